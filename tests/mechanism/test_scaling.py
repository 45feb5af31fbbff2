"""The scaling of section 4.2: no torque changes, and where it ends."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.scaling import scalings

KNEE = PRESETS["rabbit-knee"]
FULL = Joint(
    elements=(
        Element("motor", inertia=True, coulomb="symmetric", viscous=True, stribeck=True),
        Element("gearbox", ratio=20.0, inertia=True, viscous=True, load_loss="two"),
        Element("bearing", coulomb="symmetric", quadratic=True, stribeck=True, load_loss="one"),
    ),
    load=Load(inertia=True, first_moment=True, gravity_angle=True),
    offset=True,
    gain=True,
)
GEARBOX = Element("gearbox", inertia=True, coulomb="symmetric", load_loss="two")
LOSSES = replace(
    FULL,
    elements=(
        replace(GEARBOX, load_speed=True, load_square=True, load_direction="quadrants"),
        FULL.elements[2],
    ),
)
CHAINS = {"knee": KNEE.chain(), "full": FULL, "losses": LOSSES}


def random_values(chain, rng):
    """Any passive joint: losses not negative, mu_2 below one."""
    values = rng.uniform(0.05, 0.9, len(chain.names))
    if "load.gravity_angle" in chain.names:
        values[chain.names.index("load.gravity_angle")] -= 0.5
    return values


@pytest.mark.parametrize("name", CHAINS)
@given(seed=st.integers(0, 2**32 - 1), place=st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_no_torque_changes_along_a_scaling(name, seed, place):
    chain = CHAINS[name]
    rng = np.random.default_rng(seed)
    values = random_values(chain, rng)
    (scaling,) = scalings(chain)
    low, high = scaling.bounds(values)
    factor = low * (high / low) ** place
    q, qd, qdd = rng.standard_normal((3, 200)) * np.array([[1.5], [3.0], [40.0]])
    before = inverse_torque(chain, values, q, qd, qdd)
    after = inverse_torque(chain, scaling.scaled(values, factor), q, qd, qdd)
    # where the leg passes next to no torque, rounding may change which side drives
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-12 * np.abs(before).max())


@pytest.mark.parametrize(
    "more",
    [
        {"stribeck": True}, {"stribeck": "either"}, {"stribeck": "apart"}, {"load_speed": True},
        {"load_square": True}, {"load_direction": True}, {"load_direction": "quadrants"},
    ],
    ids=str,
)  # fmt: skip
def test_there_is_one_where_the_factor_changes_no_torque(more):
    """Asked of the Jacobian itself: whether it has a null direction."""
    chain = Joint((replace(GEARBOX, **more),), Load(inertia=True, first_moment=True))
    rng = np.random.default_rng(3)
    values = random_values(chain, rng) * 0.3
    q, qd, qdd = rng.standard_normal((3, 400)) * np.array([[1.5], [0.3], [40.0]])
    steps = 1e-6 * np.eye(values.size)
    up, down = (inverse_torque(chain, values + h, q, qd, qdd) for h in (steps, -steps))
    rows = up - down
    singular = np.linalg.svd(rows / np.linalg.norm(rows, axis=1)[:, None], compute_uv=False)
    assert len(scalings(chain)) == np.count_nonzero(singular < 1e-6)


@pytest.mark.parametrize("name", CHAINS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_a_passive_gearbox_ends_it_at_one_over_alpha(name, seed):
    chain = CHAINS[name]
    values = random_values(chain, np.random.default_rng(seed))
    (scaling,) = scalings(chain)
    drive, back = (chain.names.index(n) for n in (scaling.drive, scaling.back))
    alpha_1, alpha_2 = 1.0 / (1.0 + values[drive]), 1.0 / (1.0 - values[back])
    low, high = scaling.bounds(values)
    assert low == pytest.approx(1.0 / alpha_2, rel=1e-12)
    assert high == pytest.approx(1.0 / alpha_1, rel=1e-12)
    # at one end alpha_1 is one, at the other alpha_2; beyond, a loss would be negative
    assert scaling.scaled(values, high)[drive] == pytest.approx(0.0, abs=1e-12)
    assert scaling.scaled(values, low)[back] == pytest.approx(0.0, abs=1e-12)
    inside = scaling.scaled(values, np.geomspace(1.001 * low, high / 1.001, 9))
    assert (inside[:, [drive, back]] > 0.0).all()
    assert scaling.scaled(values, 1.001 * high)[drive] < 0.0
    assert scaling.scaled(values, low / 1.001)[back] < 0.0


def test_table_3_leaves_the_factor_between_0_71_and_1_35():
    chain = KNEE.chain()
    (scaling,) = scalings(chain)
    low, high = scaling.bounds(chain.vector(KNEE.values))
    assert (low, high) == pytest.approx((1 / 1.408, 1 / 0.7432), rel=1e-12)
    assert (round(low, 2), round(high, 2)) == (0.71, 1.35)


def test_a_scaling_reaches_what_it_says_and_its_tangent_is_its_derivative():
    chain = KNEE.chain()
    values = chain.vector(KNEE.values)
    for mass in (0.0, 0.5):
        (scaling,) = scalings(chain, 0.3 * mass, mass)
        ends = scaling.bounds(values)
        for factor in (0.9, 1.2):
            scaled = scaling.scaled(values, factor)
            for name in scaling.names:
                reached = scaling.factor_to(values, name, scaled[chain.names.index(name)])
                assert reached == pytest.approx(factor, rel=1e-12)
            assert np.divide(*scaling.bounds(scaled)) == pytest.approx(np.divide(*ends))
        around = scaling.scaled(values, np.exp([1e-6, -1e-6]))
        slope = (around[0] - around[1]) / 2e-6
        np.testing.assert_allclose(scaling.tangent(values), slope, rtol=1e-7, atol=1e-12)
        assert scaling.middle(values) == pytest.approx(np.sqrt(ends[0] * ends[1]))
        # limits of a parameter narrow it to where that stands on them
        limits = 0.9 * KNEE.values["load.inertia"], 1.1 * KNEE.values["load.inertia"]
        narrowed = scaling.bounds(values, {"load.inertia": limits})
        for end, limit in zip(narrowed, limits, strict=True):
            reached = scaling.scaled(values, end)[chain.names.index("load.inertia")]
            assert reached == pytest.approx(limit) or end in ends


def test_an_irreversible_gearbox_has_no_lower_end():
    chain = KNEE.chain()
    (scaling,) = scalings(chain)
    values = chain.vector(KNEE.values | {"gearbox.load_back": 1.2})
    assert scaling.bounds(values)[0] == 0.0
    assert scaling.middle(values) == 1.0


def test_one_mu_or_nothing_behind_means_no_scaling():
    end = Element("gearbox", inertia=True, load_loss="two")
    assert scalings(Joint((Element("motor", viscous=True), end), Load())) == ()
    for preset in ("servo-pendulum", "motor-axis"):
        assert scalings(Joint.preset(preset)) == ()
