"""One recording's motion: signals, scales and hidden states from which candidates make columns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import State, TypicalSizes
from bayesfric.recordings.arrays import Array, Segments, rms
from bayesfric.recordings.filters import derivative, lowpass
from bayesfric.recordings.measurement import ACCELERATION, Measurement
from bayesfric.recordings.signals import Signals

# Terms of the load that a transmission carries, without friction.
_WEIGHTS = frozenset({"first_moment", "spring", "spring_cubic"})
_CARRIED = _WEIGHTS | {"inertia", "gravity_angle", "gain", "kp"}
# Cycles of cogging per turn.
TURNS = {
    f"{k} a turn of the {side}": (k, side)
    for k in (*range(1, 9), 12, 18, 24, 36, 48)
    for side in ("motor", "joint")
}
# Order of a low-pass before logging.
ORDER = 4


@dataclass(frozen=True)
class Scales:
    """Scales of the columns, from the measured recordings; the same for replicates."""

    speed: float  # 95 % quantile of its absolute value, rad/s or m/s
    reach: float  # twice the median distance from the last reversal, rad or m
    # rms of the measured torque (the inertia's, if the motor is off), and of the model's terms
    # other than inertia, gravity and springs
    torque: float
    lost: float
    duration: float  # s, of the longest recording
    cycles: Mapping[str, float]  # radians per joint radian of cycles that the motion completes
    names: tuple[str, ...]  # of the recordings, and of their further columns
    others: tuple[str, ...]
    inertia: float  # motor torque per joint acceleration, by least squares, N m s² or N s²/m
    need: float  # rms acceleration of the load: that of the carried torque over inertia
    band: float  # Hz, widest of the recordings, or 0.3 of the slowest rate of outputs
    weighs: bool  # whether gravity and springs vary by more than 0.001 of the carried torque

    @property
    def transient_width(self) -> float:
        """Width of a transient, s: a recording has at most sixty of twice that."""
        return max(0.25, self.duration / 120.0)


def scales_of(chain: Joint, values: Array, observations: Sequence[Signals]) -> Scales:
    """Compute the scales of columns from recordings at parameters ``(n_parameters,)``."""

    def of_outputs(signals: Sequence[Array]) -> Array:
        pairs = zip(signals, observations, strict=True)
        return np.concatenate([x[o.filter.centres] for x, o in pairs])

    every_carried = [_carried(chain, values, o) for o in observations]
    weights = [_carried(chain, values, o, still=True) for o in observations]
    torques = [_torque(chain, values, o) for o in observations]
    lost = [torque - x for torque, x in zip(torques, every_carried, strict=True)]
    carried, qdd = np.concatenate(every_carried), np.concatenate([o.qdd for o in observations])
    moving = carried - np.concatenate(weights)
    inertia = max(float(moving @ qdd) / max(float(qdd @ qdd), 1e-300), 1e-300)
    span = max(float(np.ptp(o.q)) for o in observations)
    # a reversal is three encoder steps, or a thousandth of the motion
    least = max(3.0 * max(o.position_step for o in observations), 1e-3 * span)
    away = [since_reversal(o.q, least) for o in observations]
    sides = {"motor": chain.ratio, "joint": 1.0} if chain.ratio != 1.0 else {"joint": 1.0}
    cycles = {name: k * sides[side] for name, (k, side) in TURNS.items() if side in sides}
    others = dict.fromkeys(
        name
        for o in observations
        for name in o.inputs.others
        if not (chain.own_inertia and (name == ACCELERATION or name.endswith(" inertia")))
    )
    return Scales(
        speed=float(np.quantile(np.abs(of_outputs([o.qd for o in observations])), 0.95)),
        reach=2.0 * float(np.median(of_outputs(away))),
        torque=rms(np.concatenate([o.measured for o in observations])) or rms(moving),
        lost=rms(of_outputs(lost)),
        duration=max(float(np.ptp(o.stamps)) for o in observations),
        cycles={
            name: k
            for name, k in cycles.items()
            if k * span >= 2.0 * np.pi and chain.motor_motion == "rotary"
        },
        names=tuple(o.name for o in observations),
        others=tuple(name for name in others if f"load.{name}" not in chain.names),
        inertia=inertia,
        need=rms(carried) / inertia,
        band=max(float(o.settings["band"]) for o in observations)
        or 0.3 / max(o.period for o in observations),
        weighs=max(float(np.ptp(x)) for x in weights) > 1e-3 * rms(carried),
    )


def _carried(chain: Joint, values: Array, o: Signals, *, still: bool = False) -> Array:
    """Motor torque ``(N,)`` of inertia, gravity and springs; without inertia if ``still``."""
    is_carried = [p.quantity in _CARRIED or p.row.option == "signals" for p in chain.parameters]
    at_rest = replace(o, qdd=np.zeros_like(o.q)) if still else o
    return _torque(chain, np.where(is_carried, values, 0.0), at_rest)


def _torque(chain: Joint, values: Array, o: Signals) -> Array:
    """Motor torque ``(N,)`` of the whole model."""
    return inverse_torque(chain, values, o.q, o.qd, o.qdd, inputs=o.inputs, time=o.stamps)


@dataclass(frozen=True, eq=False)
class MotionSignals:
    """One recording's motion and the model's torque along it; signals are ``(N,)``."""

    chain: Joint
    values: Array  # (n_parameters,)
    o: Signals  # preprocessed
    recording: Measurement  # as read
    scales: Scales  # of all recordings

    @cached_property
    def torque(self) -> Array:
        """Motor torque of the model, N m or N; 0 where the motor is off."""
        if not self.recording.torque.any():
            return np.zeros_like(self.o.q)
        return _torque(self.chain, self.values, self.o)

    @cached_property
    def torque_rate(self) -> Array:
        """Rate of the low-passed torque, N m/s or N/s."""
        return self.rate(self.smooth(self.torque))

    @cached_property
    def waves(self) -> dict[str, tuple[Array, Array]]:
        """Sine and cosine of the position in turns of motor and joint."""
        phasors: dict[tuple[int, str], NDArray[np.complex128]] = {}
        for name, cycles in self.scales.cycles.items():
            k, side = TURNS[name]
            # products take a tenth of the time of sines
            known = (j for j, of in phasors if of == side and (k - j, side) in phasors)
            if j := next(known, None):
                phasors[k, side] = phasors[j, side] * phasors[k - j, side]
            else:
                phasors[k, side] = np.exp(1j * cycles * self.o.q)
        pairs = zip(self.scales.cycles, phasors.values(), strict=True)
        return {name: (phasor.imag, phasor.real) for name, phasor in pairs}

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
        gains = [p.quantity in ("gain", "kp") for p in chain.parameters]  # which divide
        sizes = np.where(gains, self.values, np.eye(len(chain.names)))
        indices = [i for i, p in enumerate(chain.parameters) if p.quantity in _WEIGHTS]
        weights = (_torque(chain, sizes[i], still) for i in indices)
        return self.o.qdd, self.direction, self.o.qd, *weights

    @cached_property
    def elastic(self) -> Mapping[str, Sequence[Array]]:
        """Torque of an elastic transmission at each antiresonance over the band."""
        shares = (0.1, 0.13, 0.17, 0.22, 0.29, 0.38, 0.5, 0.65, 0.8, 1.0, 1.3)
        hertz, r = [x * self.scales.band for x in shares], self.recording
        rows = resonating(self.carried, r.segments, r.period, hertz)
        columns = {f"{f:.3g} Hz": [row] for f, row in zip(hertz, rows, strict=True)}
        return {"far above the band": [self.rate(self.rate(self.smooth(self.carried)))]} | columns

    @property
    def cutoffs(self) -> Sequence[float]:
        """Cut-offs of a low-pass before logging that are tried, Hz."""
        return [2.0 ** (-k / 3.0) * self.scales.band for k in range(15)]

    def smoothed_at(self) -> float:
        """Return the cut-off of a low-pass before logging, Hz, within a factor of two, or 0.

        Above twice that, the recorded torque has less than a tenth of the amplitude of friction's
        reversals: the log has no information on friction there. Simulated logs smoothed at half the
        band have at most 0.05 above it, others at least 0.4.
        """
        segments, fs = self.recording.segments, 1.0 / self.recording.period
        if not np.ptp(self.recording.torque):  # it is known, not recorded
            return 0.0
        signals = np.stack([self.o.torque, self.torque - self.carried])
        silent = 0.0
        for f in self.cutoffs:
            fast = signals - lowpass(signals, segments, fs, f, ORDER)
            recorded, friction = map(rms, fast[:, self.o.filter.centres])
            if recorded > 0.1 * friction:
                break
            silent = f
        return 0.5 * silent

    @cached_property
    def clock(self) -> Array:
        """Time over the longest duration, centred."""
        return np.asarray((self.o.stamps - self.o.stamps.mean()) / self.scales.duration)

    def smooth(self, x: Array) -> Array:
        """Low-pass signals ``(..., N)`` as the position was."""
        cutoff, order = float(self.o.settings["lowpass"]), int(self.o.settings["order"])
        fs = 1.0 / self.recording.period
        return np.asarray(lowpass(x, self.recording.segments, fs, cutoff, order))

    def rate(self, x: Array) -> Array:
        """Differentiate signals ``(..., N)`` by time as the position was."""
        reach = int(self.o.settings["reach"])
        return derivative(x, self.recording.segments, self.recording.period, reach)

    def behind(self) -> Iterator[tuple[str, float, Array]]:
        """Yield the torque ``(N,)`` that a gearbox carries, by share of inertia behind it.

        Several are tried: a motion without losses does not identify it.
        """
        for share in (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0) if self.scales.weighs else (1.0,):
            carried = self.weight + share * (self.carried - self.weight)
            yield f"{share:.0%} of the inertia behind it", share, carried

    def state(self, transmitted: Array) -> State:
        """Return the state of one element at the joint's speed that carries a torque ``(N,)``."""
        o, still = self.o, np.zeros_like(self.o.q)
        return State(o.q, o.qd, o.qdd, self.direction, o.stamps, transmitted, still)

    @property
    def sizes(self) -> TypicalSizes:
        """Scales of grids of shapes: torque's rms, speed and duration."""
        scales = self.scales
        return TypicalSizes(scales.torque, scales.speed, 1.0, duration=scales.duration)


