"""The law as C and Python against the inverse model, compiled and fuzzed."""

import ctypes
import math
import re
import shutil
import subprocess
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.export.formats import filled
from bayesfric.export.joint_model import Trajectory, torque_along
from bayesfric.export.point_estimate import parameter_vectors
from bayesfric.export.written_law import law
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import Term
from bayesfric.recordings.measurement import AT_ROOM

from ..mechanism.joints import EVERYTHING, EVERYTHING_VALUES
from ..report.conftest import EVERYTHING as OTHERS
from .made import finished_posterior

FLAGS = ["-Wall", "-Wextra", "-Werror", "-std=c99", "-ffp-contract=off", "-O1"]
MOVING = ("q", "qd", "qdd")
NAMES = ("plain", "rabbit-knee", "servo-pendulum", "motor-axis")


def unusual():
    """Give terms that `EVERYTHING` has not, at values of their own."""
    joint = replace(OTHERS, delay=True)
    values = np.random.default_rng(3).uniform(0.02, 0.1, len(joint.names))
    at = dict(zip(joint.names, values, strict=True)) | {"drive.gain": 1.1, "drive.delay": 1e-3}
    ends = {"stribeck_exponent": 1.3, "stribeck_velocity": 2.0, "warming_time": 30.0}
    return joint, {name: ends.get(name.rpartition(".")[2], x) for name, x in at.items()}


def motion(n=400):
    rng = np.random.default_rng(5)
    return tuple(scale * rng.standard_normal(n) for scale in (1.5, 3.0, 20.0))


@pytest.fixture(scope="module")
def compiler():
    if not (gcc := shutil.which("gcc")):
        pytest.skip("there is no gcc")
    return gcc


SINGLE = "-DJOINT_REAL=float"


def compiled(compiler, files, folder, *more):
    """Give its functions of position, speed and acceleration, in double, or float by ``SINGLE``."""
    kind = ctypes.c_float if SINGLE in more else ctypes.c_double
    for name, text in files.items():
        (folder / name).write_text(text)
    source = next(name for name in files if name.endswith(".c"))
    made = folder / f"made{'-'.join(more)}.so"
    command = [compiler, *FLAGS, *more, "-shared", "-fPIC", "-o", made, folder / source, "-lm"]
    subprocess.run(command, check=True)
    library = ctypes.CDLL(str(made))
    status = ctypes.c_int()

    def call(name):
        function = getattr(library, name)
        function.restype = kind
        function.argtypes = [kind] * 3 + [ctypes.c_void_p]
        return lambda *x: (function(*x, ctypes.byref(status)), status.value)

    return call


def c_files(joint, vector):
    """Write a joint as the format does, of a vector alone."""
    given = {"remarks": [], "stem": "joint", "law": law(joint, vector, "c"), "unit": "N m"}
    names = ("feedforward.c", "feedforward.h")
    return {f"joint_{name}": filled(f"{name}.j2", rotary=True, **given) for name in names}


def python_of(joint, vector):
    """Run what the format writes in Python of a vector alone."""
    written = {}
    made = law(joint, vector, "python")
    exec(filled("feedforward.py.j2", remarks=[], name="j", law=made), written)
    return written


def along(function, q, qd, qdd):
    return np.array([function(*map(float, row))[0] for row in zip(q, qd, qdd, strict=True)])


