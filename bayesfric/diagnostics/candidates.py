"""What else could explain a torque: one table, a row each.

A candidate is a kind of effect and the columns that it adds to the model's own, functions of the
motion and of the model's torque along it. An unknown shape has a set of columns for each value of
a grid; nuisance columns only represent shapes between those of the grid.

Columns at the joint's position q and speed v, with s = sign(v), T the model's motor torque, Tc that
of inertia, gravity and springs alone (the load that a transmission carries), t the time:

==========================  ================================================================
kind                        columns
==========================  ================================================================
delay                       dT/dt, of all recordings or one
target_delay                change by a late target that the torque is computed from
torque_constant, offset     T; 1
torque_by_sign, saturation  abs(T); T abs(T)
coulomb, viscous            s; v
viscous_by_direction        abs(v)
quadratic, power            v abs(v); s abs(v)^p
stribeck                    s exp(-(v/v0)^2)
stribeck_by_direction       exp(-abs(v)/v1), v1 a tenth of nearly the largest speed
load_loss                   s abs(Tc)
load_loss_by_power          the same where the motor drives, and where the load does
load_loss_by_direction      abs(Tc)
load_square, load_speed     s Tc^2; v abs(Tc)
inertia                     dv/dt
gravity                     sin q and cos q
spring                      that of the table of quantities
friction_by_angle           s sin kq and s cos kq; of a sliding joint s q
inertia_by_angle            cos q dv/dt - v^2/2 sin q and sin q dv/dt + v^2/2 cos q
repeating                   sin kq and cos kq: cogging, or the waves of a gearbox
elastic                     Tc through the resonance of an elastic transmission, less Tc
backlash                    acceleration of a load that flies through its gap
presliding                  bristle deflection (Dahl) less s
drift                       t
coulomb_warming             s (1 - exp(-t/tau)); of viscous_warming v in place of s
temperature                 s and v times the recorded temperature
load_torque                 a recorded torque on the load
another_signal              a further recorded column, its rate, and the rate of that
smoothed                    s low-passed to and fro, less s
current_column              x abs(v), T abs(T); x v, T^2; x s; x sign(y), of regressors x and y:
                            dv/dt, s, v, and what gravity and springs take
torque_constant_by_angle    T sin kq and T cos kq
==========================  ================================================================

Load-dependent friction and backlash depend on how much of the inertia is behind the gearbox, which
a motion without losses does not show: up to four shares are tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.diagnostics.along import ORDER, Along, Sets
from bayesfric.diagnostics.disturbances import DELAYS, delay_columns
from bayesfric.diagnostics.states import deflection, in_gap
from bayesfric.diagnostics.statistics import Key
from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import lowpass
from bayesfric.recordings.observation import Observation

SMOOTHED = "smoothed"

_REACHES = (0.003, 0.01, 0.03, 0.1, 0.3)
_FLIGHTS = (0.7, 1.4, 2.8)
# Columns filtered at once: one cache line.
_LINE = 8
# Least share of the torque from another current: simulated ones have at least 0.4, measured
# recordings of the right current up to 0.14.
_ANOTHER = 0.3


@dataclass(frozen=True)
class Kind:
    """A row of the table of candidates."""

    name: str  # key of ``words.toml``
    # columns (N,) of each shape, by its name; empty if the recording has none
    columns: Callable[[Along], Sets]
    # nuisance columns for shapes between those of the grid
    nuisance: Callable[[Along], Sequence[Array]] = lambda _: ()
    # option of the mechanism's configuration that adds it; empty if none does
    option: str = ""
    choice: str | bool = True
    # whether its coefficients must be positive, as those of a growing loss
    positive: bool = False
    other: str = ""  # choice of the option that may be negative
    loss: bool = False  # whether it is friction, and so scaled by the model's losses
    # whether it is a function of speed, which the friction law absorbs
    of_speed: bool = False
    # whether it is a fault of the recorded torque, which no term models
    of_recording: bool = False
    # least share of the torque's rms: another current differs by about as much as the torque, and
    # so many columns always fit a little
    least: float = 0.0


def _delay(a: Along) -> Sets:
    rate = a.torque_rate
    if a.chain.by_target:  # which comes with the position
        return {}
    if len(a.scales.names) == 1:
        return {"": [rate]}
    by_recording = {f"in {name}": [rate * float(name == a.o.name)] for name in a.scales.names}
    return {"": [rate], **by_recording}


def _single(column: Callable[[Along], Array]) -> Callable[[Along], Sets]:
    return lambda a: {"": [column(a)]}


def _term(name: str) -> Callable[[Along], Sets]:
    """Take a column from the table of quantities, at every value of its shape."""
    row = QUANTITIES[name]

    def columns(a: Along) -> Sets:
        assert row.column is not None
        state = a.state(a.carried)
        if not row.shape:
            return {"": [row.column(state)]}
        tries = QUANTITIES[row.shape].tries
        assert tries is not None
        return {f"{x:.3g}": [row.column(state, x)] for x in tries(a.sizes)}

    return columns


def _stribeck(a: Along) -> Sets:
    tries = QUANTITIES["stribeck_velocity"].tries
    assert tries is not None
    return {f"{v:.3g}": [a.direction * np.exp(-((a.o.qd / v) ** 2))] for v in tries(a.sizes)}


def _intermediate_powers(a: Along) -> Sequence[Array]:
    v = np.abs(a.o.qd) / a.scales.speed
    return [a.direction * v**0.25, a.direction * v**0.75]


def _loads(column: Callable[[Along, Array], Sequence[Array]]) -> Callable[[Along], Sets]:
    return lambda a: {label: column(a, carried) for label, _, carried in a.behind()}


def _by_power(a: Along, carried: Array) -> Sequence[Array]:
    state = a.state(carried)
    rows = QUANTITIES["load_drive"], QUANTITIES["load_back"]
    return [row.column(state) for row in rows if row.column]


def _backlash(a: Along) -> Sets:
    """Return the load's acceleration in the gap, for shares of inertia behind it and gap widths.

    Half a gap is ``a t^2 / 2``, of the typical acceleration a and of t = 0.7, 1.4 and 2.8 over 2 pi
    times the band in Hz.
    """
    segments = np.array(a.recording.segments)
    flights: dict[str, Array] = {}
    for label, share, carried in a.behind():
        if not (share and a.scales.need):
            continue
        need = a.smooth(carried) / (share * a.scales.inertia)
        for times in _FLIGHTS:
            half = 0.5 * a.scales.need * (times / (2.0 * np.pi * a.scales.band)) ** 2
            flights[f"{label}, {half:.2g}"] = in_gap(need, a.recording.period, half, segments)
    if not flights:
        return {}
    columns = a.rate(a.rate(a.smooth(np.array([*flights.values()]))))
    return {key: [column] for key, column in zip(flights, columns, strict=True)}


def _presliding(a: Along) -> Sets:
    q, way = a.o.q, a.direction
    return {f"{100 * x:.2g}%": [deflection(q, x * a.scales.reach) - way] for x in _REACHES}


def _gravity(a: Along) -> Sets:
    if a.chain.load.motion != "rotary":
        return {}
    return {"": [np.sin(a.o.q), np.cos(a.o.q)]}


def _inertia_by_angle(a: Along) -> Sets:
    if a.chain.load.motion != "rotary":
        return {}
    sine, cosine, turning = np.sin(a.o.q), np.cos(a.o.q), 0.5 * a.o.qd**2
    return {"": [cosine * a.o.qdd - sine * turning, sine * a.o.qdd + cosine * turning]}


def _repeating(a: Along) -> Sets:
    return {name: [np.sin(k * a.o.q), np.cos(k * a.o.q)] for name, k in a.scales.cycles}


def _friction_by_angle(a: Along) -> Sets:
    if a.chain.load.motion != "rotary":
        return {"": [a.direction * a.o.q]}
    once = {"1 a turn of the joint": [np.sin(a.o.q), np.cos(a.o.q)]}  # also for less than a turn
    waves = once | {name: [*columns] for name, columns in _repeating(a).items()}
    return {name: [a.direction * x for x in columns] for name, columns in waves.items()}


def _load_torque(a: Along) -> Sets:
    signal = a.o.inputs.load_torque
    return {} if signal is None else {"": [signal.at(a.o.stamps)]}


def _temperature(a: Along) -> Sets:
    if a.o.inputs.temperature is None:
        return {}
    warm = a.o.inputs.temperature.at(a.o.stamps)
    return {"": [a.direction * warm, a.o.qd * warm]}


def _another_signal(a: Along) -> Sets:
    columns = {}
    for name in a.scales.others:
        signal = a.recording.inputs.others.get(name)
        x = np.zeros_like(a.o.q) if signal is None else a.smooth(signal.at(a.o.stamps))
        columns[name] = [x, a.rate(x), a.rate(a.rate(x))]
    return columns


def _smoothed(a: Along) -> Sets:
    """Return the effect of a low-passed log on Coulomb friction; other terms are smooth already."""
    segments, fs, way = a.recording.segments, 1.0 / a.recording.period, a.direction
    return {f"{f:.3g} Hz": [lowpass(way, segments, fs, f, ORDER) - way] for f in a.cutoffs}


def _current_column(a: Along) -> Sets:
    """Return regressors times the difference of another current.

    The supply's current is the winding's times the duty cycle, which depends on speed and torque.
    Regressors replace the model's torque, whose estimate is then wrong.
    """
    regressors, v = a.regressors, a.o.qd
    signs = [np.sign(x) for x in (regressors[0], regressors[1], *regressors[3:])]
    return {
        "the supply's": [*(x * np.abs(v) for x in regressors), a.torque * np.abs(a.torque)],
        "the supply's without a sign": [*(x * v for x in regressors), a.torque**2],
        "signed by power": [x * a.direction for x in regressors],
        "without a sign": [x * sign for sign in signs for x in regressors],
    }


def _torque_constant_by_angle(a: Along) -> Sets:
    return {name: [a.torque * x for x in columns] for name, columns in _repeating(a).items()}


KINDS: tuple[Kind, ...] = (
    Kind(
        "delay",
        _delay,
        lambda a: [] if a.chain.by_target else [a.rate(a.torque_rate)],
        option="delay",
    ),
    Kind("target_delay", lambda _: {}, option="delay"),  # see disturbances.delay_columns
    Kind("torque_constant", _single(lambda a: a.torque)),
    Kind("torque_by_sign", _single(lambda a: np.abs(a.torque)), lambda a: [a.torque**2]),
    Kind(
        "saturation",
        _single(lambda a: a.torque * np.abs(a.torque)),
        lambda a: [a.torque**3, a.torque**5],
    ),
    Kind("offset", _single(lambda a: np.ones_like(a.o.q)), option="offset"),
    Kind(
        "coulomb",
        _single(lambda a: a.direction),
        option="coulomb",
        choice="symmetric",
        loss=True,
        of_speed=True,
    ),
    Kind("viscous", _single(lambda a: a.o.qd), option="viscous", loss=True, of_speed=True),
    Kind(
        "viscous_by_direction",
        _single(lambda a: np.abs(a.o.qd)),
        option="viscous",
        choice="by-direction",
        loss=True,
        of_speed=True,
    ),
    Kind(
        "quadratic",
        _term("quadratic"),
        lambda a: [a.o.qd * np.abs(a.o.qd) ** 0.5, a.o.qd**3],
        option="quadratic",
        positive=True,
        loss=True,
        of_speed=True,
    ),
    Kind(
        "power",
        _term("power"),
        _intermediate_powers,
        option="power",
        positive=True,
        loss=True,
        of_speed=True,
    ),
    Kind(
        "stribeck",
        _stribeck,
        option="stribeck",
        positive=True,
        other="either",
        loss=True,
        of_speed=True,
    ),
    Kind(
        "stribeck_by_direction",
        _single(lambda a: np.exp(-np.abs(a.o.qd) / (0.1 * a.scales.speed))),
        loss=True,
        of_speed=True,
    ),
    Kind(
        "load_loss",
        _loads(lambda a, carried: [np.abs(carried) * a.direction]),
        option="load_loss",
        choice="one",
        positive=True,
        loss=True,
    ),
    Kind(
        "load_loss_by_power",
        _loads(_by_power),
        option="load_loss",
        choice="two",
        positive=True,
        loss=True,
    ),
    Kind(
        "load_loss_by_direction",
        _loads(lambda _, carried: [np.abs(carried)]),
        option="load_direction",
        loss=True,
    ),
    Kind(
        "load_square",
        _loads(lambda a, carried: [carried**2 * a.direction]),
        option="load_square",
        positive=True,
        loss=True,
    ),
    Kind(
        "load_speed",
        _loads(lambda a, carried: [np.abs(carried) * a.o.qd]),
        option="load_speed",
        positive=True,
        loss=True,
    ),
    Kind("inertia", _single(lambda a: a.o.qdd), option="inertia"),
    Kind("gravity", _gravity, option="gravity_angle"),
    Kind("spring", _term("spring"), option="spring"),
    Kind("friction_by_angle", _friction_by_angle, option="periodic_friction", loss=True),
    Kind("inertia_by_angle", _inertia_by_angle),
    Kind("repeating", _repeating, option="cogging"),
    Kind(
        "elastic", lambda a: a.elastic, lambda a: [*a.rate(np.concatenate([*a.elastic.values()]))]
    ),
    Kind("backlash", _backlash),
    Kind("presliding", _presliding, loss=True, of_speed=True),
    Kind("drift", _single(lambda a: a.clock), lambda a: [a.clock**2, a.clock**3]),
    Kind(
        "coulomb_warming",
        _term("coulomb_warming"),
        lambda a: [a.clock * a.direction, a.clock**2 * a.direction],
        option="warming",
        choice="constant",
        loss=True,
    ),
    Kind(
        "viscous_warming",
        _term("viscous_warming"),
        lambda a: [a.clock * a.o.qd, a.clock**2 * a.o.qd],
        option="warming",
        choice="viscous",
        loss=True,
    ),
    Kind("temperature", _temperature, option="temperature", choice="both", loss=True),
    Kind("load_torque", _load_torque),
    Kind("another_signal", _another_signal),
    Kind(SMOOTHED, _smoothed, of_recording=True),
    Kind("current_column", _current_column, of_recording=True, least=_ANOTHER),
    Kind("torque_constant_by_angle", _torque_constant_by_angle, of_recording=True),
)
BY_NAME: Mapping[str, Kind] = {kind.name: kind for kind in KINDS}


def columns_along(along: Along) -> Iterator[tuple[Key, Array]]:
    """Yield the columns ``(N,)`` of all candidates along a motion."""
    for kind in KINDS:
        for shape, columns in kind.columns(along).items():
            for number, column in enumerate(columns):
                yield Key(kind.name, shape, number), column
        for number, column in enumerate(kind.nuisance(along)):
            yield Key(kind.name, "", number, nuisance=True), column
    for delay, columns in delay_columns(along).items():
        far = DELAYS[along.chain.by_target]
        for number, column in enumerate(columns):
            yield Key(far, f"by about {delay:.2g} s", number, delay=delay), column


def filtered_columns(o: Observation, columns: Sequence[Array]) -> Array:
    """Filter columns ``(N,)``, skipping those that are zero."""
    nonzero = [i for i, column in enumerate(columns) if column.any()]
    out = np.zeros((o.filter.n_outputs, len(columns)))
    for first in range(0, len(nonzero), _LINE):
        block = nonzero[first : first + _LINE]
        raw = np.stack([columns[i] for i in block], axis=1)
        raw[~np.isfinite(raw)] = 0.0
        out[:, block] = o.filter.apply(raw.T).T
    return out
