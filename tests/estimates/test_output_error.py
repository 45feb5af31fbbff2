"""Output error, section 4.3: exact recovery, honest standard deviations."""

import dataclasses
import time

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.estimates.output_error import output_error
from bayesfric.estimates.point_estimate import Estimate, Estimation, Knowledge
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.scaling import scalings
from tests.estimates.simulated import excite, move, prepare

# torque that moves each joint well, s of it
SETTINGS = {"rabbit-knee": (4.0, 0.8), "motor-axis": (2.0, 0.5), "servo-pendulum": (3.0, 0.15)}


def start(chain, values, off=0.0, seed=0):
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], len(chain.names))
    point = tuple((n, values[n] * (1.0 + off * s)) for n, s in zip(chain.names, signs, strict=True))
    return Estimate("input-error", (), 0.0, 1, "", point=point)


def simulated(preset):
    chain, values = PRESETS[preset].chain(), PRESETS[preset].values
    seconds, amplitude = SETTINGS[preset]
    torque = excite(seconds, amplitude)
    return chain, values, torque, move(chain, values, torque).q


def fitted(chain, begin, parts, knowledge=None, **options):
    """Output error of what :func:`prepare` made, one recording or several, from a start."""
    (trajectories, observations), known = zip(*parts, strict=True), knowledge or Knowledge()
    return output_error(chain, trajectories, observations, known, Estimation(**options), begin)


@pytest.mark.parametrize(
    ("preset", "known"),
    [
        ("rabbit-knee", ("load.first_moment",)),
        ("motor-axis", ()),
        ("servo-pendulum", ()),
    ],
)
def test_exact_recovery_from_twenty_per_cent_off(preset, known):
    chain, values, torque, q = simulated(preset)
    knowledge = Knowledge(fixed={n: values[n] for n in known})
    begin = start(chain, values, 0.2)
    estimate = fitted(chain, begin, [prepare(q, torque)], knowledge, substeps=1, segment=0.2)
    assert estimate.residual_unit == "rad"
    assert estimate.residual_rms < 1e-8
    for name in chain.names:
        if name in known:
            assert dict(estimate.point)[name] == values[name]
            continue
        assert estimate[name].value == pytest.approx(values[name], rel=1e-6), name
        assert estimate[name].determined, name


def test_what_a_scaling_leaves_open_has_no_sd():
    chain, values, torque, q = simulated("rabbit-knee")
    begin = start(chain, values, 0.1)
    estimate = fitted(chain, begin, [prepare(q, torque)], substeps=1, segment=0.2)
    (scaling,) = scalings(chain)
    for name in scaling.names:
        assert np.isinf(estimate[name].sd), name
        assert np.isinf(estimate[name].sd_robust), name
        assert estimate[name].span is not None
    for name in set(chain.names) - set(scaling.names):
        assert estimate[name].value == pytest.approx(values[name], rel=1e-6), name
        assert estimate[name].determined, name
    lambdas = [(2 + a - b) / (a + b) for a, b in [(values[scaling.drive], values[scaling.back])]]
    assert estimate["gearbox.lambda_ratio"].value == pytest.approx(lambdas[0], rel=1e-6)
    # the vector stands where alpha_1 alpha_2 = 1, in the middle of what a passive gearbox allows
    point = dict(estimate.point)
    assert (1 + point[scaling.drive]) * (1 - point[scaling.back]) == pytest.approx(1.0, rel=1e-9)


def repeat(noise_of_position, noise_of_torque, segment, repeats):
    """Estimates and claimed sds of a motor axis, 2 s, over repeated noise: ``(repeats, 4, 3)``."""
    chain, values, torque, q = simulated("motor-axis")
    out = []
    for seed in range(repeats):
        rng = np.random.default_rng(seed)
        noisy = prepare(
            q + noise_of_position * rng.standard_normal(q.size),
            torque + noise_of_torque * rng.standard_normal(q.size),
        )
        estimate = fitted(chain, start(chain, values), [noisy], substeps=1, segment=segment)
        out.append(
            [(estimate[n].value, estimate[n].sd, estimate[n].sd_robust) for n in chain.names]
        )
    return np.array(out), np.array([values[n] for n in chain.names])