@pytest.mark.parametrize("name", NAMES)
def test_the_feed_forward_is_the_inverse_model_over_the_recorded_range(name, compiler, tmp_path):
    run = finished_posterior(name)
    files = bf.export(run, "c").files
    motions = [Trajectory.of(o) for o in run.model.observations]
    vector = parameter_vectors(run, motions, 10).point
    expected = torque_along(run.joint, vector[None], motions)[0]
    moving = [np.concatenate([getattr(m, x) for m in motions]) for x in MOVING]
    largest = np.abs(expected).max()
    double = along(compiled(compiler, files, tmp_path)("joint_torque"), *moving)
    np.testing.assert_allclose(double, expected, rtol=1e-6)
    single = along(compiled(compiler, files, tmp_path, SINGLE)("joint_torque"), *moving)
    np.testing.assert_allclose(single, expected, atol=1e-6 * largest)
    python = {}
    exec(bf.export(run, "python").main, python)
    again = [python["torque"](*row) for row in zip(*moving, strict=True)]  # NumPy's floats, too
    np.testing.assert_allclose(again, expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("case", ["everything", "unusual"])
def test_every_term_is_written_out(case, compiler, tmp_path):
    joint, values = (EVERYTHING, EVERYTHING_VALUES) if case == "everything" else unusual()
    vector = joint.vector(values)
    q, qd, qdd = motion()
    # at room temperature as a recording begins, of a torque that does not change
    expected = inverse_torque(joint, vector, q, qd, qdd, inputs=AT_ROOM, time=np.zeros(q.size))
    files = c_files(joint, vector)
    double = along(compiled(compiler, files, tmp_path)("joint_torque"), q, qd, qdd)
    np.testing.assert_allclose(double, expected, rtol=1e-9, atol=1e-12)
    largest = np.abs(expected).max()
    single = along(compiled(compiler, files, tmp_path, SINGLE)("joint_torque"), q, qd, qdd)
    np.testing.assert_allclose(single, expected, atol=3e-6 * largest)


MAIN = """
#include <cstdio>
#include "knee_feedforward.h"
int main() {
    double q, v, a;
    while (std::scanf("%lf %lf %lf", &q, &v, &a) == 3)
        std::printf("%.17g\\n", knee_torque(q, v, a, nullptr));
}
"""


def test_ros2_control_has_a_file_of_parameters_and_a_law_that_cpp_compiles(tmp_path):
    yaml = pytest.importorskip("yaml")
    if not shutil.which("g++"):
        pytest.skip("there is no g++")
    run = finished_posterior("rabbit-knee")
    exported = bf.export(run, "ros2-control", joint="knee")
    exported_numbers = {one["attribute"]: one["value"] for one in exported.record["numbers"]}
    parameters = yaml.safe_load(exported.main)
    gains = parameters["joint_trajectory_controller"]["ros__parameters"]["gains"]["knee"]
    own = parameters["friction_compensation"]["ros__parameters"]["knee"]["friction"]
    assert gains == {"ff_velocity_scale": exported_numbers["ff_velocity_scale"]}
    assert own["coulomb"] == exported_numbers["friction.coulomb"] > 0.0
    assert own["viscous"] == gains["ff_velocity_scale"]
    for name, text in exported.files.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "main.cpp").write_text(MAIN)
    execute = partial(subprocess.run, cwd=tmp_path, check=True)
    execute(["gcc", *FLAGS, "-c", "knee_feedforward.c"])
    strict = ["-Wall", "-Wextra", "-Werror"]
    execute(["g++", *strict, "main.cpp", "knee_feedforward.o", "-lm", "-o", "law"])
    motions = [Trajectory.of(o) for o in run.model.observations]
    vector = parameter_vectors(run, motions, 10).point
    expected = torque_along(run.joint, vector[None], motions)[0]
    moving = np.column_stack([np.concatenate([getattr(m, x) for m in motions]) for x in MOVING])
    text = "\n".join(" ".join(map(repr, row)) for row in moving.tolist())
    got = subprocess.run([tmp_path / "law"], input=text, text=True, capture_output=True, check=True)
    np.testing.assert_allclose(np.array(got.stdout.split(), float), expected, rtol=1e-6)


def test_friction_is_what_losses_add():
    joint, values = EVERYTHING, EVERYTHING_VALUES
    lossless = {
        name: 0.0 if "gravity" not in name and "stribeck_v" not in name else value
        for name, value in values.items()
    }
    kept = ("inertia", "first_moment", "gravity_angle", "gain", "offset")
    lossless |= {k: v for k, v in values.items() if k.rpartition(".")[2] in kept}
    q, qd, qdd = motion(50)
    whole = inverse_torque(joint, joint.vector(values), q, qd, qdd)
    ideal = inverse_torque(joint, joint.vector(lossless), q, qd, qdd)
    python = python_of(joint, joint.vector(values))
    got = [python["friction"](*map(float, row)) for row in zip(q, qd, qdd, strict=True)]
    np.testing.assert_allclose(got, whole - ideal, rtol=1e-9, atol=1e-12)


