"""Input error: exact recovery, honest sds, limits, told values."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.estimates.descent import Terms, TorqueProblem, minimise
from bayesfric.estimates.input_error import contradicted, input_error
from bayesfric.estimates.knowledge import Estimation, Knowledge
from bayesfric.estimates.torque import typical_load
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.scaling import scalings

KNEE, AXIS, SERVO = (PRESETS[n] for n in ("rabbit-knee", "motor-axis", "servo-pendulum"))
MOMENT = {"load.first_moment": KNEE.values["load.first_moment"]}
FEW = Estimation(starts=2)


@pytest.fixture
def knee(make_observation):
    """The knee's motion with the leg driving part of the time."""

    def make(values=KNEE.values, *, sigma=0.0, mass=0.0, **options):
        return make_observation(
            KNEE.chain(),
            values,
            sigma=sigma,
            amplitude=2.0,
            added_mass=mass,
            radius=0.35 if mass else 0.0,
            **{"n": 1000, "factor": 2} | options,
        )

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


def test_the_plain_axis_is_linear_least_squares(make_observation):
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values, sigma=0.02)
    estimate = input_error(chain, [o], Knowledge(), FEW)
    x = np.stack([o.qdd, o.qd, np.sign(o.qd), np.ones_like(o.q)], axis=1)
    expected, squares = np.linalg.lstsq(x, o.measured, rcond=None)[:2]
    covariance = np.linalg.inv(x.T @ x) * squares[0] / (o.measured.size - 4)
    for i, name in enumerate(chain.names):
        assert estimate[name].value == pytest.approx(expected[i], rel=1e-7)
        assert estimate[name].sd == pytest.approx(np.sqrt(covariance[i, i]), rel=1e-5)


@pytest.mark.parametrize("kind", ["normal", "range"])
def test_a_prior_is_contradicted_by_so_many_sds_of_both(make_observation, kind):
    """Linear least squares gives what the data say without it, and its sd."""
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values, sigma=0.02)
    free = input_error(chain, [o], Knowledge(), FEW)["motor.viscous"]
    for times in (2.5, 3.5):
        if kind == "normal":
            sd = 2.0 * free.larger_sd
            mean = free.value - times * np.hypot(sd, free.larger_sd)
            knowledge = Knowledge(priors={"motor.viscous": (mean, sd)})
        else:
            knowledge = Knowledge(
                bounds={"motor.viscous": (0.0, free.value - times * free.larger_sd)}
            )
        start = dict(input_error(chain, [o], knowledge, FEW).point)
        far = contradicted(chain, [o], knowledge, FEW, start)
        if times < 3.0:
            assert far == {}
        else:
            assert far == {"motor.viscous": pytest.approx((free.value, times), rel=1e-3)}
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


@pytest.mark.parametrize(
    ("chain", "values"), [(SERVO.chain(), SERVO.values), (FORMLESS, FORMLESS_VALUES)]
)
def test_other_chains_come_back(make_observation, chain, values):
    o = make_observation(chain, values, sigma=0.0, n=800)
    estimate = input_error(chain, [o], Knowledge(), FEW)
    for name, value in estimate.point:
        assert value == pytest.approx(values[name], rel=1e-6), name


SLOW = Joint(elements=(replace(AXIS.chain().elements[0], stribeck="either"),), offset=True)
SLOW_VALUES = AXIS.values | {"motor.stribeck_change": -0.3, "motor.stribeck_velocity": 0.012}


@pytest.mark.parametrize("seed", range(3))
def test_a_fall_at_low_speed_of_a_slow_axis_is_found(make_observation, seed):
    """From one unit of speed a search goes to zero, where no rise or fall shows."""
    o = make_observation(SLOW, SLOW_VALUES, sigma=0.0, amplitude=0.03, seed=seed)
    assert np.abs(o.qd).max() < 0.3
    estimate = input_error(SLOW, [o], Knowledge(), Estimation(seed=seed))
    for name, value in estimate.point:
        assert value == pytest.approx(SLOW_VALUES[name], rel=1e-5), name
        assert estimate[name].at_bound is None
    reached, said = estimate.notes[0].split(" starts reached the minimum")
    found, searched = map(int, reached.split(" of "))
    assert 1 <= found <= searched
    assert "shapes held" in said


def test_a_shape_that_is_fixed_or_bounded_is_not_tried_elsewhere(make_observation):
    o = make_observation(SLOW, SLOW_VALUES, sigma=0.0, amplitude=0.03)
    name = "motor.stribeck_velocity"
    fixed = input_error(SLOW, [o], Knowledge(fixed={name: 0.02}), FEW)
    assert dict(fixed.point)[name] == 0.02
    assert "shapes" not in fixed.notes[0]
    bounded = input_error(SLOW, [o], Knowledge(bounds={name: (0.02, 0.03)}), FEW)
    assert dict(bounded.point)[name] == pytest.approx(0.02)


