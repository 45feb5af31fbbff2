"""The fast moments equal the plain ones everywhere, up to the rounding both have."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.estimates.torque import torque_jacobian
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.linear_torque import ACCURACY, linear_torque
from bayesfric.inference.moments import PlainMoments, SignRegion, fast_moments
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.recordings.measurement import Signal

from .test_residual_moments import with_gaps

KNEE = PRESETS["rabbit-knee"]
AXIS = PRESETS["motor-axis"]

SINGLE = Joint(
    (
        Element("motor", inertia=True, viscous=True, coulomb="by-direction", quadratic=True),
        Element("gearbox", ratio=20.0, load_loss="one"),
        Element("joint", viscous=True, coulomb="symmetric"),
    ),
    Load(inertia=True, first_moment=True),
    offset=True,
)
SINGLE_VALUES = {
    "motor.inertia": 3e-4,
    "motor.viscous": 2e-4,
    "motor.quadratic": 1e-6,
    "motor.coulomb_positive": 0.06,
    "motor.coulomb_negative": 0.05,
    "gearbox.load": 0.15,
    "joint.viscous": 0.2,
    "joint.coulomb": 0.4,
    "load.inertia": 0.15,
    "load.first_moment": 0.42,
    "offset": 0.01,
}


def with_shapes(chain, values, shapes, **options):
    elements = tuple(replace(e, **options.get(e.name, {})) for e in chain.elements)
    chain = replace(chain, elements=elements, gain=options.get("gain", False))
    found = {**values, **shapes}
    return chain, {name: found[name] for name in chain.names}


def of(element, **values):
    return {f"{element}.{name}": value for name, value in values.items()}


# what shapes a loss, at every place that it may stand
SHAPED = {
    "stribeck-motor": with_shapes(
        KNEE.chain(), KNEE.values, of("motor", stribeck_ratio=0.4, stribeck_velocity=8.0),
        motor={"stribeck": True},
    ),
    "stribeck-load": with_shapes(
        KNEE.chain(), KNEE.values,
        of("gearbox", stribeck_load=0.3, stribeck_constant=0.2, stribeck_velocity=6.0),
        gearbox={"stribeck": "apart"},
    ),
    "stribeck-joint": with_shapes(
        KNEE.chain(), KNEE.values, of("joint", stribeck_change=-0.3, stribeck_velocity=0.4),
        joint={"stribeck": "either"},
    ),
    "power": with_shapes(
        SINGLE, SINGLE_VALUES,
        of("motor", power=0.02, power_exponent=0.6) | of("joint", power=0.3, power_exponent=1.4),
        motor={"power": True}, joint={"power": True},
    ),
    "warming": with_shapes(
        SINGLE, SINGLE_VALUES,
        of("motor", viscous_warming=-1e-4, coulomb_warming=-0.02, warming_time=0.3),
        motor={"warming": "both"},
    ),
    "load-speed": with_shapes(
        KNEE.chain(), KNEE.values, of("gearbox", load_speed=1e-3, load_square=0.02),
        gearbox={"load_speed": True, "load_square": True},
    ),
    "load-direction": with_shapes(
        KNEE.chain(), KNEE.values,
        of("gearbox", load_drive_difference=0.03, load_back_difference=-0.02)
        | of("gearbox", stribeck_ratio=0.3, stribeck_velocity=5.0) | {"drive.gain": 0.8},
        gearbox={"load_direction": "quadrants", "stribeck": True}, gain=True,
    ),
}  # fmt: skip
ANGLED = replace(KNEE.chain(), load=replace(KNEE.chain().load, gravity_angle=True))


def draws_about(chain, values, observations, n=300, sigma=0.05, seed=0):
    """A posterior of noisier torque with a prior of 20 %, so that many signs differ."""
    v = chain.vector(values)
    step = 1e-6 * np.maximum(np.abs(v), 1e-3)
    jacobian = torque_jacobian(chain, observations, v, step)
    information = jacobian.T @ jacobian / sigma**2 + np.diag(1.0 / (0.2 * np.abs(v) + 1e-6) ** 2)
    root = np.linalg.cholesky(np.linalg.inv(information))
    return v + np.random.default_rng(seed).standard_normal((n, v.size)) @ root.T


class Case:
    """A chain, its recordings, and the moments both ways."""

    def __init__(self, chain, values, observations, order, **options):
        self.chain, self.observations, self.order = chain, observations, order
        self.draws = draws_about(chain, values, observations)
        self.shaped = any(p.row.tries is not None for p in chain.parameters)
        self.plain = PlainMoments(chain, observations, order)
        self.fast = fast_moments(chain, observations, self.draws, order, **options)

    def check(self, values):
        with np.errstate(all="ignore"):
            expected = self.plain.at(values)
            found = self.fast.at(values)
            squares = expected.sum_of_squares
            # What rounding leaves of each residual is eps times the torques whose difference
            # it is. That is far below 1e-9 of the sum of squares unless residuals are 1e-5 of
            # the torques or less.
            # A shape's column is interpolated.
            eps = 4 * 20 * np.finfo(float).eps + (ACCURACY if self.shaped else 0.0)
            lost = eps * np.nan_to_num(self.size(values), posinf=np.inf)
            bound = 1e-9 * squares + lost * (np.sqrt(squares) + lost)
        number = np.isfinite(squares)
        for a, b in ((found.lagged, expected.lagged), *zip(found.heads, expected.heads)):  # noqa: B905
            good = np.isfinite(b)
            np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
            np.testing.assert_array_equal(a[~good], b[~good])
            kept = good & number[..., None, None]
            error = np.abs(np.where(kept, a, 0.0) - np.where(kept, b, 0.0))
            assert (error.max(axis=(2, 3), initial=0.0) <= np.where(number, bound, np.inf)).all()
        return found

    def size(self, values):
        """Root sum of squares of the measured torque and of each column's torque."""
        linear = linear_torque(self.chain, self.observations, self.draws)
        coefficients = linear.coefficients(values).all
        out = []
        for o in self.observations:
            psi1, psi2 = linear.columns(o, 0, o.q.size)
            phi = linear.functions(o, 0, o.q.size)
            rows = linear.rows(psi1, psi2, phi, np.sign(o.qd), np.ones(o.q.size))
            norms = np.concatenate([[np.linalg.norm(o.measured)], np.linalg.norm(rows, axis=1)])
            out.append(np.abs(coefficients) @ norms)
        return np.stack(out, axis=1)


