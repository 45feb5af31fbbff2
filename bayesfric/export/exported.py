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
from bayesfric.export.extra_terms import LINK_AND_DRIVE, fold_extra_terms, lost_by_law, lost_terms
from bayesfric.export.format import Files, Format, Options, filled, format_of, pendulum
from bayesfric.export.joint_model import (
    NUMBERS,
    STRIBECK,
    JointModel,
    Trajectory,
    joint_model,
    simulated_torque,
    stacked,
    torque_along,
    without_load_friction,
)
from bayesfric.export.point_estimate import ParameterVectors, parameter_vectors
from bayesfric.export.written_law import law, unwritten
from bayesfric.fit.result import Result, result_of
from bayesfric.identifiability.friction_curve import covered, friction_torque
from bayesfric.recordings.arrays import Array
from bayesfric.report.summary.derived_quantities import LEVEL, rms_of
from bayesfric.results.reported import ORDER

# Draws for intervals, and recorded samples at which friction is compared.
_DRAWS, _SAMPLES = 400, 2000


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
    at_load: float | None = None,
    into: Path | str | None = None,
    draws: int | None = None,
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
    at_load
        Torque at the joint, N m or N, at which load-dependent friction is exact.
    into
        MuJoCo: model whose joint is changed.
    draws
        CSV: number of draws.

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
    options = Options(joint, at_load, None if into is None else Path(into), draws)
    _check(form, options)
    if output is not None:
        check_output_folder(Path(output), force=force, marker="export.json")
    run = result_of(posterior)
    exported = _export(run, form, options)
    if output is not None:
        exported.write(output, force=force)
    return exported


def _check(form: Format, options: Options) -> None:
    for name in {"into", "draws"} - form.options:
        if getattr(options, name) is not None:
            raise BadInput(f"--{name}", f"has no effect in the format {form.name}", "leave it out")
    if options.into is not None and not options.into.is_file():
        raise BadInput(f"--into {options.into}", "does not exist", "name an MJCF file")
    if options.at_load is not None and not (np.isfinite(options.at_load) and options.at_load >= 0):
        raise BadInput("--at-load", f"is {options.at_load:g}", "give a torque of zero or more")
    if options.draws is not None and options.draws < 1:
        raise BadInput("--draws", f"is {options.draws}", "give 1 or more")
    if not re.fullmatch(r"[\w./-]+", options.joint):
        raise BadInput("--joint", f"{options.joint!r} is no name", "use letters, digits, _ - . /")


def _export(run: Result, form: Format, options: Options) -> Exported:
    chain, motions = run.joint, [Trajectory.of(o) for o in run.model.observations]
    vectors = parameter_vectors(run, motions, options.draws or _DRAWS)
    values = np.vstack([vectors.point, vectors.draws])
    if "load" in form.keeps:
        values = without_load_friction(chain, values)
    model = joint_model(chain, values, motions, options.at_load)
    # a model that is changed keeps its own link and drive
    names = {
        k: number
        for k, number in form.names.items()
        if options.into is None or number not in LINK_AND_DRIVE
    }
    carries, keeps = names.values(), STRIBECK if form.complete else form.keeps
    folded, lost = fold_extra_terms(model, carries, motions, chain, keeps)
    # the torque that held the joint at standstill is a lower limit of its static friction
    fitted_friction = folded["static_friction"]
    held = max((rest.held for rest in run.summary.fit.rests), default=0.0)
    folded["static_friction"] = np.maximum(fitted_friction, held * folded["gain"])
    at_least = bool(folded["static_friction"][0] > fitted_friction[0])
    if form.complete:
        lost = lost_by_law(chain, vectors.point)
    else:
        lost = lost_terms(chain, model, vectors.point, carries, form.keeps) + lost
    numbers = {name: float(x[0]) for name, x in folded.items()}
    draws = {name: x[1:] for name, x in folded.items()}
    error = _torque_error(run, form, vectors.point, numbers, motions)
    if form.torque is None:
        error["friction"] = _friction_error(run, numbers, vectors)
    motor_unit = "N m" if chain.motor_motion == "rotary" else "N"
    record: dict[str, Any] = {
        "bayesfric": __version__,
        "run": run.name,
        "format": form.name,
        "meaning": form.meaning,
        "joint": options.joint,
        "numbers": _number_rows(run, names, numbers, draws, model, vectors, at_least=at_least),
        "at_load": options.at_load,
        "reference": {name: float(x[0]) for name, x in model.reference.items()},
        "lost": [{**x, "says": filled("lost.txt.j2", **x).strip()} for x in lost],
        "error": error,
        "unit": motor_unit,
        "draws": len(vectors.draws),
        "central": vectors.kind,
    }
    rotary, language = chain.load.motion == "rotary", form.language
    with_body = bool(form.notes & {"body", "mujoco"}) and options.into is None
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
        "ratio": chain.ratio,
        "gravity": chain.load.gravity,
        "body": pendulum(numbers, rotary) if with_body else None,
        "unit": motor_unit,
        "position_unit": "rad" if rotary else "m",
    }
    record["notes"] = _notes(content, form, model, error)
    content["remarks"] = [
        _harmless(line) for line in filled("remarks.txt.j2", **record).splitlines() if line
    ]
    if language is not None and (form.write is None or unwritten(chain) is None):
        content["law"] = law(chain, vectors.point, language)
    files: Files = {
        name.format(stem=content["stem"]): filled(template, **content)
        for name, template in form.templates.items()
    }
    if form.write is not None:
        files = form.write(content)
    return Exported({**record, "files": list(files)}, files)


