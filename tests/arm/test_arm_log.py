"""A log of an arm: the same rows and time stamps as of one joint's recording."""

import h5py
import numpy as np
import pandas as pd
import pytest

from bayesfric.arm.arm import Arm
from bayesfric.arm.arm_columns import layout_of
from bayesfric.arm.arm_log import ArmLog
from bayesfric.arm.arm_options import ArmOptions
from tests.arm import bench
from tests.arm.bench import ELBOW, SHOULDER


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(bench.urdf())
    return Arm(folder / "arm.urdf")


def opened(arm, path, max_samples=10_000):
    joints = arm.bodies.joints
    layout, _ = layout_of(path, joints, arm.options)
    return ArmLog(path, "log", arm.options, layout, joints, max_samples)


def test_holes_and_own_time_stamps_change_no_motion(arm, tmp_path):
    """Three empty efforts are three rows less; efforts at times of their own are interpolated."""
    time = 0.005 * np.arange(800)
    columns = {"time [s]": time}
    for k, name in enumerate((SHOULDER, ELBOW)):
        columns[f"position[{name}] [rad]"] = np.sin((2.0 + k) * time)
        columns[f"effort[{name}] [N m]"] = np.cos((3.0 + k) * time)
    frame = pd.DataFrame(columns)
    frame.to_csv(tmp_path / "whole.csv", index=False)
    whole = opened(arm, tmp_path / "whole.csv")
    frame.loc[200:202, f"effort[{ELBOW}] [N m]"] = np.nan
    frame.to_csv(tmp_path / "holes.csv", index=False)
    holes = opened(arm, tmp_path / "holes.csv")
    assert (whole.rows, holes.rows) == (800, 797)
    stamps = {"encoder": time, "drive": time + 0.003}
    with h5py.File(tmp_path / "own.h5", "w") as file:
        for group, own in stamps.items():
            file[f"{group}/time"] = own
        for name in list(columns)[1:]:
            group = "drive" if "effort" in name else "encoder"
            rate = (3.0 if "effort" in name else 2.0) + (ELBOW in name)
            file[f"{group}/{name}"] = (np.cos if group == "drive" else np.sin)(rate * stamps[group])
    joints = arm.bodies.joints
    units = {"time": {"column": "encoder/time", "unit": "s"}}
    for key, unit in {"position": "rad", "torque": "N m"}.items():
        name = {"position": "encoder/position", "torque": "drive/effort"}[key]
        units[key] = {"column": f"{name}[{{joint}}] [{unit}]", "unit": unit}
    layout, _ = layout_of(tmp_path / "own.h5", joints, ArmOptions(recording=units))
    own = ArmLog(tmp_path / "own.h5", "log", arm.options, layout, joints, 10_000)
    # linear interpolation of cos(4 t) at 5 ms is right within (4 dt)**2 / 8
    for log, shift in ((holes, 0.0), (own, time[1])):  # before it there is no effort
        for joint in joints.values():
            read = log.measured(joint)
            k = 1.0 * (joint.name == ELBOW)
            near = np.abs(read.time - time[201]) < 0.05
            at = read.time[~near] + shift
            for values, exact in (
                (read.position, np.sin((2.0 + k) * at)),
                (read.torque, np.cos((3.0 + k) * at)),
            ):
                np.testing.assert_allclose(values[~near], exact, atol=5.1e-5)


@pytest.mark.parametrize(
    ("rate", "jitter", "late", "step"),
    [
        (100.0, 0.0, 0.0, 1e-3),
        (100.0, 0.2, 0.0, 2e-5),
        (1000.0, 0.2, 0.0, 1e-3),
        (1000.0, 0.0, 0.2, 2e-5),
        (5000.0, 0.2, 0.0, 2e-5),
        (5000.0, 0.0, 0.2, 1e-3),
    ],
)
def test_the_torque_of_the_bodies_is_that_of_the_motion(arm, tmp_path, rate, jitter, late, step):
    """Within 2 % of its rms, samples irregular (``jitter``) or stamped late, shares of a period."""
    rng, seconds = np.random.default_rng(5), 8.0
    exact, *motion = bench.motion(seconds, rate=rate)
    time = exact + rng.uniform(-jitter, jitter, exact.size) / rate
    q = np.stack([np.interp(time, exact, x) for x in motion[0].T]) if jitter else motion[0].T
    stamps = time + late * rng.uniform(-1.0, 1.0, exact.size) / rate
    columns = {"time [s]": stamps}
    for name, position in zip((SHOULDER, ELBOW), q, strict=True):
        columns[f"position[{name}] [rad]"] = step * np.round(position / step)
        columns[f"effort[{name}] [N m]"] = rng.normal(size=exact.size)
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    log = opened(arm, tmp_path / "log.csv", 100_000)
    nominal = arm.bodies.prior(arm.options.urdf, arm.options.payload).nominal
    torques = arm.bodies.torques(log.motion, np.tile(nominal, (2, 1))[:, :, None])[:, 0]
    inner = (log.time > 0.5) & (log.time < seconds - 0.5)
    expected = bench.rigid_torque(bench.urdf(), *motion, bench.GRAVITY).T
    expected = np.stack([np.interp(log.time[inner], exact, x) for x in expected])
    rms, true_rms = (np.sqrt(np.mean(x**2, axis=1)) for x in (torques[:, inner], expected))
    np.testing.assert_allclose(rms, true_rms, rtol=0.02)
    # twenty samples a period of the fastest motion that is resolved, here below 20 Hz
    assert log.time.size < 400.0 * seconds


@pytest.mark.parametrize(("unit", "factor"), [(None, 1.0), ("mN m", 1e-3)])
def test_efforts_without_a_unit_are_in_the_unit_that_is_given(arm, tmp_path, unit, factor):
    """N m is assumed, and said; a given unit is taken without a word."""
    time = 0.005 * np.arange(800)
    columns = {"time [s]": time}
    for joint in (SHOULDER, ELBOW):
        columns[f"{joint} position [rad]"] = np.sin(2.0 * time)
        columns[f"{joint} effort"] = np.cos(3.0 * time)
    path = tmp_path / "log.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    joints = arm.bodies.joints
    layout, assumed = layout_of(path, joints, arm.options, unit)
    assert bool(assumed) == (unit is None)
    log = ArmLog(path, "log", arm.options, layout, joints, 10_000)
    for each in joints.values():
        read = log.measured(each)
        np.testing.assert_allclose(read.torque, factor * np.cos(3.0 * read.time), atol=1e-9)
