"""Signals along a recorded motion, and scales, from which candidates make their columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesfric.diagnostics.states import resonating, since_reversal
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Sizes, State
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import derivative, lowpass
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation

Sets = Mapping[str, Sequence[Array]]

# Terms of the load that a transmission carries, without friction.
_CARRIED = frozenset({"inertia", "first_moment", "gravity_angle", "spring", "spring_cubic", "gain"})
_WEIGHTS = frozenset({"first_moment", "spring", "spring_cubic"})
# Shares of the inertia behind the gearbox that are tried; a motion without losses does not identify
# it.
_BEHIND = (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
# Cycles of cogging per turn, and antiresonances over the band.
_CYCLES = (*range(1, 9), 12, 18, 24, 36, 48)
TURNS = {f"{k} a turn of the {side}": (k, side) for k in _CYCLES for side in ("motor", "joint")}
_ANTIRESONANCES = (0.1, 0.13, 0.17, 0.22, 0.29, 0.38, 0.5, 0.65, 0.8, 1.0, 1.3)
# Cut-offs of a low-pass before logging over the band, and its order.
_CUTOFFS, ORDER = tuple(2.0 ** (-k / 3.0) for k in range(15)), 4
# Recorded amplitude above a frequency over friction's below which the log is low-passed there.
# Simulated logs smoothed at half the band have at most 0.05 above it, others at least 0.4.
_SILENT = 0.1
# Least width of a transient, s, and the largest number of them in a recording.
_TRANSIENT, _TRANSIENTS = 0.25, 60
# Quantile that is a typical largest speed; least reversal in encoder steps, and in the motion's
# span.
_FAST, _STEPS, _REVERSAL = 0.95, 3.0, 1e-3
# Default band as a share of the rate of the outputs.
_FASTEST = 0.3


@dataclass(frozen=True)
class Scales:
    """Scales of the columns, from the measured recordings; the same for replicates."""

    speed: float  # 95 % quantile of its absolute value, rad/s or m/s
    reach: float  # twice the median distance from the last reversal, rad or m
    # rms motor torque of inertia, gravity and springs; of the measured torque; and of the model's
    # other terms, such as friction, N m or N
    carried: float
    torque: float
    lost: float
    duration: float  # s, of the longest recording
    # name, and radians per joint radian, of cycles that the motion completes
    cycles: tuple[tuple[str, float], ...]
    transient_width: float  # s, of a transient: at least 0.25 and duration / 120
    # of the recordings, and of their further columns
    names: tuple[str, ...]
    others: tuple[str, ...]
    # motor torque per joint acceleration, by least squares, N m s² or N s²/m
    inertia: float
    # carried over inertia: rms acceleration of the load
    need: float
    band: float  # Hz, widest of the recordings, or 0.3 of the slowest rate of outputs
    weighs: bool  # whether gravity and springs vary by more than 0.001 of carried


def scales_of(chain: Joint, values: Array, observations: Sequence[Observation]) -> Scales:
    """Compute the scales of columns from recordings at parameters ``(n_parameters,)``."""
    speed = np.concatenate([np.abs(o.qd[o.filter.centres]) for o in observations])
    carried_torques = [_carried(chain, values, o) for o in observations]
    lost = [
        (_torque(chain, values, o) - transmitted)[o.filter.centres]
        for o, transmitted in zip(observations, carried_torques, strict=True)
    ]
    carried = np.concatenate(carried_torques)
    still_torque = [_carried(chain, values, o, still=True) for o in observations]
    moving = carried - np.concatenate(still_torque)
    qdd = np.concatenate([o.qdd for o in observations])
    inertia = max(float(moving @ qdd) / max(float(qdd @ qdd), 1e-300), 1e-300)
    span = max(float(np.ptp(o.q)) for o in observations)
    least_reversal = max(max(_STEPS * o.position_step for o in observations), _REVERSAL * span)
    reach = [since_reversal(o.q, least_reversal)[o.filter.centres] for o in observations]
    sides = {"motor": chain.ratio, "joint": 1.0} if chain.ratio != 1.0 else {"joint": 1.0}
    cycles = tuple(
        (name, k * sides[side])
        for name, (k, side) in TURNS.items()
        if side in sides
        and k * sides[side] * span >= 2.0 * np.pi
        and chain.motor_motion == "rotary"
    )
    return Scales(
        speed=float(np.quantile(speed, _FAST)),
        reach=2.0 * float(np.median(np.concatenate(reach))),
        carried=_rms(carried),
        torque=_rms(np.concatenate([o.measured for o in observations])),
        lost=_rms(np.concatenate(lost)),
        duration=max(float(np.ptp(o.stamps)) for o in observations),
        cycles=cycles,
        transient_width=max(
            _TRANSIENT, max(float(np.ptp(o.stamps)) for o in observations) / (2 * _TRANSIENTS)
        ),
        names=tuple(o.name for o in observations),
        others=tuple(
            name
            for name in dict.fromkeys(name for o in observations for name in o.inputs.others)
            if f"load.{name}" not in chain.names
        ),
        inertia=inertia,
        need=_rms(carried) / inertia,
        band=max(float(o.settings["band"]) for o in observations)
        or _FASTEST / max(o.period for o in observations),
        weighs=max(float(np.ptp(x)) for x in still_torque) > 1e-3 * _rms(carried),
    )


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _carried(chain: Joint, values: Array, o: Observation, *, still: bool = False) -> Array:
    """Motor torque ``(N,)`` of inertia, gravity and springs; without inertia if ``still``."""
    is_carried = [p.quantity in _CARRIED or p.row.option == "signals" for p in chain.parameters]
    at_rest = replace(o, qdd=np.zeros_like(o.q)) if still else o
    return _torque(chain, np.where(is_carried, values, 0.0), at_rest)


def _torque(chain: Joint, values: Array, o: Observation) -> Array:
    """Motor torque ``(N,)`` of the whole model."""
    return inverse_torque(chain, values, o.q, o.qd, o.qdd, inputs=o.inputs, time=o.stamps)


@dataclass(frozen=True, eq=False)
class Along:
    """One recording's motion and the model's torque along it; signals are ``(N,)``."""

    # the joint and its parameters (n_parameters,)
    chain: Joint
    values: Array
    # preprocessed, and as read
    o: Observation
    recording: Measurement
    scales: Scales  # of all recordings

    @cached_property
    def torque(self) -> Array:
        """Motor torque of the model, N m or N."""
        return _torque(self.chain, self.values, self.o)

    @cached_property
    def torque_rate(self) -> Array:
        """Rate of the low-passed torque, N m/s or N/s."""
        return self.rate(self.smooth(self.torque))

    @cached_property
    def elastic(self) -> Sets:
        """Torque of an elastic transmission at each antiresonance."""
        return _elastic(self)

    @cached_property
    def direction(self) -> Array:
        """Sign of the speed."""
        return np.sign(self.o.qd)

    @cached_property
    def carried(self) -> Array:
        """Motor torque of inertia, gravity and springs, N m or N."""
        return _carried(self.chain, self.values, self.o)

    @cached_property
    def weight(self) -> Array:
        """Motor torque of gravity and springs."""
        return _carried(self.chain, self.values, self.o, still=True)

    @cached_property
    def regressors(self) -> Sequence[Array]:
        """Acceleration, sign of the speed, speed, and unit gravity and springs."""
        chain, still = self.chain, replace(self.o, qdd=np.zeros_like(self.o.q))
        sizes = np.eye(len(chain.names))
        indices = [i for i, p in enumerate(chain.parameters) if p.quantity in _WEIGHTS]
        return (
            self.o.qdd,
            self.direction,
            self.o.qd,
            *(_torque(chain, sizes[i], still) for i in indices),
        )

    def smoothed_at(self) -> float:
        """Return the cut-off of a low-pass before logging, Hz, within a factor of two, or 0.

        Above twice that, the recorded torque has less than a tenth of the amplitude of friction's
        reversals: the log has no information on friction there.
        """
        segments, fs = self.recording.segments, 1.0 / self.recording.period
        signals = np.stack([self.o.torque, self.torque - self.carried])
        silent = 0.0
        for f in self.cutoffs:
            fast = signals - lowpass(signals, segments, fs, f, ORDER)
            recorded, friction = map(_rms, fast[:, self.o.filter.centres])
            if recorded > _SILENT * friction:
                break
            silent = f
        return 0.5 * silent

    @property
    def cutoffs(self) -> Sequence[float]:
        """Cut-offs of a low-pass before logging that are tried, Hz."""
        return [times * self.scales.band for times in _CUTOFFS]

    @cached_property
    def clock(self) -> Array:
        """Time over the longest duration, centred."""
        return np.asarray((self.o.stamps - self.o.stamps.mean()) / self.scales.duration)

    def smooth(self, x: Array) -> Array:
        """Low-pass signals ``(..., N)`` as the position was."""
        settings = self.o.settings
        fs = 1.0 / self.recording.period
        return np.asarray(
            lowpass(
                x, self.recording.segments, fs, float(settings["lowpass"]), int(settings["order"])
            )
        )

    def rate(self, x: Array) -> Array:
        """Differentiate signals ``(..., N)`` by time as the position was."""
        reach = int(self.o.settings["reach"])
        return derivative(x, self.recording.segments, self.recording.period, reach)

    def behind(self) -> Iterator[tuple[str, float, Array]]:
        """Yield the torque ``(N,)`` that a gearbox carries, by share of inertia behind it."""
        for share in _BEHIND if self.scales.weighs else (1.0,):
            carried = self.weight + share * (self.carried - self.weight)
            yield f"{share:.0%} of the inertia behind it", share, carried

    def state(self, transmitted: Array) -> State:
        """Return the state of one element at the joint's speed that carries a torque ``(N,)``."""
        o = self.o
        still = np.zeros_like(o.q)
        return State(o.q, o.qd, o.qdd, self.direction, o.stamps, transmitted, still)

    @property
    def sizes(self) -> Sizes:
        """Scales of grids of shapes: torque's rms, speed and duration."""
        scales = self.scales
        return Sizes(scales.torque, scales.speed, 1.0, 1.0, 1.0, scales.duration)


def _elastic(a: Along) -> Sets:
    hertz, r = [times * a.scales.band for times in _ANTIRESONANCES], a.recording
    rows = resonating(a.carried, r.segments, r.period, hertz)
    columns = {f"{f:.3g} Hz": [row] for f, row in zip(hertz, rows, strict=True)}
    return {"far above the band": [a.rate(a.rate(a.smooth(a.carried)))]} | columns
