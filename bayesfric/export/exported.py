"""A finished run as files of a format, with what they lose and how much torque that is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import bayesfric
from bayesfric.errors import BadInput
from bayesfric.export.at_joint import NUMBERS, Array, AtJoint, Moved, at_joint, without_load_losses
from bayesfric.export.carried import Lost, carried, law_lost, lost_terms
from bayesfric.export.central import Vectors, vectors
from bayesfric.export.error import SPAN, Wrong, wrong, wrong_by
from bayesfric.export.figure import ExportPicture, export_figure
from bayesfric.export.format import (
    Content,
    Files,
    Format,
    Options,
    filled,
    format_of,
    sentence,
)
from bayesfric.export.pendulum import pendulum
from bayesfric.finished import Finished, finished
from bayesfric.recordings.trajectory import trajectory
from bayesfric.report.figures.style import save
from bayesfric.report.files import check_free, made_beside, parents_made, unwritable
from bayesfric.report.summary.summary import LEVEL

# Draws that intervals are told from.
_DRAWS = 400


@dataclass(frozen=True, eq=False)
class Exported:
    """What an export says, and its files by name, the main one first."""

    record: dict[str, Any]
    files: Files
    picture: ExportPicture

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

    def write(self, output: Path | str, *, force: bool = False) -> list[str]:
        """Write the files, what they lose (``export.json``) and the figure; give their paths.

        Parameters
        ----------
        output
            A folder to make, or, with a suffix, the main file: the others stand beside it under
            its name.
        force
            Whether an old folder may be kept under another name, or old files be replaced.

        Raises
        ------
        BadInput
            If something is there already, or cannot be written; nothing is left behind.
        """
        output = Path(output)
        if not _is_file(output):
            check_output(output, force=force)
            with made_beside(output) as beside:
                names = self._fill(beside)
            return [str(output / name) for name in names]
        check_output(output, force=force)
        try:
            with (
                parents_made(output),
                TemporaryDirectory(prefix=".", dir=output.parent) as aside,
            ):
                places = {name: self._place(output, name) for name in self._fill(Path(aside))}
                if not force and (taken := [x for x in places.values() if x.exists()]):
                    raise BadInput(str(taken[0]), "exists already", "add --force to replace it")
                for name, place in places.items():
                    Path(aside, name).replace(place)
        except OSError as error:
            raise unwritable(output, error, "file") from None
        return [str(place) for place in places.values()]

    def _place(self, output: Path, name: str) -> Path:
        main = next(iter(self.files))
        return output if name == main else output.with_name(f"{output.stem}-{name}")

    def _fill(self, folder: Path) -> list[str]:
        for name, content in self.files.items():
            data = content if isinstance(content, bytes) else content.encode()
            (folder / name).write_bytes(data)
        text = json.dumps(self.record, indent=1, ensure_ascii=False, allow_nan=False)
        (folder / "export.json").write_text(text + "\n", encoding="utf-8")
        save(export_figure(self.picture), folder, "torque-error")
        more = ("export.json", "torque-error.pdf", "torque-error.svg", "torque-error.png")
        return [*self.files, *more]


def _is_file(output: Path) -> bool:
    """Whether a path names a file; a folder's name may hold a dot, as of the run "knee.v2"."""
    return output.suffix[1:].isalnum()


def check_output(output: Path, *, force: bool) -> None:
    """Refuse what would be overwritten or cannot be made, before anything is computed."""
    if not _is_file(output):
        check_free(output, force=force, marked="export.json")
        return
    if output.is_dir():
        raise BadInput(str(output), "is a folder", "name a file, or a folder without a suffix")
    if output.exists() and not force:
        raise BadInput(str(output), "exists already", "add --force to replace it")


def export(
    posterior: Any, to: str, *, output: Path | str | None = None, **options: Any
) -> Exported:
    """Put a finished posterior into a simulator's files, and say what these lose.

    Parameters
    ----------
    posterior
        From :meth:`bayesfric.Model.sample`, or the folder of a finished run.
    to
        ``mujoco``, ``urdf``, ``sdf``, ``drake``, ``pinocchio``, ``isaac``, ``bam``, ``csv``,
        ``parquet``, ``npz``, ``c`` or ``python``.
    output
        Folder to make, or main file; nothing is written if left out.
    **options
        ``joint`` (its name in the simulator), ``at_load`` (torque at the joint, N m or N, at which
        a load loss is met), and of single formats ``into``, ``damping_terms``, ``isaac_sim``,
        ``actuator``, ``draws``, ``seed``.

    Returns
    -------
    Exported
        Its ``files``, ``as_json()`` and ``text()``.

    Raises
    ------
    BadInput
        If there is no such format or option, or the joint has what no export knows.
    """
    form, chosen = format_of(to), _options(to, options)
    if output is not None:
        check_output(Path(output), force=False)
    found = posterior if isinstance(posterior, Finished) else finished(posterior)
    made = _exported(found, form, chosen)
    if output is not None:
        made.write(output)
    return made


