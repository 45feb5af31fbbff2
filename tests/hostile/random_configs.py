"""Configurations nobody would write: damaged text, wrong types, misspelt and misplaced keys."""

import tomllib
from functools import cache

from tests.hostile import good
from tests.hostile.mutation import mutated

ODD_VALUES = (
    "0", "-1", "1", "3", "true", "false", '""', '"x"', "nan", "inf", "-inf", "1e308", "-1e308",
    "1e-320", "1e-300", "1e16", "1" * 400, "0x" + "f" * 60, "9223372036854775808",
    "-9223372036854775809", "1e400", "[]", "[[]]", "[1]", "[1, 2]", "[2, 1]", '["a"]', "[nan, 1]",
    "[1e308, -1e308]", "{}", "{a = 1}", "[{}]", "[{a = 1}]", "2020-01-01", "12:00:00",
    "2020-01-01T00:00:00Z", '"1 s"', '"1e999 s"', '"-5 s"', '"0 s"', '"1e-320 s"', '"1e300 Hz"',
    '"1e-300 Hz"', '"9**9**9 s"', '"nan s"', '"m/s"', '"%"', '"off"', '"auto"', '"\\u0000"',
    '"\\u001b[31m"', '"\\n"', '"\\u2028"', '"..\\\\.."', '"/"', '"/dev/null"', '"."', '"**"',
    '"***"', '"**x"', '"[!"', '"~"', '"é"', '"😀"', "[" * 150 + "]" * 150, '"' + "a" * 5000 + '"',
    '{ distribution = "norm", loc = 1e308, scale = 1e308 }', '{ distribution = "rv_continuous" }',
    '{ distribution = "levy_stable", alpha = 1.5, beta = 0 }', '{ value = "x" }', "0.5", "1000000",
    "100000000000", '"1"', '"-"', '"1 N m"', '"rad"', '"s"', '"N m/A"',
)  # fmt: skip
ODD_KEYS = (
    "x", '""', "preset", "recordings", "file", "columns", "__class__", "model_config", '"a.b"',
    "given", '"\\u001b"', "a.b.c.d", "1", "-", "lowpas", "sampling.seed", "é", '"é"', "priors",
    "distribution",
)  # fmt: skip


@cache
def _lines():
    """Good configurations, line by line, with the places of their keys."""
    found = []
    for text in (good.config("run.csv"), good.LONG_CONFIG):
        tomllib.loads(text)
        lines = text.split("\n")
        found.append((lines, [i for i, line in enumerate(lines) if " = " in line]))
    return found


def _pick(rng, values):
    return values[int(rng.integers(len(values)))]


def _misspelt(word, rng):
    if not word:
        return "x"
    at = int(rng.integers(len(word)))
    match int(rng.integers(4)):
        case 0:
            return word[:at] + word[at + 1 :]
        case 1:
            return word[:at] + word[at] + word[at:]
        case 2:
            return word[:at] + chr(int(rng.integers(97, 123))) + word[at + 1 :]
    return word + "s"


def edited(rng):
    """A good configuration with some values, keys or lines exchanged."""
    lines, places = _pick(rng, _lines())
    lines = list(lines)
    for _ in range(int(rng.integers(1, 4))):
        at = _pick(rng, places)
        key, equals, value = lines[at].partition(" = ")
        match int(rng.integers(9)):
            case 0 | 1 | 2:
                lines[at] = f"{key} = {_pick(rng, ODD_VALUES)}"
            case 3:
                lines[at] = f"{_misspelt(key, rng)}{equals}{value}"
            case 4:
                lines[at] = f"{_pick(rng, ODD_KEYS)}{equals}{value}"
            case 5:
                lines[at] += f"\n{_pick(rng, ODD_KEYS)} = {_pick(rng, ODD_VALUES)}"
            case 6:
                # inside a table on one line
                parts = value.split(", ")
                inner = int(rng.integers(len(parts)))
                name, mark, _ = parts[inner].partition(" = ")
                if mark:
                    end = " }" if parts[inner].endswith("}") else ""
                    parts[inner] = f"{name} = {_pick(rng, ODD_VALUES)}{end}"
                lines[at] = f"{key} = {', '.join(parts)}"
            case 7:
                other = _pick(rng, places)
                lines[at], lines[other] = lines[other], lines[at]
            case 8:
                lines[at] = ""
    return "\n".join(lines).encode()


def damaged(rng):
    """A good configuration with some bytes changed."""
    lines, _ = _pick(rng, _lines())
    return mutated("\n".join(lines).encode(), rng)
