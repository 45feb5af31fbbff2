"""What came of an arm: a folder a joint, and one table of them all."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.arm.arm_log import ArmLog
from bayesfric.arm.base_parameters import base_parameters
from bayesfric.arm.inertial_prior import Bodies, Doubt, UrdfJoint
from bayesfric.arm.joint_numbers import NUMBERS
from bayesfric.arm.joint_consistency import UNLIKELY, Felt, Together, beside, moved, retold, together
from bayesfric.base import __version__
from bayesfric.base.atomic_write import write_files
from bayesfric.fit.result import Result
from bayesfric.inference.predictive import predict_held_out
from bayesfric.recordings.arrays import Array
from bayesfric.report.numbers import TEXT, p_text
from bayesfric.report.page.rendering import render
from bayesfric.report.summary.record import Validation
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.summary.validation_part import validation_record
from bayesfric.report.terminal import line_of_number
from bayesfric.report.words import listed

# Columns of the table, and which parameter is in them: the first that the joint has.
COLUMNS = {one.title: one.parameters for one in NUMBERS.values() if one.title}
# Draws kept of a joint whose pages are not made, and lines of the table with what is said.
_DRAWS, _LINES = 300, 28
_MOST_CAUSES = 3  # that a line tells of bodies


@dataclass(frozen=True, eq=False)
class FittedJoint:
    """A joint of the URDF: its fit, or why there is none, and what looks wrong."""

    joint: UrdfJoint
    gear_ratio: float | None
    result: Result | None = None
    why: str = ""
    remarks: tuple[str, ...] = ()
    # torque_rms of the bodies on this motion, N m or N, and doubt_rms of what that may be off by
    urdf: Mapping[str, float] = field(default_factory=dict)
    # by all joints: numbers, and how well what was not fitted is predicted; chance of data as far
    # from what the others say of the bodies, and whether it agrees with them
    rows: Mapping[str, PosteriorRow] = field(default_factory=dict)
    validation: Validation | None = None
    apart: float = 1.0
    agrees: bool = True

    @property
    def folder(self) -> str:
        """Name of its run directory."""
        return re.sub(r"[^\w.-]|^[.]", "_", self.joint.name)

    @property
    def cells(self) -> dict[str, PosteriorRow | None]:
        """What stands in each column of the table."""
        return {
            column: next((self.rows[name] for name in names if name in self.rows), None)
            for column, names in COLUMNS.items()
        }

    @property
    def lines(self) -> Iterator[str]:
        """What is to be said besides the table, a line each."""
        if self.result is None:
            yield f"not fitted: {self.why}"
        yield from self.remarks
        if not self.agrees:
            yield f"stands for itself: contradicts the others about bodies ({p_text(self.apart)})"
        if self.result is not None:
            summary = self.result.summary
            for word, found in (("added", summary.taken), ("found", summary.findings)):
                if found:
                    yield f"{word} {listed([one.kind for one in found])}"
            for name, part in (self.validation.parts if self.validation else {}).items():
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
        return {
            "folder": self.folder,
            "sampler": summary.sampler.status,
            "fit": summary.fit.model_dump(include={"residual_rms", "explained", "unit"}),
            "parameters": {
                name: {"unit": row.unit, **row.reported.model_dump(exclude={"how"})}
                for name, row in self.rows.items()
                if row.reported and not name.startswith("noise.")
            },
            "added": [one.kind for one in summary.taken],
            "findings": [one.kind for one in summary.findings],
            "apart": self.apart,
            "validation": self.validation and self.validation.model_dump(mode="json"),
            **told,
        }


@dataclass(frozen=True, eq=False)
class FittedArm:
    """What came of an arm, by joint in the order of the URDF."""

    bodies: Bodies
    logs: tuple[ArmLog, ...]
    joints: Mapping[str, FittedJoint]
    doubt: Doubt
    felt: Mapping[str, Felt]
    together: Together

    @classmethod
    def joined(
        cls,
        bodies: Bodies,
        logs: Sequence[ArmLog],
        joints: Mapping[str, FittedJoint],
        doubt: Doubt,
        kept: Mapping[str, Array],
        seed: int | None,
    ) -> FittedArm:
        """Join what fits say of the bodies by ``kept`` directions, and put it into joints."""
        rng, told = np.random.default_rng(seed), dict(joints)
        fits = {
            name: Felt(one.result.fit, one.result.summary.parameters, kept[name])
            for name, one in joints.items()
            if one.result
        }
        found = together(doubt, fits, rng)
        for name, own in fits.items():
            one, fit = joints[name], own.fit
            assert one.result is not None
            rows, posterior, checked = own.rows, fit.posterior, None
            if name in found.agreed and own.sound:
                posterior = moved(own, found.draws, rng)
                rows = retold(own, posterior)
            if held_out := one.result.model.held_out:
                predictions = predict_held_out(fit.target, posterior, held_out)
                record = validation_record(replace(fit, held_out=predictions))
                checked = Validation.model_validate(record)
            told[name] = replace(
                one,
                rows=rows,
                validation=checked,
                apart=found.apart[name],
                agrees=name in found.agreed,
            )
        return cls(bodies, (*logs,), told, doubt, fits, found)

    @property
    def urdf(self) -> Path:
        """The URDF."""
        return self.bodies.path

    @property
    def visited(self) -> Array:
        """Lowest and highest positions in the logs, ``(n_joints, 2)`` rad or m."""
        q = np.concatenate([log.motion[0] for log in self.logs], axis=1)
        return np.stack([q.min(axis=1), q.max(axis=1)], axis=1)

    def drawn(self, count: int, rng: np.random.Generator) -> tuple[Array, dict[str, Array]]:
        """Draw bodies and joints together, without room for what a model lacks.

        Returns
        -------
        bodies : ndarray
            ``(count, n_causes)``, as the URDF where no joint says anything of them.
        joints : dict of ndarray
            By joint parameters ``(count, n_parameters)``, in the order of its fit's chain.
        """
        found, values = self.together, {}
        urdf = np.zeros((1, len(self.doubt.inside)))
        z = rng.choice(found.draws if found.agreed else urdf, count)
        for name, one in self.felt.items():
            drawn = rng.choice(one.fit.posterior.flat(), count)
            if name in found.agreed:  # what bounds cut of it stays where it was
                along = beside(one, z, rng)
                drawn = np.where(np.isfinite(along).all(axis=1, keepdims=True), along, drawn)
            values[name] = one.fit.target.chain_values(drawn)
        return z, values

    @cached_property
    def found(self) -> dict[str, Any]:
        """What joints that agree say of the bodies.

        ``p`` of data as far from the URDF, ``causes`` of that and ``base_parameters``.
        """
        found = self.together
        return {
            "p": found.p,
            "agreed": [*found.agreed],
            "physical": found.physical,
            "width": found.width,
            "causes": found.causes(self.doubt),
            "base_parameters": base_parameters(self.bodies, self.doubt, found.draws),
        }

    @property
    def samples(self) -> tuple[int, int]:
        """How many of all logs were fitted, and how many there are."""
        return sum(log.fitted for log in self.logs), sum(log.rows for log in self.logs)

    @property
    def said(self) -> list[str]:
        """What is to be said besides the table, a line each."""
        lines = [f"{name}: {line}" for name, one in self.joints.items() for line in one.lines]
        fitted, rows = self.samples
        if fitted < rows:
            lines.insert(0, f"{fitted} of {rows} samples were fitted, in stretches all over them")
        told = self.found
        if not told["agreed"]:
            return lines
        far = [
            f"{c['name']} {c['value']:+.2g} ± {c['sd']:.2g} {c['unit']}".rstrip()
            for c in told["causes"][:_MOST_CAUSES]
            if abs(c["value"]) > 2.0 * c["sd"]
        ]
        word = "beside the URDF"
        if told["p"] < UNLIKELY:
            far_off = f"{told['width']:.2g} times as far as it was said to be off"
            word = f"contradict the URDF, {far_off}"
        return [*([f"bodies {word} ({p_text(told['p'])}): {listed(far)}"] if far else []), *lines]

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
            "logs": [str(log.path) for log in self.logs],
            "samples": dict(zip(("fitted", "of"), self.samples, strict=True)),
            "bodies": {
                **self.found,
                "base_parameters": [asdict(one) for one in self.found["base_parameters"]],
            },
            "joints": {name: one.as_json() for name, one in self.joints.items()},
        }

    def text(self) -> list[str]:
        """Lay the table out for a terminal, with what is to be said of the joints below it."""
        rows: list[tuple[str, ...]] = [("", *COLUMNS)]
        for name, one in self.joints.items():
            if one.result is not None:
                cells = [_cell(row) for row in one.cells.values()]
                rows += [(name, *(c[0] for c in cells)), ("", *(c[1] for c in cells))]
        wide = [2 + max(map(len, column)) for column in zip(*rows, strict=True)]
        table = ["".join(c.ljust(w) for c, w in zip(r, wide, strict=True)) for r in rows]
        said = self.said
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
        files = {"arm.json": f"{told}\n", "arm.html": page}
        write_files({folder / name: text for name, text in files.items()}, replace=True)
        return folder / "arm.html"


def _cell(row: PosteriorRow | None) -> tuple[str, str]:
    """Write a number with its status, and its interval with the unit."""
    if row is None or row.reported is None:
        return TEXT.none, ""
    told = line_of_number("", row.reported, row.unit, row.level)
    return f"{told.value} {told.beside}".strip(), f"{told.interval} {told.unit}".strip()
