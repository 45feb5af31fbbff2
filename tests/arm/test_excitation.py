"""Motions for an arm's next recording: within limits, and as telling as they say."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import resample

from bayesfric.arm.arm_log import layout_of
from bayesfric.arm.arm_options import Payload, Uncertainty
from bayesfric.arm.excitation import Limits, exciting_trajectory, limits_of
from bayesfric.arm.inertial_prior import Bodies
from bayesfric.base.errors import BadInput

from . import bench

OWN = ("armature", "coulomb", "viscous", "load", "offset")
VALUES = np.array([[0.3, 4.0, 2.0, 0.1, 0.5], [0.1, 2.0, 1.0, 0.05, 0.0]])
NOISE = np.array([0.02, 0.005])
JOINTS = (bench.SHOULDER, bench.ELBOW)
SECONDS, HARMONICS = 8.0, 3
HELD = np.array([[0.4, 0.4], [-1.0, 1.0]])


def arm_of(folder, text):
    path = folder / "arm.urdf"
    path.write_text(text)
    return Bodies(path, (0.0, 0.0, -9.81))


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    bodies = arm_of(tmp_path_factory.mktemp("arm"), bench.urdf())
    limits = replace(limits_of(bodies), speed=np.array([2.0, 3.0]))
    return SimpleNamespace(
        bodies=bodies, prior=bodies.prior(Uncertainty(), Payload()), limits=limits
    )


def found(arm, limits=None, **more):
    friction = {n: dict(zip(OWN, row, strict=True)) for n, row in zip(JOINTS, VALUES, strict=True)}
    more = {"seconds": SECONDS, "harmonics": HARMONICS, "seed": 1, "tries": 300, **more}
    noise = dict(zip(JOINTS, NOISE.tolist(), strict=True))
    return exciting_trajectory(arm.bodies, arm.prior, friction, noise, limits or arm.limits, **more)


@pytest.fixture(scope="module")
def free(arm):
    """Torque is far from its limits."""
    return found(arm)


@pytest.fixture(scope="module")
def weak(arm):
    """Torque confines the motion."""
    return found(arm, replace(arm.limits, torque=np.array([22.0, 9.0])))


def effort(arm, motion, z, values, torque=None):
    """Effort ``(n_joints, n)`` of bodies ``z`` and friction ``values``, and the bodies' torques."""
    if torque is None:
        every = np.column_stack([arm.prior.nominal, arm.prior.spread])
        torque = arm.bodies.torques(motion, np.repeat(every[None], 2, axis=0))
    carried = torque[:, 0] + np.einsum("jkn,k->jn", torque[:, 1:], z)
    armature, coulomb, viscous, load, offset = values.T[:, :, None]
    lost = coulomb + load * np.abs(carried)
    _, qd, qdd = motion
    return carried + armature * qdd + lost * np.sign(qd) + viscous * qd + offset, torque


def sds(arm, motion, step, more=()):
    """Posterior sds of the friction, ``(2, 5)``, by differences of the effort."""
    causes = arm.prior.spread.shape[1]
    _, torque = effort(arm, motion, np.zeros(causes), VALUES)
    point = np.r_[np.zeros(causes), VALUES.ravel()]

    def at(x):
        return effort(arm, motion, x[:causes], x[causes:].reshape(2, 5), torque)[0]

    small = 1e-6 * np.eye(point.size)
    slopes = np.array([(at(point + one) - at(point - one)) / 2e-6 for one in small])
    wide = [1.0 / (10.0 * x) ** 2 if x else 0.0 for x in VALUES.ravel()]
    precision = np.diag(np.r_[np.ones(causes), wide])
    for j, noise in enumerate(NOISE):
        precision += slopes[:, j] @ slopes[:, j].T * step / noise
    for j, known in more:
        here = slice(causes + 5 * j, causes + 5 * j + 5)
        precision[here, here] += known
    return np.sqrt(np.diag(np.linalg.inv(precision))[causes:]).reshape(2, 5)


def of_terms(told):
    return np.array([[told[f"{name}.{term}"] for term in OWN[:4]] for name in JOINTS])


def densely(one, times=8):
    """Evaluate between samples: of what is periodic and of few waves that is exact."""
    return resample(one.motion[:, :, :-1], times * (one.time.size - 1), axis=2)


def test_it_is_periodic_and_begins_and_ends_at_rest(free):
    assert np.array_equal(free.motion[:, :, -1], free.motion[:, :, 0])
    assert not free.motion[1:, :, 0].any()
    assert free.time[[0, -1]] == pytest.approx([0.0, SECONDS])
    # nothing but so many waves
    size = np.abs(np.fft.rfft(free.motion[:, :, :-1], axis=2))
    assert size[:, :, HARMONICS + 1 :].max() < 1e-9 * size.max()


