"""What came of an arm: a folder a joint, and one table of them all."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.arm.bodies import UrdfJoint
from bayesfric.base.version import __version__
from bayesfric.base.written import write_beside
from bayesfric.fit.result import Result
from bayesfric.inference.predictive import predict_held_out
from bayesfric.report.numbers import TEXT, finer, p_text, text_rounded
from bayesfric.report.page.rendering import render
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.words import listed

# Names of the page and of the numbers.
PAGE, NUMBERS = "arm.html", "arm.json"
# Columns of the table, and which parameter is in them: the first that the joint has.
COLUMNS: Mapping[str, tuple[str, ...]] = {
    "armature": ("motor.inertia",),
    "Coulomb": ("motor.coulomb", "motor.coulomb_positive"),
    "viscous": ("motor.viscous", "motor.viscous_positive"),
    "load loss": ("motor.load", "motor.load_drive"),
}
# Draws kept of a joint whose pages are not made.
_DRAWS = 300
_LINES, _WIDTH, _MOST_CAUSES = 30, 18, 5
# A p-value below which bodies of the URDF are said to be otherwise.
_UNLIKELY = 0.01


@dataclass(frozen=True)
class Cause:
    """How far off something of the URDF is by one joint's torque, with its unit."""

    name: str
    value: float
    sd: float
    prior_sd: float
    unit: str

    def __str__(self) -> str:
        """Word it."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.name} {self.value:+.2g} ± {self.sd:.2g}{unit}"


@dataclass(frozen=True, eq=False)
class FittedJoint:
    """A joint of the URDF: its fit, or why there is none, and what looks wrong."""

    joint: UrdfJoint
    gear_ratio: float | None = None
    result: Result | None = None
    why: str = ""
    remarks: tuple[str, ...] = ()
    urdf_rms: float | None = None  # N m or N, of the bodies' torque on this motion
    doubt_rms: float | None = None  # of what that may be off by
    urdf_p: float | None = None  # of bodies as far off as these data say, were the doubt right
    causes: tuple[Cause, ...] = ()  # the farthest off first, in sds of the prior

    @property
    def folder(self) -> str:
        """Name of its run directory."""
        return re.sub(r"[^\w.-]|^[.]", "_", self.joint.name)

    @property
    def cells(self) -> dict[str, PosteriorRow | None]:
        """What stands in each column of the table."""
        rows = {} if self.result is None else self.result.summary.rows
        found = {}
        for column, names in COLUMNS.items():
            row = next((rows[name] for name in names if name in rows), None)
            found[column] = None if row is None or row.reported is None else row
        return found

    @property
    def lines(self) -> Iterator[str]:
        """What is to be said besides the table, a line each."""
        if self.result is None:
            yield f"not fitted: {self.why}"
        yield from self.remarks
        if self.urdf_p is not None and self.urdf_p < _UNLIKELY:
            causes = listed([*map(str, self.causes[:2])])
            yield f"contradicts the URDF ({p_text(self.urdf_p)}): {causes}"
        if self.result is None:
            return
        summary = self.result.summary
        if summary.taken:
            yield f"added {listed([one.kind for one in summary.taken])}"
        if summary.findings:
            yield f"found {listed([one.kind for one in summary.findings])}"
        for name, one in self.predicted.items():
            what = f"predicts {name} to {one['rms']:.3g} {summary.fit.unit} rms"
            yield f"{what}; 90 % bands hold {one['coverage']:.0%}"

    @cached_property
    def predicted(self) -> dict[str, dict[str, float]]:
        """How well the torque of other motions is predicted, by log.

        ``rms`` of what is left, N m or N, ``sd`` of the prediction, and the ``coverage`` of 90 %
        bands; these have room for the model's error, as all numbers that are reported.
        """
        found = {}
        if self.result is not None and self.result.model.held_out:
            wide = self.result.fit.wide
            held_out = self.result.model.held_out
            for one in predict_held_out(wide.target, wide.posterior, held_out):
                found[one.held_out.name] = {
                    "rms": float(np.sqrt(np.mean((one.measured - one.mean) ** 2))),
                    "sd": float(np.sqrt(np.mean(one.variance))),
                    "coverage": float(np.mean(np.abs(one.pit - 0.5) <= 0.45)),
                }
        return found

    def as_json(self) -> dict[str, Any]:
        """Give its numbers."""
        told: dict[str, Any] = {"motion": self.joint.motion, "remarks": [*self.remarks]}
        if self.urdf_rms is not None:
            told["urdf"] = {
                "torque_rms": self.urdf_rms,
                "doubt_rms": self.doubt_rms,
                "p": self.urdf_p,
                "causes": [vars(one) for one in self.causes[:_MOST_CAUSES]],
            }
        if self.result is None:
            return {**told, "why": self.why}
        summary = self.result.summary
        ratio = self.gear_ratio
        armature = self.cells["armature"]
        if ratio and armature:
            told["rotor_inertia"] = armature.value / ratio**2
        return {
            **told,
            "folder": self.folder,
            "sampler": summary.sampler.status,
            "residual_rms": summary.fit.residual_rms,
            "unit": summary.fit.unit,
            "explained": summary.fit.explained,
            "parameters": {
                name: {"unit": row.unit, **row.reported.model_dump(exclude={"how"})}
                for name, row in summary.rows.items()
                if row.reported is not None and not name.startswith("noise.")
            },
            "added": [one.kind for one in summary.taken],
            "findings": [one.kind for one in summary.findings],
            "predicted": self.predicted,
        }


@dataclass(frozen=True, eq=False)
class FittedArm:
    """What came of an arm, by joint in the order of the URDF."""

    urdf: Path
    logs: tuple[Path, ...]
    joints: Mapping[str, FittedJoint]

    @property
    def reliable(self) -> bool:
        """Whether every sampling has converged."""
        results = (one.result for one in self.joints.values() if one.result)
        return all(one.summary.sampler.status == "reliable" for one in results)

    def as_json(self) -> dict[str, Any]:
        """Give what ``arm.json`` holds."""
        return {
            "bayesfric": __version__,
            "urdf": str(self.urdf),
            "logs": [*map(str, self.logs)],
            "joints": {name: one.as_json() for name, one in self.joints.items()},
        }

    def text(self) -> list[str]:
        """Lay the table out for a terminal, with what is to be said of the joints below it."""
        wide = max(map(len, self.joints)) + 2
        units: dict[str, str] = {}
        table = []
        for name, one in self.joints.items():
            if one.result is None:
                continue
            values, intervals = [], []
            for column, row in one.cells.items():
                value, interval = _cell(row)
                if row is not None and row.unit != units.setdefault(column, row.unit):
                    interval += f" {row.unit}"
                values.append(value.ljust(_WIDTH))
                intervals.append(interval.ljust(_WIDTH))
            table += [name.ljust(wide) + "".join(values), " " * wide + "".join(intervals)]
        heads = [f"{c}{f', {units[c]}' if units.get(c) else ''}".ljust(_WIDTH) for c in COLUMNS]
        said = [f"{name}: {line}" for name, one in self.joints.items() for line in one.lines]
        room = max(_LINES - len(table) - 3, 1)
        if len(said) > room:
            said = [*said[: room - 1], f"{len(said) - room + 1} lines more are in {PAGE}"]
        return [line.rstrip() for line in (" " * wide + "".join(heads), *table, *said)]

    def write(self, folder: Path | str, *, full: bool = False) -> Path:
        """Write a run directory a joint, the numbers of all and the page.

        Parameters
        ----------
        folder
            To make.
        full
            Make each joint's figures, tables and page, too.

        Returns
        -------
        Path
            The page.
        """
        folder = Path(folder)
        for one in self.joints.values():
            if one.result is not None:
                one.result.write(folder / one.folder, draws=None if full else _DRAWS)
        told = json.dumps(self.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
        page = render(
            "arm.html.j2",
            title=folder.name,
            arm=self,
            columns=COLUMNS,
            cell=_cell,
            links={name: _link(folder, one.folder) for name, one in self.joints.items()},
            version=__version__,
        )
        write_beside({folder / NUMBERS: f"{told}\n", folder / PAGE: page}, replace=True)
        return folder / PAGE


def _cell(row: PosteriorRow | None) -> tuple[str, str]:
    """Write a number with its status, and its interval."""
    if row is None or row.reported is None:
        return TEXT.none, ""
    told, (low, high) = row.reported, row.reported.interval
    width = finer(told.value, low, high, told.sd)
    if not width:
        return f"{told.value:.4g} {told.status}", ""
    return f"{text_rounded(told.value, width)} {told.status}", TEXT.interval(low, high, width)


def _link(folder: Path, joint: str) -> str:
    page = Path(joint, "report.html")
    return (page if (folder / page).is_file() else Path(joint)).as_posix()
