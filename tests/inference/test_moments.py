"""Moments against their definition in loops, and the fast ones against those of every sample."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.estimates.autoregression import follows
from bayesfric.estimates.torque import filtered_torque, torque_jacobian
from bayesfric.inference import moments
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.linear_torque import ACCURACY, linear_torque
from bayesfric.inference.moments import PlainMoments, fast_moments
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.recordings.filters import ParallelFilter
from bayesfric.recordings.measurement import Signal

KNEE = PRESETS["rabbit-knee"]
AXIS = PRESETS["motor-axis"]


def with_gaps(o, dropped):
    """The same recording without some of its outputs, and with samples that do not count."""
    kept = np.setdiff1d(np.arange(o.filter.n_outputs), dropped)
    used, gains = np.ones(o.q.size), np.ones(kept.size)
    if o.filter.taps.size > 1:
        used[np.random.default_rng(9).integers(o.q.size, size=o.q.size // 50)] = 0.0
        windows = np.lib.stride_tricks.sliding_window_view(used, o.filter.taps.size)
        gains = 1.0 / (windows[o.filter.starts[kept]] @ o.filter.taps)
    filter_ = ParallelFilter(o.filter.taps, o.filter.starts[kept], used, gains)
    return replace(
        o,
        filter=filter_,
        time=o.time[kept],
        measured=filter_.apply(o.torque),
        speed=o.speed[kept],
        segment_of=o.segment_of[kept],
    )


def by_definition(chain, observations, values, order):
    by_age = [np.zeros((len(values), len(observations), k, k)) for k in range(1, order + 2)]
    counts = np.zeros((len(observations), order + 1), dtype=int)
    for i, o in enumerate(observations):
        residual = o.measured - filtered_torque(chain, o, values)
        for r in np.split(residual, np.flatnonzero(~follows(o)) + 1, axis=1):
            for m in range(r.shape[1]):
                age = min(m, order)
                past = r[:, m - age : m + 1][:, ::-1]
                by_age[age][:, i] += past[:, :, None] * past[:, None, :]
                counts[i, age] += 1
    return by_age, counts


@pytest.mark.parametrize("factor", [1, 5])
@pytest.mark.parametrize("order", [0, 1, 2, 4])
def test_moments_are_their_definition(make_observation, monkeypatch, factor, order):
    chain = KNEE.chain()
    all_outputs = make_observation(chain, KNEE.values, n=400 * factor, factor=factor)
    # runs of 30, 1, 2, 3 and many outputs
    gaps = with_gaps(all_outputs, np.array([30, 32, 35, 39]))
    loaded = make_observation(
        chain, KNEE.values, n=300 * factor, factor=factor, seed=1, added_mass=2.0, radius=0.3
    )
    observations = [all_outputs, gaps, loaded]
    rng = np.random.default_rng(0)
    values = chain.vector(KNEE.values) * rng.uniform(0.5, 1.5, (5, len(chain.names)))
    plain = PlainMoments(chain, observations, order)
    result = plain.at(values)
    exact, counts = by_definition(chain, observations, values, order)
    bound = 1e-11 * np.trace(exact[-1], axis1=2, axis2=3)[:, :, None, None]
    for products, expected in zip(result, exact, strict=True):
        assert (np.abs(products - expected) <= bound).all()
    np.testing.assert_array_equal(plain.counts, counts)
    # vectors computed in several blocks
    monkeypatch.setattr(moments, "_BLOCK_NUMBERS", 2 * all_outputs.q.size)
    for products, expected in zip(plain.at(values), result, strict=True):
        np.testing.assert_allclose(products, expected, rtol=1e-12)


# --- fast moments

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
    values = {**values, **shapes}
    return chain, {name: values[name] for name in chain.names}


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
LOADED = {"added_mass": 1.0, "radius": 0.3}
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
            result = self.fast.at(values)
            squares = sum(products[..., 0, 0] for products in expected)
            # What rounding leaves of each residual is eps times the torques whose difference
            # it is. That is far below 1e-9 of the sum of squares unless residuals are 1e-5 of
            # the torques or less.
            # A shape's column is interpolated.
            eps = 4 * 20 * np.finfo(float).eps + (ACCURACY if self.shaped else 0.0)
            lost = eps * np.nan_to_num(self.size(values), posinf=np.inf)
            bound = 1e-9 * squares + lost * (np.sqrt(squares) + lost)
        number = np.isfinite(squares)
        for a, b in zip(result, expected, strict=True):
            good = np.isfinite(b)
            np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
            np.testing.assert_array_equal(a[~good], b[~good])
            compared = good & number[..., None, None]
            error = np.abs(np.where(compared, a, 0.0) - np.where(compared, b, 0.0))
            assert (error.max(axis=(2, 3), initial=0.0) <= np.where(number, bound, np.inf)).all()
        return result

    def size(self, values):
        """Root sum of squares of the measured torque and of each column's torque."""
        linear = linear_torque(self.chain, self.observations, self.draws)
        coefficients = linear.coefficients(values)[0]
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


def still(o, samples):
    """Stand still for a while: at rest there is no loss."""
    speed = o.qd.copy()
    speed[samples] = 0.0
    return replace(o, qd=speed)


