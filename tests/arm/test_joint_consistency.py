"""Combination of an arm's joints: exact Gaussians, physical bodies, base parameters."""

import numpy as np
import pytest

from bayesfric.arm.arm import Arm
from bayesfric.arm.arm_options import Payload, Uncertainty
from bayesfric.arm.excitation import next_motion
from bayesfric.arm.exports import files_of
from bayesfric.arm.inertial_prior import (
    Bodies,
    base_parameters,
    combinations,
    feasible,
    pseudo_inertias,
    sample_feasible,
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


@pytest.fixture
def points():
    """Masses and positions of seven points, and their inertial parameters."""
    rng = np.random.default_rng(1)
    mass, at = rng.uniform(0.1, 1.0, 7), rng.normal(size=(7, 3))
    return mass, at, of_points(mass, at)


def test_pseudo_inertia_is_the_second_moment_of_mass(points):
    mass, at, body = points
    homogeneous = np.column_stack([at, np.ones(7)])
    expected = (homogeneous.T * mass) @ homogeneous
    np.testing.assert_allclose(pseudo_inertias(body)[0], expected, atol=1e-12)


def test_second_order_completes_a_heavier_and_shifted_body(points):
    mass, at, nominal = points
    shift, small = np.array([0.3, -0.2, 0.1]), 1e-6
    exact, heavier = of_points(1.2 * mass, at + shift), of_points(1.2 * mass, at)
    slope = (of_points(1.2 * mass, at + small * shift) - heavier) / small
    linear = 1.2 * nominal + slope
    np.testing.assert_allclose(with_second_order(linear, nominal), exact, atol=1e-4)


def test_feasible_bodies_are_those_of_points(points):
    mass, at, body = points
    assert feasible(body).all()
    assert feasible(np.zeros(10)).all()
    assert not feasible(-body).any()
    # one diagonal moment larger than the sum of the two others
    flat = of_points(mass, at * [1.0, 1.0, 0.0])
    assert feasible(flat).all()
    flat[9] += 0.01
    assert not feasible(flat).any()


def test_truncated_draws_agree_with_rejection():
    """A Gaussian over mass and two second moments: means within four standard errors."""
    rng = np.random.default_rng(3)
    nominal = of_points(np.full(6, 0.5), 0.2 * np.array([*np.eye(3), *-np.eye(3)]))
    spread = np.eye(10)[:, [0, 1, 4, 7]] * [1.0, 0.4, 0.1, 0.1]
    mean, covariance = np.array([-1.0, 0.8, 0.0, 0.0]), np.diag([1.0, 0.5, 1.0, 1.0])
    draws, share = sample_feasible(nominal, spread, mean, covariance, np.zeros(4), rng)
    proposed = rng.multivariate_normal(mean, covariance, 100_000)
    physical = feasible(with_second_order(nominal + proposed @ spread.T, nominal))[:, 0]
    accepted, expected = proposed[physical], physical.mean()
    assert feasible(with_second_order(nominal + draws @ spread.T, nominal)).all()
    assert abs(share - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / 400)
    errors = accepted.std(axis=0) / np.sqrt(len(draws))
    assert (np.abs(draws.mean(axis=0) - accepted.mean(axis=0)) < 4.0 * errors).all()
    # a standard deviation of 400 draws is known to 3.5 %
    assert draws.std(axis=0) == pytest.approx(accepted.std(axis=0), rel=0.15)


def posterior_draws(x, y, sd, seed):
    """Draws with exactly the moments of a linear regression with a standard normal prior."""
    precision = np.eye(x.shape[1]) + x.T @ x / sd**2
    mean = np.linalg.solve(precision, x.T @ y / sd**2)
    flat = np.random.default_rng(seed).normal(size=(40_000, x.shape[1]))
    flat = (flat - flat.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(flat.T))).T
    return mean + flat @ np.linalg.cholesky(np.linalg.inv(precision)).T


def test_sum_of_likelihoods_is_the_regression_on_all_joints():
    rng = np.random.default_rng(4)
    count, sd = 5, 0.3
    z = rng.normal(size=count)
    total, rows, data = InertialLikelihood(np.zeros((count, count)), np.zeros(count)), [], []
    for j in range(3):
        directions = np.linalg.qr(rng.normal(size=(count, 2))).Q
        x = rng.normal(size=(20, 2))
        y = x @ directions.T @ z + sd * rng.normal(size=20)
        total = total + InertialLikelihood.from_draws(posterior_draws(x, y, sd, j), directions)
        rows.append(x @ directions.T)
        data.append(y)
    x, y = np.concatenate(rows), np.concatenate(data)
    precision = np.eye(count) + x.T @ x / sd**2
    mean, covariance = total.posterior()
    np.testing.assert_allclose(covariance, np.linalg.inv(precision), atol=1e-8)
    np.testing.assert_allclose(mean, np.linalg.solve(precision, x.T @ y / sd**2), atol=1e-8)


