"""Joints of an arm of which only targets and positions are known.

Along the measured motion the bodies load each joint with a known torque, and with an inertia of its
own acceleration, which changes with the pose. Targets reach all joints with one delay, and one
clock stamps their positions: both are estimated by each joint and combined.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.arm.arm_log import ArmLog, signals
from bayesfric.arm.departures import combined
from bayesfric.arm.inertial_prior import Bodies
from bayesfric.base.progress import Progress, ProgressCallback
from bayesfric.fit.model import Model
from bayesfric.inference.closed_loop import ClosedLoopLikelihood
from bayesfric.inference.closed_loop_fit import closed_loop_mode
from bayesfric.inference.fitting import Fit
from bayesfric.mechanism.closed_loop import follow
from bayesfric.problem.config import with_settings
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.measurement import ACCELERATION, Inputs, Measurement, Signal

# Turns of a simulation at most, and the change of positions at which they end, rad or m.
_TURNS, _SAME = 12, 1e-5
_DELAY, _INSTANTS = "target.delay", "noise.instants"


@dataclass(frozen=True)
class Timing:
    """Delay of all targets and sd of the instants of all readings, s: by all joints and by each."""

    delay: tuple[float, float]  # value and sd
    instants: tuple[float, float]
    joints: Mapping[str, Mapping[str, tuple[float, float]]]
    modes: Mapping[str, Mapping[str, float]]  # parameters of each joint without the others

    def known(self, name: str, model: Model) -> Model:
        """Give a joint's model these as priors; the search for its mode starts at its own."""
        (delay, delay_sd), (instants, instants_sd) = self.delay, self.instants
        lines = [
            f'priors."{_DELAY}" = {{distribution = "norm", loc = {delay!r}, scale = {delay_sd!r}}}',
            f'priors."{_INSTANTS}" = {{distribution = "lognorm", s = {instants_sd / instants!r}, '
            f"scale = {instants!r}}}",
        ]
        config = with_settings(model.config, lines)
        out = Model.from_config(config, terms=model.chain.terms, recordings=model.given)
        out.near = {**self.modes[name], _DELAY: delay, _INSTANTS: instants}
        return out


def common_timing(models: Mapping[str, Model], progress: ProgressCallback) -> Timing | None:
    """Combine delays and scatters of instants of the joints' modes; None of no joints."""
    joints, modes = dict[str, dict[str, tuple[float, float]]](), dict[str, dict[str, float]]()
    for name, model in models.items():
        progress(Progress(f"timing: {name}"))
        start, seed = model.starting_point(), model.config.tables.sampling.seed
        mode = closed_loop_mode(start.target, start.estimates, seed, largest=math.inf)
        target, names = mode.target, mode.target.names
        sds = np.sqrt(np.diag(np.linalg.inv(mode.information)))
        centre, moved = target.to_parameters(mode.mode + np.stack([0.0 * sds, 1e-3 * sds]))[0]
        modes[name] = dict(zip(names, centre.tolist(), strict=True))
        joints[name] = {
            key: (float(centre[k]), float(abs(moved[k] - centre[k]) / 1e-3))
            for key in (_DELAY, _INSTANTS)
            if (k := names.index(key) if key in names else -1) >= 0
        }
    if not joints:
        return None
    delay, instants = (
        combined([x[key] for x in joints.values() if key in x]) for key in (_DELAY, _INSTANTS)
    )
    return Timing(delay, instants, joints, modes)


