"""Every candidate's columns against their written formulas, on a motion that is known exactly."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.diagnostics.candidates import BY_NAME, KINDS, delay_columns
from bayesfric.diagnostics.motion import (
    MotionSignals,
    deflection,
    in_gap,
    resonating,
    scales_of,
    since_reversal,
)
from bayesfric.diagnostics.statistics import TARGET_DELAY
from bayesfric.recordings.filters import derivative, lay_windows, lowpass
from bayesfric.recordings.measurement import Inputs, Signal
from bayesfric.recordings.signals import FAR_DELAYS
from tests.axis import swing
from tests.conftest import made_observation, made_recording
from tests.diagnostics.bench import every_sample

PERIOD, N, RATIO, G = 0.002, 3000, 10.0, 9.80665
LINES = ((0.31, 1.1), (0.9, 0.3), (2.1, 0.1))
TRUTH = {
    "motor.inertia": 2e-3,
    "motor.viscous": 3e-3,
    "load.first_moment": 0.4,
    "load.spring": 0.7,
    "offset": 0.02,
}
FILTERS = {"lowpass": 0.0, "order": 2, "reach": 8, "band": 12.0}


def joint(load=None, **more):
    motor = bf.Element("motor", inertia=True, viscous=True, ratio=RATIO)
    return bf.Joint([motor], load or bf.Load(first_moment=True, spring=True), offset=True, **more)


def exact(time, begin=0.0):
    """Motion, and the motor torque that moves inertia, weight and spring, and all of it."""
    q, qd, qdd = swing(time + begin, LINES)
    weight = (0.4 * G * np.sin(q) + 0.7 * q) / RATIO
    carried = 2e-3 * RATIO * qdd + weight
    return q, qd, qdd, weight, carried, carried + 3e-3 * RATIO * qd + 0.02


def along(chain=None, names=("one", "two"), at=0, settings=FILTERS, steps=(0.0, 0.0)):
    """One of two recordings, the first in two parts; the second is shorter, and another motion."""
    chain = chain or joint()
    observations, recordings = [], []
    for k, (name, n) in enumerate(zip(names, (N, 2000), strict=False)):
        time = PERIOD * np.arange(n) + 0.5
        q, qd, qdd, *_, torque = exact(time, 1.7 * k)
        segments = ((0, 1800), (1800, n)) if k == 0 else ((0, n),)
        taken = lay_windows(np.ones(1), segments, 5, np.ones(n, bool))
        o = made_observation(
            name, time, (q, qd, qdd), torque, taken, 5 * PERIOD, Inputs(recording=name),
            settings=settings, position_step=steps[k],
        )  # fmt: skip
        observations.append(replace(o, measured=1.5 * o.measured))
        recordings.append(made_recording(time, q, torque, PERIOD, segments=segments, name=name))
    values = chain.vector({name: TRUTH.get(name, 0.0) for name in chain.names})
    scales = scales_of(chain, values, observations)
    return MotionSignals(chain, values, observations[at], recordings[at], scales)


def test_scales_are_those_of_all_recordings_together():
    a = along()
    times = [PERIOD * np.arange(n) + 0.5 for n in (N, 2000)]
    both = [exact(t, 1.7 * k) for k, t in enumerate(times)]
    _, qd, _, _, carried, torque = (np.concatenate(x) for x in zip(*both, strict=True))
    at = np.concatenate([np.arange(0, 1800, 5), np.arange(1800, N, 5), N + np.arange(0, 2000, 5)])
    scales = a.scales
    rms = lambda x: np.sqrt(np.mean(x**2))  # noqa: E731
    assert scales.speed == pytest.approx(np.quantile(np.abs(qd[at]), 0.95))
    assert scales.torque == pytest.approx(rms(1.5 * torque[at]))
    assert scales.lost == pytest.approx(rms((torque - carried)[at]))
    assert scales.inertia == pytest.approx(2e-3 * RATIO)
    assert scales.need == pytest.approx(rms(carried) / (2e-3 * RATIO))
    assert along(settings=FILTERS | {"band": 0.0}).scales.band == pytest.approx(0.3 / (5 * PERIOD))
    # a recording has at most sixty of twice the width of a transient
    assert scales.transient_width == 0.25
    assert replace(scales, duration=99.98).transient_width == pytest.approx(99.98 / 120)
    # gravity varies by a thousandth of what is carried
    for moment, weighs in ((1e-9, False), (0.1, True)):
        light = a.chain.vector({**TRUTH, "load.first_moment": moment, "load.spring": 0.0})
        assert scales_of(a.chain, light, [a.o]).weighs == weighs
    # a reversal is a thousandth of the motion, or three steps of the coarser encoder
    span = max(np.ptp(x[0]) for x in both)
    for steps, least in (((0.0, 0.0), 1e-3 * span), ((0.05, 0.1), 0.3)):
        away = np.concatenate([since_reversal(x[0], least) for x in both])
        assert along(steps=steps).scales.reach == pytest.approx(2.0 * np.median(away[at]))


@pytest.mark.parametrize("ratio", [1.0, 10.0])
def test_waves_are_those_that_the_motion_completes(ratio):
    motor = bf.Element("motor", inertia=True, ratio=ratio)
    chain = bf.Joint([motor], bf.Load(first_moment=True))
    time, windows = PERIOD * np.arange(N), every_sample(N)
    sides = {"motor": ratio, "joint": 1.0} if ratio > 1.0 else {"joint": 1.0}
    for span in (0.2, 2.5):
        motion = swing(time, ((0.5, span / 2.0),))
        o = made_observation("one", time, motion, time, windows, PERIOD, Inputs(), settings=FILTERS)
        assert scales_of(chain, np.ones(2), [o]).cycles == {
            f"{k} a turn of the {side}": k * turn
            for k in (*range(1, 9), 12, 18, 24, 36, 48)
            for side, turn in sides.items()
            if k * turn * span >= 2.0 * np.pi
        }


def test_a_sliding_joint_has_no_waves():
    screw = bf.Joint([bf.Element("motor", inertia=True, motion="linear")], bf.Load(motion="linear"))
    time, windows = PERIOD * np.arange(N), every_sample(N)
    motion = swing(time, ((0.5, 9.0),))
    o = made_observation("one", time, motion, time, windows, PERIOD, Inputs(), settings=FILTERS)
    scales, recording = scales_of(screw, np.ones(1), [o]), made_recording(time, o.q, time, PERIOD)
    a = MotionSignals(screw, np.ones(1), o, recording, scales)
    assert not a.scales.cycles
    for name in ("gravity", "inertia_by_angle", "repeating"):
        assert not BY_NAME[name].shapes(a)
    (column,) = BY_NAME["friction_by_angle"].shapes(a)[""]
    np.testing.assert_allclose(column, np.sign(o.qd) * o.q)


def expected(a, k):
    """Columns by the formula of kinds that no setting adds and that have a state or a rate."""
    scales, o, segments = a.scales, a.o, a.recording.segments
    q, qd, qdd, weight, carried, torque = exact(o.stamps, 1.7 * k)
    s, v0 = np.sign(qd), scales.speed
    smooth = lambda x: lowpass(x, segments, 500.0, 4.0, 3)  # noqa: E731
    rate = lambda x: derivative(x, segments, PERIOD, 8)  # noqa: E731
    hertz = [12.0 * x for x in (0.1, 0.13, 0.17, 0.22, 0.29, 0.38, 0.5, 0.65, 0.8, 1.0, 1.3)]
    elastic = {"far above the band": [rate(rate(smooth(carried)))]}
    rows = resonating(carried, segments, PERIOD, hertz)
    elastic |= {f"{f:.3g} Hz": [x] for f, x in zip(hertz, rows, strict=True)}
    gap = {}
    for share in (1 / 3, 2 / 3, 1):
        for times in (0.7, 1.4, 2.8):
            half = scales.need * (times / (2 * np.pi * 12.0)) ** 2 / 2.0
            need = smooth(weight + share * (carried - weight)) / (share * scales.inertia)
            place = in_gap(need, PERIOD, half, np.array(segments))
            label = f"{share:.0%} of the inertia behind it, {half:.2g}"
            gap[label] = [rate(rate(smooth(place)))]
    late = rate(smooth(torque))
    by_angle = np.cos(q) * qdd - np.sin(q) * qd**2 / 2, np.sin(q) * qdd + np.cos(q) * qd**2 / 2
    return {
        "delay": {"": [late], "in one": [late * (k == 0)], "in two": [late * (k == 1)]},
        "stribeck_by_direction": {"": [np.exp(-np.abs(qd) / (v0 / 10.0))]},
        "inertia_by_angle": {"": by_angle},
        "elastic": elastic,
        "backlash": gap,
        "presliding": {
            f"{100 * x:.2g}%": [deflection(q, x * scales.reach) - s]
            for x in (0.003, 0.01, 0.03, 0.1, 0.3)
        },
    }


@pytest.mark.parametrize("k", [0, 1])
def test_columns_are_their_formulas(k):
    """Rates pass the position's filter; kinds with a setting are tested in ``test_findings``."""
    a = along(at=k, settings=FILTERS | {"lowpass": 4.0, "order": 3})
    for name, columns in expected(a, k).items():
        shapes = BY_NAME[name].shapes(a)
        assert list(shapes) == list(columns), name
        for shape, exact_columns in columns.items():
            for column, true in zip(shapes[shape], exact_columns, strict=True):
                size = np.abs(true).max()
                np.testing.assert_allclose(column, true, atol=1e-6 * size, err_msg=name + shape)


