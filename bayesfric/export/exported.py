"""Export of a finished run: files of a format, the terms that it loses, and the torque error."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base import __version__
from bayesfric.base.atomic_write import check_output_folder, new_folder
from bayesfric.base.errors import BadInput
from bayesfric.export.bam import BAM_NUMBERS
from bayesfric.export.formats import Files, Format, Options, body_of, filled, format_of, omitted
from bayesfric.export.joint_model import (
    LINK_AND_DRIVE,
    LOSSES,
    Numbers,
    Trajectory,
    motor_unit,
    number_of,
    of_recording,
    simulated_torque,
    stacked,
    thinned,
    torque_along,
    undelayed,
    unit_of,
)
from bayesfric.export.point_estimate import ParameterVectors, parameter_vectors
from bayesfric.export.programs import Program, program_of, programs
from bayesfric.export.written_law import law
from bayesfric.fit.model import Result
from bayesfric.fit.result import result_of
from bayesfric.identifiability.friction_curve import covered
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Parameter
from bayesfric.recordings.arrays import Array, rms
from bayesfric.report.summary.derived_quantities import LEVEL
from bayesfric.results.reported import ORDER

_DRAWS = 400  # for intervals


@dataclass(frozen=True, eq=False)
class Exported:
    """The record of an export, and its files by name, the main one first."""

    record: dict[str, Any]
    files: Files

    def as_json(self) -> dict[str, Any]:
        """Give the content of ``export.json``, which the command prints."""
        content: dict[str, Any] = json.loads(json.dumps(self.record))
        return content

    @property
    def main(self) -> str | bytes:
        """Content of the main file."""
        return next(iter(self.files.values()))

    def text(self) -> str:
        """Summarise numbers, lost terms and the torque error for people."""
        return filled("export.txt.j2", **self.record, level=100 * LEVEL).rstrip()

    def write(self, folder: Path | str, *, force: bool = False) -> list[str]:
        """Write the files and ``export.json``, and return their paths.

        Parameters
        ----------
        folder
            Folder to make; nothing is left behind after an error.
        force
            Whether an old export may be replaced.

        Raises
        ------
        BadInput
            If the folder exists already, or cannot be written.
        """
        folder = Path(folder)
        check_output_folder(folder, force=force, marker="export.json")
        text = json.dumps(self.record, indent=1, ensure_ascii=False, allow_nan=False)
        with new_folder(folder) as unfinished:
            for name, content in {**self.files, "export.json": text + "\n"}.items():
                data = content if isinstance(content, bytes) else content.encode()
                (unfinished / name).write_bytes(data)
        return [str(folder / name) for name in (*self.files, "export.json")]


def export(
    posterior: Any,
    to: str,
    *,
    output: Path | str | None = None,
    force: bool = False,
    joint: str = "joint",
    into: Path | str | None = None,
    draws: int | None = None,
    program: str | None = None,
) -> Exported:
    """Export a finished posterior to a simulator's files, and report what these lose.

    Parameters
    ----------
    posterior
        From :meth:`bayesfric.Model.sample`, or the folder of a finished run.
    to
        ``mujoco``, ``urdf``, ``sdf``, ``drake``, ``pinocchio``, ``isaac``, ``bam``,
        ``ros2-control``, ``csv``, ``c`` or ``python``.
    output
        Folder to make; nothing is written if left out.
    force
        Whether to replace an old one.
    joint
        Its name in the simulator.
    into
        MuJoCo: model whose joint is changed.
    draws
        CSV: number of draws.
    program
        Program that the files are for, such as ``drake``: numbers that it does not take are left
        out, and those that it takes are fitted in their place.

    Returns
    -------
    Exported
        Its ``files``, ``as_json()`` and ``text()``.

    Raises
    ------
    BadInput
        If there is no such format or option, or the joint has a term that the format cannot take.
    """
    form = format_of(to)
    reader = None if program is None else program_of(program, to)
    if reader is not None:
        form = form.without(reader.unused)
    options = Options(joint, None if into is None else Path(into), draws, reader)
    _check(form, options)
    exported = _export(result_of(posterior), form, options)
    if output is not None:
        exported.write(output, force=force)
    return exported


def _check(form: Format, options: Options) -> None:
    for name in {"into", "draws"} - form.options:
        if getattr(options, name) is not None:
            raise BadInput(f"--{name}", f"has no effect in the format {form.name}", "leave it out")
    if options.into is not None and not options.into.is_file():
        raise BadInput(f"--into {options.into}", "does not exist", "name an MJCF file")
    if options.draws is not None and options.draws < 1:
        raise BadInput("--draws", f"is {options.draws}", "give 1 or more")
    if not re.fullmatch(r"[\w./-]+", options.joint):
        raise BadInput("--joint", f"{options.joint!r} is no name", "use letters, digits, _ - . /")


def _export(run: Result, form: Format, options: Options) -> Exported:
    joint, motions = run.joint, [Trajectory.of(o) for o in run.model.observations]
    thin = thinned(motions)
    vectors = parameter_vectors(run, thin, options.draws or _DRAWS)
    recorded = covered(run.model.chain, run.model.observations, vectors.point, open_scale=True)
    load = float(np.abs(recorded[1]).mean())
    fitted = form.fit(joint, np.vstack([vectors.point, vectors.draws]), thin, load)
    # the torque that held the joint at standstill is a lower limit of its static friction
    law_friction = fitted["static_friction"]
    held = max((rest["held"] for rest in run.summary.fit.rests), default=0.0)
    fitted["static_friction"] = np.maximum(law_friction, held * fitted["gain"])
    at_least = bool(fitted["static_friction"][0] > law_friction[0])
    first = {name: x[:1] for name, x in fitted.items()}
    numbers = {name: float(x[0]) for name, x in fitted.items()}
    draws = {name: x[1:] for name, x in fitted.items()}

    def errors(pace: float, along: Sequence[Trajectory]) -> tuple[dict[str, float], Array]:
        """Error of the format where recorded paths are travelled at a pace; the law's torque."""
        paced = [replace(m, qd=pace * m.qd, qdd=pace**2 * m.qdd) for m in along]
        law_torque = torque_along(joint, undelayed(joint, vectors.point[None]), paced)[0]
        off = form.torque(joint, vectors.point[None], first, paced)[0] - law_torque
        sizes = {"rms": rms(off), "largest": float(np.abs(off).max())}
        return {"pace": pace, **sizes, "torque_rms": rms(law_torque)}, law_torque

    motor, law_torque = errors(1.0, motions)
    unit, size = motor_unit(joint), motor["torque_rms"]
    paces = [errors(pace, thin)[0] for pace in (0.5, 2.0)]
    error = {"motor": motor, "torque_rms": size, "at_pace": paces}
    lost, made_from = lost_terms(joint, form, vectors.point, thin, load)
    readers = [options.program] if options.program else programs().get(form.name, {}).values()
    record: dict[str, Any] = {
        "bayesfric": __version__,
        "run": run.name,
        "format": form.name,
        "meaning": form.meaning,
        "joint": options.joint,
        "numbers": _number_rows(run, form, options, numbers, draws, made_from, vectors, at_least),
        "lost": [
            {**x, "says": filled("lost.txt.j2", **x, whole=size, motor_unit=unit).strip()}
            for x in lost
        ],
        "error": {**error, "says": filled("error.txt.j2", **error, unit=unit).strip()},
        "programs": [_in_program(x, joint, first, motions, law_torque) for x in readers],
        "unit": unit,
        "draws": len(vectors.draws),
        "central": vectors.kind,
    }
    rotary, language = joint.load.motion == "rotary", form.language
    with_body = options.into is None and any("inertia about the joint" in x for x in form.names)
    position, speed, _ = stacked(motions)
    # everything that templates and writers use
    content: dict[str, Any] = {
        "format": form.name,
        "name": options.joint,
        "stem": re.sub(r"\W", "_", options.joint),
        "options": options,
        "run": run,
        "vectors": vectors,
        "numbers": numbers,
        "draws": draws,
        "rotary": rotary,
        "ratio": joint.ratio,
        "gravity": joint.load.gravity,
        "body": body_of(numbers, rotary) if with_body else None,
        "unit": unit,
        "position_unit": "rad" if rotary else "m",
        "summary": run.summary,
        "known_load": any(m.inputs.known_load for m in motions),
        "speed": float(np.abs(speed).max()),
        "position": [float(position.min()), float(position.max())],
    }
    if language is not None:
        content["law"] = law(joint, vectors.point, language, required=form.write is None)
    record["notes"] = _lines("notes.txt.j2", **content)
    content["remarks"] = [_harmless(line) for line in _lines("remarks.txt.j2", **record)]
    files: Files = {
        name.format(stem=content["stem"]): filled(template, **content)
        for name, template in form.templates.items()
    }
    if form.write is not None:
        files = form.write(content)
    return Exported({**record, "files": list(files)}, files)