def knee_observations(make, factor):
    chain = KNEE.chain()
    bare = make(chain, KNEE.values, n=500 * factor, factor=factor)
    return [
        with_gaps(bare, np.array([7, 9, 12, 16, 100, 101, 250])),
        make(chain, KNEE.values, n=400 * factor, factor=factor, seed=1, added_mass=2.0, radius=0.3),
    ]


@pytest.fixture(scope="module")
def cases(make_observation):
    built = {}
    for factor, order in KNEES:
        built[f"knee-{factor}-{order}"] = Case(
            KNEE.chain(), KNEE.values, knee_observations(make_observation, factor), order
        )
    loaded = make_observation(KNEE.chain(), KNEE.values, factor=3, added_mass=1.0, radius=0.3)
    built["knee-one-known-mass"] = Case(KNEE.chain(), KNEE.values, [loaded], 1)
    known = make_observation(SINGLE, SINGLE_VALUES, n=900, added_mass=1.0, radius=0.3)
    built["single-mu-known-mass"] = Case(SINGLE, SINGLE_VALUES, [known], 0)
    axis = AXIS.chain()
    o = make_observation(axis, AXIS.values, n=800, factor=2, added_mass=3.0)
    built["no-load-loss"] = Case(axis, AXIS.values, [o], 1)
    values = {**KNEE.values, "load.gravity_angle": 0.2}
    # a mass that is known, at an angle that is not: with a moment of the joint's own, and without
    two = [
        make_observation(ANGLED, values, n=500, seed=seed, added_mass=mass, radius=0.3)
        for seed, mass in enumerate((0.0, 2.0))
    ]
    built["angle-known-mass"] = Case(ANGLED, values, two, 1)
    hung = replace(SINGLE, load=Load(gravity_angle=True), gain=True)
    values = {name: SINGLE_VALUES.get(name, 0.3) for name in hung.names}
    o = make_observation(hung, values, n=700, factor=2, added_mass=1.0, radius=0.3)
    built["angle-known-mass-only"] = Case(hung, values, [o], 2)
    # stands still for a while: at rest there is no loss
    o = make_observation(KNEE.chain(), KNEE.values, n=900, factor=3)
    speed = o.qd.copy()
    speed[200:260] = 0.0
    built["rest"] = Case(KNEE.chain(), KNEE.values, [replace(o, qd=speed)], 2)
    # no noise: the sum of squares itself is rounding at the truth
    o = make_observation(KNEE.chain(), KNEE.values, n=900, sigma=0.0)
    built["exact"] = Case(KNEE.chain(), KNEE.values, [o], 2)
    # an unknown gain, with and without a load loss and a mass that is known
    for name, chain, values, mass in (
        ("gain", replace(KNEE.chain(), gain=True), KNEE.values, 0.0),
        ("gain-single-mu-known-mass", replace(SINGLE, gain=True), SINGLE_VALUES, 1.0),
    ):
        values = {**values, "drive.gain": 0.8}
        o = make_observation(chain, values, n=900, factor=3, added_mass=mass, radius=0.3)
        built[name] = Case(chain, values, [o], 1)
    # of a delay's torque, which is that of the recording, it is no factor
    with_gain, values = replace(axis, gain=True), {**AXIS.values, "drive.gain": 0.8}
    o = make_observation(with_gain, values, n=900, factor=3, added_mass=3.0, radius=0.3)
    inputs = replace(o.inputs, torque_rate=Signal(o.stamps, np.gradient(o.torque, o.stamps)))
    late, values = replace(with_gain, delay=True), {**values, "drive.delay": 0.002}
    built["gain-delay"] = Case(late, values, [replace(o, inputs=inputs)], 1)
    for name, (chain, values) in SHAPED.items():
        o = make_observation(chain, values, n=9000, factor=2)
        speed = o.qd.copy()
        speed[200:220] = 0.0
        built[name] = Case(chain, values, [replace(o, qd=speed)], 1)
    o = make_observation(KNEE.chain(), KNEE.values, n=3000, factor=3)
    built["narrow"] = Case(KNEE.chain(), KNEE.values, [o], 1, radius=1.5)
    return built