# Hidden states: their torque depends on the past motion, not only on position, speed, acceleration.


@njit(cache=True)
def deflection(q, reach):  # type: ignore[no-untyped-def]
    """Relative bristle deflection ``(N,)`` by Dahl's model, ``dz/dq = (1 - z sign(v)) / reach``.

    Exact between samples. P. R. Dahl, "A solid friction model", The Aerospace Corporation,
    TOR-0158(3107-18)-1 (1968).
    """
    z = np.empty(q.size)
    z[0] = 0.0
    for i in range(1, q.size):
        x = (q[i] - q[i - 1]) / reach
        side = 1.0 if x > 0.0 else -1.0
        z[i] = side + (z[i - 1] - side) * math.exp(-abs(x))
    return z


@njit(cache=True)
def since_reversal(q, least):  # type: ignore[no-untyped-def]
    """Distance ``(N,)`` since the last reversal larger than a least distance."""
    out = np.empty(q.size)
    reversal = extreme = q[0]
    direction = 0.0
    for i in range(q.size):
        x = q[i]
        if direction == 0.0:
            if abs(x - reversal) > least:
                direction = 1.0 if x > reversal else -1.0
                extreme = x
        elif (x - extreme) * direction > 0.0:
            extreme = x
        elif (extreme - x) * direction > least:
            reversal, direction, extreme = extreme, -direction, x
        out[i] = abs(x - reversal)
    return out


