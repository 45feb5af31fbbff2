"""What programs take of exported files is what the package says of them; SIMULATED joints."""

import tomllib
from importlib.resources import files

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.export.programs import programs
from tests.conftest import REPOSITORY

from .arm_programs import ARM_PROGRAMS, arm_row
from .made import finished_posterior, numbers
from .programs import PROGRAMS, measured, table, torque_errors

# programs' own use of what their libraries will take away
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
TOML = tomllib.loads((files("bayesfric.export") / "programs.toml").read_text(encoding="utf-8"))
ROWS = [(name, form) for name, (_, _, forms, _) in PROGRAMS.items() for form in forms]
ARM_ROWS = [(name, form) for name, (forms, _) in ARM_PROGRAMS.items() for form in forms]


def installed(name):
    for module in PROGRAMS[name][0].split():
        pytest.importorskip(module, reason=f"{name} is not installed")


@pytest.mark.parametrize(("name", "form"), ROWS)
def test_a_program_takes_what_its_row_says(name, form):
    installed(name)
    known, row = programs()[form][name], measured(name, form)
    assert row["takes"] == pytest.approx(dict(known.takes), abs=0.02)
    assert set(row["stored"]) == set(known.stored)
    assert row["adds"] == pytest.approx(dict(known.adds), rel=0.05)
    assert set(row["warns"]) == set(known.warns)
    assert {x: set(lost) for x, lost in row["spoils"].items()} == {
        x: set(lost) for x, lost in known.spoils.items()
    }


@pytest.mark.parametrize(("name", "form"), [x for x in ROWS if "torque" in TOML[x[1]][x[0]]])
def test_a_program_has_the_torque_that_its_row_says(name, form):
    installed(name)
    errors, known = torque_errors(name, form), TOML[form][name]["torque"]
    assert errors.keys() == known.keys()
    for what, row in errors.items():
        for error, expected in zip(row, known[what], strict=True):
            assert error == expected or error == pytest.approx(expected, rel=0.05, abs=0.05)


def carries(row):
    """Whether a program takes all losses that the file for it has, so that it is no worse."""
    takes = {x for x, factor in row["takes"].items() if factor}
    return bool(takes & {"friction", "damping", "quadratic"})


@pytest.mark.parametrize(("form", "name"), [(f, n) for f, x in TOML.items() for n in x])
def test_what_was_measured_is_what_the_format_carries(form, name):
    """In a program that has losses a file for it is as near to the law as its numbers are."""
    row = TOML[form][name]
    for plain, fitted, carried, size in row.get("torque", {}).values():
        assert fitted != "refused"
        if carries(row):
            # Newton's and PyBullet's steps and damping of their own: 4 % of the law at most
            assert fitted == pytest.approx(carried, rel=0.05, abs=0.04 * size)
            assert plain == "refused" or fitted <= 1.05 * plain + 0.04 * size


def test_bam_is_as_near_to_the_law_as_was_asked():
    assert max(TOML["bam"]["bam"]["torque"][x][1] for x in ("states", "chirp")) <= 0.25


@pytest.mark.parametrize(("name", "form"), ARM_ROWS)
def test_effort_limits_and_mimic_joints_of_an_arm_arrive_as_its_row_says(name, form, tmp_path):
    installed(name)
    assert arm_row(name, form, tmp_path) == pytest.approx(dict(programs()[form][name].takes))


def test_no_program_is_without_a_row():
    rows = sorted((name, form) for form, known in programs().items() for name in known)
    assert sorted(ROWS + ARM_ROWS) == rows


def test_the_page_has_the_table():
    page = (REPOSITORY / "studies" / "reference" / "simulators.md").read_text(encoding="utf-8")
    assert table(TOML) in page


def test_an_export_for_a_program_fits_what_that_takes():
    """Drake refuses the quadratic damping of MJCF and has no friction: damping alone is left."""
    run = finished_posterior("plain")
    plain, drake = (bf.export(run, "mujoco", program=name) for name in (None, "drake"))
    assert ' 0"' in plain.main.partition("damping=")[2][:60]
    value = numbers(drake)
    assert "joint damping, second number" not in value
    assert "joint frictionloss" not in value
    assert value["joint damping"] > numbers(plain)["joint damping"]
    lost = {name for row in drake.record["lost"] for name in row["parameters"]}
    assert {"joint.quadratic", "joint.coulomb", "motor.coulomb"} <= lost
    # what a file without --for loses there is listed with its torque
    (row,) = (x for x in plain.record["programs"] if x["program"] == "drake")
    assert row["refuses"] == ["quadratic"]
    assert [x["program"] for x in drake.record["programs"]] == ["drake"]


def test_what_sdf_loses_in_drake_is_listed_in_newton_metres():
    """Friction at the motor is friction at the joint over the ratio, with the sign of speed."""
    exported = bf.export(finished_posterior("plain"), "sdf")
    (row,) = exported.record["programs"]
    (friction,) = (x for x in row["changed"] if x["number"] == "friction")
    assert friction["torque"] == pytest.approx(
        numbers(exported)["dynamics friction"] / 50.0, rel=0.01
    )
    assert row["error"] > 0.5 * friction["torque"]


@pytest.mark.parametrize("name", ["pinocchio", "drake"])
def test_a_file_for_a_program_has_nothing_that_spoils_another_number(name):
    exported = bf.export(finished_posterior("plain"), "mujoco", program=name)
    program = programs()["mujoco"][name]
    present = {x["number"] for x in exported.record["programs"][0]["changed"]}
    assert not present & set(program.spoils)
    assert np.isfinite(exported.record["programs"][0].get("error", 0.0))


def test_an_unknown_program_is_refused_by_its_nearest_name():
    with pytest.raises(BadInput, match="did you mean 'drake'"):
        bf.export(finished_posterior("plain"), "sdf", program="drak")


def test_an_offset_that_a_program_does_not_take_is_left_out_and_said():
    """Drake takes the motor of MJCF, and with it the armature, but not an actuator with a bias."""
    exported = bf.export(finished_posterior("plain"), "mujoco", program="drake")
    (offset,) = (x for x in exported.record["lost"] if x["parameters"] == ["offset"])
    assert offset["torque"] == offset["left"] == pytest.approx(0.01)
    assert offset["fitted"] == []
    assert "<motor" in exported.main
