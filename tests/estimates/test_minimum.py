"""What the input error finds is a minimum, and what it states of it follows from the Jacobian."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import least_squares as scipy_least_squares

from bayesfric.estimates.autoregression import long_run_variance
from bayesfric.estimates.descent import (
    Terms,
    TorqueProblem,
    few_threads,
    minimise,
)
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.knowledge import Estimation, Knowledge
from bayesfric.estimates.least_squares import least_squares, totals_regressors
from bayesfric.estimates.shooting_fit import bounded_step
from bayesfric.estimates.torque import typical_load
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.presets import PRESETS
from bayesfric.mechanism.scaling import scalings
from tests.axis import AXIS, VALUES

KNEE, SERVO = PRESETS["rabbit-knee"], PRESETS["servo-pendulum"]
MOMENT = {"load.first_moment": 0.42}
FEW = Estimation(starts=2)


@pytest.fixture(autouse=True)
def few():
    with few_threads([]):
        yield


def best_of_faces(matrix, target, lower, upper):
    """The least squares of every choice of what stands on which limit; the best that is within."""
    found = []
    for stands in product((-1, 0, 1), repeat=lower.size):
        at = np.where(np.array(stands) < 0, lower, upper)
        free = np.array(stands) == 0
        rest = target - matrix[:, ~free] @ at[~free]
        at[free] = np.linalg.lstsq(matrix[:, free], rest, rcond=None)[0]
        if (at >= lower - 1e-12).all() and (at <= upper + 1e-12).all():
            found.append((np.sum((target - matrix @ at) ** 2), at))
    return min(found, key=lambda one: one[0])[1]


def test_a_step_within_limits_is_the_best_of_all_faces():
    rng = np.random.default_rng(1)
    stopped = 0
    for _ in range(60):
        matrix, target = rng.standard_normal((6, 3)), rng.standard_normal(6)
        lower, upper = -rng.uniform(0.0, 0.5, (2, 3)) * [[1.0], [-1.0]]
        step = bounded_step(matrix, target, lower, upper)
        np.testing.assert_allclose(step, best_of_faces(matrix, target, lower, upper), atol=1e-9)
        stopped += (step <= lower).any() or (step >= upper).any()
    assert 10 < stopped < 60
    held = bounded_step(matrix, target, np.array([0.0, -9, -9]), np.array([0.0, 9, 9]))
    expected = np.linalg.lstsq(matrix[:, 1:], target, rcond=None)[0]
    assert held == pytest.approx([0.0, *expected])


def knee(make_observation, sigma=5e-3, **more):
    options = {"n": 500, "factor": 2, "amplitude": 2.0} | more
    return make_observation(KNEE.chain(), KNEE.values, sigma=sigma, **options)


def servo(make_observation):
    return make_observation(SERVO.chain(), SERVO.values, sigma=2e-3, n=400)


CASES = {
    "knee": (KNEE, knee, Knowledge(fixed=MOMENT)),
    "knee, on bounds": (
        KNEE, knee,
        Knowledge(
            fixed=MOMENT,
            bounds={"joint.viscous": (3.3, 9.0), "motor.coulomb_positive": (0.0, 0.08)},
        ),
    ),
    "knee, told": (
        KNEE, knee,
        Knowledge(priors={"load.first_moment": (0.4, 0.01), "motor.inertia": (3.5e-4, 1e-6)}),
    ),
    "servo": (SERVO, servo, Knowledge()),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_no_vector_nearby_fits_better_and_the_gradient_is_none(case, make_observation):
    """SciPy ends at the same height; along what stands on a limit it goes up inwards."""
    preset, made, knowledge = CASES[case]
    chain, o = preset.chain(), made(make_observation)
    problem = TorqueProblem(chain, [o], knowledge)
    rows, targets = knowledge.rows(chain)
    rng = np.random.default_rng(2)
    weights = rng.uniform(0.5, 2.0, o.measured.size)
    terms = Terms(weights, 4e-3 * rows, 4e-3 * targets) if rows.size else Terms(weights)
    names = np.array(problem.free)

    def squares(x):
        values = chain.vector(dict(zip(names, x, strict=True)) | knowledge.fixed)
        torque = inverse_torque(chain, values[None], o.q, o.qd, o.qdd)[0]
        left = weights * (o.measured - o.filter.apply(torque))
        told = [4e-3 * (m - x[names == name][0]) / sd for name, (m, sd) in knowledge.priors.items()]
        return np.concatenate([left, told])

    begin = problem.inside(1.1 * chain.vector(preset.values))
    np.testing.assert_allclose(
        terms.residual(problem, begin)[: weights.size], squares(begin)[: weights.size], atol=1e-12
    )
    found = minimise(problem, terms, begin)
    assert found.squares == pytest.approx(np.sum(squares(found.x) ** 2), rel=1e-9)
    size = np.maximum(np.abs(found.x), 1e-3)
    low, high = (np.where(np.isfinite(x), x, s * 1e9 * size) for x, s in (
        (problem.lower, -1.0), (problem.upper, 1.0)))  # fmt: skip
    theirs = scipy_least_squares(
        lambda u: squares(u * size), np.clip(begin / size, low / size + 1e-9, high / size - 1e-9),
        bounds=(low / size, high / size), xtol=1e-12, ftol=1e-12, gtol=1e-12,
    )  # fmt: skip
    assert found.squares <= 2.0 * theirs.cost * (1.0 + 1e-9)
    for width in (1e-1, 1e-3, 1e-5):
        near = found.x + width * size * rng.standard_normal((60, size.size))
        heights = [np.sum(squares(x) ** 2) for x in np.clip(near, problem.lower, problem.upper)]
        assert min(heights) >= found.squares * (1.0 - 1e-9)
    slope = terms.jacobian(problem, found.x).T @ terms.residual(problem, found.x) * size
    below, above = found.x == problem.lower, found.x == problem.upper
    assert below.sum() + above.sum() == (2 if "bounds" in case else 0)
    scale = np.linalg.norm(terms.jacobian(problem, found.x) * size, axis=0) * found.squares**0.5
    assert (np.abs(slope / scale)[~below & ~above] < 1e-4).all()
    assert (slope[below] < 0.0).all()
    assert (slope[above] > 0.0).all()


def test_a_search_within_a_linear_torque_takes_few_derivatives(make_observation, monkeypatch):
    """From five times the truth SciPy's trust region takes a few Gauss-Newton steps."""
    o = make_observation(AXIS, VALUES, sigma=0.1)
    problem = TorqueProblem(AXIS, [o], Knowledge())
    calls = []
    jacobian = problem.jacobian
    monkeypatch.setattr(problem, "jacobian", lambda x: calls.append(1) or jacobian(x))
    found = minimise(problem, Terms(np.ones(o.measured.size)), 5.0 * AXIS.vector(VALUES))
    names, regressors = totals_regressors(AXIS, [o])
    least = np.linalg.lstsq(regressors, o.measured, rcond=None)[1][0]
    assert found.squares == pytest.approx(least, rel=1e-9)
    assert len(calls) <= 10
    assert len(names) == len(AXIS.names)


