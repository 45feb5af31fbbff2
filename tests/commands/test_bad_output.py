"""Places that cannot be written to, impossible simulations, and slips on the command line."""

import pytest

from bayesfric.report.run_directory import made_beside

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


RUNS = (
    ("plain", ["plain: is a file; name a folder with -o"]),
    ("full", ["full: is not empty; name another folder", "--force"]),
    (".", [".: is not empty"]),
    ("broken", ["broken: is a link to nowhere"]),
)
FILES = (
    ("init", "c.toml", ["c.toml: exists already; name another file"]),
    ("init", "full", ["full: is a folder; name a file"]),
    ("init", "", ["is a folder"]),
    ("simulate", "x", ["x: is not named .csv"]),
    ("simulate", "x.txt", ["x.txt: is not named .csv"]),
    ("simulate", "full.csv", ["is a folder; name a file"]),
    ("simulate", "new.csv", ["new.truth.json: is a folder"]),
    ("simulate", "measured.csv", ["measured.csv: exists already", "may be a measurement"]),
)
COMMANDS = {
    "fit": (["fit", "c.toml"], ""),
    "demo": (["demo"], ""),
    "init": (["init", "motor-axis", "--json"], ".toml"),
    "simulate": (["simulate", "c.toml"], ".csv"),
}


@pytest.mark.parametrize(
    ("command", "output", "parts"),
    [
        *((command, *row) for command in ("fit", "demo") for row in RUNS),
        *FILES,
        *((command, f"{place}{end}", said) for command, (_, end) in COMMANDS.items()
          for place, said in (
              ("plain/x", ["plain/x", "cannot be written (Not a directory)"]),
              ("/proc/x", ["/proc/x", "cannot be written"]),
              ("a" * 300, ["too long"]))),
    ],
)  # fmt: skip
def test_output(places, command, output, parts):
    has(places.refused(*COMMANDS[command][0], "-o", output), *parts)


def test_force_does_not_replace_a_file(places):
    has(places.refused("fit", "c.toml", "-o", "plain", "--force"), "plain: is a file")
    has(places.refused("fit", "c.toml", "-o", "/", "--force"), "the whole disk")


def test_folders_that_are_missing_are_made(bench):
    assert bench.run("init", "motor-axis", "-o", "new/a.toml").code == 0
    bench.config(CONFIG + "\n[simulation]\nduration = 0.2\n")
    assert bench.run("simulate", "c.toml", "-o", "new/deep/er/x.csv").code == 0
    made = {path.name for path in (bench.folder / "new").rglob("*")}
    assert made == {"a.toml", "deep", "er", "x.csv", "x.truth.json"}


@pytest.mark.parametrize("command", [("fit",), ("identify", "--advise", "offset")])
def test_folders_that_are_missing_are_not_left_behind(bench, command):
    (bench.folder / "run.csv").unlink()
    name = {"fit": "run", "identify": "x.csv"}[command[0]]
    # ``refused`` looks for what was left
    has(bench.refused(command[0], "c.toml", *command[1:], "-o", f"new/deep/{name}"), "run.csv")


def test_a_run_that_fails_leaves_no_folder_made_for_it(tmp_path):
    target = tmp_path / "new" / "deep" / "run"
    with pytest.raises(ZeroDivisionError), made_beside(target):
        assert 1 / 0
    assert list(tmp_path.iterdir()) == []
    with made_beside(target) as beside:
        (beside / "a").write_text("a")
    assert (target / "a").is_file()


@pytest.mark.parametrize(
    ("options", "parts"),
    cases(
        ("excitation", 'excitation = "squares"', ["got 'squares'; did you mean 'square'?"]),
        ("unit", 'duration = "10 s"', ["duration: got '10 s'"]),
        ("short", "duration = 0.001", ["simulation.duration: makes fewer than 10 samples"]),
        ("endless", "duration = 1e5\nrate = 1e6", ["simulation.duration: makes 1e+11 samples"]),
        ("no-chirp", 'excitation = "chirp"\nfrequencies = []', ["frequencies: is empty"]),
        ("runaway", "amplitude = 1e300", ["c.toml: simulation: the joint runs away"]),
        ("mass", "added_mass = 1", ["simulation.added_mass: has no radius"]),
        ("name", 'parameters = {"moter.inertia" = 1}', ["no such parameter", "'motor.inertia'?"]),
        ("value", 'parameters = {"motor.inertia" = -1}', ["-1 is no possible value"]),
        ("weightless", 'parameters = {"motor.inertia" = 0}', ["c.toml: simulation", "no inertia"]),
    ),
)
def test_simulation(bench, options, parts):
    bench.config(f"{CONFIG}\n[simulation]\n{options}\n")
    has(bench.refused("simulate", "c.toml", "-o", "x.csv", "--json"), *parts)


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
