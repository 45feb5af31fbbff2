"""What else could explain a torque: one table, a row each.

A candidate is a kind of effect and the columns that it adds to the model's own, functions of the
motion and of the model's torque along it. An unknown shape has a set of columns for each value of
a grid; nuisance columns only represent shapes between those of the grid.

Load-dependent friction and backlash depend on how much of the inertia is behind the gearbox, which
a motion without losses does not show: up to four shares are tried.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np
from numpy.typing import DTypeLike

from bayesfric.diagnostics.motion import ORDER, MotionSignals, deflection, in_gap
from bayesfric.diagnostics.statistics import DELAYS, Key
from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import later, lowpass
from bayesfric.recordings.signals import (
    FAR_DELAYS,
    Signals,
    command_rate,
    target_torque,
)

# Columns (N,) of each shape, by its name.
Sets = Mapping[str, Sequence[Array]]

SMOOTHED = "smoothed"


@dataclass(frozen=True)
class Kind:
    """A row of the table of candidates."""

    name: str  # key of ``words.toml``
    # a column (N,), or several, or those of each shape; no shape if the recording has none
    columns: Callable[[MotionSignals], Array | Sequence[Array] | Sets]
    # nuisance columns for shapes between those of the grid
    nuisance: Callable[[MotionSignals], Sequence[Array]] = lambda _: ()
    option: str = ""  # of the mechanism's configuration, that adds it; empty if none does
    choice: str | bool = True
    # whether its coefficients must be positive, as those of a growing loss
    positive: bool = False
    other: str = ""  # choice of the option that may be negative
    loss: bool = False  # whether it is friction, and so scaled by the model's losses
    # whether it is a function of speed, which the friction law absorbs
    of_speed: bool = False
    # whether it depends on where the joint stands, which an integrated velocity does not show
    of_position: bool = False
    # whether it is a fault of the recorded torque, which no term models
    of_recording: bool = False
    # least share of the torque's rms
    least: float = 0.0

    def shapes(self, motion: MotionSignals) -> Sets:
        """Return its columns ``(N,)`` by shape; a kind of one shape has an empty name for it."""
        columns = self.columns(motion)
        if isinstance(columns, Mapping):
            return columns
        return {"": [columns] if isinstance(columns, np.ndarray) else columns}


def _delay(m: MotionSignals) -> Sets:
    if m.chain.by_target:  # which comes with the position
        return {}
    names = m.scales.names if len(m.scales.names) > 1 else ()
    by_recording = {f"in {name}": [m.torque_rate * float(name == m.o.name)] for name in names}
    return {"": [m.torque_rate], **by_recording}


def _of_table(name: str, m: MotionSignals) -> Sets:
    """Take a column from the table of quantities, at every value of its shape."""
    row, state = QUANTITIES[name], m.state(m.carried)
    assert row.column is not None
    if not row.shape:
        return {"": [row.column(state)]}
    tries = QUANTITIES[row.shape].tries
    assert tries is not None
    return {f"{x:.3g}": [row.column(state, x)] for x in tries(m.sizes)}


def _stribeck(m: MotionSignals) -> Sets:
    tries = QUANTITIES["stribeck_velocity"].tries
    assert tries is not None
    return {f"{v:.3g}": [m.direction * np.exp(-((m.o.qd / v) ** 2))] for v in tries(m.sizes)}


def _intermediate_powers(m: MotionSignals) -> Sequence[Array]:
    v = np.abs(m.o.qd) / m.scales.speed
    return [m.direction * v**0.25, m.direction * v**0.75]


def _by_load(
    column: Callable[[MotionSignals, Array], Sequence[Array]],
) -> Callable[[MotionSignals], Sets]:
    return lambda m: {label: column(m, carried) for label, _, carried in m.behind()}


def _by_power(m: MotionSignals, carried: Array) -> Sequence[Array]:
    """Return the loss where the motor drives, and where the load does."""
    rows = QUANTITIES["load_drive"], QUANTITIES["load_back"]
    return [row.column(m.state(carried)) for row in rows if row.column]


def _backlash(m: MotionSignals) -> Sets:
    """Return the load's acceleration in the gap, for shares of inertia behind it and gap widths.

    Half a gap is ``a t^2 / 2``, of the typical acceleration a and of t = 0.7, 1.4 and 2.8 over 2 pi
    times the band in Hz.
    """
    segments = np.array(m.recording.segments)
    places: dict[str, Array] = {}
    for label, share, carried in m.behind() if m.scales.need else ():
        if share:
            need = m.smooth(carried) / (share * m.scales.inertia)
            for times in (0.7, 1.4, 2.8):
                half = 0.5 * m.scales.need * (times / (2.0 * np.pi * m.scales.band)) ** 2
                places[f"{label}, {half:.2g}"] = in_gap(need, m.recording.period, half, segments)
    if not places:
        return {}
    columns = m.rate(m.rate(m.smooth(np.array([*places.values()]))))
    return {key: [column] for key, column in zip(places, columns, strict=True)}


def _presliding(m: MotionSignals) -> Sets:
    """Return the deflection of bristles (Dahl), at shares of the distance between reversals."""
    return {
        f"{100 * x:.2g}%": [deflection(m.o.q, x * m.scales.reach) - m.direction]
        for x in (0.003, 0.01, 0.03, 0.1, 0.3)
        if m.scales.reach  # points at constant speed have no path
    }


def _rotary(m: MotionSignals, *columns: Array) -> Sets:
    """Return columns ``(N,)`` that a turning joint has."""
    return {"": columns} if m.chain.load.motion == "rotary" else {}


def _inertia_by_angle(m: MotionSignals) -> Sets:
    sine, cosine, turning = np.sin(m.o.q), np.cos(m.o.q), 0.5 * m.o.qd**2
    return _rotary(m, cosine * m.o.qdd - sine * turning, sine * m.o.qdd + cosine * turning)


def _waves(m: MotionSignals, factor: Array | float = 1.0) -> Sets:
    """Return sine and cosine of the position, times a factor: cogging, or a gearbox's waves."""
    return {name: [factor * wave for wave in pair] for name, pair in m.waves.items()}


