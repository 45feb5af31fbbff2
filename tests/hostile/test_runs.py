"""A run directory from somewhere else is input like any other, and so is what is opened by name."""

import ast
import os
import re
import shutil

import h5py
import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.base.opened import (
    array_of,
    opened_hdf5,
    parse_json,
    read_bytes,
    read_json,
    read_text,
)
from tests.commands.bench import SAMPLED, recorded, simulated
from tests.conftest import REPOSITORY
from tests.hostile.rule import run

COMMANDS = (
    ("export", "bad", "--to", "urdf"),
    ("rollout", "bad"),
    ("report", "bad"),
    ("compare", "bad", "good"),
)


def ran(folder, *words):
    """Run a command in a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return run(*words, seconds=30)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesfric.diagnostics.explanation.LEAST_OUTPUTS", 10**9)
        simulated(folder / "small.toml", SAMPLED)
        outcome = ran(folder, "fit", "small.toml", "-o", "good")
    assert outcome.code in (0, 3), outcome
    return folder


@pytest.fixture
def bad(made, tmp_path):
    for name in ("good", "bad"):
        shutil.copytree(made / "good", tmp_path / name)
    for file in made.glob("small*.*"):
        shutil.copy(file, tmp_path)
    return tmp_path / "bad"


def draws(change):
    def damaged(run):
        with h5py.File(run / "posterior.nc", "r+") as file:
            change(file)

    return damaged


def put(name, make):
    def changed(file):
        group = file["posterior"]
        old = group["motor.inertia"][()]
        del group["motor.inertia"]
        make(group, old) if name is None else group.create_dataset("motor.inertia", data=make(old))

    return draws(changed)


def endless(group, _):
    # next to nothing on the disk, 16 GB of a fill value
    group.create_dataset("motor.inertia", shape=(2**11, 2**20), dtype="f8", chunks=(64, 1024))


def unpacked(group, _):
    shape = (8192, 8192)
    made = group.create_dataset("motor.inertia", shape=shape, dtype="f8", chunks=shape,
                                compression="gzip")  # fmt: skip
    made[...] = 0.0


def head(run):
    raw = bytearray((run / "posterior.nc").read_bytes())
    raw[:64] = bytes(255 - b for b in raw[:64])
    (run / "posterior.nc").write_bytes(raw)


def attribute(name, text):
    return draws(lambda file: file.attrs.__setitem__(name, text))


def summary(change):
    def damaged(run):
        path = run / "summary.json"
        path.write_text(change(path.read_text()))

    return damaged


def renamed(name):
    def changed(text):
        return text.replace("motor.inertia", name)

    return summary(changed)


def valued(key, value):
    return summary(lambda text: re.sub(rf'("{key}": )[-+.0-9e]+', rf"\g<1>{value}", text))


def instead(name, make):
    def damaged(run):
        path = run / name
        path.unlink(missing_ok=True)
        make(path)

    return damaged


def zero(path):
    path.symlink_to("/dev/zero")


DAMAGED = {
    "an array of 16 GB of nothing": put(None, endless),
    "a piece of half a gigabyte": put(None, unpacked),
    "no draws": put("", lambda x: x[:, :0]),
    "draws that are no number": put("", lambda x: np.where(x > np.median(x), np.nan, x)),
    "other shapes": put("", lambda x: x[:, :-1]),
    "one row": put("", lambda x: x[0]),
    "text": put("", lambda x: np.full(x.shape, "x", dtype="S1")),
    "a flipped head": head,
    "an empty file": instead("posterior.nc", lambda path: path.write_bytes(b"")),
    "deep JSON": attribute("versions", "[" * 100_000),
    "spans that are a list": attribute("spans", "[1]"),
    "a configuration that is none": attribute("config", "mechanism = 3"),
    "a deep summary": summary(lambda _: "[" * 200_000),
    "a summary of a list": summary(lambda _: "[1, 2]"),
    "a long name": renamed("motor." + "x" * 120),
    "half a character": renamed("motor.\\ud800"),
    "a terminal's command": renamed("motor.\\u001b[31m"),
    "the least number": valued("sd", "5e-324"),
    "the largest number": valued("median", "1e308"),
    "more than all of the torque": valued("explained", "2.0"),
    "an infinite number": valued("sd", "1e400"),
}
for _name in ("posterior.nc", "summary.json", "config.toml", "page.json", "text/captions.md",
              "figures/friction.svg"):  # fmt: skip
    DAMAGED[f"a pipe as {_name}"] = instead(_name, os.mkfifo)
    DAMAGED[f"endless {_name}"] = instead(_name, zero)
    DAMAGED[f"a folder as {_name}"] = instead(_name, lambda path: path.mkdir())


@pytest.mark.parametrize("damaged", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_run_is_refused_in_one_line_or_does_without(bad, damaged):
    damaged(bad)
    for words in COMMANDS:
        outcome = ran(bad.parent, *words)
        code, out, err = outcome.code, outcome.out, outcome.err
        assert code in (0, 2, 3), (words, err)
        assert "\x1b" not in out.replace("\x1b[0m", "")
        if code == 2:
            assert err.startswith("bayesfric: "), (words, err)
            assert err.count("\n") == 1, (words, err)


# -- what every file passes


def test_what_is_opened_is_an_ordinary_file_of_bounded_size(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "large").write_bytes(b"x" * 2000)
    (tmp_path / "latin").write_bytes(b"\xe4")
    for name in ("pipe", "zero", "large", "latin", "gone", "."):
        with pytest.raises(BadInput):
            read_text(tmp_path / name, largest=1000)
    for name in ("pipe", "zero", "latin", "gone"):
        with pytest.raises(BadInput), opened_hdf5(tmp_path / name):
            pass
    assert read_bytes(tmp_path / "large") == b"x" * 2000


@pytest.mark.parametrize(
    "text", ["[" * 10**6, "NaN", "{", "[1e", '{"a": Infinity}', "1e101", "1" * 500, '"\\u001b"']
)
def test_json_is_finite_and_not_too_deep(tmp_path, text):
    with pytest.raises(BadInput):
        parse_json("x", text)
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(BadInput):
        read_json(tmp_path / "x.json")


def test_an_array_has_the_size_that_it_says(tmp_path):
    whole = np.arange(12.0).reshape(3, 4)
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["whole"] = whole
        file.create_group("group")
        file.create_dataset("filled", shape=(10**6,), dtype="f8")
        file["linked"] = h5py.ExternalLink("other.h5", "/x")
    with opened_hdf5(tmp_path / "x.h5") as file:
        np.testing.assert_array_equal(array_of(file["whole"]), whole)
        for name in ("group", "filled"):
            with pytest.raises(ValueError, match="array"):
                array_of(file[name])


OPENS = {
    "open",
    "read_text",
    "read_bytes",
    "fromfile",
    "File",
    "loadmat",
    "from_netcdf",
}
# the gate, and what the table's gate has let through
THROUGH = {"base/opened", "recordings/tables", "recordings/source"}
# what they wrote themselves in this process, or write
OWN = {"commands/cli"}


def test_nothing_else_opens_a_file():
    house = REPOSITORY / "bayesfric"
    found = set()
    for path in house.rglob("*.py"):
        name = path.relative_to(house).with_suffix("").as_posix()
        if any(name.startswith(one) for one in THROUGH | OWN):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                inside = ast.unparse(node.func.value)
                resource = inside.startswith(("files(", "(files("))
                if node.func.attr in OPENS and not resource:
                    found.add(f"{name}: {ast.unparse(node)[:60]}")
    assert found == set()


# -- who is at fault, and when it is told

RECORDING = recorded()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("mechanism = 3", ("other.toml: mechanism", "got 3")),
        ("recordings = [1]", ("other.toml: recordings",)),
        (RECORDING + "exclude = [[0.1, 0.2]\n[0.3, 0.4]]", ("other.toml", "line 8")),
        ("a = " + "[" * 900 + "]" * 900, ("other.toml",)),
        (RECORDING + "exclude = [[0.01, 2.995]]\n", ()),
    ],
    ids=["no table", "no tables", "no comma", "deep", "nothing left"],
)
def test_a_roll_out_names_the_file_at_fault_before_it_simulates(bad, monkeypatch, text, parts):
    monkeypatch.setattr("bayesfric.rollouts.rollout._play", None)
    (bad.parent / "other.toml").write_text(text)
    outcome = ran(bad.parent, "rollout", "good", "other.toml")
    assert outcome.code == 2, outcome
    assert all(part in outcome.err for part in parts), outcome.err


def test_what_cannot_be_written_is_not_simulated(bad, monkeypatch):
    monkeypatch.setattr("bayesfric.rollouts.rollout._play", None)
    shutil.rmtree(bad / "figures")
    (bad / "figures").write_text("")
    (bad / ".figures").mkdir()
    monkeypatch.setattr("bayesfric.base.written.place_beside", lambda _: bad / ".figures")
    outcome = ran(bad.parent, "rollout", "bad")
    assert outcome.code == 2, outcome
    assert "cannot be written" in outcome.err


def test_a_roll_out_of_a_run_without_draws_names_its_file(bad):
    DAMAGED["no draws"](bad)
    outcome = ran(bad.parent, "rollout", "bad")
    assert outcome.code == 2, outcome
    assert "bad/posterior.nc" in outcome.err, outcome.err
