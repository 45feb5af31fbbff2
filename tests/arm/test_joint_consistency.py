"""What joints say of bodies together: exact Gaussians, bodies that can be, base parameters."""

import numpy as np
import pytest

from bayesfric.arm.arm import Arm
from bayesfric.arm.arm_options import Payload, Uncertainty
from bayesfric.arm.inertial_prior import base_parameters, combinations
from bayesfric.arm.excitation import next_motion
from bayesfric.arm.exports import files_of
from bayesfric.arm.inertial_prior import (
    Bodies,
    feasible,
    pseudo_inertias,
    sample_feasible,
    second_moments,
    with_second_order,
)
from bayesfric.arm.joint_consistency import InertialLikelihood

from . import bench
from .bench import ELBOW
from .test_arm import QUICK, TRUTH

pytestmark = pytest.mark.usefixtures("unexplained")


def of_points(mass, at):
    """Inertial parameters of points ``at`` ``(n, 3)`` of masses ``(n,)``."""
    inertia = sum(m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(mass, at, strict=True))
    return np.array([mass.sum(), *(mass @ at), *inertia[np.triu_indices(3)]])


def test_pseudo_inertia_is_the_second_moment_of_mass():
    rng = np.random.default_rng(1)
    mass, at = rng.uniform(0.1, 1.0, 7), rng.normal(size=(7, 3))
    whole = np.column_stack([at, np.ones(7)])
    found = pseudo_inertias(of_points(mass, at))[0]
    np.testing.assert_allclose(found, (whole.T * mass) @ whole, atol=1e-12)
    inertia = np.trace(found[:3, :3]) * np.eye(3) - found[:3, :3]
    np.testing.assert_allclose(second_moments(inertia), found[:3, :3])


def test_a_body_that_is_heavier_and_moved_is_completed_to_what_it_is():
    """Of its mass and first moment, and its inertia to first order."""
    rng = np.random.default_rng(7)
    mass, at, moved = rng.uniform(0.1, 1.0, 7), rng.normal(size=(7, 3)), np.array([0.3, -0.2, 0.1])
    nominal, exact = of_points(mass, at), of_points(1.2 * mass, at + moved)
    small = 1e-6
    slope = (of_points(1.2 * mass, at + small * moved) - of_points(1.2 * mass, at)) / small
    linear = 1.2 * nominal + slope
    np.testing.assert_allclose(with_second_order(linear, nominal), exact, atol=1e-4)


def test_bodies_that_can_be_are_those_of_points_and_no_others():
    rng = np.random.default_rng(2)
    mass, at = rng.uniform(0.1, 1.0, 7), rng.normal(size=(7, 3))
    body = of_points(mass, at)
    assert feasible(body).all()
    assert feasible(np.zeros(10)).all()
    assert not feasible(-body).any()
    # one diagonal moment larger than the sum of the two others
    flat = of_points(mass, at * [1.0, 1.0, 0.0])
    assert feasible(flat).all()
    flat[9] += 0.01
    assert not feasible(flat).any()


def test_draws_of_bodies_are_those_that_rejection_leaves():
    """A Gaussian over mass and two second moments: means within four standard errors."""
    rng = np.random.default_rng(3)
    nominal = of_points(np.full(6, 0.5), 0.2 * np.array([*np.eye(3), *-np.eye(3)]))
    spread = np.eye(10)[:, [0, 1, 4, 7]] * [1.0, 0.4, 0.1, 0.1]
    mean, covariance = np.array([-1.0, 0.8, 0.0, 0.0]), np.diag([1.0, 0.5, 1.0, 1.0])
    found, share = sample_feasible(nominal, spread, mean, covariance, np.zeros(4), rng)
    tried = rng.multivariate_normal(mean, covariance, 100_000)
    kept = tried[feasible(with_second_order(nominal + tried @ spread.T, nominal))[:, 0]]
    assert feasible(with_second_order(nominal + found @ spread.T, nominal)).all()
    expected = len(kept) / len(tried)
    assert abs(share - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / 400)
    errors = kept.std(axis=0) / np.sqrt(len(found))
    assert (np.abs(found.mean(axis=0) - kept.mean(axis=0)) < 4.0 * errors).all()
    # a standard deviation of 400 draws is known to 3.5 %
    assert found.std(axis=0) == pytest.approx(kept.std(axis=0), rel=0.15)