def lost_terms(
    joint: Joint, form: Format, vector: Array, motions: Sequence[Trajectory], load: float
) -> tuple[list[dict[str, Any]], dict[str, list[str]]]:
    """List the terms of a vector ``(d,)`` that a format has no number for.

    Of each, the rms of its torque at the motor along the recorded motion, and of what is left of
    it by the format's numbers of the law with it and without. Also the parameters that each
    number is made from: without them it changes.
    """
    vectors = np.tile(vector, (1 + len(vector), 1))
    for k, p in enumerate(joint.parameters):
        if not _is_shape(p):
            vectors[1 + k, k] = p.row.default
    numbers = form.fit(joint, vectors, motions, load)
    law_torque = torque_along(joint, undelayed(joint, vectors), motions)
    left = law_torque - form.torque(joint, vectors, numbers, motions)
    made_from: dict[str, list[str]] = {name: [] for name in numbers}
    lost, size = [], rms(law_torque[0])
    for k, p in enumerate(joint.parameters):
        changed = []
        for name, x in numbers.items():
            a_loss = name in ("static_friction", *LOSSES, *BAM_NUMBERS)
            conservative = p.row.stores or p.row.circular
            if not ((a_loss and conservative) or np.isclose(x[1 + k], x[0], rtol=1e-6, atol=0.0)):
                changed.append(name)
                made_from[name].append(p.name)
        row = {"parameters": [p.name], "value": float(vector[k]), "unit": p.unit}
        row |= {"meaning": p.meaning, "fitted": [x for x in changed if x in form.carried]}
        if of_recording(p) or (form.law == "complete" and omitted(p.row)):
            lost.append({"kind": "left out", **row})
        elif number_of(p) not in form.carried and not _is_shape(p):
            torque = rms(law_torque[0] - law_torque[1 + k])
            remaining = rms(left[0] - left[1 + k])
            if remaining > 1e-6 * size or not row["fitted"]:
                lost.append({"kind": "fitted", **row, "torque": torque, "left": remaining})
    return lost, made_from


