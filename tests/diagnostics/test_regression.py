"""Forward selection and its design matrix, against dense algebra on random and exact columns."""

import weakref
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

import bayesfric.diagnostics.regression as regression
from bayesfric.diagnostics.candidates import KINDS, filtered_columns
from bayesfric.diagnostics.motion import MotionSignals
from bayesfric.diagnostics.regression import (
    Regression,
    StoredColumns,
    draw_parameters,
    regression_of,
    reported_gradients,
)
from bayesfric.diagnostics.replicates import ReplicateError
from bayesfric.diagnostics.statistics import (
    DELAY,
    LEAST_OUTPUTS,
    SINUSOID,
    TRANSIENT,
    WHITE,
    Autocorrelation,
    Columns,
    Key,
    choose_autocorrelation,
    mean_square,
    score_candidates,
    sinusoid_columns,
    standard_normal_scores,
)
from bayesfric.estimates.torque import typical_load
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import lay_windows, parallel_taps
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.source import Processing
from tests.axis import AXIS, VALUES, swing
from tests.conftest import made_observation, made_recording
from tests.diagnostics.bench import dense_covariance, laid_out

TRUTH = AXIS.vector(VALUES)
PLAIN = ("elastic", "offset", "gravity", "gravity", "coulomb", "drift")
LAGGED = Autocorrelation(np.array([0.6]))


def columns(rng=None, effect=None, noise=WHITE):
    """Random columns of two recordings, with noise and an effect in the residual."""
    layout, fixed = laid_out(160, 140, gaps=(33, 34), rate=20.0), np.random.default_rng(7)
    keys = [Key(kind, "", int(i > 0 and PLAIN[i - 1] == kind)) for i, kind in enumerate(PLAIN)]
    keys += [Key("stribeck", shape, 0) for shape in ("in one", "in two")]
    keys += [Key("elastic", "", 0, nuisance=True)]
    keys += [Key(DELAY, f"by about {d} s", i, delay=d) for d in (0.05, -0.05) for i in (0, 1)]
    x = fixed.standard_normal((layout.outputs, 5 + len(keys)))
    residual = np.zeros(layout.outputs) if rng is None else noise.drawn(layout, rng)
    d = Columns(x[:, :5], x[:, 5:], residual, layout, tuple(keys))
    return d if effect is None else replace(d, residual=residual + effect(d))


def selection(effect=None, seed=0, noise=WHITE, number=24, sizes=TRUTH, change=lambda d: d):
    """Set up a regression on random columns; replicates have no error of sensors."""
    data = change(columns(np.random.default_rng(seed), effect, noise))
    replicates = StoredColumns(change(columns()) for _ in range(number))
    scales = SimpleNamespace(torque=2.0, lost=0.5, transient_width=0.25, names=("one", "two"))
    gradients = dict(zip(AXIS.names, np.eye(5), strict=True))
    gradients["sum"] = np.arange(1.0, 6.0)
    seeds = np.random.SeedSequence(1000 + seed)
    return Regression(data, replicates, scales, sizes, gradients, seeds)


def number(d, kind, shape=""):
    return next(i for i, k in enumerate(d.keys) if (k.kind, k.shape) == (kind, shape))


def effect_of(kind, size, shape=""):
    return lambda d: size * d.others[:, number(d, kind, shape)]


def whitened(d, *arrays, noise=None):
    covariance = dense_covariance(noise or d.autocorrelation, d.layout)
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    return [root @ x for x in arrays]


@pytest.mark.parametrize(("size", "count"), [(1.0, 24), (0.0, 24), (0.0, 5)])
def test_limit_and_probability_are_those_of_the_replicates_largest(size, count):
    r = selection(effect_of("offset", size), seed=3, number=count)
    mean = [number(r.data, "offset")]
    noise, _ = choose_autocorrelation(r.data.residual_with(mean), r.data.layout)
    arguments = r.groups, [], 0.25
    recorded = score_candidates(replace(r.data, autocorrelation=noise), *arguments)
    z, null = standard_normal_scores(
        recorded, [score_candidates(t, *arguments) for t in r.replicates]
    )
    largest = np.sort(null.max(axis=1))
    (effect,) = r.effects(1)
    normals = stats.norm.isf(0.05 / z.size / 2)  # as many independent ones
    quantile = np.quantile(largest, 0.95, method="higher")
    assert effect.limit == pytest.approx(max(quantile, normals))
    assert effect.largest == pytest.approx(z.max())
    assert effect.p == (1 + np.sum(largest >= effect.statistic)) / (count + 1)
    assert effect.significant == bool(size) == (effect.statistic > effect.limit)
    assert effect.kind == "offset" if size else effect.statistic == effect.largest


