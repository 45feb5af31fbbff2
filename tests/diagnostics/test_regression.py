"""Included effects and their shifts: recordings and replicates of random columns, dense algebra."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bayesfric.diagnostics.autocorrelation import WHITE, Autocorrelation, choose_autocorrelation
from bayesfric.diagnostics.disturbances import (
    DELAY,
    SINUSOID,
    TRANSIENT,
    sinusoid_columns,
    tune_frequency,
)
from bayesfric.diagnostics.regression import Regression
from bayesfric.diagnostics.statistics import (
    Columns,
    Key,
    mean_square,
    score_candidates,
    standard_normal_scores,
)
from bayesfric.diagnostics.statistics import (
    testable as candidates,
)
from bayesfric.estimates.torque import typical_load
from bayesfric.mechanism.derived import derive
from bayesfric.recordings.filters import ParallelFilter
from bayesfric.recordings.measurement import Inputs
from tests.axis import AXIS, VALUES, swing
from tests.conftest import made_observation
from tests.diagnostics.bench import dense_covariance, laid_out

DELAYS = (0.05, -0.05)
PLAIN = ("elastic", "offset", "gravity", "gravity", "coulomb", "drift")


def columns(rng, effect=None, noise=WHITE, counts=(160, 140), base=5):
    """Columns of two recordings; in the residual is noise, and an effect of them."""
    where = laid_out(*counts, gaps=(33, 34), rate=20.0)
    n, fixed = where.outputs, np.random.default_rng(7)
    keys = [Key(kind, "", int(i > 0 and PLAIN[i - 1] == kind)) for i, kind in enumerate(PLAIN)]
    keys += [Key("stribeck", shape, 0) for shape in ("slow", "fast")]
    keys += [Key("elastic", "", 0, nuisance=True)]
    keys += [Key(DELAY, f"by about {d} s", i, delay=d) for d in DELAYS for i in (0, 1)]
    x = fixed.standard_normal((n, base + len(keys)))
    left = noise.drawn(where, rng)
    d = Columns(x[:, :base], x[:, base:], left, where, tuple(keys))
    return d if effect is None else replace(d, residual=left + effect(d))


def made(effect=None, seed=0, noise=WHITE, replicates=24, values=None, known=()):
    """A regression whose recording and replicates are columns that are given."""
    rng = np.random.default_rng(seed)
    r = object.__new__(Regression)
    r.chain, r.known, r._smoothed = AXIS, known, ""
    r._located_scans, r._significant_kinds = [], set()
    r.values = AXIS.vector(VALUES) if values is None else values
    r.scales = SimpleNamespace(torque=2.0, lost=0.5, transient_width=0.25, names=("one", "two"))
    time = np.linspace(0.0, 7.0, 50)  # of a motion that typical loads are asked of
    every = ParallelFilter.every_sample(50)
    r.observations = [
        made_observation(name, time, swing(time, ((0.3, 1.0),)), time, every, 0.1, Inputs())
        for name in r.scales.names
    ]
    r.data = columns(rng, effect, noise)
    r._groups = candidates(r.data)
    r.replicates = [columns(rng, noise=noise) for _ in range(replicates)]
    r._clean = [np.zeros_like(t.residual) for t in r.replicates]
    return r


def left_of(d, *numbers):
    """What dense least squares leaves of the residual beside columns by number."""
    x = np.column_stack([d.base, d.others[:, [*numbers]]])
    return d.residual - x @ np.linalg.lstsq(x, d.residual)[0]


def number(d, kind, shape="", nuisance=False):
    (found, *_) = (
        i for i, k in enumerate(d.keys) if (k.kind, k.shape, k.nuisance) == (kind, shape, nuisance)
    )
    return found


def effect_of(kind, size, shape=""):
    return lambda d: size * d.others[:, number(d, kind, shape)]


def test_limit_probability_and_worth_are_those_of_all_twins_largest():
    r = made(effect_of("offset", 1.0))
    choice = r._select([], for_noise=False)
    given = r._groups, [], 0.25
    z, null = standard_normal_scores(
        score_candidates(r.data, *given), [score_candidates(t, *given) for t in r.replicates]
    )
    largest = np.sort(null.max(axis=1))
    assert choice.limit == max(largest[-2], stats.norm.isf(0.05 / z.size / 2))
    assert (choice.kind, choice.significant) == ("offset", True)
    assert choice.largest == choice.z == z.max()
    assert choice.p == 1.0 / 25.0
    mine = score_candidates(r.data, *given)
    gains = [*mine.gains, *(scan.peak for scan in mine.scans)]
    # a pair is one number more, a shape another; a tone has a frequency, a push and a delay a place
    more = [1 * (len(own) > 1) + (key.kind == "stribeck") for key, own in r._groups] + [2, 1, 1]
    np.testing.assert_allclose(choice.worth, gains - np.array(more) * np.log(r.data.residual.size))
    # of nothing that is sure the most unlikely is told, and how many replicates have more of
    # anything
    none = made(seed=3)
    choice = none._select([], for_noise=False)
    z, null = standard_normal_scores(
        score_candidates(none.data, *given), [score_candidates(t, *given) for t in none.replicates]
    )
    assert not choice.significant
    assert choice.z == z.max() < choice.limit
    assert choice.p == (1 + np.sum(null.max(axis=1) >= z.max())) / 25.0
    # with few replicates the limit is that of as many independent normals
    few = made(seed=3, replicates=5)
    assert few._select([], for_noise=False).limit >= stats.norm.isf(0.05 / z.size / 2)


def test_recordings_whose_model_is_right_are_told_so():
    """By exchange one of 25 is beyond all others but one in 8 % at most; normals ask for more."""
    wrong = [made(seed=seed)._select([], for_noise=False).significant for seed in range(80)]
    assert 1 <= sum(wrong) <= 0.08 * 80 + 3.0 * np.sqrt(80 * 0.08 * 0.92)


def tone_of(d):
    x = sinusoid_columns(d.layout, 3.21)
    return x @ [0.8, 0.3, -0.5, 0.7]


def push_of(d):
    t = np.concatenate(d.layout.stamps)
    return 2.5 * np.exp(-0.5 * ((t - 4.0) / 0.25) ** 2) * d.layout.members[1]


def far(d):
    return d.others[:, number(d, DELAY, "by about -0.05 s")] - 0.2 * d.others[:, -1]


ONE_WRONG = {
    "elastic": effect_of("elastic", 0.8),
    "gravity": lambda d: d.others[:, [2, 3]] @ [0.6, -0.6],
    "stribeck": effect_of("stribeck", 0.8, "fast"),
    SINUSOID: tone_of,
    TRANSIENT: push_of,
    DELAY: far,
}


@pytest.mark.parametrize(
    ("kind", "noise"),
    # in noise that remembers a push of this size is nothing
    [(kind, WHITE) for kind in ONE_WRONG]
    + [(kind, Autocorrelation(np.array([0.6]))) for kind in ONE_WRONG if kind != TRANSIENT],
)
def test_what_is_wrong_is_named_and_nothing_else(kind, noise):
    r = made(ONE_WRONG[kind], seed=4, noise=noise)
    r._choose_noise(np.random.SeedSequence(1))
    # what is missing is not taken for noise that remembers; a push can be, and is looked for last
    if kind != TRANSIENT:
        told, exact = (np.pad(one.partial, (0, 6 - one.partial.size)) for one in (r.noise, noise))
        np.testing.assert_allclose(told, exact, atol=0.2)
    steps = r.steps()
    assert [step.kind for step in steps if step.significant] == [kind]
    first, d = steps[0], r.data
    where = {DELAY: "by about -0.05 s", "stribeck": "fast"}
    if kind == SINUSOID:
        assert first.shape == f"{first.scan.place:.3g} Hz"
        assert first.scan.place == pytest.approx(3.21, abs=0.02)
    elif kind == TRANSIENT:
        assert first.recording == "two"
        assert first.shape.startswith("two at ")
        assert np.mean(first.span) == pytest.approx(4.0, abs=0.3)
        assert np.diff(first.span) == pytest.approx(4.0 * 0.25)
    else:
        assert (first.shape, first.recording, first.span) == (where.get(kind, ""), "", None)
    if kind in (SINUSOID, TRANSIENT, DELAY):
        assert first.scan.kind == kind
        assert r._located_scans == [(kind, tuple(first.columns))]
    assert all(len(t.keys) == len(d.keys) == t.others.shape[1] for t in r.replicates)
    assert all(key.kind == kind for key in np.array(d.keys, dtype=object)[first.columns])
    exact = {"elastic": [0.8], "gravity": [0.6, -0.6], "stribeck": [0.8], DELAY: [1.0, -0.2]}
    if kind in exact:
        sd = 4.0 / np.sqrt(d.residual.size)
        np.testing.assert_allclose(first.coefficients, exact[kind], atol=sd)
    # what a step explains is left of the torque by no second one
    own = d.others[:, first.columns] @ first.coefficients
    assert first.share == pytest.approx(np.sqrt(np.mean(own**2)) / 2.0)


def test_several_things_are_taken_in_one_after_the_other():
    """The one that explains most first, a push last; and no more of them than are asked for."""

    def effect(d):
        return push_of(d) + effect_of("coulomb", 0.5)(d) + effect_of("elastic", 1.0)(d)

    steps = made(effect, seed=5).steps()
    assert [s.kind for s in steps if s.significant] == ["elastic", "coulomb", TRANSIENT]
    assert not steps[-1].significant
    assert [s.kind for s in made(effect, seed=5).steps(1)] == ["elastic"]


def test_a_kind_that_was_taken_brings_all_its_shapes():
    """So that none of its other shapes is found beside it; not so of what has many of its own."""
    r = made(seed=5)
    for kind, family in (("stribeck", {6, 7}), ("elastic", {0, 8}), ("gravity", {2, 3})):
        r.data = columns(
            np.random.default_rng(5),
            lambda d, kind=kind: (
                3.0 * d.others[:, number(d, kind, "slow" if kind == "stribeck" else "")]
            ),
        )
        (_, before), (_, after) = r._forward_selection(2)
        assert before == []
        assert set(after) == family, kind


def test_what_wander_can_be_is_not_taken_while_noise_is_chosen():
    """A drift, a push and a slow tone; a fast one is. What is not sure has no columns."""
    slow = lambda d: sinusoid_columns(d.layout, 0.6) @ [0.8, 0.3, -0.5, 0.7]  # noqa: E731
    for effect, kind in (
        (slow, SINUSOID),
        (push_of, TRANSIENT),
        (effect_of("drift", 1.0), "drift"),
    ):
        r = made(effect, seed=6)
        assert (r._select([], for_noise=False).kind, r._select([], for_noise=True).significant) == (
            kind,
            False,
        )
    r = made(tone_of, seed=6)
    assert r._select([], for_noise=True).significant
    quiet = made(seed=3)
    before = quiet.data.others.shape
    unsure = quiet._select([], for_noise=True)
    assert not unsure.significant
    assert quiet.data.others.shape == before


def test_a_tone_is_tuned_in_the_whitened_residual():
    r = made(tone_of, seed=6, noise=Autocorrelation(np.array([0.6])))
    r._choose_noise(np.random.SeedSequence(1))
    choice = r._select([], for_noise=False)
    d, white = r.data, r.data.autocorrelation.whitened(r.data.base, r.data.layout)
    basis = np.linalg.qr(white)[0]

    def left(x):
        y = d.autocorrelation.whitened(x, d.layout)
        return y - basis @ (basis.T @ y)

    exact = tune_frequency(left(d.residual[:, None])[:, 0], d.layout, choice.scan.place, left)
    assert choice.scan.place == pytest.approx(exact, abs=1e-4)
    np.testing.assert_allclose(
        d.others[:, choice.columns], sinusoid_columns(d.layout, choice.scan.place)
    )


# What it moves


@pytest.mark.parametrize("extra", [[], [4]])
@pytest.mark.parametrize("autocorrelation", [WHITE, Autocorrelation(np.array([0.5, -0.2]))])
def test_a_candidates_size_and_what_it_moves_are_those_of_two_dense_fits(extra, autocorrelation):
    r = made(lambda d: d.base @ [0.1, 0.2, 0.0, 0.0, 0.3] + 0.7 * d.others[:, 2], seed=2)
    r.data = replace(r.data, autocorrelation=autocorrelation)
    d, own = r.data, [2, 3]
    root = np.linalg.inv(np.linalg.cholesky(dense_covariance(autocorrelation, d.layout)))
    x = root @ np.column_stack([d.base, d.others[:, [*extra, *own]]])
    y, k = root @ d.residual, 5 + len(extra)
    before, after = np.linalg.lstsq(x[:, :k], y)[0], np.linalg.lstsq(x, y)[0]
    variance = np.sum((y - x @ after) ** 2) / (y.size - x.shape[1])
    covariance = variance * np.linalg.inv(x.T @ x)
    found = r._fit_selected(own, extra)
    np.testing.assert_allclose(found["coefficients"], after[k:], rtol=1e-6)
    torque = d.others[:, own] @ after[k:]
    assert found["share"] == pytest.approx(np.sqrt(np.mean(torque**2)) / 2.0)
    shift, sds = after[:5] - before[:5], np.sqrt(np.diag(covariance)[:5])
    for name, moved in zip(AXIS.names, shift / sds, strict=True):
        assert found["moves"][name] == pytest.approx(moved, rel=1e-6, abs=1e-9)
    # and of what is made of parameters, by its gradient
    some, load = 0, typical_load(AXIS, r.observations, r.values)
    for i in range(5):
        step = np.where(np.arange(5) == i, 1e-4 * r.values, 0.0)
        sides = zip(*(derive(AXIS, (r.values + s)[None], load) for s in (step, -step)), strict=True)
        slopes = {a.name: float(a.values[0] - b.values[0]) / 2e-4 / r.values[i] for a, b in sides}
        for name, slope in slopes.items():
            assert r._gradients[name][i] == pytest.approx(slope, rel=1e-6, abs=1e-9)
            some += 1
    assert some
    for name, gradient in r._gradients.items():
        exact = gradient @ shift / np.sqrt(gradient @ covariance[:5, :5] @ gradient)
        assert found["moves"][name] == pytest.approx(exact, rel=1e-6, abs=1e-9)


def test_what_a_parameter_moves_by_does_not_hang_on_its_value():
    """Nor of one that is zero, and in whichever unit: sds are the measure."""
    moves = []
    for values in (
        AXIS.vector(VALUES),
        AXIS.vector(VALUES | {"offset": 0.0, "motor.coulomb": 3e4}),
    ):
        r = made(effect_of("elastic", 1.0), seed=2, values=values)
        found = r._fit_selected([0], [])["moves"]
        moves.append([found[name] for name in AXIS.names])
    np.testing.assert_allclose(moves[1], moves[0], rtol=1e-6)


def test_what_is_known_or_not_determined_is_moved_by_nothing():
    r = made(effect_of("elastic", 1.0), seed=2, known=(AXIS.names[0],))
    base = r.data.base.copy()
    base[:, 0] = 0.0
    base[:, 2] = 3.0 * base[:, 1]
    r.data = replace(r.data, base=base)
    moves = r._fit_selected([0], [])["moves"]
    assert not {*AXIS.names[:3]} & set(moves)
    assert {*AXIS.names[3:]} <= set(moves)


def test_rivals_look_alike_or_explain_as_much():
    r = made(effect_of("elastic", 3.0), seed=2)
    others = r.data.others.copy()
    rng = np.random.default_rng(1)
    beside = np.linalg.qr(
        np.column_stack([r.data.base, others[:, 0], rng.standard_normal((others.shape[0], 2))])
    )[0]
    unit = np.linalg.norm(others[:, 0] - beside[:, :5] @ (beside[:, :5].T @ others[:, 0]))
    for i, cosine in ((1, 0.955), (4, 0.945)):
        others[:, i] = unit * (
            cosine * np.sign(beside[:, 5] @ others[:, 0]) * beside[:, 5]
            + np.sqrt(1 - cosine**2) * beside[:, 6]
        )
    r.data = replace(r.data, others=others)
    choice = r._select([], for_noise=False)
    assert choice.kind == "elastic"
    worth = np.array(choice.worth)
    kinds = [key.kind for key, _ in r._groups]

    def told(**gains):
        for kind, gain in gains.items():
            worth[kinds.index(kind)] = gain
        return tuple(r._collinear_kinds(replace(choice, worth=worth), []))

    # what looks alike, of a cosine of 0.95, is a rival where it explains half as much; any other
    # where the best one is by less than a factor of 150 the likelier
    assert told(elastic=100.0, offset=51.0, coulomb=51.0, gravity=1.0, drift=1.0, stribeck=1.0) == (
        "offset",
    )
    assert told(offset=49.0) == ()
    assert told(gravity=100.0 - 2.0 * np.log(150.0) + 0.1) == ("gravity",)
    assert told(gravity=100.0 - 2.0 * np.log(150.0) - 0.1) == ()
    # what was found at any place has none
    found = made(tone_of, seed=4, noise=Autocorrelation(np.array([0.1])))
    found._choose_noise(np.random.SeedSequence(1))
    sinusoidal_disturbance = found._select([], for_noise=False)
    assert (
        sinusoidal_disturbance.kind,
        sinusoidal_disturbance.significant,
        found._step(sinusoidal_disturbance, []).collinear,
    ) == (SINUSOID, True, ())


# Candidates to be marginalised


def test_candidates_to_be_marginalised_are_products_of_dense_residuals():
    r = made(effect_of("elastic", 0.3), seed=2, noise=Autocorrelation(np.array([0.5])))
    r._choose_noise(np.random.SeedSequence(1))
    r.steps()
    found, d = r.missing(), r.data
    largest = np.abs(d.others).max(axis=0)
    losses = np.array([key.kind in ("coulomb", "stribeck") for key in d.keys])
    size = np.where(losses, 0.5, 2.0) / largest
    np.testing.assert_allclose(np.abs(found.columns).max(axis=0), np.where(losses, 0.5, 2.0))
    np.testing.assert_allclose(found.columns, d.others * size)

    def products(one):
        root = np.linalg.inv(np.linalg.cholesky(dense_covariance(one.autocorrelation, one.layout)))
        x, z, y = root @ one.base, root @ (one.others * size), root @ one.residual
        q = np.linalg.qr(x)[0]
        return z - q @ (q.T @ z), y - q @ (q.T @ y)

    # by the noise that was chosen before anything was taken in, whatever was taken in since
    z, y = products(replace(d, autocorrelation=r.noise))
    np.testing.assert_allclose(found.gram, z.T @ z, rtol=1e-6, atol=1e-6)
    assert found.power == pytest.approx(y @ y, rel=1e-6)
    assert found.free == y.size - 5
    scores, sds = [], []
    for replicate in r.replicates:
        a, b = products(replicate)
        scores.append(a.T @ b / np.linalg.norm(a, axis=0))
        sds.append(np.sqrt(b @ b / (b.size - 5)))
    mean, spread = np.mean(scores, axis=0), np.std(scores, axis=0, ddof=1) / np.mean(sds)
    np.testing.assert_allclose(
        found.scores, z.T @ y - mean * np.linalg.norm(z, axis=0), rtol=1e-6, atol=1e-6
    )
    wide = np.sqrt(np.maximum(spread, 1.0) ** 2 + (mean / np.mean(sds)) ** 2 / 4.0)
    np.testing.assert_allclose(found.spread, wide, rtol=1e-6)
    kinds = {
        "elastic": ((0,),),
        "offset": ((1,),),
        "gravity": ((2, 3),),
        "coulomb": ((4,),),
        "drift": ((5,),),
        "stribeck": ((6,), (7,)),
        "beside elastic": ((8,),),
    }
    assert found.kinds == kinds


def test_what_a_motion_does_not_tell_is_not_marginalised_and_what_was_found_is():
    r = made(tone_of, seed=4)
    r._choose_noise(np.random.SeedSequence(1))
    (step,) = r.steps(1)
    assert (step.kind, step.significant) == (SINUSOID, True)
    others = r.data.others.copy()
    hidden = r.data.base @ np.ones(5)
    others[:, 1] = hidden + 0.9 * 0.015 * np.linalg.norm(hidden) * others[:, 1] / np.linalg.norm(
        others[:, 1]
    )
    others[:, 8] = 0.0
    r.data = replace(r.data, others=others)
    found = r.missing()
    assert found.kinds[SINUSOID] == (tuple(step.columns),)
    assert not {"offset", "beside elastic"} & set(found.kinds)
    assert (found.columns[:, 8] == 0.0).all()
    assert np.isfinite(found.scores).all()


def test_kinds_that_this_motion_does_not_tell_are_named():
    r = made(seed=2)
    assert r.indistinguishable == (DELAY,)
    assert r.kinds == (
        "elastic",
        "offset",
        "gravity",
        "coulomb",
        "drift",
        "stribeck",
        SINUSOID,
        TRANSIENT,
    )
    r._groups = r._groups[1:]
    assert r.indistinguishable == ("elastic", DELAY)


# Noise


@pytest.mark.parametrize(
    "autocorrelation",
    [WHITE, Autocorrelation(np.array([0.7])), Autocorrelation(np.array([0.4]), 0.7)],
)
@pytest.mark.parametrize("sensors", [0.0, 0.6, 3.0])
def test_twins_are_given_so_much_noise_that_they_leave_what_the_recording_does(
    autocorrelation, sensors
):
    """Less what their sensors make of it; at least a tenth of the power is noise."""
    r = made(seed=1, noise=autocorrelation)
    rng = np.random.default_rng(9)
    level = mean_square(left_of(r.data, 4), 6)
    r._clean = [
        np.sqrt(sensors * level) * rng.standard_normal(t.residual.size) for t in r.replicates
    ]
    r._add_noise(autocorrelation, [4], np.random.SeedSequence(3))
    added = [t.residual - clean for t, clean in zip(r.replicates, r._clean, strict=True)]
    own = np.mean(
        [
            mean_square(left_of(replace(t, residual=c), 4), 6)
            for t, c in zip(r.replicates, r._clean, strict=True)
        ]
    )
    exact = max(level - own, 0.1 * level)
    drawn = np.random.default_rng(np.random.SeedSequence(3))
    series = np.concatenate([autocorrelation.drawn(r.data.layout, drawn) for _ in r.replicates])
    np.testing.assert_allclose(
        np.concatenate(added), series * np.sqrt(exact / autocorrelation.variance(r.data.layout))
    )


@pytest.mark.parametrize(
    "kinds", [(), ("elastic",), ("elastic", "offset"), ("elastic", "offset", "coulomb", "stribeck")]
)
def test_the_noise_is_that_of_the_best_residual_when_one_after_the_other_is_taken(kinds):
    """By its criterion, what was taken counted as parameters, and ten for each choice."""
    effects = [
        effect_of(kind, 0.3 + 0.1 * i, "slow" * (kind == "stribeck"))
        for i, kind in enumerate(kinds)
    ]

    def effect(d):
        return sum((one(d) for one in effects), np.zeros(d.residual.size))

    noise, stream = Autocorrelation(np.array([0.5])), np.random.SeedSequence(1)
    r, by_hand = (made(effect, seed=8, noise=noise) for _ in range(2))
    r._choose_noise(stream)
    by_hand._add_noise(WHITE, [], stream)
    taken = [[]]
    for choice, extra in by_hand._forward_selection(8, for_noise=True):
        if not choice.significant:
            break
        taken.append([*extra, *choice.columns])
    d, found = by_hand.data, []
    for picks, extra in enumerate(taken):
        autocorrelation, bic = choose_autocorrelation(left_of(d, *extra), d.layout)
        found.append(
            (bic + len(extra) * np.log(d.residual.size) + 10.0 * picks, autocorrelation, extra)
        )
    _, autocorrelation, extra = min(found, key=lambda one: one[0])
    np.testing.assert_allclose(r.noise.partial, autocorrelation.partial, rtol=1e-6)
    assert r.noise.drift == autocorrelation.drift
    # replicates then have that noise beside what was taken, and each its own autocorrelation
    by_hand._add_noise(autocorrelation, extra, stream)
    for one, other in zip(r.replicates, by_hand.replicates, strict=True):
        np.testing.assert_allclose(one.residual, other.residual, rtol=1e-6)
        own, _ = choose_autocorrelation(left_of(other, *extra), other.layout)
        np.testing.assert_allclose(one.autocorrelation.partial, own.partial, rtol=1e-6)


def test_what_is_in_one_recording_alone_names_it():
    r = made(effect_of("elastic", 1.0), seed=2)
    choice = r._select([], for_noise=False)
    for shape, recording in (("in two", "two"), ("in one", "one"), ("in", ""), ("", "")):
        assert r._step(replace(choice, shape=shape), []).recording == recording
    # rivals are looked for of what is sure alone
    assert r._step(replace(choice, significant=False), []).collinear == ()