def fitted(x, y, sd, seed):
    """Draws of a linear regression with a standard normal prior, as a joint's fit has them."""
    precision = np.eye(x.shape[1]) + x.T @ x / sd**2
    mean = np.linalg.solve(precision, x.T @ y / sd**2)
    rng = np.random.default_rng(seed)
    flat = rng.multivariate_normal(mean, np.linalg.inv(precision), 40_000)
    # exactly these moments
    flat = (flat - flat.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(flat.T))).T
    return mean + flat @ np.linalg.cholesky(np.linalg.inv(precision)).T


def test_what_joints_say_adds_up_to_the_regression_on_all_of_them():
    rng = np.random.default_rng(4)
    causes, sd = 5, 0.3
    z = rng.normal(size=causes)
    said, rows, data = InertialLikelihood.uninformative(causes), [], []
    for j in range(3):
        # each feels two directions
        kept = np.linalg.qr(rng.normal(size=(causes, 2))).Q
        x = rng.normal(size=(20, 2))
        y = x @ kept.T @ z + sd * rng.normal(size=20)
        said = said + InertialLikelihood.from_draws(fitted(x, y, sd, j), kept)
        rows.append(x @ kept.T)
        data.append(y)
    every, y = np.concatenate(rows), np.concatenate(data)
    precision = np.eye(causes) / said.width**2 + every.T @ every / sd**2
    mean, covariance = said.posterior()
    np.testing.assert_allclose(covariance, np.linalg.inv(precision), atol=1e-8)
    np.testing.assert_allclose(mean, np.linalg.solve(precision, every.T @ y / sd**2), atol=1e-8)


def test_the_width_is_that_under_which_data_are_likeliest():
    """Of forty causes each known alone: their root mean square, with a relative sd of 1/9."""
    rng = np.random.default_rng(6)
    for width in (0.3, 3.0):
        z = width * rng.normal(size=40)
        found = InertialLikelihood(1e6 * np.eye(40), 1e6 * z).width
        assert found == pytest.approx(max(np.sqrt(np.mean(z**2)), 1.0), rel=1e-4)
    assert InertialLikelihood.uninformative(4).width == 1.0


def test_a_chance_is_uniform_under_the_belief_it_is_of():
    """Kolmogorov and Smirnov: beyond 1.95 root n once in a thousand."""
    rng = np.random.default_rng(5)
    x = rng.normal(size=(8, 3))
    information, n = x.T @ x, 400
    covariance = np.array([[0.5, 0.2, 0.0], [0.2, 0.4, 0.1], [0.0, 0.1, 0.9]])
    mean, found = np.array([0.3, -1.0, 2.0]), []
    for _ in range(n):
        z = rng.multivariate_normal(mean, covariance)
        found.append(
            InertialLikelihood(information, x.T @ (x @ z + rng.normal(size=8))).p(mean, covariance)
        )
    off = np.abs(np.sort(found) - (np.arange(n) + 0.5) / n).max()
    assert off < 1.95 / np.sqrt(n)


def test_both_joints_of_an_arm_agree_and_tell_more_than_one(arm):
    assert set(arm.consistency.agreed) == set(TRUTH)
    assert arm.inertial_estimate["p"] > 0.01
    for name in TRUTH:
        one = arm.joints[name]
        alone = one.result.summary.parameters
        widths = [np.ptp(rows["motor.inertia"].reported.interval) for rows in (one.rows, alone)]
        assert widths[0] <= 1.05 * widths[1]
    drawn = arm.prior.nominal + arm.consistency.draws @ arm.prior.spread.T
    assert feasible(with_second_order(drawn, arm.prior.nominal)).all()


