"""Facts about simulated motions: closed forms, energy, order of convergence, rivals' bugs."""

import itertools

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import ellipk

from bayesfric.mechanism import forward, integrate, kernels
from bayesfric.mechanism.element import STANDARD_GRAVITY, Element, Load
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.recordings.measurement import Inputs
from tests.mechanism.joints import (
    EVERYTHING,
    EVERYTHING_VALUES,
    KNEE,
    axis,
    carried_to_motor,
    signal,
)

AMPLITUDES = {"rabbit-knee": 0.8, "motor-axis": 0.8, "servo-pendulum": 0.4}
JOINTS = {n: (p.chain(), p.values, AMPLITUDES[n]) for n, p in PRESETS.items()} | {
    "everything": (EVERYTHING, EVERYTHING_VALUES, 0.5)
}


@settings(max_examples=65, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    name=st.sampled_from(sorted(JOINTS)),
    exponents=st.lists(st.floats(-0.6, 0.6), min_size=5, max_size=25),
    seed=st.integers(0, 1000),
    mass=st.floats(0.0, 3.0),
    q0=st.floats(-2.0, 2.0),
    qd0=st.floats(-2.0, 2.0),
    hold=st.sampled_from(["linear", "zero"]),
)
def test_inverse_model_returns_the_torque(name, exponents, seed, mass, q0, qd0, hold):
    chain, values, amplitude = JOINTS[name]
    vector = chain.vector(values)
    vector = vector * np.exp(np.resize(exponents, vector.size))
    torque, inputs = signal(2e-3, amplitude=amplitude, seed=seed), Inputs(mass, 0.35)
    start = {"q0": q0, "qd0": qd0}
    motion = simulate(chain, vector, torque, 2e-3, substeps=2, inputs=inputs, hold=hold, **start)
    back = inverse_torque(chain, vector, motion.q, motion.qd, motion.qdd, inputs=inputs)
    moving = np.abs(motion.qd) > 0
    scale = max(1.0, np.abs(torque).max())
    assert np.abs(back - torque)[moving].max(initial=0.0) <= 1e-12 * scale
    np.testing.assert_array_equal(motion.qd[motion.sticking], 0.0)
    np.testing.assert_array_equal(motion.qdd[motion.sticking], 0.0)


def random_joint(rng, mu=1.5):
    n = rng.integers(1, 5)
    elements = np.zeros((n, len(kernels.ELEMENT_SLOTS)))
    on = rng.random(elements.shape) < 0.7
    elements[:, kernels.RATIO] = np.where(rng.random(n) < 0.3, 1.0, rng.uniform(0.2, 30.0, n))
    for slot, size in (
        (kernels.INERTIA, 0.01),
        (kernels.COULOMB_POSITIVE, 1.0),
        (kernels.COULOMB_NEGATIVE, 1.0),
        (kernels.VISCOUS, 0.2),
        (kernels.QUADRATIC, 0.02),
        (kernels.STRIBECK_RATIO, 1.0),
        (kernels.STRIBECK_LOAD_RATIO, 1.0),
        (kernels.LOAD_DRIVE_DIFFERENCE, 0.1),
        (kernels.LOAD_BACK_DIFFERENCE, 0.1),
        (kernels.LOAD_DRIVE, mu),
        (kernels.LOAD_BACK, mu),
    ):
        elements[:, slot] = rng.uniform(0, size, n) * on[:, slot]
    elements[:, kernels.STRIBECK_VELOCITY] = rng.uniform(0.1, 5.0, n)
    elements[:, kernels.STRIBECK_EXPONENT] = rng.choice([2.0, 0.7], n)
    elements[0, kernels.INERTIA] += 1e-3
    load = np.array([rng.choice([0.0, 0.3]), rng.uniform(0, 1), rng.uniform(-3, 3), 9.8, 0.0, 1.0])
    return integrate.plant_of(elements[None], load[None], None, 0), load