def test_speed_and_acceleration_are_derivatives(free):
    """Central differences of a wave are short by (w h)² / 6."""
    h = free.time[1]
    error = (2.0 * np.pi * HARMONICS / SECONDS * h) ** 2 / 6.0
    for of, slope in zip(free.motion[:-1], free.motion[1:], strict=True):
        differences = (of[:, 2:] - of[:, :-2]) / (2.0 * h)
        most = HARMONICS * error * np.abs(slope).max()
        assert differences == pytest.approx(slope[:, 1:-1], abs=most)


@pytest.mark.parametrize("which", ["free", "weak"])
def test_it_keeps_every_limit(arm, which, request):
    one, limits = request.getfixturevalue(which), arm.limits
    q, qd, qdd = densely(one)
    assert (q.min(axis=1) >= limits.low).all()
    assert (q.max(axis=1) <= limits.high).all()
    assert (np.abs(qd).max(axis=1) <= limits.speed).all()
    assert (np.abs(qdd).max(axis=1) <= limits.acceleration).all()
    # as large as that, if torque allows
    shares = np.array([np.ptp(q, axis=1) / (limits.high - limits.low)])
    peaks = np.abs(qd).max(axis=1) / limits.speed, np.abs(qdd).max(axis=1) / limits.acceleration
    full = np.max([*shares, *peaks], axis=0)
    assert (full > 0.99).all() == (which == "free")


def test_it_keeps_limits_of_torque_and_uses_them(arm, weak):
    motion = densely(weak)
    felt, _ = effort(arm, motion, np.zeros(arm.prior.spread.shape[1]), VALUES)
    share = np.abs(felt).max(axis=1) / [22.0, 9.0]
    # between samples of 0.01 s waves of this speed rise by a thousandth at most
    assert share.max() <= 1.001
    assert share.max() > 0.9


def test_effort_and_sds_are_those_of_the_posterior(arm, free):
    expected, _ = effort(arm, free.motion, np.zeros(arm.prior.spread.shape[1]), VALUES)
    assert free.torque == pytest.approx(expected, abs=1e-9)
    told = sds(arm, free.motion[:, :, :-1], free.time[1])[:, :4]
    # both ends are one moment of 800
    assert of_terms(free.sd_after) == pytest.approx(told, rel=2e-3)
    assert of_terms(free.sd_before) == pytest.approx(10.0 * VALUES[:, :4])


def test_json_says_what_it_brings(free):
    """Of what nothing is known there is no number that JSON has."""
    name = f"{bench.ELBOW}.load"
    told = replace(free, sd_before={**free.sd_before, name: np.inf}).as_json()
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert told["sd_before"][name] is None
    assert told["sd_after"] == free.sd_after
    assert (told["seconds"], told["narrower"]) == (SECONDS, free.narrower)


def test_what_is_known_counts(arm):
    """Known are a sum of two numbers and one by itself: what is flat stays open."""
    way = np.array([1.0, 0.0, 1.0, 0.0, 0.0])
    known = 400.0 * np.outer(way, way) + np.diag([0.0, 2500.0, 0.0, 0.0, 0.0])
    one = found(arm, known={bench.ELBOW: known}, tries=60)
    prior = np.diag(1.0 / (10.0 * VALUES[1, :4]) ** 2) + known[:4, :4]
    before = np.sqrt(np.diag(np.linalg.inv(prior)))
    assert of_terms(one.sd_before)[1] == pytest.approx(before)
    told = sds(arm, one.motion[:, :, :-1], one.time[1], [(1, known)])[:, :4]
    assert of_terms(one.sd_after) == pytest.approx(told, rel=2e-3)


def test_it_tells_more_than_random_motions(arm, free):
    """Of 15 series from rest to rest, as large as limits allow, the best tells less."""
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
        middle = (shape[0].max(axis=1) + shape[0].min(axis=1)) / 2.0
        shape[0] -= middle[:, None]
        most = np.array([(limits.high - limits.low) / 2.0, limits.speed, limits.acceleration])
        shape *= np.min(most / np.abs(shape).max(axis=2), axis=0)[:, None]
        shape[0] += (limits.high + limits.low)[:, None] / 2.0
        scores.append(np.mean(np.log(sds(arm, shape, SECONDS / 200)[:, :4])))
    score = np.mean(np.log(of_terms(free.sd_after)))
    assert score < min(scores)
    assert free.narrower > 1.0


def test_one_number_is_narrowed_more_where_it_alone_is_wanted(arm, free):
    name = f"{bench.ELBOW}.load"
    one = found(arm, wanted=[name])
    assert one.sd_after[name] < free.sd_after[name]
    assert one.sd_after.keys() == free.sd_after.keys()


def test_one_seed_decides_all(arm):
    first, again, other = (found(arm, seed=seed, tries=60).as_csv() for seed in (3, 3, 4))
    assert first == again != other


