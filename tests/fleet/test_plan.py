"""Units, their names and values, and the template filled with them."""

import tomllib

import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.fleet.plan import find_units, read_plan, read_units

from ..commands.bench import has
from .simulated_fleet import FLEET, TEMPLATE, write_fleet


def write_table(folder, text):
    path = folder / "units.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_numbers_are_numbers_and_serial_numbers_are_not(tmp_path):
    text = "unit;mass;serial;n;ok;note\na;2.50;007;3;true;x\nb;1e-2;010;4;false;\n"
    a, b = read_units(write_table(tmp_path, text), None)
    assert (a.name, b.name) == ("a", "b")
    assert a.values == {
        "unit": "a", "mass": 2.5, "serial": "007", "n": 3, "ok": True, "note": "x",
    }  # fmt: skip
    assert (b.values["mass"], b.values["note"]) == (0.01, None)
    assert type(a.values["n"]) is int
    # inside other words as it was written
    assert a.text["mass"] == "2.50"


def test_a_glob_names_parts(tmp_path):
    # one file is hidden, one of another suffix, and in one path a part is repeated
    for name in ("r1/knee/01.csv", "r1/hip/01.csv", "r2/knee/x.txt", "r3/r3/x.csv", "._x.csv"):
        (tmp_path / "logs" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "logs" / name).touch()
    units = find_units("logs/{robot}/{joint}/{day}.csv", tmp_path, None)
    assert [u.name for u in units] == ["r1-hip-01", "r1-knee-01", "r3-r3-x"]
    assert units[1].values == {
        "robot": "r1", "joint": "knee", "day": "01", "file": "logs/r1/knee/01.csv",
    }  # fmt: skip
    (repeated,) = find_units("logs/{robot}/{robot}/{day}.csv", tmp_path, "{robot}")
    assert repeated.name == "r3"
    # folders that no part names
    names = [u.name for u in find_units("**/{joint}/{day}.csv", tmp_path / "logs", None)]
    assert names == ["hip-01", "knee-01", "r3-x"]
    (hip,) = find_units(f"{tmp_path}/logs/*/h?p/{{day}}.csv", tmp_path, None, tmp_path / "logs")
    assert hip.values["file"] == "r1/hip/01.csv"


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("unit,x\na,1\na,2\n", "units.csv, row 3"),
        ("unit,x\n../a,1\n", "units.csv, row 2"),
        ("unit,x\n.a,1\n", "units.csv, row 2"),
        ("unit,x\na,1,2\n", "line 2"),
        ("serial,x\na,1\n", "units.csv: has no names"),
        ("unit,unit\na,1\n", "two columns are named 'unit'"),
        ("unit,x\n", "units.csv: has no rows"),
        ("", "units.csv: "),
    ],
)
def test_bad_tables(tmp_path, text, part):
    with pytest.raises(BadInput) as error:
        read_units(write_table(tmp_path, text), None)
    has(str(error.value), part)


def test_the_template_is_filled(tmp_path):
    plan = read_plan(write_fleet(tmp_path))
    filled = tomllib.loads(plan.configuration(plan.units[1]))
    assert filled["sampling"] == {"min_ess": 300, "seed": 1}
    assert filled["recordings"][0]["file"] == "u1.csv"


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('"{seed}"', '"{sead}"', ("sampling.seed", "{sead}", "'seed'")),
        ("min_ess = 300", "min_es = 300", ("unit.toml: sampling.min_es",)),
        ('table = "units.csv"', "", ("fleet.toml: units",)),
        ('table = "units.csv"', 'tabel = "units.csv"', ("fleet.toml: units.tabel",)),
        ('"unit.toml"', '"unix.toml"', ("unix.toml", "does not exist")),
    ],
)
def test_bad_plans_and_templates(tmp_path, old, new, parts):
    path = write_fleet(tmp_path)
    assert old in TEMPLATE + FLEET
    (tmp_path / "unit.toml").write_text(TEMPLATE.replace(old, new))
    path.write_text(FLEET.replace(old, new))
    with pytest.raises(BadInput) as error:
        read_plan(path)
    has(str(error.value), *parts)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"cluster": {"memory_limit": "much"}}, "cluster.memory_limit"),
        ({"cluster": {"worker": 2}}, "Fleet: cluster.worker"),
        ({"runs": {"draws": "all"}}, "Fleet: runs.draws"),
    ],
)
def test_bad_options_in_python(tmp_path, options, part):
    write_fleet(tmp_path, good=1)
    with pytest.raises(BadInput, match=part):
        bf.Fleet(tmp_path / "unit.toml", tmp_path / "units.csv", **options).run(tmp_path / "out")
    assert not (tmp_path / "out").exists()