def test_closed_form_acceleration_agrees_with_root_finding():
    rng = np.random.default_rng(1)
    tried = irreversible = 0
    while tried < 3000:
        joint, load = random_joint(rng)
        elements = joint.elements
        low, _ = forward.slope_bounds(elements[np.newaxis], np.array([joint.inertia]))
        if low[0] <= 1e-6:
            continue
        tried += 1
        irreversible += bool(np.any(elements[:, kernels.LOAD_BACK] > 1))
        q, qd, torque = rng.uniform(-3, 3), rng.uniform(-2, 2), rng.normal() * 3
        sign = float(np.sign(qd))
        gravity = kernels.gravity_torque(load, np.sin(q), np.cos(q))

        def excess(a, elements=elements, gravity=gravity, joint=joint, s=sign, v=qd, t=torque):
            return carried_to_motor(elements, joint.inertia * a + gravity, s, v, a) - t

        at = joint, q, qd, torque, 0.0, sign
        found, pattern = integrate.acceleration(*at, integrate.FREE)
        reach = abs(excess(0.0)) / low[0] * 1.01 + 1e-9
        brute = brentq(excess, -reach, reach, xtol=1e-14, rtol=1e-15)
        scale = abs(brute) + (abs(gravity) + abs(torque) + 10.0) / low[0]
        assert abs(found - brute) <= 1e-12 * scale
        # the frozen pattern is that motion's, and gives the same acceleration
        assert integrate.acceleration(*at, pattern) == (found, pattern)
        for k in range(len(elements)):
            out = carried_to_motor(
                elements[k + 1 :], joint.inertia * found + gravity, sign, qd, found
            )
            if joint.kinks >> k & 1 and abs(out) > 1e-9:
                assert bool(pattern >> k & 1) == (out * sign > 0)
    assert irreversible > 100


def test_slope_bounds_are_those_of_all_patterns():
    rng = np.random.default_rng(2)
    for _ in range(300):
        joint, _ = random_joint(rng)
        elements = joint.elements.copy()
        for slot in ("stribeck_load_ratio", "load_drive_difference", "load_back_difference"):
            elements[:, kernels.ELEMENT_SLOTS.index(slot)] = 0.0
        joint = joint._replace(elements=elements)
        slopes = []
        for bits in itertools.product((0, 1), repeat=len(elements)):
            pattern = sum(bit << k for k, bit in enumerate(bits))
            a, b = (
                integrate.acceleration(joint, 0.1, 1.0, t, 0.0, 1.0, pattern)[0] for t in (0.0, 1.0)
            )
            slopes.append(1 / (b - a))
        low, high = forward.slope_bounds(elements[np.newaxis], np.array([joint.inertia]))
        np.testing.assert_allclose([low[0], high[0]], [min(slopes), max(slopes)], rtol=1e-8)


# --- closed forms ---------------------------------------------------------------------


def test_reversals_inside_one_step_are_found():
    # speed 0.7 - 3.1 t + 3 t² is positive at both ends of the step but not between
    chain = axis(coulomb="symmetric")
    motion = simulate(chain, [1.0, 0.1], [-3.0, 3.0], 1.0, qd0=0.7, substeps=1)
    assert (motion.events, motion.reversals) == (2, 2)
    np.testing.assert_allclose(motion.qd[1], 0.66, rtol=1e-13)


def test_axis_under_constant_torque_is_exponential():
    preset = PRESETS["motor-axis"]
    chain = preset.chain()
    motion = simulate(chain, chain.vector(preset.values), np.full(2001, 0.9), 1e-3)
    rate = 0.05 / 0.01
    final = (0.9 - 0.02 - 0.2) / 0.05
    np.testing.assert_allclose(motion.qd, final * -np.expm1(-rate * motion.time), atol=1e-9)
    q = final * (motion.time + np.expm1(-rate * motion.time) / rate)
    np.testing.assert_allclose(motion.q, q, rtol=0, atol=1e-9)
    assert np.abs(motion.q - q).max() < 10 * motion.step_error + 1e-13


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_coulomb_friction_stops_a_mass_where_and_when_it_should(direction):
    inertia, coulomb, v0 = 0.37, 0.81, 1.3
    chain = axis(coulomb="symmetric")
    values = chain.vector({"motor.inertia": inertia, "motor.coulomb": coulomb})
    motion = simulate(chain, values, np.zeros(1001), 1e-3, q0=0.2, qd0=direction * v0, substeps=1)
    stop = v0 * inertia / coulomb
    moving = motion.time < stop
    t = motion.time[moving]
    np.testing.assert_array_equal(motion.sticking, ~moving)
    np.testing.assert_allclose(
        motion.qd[moving], direction * (v0 - coulomb / inertia * t), rtol=0, atol=1e-13
    )
    rest = 0.2 + direction * v0**2 * inertia / (2 * coulomb)
    np.testing.assert_allclose(motion.q[~moving], rest, rtol=0, atol=1e-13)
    assert np.all(motion.q[~moving] == motion.q[-1])
    assert not np.any(motion.qd[~moving])
    assert not np.any(motion.qdd[~moving])
    assert (motion.events, motion.reversals) == (1, 0)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_breakaway_comes_at_the_instant_the_torque_reaches_the_limit(direction):
    inertia, coulomb, viscous, slope = 0.02, 0.3137, 0.11, 1.7
    chain = axis(coulomb="symmetric", viscous=True)
    values = chain.vector(
        {"motor.inertia": inertia, "motor.coulomb": coulomb, "motor.viscous": viscous}
    )
    time = np.arange(101) * 1e-2
    motion = simulate(chain, values, direction * slope * time, 1e-2, q0=0.123, tolerance=1e-11)
    since = time - coulomb / slope
    np.testing.assert_array_equal(motion.sticking, since <= 0)
    assert np.all(motion.q[since <= 0] == 0.123)
    x = np.clip(since, 0, None)
    rate = viscous / inertia
    q = slope / viscous * (x**2 / 2 - x / rate - np.expm1(-rate * x) / rate**2)
    np.testing.assert_allclose(motion.q, 0.123 + direction * q, rtol=0, atol=3e-11)
    assert motion.events == 1


