"""Coordinates: round trips, Jacobians against finite differences, bounds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats

from bayesfric.inference.coordinates import (
    BoundedCoordinates,
    GearboxCoordinates,
    choose_coordinates,
)
from bayesfric.inference.priors import read_prior
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.own_term import Term

INF = math.inf


def numeric_log_determinant(mapped, u, step=1e-6):
    """Of a map's Jacobian, by differences over so much of each coordinate."""
    jacobian = np.empty((u.size, u.size))
    for i in range(u.size):
        h = step * max(abs(u[i]), 1e-2)
        neighbours = np.stack([u, u])
        neighbours[0, i] += h
        neighbours[1, i] -= h
        high, low = mapped(neighbours)[0]
        jacobian[:, i] = (high - low) / (2 * h)
    return np.linalg.slogdet(jacobian)[1]


widths = st.lists(st.floats(0.01, 20.0), min_size=4, max_size=4)


@settings(max_examples=60, deadline=None)
# four sds out a place is 4e-5 widths from its bound: further, differences lose its last digits
@given(st.one_of(st.none(), widths), st.lists(st.floats(-4.0, 4.0), min_size=4, max_size=4))
def test_bounded_coordinates_invert_and_their_jacobian_is_right(given_widths, u):
    coordinates = BoundedCoordinates(
        [0.0, -1.0, -INF, -INF],
        [INF, 2.0, INF, 5.0],
        None if given_widths is None else np.array(given_widths),
    )
    u = np.array(u)
    x, jacobian = coordinates.to_parameters(u[None])
    if given_widths is not None:
        assume(np.isfinite(jacobian[0]))
    np.testing.assert_allclose(coordinates.from_parameters(x)[0], u, rtol=1e-6, atol=1e-6)
    # five sds out a shorter step would be lost in rounding: 2e-16 over a slope of 5e-6
    numeric = numeric_log_determinant(coordinates.to_parameters, u, step=1e-4)
    assert jacobian[0] == pytest.approx(numeric, abs=1e-5)
    assert x[0, 0] > 0.0
    assert x[0, 1] > -1.0
    assert x[0, 3] < 5.0


def test_with_widths_a_parameter_is_its_own_coordinate_and_the_bound_cuts_it():
    coordinates = BoundedCoordinates([0.0, -INF], [INF, 5.0], np.array([0.1, 2.0]))
    x = np.array([[3.0, -2.0], [1e-9, 4.9], [-1e-9, 1.0], [1.0, 5.1]])
    parameters, slope = coordinates.to_parameters(x)
    np.testing.assert_array_equal(parameters, x)
    assert slope.tolist() == [0.0, 0.0, -INF, -INF]
    np.testing.assert_array_equal(coordinates.from_parameters(x[:2]), x[:2])


def test_a_uniform_share_between_two_bounds_is_a_standard_normal_coordinate():
    """What the prior alone says of a parameter between bounds: no long tail at either."""
    coordinates = BoundedCoordinates([-0.6], [0.6])
    u = np.linspace(-8.0, 8.0, 41)[:, None]
    x, jacobian = coordinates.to_parameters(u)
    density = jacobian + stats.uniform(-0.6, 1.2).logpdf(np.clip(x[:, 0], -0.6, 0.6))
    np.testing.assert_allclose(density, stats.norm.logpdf(u[:, 0]), rtol=1e-12)


@pytest.mark.parametrize("given_widths", [None, np.array([0.02])])
def test_what_rounding_puts_on_a_bound_is_impossible(given_widths):
    """A partial autocorrelation of one has no density to divide by."""
    coordinates = BoundedCoordinates([-1.0], [1.0], given_widths)
    x, jacobian = coordinates.to_parameters(np.array([[-800.0], [0.0], [800.0]]))
    assert (np.abs(x[np.isfinite(jacobian)]) < 1.0).all()
    assert np.isfinite(jacobian).tolist() == [False, True, False]


# -- joints with load-dependent friction