def _friction_by_angle(m: MotionSignals) -> Sets:
    s, q = m.direction, m.o.q
    if m.chain.load.motion != "rotary":
        return {"": [s * q]}
    # once a turn of the joint also for less than a turn
    return {"1 a turn of the joint": [s * np.sin(q), s * np.cos(q)], **_waves(m, s)}


def _load_torque(m: MotionSignals) -> Sets:
    signal = m.o.inputs.load_torque
    return {} if signal is None else {"": [signal.at(m.o.stamps)]}


def _temperature(m: MotionSignals) -> Sets:
    if m.o.inputs.temperature is None:
        return {}
    warm = m.o.inputs.temperature.at(m.o.stamps)
    return {"": [m.direction * warm, m.o.qd * warm]}


def _another_signal(m: MotionSignals) -> Sets:
    """Return further recorded columns, their rates, and the rates of those."""
    columns = {}
    for name in m.scales.others:
        signal = m.recording.inputs.others.get(name)
        x = np.zeros_like(m.o.q) if signal is None else m.smooth(signal.at(m.o.stamps))
        columns[name] = [x, m.rate(x), m.rate(m.rate(x))]
    return columns


def _smoothed(m: MotionSignals) -> Sets:
    """Return the effect of a low-passed log on Coulomb friction; other terms are smooth already."""
    segments, fs, way = m.recording.segments, 1.0 / m.recording.period, m.direction
    return {f"{f:.3g} Hz": [lowpass(way, segments, fs, f, ORDER) - way] for f in m.cutoffs}


