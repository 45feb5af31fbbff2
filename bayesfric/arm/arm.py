"""An arm and its URDF: each joint's fit, beside the torque that the bodies ask for.

A joint's model is one element, referred to the joint: armature, Coulomb, viscous and
load-dependent friction, and an offset. Its load is the torque of the URDF's bodies along the
measured motion of all joints, with the few directions in which these may be otherwise as further
torques, whose coefficients have standard normal priors (:mod:`bayesfric.arm.bodies`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy.stats import chi2

from bayesfric.arm.arm_log import ArmLog, Layout, layout_of, remarks, signals
from bayesfric.arm.arm_options import ArmOptions, JointOptions
from bayesfric.arm.bodies import Bodies, Doubt, UrdfJoint
from bayesfric.arm.fitted_arm import Cause, FittedArm, FittedJoint
from bayesfric.base.configuration_errors import configuration_error
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, Shown, progress_shown
from bayesfric.fit.model import Model
from bayesfric.fit.result import Result
from bayesfric.problem.config import checked_toml, parse_config, read_toml
from bayesfric.problem.config_text import document_text, recording_table
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.processing import Processing

# Of a joint's effort, rms: bodies that ask for less otherwise are taken as they are.
_SMALL = 0.01
# Moments that are looked at for directions.
_LOOKED_AT = 2000
# What a joint has.
_FRICTION = {"inertia": True, "coulomb": "symmetric", "viscous": True, "load_loss": "one"}
# Share of the prior's variance that the data must take off before a direction is judged by it.
_TELLING = 0.05
# How well a rotor's inertia is known that is given.
_ROTOR = 0.2


class Arm:
    """A robot arm by its URDF, with what else is known of it.

    Parameters
    ----------
    urdf
        Its file; meshes are not needed.
    options
        ``arm.toml``, or its tables as a dict.

    Raises
    ------
    BadInput
        For anything that cannot be used.
    """

    def __init__(self, urdf: Path | str, options: Path | str | Mapping[str, Any] = {}) -> None:  # noqa: B006
        if isinstance(options, Mapping):
            text, self._where = document_text(options, Path("Arm")), Path("Arm")
        else:
            self._where = Path(options)
            text = read_toml(self._where)
        self.options = checked_toml(text, self._where, ArmOptions, "table of an arm")
        self.bodies = Bodies(Path(urdf), self.options.gravity)
        for name, one in self.options.joints.items():
            where = f"{self._where}: joints.{name}"
            if name not in self.bodies.joints:
                mend = nearest(name, self.bodies.joints)
                raise BadInput(
                    where, "no joint of the URDF that moves by itself has that name", mend
                )
            if one.rotor_inertia and not one.gear_ratio:
                raise BadInput(f"{where}.rotor_inertia", "needs a gear_ratio", "add it")
        given = self.options.fit.get("processing", {})
        try:
            self._processing = Processing.model_validate(given)
        except ValidationError as error:
            where = f"{self._where}: fit.processing."
            raise configuration_error(where, "processing", error, given, Processing) from None

    def fit(
        self,
        log: Path | str,
        *,
        predict: Path | str | None = None,
        seed: int | None = None,
        progress: bool | Shown = False,
    ) -> FittedArm:
        """Fit each joint that moves and has an effort.

        Parameters
        ----------
        log
            What the readers know, with the positions of all joints.
        predict
            A log of another motion, of the same columns, whose torque is predicted and not fitted.
        seed
            Of the sampling.
        progress
            Whether to show a bar, or what to call as work goes on.

        Raises
        ------
        BadInput
            If the log cannot be read beside the URDF, or no joint can be fitted.
        """
        path, options = Path(log), self.options
        layout = Layout(options.recording, {})
        if "position" not in options.recording:
            layout = layout_of(path, self.bodies.joints, options.recording.get("table"))
            layout = Layout({**layout.recording, **options.recording}, layout.labels)
        paths = [path] if predict is None else [path, Path(predict)]
        with progress_shown(progress) as tell:
            tell(Progress("motion"))
            logs = [
                ArmLog(one, options, layout, self.bodies.joints, self._processing) for one in paths
            ]
            efforts = {name: self._effort(logs[0], joint) for name, joint in self._wanted()}
            tell(Progress("torque of the bodies"))
            felt = self._felt(logs, efforts)
            fitted = {}
            for name, effort in efforts.items():
                tell(Progress(name))
                fitted[name] = self._fitted(name, effort, logs, felt[name], seed, tell)
        if all(one.result is None for one in fitted.values()):
            why = "; ".join(f"{name}: {one.why}" for name, one in fitted.items())
            raise BadInput(str(path), f"no joint is fitted: {why}", "see there")
        return FittedArm(self.bodies.path, tuple(paths), fitted)

    def _wanted(self) -> Iterator[tuple[str, UrdfJoint]]:
        for name, joint in self.bodies.joints.items():
            own = self._own(name)
            if own.fit and own.held is None:
                yield name, joint

    def _own(self, name: str) -> JointOptions:
        return self.options.joints.get(name, JointOptions())

    def _effort(self, log: ArmLog, joint: UrdfJoint) -> Measurement | BadInput:
        try:
            return log.measured(joint)
        except BadInput as error:
            return error

    def _felt(
        self, logs: Sequence[ArmLog], efforts: Mapping[str, Measurement | BadInput]
    ) -> dict[str, _Felt]:
        """Ask the bodies for the torque of each joint, in each log."""
        bodies, order = self.bodies, list(self.bodies.joints)
        doubt = bodies.doubt(self.options.urdf, self.options.payload)
        small = np.full(len(order), np.inf)
        for name, effort in efforts.items():
            if isinstance(effort, Measurement):
                small[order.index(name)] = _SMALL * float(np.std(effort.torque))
        kept = bodies.directions(logs[0].motion.thinned(_LOOKED_AT), doubt, small)
        most = max(one.shape[1] for one in kept)
        parameters = np.zeros((len(order), doubt.nominal.size, 1 + most))
        for j, one in enumerate(kept):
            parameters[j, :, 0] = doubt.nominal
            parameters[j, :, 1 : 1 + one.shape[1]] = doubt.spread @ one
        torques = [bodies.torques(log.motion, parameters) for log in logs]
        return {
            name: _Felt(doubt, one, [t[j, : 1 + one.shape[1]] for t in torques])
            for j, (name, one) in enumerate(zip(order, kept, strict=True))
        }

    def _fitted(
        self,
        name: str,
        effort: Measurement | BadInput,
        logs: Sequence[ArmLog],
        felt: _Felt,
        seed: int | None,
        tell: Shown,
    ) -> FittedJoint:
        joint, ratio = self.bodies.joints[name], self._own(name).gear_ratio
        if isinstance(effort, BadInput):
            return FittedJoint(joint, ratio, why=str(effort))
        urdf, *off = felt.torques[0]
        told = FittedJoint(
            joint,
            ratio,
            remarks=tuple(remarks(joint, effort, urdf)),
            urdf_rms=float(np.sqrt(np.mean(urdf**2))),
            doubt_rms=float(np.sqrt(np.sum(np.mean(np.square(off), axis=1)))) if off else 0.0,
        )
        if not urdf.any() and not off:
            why = "the URDF's bodies beyond it have no mass: give them an <inertial>"
            return replace(told, why=why)
        try:
            model = self._model(joint, logs, felt)
            result = model.fit(seed=seed, progress=tell)
        except BadInput as error:
            return replace(told, why=str(error))
        return replace(told, result=result, **felt.told(result))

    def _model(self, joint: UrdfJoint, logs: Sequence[ArmLog], felt: _Felt) -> Model:
        """Make the model of one joint: an element, its load the torque of the bodies."""
        own = self._own(joint.name)
        recordings = [log.recording(joint, t) for log, t in zip(logs, felt.torques, strict=True)]
        columns = signals(felt.kept.shape[1])
        priors: dict[str, Any] = {
            f"load.{one}": {"distribution": "norm", "loc": 0.0, "scale": 1.0} for one in columns
        }
        if own.rotor_inertia and own.gear_ratio:
            inertia = own.rotor_inertia * own.gear_ratio**2
            width = {"loc": inertia, "scale": _ROTOR * inertia}
            priors["motor.inertia"] = {"distribution": "norm", **width}
        tables = dict(self.options.fit)
        if len(logs) > 1:
            tables["validation"] = {"recordings": [one.source.name for one in recordings[1:]]}
        document = {
            "mechanism": {
                "terms": tables.pop("terms", "auto"),
                "motion": joint.motion,
                "offset": True,
                "elements": {"motor": {**_FRICTION, **self.options.friction.given()}},
                "load": {"motion": joint.motion, "signals": columns},
            },
            "recordings": [recording_table(r, n) for n, r in enumerate(recordings, start=1)],
            "priors": {**priors, **own.priors},
            **tables,
        }
        path = Path(joint.name)
        config = parse_config(document_text(document, path), path)
        return Model.from_config(config, recordings=recordings)


@dataclass(frozen=True, eq=False)
class _Felt:
    """What one joint feels of the bodies."""

    doubt: Doubt
    kept: Array  # (n_causes, k) directions
    torques: Sequence[Array]  # (1 + k, n) of each log

    def told(self, result: Result) -> dict[str, Any]:
        """Say what the posterior of the directions makes of the causes."""
        count = self.kept.shape[1]
        if not count:
            return {}
        posterior = result.fit.posterior
        draws = posterior.flat()[:, [posterior.names.index(f"load.{n}") for n in signals(count)]]
        mean, spread = draws.mean(axis=0), np.atleast_2d(np.cov(draws.T))
        # over the prior's draws a posterior mean scatters by what the data take off the prior
        seen = np.eye(count) - spread
        size, ways = np.linalg.eigh(0.5 * (seen + seen.T))
        told = size > _TELLING
        far = float(np.sum((ways[:, told].T @ mean) ** 2 / size[told]))
        value = self.kept @ mean
        left = 1.0 - np.einsum("ik,kl,il->i", self.kept, seen, self.kept)
        causes = [
            Cause(name, float(x * one), float(np.sqrt(max(v, 0.0)) * one), one, unit)
            for (name, one, unit), x, v in zip(self.doubt.causes, value, left, strict=True)
            if one > 0.0
        ]
        causes.sort(key=lambda c: -abs(c.value) / c.prior_sd)
        return {"causes": tuple(causes), "urdf_p": float(chi2.sf(far, np.count_nonzero(told)))}
