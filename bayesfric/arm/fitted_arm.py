"""What came of an arm: a folder a joint, and one table of them all."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayesfric.arm.bodies import UrdfJoint
from bayesfric.base.version import __version__
from bayesfric.base.written import write_beside
from bayesfric.fit.result import Result
from bayesfric.report.numbers import TEXT, finer, p_text, text_rounded
from bayesfric.report.page.rendering import render
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.words import listed

# Columns of the table, and which parameter is in them: the first that the joint has.
COLUMNS: Mapping[str, tuple[str, ...]] = {
    "armature": ("motor.inertia",),
    "Coulomb": ("motor.coulomb", "motor.coulomb_positive"),
    "viscous": ("motor.viscous", "motor.viscous_positive"),
    "load loss": ("motor.load", "motor.load_drive"),
}
# Draws kept of a joint whose pages are not made; lines of the table, and letters of a column.
_DRAWS, _LINES, _WIDTH = 300, 28, 22
# A p-value below which bodies of the URDF are said to be otherwise.
_UNLIKELY = 0.01


@dataclass(frozen=True, eq=False)
class FittedJoint:
    """A joint of the URDF: its fit, or why there is none, and what looks wrong."""

    joint: UrdfJoint
    gear_ratio: float | None
    result: Result | None = None
    why: str = ""
    remarks: tuple[str, ...] = ()
    # torque_rms of the bodies on this motion, N m or N, and doubt_rms of what that may be off by;
    # p of bodies as far off as these data say, were the doubt right; and causes of that, each with
    # name, value, sd, prior_sd and unit, those the farthest off first
    urdf: Mapping[str, Any] = field(default_factory=dict)

    @property
    def folder(self) -> str:
        """Name of its run directory."""
        return re.sub(r"[^\w.-]|^[.]", "_", self.joint.name)

    @property
    def cells(self) -> dict[str, PosteriorRow | None]:
        """What stands in each column of the table."""
        rows = {} if self.result is None else self.result.summary.parameters
        return {
            column: next((rows[name] for name in names if name in rows), None)
            for column, names in COLUMNS.items()
        }

    @property
    def lines(self) -> Iterator[str]:
        """What is to be said besides the table, a line each."""
        if self.result is None:
            yield f"not fitted: {self.why}"
        yield from self.remarks
        if self.urdf.get("p", 1.0) < _UNLIKELY:
            far = [
                f"{c['name']} {c['value']:+.2g} ± {c['sd']:.2g} {c['unit']}".rstrip()
                for c in self.urdf["causes"][:2]
            ]
            yield f"contradicts the URDF ({p_text(self.urdf['p'])}): {listed(far)}"
        if self.result is not None:
            summary = self.result.summary
            for word, found in (("added", summary.taken), ("found", summary.findings)):
                if found:
                    yield f"{word} {listed([one.kind for one in found])}"
            for name, part in (summary.validation.parts if summary.validation else {}).items():
                held = f"90 % bands hold {part.coverage['0.9'].share:.0%}"
                yield f"predicts {name} to {part.residual_rms:.3g} {summary.fit.unit} rms; {held}"

    def as_json(self) -> dict[str, Any]:
        """Give its numbers."""
        told: dict[str, Any] = {"remarks": [*self.remarks], "urdf": dict(self.urdf)}
        if self.result is None:
            return {"why": self.why, **told}
        summary, armature = self.result.summary, self.cells["armature"]
        if self.gear_ratio and armature:
            told["rotor_inertia"] = armature.value / self.gear_ratio**2
        rows = {name: row for name, row in summary.parameters.items() if row.reported}
        return {
            "folder": self.folder,
            "sampler": summary.sampler.status,
            "fit": summary.fit.model_dump(include={"residual_rms", "explained", "unit"}),
            "parameters": {
                name: {"unit": row.unit, **row.reported.model_dump(exclude={"how"})}
                for name, row in rows.items()
                if row.reported and not name.startswith("noise.")
            },
            "added": [one.kind for one in summary.taken],
            "findings": [one.kind for one in summary.findings],
            "validation": summary.validation and summary.validation.model_dump(mode="json"),
            **told,
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
        margin = max(map(len, self.joints)) + 2
        rows: list[tuple[str, ...]] = [("", *COLUMNS)]
        for name, one in self.joints.items():
            if one.result is not None:
                cells = [_cell(row) for row in one.cells.values()]
                rows += [(name, *(c[0] for c in cells)), ("", *(c[1] for c in cells))]
        table = [r[0].ljust(margin) + "".join(c.ljust(_WIDTH) for c in r[1:]) for r in rows]
        said = [f"{name}: {line}" for name, one in self.joints.items() for line in one.lines]
        room = max(_LINES - len(table), 1)
        if len(said) > room:
            said = [*said[: room - 1], f"and {len(said) - room + 1} lines more in arm.html"]
        return [line.rstrip() for line in (*table, *said)]

    def write(self, folder: Path | str, *, full: bool = False) -> Path:
        """Write a run directory a joint, ``arm.json`` and the page ``arm.html``, which is returned.

        With ``full`` each joint has its figures, tables and page, too.
        """
        folder = Path(folder)
        for one in self.joints.values():
            if one.result is not None:
                one.result.write(folder / one.folder, draws=None if full else _DRAWS)
        told = json.dumps(self.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
        page = render(
            "arm.html.j2", title=folder.name, arm=self, columns=COLUMNS, cell=_cell, full=full,
            version=__version__,
        )  # fmt: skip
        write_beside({folder / "arm.json": f"{told}\n", folder / "arm.html": page}, replace=True)
        return folder / "arm.html"


def _cell(row: PosteriorRow | None) -> tuple[str, str]:
    """Write a number with its status, and its interval with the unit."""
    if row is None or row.reported is None:
        return TEXT.none, ""
    told, (low, high) = row.reported, row.reported.interval
    width = finer(told.value, low, high, told.sd) or None
    ends = TEXT.interval(low, high, width) if width else ""
    return f"{text_rounded(told.value, width)} {told.status}", f"{ends} {row.unit}".strip()
