"""A fitted arm: a run directory for each joint, and one table of them all."""

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
from bayesfric.arm.arm_options import NUMBERS
from bayesfric.arm.base_parameters import base_parameters
from bayesfric.arm.inertial_prior import Bodies, InertialPrior, UrdfJoint
from bayesfric.arm.joint_consistency import (
    UNLIKELY,
    JointConsistency,
    JointFit,
    combine_joints,
    conditional_draws,
    conditional_posterior,
    updated_rows,
)
from bayesfric.base import __version__
from bayesfric.base.atomic_write import write_files
from bayesfric.fit.model import Result
from bayesfric.inference.predictive import predict_held_out
from bayesfric.recordings.arrays import Array
from bayesfric.report.numbers import TEXT, p_text
from bayesfric.report.page.rendering import render
from bayesfric.report.summary.parts import validation_record
from bayesfric.report.summary.record import PosteriorRow, Validation
from bayesfric.report.terminal import printed_row
from bayesfric.report.words import listed

# Columns of the table, and the parameters of each, of which a joint has one.
COLUMNS = {number.title: number.parameters for number in NUMBERS.values() if number.title}
# Draws kept of a joint whose pages are not made; lines of the table and its messages.
_DRAWS, _LINES = 300, 28
_DEVIATIONS = 3  # that a message lists


@dataclass(frozen=True, eq=False)
class FittedJoint:
    """A joint of the URDF: its fit, or why there is none, and remarks on its data."""

    joint: UrdfJoint
    gear_ratio: float | None
    result: Result | None = None
    failure: str = ""
    remarks: tuple[str, ...] = ()
    # torque_rms of the bodies on this motion, N m or N, and doubt_rms, the prior sd of that
    urdf: Mapping[str, float] = field(default_factory=dict)
    # by all joints: numbers, predictions of held-out logs, and the p-value under the other joints
    rows: Mapping[str, PosteriorRow] = field(default_factory=dict)
    validation: Validation | None = None
    p_value: float = 1.0
    agrees: bool = True

    @property
    def folder(self) -> str:
        """Name of its run directory."""
        return re.sub(r"[^\w.-]|^[.]", "_", self.joint.name)

    @property
    def cells(self) -> dict[str, PosteriorRow | None]:
        """The row of each column of the table."""
        return {
            column: next((self.rows[name] for name in names if name in self.rows), None)
            for column, names in COLUMNS.items()
        }

    def number_rows(self, key: str) -> list[PosteriorRow]:
        """List the rows of one of :data:`NUMBERS`: none, one, or one for each direction."""
        return [self.rows[name] for name in NUMBERS[key].parameters if name in self.rows]

    @property
    def numbers(self) -> dict[str, float]:
        """Reported numbers by key, SI, referred to the joint."""
        rows = {key: self.number_rows(key) for key in NUMBERS}
        return {key: float(np.mean([row.value for row in x])) for key, x in rows.items() if x}

    @property
    def messages(self) -> Iterator[str]:
        """Messages below the table, a line each."""
        if self.result is None:
            yield f"not fitted: {self.failure}"
        yield from self.remarks
        if not self.agrees:
            p = p_text(self.p_value)
            yield f"excluded: contradicts the others about inertial parameters ({p})"
        if self.result is not None:
            summary = self.result.summary
            for word, terms in (("added", summary.taken), ("found", summary.findings)):
                if terms:
                    yield f"{word} {listed([term.kind for term in terms])}"
            for name, part in (self.validation.parts if self.validation else {}).items():
                coverage = f"90 % bands hold {part.coverage['0.9'].share:.0%}"
                rms = f"{part.residual_rms:.3g} {summary.fit.unit} rms"
                yield f"predicts {name} to {rms}; {coverage}"

    def as_json(self) -> dict[str, Any]:
        """Give its numbers."""
        checks: dict[str, Any] = {"remarks": [*self.remarks], "urdf": dict(self.urdf)}
        if self.result is None:
            return {"why": self.failure, **checks}
        summary, armature = self.result.summary, self.cells["armature"]
        if self.gear_ratio and armature:
            checks["rotor_inertia"] = armature.value / self.gear_ratio**2
        return {
            "folder": self.folder,
            "sampler": summary.sampler.status,
            "fit": summary.fit.model_dump(include={"residual_rms", "explained", "unit"}),
            "parameters": {
                name: {"unit": row.unit, **row.reported.model_dump()}
                for name, row in self.rows.items()
                if not name.startswith("noise.")
            },
            "added": [term.kind for term in summary.taken],
            "findings": [finding.kind for finding in summary.findings],
            "apart": self.p_value,
            "validation": self.validation and self.validation.model_dump(mode="json"),
            **checks,
        }


