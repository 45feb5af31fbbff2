"""Each kind of oddity once, with its reader, and random damage: 0, or one line and 2.

In one process that may take little memory, so that a reader that allocates what a file claims is
told too.
"""

import io
import json
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayesfric.base.errors import BadInput
from bayesfric.problem.config import parse_config
from tests.hostile import good
from tests.hostile.rule import broken_rule, check
from tests.hostile.test_findings import npy, npz

MEMORY = 2**30
SUFFIXES = ("csv", "tsv", "json", "npz", "mat", "parquet", "jsonl", "h5", "mcap", "bag", "db3")


@pytest.fixture(scope="module", autouse=True)
def little_memory(tmp_path_factory):
    """Refuse this process more than a GiB beyond what reading one file of each kind imports."""
    folder = tmp_path_factory.mktemp("good")
    for form in (*SUFFIXES, "7.3.mat", "packed.mcap"):
        (folder / f"run.{form}").write_bytes(good.content(form))
        (folder / "c.toml").write_text(good.config(f"run.{form}"))
        assert check(folder / "c.toml", seconds=120).code == 0, form
    parse_config(good.LONG_CONFIG, Path("c.toml"))
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def ends_well(folder, form, recording, extra=""):
    """Check a recording of these bytes; what is wrong with how that ends."""
    suffix = form.rpartition(".")[2]
    (folder / f"run.{suffix}").write_bytes(recording)
    (folder / "c.toml").write_text(good.config(f"run.{suffix}", extra))
    return broken_rule(folder / "c.toml", "run.", "'run'", ": run:")


# -- bytes


def damaged(data, rng):
    """Flip, exchange, insert, repeat, move or cut bytes, in one to three places."""
    data = bytearray(data)
    # binary formats say what they hold at their beginnings and ends
    near = [range(len(data)), range(120), range(max(len(data) - 120, 0), len(data))]
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.choice(near[int(rng.integers(3))]))
        long = int(rng.integers(1, 40))
        word = int(rng.choice([0, 1, 2**16, 2**31 - 1, 2**31, 2**32 - 1]))
        match int(rng.integers(7)):
            case 0:
                data[at : at + 1] = bytes(
                    [data[at] ^ 1 << int(rng.integers(8))] if data[at:] else b""
                )
            case 1:
                data[at : at + 4] = word.to_bytes(4, "little")
            case 2:
                data[at:at] = rng.bytes(long)
            case 3:
                data[at:at] = data[at : at + long] * int(rng.integers(1, 20))
            case 4:
                data[at : at + long] = data[:long]
            case 5:
                del data[at : at + long]
            case 6:
                del data[at:]
    return bytes(data)


# studies/fuzzing goes on from here
SEEDS = range(4)


@pytest.mark.parametrize("form", good.FORMATS)
def test_damaged_recordings(tmp_path, form):
    whole = good.content(form)
    for seed in SEEDS:
        recording = damaged(whole, np.random.default_rng(seed))
        assert ends_well(tmp_path, form, recording) is None, seed


@pytest.mark.parametrize("text", [good.config("run.csv"), good.LONG_CONFIG])
def test_damaged_configurations(tmp_path, text):
    (tmp_path / "run.csv").write_bytes(good.content("csv"))
    for seed in SEEDS:
        (tmp_path / "c.toml").write_bytes(damaged(text.encode(), np.random.default_rng(seed)))
        assert broken_rule(tmp_path / "c.toml") is None, seed


# -- cells, names, numbers, types

TEXTS = (
    " ", "-1e-999", "1e-320", "1,5", "1.5.2", "--1", "True", "2020-01-01", '"', "#", "\\", "\t",
    "\x0b", "\x1b[31m", "\x85", "\u2028", "\u00a0", "\u0661", "\ufeff", "😀", "=1+1", "9" * 400,
    "18446744073709551616", "a" * 300, "\0",
)  # fmt: skip
NUMBERS = (np.nan, -np.inf, 1e308, 1e200, 1e16, 1e-320, 1e-200, -0.0)
TYPES = ("?", "i1", "u8", ">f4", "f2", "c16", "S5", "U3", "M8[ns]", "m8[s]")


def test_cells_and_names_of_a_csv(tmp_path):
    rows = [line.split(",") for line in good.content("csv").decode().splitlines()]
    for k, text in enumerate(TEXTS):
        for at in (0, 3):
            odd = [list(row) for row in rows]
            odd[at][1] = text
            mark = (",", ";", "\t", "|", " ", ", ")[k % 6]
            end = ("\n", "\r\n", "\r", "\n\n")[k % 4]
            made = end.join(mark.join(row) for row in odd)
            assert ends_well(tmp_path, "csv", made.encode(errors="replace")) is None, (text, at)


@pytest.mark.parametrize("form", ["npz", "deflated.mat", "parquet"])
@pytest.mark.parametrize("name", ["t", "q", "tau"])
def test_numbers_of_a_column(tmp_path, form, name):
    whole = good.columns()
    for number in NUMBERS:
        for where in (slice(3, 4), slice(None)):
            odd = whole[name].copy()
            odd[where] = number
            recording = good.content(form, data=whole | {name: odd})
            assert ends_well(tmp_path, form, recording) is None, number


@pytest.mark.parametrize("name", ["t", "q"])
def test_types_and_shapes_of_a_column(tmp_path, name):
    whole = good.columns()
    of = whole[name]
    shapes = [of[:0], of[:1].reshape(()), of[::-1], np.repeat(of, 2), of.reshape(-1, 1, 1)]
    with np.errstate(all="ignore"):
        kinds = [(100 * of).astype("i8").astype(kind) for kind in TYPES]
    for odd in (*shapes, *kinds):
        recording = good.content("npz", data=whole | {name: odd})
        assert ends_well(tmp_path, "npz", recording) is None, (odd.shape, odd.dtype)
    for odd in ("Q", "a.b", "/q", "../q", "\ufeffq", "t" * 400):
        assert ends_well(tmp_path, "npz", npz(**{odd: npy(), "t": npy()})) is None, odd


