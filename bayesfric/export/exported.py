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
from bayesfric.base.atomic_write import check_output_folder, jsonable, new_folder
from bayesfric.base.errors import BadInput, nearest
from bayesfric.export.formats import Format, body_of, filled, formats, omitted, put_into
from bayesfric.export.joint_model import (
    LINK_AND_DRIVE,
    LOSSES,
    NUMBERS,
    Numbers,
    Trajectory,
    number_of,
    simulated_torque,
    simulator_numbers,
    stacked,
    thinned,
    torque_along,
    unit_of,
)
from bayesfric.export.point_estimate import ParameterVectors, parameter_vectors
from bayesfric.export.programs import Program, programs
from bayesfric.export.written_law import law
from bayesfric.fit.model import Result
from bayesfric.fit.result import result_of
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Parameter
from bayesfric.recordings.arrays import Array, rms
from bayesfric.report.summary.derived_quantities import LEVEL
from bayesfric.results.reported import ORDER


@dataclass(frozen=True, eq=False)
class Exported:
    """The record of an export, and its files by name, the main one first."""

    record: dict[str, Any]
    files: Mapping[str, str]

    def as_json(self) -> dict[str, Any]:
        """Give the content of ``export.json``, which the command prints."""
        return self.record

    @property
    def main(self) -> str:
        """Content of the main file."""
        return next(iter(self.files.values()))

    def text(self) -> str:
        """Summarise numbers, lost terms and the torque error for people."""
        return filled("export.txt.j2", **self.record, level=100 * LEVEL).rstrip()


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
        Number of draws of the posterior, of which intervals are and the rows of the CSV.
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
        If there is no such format or option, the joint has a term that the format cannot take, or
        the folder exists already or cannot be written.
    """
    if to not in formats():
        raise BadInput("--to", f"there is no format {to!r}", nearest(to, formats()))
    form, run, readers = formats()[to], result_of(posterior), programs().get(to, {})
    if program is not None and program not in readers:
        problem = f"no file of the format {to} was tried in {program!r}"
        raise BadInput("--for", problem, nearest(program, readers))
    if into is not None and to != "mujoco":
        raise BadInput("--into", f"has no effect in the format {to}", "leave it out")
    if draws is not None and not 1 <= draws <= len(run.draws):
        problem = f"is {draws}, and the run has {len(run.draws)}"
        raise BadInput("--draws", problem, "reduce it, or fit with more steps")
    if not re.fullmatch(r"[\w./-]+", joint):
        raise BadInput("--joint", f"{joint!r} is no name", "use letters, digits, _ - . /")
    reader = None if program is None else readers[program]
    form = form.without(reader.unused) if reader else form
    exported = export_to(form, run, reader, joint, None if into is None else Path(into), draws)
    if output is not None:
        check_output_folder(Path(output), force=force, marker="export.json")
        record = json.dumps(exported.record, indent=1, ensure_ascii=False)
        with new_folder(Path(output)) as unfinished:
            for name, text in {**exported.files, "export.json": record + "\n"}.items():
                (unfinished / name).write_bytes(text.encode())
    return exported


def export_to(
    form: Format,
    run: Result,
    reader: Program | None = None,
    name: str = "joint",
    into: Path | None = None,
    draws: int | None = None,
) -> Exported:
    """Export to a format, whose numbers may be those of one ``reader``."""
    joint, motions = run.joint, [Trajectory.of(o) for o in run.model.observations]
    rotary = joint.load.motion == "rotary"
    if form.name == "bam" and not rotary:
        raise BadInput("--to bam", "supports joints that turn", "export another format")
    thin = thinned(motions)
    vectors = parameter_vectors(run, thin, draws or 400)
    point = vectors.point[None]
    fitted = simulator_numbers(joint, np.vstack([point, vectors.draws]), thin, form.carried)
    # the torque that held the joint at standstill is a lower limit of its static friction
    held = fitted["gain"] * max((rest["held"] for rest in run.summary.fit.rests), default=0.0)
    at_least = bool(held[0] > fitted["static_friction"][0])
    fitted["static_friction"] = np.maximum(fitted["static_friction"], held)
    first = {number: x[:1] for number, x in fitted.items()}
    numbers = {number: float(x[0]) for number, x in fitted.items()}

    def errors(pace: float, along: Sequence[Trajectory]) -> dict[str, float]:
        """Error of the format where recorded paths are travelled at a pace."""
        paced = [replace(m, qd=pace * m.qd, qdd=pace**2 * m.qdd) for m in along]
        law_torque = torque_along(joint, point, paced)
        off = form.torque(joint, point, first, paced) - law_torque
        largest = float(np.abs(off).max())
        return {"pace": pace, "rms": rms(off), "largest": largest, "torque_rms": rms(law_torque)}

    motor, paces = errors(1.0, motions), [errors(pace, thin) for pace in (0.5, 2.0)]
    lost, made_from = lost_terms(joint, form, vectors.point, thin)
    readers = [reader] if reader else programs().get(form.name, {}).values()
    # a model that is changed keeps its own link and drive
    shown = {k: x for k, x in form.names.items() if into is None or x not in LINK_AND_DRIVE}
    record: dict[str, Any] = {
        "bayesfric": __version__, "run": run.name, "format": form.name, "meaning": form.meaning,
        "joint": name, "unit": joint.torque_unit, "draws": len(vectors.draws),
        "central": vectors.kind, "lost": lost,
        "numbers": number_rows(run, vectors, shown, fitted, made_from, at_least),
        "error": {"motor": motor, "torque_rms": motor["torque_rms"], "at_pace": paces},
        "programs": [in_program(x, joint, point, first, motions) for x in readers],
    }  # fmt: skip
    # other programs than the format's own do not run its Python
    law_files = form.law if reader is None or reader.name == form.name else {}
    written = law(joint, vectors.point, form.language, form.complete) if law_files else None
    position, speed, _ = stacked(motions)
    columns = {(x, unit_of(NUMBERS[x], joint)): fitted[x][1:] for x in form.names.values()}
    columns |= {(p.name, p.unit): x for p, x in zip(joint.parameters, vectors.draws.T, strict=True)}
    # everything that templates use
    content: dict[str, Any] = {
        "format": form.name, "name": name, "stem": re.sub(r"\W", "_", name), "unit": record["unit"],
        "into": into is not None, "names": form.names, "numbers": numbers, "rotary": rotary,
        "ratio": joint.ratio, "gravity": joint.load.gravity, "vectors": vectors,
        "body": body_of(numbers, rotary) if form.body else None, "summary": run.summary,
        "law": written, "no_formula": bool(law_files) and written is None,
        "titles": [f"{x} [{unit}]" if unit else x for x, unit in columns],
        "rows": zip(*columns.values(), strict=True),
        "known_load": any(m.inputs.known_load for m in motions),
        "speed": float(np.abs(speed).max()),
        "position": [float(position.min()), float(position.max())],
    }  # fmt: skip
    record["notes"] = filled("notes.txt.j2", **content).splitlines()
    remarks = filled("remarks.txt.j2", **record).splitlines()
    # remarks hold names of folders and recordings, which must not end a comment
    lines = ("".join(filter(str.isprintable, x)).replace("\\", "/") for x in remarks)
    lines = (x.replace('"', "'").replace("*/", "* /").replace("--", "- -") for x in lines)
    content["remarks"] = [*lines]
    files = {
        file.format(stem=content["stem"]): filled(template, **content)
        for file, template in {**form.files, **(law_files if written else {})}.items()
    }
    if into is not None:
        model = files.pop(next(iter(files)))
        files = {into.name: put_into(into, name, model), **files}
    return Exported(jsonable({**record, "files": list(files)}), files)


def lost_terms(
    joint: Joint, form: Format, vector: Array, motions: Sequence[Trajectory]
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
    numbers = simulator_numbers(joint, vectors, motions, form.carried)
    law_torque = torque_along(joint, vectors, motions)
    left = law_torque - form.torque(joint, vectors, numbers, motions)
    made_from: dict[str, list[str]] = {name: [] for name in numbers}
    lost, size = [], rms(law_torque[0])
    for k, p in enumerate(joint.parameters):
        conservative = p.row.stores or p.row.circular
        changed = [
            name
            for name, x in numbers.items()
            if not (conservative and name in ("static_friction", *LOSSES))
            and not np.isclose(x[1 + k], x[0], rtol=1e-6, atol=0.0)
        ]
        for name in changed:
            made_from[name].append(p.name)
        row = {"parameters": [p.name], "value": float(vector[k]), "unit": p.unit}
        row |= {"meaning": p.meaning, "fitted": [x for x in changed if x in form.carried]}
        # a delay, or the separate offset of one recording
        of_recording = p.quantity == "delay" or (p.owner == "" and p.name != "offset")
        if of_recording or (form.complete and omitted(p.row)):
            lost.append({"kind": "left out", **row})
        elif not form.complete and number_of(p) not in form.carried and not _is_shape(p):
            torque = rms(law_torque[0] - law_torque[1 + k])
            remaining = rms(left[0] - left[1 + k])
            if remaining > 1e-6 * size or not row["fitted"]:
                lost.append({"kind": "fitted", **row, "torque": torque, "left": remaining})
    return lost, made_from


def _is_shape(p: Parameter) -> bool:
    """Whether it only shapes another term, which is zero without it or not."""
    return p.row.role == "form" and p.row.default != 0.0 and p.quantity != "gain"


def number_rows(
    run: Result,
    vectors: ParameterVectors,
    names: Mapping[str, str],
    fitted: Numbers,
    made_from: Mapping[str, list[str]],
    at_least: bool,
) -> list[dict[str, Any]]:
    """Tabulate numbers by the ``names`` of a format; ``at_least`` is for static friction."""
    ends = [50.0 - 50.0 * LEVEL, 50.0 + 50.0 * LEVEL]
    unusable, rows = run.summary.sampler.status == "unusable", []
    for attribute, number in names.items():
        value, spread = float(fitted[number][0]), fitted[number][1:]
        if number != "gain" and not fitted[number].any():
            continue
        limit = at_least and number == "static_friction"
        fixed = float(np.ptp(spread)) <= 1e-9 * abs(value) or unusable or limit
        row = {"attribute": attribute, "value": value, "at_least": limit}
        row["interval"] = None if fixed else np.percentile(spread, ends).tolist()
        row |= {"unit": unit_of(NUMBERS[number], run.joint), "meaning": NUMBERS[number][2]}
        row["made_from"] = made_from[number]
        statuses = {name: _status(run, name, vectors) for name in made_from[number]}
        row["not_identified"] = {k: x for k, x in statuses.items() if x != "identified"}
        rows.append(row)
    return rows


def _status(run: Result, name: str, vectors: ParameterVectors) -> str:
    """Give the reported status of a parameter, or where its scale is chosen the worst of totals."""
    quantities, rows = [name], run.summary.rows
    if any(name in scaling.names for scaling in vectors.scalings):
        # only motor-side totals can be identified
        row = next(p.row for p in run.joint.parameters if p.name == name)
        kinds = (*(row.totals or (row.name,)), *(row.by_direction or ()))
        quantities = [f"total_{side}.{kind}" for side in ("drive", "back") for kind in kinds]
    statuses = (rows[x].reported.status for x in quantities if x in rows)
    return max(statuses, key=ORDER.index, default="identified")


def in_program(
    program: Program, joint: Joint, point: Array, numbers: Numbers, motions: Sequence[Trajectory]
) -> dict[str, Any]:
    """Say what a program makes of a format's numbers, in motor torque along recorded motion."""
    factors, refused = program.changes(name for name, x in numbers.items() if x.any())
    row: dict[str, Any] = {"program": program.name, "version": program.version}
    row |= {"refuses": refused, "at_joint": "gain" in factors, "changed": []}
    adds = {name: x for name, x in program.adds.items() if not numbers[name].any()}
    acting = [name for name in (*factors, *adds) if name not in ("gain", "torque_offset")]
    read = {x: factors.get(x, 1.0) * numbers[x] + adds.get(x, 0.0) for x in acting}
    if read and not refused:
        written = simulated_torque(joint, numbers, motions)
        for name, x in read.items():
            change = {"number": name, "stored": name in program.stored}
            change |= {"factor": factors.get(name, 1.0), "adds": adds.get(name, 0.0)}
            torque = rms(written - simulated_torque(joint, numbers | {name: x}, motions))
            row["changed"].append({**change, "torque": torque})
        law_torque = torque_along(joint, point, motions)
        row["error"] = rms(simulated_torque(joint, numbers | read, motions) - law_torque)
    return row