def test_p_values_are_uniform_under_their_gaussian():
    """Kolmogorov and Smirnov: beyond 1.95 root n once in a thousand."""
    rng = np.random.default_rng(5)
    x, n = rng.normal(size=(8, 3)), 400
    covariance = np.array([[0.5, 0.2, 0.0], [0.2, 0.4, 0.1], [0.0, 0.1, 0.9]])
    mean, p_values = np.array([0.3, -1.0, 2.0]), []
    for _ in range(n):
        y = x @ rng.multivariate_normal(mean, covariance) + rng.normal(size=8)
        p_values.append(InertialLikelihood(x.T @ x, x.T @ y).p(mean, covariance))
    distance = np.abs(np.sort(p_values) - (np.arange(n) + 0.5) / n).max()
    assert distance < 1.95 / np.sqrt(n)


def test_two_agreeing_joints_are_combined_and_hold_the_truth(arm):
    """Fewer than five of eight 90 % intervals hold it once in 200 times, were they independent."""
    assert set(arm.consistency.agreed) == set(TRUTH)
    assert arm.inertial_estimate["p"] > 0.01
    inside = []
    for name, truth in TRUTH.items():
        joint = arm.joints[name]
        separate = joint.result.summary.parameters
        widths = [
            np.ptp(rows["motor.inertia"].reported.interval) for rows in (joint.rows, separate)
        ]
        assert widths[0] <= 1.05 * widths[1]
        for parameter, value in truth.items():
            reported = joint.rows[parameter].reported
            low, high = reported.interval
            inside.append(low <= value <= high)
            assert reported.value == pytest.approx(value, rel=0.5), parameter
    assert sum(inside) >= 5
    parameters = arm.prior.nominal + arm.consistency.draws @ arm.prior.spread.T
    assert feasible(with_second_order(parameters, arm.prior.nominal)).all()


def test_a_wrong_drive_gain_contradicts_no_other_joint(tmp_path):
    """It is named, within three sds, and no number that it multiplies is identified."""
    (tmp_path / "arm.urdf").write_text(bench.urdf())
    frame = bench.log(bench.urdf(), TRUTH)
    frame[f"effort[{ELBOW}] [N m]"] *= 1.5
    frame.to_csv(tmp_path / "log.csv", index=False)
    options = {**QUICK, "payload": {"mass_sd": "0.1 kg"}}
    arm = Arm(tmp_path / "arm.urdf", options).fit(tmp_path / "log.csv", seed=1)
    assert arm.departures.joints.keys() == {ELBOW}
    value, sd = arm.departures.joints[ELBOW]
    assert abs(value - 1.5) < 3.0 * sd
    assert set(arm.consistency.agreed) == set(TRUTH)
    statuses = {name: row.reported.status for name, row in arm.joints[ELBOW].rows.items()}
    assert not [
        key for key in TRUTH[ELBOW] if key != "motor.load" and statuses[key] == "identified"
    ]


def test_files_and_next_motion_have_the_posterior_bodies(arm, monkeypatch):
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
    first, sums = combinations(bodies)
    assert len(first) == 6
    identity = np.broadcast_to(np.eye(sums.shape[1]), (2, sums.shape[1], sums.shape[1]))
    columns = bodies.torques(np.random.default_rng(1).normal(size=(3, 2, 50)), identity)
    expected = np.einsum("jkn,kp->jpn", columns[:, first], sums)
    np.testing.assert_allclose(columns, expected, atol=1e-9)
    prior = bodies.prior(Uncertainty(), Payload())
    rows = base_parameters(bodies, prior, np.zeros((2, len(prior.deviations))))
    for row in rows:
        assert (row["sd"], row["value"]) == (0.0, pytest.approx(row["urdf"]))
        # the tool is bolted to the lower link: only sums of both
        links = {part.rpartition(" of ")[2] for part in (row["name"], *row["beside"])}
        assert {"lower", "tool"} <= links
    mx = next(row for row in rows if row["name"] == "mx of lower")
    assert mx["beside"]["mx of tool"] == pytest.approx(1.0)
    assert mx["urdf_sd"] > 0.0
    lower = prior.nominal.reshape(-1, 10)[bodies.links.index("lower")]
    assert lower[1] < mx["value"]
