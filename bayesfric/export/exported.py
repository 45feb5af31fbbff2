"""A finished run as files of a format, with what they lose and how much torque that is."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base import __version__
from bayesfric.base.atomic_write import check_output_folder, new_folder
from bayesfric.base.errors import BadInput
from bayesfric.export.joint_model import (
    NUMBERS,
    RISES,
    AtJoint,
    Moved,
    at_joint,
    moving,
    simulated_torque,
    torque_along,
    without_load_losses,
)
from bayesfric.export.extra_terms import AROUND, carried, law_lost, lost_terms
from bayesfric.export.point_estimate import Vectors, vectors
from bayesfric.export.format import Content, Files, Format, Options, filled, format_of, pendulum
from bayesfric.export.written_law import unwritten
from bayesfric.fit.finished_run import Finished, finished
from bayesfric.identifiability.friction_curve import covered, friction_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.report.summary.conclusions import put_reported
from bayesfric.report.summary.derived_quantities import LEVEL, rms_of
from bayesfric.results.reported import ORDER

# Draws that intervals are told from, and recorded places at which friction is compared.
_DRAWS, _PLACES = 400, 2000


@dataclass(frozen=True, eq=False)
class Exported:
    """What an export says, and its files by name, the main one first."""

    record: dict[str, Any]
    files: Files

    def as_json(self) -> dict[str, Any]:
        """Give what ``export.json`` holds and the command prints."""
        found: dict[str, Any] = json.loads(json.dumps(self.record))
        return found

    @property
    def main(self) -> str | bytes:
        """The main file's content."""
        return next(iter(self.files.values()))

    def text(self) -> str:
        """Say it for people: numbers, what is lost, and how much torque that is."""
        return filled("export.txt.j2", **self.record, level=100 * LEVEL).rstrip()

    def write(self, folder: Path | str, *, force: bool = False) -> list[str]:
        """Write the files and what they lose (``export.json``); give their paths.

        ``force`` is whether an old folder may be replaced. ``BadInput`` if something
        is there already, or cannot be written; nothing is left behind.
        """
        folder = Path(folder)
        check_output_folder(folder, force=force, marker="export.json")
        text = json.dumps(self.record, indent=1, ensure_ascii=False, allow_nan=False)
        with new_folder(folder) as beside:
            for name, content in {**self.files, "export.json": text + "\n"}.items():
                data = content if isinstance(content, bytes) else content.encode()
                (beside / name).write_bytes(data)
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
    """Put a finished posterior into a simulator's files, and say what these lose.

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
        Replace an old one.
    joint
        Its name in the simulator.
    at_load
        Torque at the joint, N m or N, at which a load loss is met.
    into
        MuJoCo: model whose joint is changed.
    draws
        CSV: how many.

    Returns
    -------
    Exported
        Its ``files``, ``as_json()`` and ``text()``.

    Raises
    ------
    BadInput
        If there is no such format or option, or the joint has what no export knows.
    """
    form = format_of(to)
    chosen = Options(joint, at_load, None if into is None else Path(into), draws)
    _check(form, chosen)
    if output is not None:
        check_output_folder(Path(output), force=force, marker="export.json")
    found = posterior if isinstance(posterior, Finished) else finished(posterior)
    found = replace(found, summary=put_reported(found.summary))
    made = _exported(found, form, chosen)
    if output is not None:
        made.write(output, force=force)
    return made


def _check(form: Format, chosen: Options) -> None:
    for name in {"into", "draws"} - form.options:
        if getattr(chosen, name) is not None:
            raise BadInput(f"--{name}", f"says nothing to the format {form.name}", "leave it out")
    if chosen.into is not None and not chosen.into.is_file():
        raise BadInput(f"--into {chosen.into}", "does not exist", "name an MJCF file")
    if chosen.at_load is not None and not (np.isfinite(chosen.at_load) and chosen.at_load >= 0.0):
        raise BadInput("--at-load", f"is {chosen.at_load:g}", "give a torque of zero or more")
    if chosen.draws is not None and chosen.draws < 1:
        raise BadInput("--draws", f"is {chosen.draws}", "ask for one or more")
    if not chosen.joint or not all(c.isalnum() or c in "_-./" for c in chosen.joint):
        raise BadInput("--joint", f"{chosen.joint!r} is no name", "use letters, digits, _ - . /")