@pytest.mark.parametrize("noise", [WHITE, LAGGED])
def test_stored_columns_are_as_given_and_leave_memory_once_used(noise):
    given = replace(columns(np.random.default_rng(5)), autocorrelation=noise)
    (stored,) = StoredColumns([given])
    np.testing.assert_array_equal(stored.whitened.others, given.whitened.others)
    gone = weakref.ref(stored.others)
    del stored  # not by the garbage collector, which runs too late
    assert gone() is None


def test_p_values_of_right_models_are_uniform():
    """By exchange one of 25 is beyond all others but one in 8 % at most; normals ask for more."""
    effects = [selection(seed=seed).effects(1)[0] for seed in range(80)]
    wrong, ps = sum(e.significant for e in effects), [e.p for e in effects]
    assert wrong <= 0.08 * 80 + 3.0 * np.sqrt(80 * 0.08 * 0.92)
    # each place among 25 is as likely
    assert np.mean(ps) == pytest.approx(13 / 25, abs=3.0 * np.sqrt(1 / 12 / 80))


def sinusoid(d):
    return sinusoid_columns(d.layout, 3.21) @ [0.8, 0.3, -0.5, 0.7]


def transient(d):
    t = np.concatenate(d.layout.stamps)
    return 2.5 * np.exp(-0.5 * ((t - 4.0) / 0.25) ** 2) * d.layout.members[1]


def far_delay(d):
    return d.others[:, number(d, DELAY, "by about -0.05 s")] - 0.2 * d.others[:, -1]


ONE_WRONG = {
    "elastic": (effect_of("elastic", 0.8), "", [0.8]),
    "gravity": (lambda d: d.others[:, [2, 3]] @ [0.6, -0.6], "", [0.6, -0.6]),
    "stribeck": (effect_of("stribeck", 0.8, "in two"), "in two", [0.8]),
    SINUSOID: (sinusoid, "3.21 Hz", None),
    TRANSIENT: (transient, "two at ", None),
    DELAY: (far_delay, "by about -0.05 s", [1.0, -0.2]),
}


@pytest.mark.parametrize(
    ("kind", "noise"),
    # in autocorrelated noise a transient of this size is nothing
    [(kind, WHITE) for kind in ONE_WRONG]
    + [(kind, LAGGED) for kind in ONE_WRONG if kind != TRANSIENT],
)
def test_one_missing_effect_is_named_and_nothing_else(kind, noise):
    effect, shape, exact = ONE_WRONG[kind]
    r = selection(effect, seed=4, noise=noise)
    # what is missing is not taken for autocorrelation; a transient can be, and is tried last
    if kind != TRANSIENT:
        partial, true = (np.pad(x.partial, (0, 6 - x.partial.size)) for x in (r.noise, noise))
        np.testing.assert_allclose(partial, true, atol=0.2)
    effects = r.effects()
    assert [e.kind for e in effects if e.significant] == [kind] == [e.kind for e in r.included]
    first, d = effects[0], r.data
    assert first.shape.startswith(shape if kind != SINUSOID else "3.2")
    assert first.recording == {"stribeck": "two", TRANSIENT: "two"}.get(kind, "")
    if kind == SINUSOID:
        assert first.scan.place == pytest.approx(3.21, abs=0.02)
    assert (first.span is None) == (kind != TRANSIENT)
    if kind == TRANSIENT:
        assert np.mean(first.span) == pytest.approx(4.0, abs=0.3)
        assert np.diff(first.span) == pytest.approx(4.0 * 0.25)
    if exact:
        tolerance = 4.0 / np.sqrt(d.residual.size)
        np.testing.assert_allclose(first.coefficients, exact, atol=tolerance)
    torque = d.others[:, first.columns] @ first.coefficients
    assert first.share == pytest.approx(np.sqrt(np.mean(torque**2)) / 2.0)
    shapes = r.missing(()).kinds.get(kind, ())
    assert (tuple(first.columns) in shapes) or exact is None