def _is_shape(p: Parameter) -> bool:
    """Whether it only shapes another term, which is zero without it or not."""
    return p.row.role == "form" and p.row.default != 0.0 and p.quantity != "gain"


def _harmless(remark: str) -> str:
    """Keep a remark, which may hold names of folders and recordings, from ending a comment."""
    printable = "".join(c for c in remark if c.isprintable())
    return printable.replace('"', "'").replace("\\", "/").replace("*/", "* /").replace("--", "- -")


def _lines(template: str, **values: Any) -> list[str]:
    return [line for line in filled(template, **values).splitlines() if line]


def _number_rows(
    run: Result,
    form: Format,
    options: Options,
    numbers: Mapping[str, float],
    draws: Mapping[str, Array],
    made_from: Mapping[str, list[str]],
    vectors: ParameterVectors,
    at_least: bool,
) -> list[dict[str, Any]]:
    """Tabulate the numbers by the format's names, with intervals and parameters.

    ``at_least`` is whether static friction is a lower limit, by standstill.
    """
    ends = [50.0 - 50.0 * LEVEL, 50.0 + 50.0 * LEVEL]
    unusable, rows = run.summary.sampler.status == "unusable", []
    for attribute, number in form.names.items():
        value, spread = numbers[number], draws[number]
        # a model that is changed keeps its own link and drive
        kept = options.into is not None and number in LINK_AND_DRIVE
        if kept or (number != "gain" and not (value or np.any(spread))):
            continue
        limit = at_least and number == "static_friction"
        fixed = float(np.ptp(spread)) <= 1e-9 * abs(value) or unusable or limit
        rows.append(
            {
                "attribute": attribute,
                "value": value,
                "at_least": limit,
                "interval": None if fixed else np.percentile(spread, ends).tolist(),
                "unit": unit_of(form.numbers[number], run.joint),
                "meaning": form.numbers[number][2],
                "made_from": made_from[number],
                "not_identified": _not_identified(run, made_from[number], vectors),
            }
        )
    return rows


def _not_identified(run: Result, names: Sequence[str], vectors: ParameterVectors) -> dict[str, str]:
    """Give the reported status of the parameters that are not identified."""
    scaled = {name for scaling in vectors.scalings for name in scaling.names}
    rows = {p.name: p.row for p in run.joint.parameters}
    statuses = {}
    for name in names:
        quantities, table = [name], run.summary.parameters
        if name in scaled:
            # the scale is chosen: only motor-side totals can be identified
            kinds = (*(rows[name].totals or (rows[name].name,)), *(rows[name].by_direction or ()))
            quantities = [f"total_{side}.{kind}" for side in ("drive", "back") for kind in kinds]
            table = run.summary.derived
        worst = (table[x].reported.status for x in quantities if x in table)
        status = max(worst, key=ORDER.index, default="identified")
        if status != "identified":
            statuses[name] = status
    return statuses


def _in_program(
    program: Program, joint: Joint, numbers: Numbers, motions: Sequence[Trajectory], law: Array
) -> dict[str, Any]:
    """Say what a program makes of the numbers, in motor torque along the recorded motion.

    ``numbers`` are those of the format, ``(1,)`` each, and ``law`` is the fitted joint's torque.
    """
    factors, refused = program.changes(name for name, x in numbers.items() if x.any())
    plain = {name: x for name, x in factors.items() if name not in ("gain", "torque_offset")}
    row: dict[str, Any] = {"program": program.name, "version": program.version}
    row |= {"refuses": refused, "at_joint": "gain" in factors, "changed": []}
    if plain and not refused:
        written = simulated_torque(joint, numbers, motions)[0]
        for name, factor in plain.items():
            alone = simulated_torque(joint, numbers | {name: factor * numbers[name]}, motions)[0]
            term = {"number": name, "factor": factor, "stored": name in program.stored}
            row["changed"].append({**term, "torque": rms(written - alone)})
        read = numbers | {name: factor * numbers[name] for name, factor in plain.items()}
        row["error"] = rms(simulated_torque(joint, read, motions)[0] - law)
    values = {**row, "whole": rms(law), "unit": motor_unit(joint)}
    return row | {"says": filled("program.txt.j2", **values).strip()}