def _exported(found: Finished, form: Format, options: Options) -> Exported:
    chain, motions = found.joint, [Moved.of(o) for o in found.model.observations]
    told = vectors(found, motions, options.draws or _DRAWS)
    each = np.vstack([told.middle, told.draws])
    if "load" in form.keeps:
        each = without_load_losses(chain, each)
    at = at_joint(chain, each, motions, options.at_load)
    # a link and a drive that a model has already are its own
    names = {k: n for k, n in form.names.items() if options.into is None or n not in AROUND}
    carries = names.values()
    kept, folded = carried(at, carries, motions, chain, RISES if form.whole else form.keeps)
    law = kept["static_friction"]
    # what held the joint at rest is less than what would have broken it loose
    held = max((rest.held for rest in found.summary.fit.rests), default=0.0)
    kept["static_friction"] = np.maximum(law, held * kept["gain"])
    limit = bool(kept["static_friction"][0] > law[0])
    lost = lost_terms(chain, at, told.middle, carries, form.keeps) + folded
    if form.whole:
        lost = law_lost(chain, told.middle)
    numbers = {name: float(x[0]) for name, x in kept.items()}
    draws = {name: x[1:] for name, x in kept.items()}
    error = _wrong(found, form, told.middle, numbers, motions)
    if form.torque is None:
        error["friction"] = _from_curve(found, numbers, told)
    record: dict[str, Any] = {
        "bayesfric": __version__,
        "run": found.name,
        "format": form.name,
        "meaning": form.meaning,
        "joint": options.joint,
        "numbers": _rows(found, names, numbers, draws, at, told, limit=limit),
        "at_load": options.at_load,
        "reference": {name: float(x[0]) for name, x in at.reference.items()},
        "lost": [{**x, "says": filled("lost.txt.j2", **x).strip()} for x in lost],
        "notes": _notes(found, form, options, numbers, at, told, motions, error),
        "error": error,
        "unit": _unit(chain),
        "draws": len(told.draws),
        "central": told.kind,
    }
    remarks = [_harmless(x) for x in filled("remarks.txt.j2", **record).splitlines() if x]
    files = form.write(Content(found, options, told, numbers, draws, motions, remarks))
    record["files"] = list(files)
    return Exported(record, files)


def _harmless(remark: str) -> str:
    """Keep a remark, which may hold names of folders and recordings, from ending a comment."""
    kept = "".join(c for c in remark if c.isprintable())
    return kept.replace('"', "'").replace("\\", "/").replace("*/", "* /").replace("--", "- -")


def _notes(
    found: Finished,
    form: Format,
    options: Options,
    numbers: Mapping[str, float],
    middle: AtJoint,
    told: Vectors,
    motions: Sequence[Moved],
    error: Mapping[str, Any],
) -> list[str]:
    """Say what to know of the format, and of the run, beside the numbers."""
    chain = found.joint
    rotary = chain.load.motion == "rotary"
    placeholder = None
    if form.notes & {"body", "mujoco"} and options.into is None:
        whole = {name: float(x[0]) for name, x in middle.values.items()}
        # what a rotor's inertia is added to has one
        if not numbers["link_inertia"]:
            placeholder = pendulum(whole, rotary)
    position, speed, _ = moving(motions)
    text = filled(
        "notes.txt.j2",
        **{**vars(options), "words": form.notes, "numbers": numbers, "told": told},
        summary=found.summary,
        friction=error.get("friction"),
        unit=_unit(chain),
        rotary=rotary,
        gravity=chain.load.gravity,
        known_load=any(m.inputs.known_load for m in motions),
        own_term=unwritten(chain) is not None,
        placeholder=placeholder,
        speed=float(np.abs(speed).max()),
        position=[float(position.min()), float(position.max())],
    )
    return [line for line in text.splitlines() if line]


def _unit(chain: Joint) -> str:
    return "N m" if chain.motor_motion == "rotary" else "N"


