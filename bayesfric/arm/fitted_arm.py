"""A fitted arm: a run directory for each joint, and one table of them all.

A joint's own numbers follow the inertial parameters of all joints by linear regression on the draws
of its fit. A joint with model discrepancy contributes the likelihood of its widened draws, but its
numbers stay: a discrepancy may have many causes and does not follow the inertial parameters.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from bayesfric.arm.arm_closed_loop import Timing
from bayesfric.arm.arm_log import ArmLog, signals
from bayesfric.arm.arm_options import NUMBERS, Repeatability, torque_columns
from bayesfric.arm.departures import ArmDelay, Departures
from bayesfric.arm.inertial_prior import Bodies, InertialPrior, UrdfJoint, base_parameters
from bayesfric.arm.joint_consistency import (
    UNLIKELY,
    InertialLikelihood,
    JointConsistency,
    combine_joints,
)
from bayesfric.base import __version__
from bayesfric.base.atomic_write import write_files
from bayesfric.fit.model import Result
from bayesfric.identifiability.local import WIDE
from bayesfric.inference.posterior import Posterior, Prediction, predict_held_out
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.arrays import Array, rms
from bayesfric.report.numbers import TEXT, p_text
from bayesfric.report.page.pages import render
from bayesfric.report.summary.derived_quantities import leaning, spread
from bayesfric.report.summary.parts import validation_record
from bayesfric.report.summary.record import PosteriorRow
from bayesfric.report.terminal import FINDINGS, aligned, messages_of, printed_row, wrapped
from bayesfric.report.words import filled

COLUMNS = [number.title for number in NUMBERS.values() if number.title]  # of the table
# Draws by which a joint's numbers follow the others.
_DRAWS = 4000
# Draws of predictions.
_PREDICTED = 400


@dataclass(frozen=True, eq=False)
class FittedJoint:
    """A joint of the URDF: its fit, or why there is none, and remarks on its data."""

    joint: UrdfJoint
    gear_ratio: float | None
    directions: Array  # (n_deviations, k) of the inertial prior, the signals of its load
    result: Result | None = None
    failure: str = ""
    remarks: tuple[str, ...] = ()
    is_coupled: bool = False  # by its data, while no option says so
    repeatability: Repeatability = field(default_factory=Repeatability)
    is_loaded: bool = True  # whether the log resolves its rigid-body torque
    # torque_rms of the bodies on this motion, N m or N, and doubt_rms, the prior sd of that
    urdf: Mapping[str, float] = field(default_factory=dict)
    # by all joints: numbers, predictions of held-out logs, and the p-value under the other joints
    rows: Mapping[str, PosteriorRow] = field(default_factory=dict)
    validation: dict[str, Any] | None = None
    p_value: float = 1.0
    agrees: bool = True

    @property
    def fitted(self) -> Result:
        """The result of a joint that is fitted."""
        assert self.result is not None
        return self.result

    @property
    def by_all(self) -> bool:
        """Whether its numbers follow the inertial parameters by all joints."""
        return self.agrees and self.fitted.fit.wide is self.fitted.fit

    @property
    def folder(self) -> str:
        """Name of its run directory."""
        return re.sub(r"[^\w.-]|^[.]", "_", self.joint.name)

    def number_rows(self, key: str) -> list[PosteriorRow]:
        """List the rows of one of :data:`NUMBERS`: none, one, or one for each direction."""
        return [self.rows[name] for name in NUMBERS[key].parameters if name in self.rows]

    @property
    def cells(self) -> dict[str, PosteriorRow | None]:
        """The row of each column of the table."""
        keys = {number.title: key for key, number in NUMBERS.items()}
        return {title: next(iter(self.number_rows(keys[title])), None) for title in COLUMNS}

    def numbers(self) -> dict[str, float]:
        """Return reported numbers by key, SI, referred to the joint."""
        rows = {key: [row.value for row in self.number_rows(key)] for key in NUMBERS}
        return {key: float(np.mean(values)) for key, values in rows.items() if values}

    def feedforward(self) -> tuple[dict[str, float], float, float]:
        """Compute its numbers at the posterior means, rms of what they leave of that law, and its.

        What the law has in addition to these numbers is fitted by them along the log.
        """
        fit, parts = self.fitted.fit, []
        keys = [key for key in NUMBERS if self.number_rows(key) and key != "gain"]
        gains = [row.mean for row in self.number_rows("gain")]
        gain = gains[0] if gains else 1.0
        means = np.array([[self.rows[name].mean for name in fit.target.free]])
        law_values = fit.target.chain_values(means)[0]
        law_values[[name == fit.chain.delay_name for name in fit.chain.names]] = 0.0
        losses = [name.startswith("motor.") or name == "offset" for name in fit.chain.names]
        values = np.stack([law_values, np.where(losses, 0.0, law_values)])
        for o in self.fitted.model.observations:
            motion = o.q, o.qd, o.qdd
            law, rigid = inverse_torque(fit.chain, values, *motion, inputs=o.inputs, time=o.stamps)
            columns = dict(zip(NUMBERS, torque_columns(gain * rigid, o.qd, o.qdd), strict=False))
            parts.append((law, rigid, *(columns[key] / gain for key in keys)))
        law, rigid, *by_key = np.concatenate(parts, axis=1)
        a = np.array(by_key).T
        numbers = np.array([np.mean([row.mean for row in self.number_rows(key)]) for key in keys])
        numbers += np.linalg.lstsq(a, law - rigid - a @ numbers)[0]
        left = rms(law - rigid - a @ numbers)
        known = dict(zip(keys, numbers.tolist(), strict=True))
        return known | dict.fromkeys(["gain"] * len(gains), gain), left, rms(law)

    def coefficients(self, flat: Array) -> Array:
        """Take the coefficients ``(n, k)`` of the directions, corrected as reported."""
        wide, columns = self.fitted.fit.wide.posterior, []
        for name in (f"load.{signal}" for signal in signals(self.directions.shape[1])):
            k, reported = wide.names.index(name), self.fitted.summary.parameters[name].reported
            columns.append(flat[:, k] + reported.value - np.median(wide[name]))
        return np.stack(columns, axis=1) if columns else np.zeros((len(flat), 0))

    @property
    def likelihood(self) -> InertialLikelihood:
        """What the fit says of the inertial parameters."""
        draws = self.coefficients(self.fitted.fit.wide.posterior.flat())
        return InertialLikelihood.from_draws(draws, self.directions)

    def draws(self, z: Array, rng: np.random.Generator) -> Array:
        """Draw parameters ``(n, d)`` given deviations ``(n, n_deviations)``.

        NaN where they would be outside their bounds.
        """
        target = self.fitted.fit.target
        flat = self.fitted.fit.posterior.flat(_DRAWS)
        v = target.unbounded(flat)
        finite = np.isfinite(v).all(axis=1)
        v, x = v[finite], self.coefficients(flat[finite])
        slopes = np.linalg.lstsq(x - x.mean(axis=0), v - v.mean(axis=0), rcond=None)[0]
        rows = rng.permutation(np.arange(len(z)) % len(v))
        draws = target.from_unbounded(v[rows] + (z @ self.directions - x[rows]) @ slopes)
        draws[~np.isfinite(draws).all(axis=1)] = np.nan
        return np.asarray(draws)

    def updated(self, consistency: JointConsistency, rng: np.random.Generator) -> FittedJoint:
        """Update numbers and predictions by all joints."""
        fit, model, name = self.fitted.fit, self.fitted.model, self.joint.name
        joint = replace(
            self,
            rows=self.fitted.summary.parameters,
            p_value=consistency.p_values[name],
            agrees=name in consistency.agreed,
        )
        posterior, z = fit.posterior, consistency.draws
        if joint.by_all:
            draws = self.draws(z[rng.integers(len(z), size=_DRAWS)], rng)
            draws = draws[np.isfinite(draws).all(axis=1)]
            posterior = posterior.with_draws(draws)
            joint = replace(joint, rows=self._updated_rows(posterior))
        if not model.held_out:
            return joint
        held_out = joint.predicted(posterior, rng)
        return replace(joint, validation=validation_record(replace(fit, held_out=held_out)))

    def predicted(self, posterior: Posterior, rng: np.random.Generator) -> tuple[Prediction, ...]:
        """Predict the held-out logs.

        About the mean of a posterior, bands have the model discrepancy, and allow friction and
        efforts to differ as far as ``repeatability`` says: those in equal parts by their gain and,
        as other poses change them, by a constant of their rms.
        """
        fit, held_out = self.fitted.fit, self.fitted.model.held_out
        wide = posterior if self.by_all else fit.wide.posterior
        draws = wide.flat(_PREDICTED).copy()
        quantiles = norm.ppf((np.arange(len(draws)) + 0.5) / len(draws))
        for key in ("coulomb", "viscous", "load"):
            change = 1.0 + self.repeatability.friction * rng.permutation(quantiles)
            at = [k for k, name in enumerate(wide.names) if name in NUMBERS[key].parameters]
            draws[:, at] *= np.maximum(change, 0.0)[:, None]
        predictions = []
        for centre, band in zip(
            predict_held_out(fit.target, posterior, held_out),
            predict_held_out(fit.target, wide.with_draws(draws), held_out),
            strict=True,
        ):
            n, size = len(band.torque), self.repeatability.effort / math.sqrt(2.0)
            gain, pose = (size * rng.permutation(quantiles)[:n, None] for _ in range(2))
            torque = band.torque * (1.0 + gain) + pose * rms(centre.mean)
            torque += centre.mean - torque.mean(axis=0)
            predictions.append(replace(band, torque=torque))
        return tuple(predictions)

    def _updated_rows(self, posterior: Posterior) -> dict[str, PosteriorRow]:
        """Change the reported numbers as the draws of the joint change."""
        fit, before, after, rows = self.fitted.fit, self.fitted.fit.posterior, posterior.flat(), {}
        priors = dict(zip(posterior.names, posterior.priors, strict=True))
        bounds = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
        for name, row in self.fitted.summary.parameters.items():
            if name not in bounds:
                rows[name] = row
                continue
            k, reported = posterior.names.index(name), row.reported
            was, now = spread(before[name].ravel()), spread(after[:, k])
            # corrections of the joint's own fit stay
            changes = np.subtract(now["interval"], was["interval"]).tolist()
            low, high = (
                max(end + change, bounds[name][0])
                for end, change in zip(reported.interval, changes, strict=True)
            )
            value = min(max(reported.value + now["median"] - was["median"], low), high)
            update = {"mean": now["mean"]}
            update |= leaning(after[:, k], priors[name].limits, bounds[name])
            sd = reported.sd * now["sd"] / was["sd"]
            if row.verdict == "weak" and sd < WIDE * (row.prior_sd or math.inf):
                update["verdict"] = "data"  # of all joints, and the URDF
            updated = row.model_copy(update=update)
            conclusion = updated.conclude(value, (low, high), sd)
            rows[name] = updated.model_copy(update={"reported": conclusion})
        return rows

    @property
    def messages(self) -> list[str]:
        """What to know of the joint before its numbers are used, the worst first."""
        if self.result is None:
            return [f"not fitted: {self.failure}", *self.remarks]
        lines = [*self.remarks]
        if not self.agrees:
            p = p_text(self.p_value)
            lines.append(f"excluded: contradicts the others about inertial parameters ({p})")
        if any(finding.kind == "gravity" for finding in self.result.summary.findings):
            lines.append(
                "gravity acts on it that no bodies explain: is its axis right in the URDF?"
            )
        lines += [f"added: {term.text}" for term in self.result.summary.taken]
        of_fit = (x for x in messages_of(self.result.summary) if x.kind != "held out")
        briefs = list(dict.fromkeys(message.brief for message in of_fit if message.brief))
        more = len(briefs) - FINDINGS
        return lines + briefs[:FINDINGS] + [f"further findings: {more}, in its report"] * (more > 0)

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
            "messages": self.messages,
            "apart": self.p_value,
            "validation": self.validation,
            **checks,
        }


@dataclass(frozen=True, eq=False)
class FittedArm:
    """A fitted arm, its joints in the order of the URDF."""

    bodies: Bodies
    logs: tuple[ArmLog, ...]
    joints: Mapping[str, FittedJoint]
    prior: InertialPrior
    consistency: JointConsistency
    departures: Departures
    assumed: str = ""  # about columns and units that the log does not name
    late: ArmDelay | None = None  # of the efforts; None where it is known
    timing: Timing | None = None  # of targets and readings, of joints without an effort

    def combined(self, rng: np.random.Generator) -> FittedArm:
        """Combine the fits of joints, and update their numbers."""
        joints = dict(self.joints)
        likelihoods = {name: joint.likelihood for name, joint in self.fitted.items()}
        consistency = combine_joints(self.prior, likelihoods, rng)
        for name, joint in self.fitted.items():
            joints[name] = joint.updated(consistency, rng)
        return replace(self, joints=joints, consistency=consistency)

    @property
    def urdf(self) -> Path:
        """The URDF."""
        return self.bodies.path

    @property
    def fitted(self) -> dict[str, FittedJoint]:
        """The joints that are fitted."""
        return {name: joint for name, joint in self.joints.items() if joint.result}

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
        for name, joint in self.fitted.items():
            fit = joint.fitted.fit
            draws = rng.choice(fit.posterior.flat(), count)
            # all move with the same bodies; draws outside their bounds stay as they were
            conditional = joint.draws(z, rng)
            inside = np.isfinite(conditional).all(axis=1, keepdims=True)
            draws = np.where(inside, conditional, draws)
            values[name] = fit.target.chain_values(draws)
        return z, values

    @cached_property
    def inertial_estimate(self) -> dict[str, Any]:
        """Inertial parameters by the joints that agree, with keys as in ``arm.json``.

        ``causes`` are the deviations, the surest first.
        """
        consistency = self.consistency
        return {
            "p": consistency.p,
            "agreed": [*consistency.agreed],
            "physical": consistency.physical,
            "width": float(np.max(self.prior.widths)),
            "factor": dict(zip(("value", "sd"), self.departures.bodies, strict=True)),
            "departures": [x._asdict() for x in self.departures.included],
            "alternatives": [x._asdict() for x in self.departures.alternatives],
            "causes": consistency.deviations(self.prior),
            "base_parameters": base_parameters(self.bodies, self.prior, consistency.draws),
        }

    @property
    def samples(self) -> dict[str, int]:
        """Number of fitted samples, and of all samples."""
        fitted, every = (sum(getattr(log, key) for log in self.logs) for key in ("fitted", "rows"))
        return {"fitted": fitted, "of": every}

    @property
    def messages(self) -> list[str]:
        """Messages below the table: bodies, predictions, and what each joint warns of."""
        of_joints: dict[str, list[str]] = {}
        for name, joint in self.joints.items():
            for text in joint.messages:
                of_joints.setdefault(text, []).append(name)
        return filled("arm.txt.j2", arm=self, unlikely=UNLIKELY, of_joints=of_joints).splitlines()

    @property
    def reliable(self) -> bool:
        """Whether no joint warns of its numbers, as one that contradicts the others does."""
        return all(
            x.agrees and not x.is_coupled and x.fitted.summary.sampler.status == "reliable"
            for x in self.fitted.values()
        )

    def as_json(self) -> dict[str, Any]:
        """Give the content of ``arm.json``."""
        return {
            "bayesfric": __version__,
            "urdf": str(self.urdf),
            "logs": [str(log.path) for log in self.logs],
            "assumed": self.assumed,
            "samples": self.samples,
            "delay": self.late and asdict(self.late),
            "timing": self.timing and asdict(self.timing),
            "bodies": self.inertial_estimate,
            "joints": {name: joint.as_json() for name, joint in self.joints.items()},
        }

    def text(self) -> list[str]:
        """Lay out the numbers as those of a fit are, with the messages below, for a terminal."""
        level = next(iter(self.fitted.values())).fitted.summary.level
        table: list[tuple[str, ...]]
        table = [("", "value", "sd", f"{100 * level:g} % interval", "", "status")]
        unidentified = list[str]()
        for name, joint in self.fitted.items():
            for title, row in joint.cells.items():
                unloaded = title == NUMBERS["load"].title and not joint.is_loaded
                if unloaded or (row is not None and row.reported.status == "unidentified"):
                    unidentified.append(f"{name} {title}")
                elif row is not None:
                    table.append(printed_row(f"{name} {title}", row.reported, row.unit, row.level))
        lines = ["Unidentified: " + ", ".join(unidentified)] if unidentified else []
        for line in self.messages:
            lines += wrapped(line, indent=2)
        assumed = wrapped(self.assumed, indent=2) if self.assumed else []
        return [*assumed, *aligned(table), *lines]

    def write(self, folder: Path | str, *, full: bool = False) -> Path:
        """Write run directories, ``arm.json`` and the page ``arm.html``, whose path is returned.

        Parameters
        ----------
        folder
            Where to write; each joint has a run directory in it.
        full
            Whether each joint has its figures, tables and page, too, and all draws, not 300.
        """
        folder = Path(folder)
        for joint in self.fitted.values():
            joint.fitted.write(folder / joint.folder, draws=None if full else 300)
        record = json.dumps(self.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
        columns = [x for x in COLUMNS if any(joint.cells[x] for joint in self.joints.values())]
        page = render(
            "arm.html.j2", title=folder.name, arm=self, columns=columns, cell=_cell, full=full,
            version=__version__,
        )  # fmt: skip
        files = {"arm.json": f"{record}\n", "arm.html": page}
        write_files({folder / name: text for name, text in files.items()}, replace=True)
        return folder / "arm.html"


def _cell(row: PosteriorRow | None) -> tuple[str, str]:
    """Format a number with its status, and its interval with the unit."""
    if row is None or row.reported.status == "unidentified":
        return ("" if row is None else "unidentified") or TEXT.none, ""
    _, value, _, interval, unit, status = printed_row("", row.reported, row.unit, row.level)
    return f"{value} {status}".strip(), f"{interval} {unit}".strip()