def test_friction_is_zero_at_rest_and_positive_where_it_can_only_lose():
    """Columns are finite at rest; what a bristle remembers is friction that is there then, too."""
    a = along()
    resting = np.arange(N) % 9 == 4
    o = replace(a.o, qd=np.where(resting, 0.0, a.o.qd))
    signals = {"q2": Signal(o.stamps, np.sin(2.0 * o.stamps))}
    inputs = Inputs(
        temperature=Signal(o.stamps, 25.0 + 2.0 * o.stamps),
        load_torque=Signal(o.stamps, np.cos(3.0 * o.stamps)),
        others=signals,
    )
    recording, scales = replace(a.recording, inputs=inputs), replace(a.scales, others=("q2",))
    a = replace(a, o=replace(o, inputs=inputs), recording=recording, scales=scales)
    by_size = "presliding", "stribeck_by_direction", "load_loss_by_direction"
    # of which a joint may have less than its model, or lose less as it warms
    either = "coulomb", "viscous", "coulomb_warming", "viscous_warming", "temperature"
    for kind in (kind for kind in KINDS if kind.name != TARGET_DELAY):
        some = np.array([x for columns in kind.shapes(a).values() for x in columns])
        every = np.array([*some, *kind.nuisance(a)])
        assert np.isfinite(every).all(), kind.name
        rests = kind.name in by_size or not every[:, resting].any()
        assert kind.loss == rests, kind.name
        loses = bool((some * o.qd >= 0.0).all())
        assert kind.positive == (loses and kind.name not in either), kind.name