def _rows(
    found: Finished,
    names: Mapping[str, str],
    numbers: Mapping[str, float],
    draws: Mapping[str, Array],
    middle: AtJoint,
    told: Vectors,
    *,
    limit: bool,
) -> list[dict[str, Any]]:
    """Tabulate the numbers as the simulator calls them, with intervals and what made them.

    ``limit`` is whether static friction is only known to be at least that, by rests.
    """
    ends = [50.0 - 50.0 * LEVEL, 50.0 + 50.0 * LEVEL]
    unusable = found.summary.sampler.status == "unusable"
    rows = []
    for attribute, number in names.items():
        made_from = middle.made_from[number]
        if not made_from and number != "gain":
            continue  # the joint has none
        value, spread = numbers[number], draws[number]
        at_least = limit and number == "static_friction"
        fixed = float(np.ptp(spread)) <= 1e-9 * abs(value) or unusable or at_least
        rows.append(
            {
                "attribute": attribute,
                "value": value,
                "at_least": at_least,
                "interval": None if fixed else np.percentile(spread, ends).tolist(),
                "unit": NUMBERS[number].unit(found.joint),
                "meaning": NUMBERS[number].meaning,
                "made_from": list(made_from),
                "not_identified": _not_identified(found, made_from, told),
            }
        )
    return rows


def _not_identified(found: Finished, names: tuple[str, ...], told: Vectors) -> dict[str, str]:
    """Give the reported status of what a number is made of, where that is another."""
    scaled = {name for one in told.scalings for name in one.names}
    rows = {p.name: p.row for p in found.joint.parameters}
    found_statuses = {}
    for name in names:
        made, table = [name], found.summary.parameters
        if name in scaled:
            # the scale is chosen, and then they are what the motor feels of them
            kinds = (*(rows[name].totals or (rows[name].name,)), *(rows[name].by_direction or ()))
            made = [f"total_{side}.{kind}" for side in ("drive", "back") for kind in kinds]
            table = found.summary.derived
        reported = [table[x].reported for x in made if x in table]
        status = max((x.status for x in reported if x), key=ORDER.index, default="identified")
        if status != "identified":
            found_statuses[name] = status
    return found_statuses


def _wrong(
    found: Finished,
    form: Format,
    vector: Array,
    numbers: Mapping[str, float],
    motions: Sequence[Moved],
) -> dict[str, Any]:
    """Replay recorded motion through the fitted joint and through a format's; compare torques.

    A delay is left out: it is of the recording.
    """
    chain, here = found.joint, vector[None].copy()
    if chain.delay_name:
        here[0, chain.names.index(chain.delay_name)] = 0.0
    whole = torque_along(chain, here, motions)[0]
    if form.torque is None:
        torque = simulated_torque(chain, numbers, motions)
    else:
        torque = form.torque(chain, vector, motions)
    return {
        "motor": {"rms": rms_of(torque - whole), "largest": float(np.abs(torque - whole).max())},
        "torque_rms": rms_of(whole),
    }


def _from_curve(found: Finished, numbers: Mapping[str, float], told: Vectors) -> dict[str, float]:
    """Compare a format's friction with the median over draws, at recorded speeds and loads.

    Both are at the motor, of its true torque, each speed as often as it was recorded.
    """
    chain = found.joint
    places = covered(found.model, told.middle, open_scale=True)
    some = np.linspace(0, places.shape[1] - 1, min(places.shape[1], _PLACES)).astype(int)
    speed, load = places[:, some]
    with np.errstate(all="ignore"):
        drawn = friction_torque(chain, told.draws, speed, load, open_scale=True)
    curve = np.median(drawn, axis=0)
    size = np.abs(speed / chain.ratio)
    written = numbers["friction"] + numbers["damping"] * size + numbers["quadratic"] * size**2
    gain = told.middle[chain.names.index("drive.gain")] if chain.gain else 1.0
    apart = (written * gain / numbers["gain"] - curve)[np.isfinite(curve)]
    return {"rms": rms_of(apart), "curve_rms": rms_of(curve[np.isfinite(curve)])}