@pytest.mark.parametrize("larger", [sinusoid, far_delay, effect_of("elastic", 1.5)])
def test_what_a_low_passed_log_lacks_is_named_before_larger_effects(larger):
    def renamed(d):
        keys = [Key("smoothed", "3 Hz", 0) if k.kind == "offset" else k for k in d.keys]
        return replace(d, keys=tuple(keys))

    r = selection(lambda d: larger(d) + effect_of("offset", 0.4)(d), seed=4, change=renamed)
    assert r.effects()[0].kind != "smoothed"
    r.smoothed = "3 Hz"
    assert r.effects()[0].kind == "smoothed"


def test_several_effects_are_included_one_after_the_other():
    """The one that explains most first, a transient last; a kind with all its shapes."""

    def effect(d):
        return transient(d) + effect_of("coulomb", 0.5)(d) + effect_of("elastic", 1.0)(d)

    effects = selection(effect, seed=5).effects()
    assert [e.kind for e in effects if e.significant] == ["elastic", "coulomb", TRANSIENT]
    assert not effects[-1].significant
    assert [e.kind for e in selection(effect, seed=5).effects(1)] == ["elastic"]

    def shapes(d):
        return d.others[:, [number(d, "stribeck", x) for x in ("in one", "in two")]] @ [1.0, 0.7]

    assert [e.kind for e in selection(shapes, seed=5).effects() if e.significant] == ["stribeck"]


@pytest.mark.parametrize("noise", [WHITE, LAGGED])
def test_sizes_and_shifts_are_those_of_two_dense_fits(noise):
    def effect(d):
        return (
            d.base @ [0.1, 0.2, 0.0, 0.0, 0.3] + d.others[:, 4] + d.others[:, [2, 3]] @ [0.6, 0.3]
        )

    r = selection(effect, seed=2, noise=noise)
    first, second = [e for e in r.effects(2) if e.significant]
    assert (first.kind, second.kind) == ("coulomb", "gravity")
    d, extra, own = r.data, [4], [2, 3]  # whitened by the noise after the first
    x, y = whitened(d, np.column_stack([d.base, d.others[:, extra + own]]), d.residual)
    before, after = np.linalg.lstsq(x[:, :6], y)[0], np.linalg.lstsq(x, y)[0]
    variance = np.sum((y - x @ after) ** 2) / (y.size - x.shape[1])
    covariance = variance * np.linalg.inv(x.T @ x)[:5, :5]
    np.testing.assert_allclose(second.coefficients, after[6:], rtol=1e-6)
    shift = after[:5] - before[:5]
    for name, gradient in r.gradients.items():
        exact = gradient @ shift / np.sqrt(gradient @ covariance @ gradient)
        assert second.moves[name] == pytest.approx(exact, rel=1e-6, abs=1e-9)
    # in whichever unit, and whatever the value
    sizes = np.array([1.0, 3e4, 1e-3, 1.0, 1e-9])
    same, _ = selection(effect, seed=2, noise=noise, sizes=sizes).effects(2)
    np.testing.assert_allclose(
        [same.moves[n] for n in AXIS.names], [first.moves[n] for n in AXIS.names], rtol=1e-6
    )


def test_parameters_that_are_not_determined_have_no_shift():
    def change(d):
        base = d.base.copy()
        base[:, 0], base[:, 2] = 0.0, 3.0 * base[:, 1]
        return replace(d, base=base)

    (effect,) = selection(effect_of("elastic", 1.0), seed=2, change=change).effects(1)
    assert set(effect.moves) == {*AXIS.names[3:]}