@pytest.mark.slow
def test_both_sds_are_right_for_noise_of_the_encoder():
    repeats = 60
    estimate, truth = repeat(1e-4, 0.0, 0.1, repeats)
    spread = estimate[:, :, 0].std(axis=0, ddof=1)
    # a spread from n repeats has the relative error 1/sqrt(2(n - 1))
    error = 5.0 / np.sqrt(2.0 * (repeats - 1))
    assert np.all(np.abs(estimate[:, :, 1].mean(axis=0) / spread - 1.0) < error)
    assert np.all(np.abs(estimate[:, :, 2].mean(axis=0) / spread - 1.0) < error)
    assert np.all(np.abs(estimate[:, :, 0].mean(axis=0) - truth) < 5.0 * spread / np.sqrt(repeats))


@pytest.mark.slow
def test_only_the_robust_sd_is_right_for_noise_of_the_torque():
    repeats = 60
    estimate, _ = repeat(0.0, 0.005, 0.1, repeats)
    spread = estimate[:, :, 0].std(axis=0, ddof=1)
    # integrated noise: the sd for white residuals is too small several times over
    assert np.all(estimate[:, :, 1].mean(axis=0) < 0.33 * spread)
    error = 5.0 / np.sqrt(2.0 * (repeats - 1))
    robust = np.sqrt((estimate[:, :, 2] ** 2).mean(axis=0))
    assert np.all(np.abs(robust / spread - 1.0) < error), robust / spread


def test_a_prior_settles_what_the_scaling_leaves_open():
    chain, values, torque, q = simulated("rabbit-knee")
    rng = np.random.default_rng(1)
    parts = [prepare(q + 1e-5 * rng.standard_normal(q.size), torque)]
    knowledge = Knowledge(priors={"load.first_moment": (0.42, 0.021)})
    estimate = fitted(chain, start(chain, values, 0.02), parts, knowledge, substeps=1, segment=0.2)
    assert estimate["load.first_moment"].value == pytest.approx(0.42, rel=1e-4)
    # nothing but the prior knows the scale
    assert estimate["load.first_moment"].sd == pytest.approx(0.021, rel=0.01)


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_another_minimum_than_the_torques_is_reported(times):
    """A motion of twice the inertia, whose torque is not the recorded one."""
    chain, values, torque, q = simulated("motor-axis")
    heavy = values | {"motor.inertia": times * values["motor.inertia"]}
    (trajectory, _), (_, observation) = (
        prepare(x, torque) for x in (move(chain, heavy, torque).q, q)
    )
    parts = [(trajectory, observation)]
    estimate = fitted(chain, start(chain, values), parts, substeps=1, segment=0.2)
    assert ("ANOTHER MINIMUM" in estimate.notes[0]) == (times > 1.0)


def test_a_joint_without_inertia_is_refused():
    chain = Joint(elements=(Element("motor", coulomb="symmetric", viscous=True),), load=Load())
    _, _, torque, q = simulated("motor-axis")
    begin = start(chain, {"motor.coulomb": 0.2, "motor.viscous": 0.05})
    with pytest.raises(BadInput, match="no inertia"):
        fitted(chain, begin, [prepare(q, torque)])


def test_a_joint_that_runs_away_is_refused():
    chain, values, torque, q = simulated("motor-axis")
    trajectory, observation = prepare(q, torque)
    mad = dataclasses.replace(trajectory, torque=np.full_like(torque, 1e12))
    with pytest.raises(BadInput, match="cannot be simulated"):
        fitted(chain, start(chain, values), [(mad, observation)])


def test_at_its_time_limit_it_gives_the_best_so_far_marked():
    chain, values, torque, q = simulated("motor-axis")
    parts, begin = [prepare(q, torque)], start(chain, values, 0.2)
    for seconds in (1e-9, 0.02):
        began = time.process_time()
        estimate = fitted(chain, begin, parts, max_seconds=seconds)
        assert time.process_time() - began < 5.0
        assert not estimate.converged
        assert "NOT CONVERGED" in estimate.notes[0]
        assert "estimation.max_seconds" in estimate.notes[0]
        assert not any(value.determined for value in estimate.values)
        assert set(dict(estimate.point)) == set(chain.names)
    assert fitted(chain, begin, parts).converged
