"""Eqs. (12) to (19): the form of the torque, Theta1 in closed form, the gradient, the sign."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.estimates.torque import VariableProjection, columns, filtered_torque, torque_form
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import PRESETS, Joint
from tests.mechanism.joints import thetas

KNEE = PRESETS["rabbit-knee"]

# Losses everywhere, two stages: every column of psi has several owners.
RICH = Joint(
    elements=(
        Element("motor", inertia=True, coulomb="by-direction", viscous=True, quadratic=True),
        Element("belt", ratio=3.0, inertia=True, coulomb="symmetric"),
        Element("gearbox", ratio=10.0, viscous=True, coulomb="symmetric", load_loss="two"),
        Element("joint", ratio=2.0, viscous=True, coulomb="by-direction", quadratic=True),
    ),
    load=Load(inertia=True, first_moment=True, gravity_angle=True),
    offset=True,
)


def rich_values():
    rng = np.random.default_rng(3)
    values = dict(zip(RICH.names, rng.uniform(0.1, 0.4, len(RICH.names)), strict=True))
    return values | {"motor.inertia": 1e-4, "joint.quadratic": 0.7, "load.inertia": 0.2}


CASES = {name: (p.chain(), p.values) for name, p in PRESETS.items()} | {
    "rich": (RICH, rich_values())
}


def knee(make_observation, *, sigma=0.01, masses=(0.0,), factor=4, n=1000):
    chain = KNEE.chain()
    observations = [
        make_observation(
            chain,
            KNEE.values,
            sigma=sigma,
            n=n,
            factor=factor,
            amplitude=2.0,
            seed=seed,
            added_mass=mass,
            radius=0.35 if mass else 0.0,
        )
        for seed, mass in enumerate(masses)
    ]
    form = torque_form(chain, observations)
    return chain, observations, form, VariableProjection(form, observations)


@pytest.mark.parametrize("case", CASES)
def test_the_form_makes_the_torque_of_the_kernels(case, make_observation):
    chain, values = CASES[case]
    o = make_observation(chain, values, sigma=0.0, n=800, factor=3, amplitude=2.0)
    if "gearbox.load_drive" not in chain.names:
        # at rest the kernels take no loss; eq. (13) leaves lambda_1, which must then be one
        o = replace(o, qd=np.where(np.arange(o.qd.size) % 50 == 0, 0.0, o.qd))
    form = torque_form(chain, [o])
    theta1, theta2 = form.thetas(chain.vector(values))
    torque = theta1 @ columns(chain, o, form.names1)
    torque = torque + np.sign(o.qd) * np.abs(theta2 @ columns(chain, o, form.names2))
    expected = filtered_torque(chain, o, chain.vector(values)[None])[0]
    size = np.abs(expected).max()
    np.testing.assert_allclose(o.filter.apply(torque), expected, rtol=0, atol=1e-13 * size)


@pytest.mark.parametrize("case", CASES)
def test_parameters_make_the_thetas_they_came_from(case):
    """Where several parameters share a column they cannot be told apart, but their sum stays."""
    chain, values = CASES[case]
    form = torque_form(chain)
    theta1, theta2 = form.thetas(chain.vector(values))
    again = form.thetas(form.parameters(theta1, theta2))
    np.testing.assert_allclose(again[0], theta1, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(again[1], theta2, rtol=1e-9, atol=1e-15)


def gradient_of(projection, theta2):
    """Of the criterion; zero where eq. (19) is solved."""
    return 2.0 * projection.jacobian(theta2).T @ projection.residual(theta2)


def test_gradient_is_eq_15_with_eq_17(make_observation):
    """Without a filter the paper's own formulas hold sample by sample."""
    chain, (o,), form, projection = knee(make_observation, factor=1)
    theta2 = 0.8 * form.thetas(chain.vector(KNEE.values))[1]
    psi = columns(chain, o, form.names1).T
    sign = np.sign(o.qd)
    error = o.measured - psi @ projection.theta1(theta2) - sign * np.abs(psi @ theta2)
    # eq. (14) is solved by eq. (18)
    assert np.abs(psi.T @ error).max() < 1e-9 * np.abs(psi).sum()
    psi1 = (sign * np.sign(psi @ theta2))[:, None] * psi
    np.testing.assert_allclose(gradient_of(projection, theta2), -2.0 * psi1.T @ error, rtol=1e-7)


def test_both_signs_of_theta2_fit_alike_and_the_mechanical_one_is_taken(make_observation):
    chain, _, form, projection = knee(make_observation)
    truth = form.thetas(chain.vector(KNEE.values))[1]
    assert projection.criterion(truth) == projection.criterion(-truth)
    plus, minus = projection.minimise([truth]), projection.minimise([-truth])
    np.testing.assert_allclose(plus[1], minus[1], rtol=1e-6)
    at = dict(zip(chain.names, form.parameters(*plus[:2]), strict=True))
    assert at["load.inertia"] > 0.0
    assert at["gearbox.load_drive"] + at["gearbox.load_back"] > 0.0  # alpha_2 > alpha_1