@pytest.mark.parametrize(("size", "rivals"), [(2.0, ("offset",)), (0.55, ("offset", "coulomb"))])
def test_rivals_are_collinear_or_explain_as_much(size, rivals):
    """A cosine of 0.95 is collinear; others are rivals within a factor of 150 in likelihood."""

    def change(d):
        others, rng = d.others.copy(), np.random.default_rng(1)
        more = rng.standard_normal((others.shape[0], 2))
        basis = np.linalg.qr(np.column_stack([d.base, others[:, 0], more]))[0]
        for i, cosine, axis in ((1, 0.955, 6), (4, 0.945, 7)):
            others[:, i] = cosine * basis[:, 5] + np.sqrt(1 - cosine**2) * basis[:, axis]
        return replace(d, others=others)

    (effect,) = selection(effect_of("elastic", size), seed=2, change=change).effects(1)
    assert (effect.kind, effect.rivals) == ("elastic", rivals)


# Candidates to be marginalised


def test_marginalised_candidates_are_products_of_dense_residuals():
    r = selection(effect_of("elastic", 0.3), seed=2, noise=LAGGED)
    r.effects()
    missing, d = r.missing(()), r.data
    losses = np.array([key.kind in ("coulomb", "stribeck") for key in d.keys])
    size = np.where(losses, 0.5, 2.0) / np.abs(d.others).max(axis=0)
    np.testing.assert_allclose(missing.columns, d.others * size)

    def products(d, noise=None):
        # all have the same columns, of which replicates keep the whitened ones alone
        x, z, y = whitened(d, d.base, r.data.others * size, d.residual, noise=noise)
        q = np.linalg.qr(x)[0]
        return z - q @ (q.T @ z), y - q @ (q.T @ y)

    # by the noise that was chosen before anything was included
    z, y = products(d, r.noise)
    np.testing.assert_allclose(missing.gram, z.T @ z, rtol=1e-6, atol=1e-6)
    assert missing.power == pytest.approx(y @ y, rel=1e-6)
    assert missing.free == y.size - 5
    scores, sds = [], []
    for replicate in r.replicates:
        a, b = products(replicate)
        scores.append(a.T @ b / np.linalg.norm(a, axis=0))
        sds.append(np.sqrt(b @ b / (b.size - 5)))
    mean, spread = np.mean(scores, axis=0), np.std(scores, axis=0, ddof=1) / np.mean(sds)
    exact = z.T @ y - mean * np.linalg.norm(z, axis=0)
    np.testing.assert_allclose(missing.scores, exact, rtol=1e-6, atol=1e-6)
    wide = np.sqrt(np.maximum(spread, 1.0) ** 2 + (mean / np.mean(sds)) ** 2 / 4.0)
    np.testing.assert_allclose(missing.spread, wide, rtol=1e-6)
    kinds = {"elastic": ((0,),), "offset": ((1,),), "gravity": ((2, 3),), "coulomb": ((4,),)}
    kinds |= {"drift": ((5,),), "stribeck": ((6,), (7,)), "beside elastic": ((8,),)}
    assert missing.kinds == kinds


def test_candidates_collinear_with_the_model_are_neither_tested_nor_marginalised():
    def change(d):
        others, hidden = d.others.copy(), d.base @ np.ones(5)
        unit = others[:, 1] / np.linalg.norm(others[:, 1])
        others[:, 1] = hidden + 0.9 * 0.015 * np.linalg.norm(hidden) * unit
        others[:, 8] = 0.0
        return replace(d, others=others)

    r = selection(sinusoid, seed=4, change=change)
    assert r.indistinguishable == ("offset", DELAY)
    tested = "elastic", "gravity", "coulomb", "drift", "stribeck"
    assert r.kinds == (*tested, SINUSOID, TRANSIENT)
    (effect,) = r.effects(1)
    missing = r.missing(())
    assert set(missing.kinds) == {*tested, SINUSOID}
    assert missing.kinds[SINUSOID] == (tuple(effect.columns),)
    assert (missing.columns[:, 8] == 0.0).all()
    assert np.isfinite(missing.scores).all()