KNEES = ((1, 0), (4, 1), (1, 2), (4, 2))
NAMES = [
    *(f"knee-{factor}-{order}" for factor, order in KNEES), "knee-one-known-mass",
    "single-mu-known-mass", "no-load-loss", "angle-known-mass", "angle-known-mass-only", "rest",
    "exact", "gain", "gain-single-mu-known-mass", "gain-delay", *SHAPED, "narrow",
]  # fmt: skip


def away(case, rng, far):
    """Draws near, at the edge and far."""
    centre = case.draws.mean(axis=0)
    return centre + far * (case.draws[rng.integers(case.draws.shape[0], size=40)] - centre)


def of_any_sign_and_size(case, rng, log):
    """Negative inertias, load losses that give energy, lambda_2 of zero."""
    names = case.chain.names
    values = case.draws[rng.integers(case.draws.shape[0], size=40)]
    values = np.where(rng.random(values.shape) < 0.2, -values, values)
    values = np.where(rng.random(values.shape) < 0.2, values * 10.0**log, values)
    values[rng.random(values.shape) < 0.05] = 0.0
    losses = [j for j, n in enumerate(names) if ".load_" in n or n.endswith(".load")]
    for j in losses:
        values[:10, j] *= -1.0
        values[10:15, j] = 0.0
    if len(losses) == 2:
        values[15:20, losses[0]] = -values[15:20, losses[1]]
    return values


def with_no_number(case, rng, _):
    values = case.draws[:30].copy()
    odd = np.array([np.nan, np.inf, -np.inf, 1e308, -1e308, 1e200, 1e155, 1e-308, 0.0])
    at = rng.integers(values.shape[1], size=30)
    values[np.arange(30), at] = odd[rng.integers(odd.size, size=30)]
    return values


TRIED = [
    *((away, far) for far in (0.0, 1.0, 6.0, 30.0)),
    *((of_any_sign_and_size, log) for log in (-3.0, 0.3, 1.0, 5.0, 8.0)),
    *((with_no_number, None) for _ in range(3)),
]


@pytest.mark.parametrize("name", NAMES)
def test_equal_wherever(cases, name):
    for seed, (made, size) in enumerate(TRIED):
        cases[name].check(made(cases[name], np.random.default_rng(seed), size))


