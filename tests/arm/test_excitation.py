"""Exciting trajectories: within limits, and as informative as they report."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import resample

from bayesfric.arm import excitation
from bayesfric.arm.arm_columns import layout_of
from bayesfric.arm.arm_options import ArmOptions, Payload, Uncertainty
from bayesfric.arm.excitation import Limits, exciting_trajectory, limits_of
from bayesfric.arm.inertial_prior import Bodies
from bayesfric.base.errors import BadInput

from . import bench

VALUES = np.array([[0.3, 4.0, 2.0, 0.1, 0.5], [0.1, 2.0, 1.0, 0.05, 0.1]])
SDS = 10.0 * VALUES
NOISE = np.array([0.02, 0.005])
JOINTS = (bench.SHOULDER, bench.ELBOW)
SECONDS, HARMONICS = 8.0, 5
NEAR = np.tile([-np.pi, np.pi], (3, 1))


def bodies_of(folder, text):
    path = folder / "arm.urdf"
    path.write_text(text)
    return Bodies(path, (0.0, 0.0, -9.81))


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    bodies = bodies_of(tmp_path_factory.mktemp("arm"), bench.urdf())
    limits = replace(limits_of(bodies, NEAR[:2]), speed=np.array([2.0, 3.0]))
    return SimpleNamespace(
        bodies=bodies,
        prior=bodies.prior(Uncertainty(), Payload()),
        limits=limits,
        options=ArmOptions(),
    )


def trajectory(arm, limits=None, tries=60, **options):
    numbers = zip(np.stack([VALUES, SDS], axis=1), NOISE.tolist(), strict=True)
    joints = dict(zip(JOINTS, numbers, strict=True))
    options = {"seconds": SECONDS, "seed": 1, **options}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(excitation, "_TRIES", tries)
        return exciting_trajectory(arm.bodies, arm.prior, joints, limits or arm.limits, **options)


@pytest.fixture(scope="module")
def free(arm):
    """Torque is far from its limits."""
    return trajectory(arm, tries=300)


@pytest.fixture(scope="module")
def weak(arm):
    """Torque confines the motion."""
    return trajectory(arm, replace(arm.limits, torque=np.array([22.0, 9.0])), tries=300)


def effort(arm, motion, z, values, torque=None):
    """Effort ``(n_joints, n)`` for deviations ``z`` and friction ``values``; torques by column."""
    if torque is None:
        columns = np.column_stack([arm.prior.nominal, arm.prior.spread])
        torque = arm.bodies.torques(motion, np.repeat(columns[None], 2, axis=0))
    rigid = torque[:, 0] + np.einsum("jkn,k->jn", torque[:, 1:], z)
    armature, coulomb, viscous, load, offset = values.T[:, :, None]
    _, qd, qdd = motion
    friction = (coulomb + load * np.abs(rigid)) * np.sign(qd) + viscous * qd
    return rigid + armature * qdd + friction + offset, torque


def posterior_sds(arm, motion, step):
    """Posterior sds of the friction, ``(2, 4)``, by differences of the effort."""
    count = arm.prior.spread.shape[1]
    _, torque = effort(arm, motion, np.zeros(count), VALUES)
    point = np.r_[np.zeros(count), VALUES.ravel()]

    def at(x):
        return effort(arm, motion, x[:count], x[count:].reshape(2, 5), torque)[0]

    shifts = 1e-6 * np.eye(point.size)
    slopes = np.array([(at(point + shift) - at(point - shift)) / 2e-6 for shift in shifts])
    precision = np.diag(np.r_[np.ones(count), SDS.ravel() ** -2.0])
    for j, noise in enumerate(NOISE):
        precision += slopes[:, j] @ slopes[:, j].T * step / noise
    return np.sqrt(np.diag(np.linalg.inv(precision))[count:]).reshape(2, 5)[:, :4]


def sds_of(sds):
    terms = ("armature", "coulomb", "viscous", "load")
    return np.array([[sds[f"{name}.{term}"] for term in terms] for name in JOINTS])


def densely(motion):
    """Interpolate between samples: exact for periodic motions of few waves."""
    return resample(motion[:, :, :-1], 8 * (motion.shape[2] - 1), axis=2)


def test_motion_is_a_finite_series_from_rest_to_rest_with_its_derivatives(free):
    assert np.array_equal(free.motion[:, :, -1], free.motion[:, :, 0])
    assert not free.motion[1:, :, 0].any()
    assert free.time[[0, -1]] == pytest.approx([0.0, SECONDS])
    spectrum = np.abs(np.fft.rfft(free.motion[:, :, :-1], axis=2))
    assert spectrum[:, :, HARMONICS + 1 :].max() < 1e-9 * spectrum.max()
    # central differences of a wave are short by (w h)² / 6
    h = free.time[1]
    error = (2.0 * np.pi * HARMONICS / SECONDS * h) ** 2 / 6.0
    for values, slope in zip(free.motion[:-1], free.motion[1:], strict=True):
        differences = (values[:, 2:] - values[:, :-2]) / (2.0 * h)
        bound = HARMONICS * error * np.abs(slope).max()
        assert differences == pytest.approx(slope[:, 1:-1], abs=bound)


@pytest.mark.parametrize("which", ["free", "weak"])
def test_motion_keeps_every_limit_and_uses_one(arm, which, request):
    limits, motion = arm.limits, densely(request.getfixturevalue(which).motion)
    q, qd, qdd = motion
    assert (q.min(axis=1) >= limits.low).all()
    assert (q.max(axis=1) <= limits.high).all()
    assert (np.abs(qd).max(axis=1) <= limits.speed).all()
    assert (np.abs(qdd).max(axis=1) <= limits.acceleration).all()
    shares = np.array([np.ptp(q, axis=1) / (limits.high - limits.low)])
    peaks = np.abs(qd).max(axis=1) / limits.speed, np.abs(qdd).max(axis=1) / limits.acceleration
    assert (np.max([*shares, *peaks], axis=0) > 0.99).all() == (which == "free")
    if which == "weak":
        torque, _ = effort(arm, motion, np.zeros(arm.prior.spread.shape[1]), VALUES)
        # between samples of 0.01 s waves of this speed rise by a thousandth at most
        assert 0.9 < np.max(np.abs(torque).max(axis=1) / [22.0, 9.0]) <= 1.001


def test_effort_and_sds_are_those_of_the_posterior(arm, free):
    expected, _ = effort(arm, free.motion, np.zeros(arm.prior.spread.shape[1]), VALUES)
    assert free.torque == pytest.approx(expected, abs=1e-9)
    sds = posterior_sds(arm, free.motion[:, :, :-1], free.time[1])
    # both ends are one moment of 800
    assert sds_of(free.sd_after) == pytest.approx(sds, rel=2e-3)
    assert sds_of(free.sd_before) == pytest.approx(SDS[:, :4])


def test_json_has_no_number_where_nothing_is_known(free):
    name = f"{bench.ELBOW}.load"
    record = replace(free, sd_before={**free.sd_before, name: np.inf}).as_json()
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert record["sd_before"][name] is None
    assert record["sd_after"] == free.sd_after


def test_optimum_is_more_informative_than_random_motions(arm, free):
    """Than any of 15 series from rest to rest, as large as the limits allow."""
    rng, limits = np.random.default_rng(5), arm.limits
    time = (np.arange(200) + 0.5) * SECONDS / 200
    w = 2.0 * np.pi / SECONDS * np.arange(1, HARMONICS + 1)[:, None]
    sin, cos = np.sin(w * time), np.cos(w * time)
    scores = []
    for _ in range(15):
        a, b = rng.normal(size=(2, 2, HARMONICS))
        a[:, -1] -= a.sum(axis=1)
        b[:, 0] -= b @ w[:, 0] / w[0, 0]
        shape = np.array([a / w.T @ sin - b / w.T @ cos, a @ cos + b @ sin])
        shape = np.array([*shape, -a * w.T @ sin + b * w.T @ cos])
        shape[0] -= (shape[0].max(axis=1) + shape[0].min(axis=1))[:, None] / 2.0
        largest = np.array([(limits.high - limits.low) / 2.0, limits.speed, limits.acceleration])
        shape *= np.min(largest / np.abs(shape).max(axis=2), axis=0)[:, None]
        shape[0] += (limits.high + limits.low)[:, None] / 2.0
        scores.append(np.mean(np.log(posterior_sds(arm, shape, SECONDS / 200))))
    assert np.mean(np.log(sds_of(free.sd_after))) < min(scores)
    assert free.narrower > 1.0


def test_a_wanted_number_is_narrowed_more_than_among_all(arm, free):
    name = f"{bench.ELBOW}.load"
    motion = trajectory(arm, wanted=[name], tries=300)
    assert motion.sd_after[name] < free.sd_after[name]
    assert motion.sd_after.keys() == free.sd_after.keys()


def test_same_seed_same_motion(arm):
    first, repeated, other = (trajectory(arm, seed=seed).as_csv() for seed in (3, 3, 4))
    assert first == repeated != other


def test_csv_is_a_log_of_the_arm(arm, free, tmp_path):
    path = tmp_path / "next.csv"
    path.write_text(free.as_csv())
    frame = pd.read_csv(path)
    assert frame["time [s]"].to_numpy() == pytest.approx(free.time, rel=1e-14)
    units = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2", "effort": "N m"}
    for j, name in enumerate(JOINTS):
        columns = np.array([frame[f"{key}[{name}] [{unit}]"] for key, unit in units.items()])
        expected = [*free.motion[:, j], free.torque[j]]
        assert columns == pytest.approx(np.array(expected), rel=1e-14, abs=1e-99)
    layout, assumed = layout_of(path, arm.bodies.joints, arm.options)
    for name in JOINTS:
        assert layout[name]["position"] == {"column": f"position[{name}] [rad]", "unit": "rad"}
        assert layout[name]["torque"] == {"column": f"effort[{name}] [N m]", "unit": "N m"}
    assert not assumed


def test_joint_trajectory_is_yaml_of_20_points_a_second(free):
    message = pytest.importorskip("yaml").safe_load(free.as_joint_trajectory())
    assert message["joint_names"] == list(JOINTS)
    stamps = [point["time_from_start"] for point in message["points"]]
    assert all(0 <= stamp["nanosec"] < 10**9 for stamp in stamps)
    time = np.array([stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps])
    assert time == pytest.approx(np.arange(161) / 20.0)
    for key, values in zip(("positions", "velocities", "accelerations"), free.motion, strict=True):
        points = np.array([point[key] for point in message["points"]])
        assert points == pytest.approx(values[:, ::5].T, abs=1e-9)


def test_a_held_joint_stays_and_has_no_information(arm):
    motion = trajectory(arm, limits_of(arm.bodies, np.array([[0.4, 0.4], [-1.0, 1.0]])))
    assert (motion.motion[0, 0] == 0.4).all()
    assert (motion.motion[1:, 0] == 0.0).all()
    assert {name.partition(".")[0] for name in motion.sd_after} == {bench.ELBOW}


def test_limits_are_those_of_the_urdf_within_visited_positions(tmp_path):
    bodies = bodies_of(tmp_path, bench.urdf(slides=True))
    limits = limits_of(bodies, NEAR)
    assert limits.low == pytest.approx([-np.pi, -3.0, -3.0])
    assert limits.high == pytest.approx([np.pi, 3.0, 3.0])
    assert limits.torque == pytest.approx(90.0)
    assert limits.acceleration == pytest.approx(9.0 / 0.5)
    visited = limits_of(bodies, np.array([[-7.0, 1.0], [-1.0, 5.0], [0.5, 1.0]]))
    assert visited.low == pytest.approx([-7.0, -1.0, 0.5])
    assert visited.high == pytest.approx([1.0, 3.0, 1.0])


def test_a_sliding_joint_is_in_metres_and_newtons(tmp_path, monkeypatch):
    monkeypatch.setattr(excitation, "_TRIES", 60)
    bodies = bodies_of(tmp_path, bench.urdf(slides=True))
    prior = bodies.prior(Uncertainty(), Payload())
    joints = {bench.SLIDE: (np.stack([np.zeros(5), np.full(5, np.inf)]), 0.01)}
    motion = exciting_trajectory(
        bodies, prior, joints, limits_of(bodies, NEAR), seed=1, seconds=6.0
    )
    assert f"effort[{bench.SLIDE}] [N]" in motion.as_csv().partition("\n")[0]
    assert np.isinf([*motion.sd_before.values()]).all()
    assert np.isfinite([*motion.sd_after.values()]).all()


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({}, {"wanted": [f"{bench.ELBOW}.vicsous"]}, rf"mean '{bench.ELBOW}\.viscous'"),
        ({"low": np.array([0.0, 4.0])}, {}, f"limits of '{bench.ELBOW}'"),
        ({"high": np.array([np.inf, 1.0])}, {}, f"limits of '{bench.SHOULDER}'"),
        ({"speed": np.array([0.0, 1.0])}, {}, f"limits of '{bench.SHOULDER}'"),
        ({"low": np.ones(2), "high": np.ones(2)}, {}, "do not allow a motion"),
        ({"torque": np.array([1.0, 90.0])}, {}, "torque"),
        ({}, {"seconds": 1.0}, r"2\.5 s"),
    ],
)
def test_impossible_motions_are_refused(arm, change, options, message):
    with pytest.raises(BadInput, match=message):
        trajectory(arm, Limits(**{**vars(arm.limits), **change}), **options)