@dataclass(frozen=True, eq=False)
class FittedArm:
    """A fitted arm, its joints in the order of the URDF."""

    bodies: Bodies
    logs: tuple[ArmLog, ...]
    joints: Mapping[str, FittedJoint]
    prior: InertialPrior
    fits: Mapping[str, JointFit]
    consistency: JointConsistency

    @classmethod
    def combined(
        cls,
        bodies: Bodies,
        logs: Sequence[ArmLog],
        joints: Mapping[str, FittedJoint],
        prior: InertialPrior,
        directions: Mapping[str, Array],
        seed: int | None,
    ) -> FittedArm:
        """Combine the fits of joints by their ``directions``, and update their numbers."""
        rng, updated = np.random.default_rng(seed), dict(joints)
        fits = {
            name: JointFit(joint.result.fit, joint.result.summary.parameters, directions[name])
            for name, joint in joints.items()
            if joint.result
        }
        consistency = combine_joints(prior, fits, rng)
        for name, joint_fit in fits.items():
            joint, fit = joints[name], joint_fit.fit
            assert joint.result is not None
            rows, posterior, validation = joint_fit.rows, fit.posterior, None
            if name in consistency.agreed and joint_fit.adequate:
                posterior = conditional_posterior(joint_fit, consistency.draws, rng)
                rows = updated_rows(joint_fit, posterior)
            if held_out := joint.result.model.held_out:
                predictions = predict_held_out(fit.target, posterior, held_out)
                validation = validation_record(replace(fit, held_out=predictions))
            updated[name] = replace(
                joint,
                rows=rows,
                validation=validation,
                p_value=consistency.p_values[name],
                agrees=name in consistency.agreed,
            )
        return cls(bodies, (*logs,), updated, prior, fits, consistency)

    @property
    def urdf(self) -> Path:
        """The URDF."""
        return self.bodies.path

    @property
    def visited(self) -> Array:
        """Lowest and highest positions in the logs, ``(n_joints, 2)`` rad or m."""
        q = np.concatenate([log.motion[0] for log in self.logs], axis=1)
        return np.stack([q.min(axis=1), q.max(axis=1)], axis=1)

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Array, dict[str, Array]]:
        """Draw inertial parameters and joints together, without model discrepancy.

        Returns deviations ``(count, n_deviations)``, zero where no joint agrees, and by joint
        parameters ``(count, n_parameters)`` in the order of its fit's chain.
        """
        consistency, values = self.consistency, {}
        urdf = np.zeros((1, len(self.prior.deviations)))
        z = rng.choice(consistency.draws if consistency.agreed else urdf, count)
        for name, joint_fit in self.fits.items():
            draws = rng.choice(joint_fit.fit.posterior.flat(), count)
            if name in consistency.agreed:  # draws outside their bounds stay as they were
                conditional = conditional_draws(joint_fit, z, rng)
                inside = np.isfinite(conditional).all(axis=1, keepdims=True)
                draws = np.where(inside, conditional, draws)
            values[name] = joint_fit.fit.target.chain_values(draws)
        return z, values

    @cached_property
    def inertial_estimate(self) -> dict[str, Any]:
        """Inertial parameters by the joints that agree, with keys as in ``arm.json``."""
        consistency = self.consistency
        return {
            "p": consistency.p,
            "agreed": [*consistency.agreed],
            "physical": consistency.physical,
            "width": consistency.width,
            "causes": consistency.deviations(self.prior),
            "base_parameters": base_parameters(self.bodies, self.prior, consistency.draws),
        }

    @property
    def samples(self) -> tuple[int, int]:
        """Number of fitted samples, and of all samples."""
        return sum(log.fitted for log in self.logs), sum(log.rows for log in self.logs)

    @property
    def messages(self) -> list[str]:
        """Messages below the table, a line each."""
        lines = [f"{name}: {line}" for name, x in self.joints.items() for line in x.messages]
        fitted, rows = self.samples
        if fitted < rows:
            lines.insert(0, f"{fitted} of {rows} samples were fitted, in segments all over them")
        estimate = self.inertial_estimate
        significant = [
            f"{row['name']} {row['value']:+.2g} ± {row['sd']:.2g} {row['unit']}".rstrip()
            for row in estimate["causes"][:_DEVIATIONS]
            if abs(row["value"]) > 2.0 * row["sd"]
        ]
        if not estimate["agreed"] or not significant:
            return lines
        verdict = "differ from the URDF"
        if estimate["p"] < UNLIKELY:
            verdict = f"contradict the URDF, by {estimate['width']:.2g} times its uncertainty"
        return [f"bodies {verdict} ({p_text(estimate['p'])}): {listed(significant)}", *lines]

    @property
    def reliable(self) -> bool:
        """Whether every sampling has converged."""
        results = (joint.result for joint in self.joints.values() if joint.result)
        return all(result.summary.sampler.status == "reliable" for result in results)

    def as_json(self) -> dict[str, Any]:
        """Give the content of ``arm.json``."""
        base = [asdict(parameter) for parameter in self.inertial_estimate["base_parameters"]]
        return {
            "bayesfric": __version__,
            "urdf": str(self.urdf),
            "logs": [str(log.path) for log in self.logs],
            "samples": dict(zip(("fitted", "of"), self.samples, strict=True)),
            "bodies": {**self.inertial_estimate, "base_parameters": base},
            "joints": {name: joint.as_json() for name, joint in self.joints.items()},
        }

    def text(self) -> list[str]:
        """Lay out the table for a terminal, with the messages below it."""
        rows: list[tuple[str, ...]] = [("", *COLUMNS)]
        for name, joint in self.joints.items():
            if joint.result is not None:
                cells = [_cell(row) for row in joint.cells.values()]
                rows += [(name, *(c[0] for c in cells)), ("", *(c[1] for c in cells))]
        widths = [2 + max(map(len, column)) for column in zip(*rows, strict=True)]
        table = ["".join(c.ljust(w) for c, w in zip(r, widths, strict=True)) for r in rows]
        messages = self.messages
        limit = max(_LINES - len(table), 1)
        if len(messages) > limit:
            hidden = len(messages) - limit + 1
            messages = [*messages[: limit - 1], f"and {hidden} lines more in arm.html"]
        return [line.rstrip() for line in (*table, *messages)]

    def write(self, folder: Path | str, *, full: bool = False) -> Path:
        """Write run directories, ``arm.json`` and the page ``arm.html``, whose path is returned.

        Parameters
        ----------
        folder
            Where to write; each joint has a run directory in it.
        full
            Whether each joint has its figures, tables and page, too.
        """
        folder = Path(folder)
        for joint in self.joints.values():
            if joint.result is not None:
                joint.result.write(folder / joint.folder, draws=None if full else _DRAWS)
        record = json.dumps(self.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
        page = render(
            "arm.html.j2", title=folder.name, arm=self, columns=COLUMNS, cell=_cell, full=full,
            version=__version__,
        )  # fmt: skip
        files = {"arm.json": f"{record}\n", "arm.html": page}
        write_files({folder / name: text for name, text in files.items()}, replace=True)
        return folder / "arm.html"


def _cell(row: PosteriorRow | None) -> tuple[str, str]:
    """Format a number with its status, and its interval with the unit."""
    if row is None:
        return TEXT.none, ""
    printed = printed_row("", row.reported, row.unit, row.level)
    value, interval = (printed.value, printed.status), (printed.interval, printed.unit)
    return " ".join(value).strip(), " ".join(interval).strip()