def _current_column(m: MotionSignals) -> Sets:
    """Return regressors times the difference of another current.

    The supply's current is the winding's times the duty cycle, which depends on speed and torque.
    Regressors replace the model's torque, whose estimate is then wrong.
    """
    regressors, v = m.regressors, m.o.qd
    signs = [np.sign(x) for x in (regressors[0], regressors[1], *regressors[3:])]
    return {
        "the supply's": [*(x * np.abs(v) for x in regressors), m.torque * np.abs(m.torque)],
        "the supply's without a sign": [*(x * v for x in regressors), m.torque**2],
        'signed by power (sign = "by-speed")': [x * m.direction for x in regressors],
        "without a sign": [x * sign for sign in signs for x in regressors],
    }


_friction = partial(Kind, loss=True)
_over_speed = partial(Kind, loss=True, of_speed=True)
_fault = partial(Kind, of_recording=True)

# fmt: off
KINDS: tuple[Kind, ...] = (
    Kind("delay", _delay, option="delay",
         nuisance=lambda m: [] if m.chain.by_target else [m.rate(m.torque_rate)]),
    Kind("target_delay", lambda _: {}, option="delay"),  # see disturbances.delay_columns
    Kind("torque_constant", lambda m: m.torque),
    Kind("torque_by_sign", lambda m: np.abs(m.torque), nuisance=lambda m: [m.torque**2]),
    Kind("saturation", lambda m: m.torque * np.abs(m.torque),
         nuisance=lambda m: [m.torque**3, m.torque**5]),
    Kind("offset", lambda m: np.ones_like(m.o.q), option="offset"),
    _over_speed("coulomb", lambda m: m.direction, option="coulomb", choice="symmetric"),
    _over_speed("viscous", lambda m: m.o.qd, option="viscous"),
    _over_speed("viscous_by_direction", lambda m: np.abs(m.o.qd),
                option="viscous", choice="by-direction"),
    _over_speed("quadratic", partial(_of_table, "quadratic"), option="quadratic", positive=True,
                nuisance=lambda m: [m.o.qd * np.abs(m.o.qd) ** 0.5, m.o.qd**3]),
    _over_speed("power", partial(_of_table, "power"), _intermediate_powers,
                option="power", positive=True),
    _over_speed("stribeck", _stribeck, option="stribeck", positive=True, other="either"),
    _over_speed("stribeck_by_direction",
                lambda m: np.exp(-np.abs(m.o.qd) / (0.1 * m.scales.speed))),
    _friction("load_loss", _by_load(lambda m, carried: [np.abs(carried) * m.direction]),
              option="load_loss", choice="one", positive=True),
    _friction("load_loss_by_power", _by_load(_by_power),
              option="load_loss", choice="two", positive=True),
    _friction("load_loss_by_direction", _by_load(lambda _, carried: [np.abs(carried)]),
              option="load_direction"),
    _friction("load_square", _by_load(lambda m, carried: [carried**2 * m.direction]),
              option="load_square", positive=True),
    _friction("load_speed", _by_load(lambda m, carried: [np.abs(carried) * m.o.qd]),
              option="load_speed", positive=True),
    Kind("inertia", lambda m: m.o.qdd, option="inertia"),
    Kind("gravity", lambda m: _rotary(m, np.sin(m.o.q), np.cos(m.o.q)), option="gravity_angle",
         of_position=True),
    Kind("spring", partial(_of_table, "spring"), option="spring", of_position=True),
    _friction("friction_by_angle", _friction_by_angle, option="periodic_friction",
              of_position=True),
    Kind("inertia_by_angle", _inertia_by_angle, of_position=True),
    Kind("repeating", _waves, option="cogging", of_position=True),
    Kind("elastic", lambda m: m.elastic,
         nuisance=lambda m: [*m.rate(np.concatenate([*m.elastic.values()]))]),
    Kind("backlash", _backlash),
    _over_speed("presliding", _presliding),
    Kind("drift", lambda m: m.clock, nuisance=lambda m: [m.clock**2, m.clock**3]),
    _friction("coulomb_warming", partial(_of_table, "coulomb_warming"),
              option="warming", choice="constant",
              nuisance=lambda m: [m.clock * m.direction, m.clock**2 * m.direction]),
    _friction("viscous_warming", partial(_of_table, "viscous_warming"),
              option="warming", choice="viscous",
              nuisance=lambda m: [m.clock * m.o.qd, m.clock**2 * m.o.qd]),
    _friction("temperature", _temperature, option="temperature", choice="both"),
    Kind("load_torque", _load_torque),
    Kind("another_signal", _another_signal),
    _fault(SMOOTHED, _smoothed),
    # so many columns always fit a little: simulated recordings of another current have at least 0.4
    # of the torque, measured ones of the right current up to 0.14
    _fault("current_column", _current_column, least=0.3),
    _fault("torque_constant_by_angle", lambda m: _waves(m, m.torque), of_position=True),
)
# fmt: on
BY_NAME: Mapping[str, Kind] = {kind.name: kind for kind in KINDS}