def test_intervals_hold_the_truth_beside_bodies_that_are_a_tenth_off(arm):
    """Fewer than five of eight 90 % intervals hold it once in 200 times, were they independent."""
    inside = []
    for name, truth in TRUTH.items():
        for parameter, value in truth.items():
            told = arm.joints[name].rows[parameter].reported
            low, high = told.interval
            inside.append(low <= value <= high)
            assert told.value == pytest.approx(value, rel=0.5), parameter
    assert sum(inside) >= 5


def test_a_joint_whose_drive_gain_is_wrong_is_not_believed_about_bodies(tmp_path):
    """Of two that contradict each other neither is."""
    (tmp_path / "arm.urdf").write_text(bench.urdf())
    frame = bench.log(bench.urdf(), TRUTH)
    frame[f"effort[{ELBOW}] [N m]"] *= 1.5
    frame.to_csv(tmp_path / "log.csv", index=False)
    options = {**QUICK, "payload": {"mass_sd": "0.1 kg"}}
    found = Arm(tmp_path / "arm.urdf", options).fit(tmp_path / "log.csv", seed=1)
    assert not found.consistency.agreed
    assert max(found.consistency.p_values.values()) < 0.01
    for one in found.joints.values():
        assert one.rows == one.result.summary.parameters
        assert any("contradicts the others" in line for line in one.messages)


def test_files_and_the_next_motion_are_those_of_what_was_found(arm, monkeypatch):
    monkeypatch.setattr("bayesfric.arm.excitation._TRIES", 300)
    files = files_of(arm)
    assert set(files) == {
        "identified-arm.urdf", "robot.xml", "ros2_control.yaml", "feedforward.py"
    }  # fmt: skip
    path = arm.urdf.with_name("identified-arm.urdf")
    path.write_text(files[path.name])
    written = Bodies(path, arm.bodies.gravity).prior(Uncertainty(), Payload()).nominal
    expected = arm.prior.nominal + arm.prior.spread @ arm.consistency.draws.mean(axis=0)
    np.testing.assert_allclose(written, with_second_order(expected, arm.prior.nominal), atol=1e-9)
    motion = next_motion(arm, [f"{ELBOW}.load"], seconds=8.0, seed=1)
    visited, q = arm.visited, motion.motion[0]
    assert (q.min(axis=1) >= visited[:, 0] - 1e-9).all()
    assert (q.max(axis=1) <= visited[:, 1] + 1e-9).all()
    assert motion.sd_after[f"{ELBOW}.load"] < motion.sd_before[f"{ELBOW}.load"]
    assert motion.narrower > 1.0


def test_base_parameters_of_a_pendulum_of_two_links(tmp_path):
    """Two parallel axes, gravity in their plane: six sums (Gautier and Khalil 1990).

    Of each link its inertia about the axis and two moments, the first's with the second's mass.
    """
    path = tmp_path / "arm.urdf"
    path.write_text(bench.urdf())
    bodies = Bodies(path, (0.0, 0.0, -9.80665))
    rng = np.random.default_rng(1)
    first, sums = combinations(bodies)
    assert len(first) == 6
    every = np.broadcast_to(np.eye(sums.shape[1]), (2, sums.shape[1], sums.shape[1]))
    motion = rng.normal(size=(3, 2, 50))
    columns = bodies.torques(motion, every)
    np.testing.assert_allclose(
        columns, np.einsum("jkn,kp->jpn", columns[:, first], sums), atol=1e-9
    )
    prior = bodies.prior(Uncertainty(), Payload())
    told = base_parameters(bodies, prior, np.zeros((2, len(prior.deviations))))
    values = dict(zip(bodies.links, prior.nominal.reshape(-1, 10), strict=True))
    for one in told:
        assert (one.sd, one.value) == (0.0, pytest.approx(one.urdf))
        # the tool is bolted to the lower link: only sums of both
        assert {"lower", "tool"} <= {part.rpartition(" of ")[2] for part in (one.name, *one.beside)}
    mx = next(one for one in told if one.name == "mx of lower")
    assert mx.beside["mx of tool"] == pytest.approx(1.0)
    assert mx.urdf_sd > 0.0
    assert values["lower"][1] < mx.value