def test_an_offset_is_no_friction(compiler, tmp_path):
    """At rest an axis has none: what is measured there is the offset, which stands by itself."""
    motor = Element("motor", inertia=True, viscous=True, coulomb="symmetric")
    joint = Joint(elements=(motor,), load=Load(), offset=True, gain=True)
    values = {"motor.inertia": 0.1, "motor.viscous": 0.2, "motor.coulomb": 0.5}
    vector = joint.vector(values | {"offset": -3.1, "drive.gain": 2.0})
    files = c_files(joint, vector)
    call = compiled(compiler, files, tmp_path)
    assert call("joint_friction")(0.0, 0.0, 0.0)[0] == 0.0
    assert call("joint_torque")(0.0, 0.0, 0.0)[0] == pytest.approx(-1.55)
    (exported_numbers,) = re.findall(r"#define JOINT_OFFSET \((.*)\)", files["joint_feedforward.h"])
    assert float(exported_numbers) == pytest.approx(-1.55)
    python = python_of(joint, vector)
    assert python["friction"](0.0, 0.0, 0.0) == 0.0
    assert python["OFFSET"] == pytest.approx(-1.55)
    assert python["friction"](0.0, 1.0, 0.0) == pytest.approx((0.2 + 0.5) / 2.0)


def test_nothing_but_numbers_comes_out_whatever_goes_in(compiler, tmp_path):
    joint = EVERYTHING
    call = compiled(compiler, c_files(joint, joint.vector(EVERYTHING_VALUES)), tmp_path)
    rng = np.random.default_rng(8)
    odd = [math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, 1e308, -1e308, 1e-3, 1e20, -3.0]
    python = python_of(joint, joint.vector(EVERYTHING_VALUES))
    torque, friction = call("joint_torque"), call("joint_friction")
    single = compiled(compiler, c_files(joint, joint.vector(EVERYTHING_VALUES)), tmp_path, SINGLE)
    single = single("joint_torque")
    seen = set()
    for _ in range(2000):
        row = [odd[k] for k in rng.integers(len(odd), size=3)]
        for function in (torque, friction, single):
            value, status = function(*row)
            assert math.isfinite(value)
            assert status == 0 or value == 0.0
            given = [ctypes.c_float(x).value for x in row] if function is single else row
            assert (status == 1) == (not all(map(math.isfinite, given)))
            seen.add(status)
        value, status = torque(*row)
        got, _, fine = python["both"](*row)
        assert fine == (status == 0)
        assert got == pytest.approx(value, rel=1e-9)
    assert seen == {0, 1, 2}


def test_smoothing_makes_losses_grow_from_rest(compiler, tmp_path):
    joint = EVERYTHING
    files = c_files(joint, joint.vector(EVERYTHING_VALUES))
    sharp = compiled(compiler, files, tmp_path)("joint_friction")
    smooth = compiled(compiler, files, tmp_path, "-DJOINT_SMOOTH=0.5")("joint_friction")
    assert sharp(0.3, 0.0, 0.0)[0] == smooth(0.3, 0.0, 0.0)[0]
    jump = sharp(0.3, 1e-9, 0.0)[0] - sharp(0.3, -1e-9, 0.0)[0]
    step = smooth(0.3, 1e-9, 0.0)[0] - smooth(0.3, -1e-9, 0.0)[0]
    assert abs(step) < 1e-6 * abs(jump)
    assert smooth(0.3, 0.6, 0.0)[0] == sharp(0.3, 0.6, 0.0)[0]


def with_own(column):
    joint = Joint(elements=(Element("motor", ratio=3.0, inertia=True),), load=Load(inertia=True))
    return joint.with_term(Term("motor.own", column))


def test_a_term_of_ones_own_is_written_out(compiler, tmp_path):
    joint = with_own(
        lambda m: (
            m.direction * np.square(np.arctan(m.speed)) - (-m.position - 1.0) / (2.0 - m.speed)
        )
    )
    vector = np.array([0.1, 0.7, 0.2])
    q, qd, qdd = motion(50)
    expected = inverse_torque(joint, vector, q, qd, qdd, time=np.zeros(q.size))
    double = along(compiled(compiler, c_files(joint, vector), tmp_path)("joint_torque"), q, qd, qdd)
    np.testing.assert_allclose(double, expected, rtol=1e-12)
    again = along(python_of(joint, vector)["both"], q, qd, qdd)
    np.testing.assert_allclose(again, expected, rtol=1e-12)


@pytest.mark.parametrize("column", [lambda m: math.sin(m.position), lambda m: np.sin(m.time)])
def test_one_without_a_formula_is_refused_by_name(column):
    joint = with_own(column)
    with pytest.raises(BadInput, match=r"motor\.own: is a custom term"):
        law(joint, np.ones(len(joint.names)), "c")