@pytest.mark.parametrize("noise", [WHITE, LAGGED])
@pytest.mark.parametrize("sensors", [0.0, 0.6, 3.0])
def test_replicates_have_as_much_noise_as_the_recording(noise, sensors):
    """Less what their sensors make of it; at least a tenth of the power is noise."""
    rng, clean = np.random.default_rng(9), []

    def change(d):
        if d.residual.any():
            return d
        clean.append(np.sqrt(sensors) * rng.standard_normal(d.residual.size))
        return replace(d, residual=clean[-1])

    r = selection(seed=1, noise=noise, change=change)
    level = mean_square(r.data.residual_with([]), 5)
    added = [t.residual - x for t, x in zip(r.replicates, clean, strict=True)]
    innovations = r.noise.whitened(np.column_stack(added), r.data.layout)
    power = np.mean(innovations**2) * r.noise.variance(r.data.layout)
    # powers of 24 replicates of 296 outputs, and of their sensors
    error = 4.0 * np.sqrt(2.0 / 24 / 296) * (level + sensors)
    assert power == pytest.approx(max(level - sensors, 0.1 * level), abs=error)


# The design matrix

PERIOD, FACTOR = 0.004, 5
SETTINGS = {"lowpass": 30.0, "order": 2, "reach": 8, "band": 12.0}


def exact_recording(name, n, begin=0.0):
    """Record a known motion; the measured torque passes the parallel filter."""
    time = PERIOD * np.arange(n)
    motion = swing(time + begin, ((0.4, 1.0), (1.3, 0.3)))
    torque = inverse_torque(AXIS, TRUTH, *motion)
    torque = torque + 0.02 * np.random.default_rng(1).standard_normal(n)
    windows = lay_windows(parallel_taps(FACTOR, None, 250.0), ((0, n),), FACTOR, np.ones(n, bool))
    o = made_observation(
        name, time, motion, torque, windows, FACTOR * PERIOD, Inputs(), settings=SETTINGS
    )
    return o, made_recording(time, motion[0], torque, PERIOD, name=name)


PAIR = exact_recording("one", 1200), exact_recording("two", 800, 1.1)


def built(monkeypatch, replicate=lambda k, o: replace(o, measured=o.measured + 0.01 * k), **more):
    """Set up the regression of a pair of recordings with given replicates."""

    def simulated(chain, vectors, r, o, processing, seeds):  # noqa: ARG001
        yield from (replicate(k, o) for k, _ in enumerate(seeds))

    monkeypatch.setattr(regression, "replicates", simulated)
    observations, recordings = zip(*PAIR, strict=True)
    arguments = {"values": TRUTH, "known": ("motor.viscous",), "number": 6} | more
    return regression_of(AXIS, recordings, observations, Processing(), **arguments)


def test_the_models_columns_are_derivatives_of_its_filtered_torque(monkeypatch):
    off = TRUTH * [1.1, 0.9, 1.0, 1.2, 1.0]
    r, _ = built(monkeypatch, values=off)
    observations, split = [o for o, _ in PAIR], r.data.layout.split
    blocks = zip(observations, split(r.data.base), split(r.data.residual), strict=True)
    for o, base, residual in blocks:
        now = inverse_torque(AXIS, off, o.q, o.qd, o.qdd)
        np.testing.assert_allclose(residual, o.measured - o.filter.apply(now), atol=1e-12)
        x = [o.qdd, 0.0 * o.q, np.sign(o.qd), 9.80665 * np.sin(o.q), np.ones_like(o.q)]
        exact = np.stack([o.filter.apply(column) for column in x], axis=1)
        np.testing.assert_allclose(base[:, [0, 2, 4]], exact[:, [0, 2, 4]], atol=1e-5)
        np.testing.assert_allclose(base[:, 3], exact[:, 3], rtol=1e-2, atol=1e-3)
        assert not base[:, 1].any()  # which is known
    assert "motor.viscous" not in r.gradients
    # and of derived quantities
    gradients = reported_gradients(AXIS, TRUTH, observations)
    load = typical_load(AXIS, observations, TRUTH)
    steps = np.diag(1e-3 * TRUTH)
    for q in derive(AXIS, np.concatenate([TRUTH + steps, TRUTH - steps]), load):
        slopes = (q.values[:5] - q.values[5:]) / (2e-3 * TRUTH)
        np.testing.assert_allclose(gradients[q.name], slopes, rtol=1e-4, atol=1e-9)


