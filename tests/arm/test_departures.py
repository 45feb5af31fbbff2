"""Departures from a right URDF and log that all joints show, in simulated arms."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayesfric.arm.arm import Arm
from bayesfric.arm.departures import Departure, Evidence

from . import bench
from .bench import ELBOW, GRAVITY, SHOULDER
from .test_arm import TRUTH


def examined(folder, changed, bodies=None):
    """Fit no joint, but what they say together of a log that ``changed`` makes of a right one."""
    text = bench.urdf(dict.fromkeys(bench.LINKS, bodies) if bodies else {})
    (folder / "arm.urdf").write_text(bench.urdf())
    changed(bench.log(text, TRUTH)).to_csv(folder / "log.csv", index=False)
    arm, *_ = Arm(folder / "arm.urdf").prepared([folder / "log.csv"])
    return arm.departures


def times(**scales):
    names = {f"effort[{name}] [N m]": scale for name, scale in scales.items()}
    return lambda frame: frame.assign(**{key: x * frame[key] for key, x in names.items()})


def without_gravity(frame):
    q = frame[[f"position[{name}] [rad]" for name in TRUTH]].to_numpy()
    weight = bench.rigid_torque(bench.urdf(), q, 0.0 * q, 0.0 * q, GRAVITY)
    columns = [f"effort[{name}] [N m]" for name in TRUTH]
    return frame.assign(**dict(zip(columns, (frame[columns].to_numpy() - weight).T, strict=True)))


@pytest.mark.parametrize(
    ("changed", "scales"),
    [
        (times(), {}),
        (times(**{SHOULDER: 1.5, ELBOW: 1.5}), {SHOULDER: 1.5, ELBOW: 1.5}),
        (times(**{SHOULDER: -1.0}), {SHOULDER: -1.0}),
        (times(**{SHOULDER: 1e3, ELBOW: 1e3}), {SHOULDER: 1e3, ELBOW: 1e3}),
    ],
)
def test_efforts_of_another_scale(tmp_path, changed, scales):
    """Within three of their sds, the torque of bodies that are right known to 15 %."""
    factors = examined(tmp_path, changed)
    assert factors.joints.keys() == scales.keys() == factors.scales.keys()
    assert Departure("gravity") not in factors.included
    for name, scale in scales.items():
        value, sd = factors.joints[name]
        assert abs(value - scale) < 3.0 * sd < 0.45 * abs(scale)


def test_efforts_without_gravity(tmp_path):
    factors = examined(tmp_path, without_gravity)
    assert Departure("gravity") in factors.included
    assert factors.gravity == (0.0, 0.0, 0.0)
    assert not factors.joints


def test_bodies_that_are_all_heavier(tmp_path):
    """Efforts of another scale would look the same: an alternative, by which none is divided."""
    factors = examined(tmp_path, times(), bodies=1.25)
    value, sd = factors.bodies
    assert not factors.scales
    assert {kind for kind, *_ in factors.alternatives} <= {"efforts", "payload"}
    assert abs(value - 1.25) < 3.0 * sd < 0.25


def test_evidence_of_departures_is_that_of_their_marginal_densities():
    """Of 12 data that are linear in coefficients: closed form, and equal step by step."""
    rng, unit = np.random.default_rng(1), np.eye(5)
    x, sd = rng.normal(size=(12, 5)), 0.3
    y = x @ [0.5, -3.0, 1.0, 0.2, 1.0] + sd * rng.normal(size=12)
    columns = {
        "body": {"a": unit[:, [0]], "b": unit[:, [1]]},
        "bodies": {"": unit[:, :3]},
        "gravity": {"": unit[:, -1:]},
    }
    evidence = Evidence(x.T @ x / sd**2, x.T @ y / sd**2, 3, columns)

    def density(taken):
        covariance, mean, prior = np.diag([1.0, 1.0, 1.0, 0.0, 0.0]), np.zeros(5), 0.0
        for kind, name, scale in taken:
            prior -= np.log(3 * len(columns[kind]))
            if kind == "gravity":
                mean[-1] = 1.0
            else:
                covariance += scale**2 * columns[kind][name] @ columns[kind][name].T
                prior += np.log(2.0 * scale / (1.0 + scale**2))
        of_data = x @ covariance @ x.T + sd**2 * np.eye(12)
        return multivariate_normal.logpdf(y, x @ mean, of_data) + prior

    for taken in ((), (Departure("gravity"),), (Departure("body", "b", 4.0),)):
        for value, departure in evidence.added(taken):
            option = (*taken, departure)
            assert value == pytest.approx(evidence.posterior(option)[0])
            gain = value - evidence.posterior(())[0]
            assert gain == pytest.approx(density(option) - density(()))
