"""What the input error finds is a minimum, and what it states of it follows from the Jacobian."""

import numpy as np
import pytest
from scipy.optimize import least_squares as scipy_least_squares

from bayesfric.estimates.information import long_run_variance
from bayesfric.estimates.input_error import (
    TorqueProblem,
    few_threads,
    input_error,
)
from bayesfric.estimates.least_squares import least_squares, totals_regressors
from bayesfric.estimates.point_estimate import Estimation, Knowledge
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
        Knowledge(priors={"motor.inertia": (3.5e-4, 1e-6), "load.first_moment": (0.4, 0.01)}),
    ),
    "servo": (SERVO, servo, Knowledge()),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_no_vector_nearby_fits_better_and_the_gradient_is_none(case, make_observation):
    """SciPy ends at the same height; along what stands on a limit it goes up inwards."""
    preset, made, knowledge = CASES[case]
    chain, o = preset.chain(), made(make_observation)
    rng = np.random.default_rng(2)
    weights = rng.uniform(0.5, 2.0, o.measured.size)
    problem = TorqueProblem(chain, [o], knowledge).weighted(weights, 4e-3)
    names = np.array(problem.free)

    def squares(x):
        values = chain.vector(dict(zip(names, x, strict=True)) | knowledge.fixed)
        torque = inverse_torque(chain, values[None], o.q, o.qd, o.qdd)[0]
        left = weights * (o.measured - o.filter.apply(torque))
        told = [4e-3 * (m - x[names == name][0]) / sd for name, (m, sd) in knowledge.priors.items()]
        return np.concatenate([left, told])

    begin = problem.inside(1.1 * chain.vector(preset.values))
    np.testing.assert_allclose(problem.residual(begin), squares(begin), atol=1e-12)
    found = problem.minimise(begin)
    assert 2.0 * found.cost == pytest.approx(np.sum(squares(found.x) ** 2), rel=1e-9)
    size = np.maximum(np.abs(found.x), 1e-3)
    low, high = (np.where(np.isfinite(x), x, s * 1e9 * size) for x, s in (
        (problem.lower, -1.0), (problem.upper, 1.0)))  # fmt: skip
    theirs = scipy_least_squares(
        lambda u: squares(u * size), np.clip(begin / size, low / size + 1e-9, high / size - 1e-9),
        bounds=(low / size, high / size), xtol=1e-12, ftol=1e-12, gtol=1e-12,
    )  # fmt: skip
    assert found.cost <= theirs.cost * (1.0 + 1e-9)
    for width in (1e-1, 1e-3, 1e-5):
        near = found.x + width * size * rng.standard_normal((60, size.size))
        heights = [np.sum(squares(x) ** 2) for x in np.clip(near, problem.lower, problem.upper)]
        assert min(heights) >= 2.0 * found.cost * (1.0 - 1e-9)
    slope = -problem.jacobian(found.x).T @ problem.residual(found.x) * size
    below, above = found.x == problem.lower, found.x == problem.upper
    assert below.sum() + above.sum() == (2 if "bounds" in case else 0)
    scale = np.linalg.norm(problem.jacobian(found.x) * size, axis=0) * (2.0 * found.cost) ** 0.5
    assert (np.abs(slope / scale)[~below & ~above] < 1e-4).all()
    assert (slope[below] < 0.0).all()
    assert (slope[above] > 0.0).all()


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