def test_sds_are_those_of_repeated_noise(knee):
    chain = KNEE.chain()
    # so little noise that the model is linear over it
    sigma, repeats = 1e-3, 150
    o = knee(factor=1, n=400)
    rng = np.random.default_rng(7)

    def noisy():
        return replace(o, measured=o.measured + sigma * rng.standard_normal(o.measured.size))

    claimed = input_error(chain, [noisy()], Knowledge(), FEW)
    truth = chain.vector(KNEE.values)
    load = typical_load(chain, [o], truth)
    found = np.empty((repeats, truth.size))
    for i in range(repeats):
        problem = TorqueProblem(chain, [noisy()], Knowledge())
        found[i] = minimise(problem, Terms(np.ones(o.measured.size)), truth).x
    spread = {name: found[:, i].std(ddof=1) for i, name in enumerate(chain.names)}
    spread |= {d.name: d.values.std(ddof=1) for d in derive(chain, found, load)}
    # the sd of each sd: 1/sqrt(2(m-1)) from m repeats, 1/sqrt(2(n-d)) in the claimed one
    error = np.hypot(1 / np.sqrt(2 * (repeats - 1)), 1 / np.sqrt(2 * (400 - 10)))
    tested = [v for v in claimed.values if v.determined and v.kind != "total"]
    assert len(tested) >= 15
    for value in tested:
        assert value.sd / spread[value.name] == pytest.approx(1.0, abs=5 * error), value.name


def test_a_told_value_sets_the_scale_with_its_own_sd(knee):
    chain = KNEE.chain()
    o = knee(sigma=2e-3)
    free = input_error(chain, [o], Knowledge(), FEW)
    told = Knowledge(priors={"load.first_moment": (0.41, 0.02)})
    estimate = input_error(chain, [o], told, FEW)
    # nothing else knows of the scale
    assert estimate["load.first_moment"].value == pytest.approx(0.41, rel=1e-6)
    assert estimate["load.first_moment"].sd == pytest.approx(0.02, rel=1e-4)
    for name in ("motor.inertia", "total_back.viscous", "gearbox.lambda_ratio"):
        assert estimate[name].value == pytest.approx(free[name].value, rel=1e-5), name
        assert estimate[name].sd == pytest.approx(free[name].sd, rel=1e-3), name
    # lambda_2 is theta10 over the moment: its relative variances add
    theta10 = free["total_drive.gravity"].value - free["total_back.gravity"].value
    fixed = input_error(chain, [o], Knowledge(fixed={"load.first_moment": 0.41}), FEW)
    alone = fixed["gearbox.lambda_2"].sd / fixed["gearbox.lambda_2"].value
    value = estimate["gearbox.lambda_2"]
    assert value.value == pytest.approx(theta10 * 50 / (2 * 9.80665 * 0.41), rel=1e-5)
    assert value.sd / value.value == pytest.approx(np.hypot(alone, 0.02 / 0.41), rel=1e-3)


def test_told_values_set_the_scale_by_their_variances(knee):
    """One factor on all that is behind the gearbox, by weighted least squares of one number."""
    chain, o = KNEE.chain(), knee(sigma=1e-5)
    told = {
        "load.first_moment": (0.41, 0.02),
        "load.inertia": (0.23, 0.02),
        "joint.viscous": (3.0, 1),
    }
    found = input_error(chain, [o], Knowledge(priors=told), FEW)
    true = np.array([KNEE.values[name] for name in told])
    mean, sd = np.array(list(told.values())).T
    factor = np.sum(true * mean / sd**2) / np.sum((true / sd) ** 2)
    for name in scalings(chain)[0].behind:
        spread = KNEE.values[name] / np.sqrt(np.sum((true / sd) ** 2))
        # what the motion tells of them is a hundred times as much
        assert abs(found[name].value - factor * KNEE.values[name]) < 0.02 * spread, name
        assert found[name].sd == pytest.approx(spread, rel=0.02), name


def test_a_told_motor_value_is_weighed_against_the_data(make_observation):
    """Two independent measurements of one number average by their variances."""
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values, sigma=0.02)
    alone = input_error(chain, [o], Knowledge(), FEW)["motor.inertia"]
    mean, sd = alone.value + 2.0 * alone.sd, alone.sd
    both = input_error(chain, [o], Knowledge(priors={"motor.inertia": (mean, sd)}), FEW)
    assert both["motor.inertia"].value == pytest.approx((alone.value + mean) / 2, rel=1e-6)
    # sigma is taken anew from residuals that the told value has made a little larger
    assert both["motor.inertia"].sd == pytest.approx(sd / np.sqrt(2), rel=5e-3)


def test_a_noisy_recording_counts_for_less(knee):
    chain = KNEE.chain()
    observations = [
        knee(sigma=0.005, factor=1, n=700, seed=3, name="quiet"),
        knee(sigma=0.1, factor=1, n=700, seed=4, name="loud"),
    ]
    knowledge = Knowledge(fixed=MOMENT)
    weighted = input_error(chain, observations, knowledge, FEW)
    quiet = input_error(chain, observations[:1], knowledge, FEW)
    for name in ("motor.inertia", "motor.viscous", "joint.viscous"):
        # the loud one adds (0.005/0.1)² = 0.25 % of information
        assert weighted[name].sd == pytest.approx(quiet[name].sd, rel=0.06), name
        assert abs(weighted[name].value - quiet[name].value) < 0.5 * quiet[name].sd, name
    assert "within each recording" in weighted.assumption


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
    knowledge = Knowledge(fixed=MOMENT)
    inside = input_error(chain, [o], knowledge, FEW)
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
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values)
    with pytest.raises(BadInput, match="every parameter is fixed"):
        input_error(chain, [o], Knowledge(fixed=AXIS.values), FEW)
    with pytest.raises(BadInput, match="has no room"):
        input_error(chain, [o], Knowledge(bounds={"motor.inertia": (2.0, 1.0)}), FEW)
    few = make_observation(chain, AXIS.values, n=4)
    with pytest.raises(BadInput, match="cannot determine"):
        input_error(chain, [few], Knowledge(), FEW)