KNEE = PRESETS["rabbit-knee"]
MOTOR, GEARBOX, JOINT = KNEE.chain().elements
MORE = {
    "gearbox.load": 0.4,
    "joint.viscous_positive": 4.0,
    "joint.viscous_negative": 6.0,
    "gearbox.stribeck_ratio": 0.5,
    "gearbox.stribeck_velocity": 2.0,
    "joint.cogging": -0.3,
    "load.gravity_angle": 0.4,
    "offset": -0.02,
    "drive.gain": 1.1,
}
CHAINS = {
    "knee": KNEE.chain(),
    "one loss": replace(KNEE.chain(), elements=(MOTOR, replace(GEARBOX, load_loss="one"), JOINT)),
    "viscous by direction": replace(
        KNEE.chain(), elements=(MOTOR, GEARBOX, replace(JOINT, viscous="by-direction"))
    ),
    "rise, offset, gain": replace(
        KNEE.chain(), elements=(MOTOR, replace(GEARBOX, stribeck=True), JOINT),
        offset=True, gain=True,
    ),
    "angle and a user's term": replace(
        KNEE.chain().with_term(Term("joint.cogging", lambda m: np.sin(6.0 * m.position))),
        load=replace(KNEE.chain().load, gravity_angle=True),
    ),
}  # fmt: skip


def values_of(chain):
    return np.array([(KNEE.values | MORE)[name] for name in chain.names])


def priors_of(chain, changes=()):
    changes, priors = dict(changes), {}
    for p in chain.parameters:
        text = {"distribution": "halfnorm", "scale": 10.0}
        if p.lower < 0.0:
            text = {"distribution": "norm", "scale": 10.0}
        text, upper = changes.get(p.name, text), min(p.upper, p.row.prior_upper)
        priors[p.name] = read_prior(
            p.name, text, lower=p.lower, upper=p.upper if p.name in changes else upper
        )
    return priors


COORDINATES = choose_coordinates(KNEE.chain(), priors_of(KNEE.chain()))
POINT = COORDINATES.from_parameters(values_of(KNEE.chain())[None])


def rows_of(chain, priors, n, seed):
    """Random joints with a passive, reversible gearbox, their free parameters."""
    rng = np.random.default_rng(seed)
    rows = values_of(chain) * rng.uniform(0.3, 2.0, (n, len(chain.names)))
    for i, name in enumerate(chain.names):
        rows[:, i] = rng.uniform(0.01, 0.9, n) if "gearbox.load" in name else rows[:, i]
    return rows[:, [i for i, name in enumerate(chain.names) if not priors[name].fixed]]


KNOWN = (
    {},
    {"load.first_moment": {"distribution": "norm", "loc": 0.4, "scale": 0.01}},
    {"gearbox.load_drive": {"distribution": "norm", "loc": 0.3, "scale": 0.01}},
    {"load.first_moment": 0.42},
    {"load.inertia": 0.15, "load.first_moment": 0.42},
    {"gearbox.load_drive": 0.3},
    {"gearbox.load_back": 0.2},
    {"gearbox.load_drive": 0.3, "gearbox.load_back": 0.2},
    {"gearbox.load": 0.3},
    {"gearbox.load": [0.0, 3.0]},
    {"motor.coulomb_positive": 0.1},
    {"joint.coulomb_positive": 5.0},
)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        (name, prior_texts)
        for name, chain in CHAINS.items()
        for prior_texts in KNOWN
        if prior_texts.keys() <= {*chain.names}
    ],
    ids=str,
)
def test_every_form_round_trips_and_its_jacobian_is_right(name, changes):
    chain = CHAINS[name]
    priors = priors_of(chain, changes)
    coordinates = choose_coordinates(chain, priors)
    assert isinstance(coordinates, GearboxCoordinates)
    rows = rows_of(chain, priors, 200, seed=1)
    known = {n: p.value for n, p in priors.items() if p.fixed}
    passive = {"gearbox.load_drive", "gearbox.load_back"} & set(known)
    u = coordinates.from_parameters(rows)
    # m cannot be below what a known loss leaves of it, nor is there a row that says so
    assert passive or np.isfinite(u).all()
    u = u[np.isfinite(u).all(axis=1)]
    assert u.shape == (len(u), rows.shape[1])
    assert len(u) > 30
    back, jacobian = coordinates.to_parameters(u)
    np.testing.assert_allclose(coordinates.from_parameters(back), u, rtol=1e-7, atol=1e-7)
    if not passive:
        np.testing.assert_allclose(back, rows, rtol=1e-9)
    for place, closed in zip(u[:15], jacobian[:15], strict=True):
        assert closed == pytest.approx(
            numeric_log_determinant(coordinates.to_parameters, place), abs=1e-5
        )