def _options(to: str, given: Mapping[str, Any]) -> Options:
    known = {"joint", "at_load", *format_of(to).options}
    for name, value in given.items():
        if name not in {f.name for f in fields(Options)}:
            raise BadInput(name, "is no option of an export", f"use {', '.join(sorted(known))}")
        if name not in known and value is not None:
            key = f"--{name.replace('_', '-')}"
            raise BadInput(key, f"says nothing to the format {to}", "leave it out")
    chosen = Options(**{k: v for k, v in given.items() if v is not None})
    if chosen.into is not None:
        chosen = Options(**{**vars(chosen), "into": Path(chosen.into)})
    if chosen.at_load is not None and not (np.isfinite(chosen.at_load) and chosen.at_load >= 0.0):
        raise BadInput("--at-load", f"is {chosen.at_load:g}", "give a torque of zero or more")
    if chosen.draws is not None and chosen.draws < 1:
        raise BadInput("--draws", f"is {chosen.draws}", "ask for one or more")
    if not chosen.joint or not all(c.isalnum() or c in "_-./" for c in chosen.joint):
        raise BadInput("--joint", f"{chosen.joint!r} is no name", "use letters, digits, _ - . /")
    return chosen


def _exported(found: Finished, form: Format, options: Options) -> Exported:
    if form.check is not None:
        form.check(options)
    chain, motions = found.joint, [Moved.of(o) for o in found.model.observations]
    told = vectors(found, motions, options.draws or _DRAWS, options.seed)
    own_loads = "load loss" in form.keeps
    middle, each = (
        at_joint(
            chain,
            without_load_losses(chain, values) if own_loads else values,
            motions,
            options.at_load,
        )
        for values in (told.middle[None], told.draws)
    )
    carries, motion = form.carries(options), chain.load.motion
    kept = carried(middle, carries, form.supplied, motions, motion)
    spread = carried(each, carries, form.supplied, motions, motion)
    if form.torque is None:
        # both joints under one torque: that a delay moves a back-EMF makes no difference there
        pairs = zip(found.model.recordings, found.model.observations, strict=True)
        trajectories = [trajectory(replace(r, back_emf=None), o, SPAN) for r, o in pairs]
        error = wrong(chain, told.middle, kept.values, motions, trajectories)
    else:
        own = form.torque(chain, told.middle, motions)
        error = wrong_by(chain, told.middle, own, kept.values, motions)
    terms = lost_terms(chain, middle, told.middle, carries)
    lost = (*(x for x in terms if x.kind not in form.keeps), *kept.lost)
    if form.whole:
        lost = law_lost(chain, told.middle)
    numbers = {name: float(x[0]) for name, x in kept.values.items()}
    rows = _rows(found, form, options, numbers, spread.values, middle, told)
    record = _record(found, form, options, rows, lost, error, middle, told)
    remarks = map(_harmless, filled("remarks.txt.j2", **record).splitlines())
    content = Content(
        found, options, told, numbers, spread.values, motions, error, [r for r in remarks if r]
    )
    files = form.write(content)
    record["files"] = list(files)
    picture = ExportPicture(chain, motions, error, form.name)
    return Exported(record, files, picture)


def _harmless(remark: str) -> str:
    """Keep a remark, which may hold names of folders and recordings, from ending a comment."""
    kept = "".join(c for c in remark if c.isprintable())
    return kept.replace('"', "'").replace("\\", "/").replace("*/", "* /").replace("--", "- -")


