"""A recording's motion, the model's torque along it, and the scales of what may be added to it.

:class:`Along` is what a candidate of :mod:`bayesfric.diagnostics.candidates` makes its columns of.
"""

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

# What a transmission carries: what the load itself takes, and no friction.
_CARRIED = frozenset({"inertia", "first_moment", "gravity_angle", "spring", "spring_cubic", "gain"})
_WEIGHTS = frozenset({"first_moment", "spring", "spring_cubic"})
# Shares of the inertia that lie behind the gearbox; which, a motion without losses does not tell.
_BEHIND = (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
# Turns of the cogging, and antiresonances in bands: grids of shapes.
_CYCLES = (*range(1, 9), 12, 18, 24, 36, 48)
TURNS = {f"{k} a turn of the {side}": (k, side) for k in _CYCLES for side in ("motor", "joint")}
_ANTIRESONANCES = (0.1, 0.13, 0.17, 0.22, 0.29, 0.38, 0.5, 0.65, 0.8, 1.0, 1.3)
# Cut-offs of a low-pass before logging, in bands, and its order.
_CUTOFFS, ORDER = tuple(2.0 ** (-k / 3.0) for k in range(15)), 4
# Share of friction's amplitude above a frequency below which the log holds nothing there. Simulated
# logs smoothed at half the band have 0.05 and less above the band, unsmoothed ones 0.4 and more.
_SILENT = 0.1
# Width of a push in s, at least, and how many of them a recording has at most.
_PUSH, _PUSHES = 0.25, 60
# Speeds, and positions beside a step, that count as one.
_FAST, _STEPS, _REVERSAL = 0.95, 3.0, 1e-3
# What stands for a band where none is compared in, as a share of the rate of the outputs.
_FASTEST = 0.3


@dataclass(frozen=True)
class Scales:
    """What shapes columns: of the recordings that were measured; replicates have the same."""

    speed: float  # Nearly the largest, the 95 % quantile of its absolute value, rad/s or m/s
    reach: float  # Twice the median distance from the last reversal, rad or m
    # Root mean square of the motor torque of inertia, gravity and springs; of the measured one; and
    # of all else in the model's, such as friction. N m or N
    carried: float
    torque: float
    lost: float
    duration: float  # Of the longest recording, s
    # Name, and radians a radian of the joint, of waves that the motion goes through at least once
    cycles: tuple[tuple[str, float], ...]
    transient_width: (
        float  # Width of a push, s: at least 0.25, and a hundred-and-twentieth of duration
    )
    # Of the recordings; and of further columns of any of them
    names: tuple[str, ...]
    others: tuple[str, ...]
    # Motor torque an acceleration of the joint, by least squares, in N m s² and alike
    inertia: float
    # carried over inertia: acceleration that the motor gives the load, root mean square
    need: float
    band: float  # Widest that is compared in, Hz; 0.3 of the slowest rate of outputs where none is
    weighs: bool  # Whether gravity and springs vary by more than a thousandth of carried


def scales_of(chain: Joint, values: Array, observations: Sequence[Observation]) -> Scales:
    """Take the scales of columns from recordings and an estimate.

    Shapes: ``values`` (n_parameters,).
    """
    speed = np.concatenate([np.abs(o.qd[o.filter.centres]) for o in observations])
    each = [_carried(chain, values, o) for o in observations]
    lost = [
        (_torque(chain, values, o) - own)[o.filter.centres]
        for o, own in zip(observations, each, strict=True)
    ]
    carried = np.concatenate(each)
    still_torque = [_carried(chain, values, o, still=True) for o in observations]
    moving = carried - np.concatenate(still_torque)
    qdd = np.concatenate([o.qdd for o in observations])
    inertia = max(float(moving @ qdd) / max(float(qdd @ qdd), 1e-300), 1e-300)
    span = max(float(np.ptp(o.q)) for o in observations)
    still = max(max(_STEPS * o.position_step for o in observations), _REVERSAL * span)
    reach = [since_reversal(o.q, still)[o.filter.centres] for o in observations]
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
            _PUSH, max(float(np.ptp(o.stamps)) for o in observations) / (2 * _PUSHES)
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
    """Motor torque ``(N,)`` of inertia, weight and springs alone; at rest without inertia."""
    kept = [p.quantity in _CARRIED or p.row.option == "signals" for p in chain.parameters]
    at_rest = replace(o, qdd=np.zeros_like(o.q)) if still else o
    return _torque(chain, np.where(kept, values, 0.0), at_rest)


def _torque(chain: Joint, values: Array, o: Observation) -> Array:
    """Motor torque ``(N,)`` of everything that the model has."""
    return inverse_torque(chain, values, o.q, o.qd, o.qdd, inputs=o.inputs, time=o.stamps)


@dataclass(frozen=True, eq=False)
class Along:
    """One recording's motion, and the model's torque along it; signals are ``(N,)``."""

    # The joint and its parameters (n_parameters,)
    chain: Joint
    values: Array
    # The recording as prepared, and as read
    o: Observation
    recording: Measurement
    scales: Scales  # Of all recordings together

    @cached_property
    def torque(self) -> Array:
        """The model's motor torque, N m or N."""
        return _torque(self.chain, self.values, self.o)

    @cached_property
    def torque_rate(self) -> Array:
        """How fast that changes, low-passed first, N m/s or N/s."""
        return self.rate(self.smooth(self.torque))

    @cached_property
    def elastic(self) -> Sets:
        """What an elastic transmission adds, at each antiresonance."""
        return _elastic(self)

    @cached_property
    def direction(self) -> Array:
        """Sign of the speed."""
        return np.sign(self.o.qd)

    @cached_property
    def carried(self) -> Array:
        """Motor torque of inertia, gravity and springs, which a transmission carries, N m or N."""
        return _carried(self.chain, self.values, self.o)

    @cached_property
    def weight(self) -> Array:
        """The same without acceleration: gravity and springs."""
        return _carried(self.chain, self.values, self.o, still=True)

    @cached_property
    def regressors(self) -> Sequence[Array]:
        """Acceleration, sign of the speed, speed, and what gravity and springs take at size one."""
        chain, still = self.chain, replace(self.o, qdd=np.zeros_like(self.o.q))
        sizes = np.eye(len(chain.names))
        at = [i for i, p in enumerate(chain.parameters) if p.quantity in _WEIGHTS]
        return self.o.qdd, self.direction, self.o.qd, *(_torque(chain, sizes[i], still) for i in at)

    def smoothed_at(self) -> float:
        """Cut-off of a low-pass before logging, Hz, or up to half of it; 0 where there is none.

        Above twice that the recorded torque has less than a tenth of what friction's reversals
        have. A log so smoothed tells nothing of friction there, whatever columns make up for it.
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
        """Cut-offs of a low-pass before logging that are tried, Hz, from the band down."""
        return [times * self.scales.band for times in _CUTOFFS]

    @cached_property
    def clock(self) -> Array:
        """Time in durations, from -0.5 to 0.5 of the longest recording."""
        return np.asarray((self.o.stamps - self.o.stamps.mean()) / self.scales.duration)

    def smooth(self, x: Array) -> Array:
        """Low-pass signals ``(..., N)`` as the position is."""
        told = self.o.settings
        fs = 1.0 / self.recording.period
        return np.asarray(
            lowpass(x, self.recording.segments, fs, float(told["lowpass"]), int(told["order"]))
        )

    def rate(self, x: Array) -> Array:
        """Differentiate signals ``(..., N)`` by time, as the position is."""
        reach = int(self.o.settings["reach"])
        return derivative(x, self.recording.segments, self.recording.period, reach)

    def behind(self) -> Iterator[tuple[str, float, Array]]:
        """Give what a gearbox carries with each share of the inertia behind it.

        Shapes: ``carried : ndarray`` (N,).
        """
        for share in _BEHIND if self.scales.weighs else (1.0,):
            carried = self.weight + share * (self.carried - self.weight)
            yield f"{share:.0%} of the inertia behind it", share, carried

    def state(self, transmitted: Array) -> State:
        """Give the state of one element that stands for all, at the joint's speed.

        It carries the torque ``transmitted`` ``(N,)``; gravity is left out.
        """
        o = self.o
        still = np.zeros_like(o.q)
        return State(o.q, o.qd, o.qdd, self.direction, o.stamps, transmitted, still)

    @property
    def sizes(self) -> Sizes:
        """Sizes by which grids of shapes are scaled: torque's rms, speed and duration."""
        one = self.scales
        return Sizes(one.torque, one.speed, 1.0, 1.0, 1.0, one.duration)


def _elastic(a: Along) -> Sets:
    hertz, r = [times * a.scales.band for times in _ANTIRESONANCES], a.recording
    rows = resonating(a.carried, r.segments, r.period, hertz)
    found = {f"{f:.3g} Hz": [row] for f, row in zip(hertz, rows, strict=True)}
    return {"far above the band": [a.rate(a.rate(a.smooth(a.carried)))]} | found
