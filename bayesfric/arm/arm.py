"""A robot arm and its URDF: fits each joint in addition to the rigid-body torque of the URDF.

A joint's model is one element, referred to the joint: armature, Coulomb, viscous and
load-dependent friction, and an offset. Its load is the rigid-body torque of the URDF along the
measured motion of all joints. The directions in which that torque is uncertain are further torques,
whose coefficients have standard normal priors (:mod:`bayesfric.arm.inertial_prior`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.arm.arm_closed_loop import common_timing, own_columns
from bayesfric.arm.arm_columns import layout_of
from bayesfric.arm.arm_log import ArmLog, signals
from bayesfric.arm.arm_options import ArmOptions, Gain
from bayesfric.arm.departures import (
    bodies_torques,
    common_delay,
    coupled_joint,
    find_departures,
)
from bayesfric.arm.fitted_arm import FittedArm, FittedJoint
from bayesfric.arm.inertial_prior import Bodies, InertialPrior, UrdfJoint, directions, resolution
from bayesfric.arm.joint_consistency import JointConsistency
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, ProgressCallback, no_progress, progress_shown
from bayesfric.fit.model import Model
from bayesfric.problem.config import (
    checked_toml,
    document_text,
    parse_config,
    read_toml,
    recording_table,
)
from bayesfric.recordings.arrays import Array, rms
from bayesfric.recordings.filters import interpolated
from bayesfric.recordings.measurement import Measurement

_FRICTION = {"inertia": True, "coulomb": "symmetric", "viscous": True, "load_loss": "one"}


class Arm:
    """A robot arm: its URDF, and options.

    Parameters
    ----------
    urdf
        The URDF file; meshes are not needed.
    options
        ``arm.toml``, or its tables as a dict.

    Raises
    ------
    BadInput
        For a URDF or an option that cannot be used.
    """

    def __init__(
        self, urdf: Path | str, options: Path | str | Mapping[str, Any] | None = None
    ) -> None:
        if isinstance(options, Path | str):
            source = Path(options)
            text = read_toml(source)
        else:
            source = Path("Arm")
            text = document_text(options or {}, source)
        self.options = checked_toml(text, source, ArmOptions, "table of an arm")
        self.bodies = Bodies(Path(urdf), self.options.gravity, self.options.coupling)
        joints = self.bodies.joints
        for name, joint_options in self.options.joints.items():
            if name not in joints:
                problem = "the URDF has no such joint that moves independently"
                raise BadInput(f"{source}: joints.{name}", problem, nearest(name, joints))
            if joint_options.rotor_inertia and not joint_options.gear_ratio:
                key = f"{source}: joints.{name}.rotor_inertia"
                raise BadInput(key, "needs a gear_ratio", "add it")

    def fit(
        self,
        log: Path | str | Sequence[Path | str],
        *,
        predict: Path | str | None = None,
        effort_unit: str | None = None,
        seed: int | None = None,
        progress: bool | ProgressCallback = False,
    ) -> FittedArm:
        """Fit each joint that moves and has an effort.

        Parameters
        ----------
        log
            A log that holds the positions of all joints; or several with the same columns.
        predict
            A log of another motion, with the same columns; its torque is predicted, not fitted. An
            arm of targets alone follows them in :func:`bayesfric.arm.arm_rollout.rollout`.
        effort_unit
            Unit of the efforts, where no log names it; N m (N of a sliding joint) if left out.
        seed
            Of the random numbers.
        progress
            Whether to show a bar, or a callback.

        Raises
        ------
        BadInput
            If the log cannot be read, does not match the URDF, or no joint can be fitted.
        """
        paths = [Path(path) for path in ([log] if isinstance(log, Path | str) else log)]
        with progress_shown(progress) as report:
            arm, models, torques = self.prepared(paths, predict, effort_unit, report)
            joints = dict(arm.joints)
            closed = {name: x for name, x in models.items() if x.chain.closed_loop}
            timing = common_timing(closed, report)
            for name, model in models.items():
                report(Progress(name))
                if timing is not None and name in closed:
                    model = timing.known(name, model)
                else:  # which has an effort
                    joints[name] = self._with_coupling(
                        joints[name], model, arm.logs[0], torques[name]
                    )
                try:
                    result = arm.departures.doubted(name, model.fit(seed=seed, progress=report))
                    joints[name] = replace(joints[name], result=result)
                except BadInput as error:
                    joints[name] = replace(joints[name], failure=str(error))
        if all(joint.result is None for joint in joints.values()):
            failures = "; ".join(f"{name}: {joint.failure}" for name, joint in joints.items())
            raise BadInput(str(paths[0]), f"no joint is fitted ({failures})", "correct one")
        return replace(arm, joints=joints, timing=timing).combined(np.random.default_rng(seed))

    def prepared(
        self,
        paths: Sequence[Path],
        predict: Path | str | None = None,
        effort_unit: str | None = None,
        report: ProgressCallback = no_progress,
    ) -> tuple[FittedArm, dict[str, Model], dict[str, list[Array]]]:
        """Read logs, and correct them and the bodies by what all joints say together.

        Returns the arm without fits, and by joint models and torques ``(1 + k, n)`` in each log.
        """
        options, bodies, fitted_count = self.options, self.bodies, len(paths)
        layout, assumed = layout_of(paths[0], bodies.joints, options, effort_unit)
        paths = [*paths, *([] if predict is None else [Path(predict)])]
        names = [path.stem for path in paths]
        if len(set(names)) < len(names):
            names = [f"{name}-{k}" for k, name in enumerate(names, start=1)]
        for name in options.payload.logs or ():
            if name not in names:
                problem = f"there is no log {name!r}"
                raise BadInput("payload.logs", problem, nearest(name, names))
        report(Progress("motion"))
        size = options.samples // len(paths)
        logs = tuple(
            ArmLog(path, name, options, layout, bodies.joints, size)
            for path, name in zip(paths, names, strict=True)
        )
        report(Progress("torque of the bodies"))
        prior, others = bodies.prior(options.urdf, options.payload), names[fitted_count:]
        delay = options.delay or 0.0
        joints, models, torques = self._models(bodies, prior, logs, others, delay)
        late = common_delay(models) if options.delay is None else None
        directions = {name: joint.directions for name, joint in joints.items()}
        departures = find_departures(
            bodies,
            prior,
            logs,
            {name: x for name, x in models.items() if not x.chain.by_target},
            directions,
            payload=options.payload.given,
            lacking=options.repeatability.friction,
        )
        if departures.changes or (late is not None and late.evident):
            delay = late.value if late is not None and late.evident else delay
            bodies, prior = bodies.under(departures.gravity), prior.widened(departures.widths)
            for log in logs:
                log.scales = departures.scales
            gains = departures.gains
            joints, models, torques = self._models(bodies, prior, logs, others, delay, gains)
        urdf = JointConsistency(np.zeros((1, len(prior.deviations))), 1.0, 1.0, {}, ())
        arm = FittedArm(bodies, logs, joints, prior, urdf, departures, assumed, late)
        return arm, models, torques

    def _models(
        self,
        bodies: Bodies,
        prior: InertialPrior,
        logs: Sequence[ArmLog],
        held_out: Sequence[str],
        delay: float,
        gains: Mapping[str, float] = {},
    ) -> tuple[dict[str, FittedJoint], dict[str, Model], dict[str, list[Array]]]:
        """Make the joints that are to be fitted, and the models of those that can be.

        Also returns the torques ``(1 + k, n)`` of each joint in each log.
        """
        efforts: dict[str, Measurement | BadInput] = {}
        for name in logs[0].sources:
            if self.options.of(name).fit:
                try:
                    efforts[name] = logs[0].measured(bodies.joints[name])
                except BadInput as error:
                    efforts[name] = error
        parameters = [prior.columns(loaded=log.loaded) for log in logs]
        projected = self._projected(bodies, parameters, logs, efforts)
        joints, models = dict[str, FittedJoint](), dict[str, Model]()
        for name, effort in efforts.items():
            directions, torques, resolved = projected[name]
            joint = FittedJoint(
                bodies.joints[name],
                self.options.of(name).gear_ratio,
                directions,
                repeatability=self.options.repeatability,
                is_loaded=rms(np.concatenate([torque[0] for torque in torques])) > resolved,
            )
            try:
                if isinstance(effort, BadInput):
                    raise effort
                further = own_columns(bodies, name, directions, logs, parameters)
                settings = further, held_out, delay, gains.get(name)
                models[name] = self._model(joint, logs, torques, *settings)
                observations = models[name].observations
                compared = [o.filter.apply(bodies_torques(o)) for o in observations]
                urdf, *deviations = np.concatenate(compared, axis=1)
                joint = replace(
                    joint,
                    remarks=tuple(remarks(joint.joint, effort)),
                    urdf={
                        "torque_rms": rms(urdf),
                        "doubt_rms": rms(np.linalg.norm(deviations, axis=0)),
                    },
                )
            except BadInput as error:
                joint = replace(joint, failure=str(error))
            joints[name] = joint
        return joints, models, {name: torques for name, (_, torques, _) in projected.items()}

    def _with_coupling(
        self, joint: FittedJoint, model: Model, log: ArmLog, torques: Sequence[Array]
    ) -> FittedJoint:
        """Note a joint whose motor turns with another one, too, as no option says."""
        name, order = joint.joint.name, [*self.bodies.joints]
        if name in self.options.coupling.joints:
            return joint
        observation, *_ = model.observations
        coupled = coupled_joint(observation, log, order, name, torques[0])
        if coupled is None:
            return joint
        (other, ratio, before, after), linear = coupled, joint.joint.motion == "linear"
        text = (
            f"its effort is that of a motor that turns with {other}, too ({before:.3g} to "
            f'{after:.3g} {"N" if linear else "N m"} rms): [coupling] joints = ["{other}", '
            f'"{name}"], matrix = [[1, 0], [{ratio:.2g}, 1]]'
        )
        return replace(joint, remarks=(*joint.remarks, text), is_coupled=True)

    def _projected(
        self,
        bodies: Bodies,
        parameters: Sequence[Array],
        logs: Sequence[ArmLog],
        efforts: Mapping[str, Measurement | BadInput],
        *,
        compared: int = 2000,
    ) -> dict[str, tuple[Array, list[Array], float]]:
        """Project the inertial prior on the torque of each joint.

        ``parameters`` are the prior's columns in each log; ``compared`` samples in all give the
        directions. Returns by joint directions
        ``(n_deviations, k)``, the torques ``(1 + k, n)`` in each log: nominal, and one sd along
        each direction, and the smallest rms torque that the effort resolves.
        """
        order = list(bodies.joints)
        counts = [log.motion.shape[2] for log in logs]
        sizes = [max(compared * n // sum(counts), 1) for n in counts]
        samples = [
            np.unique(np.linspace(0, n - 1, size).astype(int))
            for n, size in zip(counts, sizes, strict=True)
        ]
        torques = [
            bodies.torques(log.motion[:, :, at], np.repeat(columns[None], len(order), axis=0))
            for log, at, columns in zip(logs, samples, parameters, strict=True)
        ]
        every_torque, at = np.concatenate(torques, axis=2), samples[0]
        joint_directions, resolved = [], []
        for j, name in enumerate(order):
            threshold, effort = np.inf, efforts.get(name)
            if isinstance(effort, Measurement):
                _, qd, qdd = logs[0].motion[:, j, at]
                torque = interpolated(effort.time, effort.torque, logs[0].time[at])
                error = resolution(torque, qd, qdd, torques[0][j])
                threshold = error * np.sqrt(at.size / counts[0])
            joint_directions.append(directions(every_torque[j, 1:], threshold))
            resolved.append(threshold)
        width = max(x.shape[1] for x in joint_directions)
        combinations = np.zeros((len(order), parameters[0].shape[1], 1 + width))
        combinations[:, 0, 0] = 1.0
        for j, x in enumerate(joint_directions):
            combinations[j, 1:, 1 : 1 + x.shape[1]] = x
        projected = [
            bodies.torques(log.motion, columns @ combinations)
            for log, columns in zip(logs, parameters, strict=True)
        ]
        return {
            name: (x, [torque[j, : 1 + x.shape[1]] for torque in projected], resolved[j])
            for j, (name, x) in enumerate(zip(order, joint_directions, strict=True))
        }

    def _model(
        self,
        fitted: FittedJoint,
        logs: Sequence[ArmLog],
        torques: Sequence[Array],
        further: Sequence[Mapping[str, Array]],
        held_out: Sequence[str],
        delay: float,
        gain: Gain | None,
    ) -> Model:
        """Make the model of one joint: an element whose load is the rigid-body torque.

        ``delay`` is that of positions after efforts, s, and ``gain`` that of the drive, unless the
        options have others.
        """
        joint, options = fitted.joint, self.options
        joint_options = self.options.of(joint.name)
        by_target = logs[0].by_target(joint.name)
        if by_target:  # what is held out is predicted by the arm as a whole, from its targets
            logs, held_out = logs[: len(logs) - len(held_out)], ()
        recordings = [
            log.recording(joint, t, x) for log, t, x in zip(logs, torques, further, strict=False)
        ]
        columns = signals(fitted.directions.shape[1])
        normal = {"distribution": "norm", "loc": 0.0, "scale": 1.0}
        priors: dict[str, Any] = {f"load.{column}": normal for column in columns}
        if joint_options.rotor_inertia and joint_options.gear_ratio:
            inertia = joint_options.rotor_inertia * joint_options.gear_ratio**2
            priors["motor.inertia"] = {**normal, "loc": inertia, "scale": 0.2 * inertia}
        delay = delay if joint_options.delay is None else joint_options.delay
        gain = joint_options.gain or options.gain or gain
        if delay:
            priors["target.delay" if by_target else "drive.delay"] = delay
        if gain:
            lognormal = {"distribution": "lognorm", "s": gain, "scale": 1.0}
            priors["drive.gain"] = [*gain] if isinstance(gain, tuple) else lognormal
        friction = {**_FRICTION, **options.friction.settings()}
        if not fitted.is_loaded:  # friction that depends on it is not identifiable
            friction["load_loss"] = "none"
        document = {
            "mechanism": {
                "terms": options.terms,
                "motion": joint.motion,
                "offset": True,
                "gain": bool(gain),
                **({} if by_target else {"delay": delay != 0.0}),
                "elements": {"motor": friction},
                "load": {
                    "motion": joint.motion,
                    "signals": columns,
                    **({"spring": True} if options.spring else {}),
                },
            },
            "recordings": [recording_table(r, n) for n, r in enumerate(recordings, start=1)],
            "priors": {**priors, **joint_options.priors},
            "processing": options.processing,
            **({"validation": {"recordings": [*held_out]}} if held_out else {}),
            **options.fit,
        }
        # ends of a 90 % interval are then right to a tenth of an sd; six joints take a minute
        document["sampling"] = {"min_ess": 400, **options.fit.get("sampling", {})}
        path = Path(joint.name)
        config = parse_config(document_text(document, path), path)
        return Model.from_config(config, recordings=recordings)


def remarks(joint: UrdfJoint, recording: Measurement) -> Iterator[str]:
    """Report positions that the URDF does not allow."""
    travel, limit = float(np.ptp(recording.position)), joint.high - joint.low
    if travel > 1.5 * limit:
        limits = f"its limits in the URDF over {limit:.3g}"
        yield f"its positions range over {travel:.3g}, {limits}: is their unit right?"
