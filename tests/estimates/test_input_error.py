"""Input error: exact recovery, honest sds, limits, priors."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.estimates.autoregression import long_run_variance
from bayesfric.estimates.input_error import TorqueProblem, contradicted, few_threads, input_error
from bayesfric.estimates.least_squares import least_squares, totals_regressors
from bayesfric.estimates.point_estimate import Estimation, Knowledge
from bayesfric.estimates.torque import filtered_torque, typical_load
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.scaling import scalings
from tests.axis import AXIS, VALUES

KNEE, MOTOR, SERVO = (PRESETS[n] for n in ("rabbit-knee", "motor-axis", "servo-pendulum"))
MOMENT = {"load.first_moment": KNEE.values["load.first_moment"]}
FEW = Estimation(starts=2)


@pytest.fixture(autouse=True)
def few():
    with few_threads([]):
        yield


@pytest.fixture
def knee(make_observation):
    """The knee's motion with the leg driving part of the time."""

    def make(values=KNEE.values, *, mass=0.0, **options):
        options = {"sigma": 0.0, "n": 1000, "factor": 2, "amplitude": 2.0} | options
        load = {"added_mass": mass, "radius": 0.35 if mass else 0.0}
        return make_observation(KNEE.chain(), values, **options, **load)

    return make


def truths(chain, values, observations):
    """Every parameter and derived quantity, at the load the estimate states it for."""
    vector = chain.vector(values)
    load = typical_load(chain, observations, vector)
    derived = {d.name: float(d.values[0]) for d in derive(chain, vector[None], load)}
    return dict(values) | derived


@pytest.mark.parametrize(
    ("fixed", "masses"),
    [
        (MOMENT, (0.0,)),
        ({"gearbox.load_back": KNEE.values["gearbox.load_back"]}, (0.0,)),
        ({}, (0.0, 2.0)),
    ],
    ids=["known first moment", "known mu", "known mass"],
)
def test_all_of_table_3_comes_back(knee, fixed, masses):
    chain = KNEE.chain()
    observations = [knee(mass=m, seed=i, name=f"r{i}") for i, m in enumerate(masses)]
    estimate = input_error(chain, observations, Knowledge(fixed=fixed), FEW)
    for name, value in dict(estimate.point).items():
        assert value == pytest.approx(KNEE.values[name], rel=1e-6), name
    assert all(np.isfinite(v.sd) for v in estimate.values)
    assert any("is fixed by" in note for note in estimate.notes)


def test_without_a_scale_the_motor_side_comes_back_and_the_leg_is_open(knee):
    chain = KNEE.chain()
    o = knee()
    estimate = input_error(chain, [o], Knowledge(), FEW)
    truth = truths(chain, KNEE.values, [o])
    determined = {v.name for v in estimate.values if v.determined and v.kind != "total"}
    for name in determined:
        assert estimate[name].value == pytest.approx(truth[name], rel=1e-6), name
    assert determined >= {f"motor.{q}" for q in ("inertia", "viscous", "coulomb_positive")}
    assert determined >= {"gearbox.lambda_ratio", "total_drive.gravity", "total_back.inertia"}
    for name in scalings(chain)[0].names:
        value = estimate[name]
        assert np.isinf(value.sd), name
        assert np.isinf(value.sd_robust), name
        assert value.span[0] <= truth[name] <= value.span[1], name
    assert any("is open" in note for note in estimate.notes)
    # the middle of what a passive gearbox allows
    vector = chain.vector(dict(estimate.point))
    assert scalings(chain)[0].middle(vector) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("kind", ["normal", "range"])
