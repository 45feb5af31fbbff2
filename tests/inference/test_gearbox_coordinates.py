"""Coordinates of joints with a load loss: what stays, round trips, Jacobians by differences."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bayesfric.inference.coordinates import BoundedCoordinates
from bayesfric.inference.gearbox_coordinates import GearboxCoordinates, choose_coordinates
from bayesfric.inference.prior.priors import read_prior
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.own_term import Term
from tests.inference.test_coordinates import numeric_log_determinant

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
    "angle and a term of one's own": replace(
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
        (name, some)
        for name, chain in CHAINS.items()
        for some in KNOWN
        if some.keys() <= {*chain.names}
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
def test_straight_coordinates_round_trip_and_their_jacobian_is_right(chain):
    coordinates = choose_coordinates(chain, priors_of(chain))
    assert coordinates.is_nonlinear
    u = coordinates.from_parameters(rows_of(chain, priors_of(chain), 30, seed=5))
    straight, slope = coordinates.to_linear(u)
    np.testing.assert_allclose(coordinates.from_linear(straight), u, rtol=1e-9, atol=1e-9)
    for place, closed in zip(u, slope, strict=True):
        numeric = numeric_log_determinant(coordinates.to_linear, place)
        assert closed == pytest.approx(numeric, abs=1e-5)
    straight[:, 0] = -straight[:, 0]  # nothing to go back to
    assert not np.isfinite(coordinates.from_linear(straight)).all(axis=1).any()


def test_the_torque_is_linear_in_the_straight_ones():
    """So a posterior that the data tell is normal there: eq. (13) at fixed directions of power."""
    chain = KNEE.chain()
    coordinates = choose_coordinates(chain, priors_of(chain))
    u = coordinates.from_parameters(values_of(chain)[None])
    straight = np.repeat(coordinates.to_linear(u)[0], 3, axis=0)
    straight[1:, :10] *= 1.0 + np.outer([0.5, 1.0], np.linspace(-1e-3, 1e-3, 10))
    rows, _ = coordinates.to_parameters(coordinates.from_linear(straight))
    rng = np.random.default_rng(6)
    q, qd, qdd = rng.normal(size=(3, 200)) + np.array([[0.0], [0.0], [3.0]])
    first, middle, last = inverse_torque(chain, rows, q, qd, qdd)
    away = np.abs(last - first).max()
    assert np.quantile(np.abs(middle - 0.5 * (first + last)), 0.9) < 1e-9 * away


def test_the_scale_leaves_the_torque_alone_and_fills_the_passive_interval():
    """Notes: dissipativity confines the factor k to [1/alpha_2, 1/alpha_1]."""
    chain = KNEE.chain()
    coordinates = choose_coordinates(chain, priors_of(chain))
    u = np.tile(coordinates.from_parameters(values_of(chain)[None]), (41, 1))
    u[:, 10] = np.linspace(-30.0, 30.0, 41)
    rows, _ = coordinates.to_parameters(u)
    q, qd, qdd = np.random.default_rng(2).normal(size=(3, 200))
    torque = inverse_torque(chain, rows, q, qd, qdd)
    assert np.abs(torque - torque[0]).max() < 1e-12
    assert (rows[:, 4] >= -1e-12).all()
    assert (rows[:, 5] >= -1e-12).all()
    factor = rows[:, 10] / values_of(chain)[10]
    assert factor.max() == pytest.approx(1.0 / 0.7432, rel=1e-9)
    assert factor.min() == pytest.approx(1.0 / 1.408, rel=1e-9)


def test_what_is_felt_while_the_motor_drives_hangs_on_the_first_coordinates_alone():
    chain = KNEE.chain()
    coordinates = choose_coordinates(chain, priors_of(chain))
    u = coordinates.from_parameters(rows_of(chain, priors_of(chain), 1, seed=3))
    others = np.tile(u, (50, 1))
    # four felt with shares between motor and leg, then the shares, then gravity's
    moving = [4, 5, 6, 7]
    others[:, [*moving, 9, 10]] = np.random.default_rng(4).normal(size=(50, 6))
    rows, _ = coordinates.to_parameters(others)
    # a load that pulls against the motion, so that the motor drives throughout
    q, qd, qdd = np.full(30, 0.7), np.linspace(0.1, 3.0, 30), np.linspace(0.0, 5.0, 30)
    torque = inverse_torque(chain, rows, q, qd, qdd)
    assert np.abs(torque - torque[0]).max() < 1e-9 * np.abs(torque).max()


def test_what_no_gearbox_can_be_is_impossible():
    chain = KNEE.chain()
    coordinates = choose_coordinates(chain, priors_of(chain))
    u = np.tile(coordinates.from_parameters(values_of(chain)[None]), (2, 1))
    u[0, 0] = -u[0, 0]  # less than no torque, shared between motor and leg
    u[1, 0] = math.nan
    assert np.isneginf(coordinates.to_parameters(u)[1]).all()


def test_they_are_chosen_where_one_element_loses_by_load():
    knee = KNEE.chain()
    # mu_2 above one, an irreversible gearbox, passes nothing back
    irreversible = priors_of(knee, {"gearbox.load_back": [0.0, 2.0]})
    assert isinstance(choose_coordinates(knee, irreversible), BoundedCoordinates)
    plain = replace(knee, elements=(MOTOR, replace(GEARBOX, load_loss="none"), JOINT))
    assert isinstance(choose_coordinates(plain, priors_of(plain)), BoundedCoordinates)
    both = replace(knee, elements=(MOTOR, GEARBOX, replace(JOINT, load_loss="one")))
    assert isinstance(choose_coordinates(both, priors_of(both)), BoundedCoordinates)
    bare = Joint(elements=(MOTOR, replace(GEARBOX, load_loss="one")))
    assert isinstance(choose_coordinates(bare, priors_of(bare)), BoundedCoordinates)
