"""Every candidate's columns against their written formulas, on a motion that is known exactly."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.diagnostics.along import Along, scales_of
from bayesfric.diagnostics.candidates import BY_NAME, KINDS
from bayesfric.diagnostics.disturbances import TARGET_DELAY, delay_columns
from bayesfric.diagnostics.states import deflection, in_gap, resonating, since_reversal
from bayesfric.recordings.filters import ParallelFilter, derivative, lay_windows, lowpass
from bayesfric.recordings.measurement import Inputs, Signal
from bayesfric.recordings.observation import FAR_DELAYS
from tests.axis import swing
from tests.conftest import made_observation, made_recording

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


def along(
    chain=None, names=("one", "two"), at=0, settings=FILTERS, steps=(0.0, 0.0), inputs=(), **more
):
    """One of two recordings, the first in two parts; the second is shorter, and another motion."""
    chain = chain or joint()
    observations, recordings = [], []
    for k, (name, n) in enumerate(zip(names, (N, 2000), strict=False)):
        time = PERIOD * np.arange(n) + 0.5
        q, qd, qdd, *_, torque = exact(time, 1.7 * k)
        segments = ((0, 1800), (1800, n)) if k == 0 else ((0, n),)
        taken = lay_windows(np.ones(1), segments, 5, np.ones(n, bool))
        given = inputs[k] if inputs else Inputs(recording=name)
        o = made_observation(
            name, time, (q, qd, qdd), torque, taken, 5 * PERIOD, given,
            settings=settings, position_step=steps[k],
        )  # fmt: skip
        observations.append(replace(o, measured=1.5 * o.measured))
        recordings.append(
            made_recording(
                time, q, torque, PERIOD, segments=segments, name=name, inputs=given, **more
            )
        )
    values = chain.vector({name: TRUTH.get(name, 0.0) for name in chain.names})
    scales = scales_of(chain, values, observations)
    return Along(chain, values, observations[at], recordings[at], scales)


def test_scales_are_those_of_all_recordings_together():
    a = along()
    times = [PERIOD * np.arange(n) + 0.5 for n in (N, 2000)]
    both = [exact(t, 1.7 * k) for k, t in enumerate(times)]
    _, qd, _, _, carried, torque = (np.concatenate(x) for x in zip(*both, strict=True))
    at = np.concatenate([np.arange(0, 1800, 5), np.arange(1800, N, 5), N + np.arange(0, 2000, 5)])
    one = a.scales
    rms = lambda x: np.sqrt(np.mean(x**2))  # noqa: E731
    assert one.speed == pytest.approx(np.quantile(np.abs(qd[at]), 0.95))
    assert one.carried == pytest.approx(rms(carried))
    assert one.torque == pytest.approx(rms(1.5 * torque[at]))
    assert one.lost == pytest.approx(rms((torque - carried)[at]))
    assert one.duration == pytest.approx(PERIOD * (N - 1))
    assert one.inertia == pytest.approx(2e-3 * RATIO)
    assert one.need == pytest.approx(rms(carried) / (2e-3 * RATIO))
    assert one.names == ("one", "two")
    span = max(np.ptp(both[0][0]), np.ptp(both[1][0]))
    away = [since_reversal(x[0], 1e-3 * span) for x in both]
    assert one.reach == pytest.approx(2.0 * np.median(np.concatenate(away)[at]))
    assert one.band == 12.0
    assert one.weighs
    # it does where it varies by a thousandth of what is carried
    for moment, weighs in ((1e-9, False), (0.1, True)):
        light = a.chain.vector({**TRUTH, "load.first_moment": moment, "load.spring": 0.0})
        assert scales_of(a.chain, light, [a.o]).weighs == weighs
    assert along(settings=FILTERS | {"band": 0.0}).scales.band == pytest.approx(0.3 / (5 * PERIOD))
    assert one.transient_width == 0.25
    # steps of an encoder turn nothing about: three of the coarser one
    coarse = along(steps=(0.05, 0.1)).scales
    away = [since_reversal(x[0], 0.3) for x in both]
    assert coarse.reach == pytest.approx(2.0 * np.median(np.concatenate(away)[at]))
    assert coarse.reach != one.reach


def test_a_push_is_wider_in_long_recordings():
    """So that a recording has sixty of twice its width at most."""
    time = 0.02 * np.arange(5000)
    q, qd, qdd, *_, torque = exact(time)
    taken = ParallelFilter.every_sample(time.size)
    o = made_observation(
        "long", time, (q, qd, qdd), torque, taken, 0.02, Inputs(), settings=FILTERS
    )
    chain = joint()
    assert scales_of(chain, chain.vector(TRUTH), [o]).transient_width == pytest.approx(99.98 / 120)


@pytest.mark.parametrize("ratio", [1.0, 10.0])
def test_waves_are_those_that_the_motion_goes_through_once(ratio):
    motor = bf.Element("motor", inertia=True, ratio=ratio)
    chain = bf.Joint([motor], bf.Load(first_moment=True))
    time = PERIOD * np.arange(N)
    for span in (0.2, 2.5):
        motion = swing(time, ((0.5, span / 2.0),))
        taken = ParallelFilter.every_sample(N)
        o = made_observation("one", time, motion, time, taken, PERIOD, Inputs(), settings=FILTERS)
        found = dict(scales_of(chain, np.ones(2), [o]).cycles)
        sides = {"motor": ratio, "joint": 1.0} if ratio > 1.0 else {"joint": 1.0}
        for side, turn in sides.items():
            told = [int(name.split()[0]) for name in found if name.endswith(side)]
            # all up to eight a turn, and of beyond the multiples of six that 36 or 48 are of
            more = [k for k in range(12, 49, 6) if 48 % k == 0 or 36 % k == 0]
            asked = [*range(1, 9), *more]
            assert told == [k for k in asked if k * turn * span >= 2.0 * np.pi]
            for k in told:
                assert found[f"{k} a turn of the {side}"] == k * turn
        assert all(name.split()[-1] in sides for name in found)


def test_what_slides_goes_through_no_waves():
    screw = bf.Joint([bf.Element("motor", inertia=True, motion="linear")], bf.Load(motion="linear"))
    time = PERIOD * np.arange(N)
    o = made_observation(
        "one", time, swing(time, ((0.5, 9.0),)), time, ParallelFilter.every_sample(N), PERIOD,
        Inputs(), settings=FILTERS,
    )  # fmt: skip
    one = Along(
        screw,
        np.ones(1),
        o,
        made_recording(time, o.q, time, PERIOD),
        scales_of(screw, np.ones(1), [o]),
    )
    assert not one.scales.cycles
    columns = {kind.name: kind.columns(one) for kind in KINDS}
    for name in ("gravity", "inertia_by_angle", "repeating"):
        assert not columns[name]
    np.testing.assert_allclose(columns["friction_by_angle"][""], [np.sign(o.qd) * o.q])


def expected(a, k):
    """Columns of every kind by the formula, and those beside, of recording ``k``."""
    one, o = a.scales, a.o
    q, qd, qdd, weight, carried, torque = exact(o.stamps, 1.7 * k)
    s, v0 = np.sign(qd), one.speed
    clock = (o.stamps - o.stamps.mean()) / one.duration
    rate = lambda x: derivative(x, a.recording.segments, PERIOD, 8)  # noqa: E731
    shares = {
        f"{x:.0%} of the inertia behind it": weight + x * (carried - weight)
        for x in (0, 1 / 3, 2 / 3, 1)
    }
    turns = {name: [np.sin(x * q), np.cos(x * q)] for name, x in one.cycles}
    warm = {
        f"{x * one.duration:.3g}": 1.0 - np.exp(-o.stamps / (x * one.duration))
        for x in (0.05, 0.1, 0.2, 0.35, 0.6, 1.0)
    }
    powers = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.2, 1.4, 1.6, 1.8)
    hertz = [x * one.band for x in (0.1, 0.13, 0.17, 0.22, 0.29, 0.38, 0.5, 0.65, 0.8, 1.0, 1.3)]
    rung = resonating(carried, a.recording.segments, PERIOD, hertz)
    elastic = {"far above the band": [rate(rate(carried))]}
    elastic |= {f"{f:.3g} Hz": [x] for f, x in zip(hertz, rung, strict=True)}
    gap = {}
    for (label, x), share in zip(shares.items(), (0, 1 / 3, 2 / 3, 1), strict=True):
        for times in (0.7, 1.4, 2.8) if share else ():
            half = one.need * (times / (2 * np.pi * one.band)) ** 2 / 2.0
            need = x / (share * one.inertia)
            flown = in_gap(need, PERIOD, half, np.array(a.recording.segments))
            gap[f"{label}, {half:.2g}"] = [rate(rate(flown))]
    heat, pull = 25.0 + 2.0 * o.stamps, np.cos(3.0 * o.stamps)
    swept = np.sin(2.0 * o.stamps) if k == 0 else 0.0 * q
    late, stribeck = rate(torque), (0.03, 0.05, 0.08, 0.13, 0.22, 0.36, 0.6)
    own = qdd, s, qd, G * np.sin(q) / RATIO, q / RATIO
    cutoffs = [one.band * 2.0 ** (-k / 3) for k in range(15)]
    grown, v = np.sin(q) * qdd + np.cos(q) * qd**2 / 2, qd / v0
    columns = {
        "target_delay": {},  # which is scanned for
        "delay": {"": [late], "in one": [late * (k == 0)], "in two": [late * (k == 1)]},
        "torque_constant": {"": [torque]},
        "torque_by_sign": {"": [np.abs(torque)]},
        "saturation": {"": [torque * np.abs(torque)]},
        "offset": {"": [np.ones(q.size)]},
        "coulomb": {"": [s]},
        "viscous": {"": [qd]},
        "viscous_by_direction": {"": [np.abs(qd)]},
        "quadratic": {"": [qd * np.abs(qd)]},
        "power": {f"{p}": [s * np.abs(qd) ** p] for p in powers},
        "stribeck": {f"{x * v0:.3g}": [s * np.exp(-((v / x) ** 2))] for x in stribeck},
        "stribeck_by_direction": {"": [np.exp(-np.abs(qd) / (v0 / 10.0))]},
        "load_loss": {name: [s * np.abs(x)] for name, x in shares.items()},
        "load_loss_by_power": {
            name: [s * np.abs(x) * (x * s > 0.0), s * np.abs(x) * (x * s < 0.0)]
            for name, x in shares.items()
        },
        "load_loss_by_direction": {name: [np.abs(x)] for name, x in shares.items()},
        "load_square": {name: [s * x**2] for name, x in shares.items()},
        "load_speed": {name: [qd * np.abs(x)] for name, x in shares.items()},
        "inertia": {"": [qdd]},
        "gravity": {"": [np.sin(q), np.cos(q)]},
        "spring": {"": [q]},
        "friction_by_angle": {"1 a turn of the joint": [s * np.sin(q), s * np.cos(q)]}
        | {name: [s * x for x in both] for name, both in turns.items()},
        "inertia_by_angle": {"": [np.cos(q) * qdd - np.sin(q) * qd**2 / 2, grown]},
        "repeating": turns,
        "elastic": elastic,
        "backlash": gap,
        "presliding": {
            f"{100 * x:.2g}%": [deflection(q, x * one.reach) - s]
            for x in (0.003, 0.01, 0.03, 0.1, 0.3)
        },
        "drift": {"": [clock]},
        "coulomb_warming": {name: [s * x] for name, x in warm.items()},
        "viscous_warming": {name: [qd * x] for name, x in warm.items()},
        "temperature": {"": [s * heat, qd * heat]},
        "load_torque": {"": [pull]},
        "another_signal": {"q2": [swept, rate(swept), rate(rate(swept))]},
        "smoothed": {
            f"{f:.3g} Hz": [lowpass(s, a.recording.segments, 500.0, f, 4) - s] for f in cutoffs
        },
        "current_column": {
            "the supply's": [*(x * np.abs(qd) for x in own), torque * np.abs(torque)],
            "the supply's without a sign": [*(x * qd for x in own), torque**2],
            "signed by power": [x * s for x in own],
            "without a sign": [x * np.sign(y) for y in (qdd, s, *own[3:]) for x in own],
        },
        "torque_constant_by_angle": {
            name: [torque * x for x in both] for name, both in turns.items()
        },
    }  # fmt: skip
    beside = {
        "delay": [rate(rate(torque))],
        "torque_by_sign": [torque**2],
        "saturation": [torque**3, torque**5],
        "quadratic": [qd * np.sqrt(np.abs(qd)), qd**3],
        "power": [s * np.abs(qd / v0) ** 0.25, s * np.abs(qd / v0) ** 0.75],
        "elastic": [rate(x) for (x,) in elastic.values()],
        "drift": [clock**2, clock**3],
        "coulomb_warming": [s * clock, s * clock**2],
        "viscous_warming": [qd * clock, qd * clock**2],
    }
    return columns, beside


def felt(k):
    """What each recording felt besides; a second arm was recorded in the first alone."""
    stamps = PERIOD * np.arange(N) + 0.5
    signals = {
        "temperature": Signal(stamps, 25.0 + 2.0 * stamps),
        "load_torque": Signal(stamps, np.cos(3.0 * stamps)),
        "others": {"q2": Signal(stamps, np.sin(2.0 * stamps))} if k == 0 else {},
    }
    return Inputs(recording=f"{k}", **signals)


def feeling(a, k):
    """The same recording, as prepared and as read, with what it felt."""
    inputs = felt(k)
    both = replace(a.o, inputs=inputs), replace(a.recording, inputs=inputs)
    return replace(a, o=both[0], recording=both[1])


@pytest.mark.parametrize("k", [0, 1])
def test_columns_are_their_formulas(k):
    """Of inputs that the model's own torque feels, none here: it is known without."""
    a = along(at=k)
    a = replace(a, scales=replace(a.scales, others=("q2",)))
    # what is looked up beside the model's torque, which no load torque moves here
    given = feeling(a, k)
    columns, beside = expected(a, k)
    assert set(columns) == {kind.name for kind in KINDS}
    for kind in KINDS:
        looked = kind.name in ("temperature", "load_torque", "another_signal")
        found = kind.columns(given if looked else a)
        assert list(found) == list(columns[kind.name]), kind.name
        for shape, exact_ones in columns[kind.name].items():
            compare(found[shape], exact_ones, f"{kind.name} {shape}")
        compare(kind.nuisance(a), beside.get(kind.name, []), kind.name)