HUNG = replace(SINGLE, load=Load(gravity_angle=True), gain=True)
# chain, values, order, and how recordings are simulated
CASES = {
    "knee-one-known-mass": (KNEE.chain(), KNEE.values, 1, {"factor": 3, **LOADED}),
    "single-mu-known-mass": (SINGLE, SINGLE_VALUES, 0, {"n": 900, **LOADED}),
    "no-load-loss": (AXIS.chain(), AXIS.values, 1, {"n": 800, "factor": 2, "added_mass": 3.0}),
    # a mass that is known, at an angle that is not: with a moment of the joint's own, and without
    "angle-known-mass": (
        ANGLED, KNEE.values | {"load.gravity_angle": 0.2}, 1,
        {"n": 500, **LOADED, "added_mass": 0.0}, {"n": 500, "seed": 1, **LOADED, "added_mass": 2.0},
    ),
    "angle-known-mass-only": (
        HUNG, {name: SINGLE_VALUES.get(name, 0.3) for name in HUNG.names}, 2,
        {"n": 700, "factor": 2, **LOADED},
    ),
    "rest": (KNEE.chain(), KNEE.values, 2, {"n": 900, "factor": 3}),
    # no noise: the sum of squares itself is rounding at the truth
    "exact": (KNEE.chain(), KNEE.values, 2, {"n": 900, "sigma": 0.0}),
    # an unknown gain, with and without a load loss and a mass that is known
    "gain": (
        replace(KNEE.chain(), gain=True), KNEE.values | {"drive.gain": 0.8}, 1,
        {"n": 900, "factor": 3},
    ),
    "gain-single-mu-known-mass": (
        replace(SINGLE, gain=True), SINGLE_VALUES | {"drive.gain": 0.8}, 1,
        {"n": 900, "factor": 3, **LOADED},
    ),
    **{name: (*case, 1, {"n": 9000, "factor": 2}) for name, case in SHAPED.items()},
    "narrow": (KNEE.chain(), KNEE.values, 1, {"n": 3000, "factor": 3}),
}  # fmt: skip
KNEES = {f"knee-{f}-{order}": (f, order) for f, order in ((1, 0), (4, 1), (1, 2), (4, 2))}
NAMES = [*KNEES, *CASES, "gain-delay"]


@pytest.fixture(scope="module")
def cases(make_observation):
    built = {}
    for name, (factor, order) in KNEES.items():
        observations = knee_observations(make_observation, factor)
        built[name] = Case(KNEE.chain(), KNEE.values, observations, order)
    for name, (chain, values, order, *recordings) in CASES.items():
        observations = [make_observation(chain, values, **options) for options in recordings]
        if name == "rest" or name in SHAPED:
            samples = slice(200, 260 if name == "rest" else 220)
            observations = [still(o, samples) for o in observations]
        options = {"radius": 1.5} if name == "narrow" else {}
        built[name] = Case(chain, values, observations, order, **options)
    # of a delay's torque, which is that of the recording, the gain is no factor
    with_gain, values = replace(AXIS.chain(), gain=True), {**AXIS.values, "drive.gain": 0.8}
    o = make_observation(with_gain, values, n=900, factor=3, added_mass=3.0, radius=0.3)
    inputs = replace(o.inputs, torque_rate=Signal(o.stamps, np.gradient(o.torque, o.stamps)))
    late, values = replace(with_gain, delay=True), {**values, "drive.delay": 0.002}
    built["gain-delay"] = Case(late, values, [replace(o, inputs=inputs)], 1)
    return built


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
    for seed, (draw, size) in enumerate(TRIED):
        cases[name].check(draw(cases[name], np.random.default_rng(seed), size))


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
    assert 10 < case.fast.uncertain_samples < sum(o.q.size for o in case.observations)


def test_a_sample_exactly_at_the_kink(make_observation):
    """Where the load takes no torque at the centre either sign is as good."""
    chain = replace(KNEE.chain())
    o = make_observation(chain, KNEE.values, n=600)
    q, qd, qdd = o.q.copy(), o.qd.copy(), o.qdd.copy()
    q[::50] = qdd[::50] = 0.0
    values = {**KNEE.values, "joint.viscous": 0.0, "joint.coulomb_positive": 0.0}
    values["joint.coulomb_negative"] = 0.0
    case = Case(chain, values, [replace(o, q=q, qd=qd, qdd=qdd)], 2)
    vector = chain.vector(values)
    other = vector.copy()
    other[chain.names.index("joint.coulomb_positive")] = -0.01
    case.check(np.stack([vector, other, 2.0 * vector]))
    at_centre = fast_moments(chain, case.observations, vector[None], 2)
    for row in (vector, other):
        for result, expected in zip(at_centre.at(row[None]), case.plain.at(row[None]), strict=True):
            np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-12)


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
    observations = knee_observations(make_observation, factor)
    monkeypatch.setattr(moments, "_CHUNK", 50)
    case = Case(KNEE.chain(), KNEE.values, observations, order)
    case.check(case.draws)
    monkeypatch.undo()
    unbroken = Case(KNEE.chain(), KNEE.values, observations, order)
    assert unbroken.fast.uncertain_samples == case.fast.uncertain_samples