@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
def test_linear_coordinates_round_trip_and_their_jacobian_is_right(chain):
    coordinates = choose_coordinates(chain, priors_of(chain))
    assert coordinates.is_nonlinear
    u = coordinates.from_parameters(rows_of(chain, priors_of(chain), 30, seed=5))
    linear, slope = coordinates.to_linear(u)
    np.testing.assert_allclose(coordinates.from_linear(linear), u, rtol=1e-9, atol=1e-9)
    for place, closed in zip(u, slope, strict=True):
        numeric = numeric_log_determinant(coordinates.to_linear, place)
        assert closed == pytest.approx(numeric, abs=1e-5)
    linear[:, 0] = -linear[:, 0]  # without an inverse
    assert not np.isfinite(coordinates.from_linear(linear)).all(axis=1).any()


def test_the_torque_is_linear_in_linear_coordinates():
    """So an identified posterior is normal there: eq. (13) at fixed directions of power."""
    linear = np.repeat(COORDINATES.to_linear(POINT)[0], 3, axis=0)
    linear[1:, :10] *= 1.0 + np.outer([0.5, 1.0], np.linspace(-1e-3, 1e-3, 10))
    rows, _ = COORDINATES.to_parameters(COORDINATES.from_linear(linear))
    rng = np.random.default_rng(6)
    q, qd, qdd = rng.normal(size=(3, 200)) + np.array([[0.0], [0.0], [3.0]])
    first, middle, last = inverse_torque(KNEE.chain(), rows, q, qd, qdd)
    away = np.abs(last - first).max()
    assert np.quantile(np.abs(middle - 0.5 * (first + last)), 0.9) < 1e-9 * away


def test_the_scale_leaves_the_torque_alone_and_fills_the_passive_interval():
    """Notes: dissipativity confines the factor k to [1/alpha_2, 1/alpha_1]."""
    u = np.tile(POINT, (41, 1))
    u[:, 10] = np.linspace(-30.0, 30.0, 41)
    rows, _ = COORDINATES.to_parameters(u)
    q, qd, qdd = np.random.default_rng(2).normal(size=(3, 200))
    torque = inverse_torque(KNEE.chain(), rows, q, qd, qdd)
    assert np.abs(torque - torque[0]).max() < 1e-12
    assert (rows[:, 4:6] >= -1e-12).all()
    factor = rows[:, 10] / values_of(KNEE.chain())[10]
    assert factor.max() == pytest.approx(1.0 / 0.7432, rel=1e-9)
    assert factor.min() == pytest.approx(1.0 / 1.408, rel=1e-9)


def test_the_torque_while_the_motor_drives_depends_on_the_first_coordinates_alone():
    others = np.tile(POINT, (50, 1))
    # four sums of motor and leg, then their shares, then gravity's
    moving = [4, 5, 6, 7]
    others[:, [*moving, 9, 10]] = np.random.default_rng(4).normal(size=(50, 6))
    rows, _ = COORDINATES.to_parameters(others)
    # a load that pulls against the motion, so that the motor drives throughout
    q, qd, qdd = np.full(30, 0.7), np.linspace(0.1, 3.0, 30), np.linspace(0.0, 5.0, 30)
    torque = inverse_torque(KNEE.chain(), rows, q, qd, qdd)
    assert np.abs(torque - torque[0]).max() < 1e-9 * np.abs(torque).max()


def test_impossible_gearboxes_have_no_density():
    u = np.tile(POINT, (2, 1))
    u[0, 0] = -u[0, 0]  # less than no torque, shared between motor and leg
    u[1, 0] = math.nan
    assert np.isneginf(COORDINATES.to_parameters(u)[1]).all()


def test_they_are_for_one_load_dependent_element():
    knee = KNEE.chain()
    # mu_2 above one, an irreversible gearbox, passes nothing back
    irreversible = priors_of(knee, {"gearbox.load_back": [0.0, 2.0]})
    assert isinstance(choose_coordinates(knee, irreversible), BoundedCoordinates)
    lossless, one = (replace(GEARBOX, load_loss=loss) for loss in ("none", "one"))
    for chain in (
        replace(knee, elements=(MOTOR, lossless, JOINT)),
        replace(knee, elements=(MOTOR, GEARBOX, replace(JOINT, load_loss="one"))),
        Joint(elements=(MOTOR, one)),
    ):
        assert isinstance(choose_coordinates(chain, priors_of(chain)), BoundedCoordinates)