def test_a_prior_is_contradicted_by_so_many_sds_of_both(make_observation, kind):
    """Of the value without the prior, and its sd."""
    chain, name = MOTOR.chain(), "motor.viscous"
    o = make_observation(chain, MOTOR.values, sigma=0.02)
    free = input_error(chain, [o], Knowledge(), FEW)[name]
    for times in (2.5, 3.5):
        sd = 2.0 * free.larger_sd if kind == "normal" else 0.0
        nearest = free.value - times * np.hypot(sd, free.larger_sd)
        knowledge = Knowledge(bounds={name: (0.0, nearest)})
        if sd:
            knowledge = Knowledge(priors={name: (nearest, sd)})
        start = dict(input_error(chain, [o], knowledge, FEW).point)
        far = contradicted(chain, [o], knowledge, FEW, start)
        expected = {name: pytest.approx((free.value, times), rel=1e-3)}
        assert far == (expected if times > 3.0 else {})
    assert contradicted(chain, [o], Knowledge(), FEW, start) == {}


# Stribeck rise and a load loss: nothing to project, but to search.
FORMLESS = Joint(
    elements=(
        Element("motor", inertia=True, coulomb="symmetric", viscous=True, stribeck=True),
        Element("gearbox", load_loss="one"),
    ),
    load=Load(first_moment=True),
)
FORMLESS_VALUES = {
    "motor.inertia": 2e-3, "motor.viscous": 0.02, "motor.coulomb": 0.05,
    "motor.stribeck_ratio": 0.6, "motor.stribeck_velocity": 1.5, "gearbox.load": 0.2,
    "load.first_moment": 0.05,
}  # fmt: skip


SLOW = Joint(elements=(replace(MOTOR.chain().elements[0], stribeck="either"),), offset=True)
SLOW_VALUES = MOTOR.values | {"motor.stribeck_change": -0.3, "motor.stribeck_velocity": 0.012}


BACK = {
    "servo": (SERVO.chain(), SERVO.values, 1.0, 0),
    "Stribeck rise": (FORMLESS, FORMLESS_VALUES, 1.0, 0),
    # from one unit of speed a search goes to zero, where no rise or fall has an effect
    **{f"fall at low speed {k}": (SLOW, SLOW_VALUES, 0.03, k) for k in range(3)},
}


@pytest.mark.parametrize("case", BACK)
def test_other_chains_come_back(make_observation, case):
    chain, values, amplitude, seed = BACK[case]
    o = make_observation(chain, values, sigma=0.0, amplitude=amplitude, seed=seed)
    estimate = input_error(chain, [o], Knowledge(), Estimation(seed=seed))
    for name, value in estimate.point:
        assert value == pytest.approx(values[name], rel=1e-5), name
        assert estimate[name].at_bound is None


def test_a_shape_that_is_fixed_or_bounded_is_not_tried_elsewhere(make_observation):
    o = make_observation(SLOW, SLOW_VALUES, sigma=0.0, amplitude=0.03)
    name = "motor.stribeck_velocity"
    fixed = input_error(SLOW, [o], Knowledge(fixed={name: 0.02}), FEW)
    assert dict(fixed.point)[name] == 0.02
    bounded = input_error(SLOW, [o], Knowledge(bounds={name: (0.02, 0.03)}), FEW)
    assert dict(bounded.point)[name] == pytest.approx(0.02)


def test_priors_set_the_scale_by_their_variances(knee):
    """One factor on all that is behind the gearbox, by weighted least squares of one number."""
    chain, o = KNEE.chain(), knee(sigma=1e-5)
    priors = {
        "load.first_moment": (0.41, 0.02),
        "load.inertia": (0.23, 0.02),
        "joint.viscous": (3.0, 1),
    }
    estimate = input_error(chain, [o], Knowledge(priors=priors), FEW)
    true = np.array([KNEE.values[name] for name in priors])
    mean, sd = np.array(list(priors.values())).T
    factor = np.sum(true * mean / sd**2) / np.sum((true / sd) ** 2)
    for name in scalings(chain)[0].behind:
        spread = KNEE.values[name] / np.sqrt(np.sum((true / sd) ** 2))
        # what the motion tells of them is a hundred times as much
        assert abs(estimate[name].value - factor * KNEE.values[name]) < 0.02 * spread, name
        assert estimate[name].sd == pytest.approx(spread, rel=0.02), name