def compare(found, exact_ones, what):
    assert len(found) == len(exact_ones), what
    for mine, one in zip(found, exact_ones, strict=True):
        scale = np.abs(one).max()
        np.testing.assert_allclose(mine, one, atol=1e-6 * scale, err_msg=what)


def test_friction_is_what_rests_with_the_joint_and_must_be_positive_where_it_can_only_lose():
    """Columns are finite at rest; what a bristle remembers is friction that is there then, too."""
    a = along()
    resting = np.arange(N) % 9 == 4
    o = replace(a.o, qd=np.where(resting, 0.0, a.o.qd))
    a = feeling(replace(a, o=o, scales=replace(a.scales, others=("q2",))), 0)
    by_size = "presliding", "stribeck_by_direction", "load_loss_by_direction"
    # of which a joint may have less than its model, or lose less as it warms
    either = "coulomb", "viscous", "coulomb_warming", "viscous_warming", "temperature"
    for kind in (kind for kind in KINDS if kind.name != TARGET_DELAY):
        some = np.array([x for columns in kind.columns(a).values() for x in columns])
        every = np.array([*some, *kind.nuisance(a)])
        assert np.isfinite(every).all(), kind.name
        rests = kind.name in by_size or not every[:, resting].any()
        assert kind.loss == rests, kind.name
        loses = bool((some * o.qd >= 0.0).all())
        assert kind.positive == (loses and kind.name not in either), kind.name