def _record(
    found: Finished,
    form: Format,
    options: Options,
    rows: list[dict[str, Any]],
    lost: tuple[Lost, ...],
    error: Wrong,
    middle: AtJoint,
    told: Vectors,
) -> dict[str, Any]:
    rotary = found.joint.load.motion == "rotary"
    open_names = [name for one in told.scalings for name in one.names]
    said = {**vars(options), "gravity": found.joint.load.gravity, "slides": not rotary}
    kinds = form.notes(options, found.joint)
    notes = [sentence("notes.txt.j2", kind, said) for kind in kinds]
    if "body" in kinds and "rotor in link" not in kinds and not middle.values["link_inertia"][0]:
        body = pendulum({name: float(x[0]) for name, x in middle.values.items()}, rotary)
        told_of = {"mass": body.mass, "weighs": bool(np.any(body.com))}
        notes.append(sentence("notes.txt.j2", "no link", told_of))
    if any(o.inputs.known_load for o in found.model.observations):
        notes.insert(0, sentence("notes.txt.j2", "known load", {}))
    if (emf := found.summary.fit.back_emf) is not None:
        notes.append(sentence("notes.txt.j2", "back emf", emf.model_dump()))
    if found.summary.fit.rests:
        beyond = max(one.beyond for one in found.summary.fit.rests)
        worst = {"beyond": beyond, "unit": found.summary.fit.unit}
        notes.append(sentence("notes.txt.j2", "rests", worst))
    if found.summary.fit.residual_rms is not None:
        notes.append(sentence("notes.txt.j2", "of fit", _of_fit(found)))
    status, doubted = _status(found), found.summary.only_doubted
    if status != "reliable":
        notes.insert(0, sentence("notes.txt.j2", "status", {"status": status, "doubted": doubted}))
    reported = {name: row.reported for name, row in found.summary.rows.items()}
    biased = [name for name, one in reported.items() if one and one.how.bias]
    notes.insert(0, sentence("notes.txt.j2", told.kind, {"biased": biased}))
    if told.scalings:
        notes.insert(0, sentence("notes.txt.j2", "open scale", {"names": open_names}))
    return {
        "bayesfric": bayesfric.__version__,
        "run": found.name,
        "format": form.name,
        "meaning": form.meaning,
        "joint": options.joint,
        "numbers": rows,
        "at_load": options.at_load,
        "reference": {name: float(x[0]) for name, x in middle.reference.items()},
        "lost": [
            {**one.as_dict(), "says": sentence("lost.txt.j2", one.kind, vars(one))} for one in lost
        ],
        "notes": notes,
        "error": error.as_dict(),
        "unit": "N m" if found.joint.motor_motion == "rotary" else "N",
        "joint_unit": "N m" if rotary else "N",
        "position_unit": "rad" if rotary else "m",
        "draws": len(told.draws),
        "central": told.kind,
    }


def _of_fit(found: Finished) -> dict[str, Any]:
    """Give what the fitted joint leaves of the recordings, and how fast these are."""
    fit, seen = found.summary.fit, found.model.observations
    return {
        "rms": fit.residual_rms,
        "unit": fit.unit,
        "quantity": f"measured {fit.quantity}",
        "speed": max(float(np.abs(o.qd[o.filter.centres]).max()) for o in seen),
        "of_speed": "rad/s" if found.joint.load.motion == "rotary" else "m/s",
        "of_position": "rad" if found.joint.load.motion == "rotary" else "m",
        "position": [pick(pick(o.q[o.filter.centres]) for o in seen) for pick in (min, max)],
        "wrong": found.summary.widened,
    }


def _rows(
    found: Finished,
    form: Format,
    options: Options,
    numbers: Mapping[str, float],
    draws: Mapping[str, Array],
    middle: AtJoint,
    told: Vectors,
) -> list[dict[str, Any]]:
    """Tabulate the numbers as the simulator calls them, with intervals and what made them."""
    rotary = found.joint.load.motion == "rotary"
    ends = [50.0 - 50.0 * LEVEL, 50.0 + 50.0 * LEVEL]
    rows = []
    for one in form.attributes(options, rotary):
        if not middle.made_from[one.number] and one.number != "gain":
            continue  # the joint has none
        value, spread = one.factor * numbers[one.number], one.factor * draws[one.number]
        names = middle.made_from[one.number]
        low, high = np.percentile(spread, ends)
        fixed = float(np.ptp(spread)) <= 1e-9 * abs(value) or _status(found) == "unusable"
        rows.append(
            {
                "attribute": one.name,
                "value": value,
                "interval": None if fixed else [float(low), float(high)],
                "unit": NUMBERS["gain"].unit_of(found.joint) if one.number == "gain" else one.unit,
                "meaning": NUMBERS[one.number].meaning,
                "made_from": list(names),
                **_unsettled(found, names, told),
            }
        )
    return rows


def _status(found: Finished) -> str:
    return found.summary.sampler.status


def _unsettled(found: Finished, names: tuple[str, ...], told: Vectors) -> dict[str, Any]:
    """Name what a number is made of that the data do not determine, or only weakly.

    ``doubtful`` is what may not be what they determine, however much they say of it.
    """
    summary = found.summary
    scaled = {name for one in told.scalings for name in one.names}
    rows = {p.name: p.row for p in found.joint.parameters}
    verdicts, doubtful = {}, []
    for name in names:
        if name in scaled:
            # the scale is chosen, and then they are what the motor feels of them
            kinds = (*(rows[name].totals or (rows[name].name,)), *(rows[name].by_direction or ()))
            made = [f"total_{side}.{kind}" for side in ("drive", "back") for kind in kinds]
            found_here = [summary.derived[x] for x in made if x in summary.derived]
        else:
            found_here = [summary.parameters[name]] if name in summary.parameters else []
        said = {"doubtful" if row.doubtful else row.verdict for row in found_here}
        worst = next((v for v in ("prior", "doubtful", "weak") if v in said), "data")
        if worst == "doubtful":
            doubtful.append(name)
        elif worst != "data":
            verdicts[name] = worst
    return {"not_from_data": verdicts, "doubtful": doubtful}
