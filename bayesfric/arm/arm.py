"""An arm and its URDF: each joint's fit, beside the torque that the bodies ask for.

A joint's model is one element, referred to the joint: armature, Coulomb, viscous and
load-dependent friction, and an offset. Its load is the torque of the URDF's bodies along the
measured motion of all joints, with the few directions in which these may be otherwise as further
torques, whose coefficients have standard normal priors (:mod:`bayesfric.arm.inertial_prior`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.arm.arm_log import ArmLog, Layout, layout_of, signals
from bayesfric.arm.arm_options import ArmOptions, JointOptions
from bayesfric.arm.inertial_prior import Bodies, Doubt, UrdfJoint, directions, resolution
from bayesfric.arm.fitted_arm import FittedArm, FittedJoint
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, Shown, progress_shown
from bayesfric.fit.model import Model
from bayesfric.problem.config import checked_toml, parse_config, read_toml
from bayesfric.problem.config_text import document_text, recording_table, toml_value
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.units import OPEN

# What a joint has.
_FRICTION = {"inertia": True, "coulomb": "symmetric", "viscous": True, "load_loss": "one"}
# Moments that are looked at for directions.
_LOOKED_AT = 2000
# Independent draws of each number: the ends of a 90 % interval are then right to a tenth of a
# standard deviation, and six joints take a minute.
_ENOUGH = 400
# How well a rotor's inertia is known that is given.
_ROTOR = 0.2
# Share of an effort that bodies explain before it is judged by them.
_MOSTLY = 0.5


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

    def __init__(
        self, urdf: Path | str, options: Path | str | Mapping[str, Any] | None = None
    ) -> None:
        if isinstance(options, Path | str):
            where = Path(options)
            text = read_toml(where)
        else:
            where = Path("Arm")
            text = document_text(options or {}, where)
        self.options = checked_toml(text, where, ArmOptions, "table of an arm")
        self.bodies = Bodies(Path(urdf), self.options.gravity)
        joints = self.bodies.joints
        for name, one in self.options.joints.items():
            if name not in joints:
                what = "no joint of the URDF that moves by itself has that name"
                raise BadInput(f"{where}: joints.{name}", what, nearest(name, joints))
            if one.rotor_inertia and not one.gear_ratio:
                key = f"{where}: joints.{name}.rotor_inertia"
                raise BadInput(key, "needs a gear_ratio", "add it")

    def fit(
        self,
        log: Path | str | Sequence[Path | str],
        *,
        predict: Path | str | None = None,
        seed: int | None = None,
        progress: bool | Shown = False,
    ) -> FittedArm:
        """Fit each joint that moves and has an effort.

        Parameters
        ----------
        log
            What the readers know, with the positions of all joints; or several, alike in columns.
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
        options, joints = self.options, self.bodies.joints
        paths = [Path(one) for one in ([log] if isinstance(log, Path | str) else log)]
        path, count = paths[0], len(paths)
        layout = Layout(options.recording, {})
        if "position" not in options.recording:
            found = layout_of(path, joints, options.recording.get("table"))
            layout = Layout({**found.recording, **options.recording}, found.labels)
            if OPEN in str(layout.recording):
                what = f"does not tell all units: {toml_value(layout.recording)}"
                mend = "write them in arm.toml ('bayesfric init arm --from LOG --urdf URDF')"
                raise BadInput(str(path), what, mend)
        paths += [] if predict is None else [Path(predict)]
        with progress_shown(progress) as tell:
            tell(Progress("motion"))
            names = [one.stem for one in paths]
            if len(set(names)) < len(names):
                names = [f"{name}-{k}" for k, name in enumerate(names, start=1)]
            for name in options.payload.logs or ():
                if name not in names:
                    raise BadInput(
                        "payload.logs", f"no log is called {name!r}", nearest(name, names)
                    )
            logs = [
                ArmLog(one, called, options, layout, joints, options.samples // len(paths))
                for one, called in zip(paths, names, strict=True)
            ]
            efforts: dict[str, Measurement | BadInput] = {}
            for name in logs[0].sources:
                if self._own(name).fit:
                    try:
                        efforts[name] = logs[0].measured(joints[name])
                    except BadInput as error:
                        efforts[name] = error
            tell(Progress("torque of the bodies"))
            doubt = self.bodies.doubt(options.urdf, options.payload)
            felt = self._felt(doubt, logs, efforts)
            fitted = {}
            for name, effort in efforts.items():
                tell(Progress(name))
                told = joints[name], effort, logs, felt[name], names[count:]
                fitted[name] = self._fitted(*told, seed, tell)
        if all(one.result is None for one in fitted.values()):
            why = "; ".join(f"{name}: {one.why}" for name, one in fitted.items())
            raise BadInput(str(path), f"no joint is fitted ({why})", "see to one")
        kept = {name: felt[name].kept for name in fitted}
        return FittedArm.joined(self.bodies, logs, fitted, doubt, kept, seed)

    def _own(self, name: str) -> JointOptions:
        return self.options.joints.get(name, JointOptions())

    def _felt(
        self,
        doubt: Doubt,
        logs: Sequence[ArmLog],
        efforts: Mapping[str, Measurement | BadInput],
    ) -> dict[str, _Felt]:
        """Ask the bodies for the torque of each joint, in each log."""
        bodies, order = self.bodies, list(self.bodies.joints)
        every = [doubt.columns(loaded=log.loaded) for log in logs]
        counts = [log.motion.shape[2] for log in logs]
        some = [
            np.unique(np.linspace(0, n - 1, max(_LOOKED_AT * n // sum(counts), 1)).astype(int))
            for n in counts
        ]
        parts = [
            bodies.torques(log.motion[:, :, at], np.repeat(one[None], len(order), axis=0))
            for log, at, one in zip(logs, some, every, strict=True)
        ]
        columns, own, count, kept = np.concatenate(parts, axis=2), some[0], counts[0], []
        for j, name in enumerate(order):
            small, effort = np.inf, efforts.get(name)
            if isinstance(effort, Measurement):
                _, qd, qdd = logs[0].motion[:, j, own]
                seen = parts[0][j]
                small = resolution(effort.torque[own], qd, qdd, seen) * np.sqrt(own.size / count)
            kept.append(directions(columns[j, 1:], small))
        most = max(one.shape[1] for one in kept)
        ways = np.zeros((len(order), every[0].shape[1], 1 + most))
        ways[:, 0, 0] = 1.0
        for j, one in enumerate(kept):
            ways[j, 1:, 1 : 1 + one.shape[1]] = one
        torques = [bodies.torques(log.motion, x @ ways) for log, x in zip(logs, every, strict=True)]
        return {
            name: _Felt(one, [t[j, : 1 + one.shape[1]] for t in torques])
            for j, (name, one) in enumerate(zip(order, kept, strict=True))
        }

    def _fitted(
        self,
        joint: UrdfJoint,
        effort: Measurement | BadInput,
        logs: Sequence[ArmLog],
        felt: _Felt,
        held_out: Sequence[str],
        seed: int | None,
        tell: Shown,
    ) -> FittedJoint:
        told = FittedJoint(joint, self._own(joint.name).gear_ratio)
        if isinstance(effort, BadInput):
            return replace(told, why=str(effort))
        urdf, *off = felt.torques[0]
        sizes = {
            "torque_rms": float(np.sqrt(np.mean(urdf**2))),
            "doubt_rms": float(np.sqrt(sum(np.mean(one**2) for one in off))),
        }
        told = replace(told, remarks=tuple(remarks(joint, effort, urdf)), urdf=sizes)
        try:
            result = self._model(joint, logs, felt, held_out).fit(seed=seed, progress=tell)
        except BadInput as error:
            return replace(told, why=str(error))
        return replace(told, result=result)

    def _model(
        self, joint: UrdfJoint, logs: Sequence[ArmLog], felt: _Felt, held_out: Sequence[str]
    ) -> Model:
        """Make the model of one joint: an element, its load the torque of the bodies."""
        own, options = self._own(joint.name), self.options
        recordings = [log.recording(joint, t) for log, t in zip(logs, felt.torques, strict=True)]
        columns = signals(felt.kept.shape[1])
        normal = {"distribution": "norm", "loc": 0.0, "scale": 1.0}
        priors: dict[str, Any] = {f"load.{one}": normal for one in columns}
        if own.rotor_inertia and own.gear_ratio:
            inertia = own.rotor_inertia * own.gear_ratio**2
            priors["motor.inertia"] = {**normal, "loc": inertia, "scale": _ROTOR * inertia}
        document = {
            "mechanism": {
                "terms": options.terms,
                "motion": joint.motion,
                "offset": True,
                "elements": {"motor": {**_FRICTION, **options.friction.given()}},
                "load": {"motion": joint.motion, "signals": columns},
            },
            "recordings": [recording_table(r, n) for n, r in enumerate(recordings, start=1)],
            "priors": {**priors, **own.priors},
            "processing": options.processing,
            **({"validation": {"recordings": [*held_out]}} if held_out else {}),
            **options.fit,
        }
        document["sampling"] = {"min_ess": _ENOUGH, **options.fit.get("sampling", {})}
        path = Path(joint.name)
        config = parse_config(document_text(document, path), path)
        return Model.from_config(config, recordings=recordings)


def remarks(joint: UrdfJoint, one: Measurement, urdf: Array) -> Iterator[str]:
    """Say what of a joint's log looks wrong beside the URDF.

    Its effort is regressed on the bodies' torque ``urdf`` ``(n,)``, Coulomb and viscous friction:
    where bodies are most of it, their factor is about one.
    """
    reach = float(np.ptp(one.position))
    if reach > 1.5 * joint.range:
        what = (
            f"its positions range over {reach:.3g}, its limits in the URDF over {joint.range:.3g}"
        )
        yield f"{what}: are they in the unit that is given?"
    speed = np.gradient(one.position, one.time)
    columns = np.stack([urdf, np.sign(speed), speed, np.ones_like(urdf)], axis=1)
    factor = float(np.linalg.lstsq(columns, one.torque, rcond=None)[0][0])
    share = abs(factor) * float(np.std(urdf)) / float(np.std(one.torque))
    if share > _MOSTLY and not 0.5 < factor < 2.0:
        what = "the opposite sign" if -2.0 < factor < -0.5 else "another unit or drive gain"
        yield f"its effort is {factor:.2g} times the torque of the bodies: has it {what}?"


@dataclass(frozen=True, eq=False)
class _Felt:
    """What one joint feels of the bodies."""

    kept: Array  # (n_causes, k) directions
    torques: Sequence[Array]  # (1 + k, n) of each log