def between(kind, a):
    """Columns of shapes in the middle of each two neighbours of a kind's grid."""
    one, o = a.scales, a.o
    s, v = np.sign(o.qd), np.abs(o.qd)
    made = {
        "power": lambda p: s * v**p,
        "stribeck": lambda v0: s * np.exp(-((v / v0) ** 2)),
        "presliding": lambda x: deflection(o.q, x * one.reach) - s,
        "coulomb_warming": lambda tau: s * np.exp(-o.stamps / tau),
        "viscous_warming": lambda tau: o.qd * np.exp(-o.stamps / tau),
    }[kind]
    told = [float(x.strip("%")) / (100.0 if "%" in x else 1.0) for x in BY_NAME[kind].columns(a)]
    assert (np.diff(told) > 0.0).all()
    return [made(np.sqrt(x * y)) for x, y in pairwise(told)]


@pytest.mark.parametrize(
    "kind", ["power", "stribeck", "presliding", "coulomb_warming", "viscous_warming"]
)
def test_a_shape_between_those_of_a_grid_is_what_stands_there(kind):
    """Of what the model leaves of it one of them, and what is beside, leaves less than a fifth."""
    a = along()
    s = np.sign(a.o.qd)
    model = [s, a.o.qd, a.o.qdd, np.sin(a.o.q), a.o.q, np.ones_like(s)]
    sets, beside = [*BY_NAME[kind].columns(a).values()], [*BY_NAME[kind].nuisance(a)]

    def left(y, *columns):
        x = np.column_stack([*model, *columns])
        x = x / np.linalg.norm(x, axis=0)
        return float(((y - x @ np.linalg.lstsq(x, y)[0]) ** 2).sum())

    for y in between(kind, a):
        best = min(left(y, *own, *beside) for own in sets)
        assert best < 0.2 * left(y)