def own_columns(
    bodies: Bodies,
    name: str,
    directions: Array,
    logs: Sequence[ArmLog],
    parameters: Sequence[Array],
) -> list[dict[str, Array]]:
    """Compute the inertia that the bodies have about a joint's axis, in each log.

    Of the nominal bodies and of each direction; and the joint's acceleration, from which their
    torques have it. Nothing where the joint has an effort.
    """
    if not logs[0].by_target(name):
        return [{} for _ in logs]
    j, out = list(bodies.joints).index(name), []
    for log, columns in zip(logs, parameters, strict=True):
        combined = np.column_stack([columns[:, 0], columns[:, 1:] @ directions])
        inertia = bodies.own_inertia(name, log.motion[0], combined)
        torques = ("load_torque", *signals(len(inertia) - 1))
        named = {f"{torque} inertia": x for torque, x in zip(torques, inertia, strict=True)}
        out.append({**named, ACCELERATION: log.motion[2, j]})
    return out


def followed(
    bodies: Bodies,
    log: ArmLog,
    measured: Mapping[str, Measurement],
    fits: Mapping[str, Fit],
    inertial: Array,
    values: Mapping[str, Array],
    restarts: Flags,
    rng: np.random.Generator,
    progress: ProgressCallback,
) -> Array:
    """Simulate joints that follow their targets, as encoders read them: ``(draws, n_joints, n)``.

    ``inertial`` ``(draws, 10 n_links)`` and ``values`` by joint are draws, with noise of the fits.
    Each joint is simulated along the others' motion, in turns until none changes (waveform
    relaxation; Lelarasmee, Ruehli and Sangiovanni-Vincentelli, IEEE Transactions on Computer-Aided
    Design 1 (1982) 131-145).
    """
    starts = np.flatnonzero(restarts)
    segments = np.stack([starts, np.append(starts[1:], log.time.size)], axis=1)
    driven = [list(bodies.joints).index(name) for name in fits]
    out = np.empty((len(inertial), len(fits), log.time.size))
    period = float(np.median(np.diff(log.time)))
    for k in range(len(inertial)):
        progress(Progress(f"roll-out {k + 1} of {len(inertial)}"))
        dynamics, motion = bodies.dynamics(inertial[k]), log.motion.copy()
        noise = [
            _disturbance(fit, values[name][k], log.time.size, period, rng)
            for name, fit in fits.items()
        ]
        for _ in range(_TURNS):
            along = [dynamics(q, qd) for q, qd in motion[:2].transpose(2, 0, 1)]
            mass, bias = (np.array(x) for x in zip(*along, strict=True))
            before = motion[0].copy()
            for j, name, (push, *_) in zip(driven, fits, noise, strict=True):
                own_inertia = mass[:, j, j]
                torque = bias[:, j] + np.einsum("nj,jn->n", mass[:, j], motion[2])
                columns = {"load_torque inertia": own_inertia, ACCELERATION: motion[2, j]}
                others = {key: Signal(log.time, x) for key, x in columns.items()}
                inputs = Inputs(load_torque=Signal(log.time, -torque), others=others)
                law, chain = measured[name].law, fits[name].chain
                assert law is not None
                q, qd = follow(
                    chain, values[name][k : k + 1], law, period, segments, log.motion[0, j, starts],
                    log.motion[1, j, starts], push=push[None], inputs=inputs, time=log.time,
                )  # fmt: skip
                motion[0, j], motion[1, j] = q[0], qd[0]
                for a, b in segments:
                    motion[2, j, a:b] = np.gradient(qd[0, a:b], period)
            if np.abs(motion[0] - before).max() < _SAME:
                break
        for row, j, (_, encoder, instants) in zip(out[k], driven, noise, strict=True):
            row[:] = motion[0, j] + encoder + instants * motion[1, j]
    return out


def _disturbance(
    fit: Fit, values: Array, count: int, period: float, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Draw a random torque ``(count,)``, and errors of readings and instants, of a fit's noise."""
    drawn = rng.choice(fit.posterior.flat())[None, len(fit.target.free) :]
    likelihood, scales = fit.target.likelihood, fit.target.noise.scales(drawn)[0, 0]
    assert isinstance(likelihood, ClosedLoopLikelihood)
    return likelihood.draw_disturbance(values, scales, count, period, rng)