def stated(estimate, chain, observations, knowledge, weights):
    """Every number with its sds by dense algebra: gradients of all are numerical."""
    point = dict(estimate.point)
    values, free = chain.vector(point), [n for n in chain.names if n not in knowledge.fixed]
    columns = [chain.names.index(n) for n in free]
    steps = np.eye(values.size)[columns] * 1e-6 * np.abs(values[columns])[:, None]
    steps += (steps.sum(axis=1) == 0.0)[:, None] * 1e-7 * np.eye(values.size)[columns]
    h = steps.sum(axis=1)

    def torque(v):
        return np.concatenate(
            [
                o.filter.apply(inverse_torque(chain, v[None], o.q, o.qd, o.qdd, inputs=o.inputs)[0])
                for o in observations
            ]
        )

    _, regressors = totals_regressors(chain, observations)
    load = typical_load(chain, observations, values)
    labels = [v.name for v in least_squares(chain, observations).values]

    def numbers(v):
        made = dict(zip(labels, np.linalg.lstsq(regressors, torque(v), rcond=None)[0], strict=True))
        made |= {d.name: float(d.values[0]) for d in derive(chain, v[None], load)}
        return made | dict(zip(chain.names, v, strict=True))

    def slopes(f):
        return [(f(values + s), f(values - s), 2.0 * w) for s, w in zip(steps, h, strict=True)]

    jacobian = np.stack([(a - b) / w for a, b, w in slopes(torque)], axis=1) * weights[:, None]
    measured = np.concatenate([o.measured for o in observations])
    residual = weights * (measured - torque(values))
    unit = np.abs(values[columns]) + 1e-12
    singular = np.linalg.svd(jacobian * unit, compute_uv=False)
    freedom = residual.size - np.count_nonzero(singular > 1e-6 * singular[0])
    variance = residual @ residual / freedom
    rows = np.array([[float(n == f) / sd for f in free] for n, (_, sd) in knowledge.priors.items()])
    rows = rows.reshape(-1, len(free))
    whole = (jacobian.T @ jacobian + variance * rows.T @ rows) * np.outer(unit, unit)
    inverse = np.linalg.inv(whole) * np.outer(unit, unit)
    by = slopes(numbers)
    places = np.concatenate(
        [k * 3000 + np.arange(o.measured.size) for k, o in enumerate(observations)]
    )
    found = {}
    for name, value in numbers(values).items():
        gradient = np.array([(a[name] - b[name]) / w for a, b, w in by])
        weight = inverse @ gradient
        told = variance**2 * np.sum((rows @ weight) ** 2)
        robust = long_run_variance(jacobian @ weight * residual, places)
        robust = robust * residual.size / freedom + told
        found[name] = value, np.sqrt(variance * gradient @ weight), np.sqrt(robust)
    return found