def test_signals_that_were_not_recorded_have_no_columns():
    a = along()
    assert not BY_NAME["temperature"].columns(a)
    assert not BY_NAME["load_torque"].columns(a)
    assert not BY_NAME["another_signal"].columns(a)
    # of one recording alone there is one delay
    assert list(BY_NAME["delay"].columns(along(names=("one",)))) == [""]


def test_columns_of_rates_pass_the_positions_filter():
    """Torque, what an elastic drive carries and further signals, at the recording's own rate."""
    told = FILTERS | {"lowpass": 4.0, "order": 3}
    a = along(settings=told, inputs=(felt(0), felt(1)))
    smooth = lambda x: lowpass(x, a.recording.segments, 500.0, 4.0, 3)  # noqa: E731
    rate = lambda x: derivative(x, a.recording.segments, PERIOD, 8)  # noqa: E731
    compare(BY_NAME["delay"].columns(a)[""], [rate(smooth(a.torque))], "delay")
    far = BY_NAME["elastic"].columns(a)["far above the band"]
    compare(far, [rate(rate(smooth(a.carried)))], "elastic")
    x = smooth(np.sin(2.0 * a.o.stamps))
    compare(BY_NAME["another_signal"].columns(a)["q2"], [x, rate(x), rate(rate(x))], "signal")
    need = smooth(a.carried) / a.scales.inertia
    half = a.scales.need * (1.4 / (2 * np.pi * 12.0)) ** 2 / 2.0
    flown = in_gap(need, PERIOD, half, np.array(a.recording.segments))
    found = BY_NAME["backlash"].columns(a)[f"100% of the inertia behind it, {half:.2g}"]
    compare(found, [rate(rate(smooth(flown)))], "backlash")