def between(kind, a):
    """Columns of shapes in the middle of each two neighbours of a kind's grid."""
    scales, o = a.scales, a.o
    s, v = np.sign(o.qd), np.abs(o.qd)
    laws = {
        "power": lambda p: s * v**p,
        "stribeck": lambda v0: s * np.exp(-((v / v0) ** 2)),
        "presliding": lambda x: deflection(o.q, x * scales.reach) - s,
        "coulomb_warming": lambda tau: s * np.exp(-o.stamps / tau),
        "viscous_warming": lambda tau: o.qd * np.exp(-o.stamps / tau),
    }[kind]
    grid = [float(x.strip("%")) / (100.0 if "%" in x else 1.0) for x in BY_NAME[kind].shapes(a)]
    assert (np.diff(grid) > 0.0).all()
    return [laws(np.sqrt(x * y)) for x, y in pairwise(grid)]


@pytest.mark.parametrize(
    "kind", ["power", "stribeck", "presliding", "coulomb_warming", "viscous_warming"]
)
def test_a_shape_between_those_of_a_grid_is_represented(kind):
    """One of them and the nuisance columns leave less than a fifth of what the model leaves."""
    a = along()
    s = np.sign(a.o.qd)
    model = [s, a.o.qd, a.o.qdd, np.sin(a.o.q), a.o.q, np.ones_like(s)]
    sets, nuisance = [*BY_NAME[kind].shapes(a).values()], [*BY_NAME[kind].nuisance(a)]
    targets = between(kind, a)
    every = np.column_stack(
        [*model, *nuisance, *(x for columns in sets for x in columns), *targets]
    )
    # a rotation of the samples changes no least squares, and leaves as many rows as columns
    rotated = np.linalg.qr(every / np.linalg.norm(every, axis=0), mode="r").T
    first = len(model) + len(nuisance)
    ends = np.cumsum([first, *map(len, sets)])

    def left(y, x):
        return float(((y - x.T @ np.linalg.lstsq(x.T, y)[0]) ** 2).sum())

    for y in rotated[ends[-1] :]:
        best = min(left(y, rotated[[*range(first), *range(*e)]]) for e in pairwise(ends))
        assert best < 0.2 * left(y, rotated[: len(model)])