@pytest.mark.parametrize("case", ["knee", "knee, told", "servo"])
def test_every_number_has_the_sds_of_its_gradient(case, make_observation):
    preset, made, knowledge = CASES[case]
    chain, o = preset.chain(), made(make_observation)
    estimate = input_error(chain, [o], knowledge, FEW)
    expected = stated(estimate, chain, [o], knowledge, np.ones(o.measured.size))
    assert len(estimate.values) >= len(expected) - len(knowledge.fixed) - 3
    for value in estimate.values:
        number, plain, robust = expected[value.name]
        assert value.value == pytest.approx(number, rel=1e-6), value.name
        assert value.sd == pytest.approx(plain, rel=2e-3), value.name
        assert value.sd_robust == pytest.approx(robust, rel=2e-3), value.name
        assert value.at_bound is None
        assert value.span is None


def test_an_open_number_has_the_span_of_what_a_passive_gearbox_allows(make_observation):
    chain, o = KNEE.chain(), knee(make_observation)
    estimate = input_error(chain, [o], Knowledge(), FEW)
    (scaling,) = scalings(chain)
    values = chain.vector(dict(estimate.point))
    at = dict(estimate.point)
    ends = 1.0 - at["gearbox.load_back"], 1.0 + at["gearbox.load_drive"]
    family = scaling.scaled(values, np.geomspace(*ends, 101))
    load = typical_load(chain, [o], values)
    made = {d.name: d.values for d in derive(chain, family, load)}
    made |= dict(zip(chain.names, family.T, strict=True))
    opened = [v for v in estimate.values if v.span is not None]
    assert {v.name for v in opened} >= {*scaling.names, "gearbox.alpha_drive", "gearbox.lambda_1"}
    for value in opened:
        assert np.isinf([value.sd, value.sd_robust]).all()
        assert not value.gauge_free
        several = made[value.name][np.isfinite(made[value.name])]
        assert value.span == pytest.approx((several.min(), several.max()), rel=1e-9), value.name
    # what does not change along it is as well known as with the scale
    known = input_error(
        chain, [o], Knowledge(fixed={"load.first_moment": at["load.first_moment"]}), FEW
    )
    for value in estimate.values:
        if value.span is None and value.kind != "total":
            assert value.gauge_free, value.name
            assert value.sd == pytest.approx(known[value.name].sd, rel=2e-3), value.name


