"""Places that cannot be written to, impossible simulations, and slips on the command line."""

import pytest

from .bench import CONFIG, below_a_file, cases, has


@pytest.fixture
def places(bench):
    """A folder with something of everything that is in the way."""
    below_a_file(bench.folder)
    for name in ("full", "full.csv", "full.truth.json", "new.truth.json"):
        (bench.folder / name).mkdir()
    (bench.folder / "full" / "summary.json").write_text("{}")
    (bench.folder / "measured.csv").write_text("t,q,tau\n1,2,3\n")
    (bench.folder / "broken").symlink_to(bench.folder / "no" / "where")
    return bench


RUNS = ("plain", "full", ".", "broken")
FILES = (
    ("init", "c.toml"),
    ("init", "full"),
    ("init", ""),
    ("simulate", "x"),
    ("simulate", "x.txt"),
    ("simulate", "full.csv"),
    ("simulate", "new.csv"),
    ("simulate", "measured.csv"),
)
COMMANDS = {
    "fit": (["fit", "c.toml"], ""),
    "demo": (["demo"], ""),
    "init": (["init", "motor-axis", "--json"], ".toml"),
    "simulate": (["simulate", "c.toml"], ".csv"),
}


@pytest.mark.parametrize(
    ("command", "output"),
    [
        *((command, place) for command in ("fit", "demo") for place in RUNS),
        *FILES,
        *((command, f"{place}{end}") for command, (_, end) in COMMANDS.items()
          for place in ("plain/x", "/proc/x", "a" * 300)),
    ],
)  # fmt: skip
def test_output(places, command, output):
    name = "new.truth.json" if output == "new.csv" else output or "."
    has(places.refused(*COMMANDS[command][0], "-o", output), f"bayesfric: {name}: ")


@pytest.mark.parametrize("output", ["plain", "/"])
def test_force_does_not_replace_what_is_not_a_run(places, output):
    has(places.refused("fit", "c.toml", "-o", output, "--force"), f"bayesfric: {output}: ")


def test_folders_that_are_missing_are_made(bench):
    assert bench.run("init", "motor-axis", "-o", "new/a.toml").code == 0
    bench.config(CONFIG + "\n[simulation]\nduration = 0.2\n")
    assert bench.run("simulate", "c.toml", "-o", "new/deep/er/x.csv").code == 0
    made = {path.name for path in (bench.folder / "new").rglob("*")}
    assert made == {"a.toml", "deep", "er", "x.csv", "x.truth.json"}


@pytest.mark.parametrize(
    ("options", "parts"),
    cases(
        ("excitation", 'excitation = "squares"', ["excitation", "'squares'", "'square'"]),
        ("unit", 'duration = "10 s"', ["duration", "'10 s'"]),
        ("short", "duration = 0.001", ["simulation.duration"]),
        ("endless", "duration = 1e5\nrate = 1e6", ["simulation.duration"]),
        ("no-chirp", 'excitation = "chirp"\nfrequencies = []', ["simulation.frequencies"]),
        ("runaway", "amplitude = 1e300", ["simulation"]),
        ("mass", "added_mass = 1", ["simulation.added_mass", "radius"]),
        ("name", 'parameters = {"moter.inertia" = 1}', ["moter.inertia", "'motor.inertia'"]),
        ("value", 'parameters = {"motor.inertia" = -1}', ["motor.inertia", "-1"]),
        ("weightless", 'parameters = {"motor.inertia" = 0}', ["simulation", "inertia"]),
    ),
)
def test_simulation(bench, options, parts):
    bench.config(f"{CONFIG}\n[simulation]\n{options}\n")
    has(bench.refused("simulate", "c.toml", "-o", "x.csv", "--json"), "c.toml", *parts)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    cases(
        ("option", ("check", "c.toml", "--jsn"), ["--jsn"]),
        ("argument", ("check",), ["CONFIG"]),
        ("command", ("chek", "c.toml"), ["chek"]),
        ("too-many", ("check", "c.toml", "d.toml"), ["d.toml"]),
        ("no-output", ("simulate", "c.toml"), ["--output"]),
        ("seed", ("fit", "c.toml", "--seed", "-1"), ["--seed"]),
        ("seed-large", ("demo", "--seed", "9" * 30), ["--seed"]),
    ),
)
def test_slip_on_the_command_line(bench, arguments, parts):
    before = bench.held()
    done = bench.run(*arguments)
    assert (done.code, done.out) == (2, "")
    has(done.err, "Usage: bayesfric", *parts)
    assert "Traceback" not in done.err
    assert bench.held() == before