@njit(cache=True)
def in_gap(need, period, half, segments):  # type: ignore[no-untyped-def]
    """Relative position ``(N,)`` of a load in its gap (backlash).

    It flies freely from where its acceleration ``need`` changes sign until it meets the other side.
    """
    out = np.empty(need.size)
    for i in range(need.size):
        out[i] = 0.0
    for a, b in segments:
        side = 1.0 if need[a] > 0.0 else -1.0
        x, v, flying = side * half, 0.0, False
        for i in range(a, b):
            if not flying and need[i] * side < 0.0:
                flying, v = True, 0.0
            if flying:
                x += v * period + 0.5 * need[i] * period**2
                v += need[i] * period
                if abs(x) >= half:
                    side = np.sign(x)
                    x, flying = side * half, False
            out[i] = x / half
    return out


def resonating(
    x: Array, segments: Segments, period: float, hertz: Sequence[float], damping: float = 0.05
) -> Array:
    """Return the torque ``(k, N)`` that elastic transmissions add at their antiresonances.

    ``1 / (1 - r^2 + 2 i D r) - 1`` of the load's torque, r the frequency over the antiresonance.
    """
    out = np.zeros((len(hertz), x.size))
    for a, b in segments:
        if b - a <= 20:  # too few for a spectrum
            continue
        # detrended, its ends join
        part = x[a:b]
        part = part - np.linspace(part[0], part[-1], part.size)
        size = fft.next_fast_len(2 * part.size, real=True)
        r = fft.rfftfreq(size, period) / np.array(hertz)[:, None]
        response = 1.0 / (1.0 - r**2 + 2j * damping * r) - 1.0
        out[:, a:b] = fft.irfft(response * fft.rfft(part, size), size)[:, : part.size]
    return out