def test_what_the_fit_would_make_negative_stands_on_its_bound(knee):
    chain = KNEE.chain()
    o = knee(KNEE.values | {"joint.viscous": -0.5}, sigma=2e-3)
    estimate = input_error(chain, [o], Knowledge(fixed=MOMENT), FEW)
    value = estimate["joint.viscous"]
    assert value.value == 0.0
    assert value.at_bound == "lower"
    assert np.isnan(value.sd)
    assert all(x.value >= 0.0 for x in estimate.values if x.kind == "parameter")


def test_a_bound_does_not_make_others_better_known(knee):
    """Cm and Cc trade off: while one stands on its bound the other is no better known."""
    chain = KNEE.chain()
    o = knee(sigma=2e-3)
    inside = input_error(chain, [o], Knowledge(fixed=MOMENT), FEW)
    top = inside["motor.coulomb_positive"].value - inside["motor.coulomb_positive"].sd
    bounds = {"motor.coulomb_positive": (0.0, top)}
    on = input_error(chain, [o], Knowledge(fixed=MOMENT, bounds=bounds), FEW)
    assert on["motor.coulomb_positive"].at_bound == "upper"
    assert on["motor.coulomb_positive"].value == top
    for name in ("motor.inertia", "joint.coulomb_positive", "total_drive.coulomb_positive"):
        assert on[name].sd == pytest.approx(inside[name].sd, rel=0.1), name


def test_an_open_scale_keeps_to_the_bounds_it_was_given(knee):
    bounds = {"load.first_moment": (0.40, 0.45)}
    estimate = input_error(KNEE.chain(), [knee(sigma=2e-3)], Knowledge(bounds=bounds), FEW)
    value = estimate["load.first_moment"]
    assert value.value == pytest.approx(np.sqrt(0.40 * 0.45), rel=1e-9)
    assert np.isinf(value.sd)


def test_what_cannot_be_estimated_is_refused(make_observation):
    chain = MOTOR.chain()
    o = make_observation(chain, MOTOR.values)
    with pytest.raises(BadInput, match="every parameter is fixed"):
        input_error(chain, [o], Knowledge(fixed=MOTOR.values), FEW)
    with pytest.raises(BadInput, match="has no room"):
        input_error(chain, [o], Knowledge(bounds={"motor.inertia": (2.0, 1.0)}), FEW)
    few = make_observation(chain, MOTOR.values, n=4)
    with pytest.raises(BadInput, match="cannot determine"):
        input_error(chain, [few], Knowledge(), FEW)


@pytest.fixture
def noisy(make_observation):
    """A noisy recording of a preset."""

    def make(preset):
        options = {"sigma": 5e-3, "n": 500, "factor": 2, "amplitude": 2.0}
        if preset is SERVO:
            options = {"sigma": 2e-3, "n": 400}
        return make_observation(preset.chain(), preset.values, **options)

    return make


ON_BOUNDS = {"joint.viscous": (3.3, 9.0), "motor.coulomb_positive": (0.0, 0.08)}
PRIORS = {"motor.inertia": (3.5e-4, 1e-6), "load.first_moment": (0.4, 0.01)}
CASES = {
    "knee": (KNEE, Knowledge(fixed=MOMENT)),
    "knee, on bounds": (KNEE, Knowledge(fixed=MOMENT, bounds=ON_BOUNDS)),
    "knee, priors": (KNEE, Knowledge(priors=PRIORS)),
    "servo": (SERVO, Knowledge()),
}


