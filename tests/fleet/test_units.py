"""Units, their names and values, and the template filled with them."""

from contextlib import contextmanager

import pytest

from bayesfric.base.errors import BadInput
from bayesfric.fleet.plan import find_units, read_plan, read_units

from ..commands.bench import has
from .made import FLEET, TEMPLATE, write_fleet


@contextmanager
def refused(*said):
    with pytest.raises(BadInput) as told:
        yield
    has(str(told.value), *said)


def table(folder, text):
    path = folder / "units.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_numbers_are_numbers_and_serial_numbers_are_not(tmp_path):
    path = table(tmp_path, "unit;mass;serial;n;ok;note\na;2.50;007;3;true;x\nb;1e-2;010;4;false;\n")
    a, b = read_units(path, None)
    assert (a.name, b.name) == ("a", "b")
    assert a.values == {
        "unit": "a", "mass": 2.5, "serial": "007", "n": 3, "ok": True, "note": "x",
    }  # fmt: skip
    assert b.values["mass"] == 0.01
    assert b.values["note"] is None
    assert type(a.values["n"]) is int
    # inside other words as it was written
    assert a.text["mass"] == "2.50"


def test_a_glob_names_parts(tmp_path):
    for name in ("r1/knee/01.csv", "r1/hip/01.csv", "r2/knee/12.csv", "r2/knee/x.txt"):
        (tmp_path / "logs" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "logs" / name).touch()
    units = find_units("logs/{robot}/{joint}/{day}.csv", tmp_path, None)
    assert [u.name for u in units] == ["r1-hip-01", "r1-knee-01", "r2-knee-12"]
    assert units[2].values == {
        "robot": "r2", "joint": "knee", "day": "12", "file": "logs/r2/knee/12.csv",
    }  # fmt: skip
    # a part named twice is one
    (tmp_path / "logs/r3/r3").mkdir(parents=True)
    (tmp_path / "logs/r3/r3/x.csv").touch()
    (only,) = find_units("logs/{robot}/{robot}/{day}.csv", tmp_path, "{robot}")
    assert only.name == "r3"
    # folders that no part names, and hidden files that nobody means
    (tmp_path / "logs/._x.csv").touch()
    names = [u.name for u in find_units("**/{joint}/{day}.csv", tmp_path / "logs", None)]
    assert names == ["hip-01", "knee-01", "knee-12", "r3-x"]
    (hip,) = find_units(f"{tmp_path}/logs/*/h?p/{{day}}.csv", tmp_path, None)
    assert hip.values["file"] == "logs/r1/hip/01.csv"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("unit,x\na,1\na,2\n", ("row 3", "'a' is there twice")),
        ("unit,x\n../a,1\n", ("row 2", "cannot be the name of a folder")),
        ("unit,x\n.a,1\n", ("row 2", "cannot be the name of a folder")),
        ("unit,x\na,1,2\n", ("Expected 2 fields in line 2, saw 3",)),
        ("serial,x\na,1\n", ("has no names of units",)),
        ("unit,unit\na,1\n", ("columns 1 and 2 are both named 'unit'",)),
        ("unit,x\n", ("has no rows",)),
        ("", ("is empty",)),
    ],
)
def test_a_bad_table_is_told_in_a_line(tmp_path, text, said):
    with refused(*said):
        read_units(table(tmp_path, text), None)


def test_the_template_is_filled(tmp_path):
    plan = read_plan(write_fleet(tmp_path))
    import tomllib

    filled = tomllib.loads(plan.configuration(plan.units[1]))
    assert filled["sampling"] == {"min_ess": 300, "seed": 1}
    assert filled["recordings"][0]["file"] == "u1.csv"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"{seed}"', '"{sead}"', ("sampling.seed", "{sead}", "did you mean 'seed'?")),
        ("min_ess = 300", "min_es = 300", ("unit.toml: sampling.min_es", "unknown key")),
        ('table = "units.csv"', "", ("units", "got neither")),
        ('table = "units.csv"', 'tabel = "units.csv"', ("units.tabel", "unknown key")),
        ('"unit.toml"', '"unix.toml"', ("unix.toml", "does not exist")),
    ],
)
def test_a_bad_plan_or_template_is_told_in_a_line(tmp_path, old, new, said):
    path = write_fleet(tmp_path)
    assert old in TEMPLATE + FLEET
    (tmp_path / "unit.toml").write_text(TEMPLATE.replace(old, new))
    path.write_text(FLEET.replace(old, new))
    with refused(*said):
        read_plan(path)