@pytest.mark.parametrize("amplitude", [0.3, 1.5, 3.0])
def test_pendulum_swings_with_the_period_of_the_elliptic_integral(amplitude):
    chain = Joint(
        elements=(Element("motor", inertia=True),), load=Load(first_moment=True, inertia=True)
    )
    values = chain.vector({"motor.inertia": 0.01, "load.inertia": 0.04, "load.first_moment": 0.1})
    swing = 4 * np.sqrt(0.05 / (0.1 * STANDARD_GRAVITY)) * ellipk(np.sin(amplitude / 2) ** 2)
    motion = simulate(chain, values, np.zeros(1601), swing / 400, q0=amplitude, tolerance=1e-11)
    # after quarters the pendulum passes the bottom, where an error of time shows most
    np.testing.assert_allclose(motion.q[100::200], 0.0, atol=1e-8)
    np.testing.assert_allclose(motion.q[0::400], amplitude, rtol=0, atol=1e-8)
    np.testing.assert_allclose(motion.q[200::400], -amplitude, rtol=0, atol=1e-8)
    # the last turning point is the last sample, on which side of it rounding says
    assert motion.reversals in (7, 8)


# --- stiction -------------------------------------------------------------------------


@pytest.mark.parametrize("q0", [-1.5707, 0.4, 1.2])
@pytest.mark.parametrize(("back", "moment"), [(0.98, 0.42), (1.0, 0.42), (1.3, 0.42), (1.0, 4.2)])
def test_irreversible_gearbox_holds_a_raised_load_for_ever(q0, back, moment):
    chain = KNEE.chain()
    values = KNEE.values | {"gearbox.load_back": back, "load.first_moment": moment}
    still = np.zeros(2001)
    motion = simulate(chain, chain.vector(values), still, 1e-2, q0=q0, substeps=2)
    assert motion.sticking.all()
    assert (motion.q == q0).all()
    assert not motion.qd.any()
    assert not motion.qdd.any()
    assert motion.events == 0
    if moment > 1.0 and q0 == 1.2:
        # a reversible gearbox lets it down, to where gravity no longer overcomes friction
        reversible = chain.vector(KNEE.values | {"load.first_moment": moment})
        motion = simulate(chain, reversible, still, 1e-2, q0=q0)
        assert not motion.sticking[0]
        assert 0.1 < motion.q[-1] < 1.1
        assert abs(motion.qd[-1]) < 1e-6


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_a_torque_between_samples_goes_as_it_is_told(hold):
    """A sine on a bare inertia, q = -sin(w t)/w² + t/w: an error each hold has its own order of."""
    w, errors = 2.0 * np.pi, []
    for n in (25, 50):
        time = np.arange(n + 1) / n
        motion = simulate(axis(), [1.0], np.sin(w * time), 1.0 / n, hold=hold)
        errors.append(np.abs(motion.q - (time / w - np.sin(w * time) / w**2)).max())
    # held comes half a sample late; straight lines cut the sine's corners
    order, bound = {"zero": (1, 2e-2), "linear": (2, 2.5e-4)}[hold]
    assert errors[1] < bound
    assert errors[0] / errors[1] > 0.8 * 2**order


def test_stribeck_raises_the_breakaway_torque():
    chain = axis(coulomb="symmetric", stribeck=True)
    values = [0.01, 0.2, 0.5, 0.1]
    assert chain.names[1:3] == ("motor.coulomb", "motor.stribeck_ratio")
    time = np.arange(1001) * 1e-3
    motion = simulate(chain, values, 0.4 * time, 1e-3)
    np.testing.assert_array_equal(motion.sticking, 0.4 * time <= 0.2 * 1.5 + 1e-15)