@pytest.mark.parametrize("case", CASES)
def test_no_vector_nearby_fits_better_and_the_gradient_is_none(case, noisy):
    """Along what stands on a limit it goes up inwards."""
    preset, knowledge = CASES[case]
    chain, o = preset.chain(), noisy(preset)
    rng = np.random.default_rng(2)
    weights = rng.uniform(0.5, 2.0, o.measured.size)
    problem = TorqueProblem(chain, [o], knowledge).weighted(weights, 4e-3)
    names = np.array(problem.free)

    def squares(x):
        values = chain.vector(dict(zip(names, x, strict=True)) | knowledge.fixed)
        torque = inverse_torque(chain, values[None], o.q, o.qd, o.qdd)[0]
        left = weights * (o.measured - o.filter.apply(torque))
        by_priors = [
            4e-3 * (m - x[names == name][0]) / sd for name, (m, sd) in knowledge.priors.items()
        ]
        return np.concatenate([left, by_priors])

    begin = problem.inside(1.1 * chain.vector(preset.values))
    np.testing.assert_allclose(problem.residual(begin), squares(begin), atol=1e-12)
    cost, minimum = problem.minimise(begin)
    assert 2.0 * cost == pytest.approx(np.sum(squares(minimum) ** 2), rel=1e-9)
    size = np.maximum(np.abs(minimum), 1e-3)
    near = minimum + 1e-3 * size * rng.standard_normal((60, size.size))
    heights = [np.sum(squares(x) ** 2) for x in np.clip(near, problem.lower, problem.upper)]
    assert min(heights) >= 2.0 * cost * (1.0 - 1e-9)
    slope = -problem.jacobian(minimum).T @ problem.residual(minimum) * size
    below, above = minimum == problem.lower, minimum == problem.upper
    assert below.sum() + above.sum() == (2 if "bounds" in case else 0)
    scale = np.linalg.norm(problem.jacobian(minimum) * size, axis=0) * (2.0 * cost) ** 0.5
    assert (np.abs(slope / scale)[~below & ~above] < 1e-4).all()
    assert (slope[below] < 0.0).all()
    assert (slope[above] > 0.0).all()


def stated(estimate, chain, o, knowledge):
    """Every number with its sds by dense algebra: gradients of all are numerical."""
    point = dict(estimate.point)
    values, free = chain.vector(point), [n for n in chain.names if n not in knowledge.fixed]
    columns = [chain.names.index(n) for n in free]
    steps = np.eye(values.size)[columns] * 1e-6 * np.abs(values[columns])[:, None]
    steps += (steps.sum(axis=1) == 0.0)[:, None] * 1e-7 * np.eye(values.size)[columns]
    h = steps.sum(axis=1)

    def torque(v):
        return o.filter.apply(inverse_torque(chain, v[None], o.q, o.qd, o.qdd)[0])

    _, regressors = totals_regressors(chain, [o])
    load = typical_load(chain, [o], values)
    labels = [v.name for v in least_squares(chain, [o]).values]

    def numbers(v):
        named = dict(
            zip(labels, np.linalg.lstsq(regressors, torque(v), rcond=None)[0], strict=True)
        )
        named |= {d.name: float(d.values[0]) for d in derive(chain, v[None], load)}
        return named | dict(zip(chain.names, v, strict=True))

    def slopes(f):
        return [(f(values + s), f(values - s), 2.0 * w) for s, w in zip(steps, h, strict=True)]

    jacobian = np.stack([(a - b) / w for a, b, w in slopes(torque)], axis=1)
    residual = o.measured - torque(values)
    unit = np.abs(values[columns]) + 1e-12
    singular = np.linalg.svd(jacobian * unit, compute_uv=False)
    freedom = residual.size - np.count_nonzero(singular > 1e-6 * singular[0])
    variance = residual @ residual / freedom
    rows = np.array([[float(n == f) / sd for f in free] for n, (_, sd) in knowledge.priors.items()])
    rows = rows.reshape(-1, len(free))
    information = (jacobian.T @ jacobian + variance * rows.T @ rows) * np.outer(unit, unit)
    inverse = np.linalg.inv(information) * np.outer(unit, unit)
    by = slopes(numbers)
    expected = {}
    for name, value in numbers(values).items():
        gradient = np.array([(a[name] - b[name]) / w for a, b, w in by])
        weight = inverse @ gradient
        by_priors = variance**2 * np.sum((rows @ weight) ** 2)
        robust = long_run_variance(jacobian @ weight * residual, np.arange(residual.size))
        robust = robust * residual.size / freedom + by_priors
        expected[name] = value, np.sqrt(variance * gradient @ weight), np.sqrt(robust)
    return expected