def test_the_minimum_solves_eq_19_and_is_reached_from_afar(make_observation):
    chain, _, form, projection = knee(make_observation)
    truth = form.thetas(chain.vector(KNEE.values))[1]
    rng = np.random.default_rng(2)
    starts = [truth * rng.lognormal(0.0, 0.7, 5) for _ in range(6)]
    _, minimum, agreeing = projection.minimise(starts)
    assert 4 <= agreeing <= 6
    # nothing is left to gain: less than rounding of the criterion, in units of each column
    gradient = gradient_of(projection, minimum) / projection.scale
    assert np.abs(gradient).max() < 1e-6 * projection.criterion(minimum) ** 0.5
    assert projection.criterion(minimum) <= projection.criterion(truth)


def test_the_same_mass_everywhere_is_but_more_leg(make_observation):
    _, _, form, _ = knee(make_observation, masses=(2.0, 2.0))
    assert "added_load" not in form.names2


def test_other_chains_do_not_have_the_form(make_observation):
    motor, gearbox, joint = KNEE.chain().elements
    load = Load(inertia=True, first_moment=True)
    assert torque_form(Joint((replace(motor, stribeck=True), gearbox, joint), load)) is None
    assert torque_form(Joint((motor, gearbox, replace(joint, load_loss="one")), load)) is None
    assert torque_form(Joint((motor, gearbox, joint), load, gain=True)) is None
    servo = PRESETS["servo-pendulum"]
    chain = servo.chain()
    loaded = make_observation(chain, servo.values, added_mass=0.1, radius=0.1)
    assert torque_form(chain, [loaded]) is None
    assert torque_form(chain) is not None


def test_thetas_are_those_printed_below_eq_13():
    chain = KNEE.chain()
    theta = torque_form(chain).thetas(chain.vector(KNEE.values))
    np.testing.assert_allclose(theta, thetas(chain, KNEE.values), rtol=1e-12)


@pytest.mark.parametrize("name", ["load.first_moment", "joint.viscous", "gearbox.load_drive"])
def test_one_known_parameter_gives_all_of_table_3(name):
    chain = KNEE.chain()
    truth = chain.vector(KNEE.values)
    form = torque_form(chain)
    values = form.parameters(*form.thetas(truth), {name: KNEE.values[name]})
    np.testing.assert_allclose(values, truth, rtol=1e-12)


@pytest.mark.parametrize("case", ["knee", "pendulum"])
def test_a_known_mass_has_a_column_of_its_own_and_gives_all_parameters(case, make_observation):
    """With two mu its coefficients are lambda_1 and lambda_2; with one, lambda_1 is one."""
    if case == "knee":
        chain, values = KNEE.chain(), KNEE.values
    else:
        drive = Element("motor", inertia=True, viscous=True, coulomb="symmetric")
        gearbox = Element("gearbox", ratio=4.0, load_loss="one")
        chain = Joint((drive, gearbox), Load(inertia=True, first_moment=True))
        values = {
            "motor.inertia": 1e-3, "motor.viscous": 0.01, "motor.coulomb": 0.02,
            "gearbox.load": 0.2, "load.inertia": 0.05, "load.first_moment": 0.3,
        }  # fmt: skip
    truth = chain.vector(values)
    observations = [
        make_observation(
            chain, values, sigma=0.0, n=900, factor=3, amplitude=2.0, seed=seed,
            added_mass=mass, radius=0.35 if mass else 0.0,
        )
        for seed, mass in enumerate((0.0, 2.0))
    ]  # fmt: skip
    form = torque_form(chain, observations)
    theta1, theta2 = form.thetas(truth)
    first, second = (
        dict(zip(*x, strict=True)) for x in ((form.names1, theta1), (form.names2, theta2))
    )
    drive = values.get("gearbox.load_drive", values.get("gearbox.load"))
    back = values.get("gearbox.load_back", values.get("gearbox.load"))
    assert second["added_load"] == pytest.approx((drive + back) / 2.0)
    assert first.get("added_load", 1.0) == pytest.approx((2.0 + drive - back) / 2.0)
    assert ("added_load" in first) == (case == "knee")
    projection = VariableProjection(form, observations)
    size = np.abs(observations[1].measured).max()
    assert np.abs(projection.residual(theta2)).max() < 1e-12 * size
    np.testing.assert_allclose(projection.theta1(theta2), theta1, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(form.parameters(theta1, theta2), truth, rtol=1e-9)
    norms = [np.concatenate([columns(chain, o, (n,))[0] for o in observations]) for n in second]
    np.testing.assert_allclose(projection.scale, np.linalg.norm(norms, axis=1))
    np.testing.assert_allclose(projection.minimise([1.3 * theta2])[1], theta2, rtol=1e-6)
