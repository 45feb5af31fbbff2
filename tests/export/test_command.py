"""`export` on the command line, of a real fit of a SIMULATED recording."""

import json
import shutil

import numpy as np
import pytest

import bayesfric as bf

from ..commands.bench import SAMPLED, Bench, simulated, without_figures

pytestmark = pytest.mark.usefixtures("nothing_explained")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """Fit once; whoever exports gets a copy."""
    folder = tmp_path_factory.mktemp("fitted")
    simulated(folder / "c.toml", SAMPLED)
    with pytest.MonkeyPatch.context() as patch:
        without_figures(patch)
        from bayesfric.commands.fit import fit
        from bayesfric.problem.config import read_config

        fit(read_config(folder / "c.toml"), folder / "c-run")
    return folder


@pytest.fixture
def bench(fitted, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    made = Bench(tmp_path, monkeypatch, capfd)
    shutil.copytree(fitted, tmp_path, dirs_exist_ok=True)
    return made


def test_a_folder_is_written_and_said(bench):
    ended = bench.run("export", "c-run", "--to", "mujoco", "--joint", "knee")
    assert ended.code == 0, ended
    folder = bench.folder / "c-run-mujoco"
    names = {path.name for path in folder.iterdir()}
    assert names == {"knee.xml", "knee_friction.py", "export.json"}
    record = json.loads((folder / "export.json").read_text())
    assert record["joint"] == "knee"
    assert record["draws"] == 400
    # the truth is within the intervals
    truth = json.loads((bench.folder / "small.truth.json").read_text())["parameters"]
    rows = {row["attribute"]: row for row in record["numbers"]}
    for attribute, name in (
        ("joint armature", "motor.inertia"),
        ("joint damping", "motor.viscous"),
        ("joint frictionloss", "motor.coulomb"),
    ):
        low, high = rows[attribute]["interval"]
        width = high - low
        assert low - width < truth[name]["value"] < high + width


def test_python_returns_what_the_command_prints(bench):
    printed = bench.record("export", "c-run", "--to", "urdf")
    found = bf.export("c-run", "urdf")
    assert found.as_json() == printed
    assert (bench.folder / "c-run-urdf" / "joint.urdf").read_text() == found.main
    ended = bench.run("export", "c-run", "--to", "urdf", "--force")
    assert ended.out.startswith(found.text())


def test_the_numbers_are_those_that_the_run_reports(bench):
    """The draws that intervals are of are fewer, and have other medians."""
    record = bench.summary("c-run")
    row = record["parameters"]["motor.inertia"]

    def armature():
        found = bf.export("c-run", "mujoco").as_json()
        assert found["central"] == "reported"
        return next(x for x in found["numbers"] if x["attribute"] == "joint armature")

    before = armature()
    assert before["value"] == pytest.approx(row["reported"]["value"], rel=1e-9)
    # the same run, had its self-check torque_of off a bias of 20 sds
    off = 20.0 * row["sd"]
    row["reported"]["value"] += off
    (bench.folder / "c-run" / "summary.json").write_text(json.dumps(record))
    after = armature()
    assert after["value"] == pytest.approx(row["reported"]["value"], rel=1e-9)
    moved = np.subtract(after["interval"], before["interval"])
    assert moved == pytest.approx([off, off], rel=1e-6)


def test_what_is_there_is_kept(bench):
    (bench.folder / "out.xml").write_text("mine")
    (bench.folder / "folder").mkdir()
    (bench.folder / "folder" / "mine").write_text("mine")
    # a folder that no export made is not put aside either
    for place in (["out.xml"], ["folder"], ["folder", "--force"]):
        bench.refused("export", "c-run", "--to", "mujoco", "-o", *place)


@pytest.mark.parametrize(
    "arguments",
    [
        ("c-run", "--to", "gazebo"),
        ("c-run", "--to", "csv", "--into", "x.xml"),
        ("c-run", "--to", "mujoco", "--into", "no.xml"),
        ("nothing", "--to", "mujoco"),
    ],
)
def test_what_cannot_be_meant_is_one_line(bench, arguments):
    bench.refused("export", *arguments)