def test_candidates_pass_the_filter_of_the_torque(monkeypatch):
    r, _ = built(monkeypatch)
    blocks = r.data.layout.split(r.data.others)
    for (o, recording), block in zip(PAIR, blocks, strict=True):
        motion = MotionSignals(AXIS, TRUTH, o, recording, r.scales)
        for kind in KINDS:
            for shape, raw in kind.shapes(motion).items():
                at = [
                    i for i, k in enumerate(r.data.keys)
                    if (k.kind, k.shape, k.nuisance, k.delay) == (kind.name, shape, False, 0.0)
                ]  # fmt: skip
                filtered = [o.filter.apply(x) for x in raw]
                np.testing.assert_allclose(block[:, at].T, filtered, rtol=1e-9, atol=1e-12)
    # samples that are not finite count as zero
    x = np.cos(o.stamps)
    raw = [0.0 * x, x, np.where(np.arange(x.size) % 97 == 5, np.nan, x), *[x * k for k in range(9)]]
    exact = [o.filter.apply(np.nan_to_num(row)) for row in raw]
    keys, columns = filtered_columns(o, enumerate(raw))
    assert keys == list(range(len(raw)))
    np.testing.assert_allclose(columns.T, exact, atol=1e-12)


def test_replicates_have_parameters_that_the_recordings_allow(monkeypatch):
    """Normal about the estimate, by its covariance, but for widths beyond a tenth."""
    # little is known of the offset, whose column is small
    values = TRUTH * [1.0, 1.0, 1.0, 1.0, 1e-3]
    data = built(monkeypatch, values=values)[0].data
    drawn = draw_parameters(AXIS, values, data, 4000, np.random.default_rng(1))
    assert drawn.shape == (4000, 5)
    np.testing.assert_array_equal(drawn[:, 1], values[1])  # which is known
    x, free = data.base, [0, 2, 3, 4]
    left = data.residual - x @ np.linalg.lstsq(x, data.residual)[0]
    variance = left @ left / (left.size - 5)
    rows = x[:, free] * np.abs(values[free])
    power, vectors = np.linalg.eigh(rows.T @ rows)
    determined = power > 1e-7 * power.max()
    sds = np.minimum(np.sqrt(variance / power[determined]), 0.1)
    assert (sds == 0.1).any() or determined.sum() < 4
    exact = (vectors[:, determined] * sds**2) @ vectors[:, determined].T
    relative = (drawn[:, free] - values[free]) / values[free]
    covariance, scale = relative.T @ relative / 4000, np.diag(exact).max()
    np.testing.assert_allclose(covariance, exact, atol=5.0 * np.sqrt(2.0 / 4000) * scale)
    np.testing.assert_allclose(np.diag(covariance)[:3], np.diag(exact)[:3], rtol=0.12)
    # none is below zero that cannot be
    low = np.array([p.lower for p in AXIS.parameters])
    small, noisy = np.where(np.isfinite(low), 1e-9, values), replace(data, residual=1e3 * left)
    assert (draw_parameters(AXIS, small, noisy, 99, np.random.default_rng(1)) >= low).all()


def test_replicates_that_are_missing_or_too_short_are_left_out(monkeypatch):
    least = 5 + LEAST_OUTPUTS

    def short(o, n):
        windows = replace(o.filter, starts=o.filter.starts[:n], gains=o.filter.gains[:n])
        cut = {key: getattr(o, key)[:n] for key in ("time", "measured", "speed", "segment_of")}
        return replace(o, filter=windows, **cut)

    def losing(lost):
        def replicate(k, o):
            first = o.name == "one"
            if k < lost and first:
                return None
            if k in (lost, lost + 1):
                return short(o, least - 10 if first else 9 + (k - lost))
            return replace(o, measured=o.measured + 0.01 * k)

        return built(monkeypatch, replicate, number=8)[1]

    simulated = losing(1)
    assert len(simulated) == 6
    assert simulated[0][1].layout.outputs == least
    # at least half must remain
    assert len(losing(3)) == 4
    with pytest.raises(ReplicateError):
        losing(4)