def _harmless(remark: str) -> str:
    """Keep a remark, which may hold names of folders and recordings, from ending a comment."""
    printable = "".join(c for c in remark if c.isprintable())
    return printable.replace('"', "'").replace("\\", "/").replace("*/", "* /").replace("--", "- -")


def _notes(
    content: Mapping[str, Any], form: Format, model: JointModel, error: Mapping[str, Any]
) -> list[str]:
    """List notes on the format and the run."""
    run, motions = content["run"], content["motions"]
    placeholder = None
    # a link whose inertia is in the rotor's
    if content["body"] is not None and not content["numbers"]["link_inertia"]:
        values = {name: float(x[0]) for name, x in model.values.items()}
        placeholder = pendulum(values, content["rotary"])
    position, speed, _ = stacked(motions)
    text = filled(
        "notes.txt.j2",
        **content,
        words=form.notes,
        summary=run.summary,
        friction=error.get("friction"),
        known_load=any(m.inputs.known_load for m in motions),
        own_term=unwritten(run.joint) is not None,
        placeholder=placeholder,
        speed=float(np.abs(speed).max()),
        position=[float(position.min()), float(position.max())],
    )
    return [line for line in text.splitlines() if line]


def _number_rows(
    run: Result,
    names: Mapping[str, str],
    numbers: Mapping[str, float],
    draws: Mapping[str, Array],
    model: JointModel,
    vectors: ParameterVectors,
    *,
    at_least: bool,
) -> list[dict[str, Any]]:
    """Tabulate the numbers by the format's names, with intervals and parameters.

    ``at_least`` is whether static friction is a lower limit, by standstill.
    """
    ends = [50.0 - 50.0 * LEVEL, 50.0 + 50.0 * LEVEL]
    unusable = run.summary.sampler.status == "unusable"
    rows = []
    for attribute, number in names.items():
        made_from = model.made_from[number]
        if not made_from and number != "gain":
            continue  # the joint has none
        value, spread = numbers[number], draws[number]
        limit = at_least and number == "static_friction"
        fixed = float(np.ptp(spread)) <= 1e-9 * abs(value) or unusable or limit
        rows.append(
            {
                "attribute": attribute,
                "value": value,
                "at_least": limit,
                "interval": None if fixed else np.percentile(spread, ends).tolist(),
                "unit": NUMBERS[number].unit(run.joint),
                "meaning": NUMBERS[number].meaning,
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


def _torque_error(
    run: Result,
    form: Format,
    vector: Array,
    numbers: Mapping[str, float],
    motions: Sequence[Trajectory],
) -> dict[str, Any]:
    """Compare motor torques of the fitted joint and of a format along the recorded motion.

    Without the delay, which is a property of the recording.
    """
    chain, undelayed = run.joint, vector[None].copy()
    if chain.delay_name:
        undelayed[0, chain.names.index(chain.delay_name)] = 0.0
    expected = torque_along(chain, undelayed, motions)[0]
    if form.torque is None:
        torque = simulated_torque(chain, numbers, motions)
    else:
        torque = form.torque(chain, vector, motions)
    error = torque - expected
    motor = {"rms": rms_of(error), "largest": float(np.abs(error).max())}
    return {"motor": motor, "torque_rms": rms_of(expected)}


def _friction_error(
    run: Result, numbers: Mapping[str, float], vectors: ParameterVectors
) -> dict[str, float]:
    """Compare a format's friction with the median over draws, at recorded speeds and loads.

    Both are at the motor, of its true torque, each speed as often as it was recorded.
    """
    chain = run.joint
    samples = covered(run.model, vectors.point, open_scale=True)
    count = samples.shape[1]
    speed, load = samples[:, np.linspace(0, count - 1, min(count, _SAMPLES)).astype(int)]
    with np.errstate(all="ignore"):
        drawn = friction_torque(chain, vectors.draws, speed, load, open_scale=True)
    curve = np.median(drawn, axis=0)
    size = np.abs(speed / chain.ratio)
    exported = numbers["friction"] + numbers["damping"] * size + numbers["quadratic"] * size**2
    gain = vectors.point[chain.names.index("drive.gain")] if chain.gain else 1.0
    error = (exported * gain / numbers["gain"] - curve)[np.isfinite(curve)]
    return {"rms": rms_of(error), "curve_rms": rms_of(curve[np.isfinite(curve)])}