@pytest.mark.parametrize(
    "header",
    [
        *(f"{{'descr': {kind}, 'fortran_order': False, 'shape': (250,), }}" for kind in (
            "'|O'", "'<U9999999'", "'|V0'", "'<f16'", "[('a','<f8')]", "'<f8,<i4'", "'x'",
            "'<f8'*9", "b'<f8'", "None", "[[['a']]]", "'<c16'", "'>f8'")),
        *(f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}" for shape in (
            "()", "(0,)", "(-1,)", "(250, 1)", "(1e3,)", "(10**9,)", "(99999999999999,)",
            "(9223372036854775807,)", "(2**70,)", "(250,)*9", "'a'", "(True,)", "250",
            "(((250,),),)", "(3000000000,)")),
        "{'descr': '<f8', 'fortran_order': None, 'shape': (250,), }", "{" + "'a':" * 2000, "{",
    ],
)  # fmt: skip
def test_headers_of_an_npy(tmp_path, header):
    """Numpy reads them as Python."""
    assert ends_well(tmp_path, "npz", npz(t=npy(), q=npy(header), tau=npy())) is None


@pytest.mark.parametrize("member", ["../x.npy", "/etc/x.npy", "q", "a/", "x\n.npy"])
def test_members_of_an_npz(tmp_path, member):
    out = io.BytesIO(npz(t=npy(), q=npy(), tau=npy()))
    with zipfile.ZipFile(out, "a") as archive:
        archive.writestr(member, npy())
    assert ends_well(tmp_path, "npz", out.getvalue()) is None


def test_values_of_a_json(tmp_path):
    values = [None, True, "x", "", "1", [], [1], {}, {"a": 1}, 10**400, -(10**30), float("nan"),
              float("inf"), 1e308, "\ud800", "\0", [[[]]]]  # fmt: skip
    table, rows = (json.loads(good.content(form)) for form in ("json", "rows.json"))
    for value in values:
        cell = table["q"].copy()
        cell[3] = value
        for odd in (
            table | {"q": cell}, table | {"q": value}, [*rows[:3], value, *rows[4:]],
            [*rows[:3], rows[3] | {"q": value}, *rows[4:]],
        ):  # fmt: skip
            assert ends_well(tmp_path, "json", json.dumps(odd).encode()) is None, value


# -- configurations

VALUES = (
    "0", "-1", "3", "true", '""', '"x"', "nan", "inf", "1e308", "1e-320", "1e16", "1" * 400,
    "0x" + "f" * 60, "9223372036854775808", "1e400", "[]", "[[]]", "[1, 2]", "[2, 1]", '["a"]',
    "[nan, 1]", "[1e308, -1e308]", "{}", "{a = 1}", "[{a = 1}]", "2020-01-01", "12:00:00", '"1 s"',
    '"1e999 s"', '"-5 s"', '"1e-320 s"', '"1e300 Hz"', '"9**9**9 s"', '"nan s"', '"m/s"', '"%"',
    '"off"', '"auto"', '"\\u0000"', '"\\u001b[31m"', '"\\n"', '"/"', '"/dev/null"', '"**"',
    '"***"', '"[!"', '"~"', '"😀"', "[" * 150 + "]" * 150, '"' + "a" * 5000 + '"', "100000000000",
    '{ distribution = "norm", loc = 1e308, scale = 1e308 }', '{ distribution = "rv_continuous" }',
    '{ distribution = "levy_stable", alpha = 1.5, beta = 0 }', '{ value = "x" }',
)  # fmt: skip
NAMES = ("x", '""', "preset", "__class__", '"\\u001b"', "a.b.c.d", "-", "é", "distribution")


@pytest.mark.parametrize("text", [good.config("run.csv"), good.LONG_CONFIG], ids=["short", "long"])
def test_values_and_names_of_a_configuration(tmp_path, text):
    """Every value at some keys, every key with some values, under odd names."""
    (tmp_path / "run.csv").write_bytes(good.content("csv"))
    lines = text.split("\n")
    places = [i for i, line in enumerate(lines) if " = " in line]
    for k in range(max(3 * len(VALUES) // 2, len(places))):
        at = places[k % len(places)]
        key, _, value = lines[at].partition(" = ")
        name = NAMES[k // 3 % len(NAMES)] if k % 3 == 0 else key
        odd = f"{name} = {value if k % 3 == 0 else VALUES[k % len(VALUES)]}"
        (tmp_path / "c.toml").write_text("\n".join([*lines[:at], odd, *lines[at + 1 :]]))
        assert broken_rule(tmp_path / "c.toml") is None, odd


# -- any text as configuration, any bytes as a recording


def _checked(text):
    try:
        found = parse_config(text, Path("c.toml"))
        with found.named():
            found.tables.mechanism.joint()
    except BadInput as error:
        message = str(error)
        assert message.isprintable()
        assert message.startswith("c.toml")
        assert "; " in message
        assert "Input should" not in message


@settings(max_examples=100, derandomize=True, database=None)
@given(st.text(st.characters(codec="utf-8"), max_size=200))
def test_any_text(text):
    _checked(text)


@settings(
    max_examples=40, derandomize=True, database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)  # fmt: skip
@given(data=st.binary(max_size=400), form=st.sampled_from(SUFFIXES))
def test_any_bytes(tmp_path, data, form):
    assert ends_well(tmp_path, form, data) is None