def columns_along(motion: MotionSignals) -> Iterator[tuple[Key, Array]]:
    """Yield the columns ``(N,)`` of all candidates along a motion."""
    for kind in KINDS:
        if kind.of_recording and motion.chain.closed_loop and kind.name != "torque_constant":
            continue  # nothing was recorded of a torque
        size = 0.0 if kind.of_position and motion.recording.integrated else 1.0
        for shape, columns in kind.shapes(motion).items():
            for number, column in enumerate(columns):
                yield Key(kind.name, shape, number), size * column
        for number, column in enumerate(kind.nuisance(motion)):
            yield Key(kind.name, "", number, nuisance=True), column
    for delay, pair in delay_columns(motion).items():
        far = DELAYS[motion.chain.by_target]
        for number, column in enumerate(pair):
            yield Key(far, f"by about {delay:.2g} s", number, delay=delay), column


def delay_columns(m: MotionSignals) -> Mapping[float, tuple[Array, Array]]:
    """Return the change of the torque over each far delay, and its rate then, ``(N,)`` each.

    A position that is late by d belongs to the torque ``y(t - d)``, see
    :mod:`bayesfric.recordings.signals`.
    """
    if m.chain.delay:
        return {}
    if m.chain.by_target:
        command, r = target_torque(m.recording), m.recording
        # from 0.01 s one linear column no longer suffices
        return {
            d: (m.smooth(command - target_torque(r, d)), command_rate(m.o, r, d))
            for d in (0.01, *FAR_DELAYS)
        }
    torque = m.smooth(m.o.torque)
    delays = [d for late in FAR_DELAYS for d in (late, -late)]
    delayed, is_known = np.empty((len(delays), torque.size)), np.zeros((len(delays), torque.size))
    for delay, row, valid in zip(delays, delayed, is_known, strict=True):
        samples = delay / m.recording.period
        for begin, end in m.recording.segments:
            row[begin:end] = later(torque[begin:end], samples)
            valid[begin + math.ceil(max(samples, 0.0)) : end + math.floor(min(samples, 0.0))] = 1.0
    pairs = zip((torque - delayed) * is_known, m.rate(delayed) * is_known, strict=True)
    return dict(zip(delays, pairs, strict=True))


def filtered_columns(
    o: Signals, columns: Iterable[tuple[Key, Array]], dtype: DTypeLike = np.float64
) -> tuple[list[Key], Array]:
    """Filter columns ``(N,)`` by key to ``(M, m)``, each contiguous; not finite counts as zero."""
    keys, rows, remaining = [], [], iter(columns)
    while part := list(islice(remaining, 32)):  # some at once
        keys += [key for key, _ in part]
        unfiltered = np.array([column for _, column in part])
        filtered = o.filter.apply(unfiltered)
        if not np.isfinite(filtered).all():
            filtered = o.filter.apply(np.where(np.isfinite(unfiltered), unfiltered, 0.0))
        rows.append(filtered.astype(dtype))
    return keys, np.concatenate(rows).T