def test_signals_that_were_not_recorded_have_no_columns():
    a = along()
    for name in ("temperature", "load_torque", "another_signal"):
        assert not BY_NAME[name].shapes(a)
    # of one recording alone there is one delay
    assert list(BY_NAME["delay"].shapes(along(names=("one",)))) == [""]


def test_a_load_without_weight_has_one_share_of_the_inertia():
    """The others are only a factor, and nothing is carried without any."""
    a = along(joint(bf.Load()))
    assert [share for _, share, _ in a.behind()] == [1.0]
    # whatever the weight of a replicate, which has the shares of the recordings
    weighing = replace(a, scales=replace(a.scales, weighs=True))
    assert [share for _, share, _ in weighing.behind()] == [0.0, 1 / 3, 2 / 3, 1.0]
    assert not BY_NAME["backlash"].shapes(replace(a, scales=replace(a.scales, need=0.0)))


def test_a_far_delay_is_the_change_of_the_torque_since():
    """Exactly, of a torque that is known between samples; zero where then was not recorded."""
    a = along()
    delayed = delay_columns(a)
    assert list(delayed) == [x for d in FAR_DELAYS for x in (d, -d)]
    t, h = a.o.stamps, 1e-5
    *_, now = exact(t)
    for d, (change, rate) in delayed.items():
        *_, then = exact(t - d)
        slope = (exact(t - d + h)[-1] - exact(t - d - h)[-1]) / (2 * h)
        for begin, end in a.recording.segments:
            place = np.arange(begin, end) - d / PERIOD
            known = (place >= begin - 1e-6) & (place <= end - 1 + 1e-6)
            # where samples on either side are there, of which values between two are made
            inner = (place >= begin + 10) & (place <= end - 11)
            part = slice(begin, end)
            np.testing.assert_allclose(change[part][inner], (now - then)[part][inner], atol=1e-6)
            np.testing.assert_allclose(rate[part][inner], slope[part][inner], atol=1e-3)
            assert not change[part][~known].any()
            assert not rate[part][~known].any()
            assert (change[part][np.flatnonzero(known)[[0, -1]]] != 0.0).all()
    assert not delay_columns(replace(a, chain=joint(delay=True)))


@pytest.mark.parametrize("hertz", [1.5, 3.0, 6.0, 0.0])
def test_a_smoothed_log_lacks_the_reversals_of_friction(hertz):
    """The cut-off to compare below is at most a factor of two too low; none where none was."""
    chain = bf.Joint([bf.Element("motor", inertia=True, coulomb="symmetric")])
    time = PERIOD * np.arange(N)
    q, qd, qdd = swing(time, LINES)
    torque = 0.05 * qdd + 0.3 * np.sign(qd)
    whole = ((0, N),)
    o = made_observation(
        "one", time, (q, qd, qdd), lowpass(torque, whole, 500.0, hertz, 4),
        every_sample(N), PERIOD, Inputs(), settings=FILTERS,
    )  # fmt: skip
    values = np.array([0.05, 0.3])
    scales = scales_of(chain, values, [o])
    a = MotionSignals(chain, values, o, made_recording(time, q, torque, PERIOD), scales)
    assert 0.5 * hertz <= a.smoothed_at() <= hertz
