"""Export of a finished run: files of a format, the terms that it loses, and the torque error."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base import __version__
from bayesfric.base.atomic_write import check_output_folder, new_folder
from bayesfric.base.errors import BadInput
from bayesfric.export.formats import Files, Format, Options, body_of, filled, format_of, omitted
from bayesfric.export.joint_model import (
    LINK_AND_DRIVE,
    LOSSES,
    NUMBERS,
    Numbers,
    Trajectory,
    exact_numbers,
    number_of,
    of_recording,
    simulated_torque,
    stacked,
    thinned,
    torque_along,
    undelayed,
    unit_torques,
)
from bayesfric.export.point_estimate import ParameterVectors, parameter_vectors
from bayesfric.export.programs import Program, program_of, programs
from bayesfric.export.written_law import law, unwritten
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
    if output is not None:
        check_output_folder(Path(output), force=force, marker="export.json")
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
    law_torque = torque_along(joint, undelayed(joint, vectors.point[None]), motions)[0]
    fitted = form.fit(joint, np.vstack([vectors.point, vectors.draws]), thin, load)
    # the torque that held the joint at standstill is a lower limit of its static friction
    law_friction = fitted["static_friction"]
    held = max((rest["held"] for rest in run.summary.fit.rests), default=0.0)
    fitted["static_friction"] = np.maximum(law_friction, held * fitted["gain"])
    at_least = bool(fitted["static_friction"][0] > law_friction[0])
    numbers = {name: float(x[0]) for name, x in fitted.items()}
    draws = {name: x[1:] for name, x in fitted.items()}
    first = {name: x[:1] for name, x in fitted.items()}
    off = form.torque(joint, vectors.point, first, motions) - law_torque
    motor = {"rms": rms(off), "largest": float(np.abs(off).max())}
    error = {"motor": motor, "torque_rms": rms(law_torque)}
    readers = [options.program] if options.program else programs().get(form.name, {}).values()
    motor_unit = "N m" if joint.motor_motion == "rotary" else "N"
    lost = lost_terms(joint, form, vectors.point, motions)
    names = {
        name: number
        for name, number in form.names.items()
        # a model that is changed keeps its own link and drive
        if options.into is None or number not in LINK_AND_DRIVE
    }
    record: dict[str, Any] = {
        "bayesfric": __version__,
        "run": run.name,
        "format": form.name,
        "meaning": form.meaning,
        "joint": options.joint,
        "numbers": _number_rows(run, form, names, numbers, draws, vectors, at_least=at_least),
        "lost": [
            {**x, "says": filled("lost.txt.j2", **x, whole=error["torque_rms"]).strip()}
            for x in lost
        ],
        "error": error,
        "programs": [_in_program(reader, joint, first, motions, law_torque) for reader in readers],
        "unit": motor_unit,
        "draws": len(vectors.draws),
        "central": vectors.kind,
    }
    rotary, language = joint.load.motion == "rotary", form.language
    with_body = options.into is None and any("inertia about the joint" in x for x in form.names)
    # everything that templates and writers use
    content: dict[str, Any] = {
        "format": form.name,
        "name": options.joint,
        "stem": re.sub(r"\W", "_", options.joint),
        "options": options,
        "run": run,
        "vectors": vectors,
        "motions": motions,
        "numbers": numbers,
        "draws": draws,
        "rotary": rotary,
        "ratio": joint.ratio,
        "gravity": joint.load.gravity,
        "body": body_of(numbers, rotary) if with_body else None,
        "unit": motor_unit,
        "position_unit": "rad" if rotary else "m",
    }
    record["notes"] = _notes(content)
    content["remarks"] = [
        _harmless(line) for line in filled("remarks.txt.j2", **record).splitlines() if line
    ]
    if language is not None and (form.write is None or unwritten(joint) is None):
        content["law"] = law(joint, vectors.point, language)
    files: Files = {
        name.format(stem=content["stem"]): filled(template, **content)
        for name, template in form.templates.items()
    }
    if form.write is not None:
        files = form.write(content)
    return Exported({**record, "files": list(files)}, files)


def lost_terms(
    joint: Joint, form: Format, vector: Array, motions: Sequence[Trajectory]
) -> list[dict[str, Any]]:
    """List the terms of a vector ``(d,)`` that a format has no number for.

    Of each, the rms of its torque at the motor along the recorded motion, and of what is left of
    it where the losses that the format has are fitted to it.
    """
    values = undelayed(joint, vector[None])
    losses = [name for name in LOSSES if name in form.carried and form.friction]
    springs = ["stiffness"] if "stiffness" in form.carried else []
    # nothing stands in for the link and the drive
    bases = [
        (names, columns := unit_torques(names, motions), np.linalg.pinv(columns))
        for names in (losses, springs, [])
    ]
    torque, lost = torque_along(joint, values, motions)[0], []
    for p, value in zip(joint.parameters, vector.tolist(), strict=True):
        row = {"parameters": [p.name], "value": value, "unit": p.unit, "meaning": p.meaning}
        number = number_of(p)
        if of_recording(p) or (form.complete and omitted(p.row)):
            lost.append({"kind": "left out", **row})
        elif number in form.carried or form.complete or not form.friction or _is_shape(p):
            continue
        elif number == "armature":
            lost.append({"kind": "armature", **row})
        else:
            without = values.copy()
            without[0, joint.names.index(p.name)] = 0.0
            term = torque - torque_along(joint, without, motions)[0]
            kind = 2 if number in LINK_AND_DRIVE else number in ("stiffness", "stiffness_cubic")
            fitted, columns, inverse = bases[kind]
            left = term - columns @ (inverse @ term)
            sizes: dict[str, Any] = {"torque": rms(term), "left": rms(left), "fitted": fitted}
            sizes["torque_unit"] = "N m" if joint.motor_motion == "rotary" else "N"
            lost.append({"kind": "fitted", **row, **sizes})
    return lost


def _is_shape(p: Parameter) -> bool:
    """Whether it only shapes another term, which is zero without it or not."""
    return p.row.role == "form" and p.row.default != 0.0


def _sources(run: Result, form: Format) -> dict[str, list[str]]:
    """Name the parameters that each number of a format is made from."""
    names: dict[str, list[str]] = {number: [] for number in form.numbers}
    instead = {"armature": "link_inertia", "stiffness_cubic": "stiffness"}
    for p in run.joint.parameters:
        number = number_of(p)
        if number and number not in form.carried:
            number = instead.get(number, "")
        if number:
            names[number].append(p.name)
        elif not of_recording(p) and not _is_shape(p) and number_of(p) not in LINK_AND_DRIVE:
            for loss in (*LOSSES, *(name for name in names if name not in NUMBERS)):
                names[loss].append(p.name)
        if p.quantity in ("load_drive", "load_back"):
            names["gain"].append(p.name)
        if number == "friction" or p.quantity.startswith(("coulomb_", "load", "stribeck_")):
            names["static_friction"].append(p.name)
    return names


def _harmless(remark: str) -> str:
    """Keep a remark, which may hold names of folders and recordings, from ending a comment."""
    printable = "".join(c for c in remark if c.isprintable())
    return printable.replace('"', "'").replace("\\", "/").replace("*/", "* /").replace("--", "- -")


def _notes(content: Mapping[str, Any]) -> list[str]:
    """List notes on the format and the run."""
    run, motions = content["run"], content["motions"]
    placeholder = None
    # a link whose inertia is in the rotor's
    if content["body"] is not None and not content["numbers"]["link_inertia"]:
        exact = exact_numbers(run.joint, content["vectors"].point[None])
        constants = {name: float(x[0]) for name, x in exact.items()}
        placeholder = body_of(constants, content["rotary"])
    position, speed, _ = stacked(motions)
    text = filled(
        "notes.txt.j2",
        **content,
        summary=run.summary,
        known_load=any(m.inputs.known_load for m in motions),
        own_term=unwritten(run.joint) is not None,
        placeholder=placeholder,
        speed=float(np.abs(speed).max()),
        position=[float(position.min()), float(position.max())],
    )
    return [line for line in text.splitlines() if line]


def _number_rows(
    run: Result,
    form: Format,
    names: Mapping[str, str],
    numbers: Mapping[str, float],
    draws: Mapping[str, Array],
    vectors: ParameterVectors,
    *,
    at_least: bool,
) -> list[dict[str, Any]]:
    """Tabulate the numbers by the format's names, with intervals and parameters.

    ``at_least`` is whether static friction is a lower limit, by standstill.
    """
    ends = [50.0 - 50.0 * LEVEL, 50.0 + 50.0 * LEVEL]
    unusable = run.summary.sampler.status == "unusable"
    sources, rows = _sources(run, form), []
    for attribute, number in names.items():
        made_from = tuple(sources[number])
        value, spread = numbers[number], draws[number]
        if number != "gain" and not (made_from and (value or np.any(spread))):
            continue  # the joint has none
        limit = at_least and number == "static_friction"
        fixed = float(np.ptp(spread)) <= 1e-9 * abs(value) or unusable or limit
        rows.append(
            {
                "attribute": attribute,
                "value": value,
                "at_least": limit,
                "interval": None if fixed else np.percentile(spread, ends).tolist(),
                "unit": form.numbers[number].unit(run.joint),
                "meaning": form.numbers[number].meaning,
                "made_from": list(made_from),
                "not_identified": _not_identified(run, made_from, vectors),
            }
        )
    return rows


def _not_identified(
    run: Result, names: tuple[str, ...], vectors: ParameterVectors
) -> dict[str, str]:
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
    unit = "N m" if joint.motor_motion == "rotary" else "N"
    return row | {"says": filled("program.txt.j2", **row, whole=rms(law), unit=unit).strip()}