@pytest.mark.parametrize("name", NAMES)
def test_draws_near_the_posterior_are_not_computed_sample_by_sample(cases, name):
    case = cases[name]
    before = case.fast.slow_evaluations
    case.check(case.draws)
    share = (case.fast.slow_evaluations - before) / len(case.draws)
    assert share == 0.0 if name != "narrow" else 0.0 < share < 1.0


def test_signs_do_differ_where_it_is_tried(cases):
    """The tests above would show little if no draw crossed the kink of any sample."""
    case = cases["knee-1-0"]
    linear = linear_torque(case.chain, case.observations)
    leg = linear.coefficients(case.draws).leg
    _, psi2 = linear.columns(case.observations[0], 0, case.observations[0].q.size)
    signs = np.sign(leg @ psi2)
    changing = np.abs(signs.sum(axis=0)) < len(case.draws)
    assert np.count_nonzero(changing) > 10
    assert 0 < case.fast.uncertain_samples < sum(o.q.size for o in case.observations)


def test_a_sample_exactly_at_the_kink(make_observation):
    """Where the load takes no torque at the centre either sign is as good."""
    chain = replace(KNEE.chain())
    o = make_observation(chain, KNEE.values, n=600)
    q, qd, qdd = o.q.copy(), o.qd.copy(), o.qdd.copy()
    q[::50] = qdd[::50] = 0.0
    values = {**KNEE.values, "joint.viscous": 0.0, "joint.coulomb_positive": 0.0}
    values["joint.coulomb_negative"] = 0.0
    case = Case(chain, values, [replace(o, q=q, qd=qd, qdd=qdd)], 2)
    one = chain.vector(values)
    other = one.copy()
    other[chain.names.index("joint.coulomb_positive")] = -0.01
    case.check(np.stack([one, other, 2.0 * one]))
    at_centre = fast_moments(chain, case.observations, one[None], 2)
    for row in (one, other):
        expected = case.plain.at(row[None]).lagged
        np.testing.assert_allclose(at_centre.at(row[None]).lagged, expected, rtol=1e-9, atol=1e-12)


def test_within_its_ratio_a_sample_has_the_centres_sign():
    rng = np.random.default_rng(0)
    legs = np.array([3.0, 1.0, -2.0, 0.5]) + 0.2 * rng.standard_normal((500, 4))
    size = np.array([1.0, 10.0, 0.1, 2.0])
    region = SignRegion.around(legs / size, size)
    psi = rng.standard_normal((4, 2000)) * size[:, None]
    tried = np.concatenate([legs, 3.0 * rng.standard_normal((500, 4))]) / size
    distance, ratio = region.distance(tried), region.ratios(psi)
    assert (distance[:500] < np.inf).all()
    # longer legs are no farther
    np.testing.assert_allclose(region.distance(7.0 * tried[:500]), distance[:500], rtol=1e-9)
    differs = (tried @ psi) * (region.centre @ psi) < 0.0
    assert not (differs & (distance[:, None] < ratio)).any()
    # and the border is no farther out than it must be
    assert (differs & (distance[:, None] < 1.5 * ratio)).any()


def test_chains_without_the_form_stay_as_they_are(make_observation):
    lossy = Element("gearbox", load_loss="one", coulomb="symmetric")
    twice = Joint((lossy, replace(lossy, name="joint")), Load(inertia=True))
    names = dict.fromkeys(twice.names, 0.1)
    o = make_observation(twice, names, n=200)
    likelihood = TorqueLikelihood(twice, [o])
    assert likelihood.precomputed(twice.vector(names)[None]) is likelihood
    assert not likelihood.fast


@pytest.mark.parametrize("factor", [1, 4])
@pytest.mark.parametrize("order", [0, 2])
def test_borders_of_chunks_show_nowhere(make_observation, monkeypatch, factor, order):
    from bayesfric.inference import moments as module

    observations = knee_observations(make_observation, factor)
    monkeypatch.setattr(module, "_CHUNK", 50)
    case = Case(KNEE.chain(), KNEE.values, observations, order)
    case.check(case.draws)
    monkeypatch.undo()
    whole = Case(KNEE.chain(), KNEE.values, observations, order)
    assert whole.fast.uncertain_samples == case.fast.uncertain_samples