def test_of_a_load_without_weight_one_share_of_the_inertia_stands_for_all():
    """The others are only a factor, and nothing is carried without any."""
    a = along(joint(bf.Load()))
    assert [share for _, share, _ in a.behind()] == [1.0]
    assert {name.split(",")[0] for name in BY_NAME["backlash"].columns(a)} == {
        "100% of the inertia behind it"
    }
    # whatever the weight of a replicate, which has the shares of the recordings
    weighing = replace(a, scales=replace(a.scales, weighs=True))
    assert [share for _, share, _ in weighing.behind()] == [0.0, 1 / 3, 2 / 3, 1.0]
    massless = replace(a, scales=replace(a.scales, need=0.0))
    assert not BY_NAME["backlash"].columns(massless)


def test_a_far_delay_is_what_the_torque_changed_by_since():
    """Exactly, of a torque that is known between samples; zero where then was not recorded."""
    a = along()
    found = delay_columns(a)
    assert list(found) == [x for d in FAR_DELAYS for x in (d, -d)]
    t, h = a.o.stamps, 1e-5
    *_, now = exact(t)
    for d, (change, rate) in found.items():
        *_, then = exact(t - d)
        slope = (exact(t - d + h)[-1] - exact(t - d - h)[-1]) / (2 * h)
        for begin, end in a.recording.segments:
            place = np.arange(begin, end) - d / PERIOD
            known = (place >= begin - 1e-6) & (place <= end - 1 + 1e-6)
            # where samples on either side are there, of which values between two are made
            inner = (place >= begin + 10) & (place <= end - 11)
            edges = np.flatnonzero(known)[[0, -1]]
            part = slice(begin, end)
            np.testing.assert_allclose(change[part][inner], (now - then)[part][inner], atol=1e-6)
            np.testing.assert_allclose(rate[part][inner], slope[part][inner], atol=1e-3)
            assert not change[part][~known].any()
            assert not rate[part][~known].any()
            if abs(d / PERIOD - round(d / PERIOD)) < 1e-9:
                np.testing.assert_allclose(
                    change[part][edges], (now - then)[part][edges], atol=1e-9
                )
            assert (change[part][edges] != 0.0).all()
    assert not delay_columns(replace(a, chain=joint(delay=True)))


@pytest.mark.parametrize("hertz", [1.5, 3.0, 6.0, 0.0])
def test_a_log_that_was_smoothed_lacks_what_reversals_hold(hertz):
    """The cut-off to compare below is at most a factor of two too low; none where none was."""
    chain = bf.Joint([bf.Element("motor", inertia=True, coulomb="symmetric")])
    time = PERIOD * np.arange(N)
    q, qd, qdd = swing(time, LINES)
    torque = 0.05 * qdd + 0.3 * np.sign(qd)
    whole = ((0, N),)
    o = made_observation(
        "one", time, (q, qd, qdd), lowpass(torque, whole, 500.0, hertz, 4),
        ParallelFilter.every_sample(N), PERIOD, Inputs(), settings=FILTERS,
    )  # fmt: skip
    values = np.array([0.05, 0.3])
    scales = scales_of(chain, values, [o])
    a = Along(chain, values, o, made_recording(time, q, torque, PERIOD), scales)
    assert 0.5 * hertz <= a.smoothed_at() <= hertz