@pytest.mark.parametrize("case", ["knee", "knee, priors", "servo"])
def test_every_number_has_the_sds_of_its_gradient(case, noisy):
    preset, knowledge = CASES[case]
    chain, o = preset.chain(), noisy(preset)
    estimate = input_error(chain, [o], knowledge, FEW)
    expected = stated(estimate, chain, o, knowledge)
    assert len(estimate.values) >= len(expected) - len(knowledge.fixed) - 3
    for value in estimate.values:
        number, plain, robust = expected[value.name]
        assert value.value == pytest.approx(number, rel=1e-6), value.name
        assert value.sd == pytest.approx(plain, rel=2e-3), value.name
        assert value.sd_robust == pytest.approx(robust, rel=2e-3), value.name
        assert value.at_bound is None
        assert value.span is None


def test_an_open_number_has_the_span_of_what_a_passive_gearbox_allows(noisy):
    chain, o = KNEE.chain(), noisy(KNEE)
    estimate = input_error(chain, [o], Knowledge(), FEW)
    (scaling,) = scalings(chain)
    values = chain.vector(dict(estimate.point))
    at = dict(estimate.point)
    ends = 1.0 - at["gearbox.load_back"], 1.0 + at["gearbox.load_drive"]
    family = scaling.scaled(values, np.geomspace(*ends, 101))
    load = typical_load(chain, [o], values)
    along = {d.name: d.values for d in derive(chain, family, load)}
    along |= dict(zip(chain.names, family.T, strict=True))
    opened = [v for v in estimate.values if v.span is not None]
    assert {v.name for v in opened} >= {*scaling.names, "gearbox.alpha_drive", "gearbox.lambda_1"}
    for value in opened:
        assert np.isinf([value.sd, value.sd_robust]).all()
        assert not value.gauge_free
        several = along[value.name][np.isfinite(along[value.name])]
        assert value.span == pytest.approx((several.min(), several.max()), rel=1e-9), value.name
    # what does not change along it is as well known as with the scale
    known = input_error(
        chain, [o], Knowledge(fixed={"load.first_moment": at["load.first_moment"]}), FEW
    )
    for value in estimate.values:
        if value.span is None and value.kind != "total":
            assert value.gauge_free, value.name
            assert value.sd == pytest.approx(known[value.name].sd, rel=2e-3), value.name


def test_recordings_and_priors_are_weighed_by_their_variances(make_observation):
    """A linear torque in closed form, weights taken again until they stand."""
    observations = [
        make_observation(AXIS, VALUES, n=n, sigma=s, seed=i, name=str(i), factor=1)
        for i, (n, s) in enumerate(((400, 0.02), (150, 0.2), (250, 0.05)))
    ]
    priors = {"motor.viscous": (0.1, 0.002), "offset": (0.06, 0.01)}
    estimate = input_error(AXIS, observations, Knowledge(priors=priors), FEW)
    order = [AXIS.names.index(n) for n in priors]
    xs = [filtered_torque(AXIS, o, np.eye(5)).T for o in observations]
    y = np.concatenate([o.measured for o in observations])
    x, counts = np.concatenate(xs), [o.measured.size for o in observations]
    mean, sd = np.array(list(priors.values())).T
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
    for name, value, sd in zip(AXIS.names, at, spread, strict=True):
        # weights stand still to a thousandth
        assert abs(estimate[name].value - value) < 2e-3 * sd, name
        assert estimate[name].sd == pytest.approx(sd, rel=1e-3), name
    assert estimate.residual_rms == pytest.approx(np.sqrt(np.mean((y - x @ at) ** 2)), rel=1e-6)