def test_recordings_and_told_values_are_weighed_by_their_variances(make_observation):
    """A linear torque in closed form, weights taken anew until they stand."""
    observations = [
        make_observation(AXIS, VALUES, n=n, sigma=s, seed=i, name=str(i), factor=1)
        for i, (n, s) in enumerate(((400, 0.02), (150, 0.2), (250, 0.05)))
    ]
    told = {"motor.viscous": (0.1, 0.002), "offset": (0.06, 0.01)}
    found = input_error(AXIS, observations, Knowledge(priors=told), FEW)
    order = [AXIS.names.index(n) for n in told]
    xs = [
        np.stack(
            [
                {
                    "motor.inertia": o.qdd,
                    "motor.viscous": o.qd,
                    "motor.coulomb": np.sign(o.qd),
                    "load.first_moment": 9.80665 * np.sin(o.q),
                    "offset": np.ones(o.q.size),
                }[name]
                for name in AXIS.names
            ],
            axis=1,
        )
        for o in observations
    ]
    y = np.concatenate([o.measured for o in observations])
    x, counts = np.concatenate(xs), [o.measured.size for o in observations]
    mean, sd = np.array(list(told.values())).T
    weights, known, at = np.ones(y.size), 0.0, np.linalg.lstsq(x, y, rcond=None)[0]
    for _ in range(30):
        hat = np.einsum("ni,ij,nj->n", x, np.linalg.inv((x.T * weights**2) @ x), x) * weights**2
        parts = np.split(np.arange(y.size), np.cumsum(counts)[:-1])
        residual = y - x @ at
        sds = [np.sqrt(np.sum(residual[p] ** 2) / (p.size - hat[p].sum())) for p in parts]
        weights = np.repeat(np.exp(np.mean(np.log(sds))) / np.array(sds), counts)
        known = np.sum((weights * residual) ** 2) / (y.size - 5)
        normal = (x.T * weights**2) @ x
        right = (x.T * weights**2) @ y
        normal[order, order] += known / sd**2
        right[order] += known * mean / sd**2
        at = np.linalg.solve(normal, right)
    variance = np.sum((weights * (y - x @ at)) ** 2) / (y.size - 5)
    normal[order, order] += (variance - known) / sd**2
    spread = np.sqrt(variance * np.diag(np.linalg.inv(normal)))
    for name, value, one in zip(AXIS.names, at, spread, strict=True):
        # weights stand still to a thousandth
        assert abs(found[name].value - value) < 2e-3 * one, name
        assert found[name].sd == pytest.approx(one, rel=1e-3), name
    assert found.residual_rms == pytest.approx(np.sqrt(np.mean((y - x @ at) ** 2)), rel=1e-6)


def test_what_stands_on_a_bound_is_said_to(make_observation):
    """Another viscous friction than the data's, to either side."""
    o = make_observation(AXIS, VALUES | {"motor.viscous": 0.1}, sigma=0.01)
    for bounds, side in (((0.0, 0.05), "upper"), ((0.15, 1.0), "lower")):
        found = input_error(AXIS, [o], Knowledge(bounds={"motor.viscous": bounds}), FEW)
        value = found["motor.viscous"]
        assert value.at_bound == side
        assert value.value == bounds[side == "upper"]
        assert np.isnan([value.sd, value.sd_robust]).all()
        others = [v for v in found.values if v.name != "motor.viscous"]
        assert all(v.at_bound is None and v.determined for v in others)
        assert value.larger_sd == 0.0
    assert replace(value, sd=0.1).relative_sd == pytest.approx(10.0 / abs(value.value))