def test_csv_is_a_log_of_the_arm(arm, free, tmp_path):
    path = tmp_path / "next.csv"
    path.write_text(free.as_csv())
    read = pd.read_csv(path)
    assert read["time [s]"].to_numpy() == pytest.approx(free.time, rel=1e-14)
    for j, name in enumerate(JOINTS):
        kinds = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}
        for of, (kind, unit) in zip(free.motion, kinds.items(), strict=True):
            column = read[f"{kind}[{name}] [{unit}]"].to_numpy()
            assert column == pytest.approx(of[j], rel=1e-14, abs=1e-99)
        assert read[f"effort[{name}] [N m]"].to_numpy() == pytest.approx(free.torque[j], rel=1e-14)
    layout = layout_of(path, arm.bodies.joints, None)
    columns = {key: layout.recording[key]["column"] for key in ("position", "torque")}
    assert columns == {"position": "position[{joint}] [rad]", "torque": "effort[{joint}] [N m]"}


def test_joint_trajectory_is_yaml_of_20_points_a_second(free):
    told = pytest.importorskip("yaml").safe_load(free.as_joint_trajectory())
    assert told["joint_names"] == list(JOINTS)
    starts = [one["time_from_start"] for one in told["points"]]
    assert all(0 <= one["nanosec"] < 10**9 for one in starts)
    time = np.array([one["sec"] + 1e-9 * one["nanosec"] for one in starts])
    assert time == pytest.approx(np.arange(161) / 20.0)
    for kind, of in zip(("positions", "velocities", "accelerations"), free.motion, strict=True):
        points = np.array([one[kind] for one in told["points"]])
        assert points == pytest.approx(of[:, ::5].T, abs=1e-9)


def test_a_joint_that_is_held_stays_and_tells_nothing(arm):
    one = found(arm, limits_of(arm.bodies, visited=HELD), tries=60)
    assert (one.motion[0, 0] == 0.4).all()
    assert (one.motion[1:, 0] == 0.0).all()
    assert {name.partition(".")[0] for name in one.sd_after} == {bench.ELBOW}


def test_limits_are_those_of_the_urdf_cut_to_where_the_arm_was(tmp_path):
    bodies = arm_of(tmp_path, bench.urdf(slides=True))
    limits = limits_of(bodies)
    assert limits.low == pytest.approx([-np.pi, -3.0, -3.0])
    assert limits.high == pytest.approx([np.pi, 3.0, 3.0])
    assert limits.torque == pytest.approx(90.0)
    assert limits.acceleration == pytest.approx(9.0 / 0.5)
    cut = limits_of(bodies, visited=np.array([[-7.0, 1.0], [-1.0, 5.0], [0.5, 1.0]]))
    assert cut.low == pytest.approx([-7.0, -1.0, 0.5])
    assert cut.high == pytest.approx([1.0, 3.0, 1.0])


def test_a_slide_is_in_metres(tmp_path):
    bodies = arm_of(tmp_path, bench.urdf(slides=True))
    noise = {bench.SLIDE: 0.01}
    one = exciting_trajectory(
        bodies, bodies.prior(Uncertainty(), Payload()), {}, noise, limits_of(bodies), seed=1,
        seconds=6.0, harmonics=2, tries=60,
    )  # fmt: skip
    assert f"effort[{bench.SLIDE}] [N]" in one.as_csv().partition("\n")[0]
    # nothing is known of it before
    assert np.isinf([*one.sd_before.values()]).all()
    assert np.isfinite([*one.sd_after.values()]).all()


@pytest.mark.parametrize(
    ("change", "more", "told"),
    [
        ({}, {"wanted": [f"{bench.ELBOW}.vicsous"]}, rf"mean '{bench.ELBOW}\.viscous'"),
        ({"low": np.array([0.0, 4.0])}, {}, f"limits of '{bench.ELBOW}'"),
        ({"high": np.array([np.inf, 1.0])}, {}, f"limits of '{bench.SHOULDER}'"),
        ({"speed": np.array([0.0, 1.0])}, {}, f"limits of '{bench.SHOULDER}'"),
        ({"low": np.ones(2), "high": np.ones(2)}, {}, "do not allow a motion"),
        ({"torque": np.array([1.0, 90.0])}, {"tries": 60}, "torque"),
        ({}, {"seconds": 1.0}, r"give at least two, and 1\.5 s"),
        ({}, {"harmonics": 1}, "at least two"),
    ],
)
def test_what_cannot_be_is_refused(arm, change, more, told):
    with pytest.raises(BadInput, match=told):
        found(arm, Limits(**{**vars(arm.limits), **change}), **more)


def test_a_limit_is_a_number(tmp_path):
    bodies = arm_of(tmp_path, bench.urdf().replace('velocity="9"', 'velocity="fast"', 1))
    with pytest.raises(BadInput, match=rf"{bench.SHOULDER}.*velocity"):
        limits_of(bodies)
