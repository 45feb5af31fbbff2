"""Bad input and output, given to the real command: one line, exit code 2, nothing changed."""

import pytest

from bayesfric.inference.priors import DISTRIBUTIONS

from .bench import CONFIG, PRIOR, RECORDING, cases, has, lines

pytestmark = pytest.mark.usefixtures("nothing_explained")

FILE = 'file = "run.csv"'
CURRENT = 'current = {{column = 3, unit = "A", torque_constant = "{}"}}\n'
SQUARE = 'preset = "servo-pendulum"\nelements.gearbox = {load_loss = "none", load_square = true}'
VOLTAGE = '{column = 3, unit = "V", torque_constant = "1 N m/A", resistance = "3 N"}'


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    cases(
        ("missing file", '"run.csv"', '"ran.csv"', ["ran.csv"]),
        ("pattern", '"run.csv"', '"runs/*.csv"', ["recordings.1", "'runs/*.csv'"]),
        ("folder", '"run.csv"', '"."', ["is a folder"]),
        ("no table", '"run.csv"', '"c.toml"', ["line", "delimiter"]),
        ("unit of another kind", '"rad"', '"kg"', ["run.csv", "'q'", "'kg'"]),
        ("linear speed", "order = 4", 'dead_zone = "5 m/s"', ["dead_zone", "'5 m/s'"]),
        ("slides", "preset", 'motion = "linear"\npreset', ["'q'", "'rad'"]),
        ("table", "[[recordings]]", "[[recording]]", ["recording:", "'recordings'"]),
        ("key", "order = 4", "low_pass = 20", [".low_pass:", "'lowpass'"]),
        ("preset", "motor-axis", "motor-axes", ["mechanism.preset", "'motor-axis'"]),
        ("term", "preset", "elements.motor.inerta = true\npreset", ["inerta", "'inertia'"]),
        ("load square", 'preset = "motor-axis"', SQUARE, ["gearbox.load_square"]),
        ("true for an integer", "order = 4", "decimate = true", ["decimate", "true"]),
        ("too few outputs", "order = 4", "decimate = 900", ["recording 'run', decimate", "400"]),
        ("column 9", 'column = "q"', "column = 9", ["run.csv, column 9", "3"]),
        ("two drives", "torque =", f"{CURRENT.format('1 N m/A')}torque =", ["recordings.1"]),
        ("constant", "torque =", f"{CURRENT.format('3 rpm/V')}# torque =", ["torque_constant"]),
        ("resistance", "torque =", f"voltage = {VOLTAGE}\n# torque =", ["1.voltage.resistance"]),
        ("no radius", FILE, f'added_mass = "2 kg"\n{FILE}', ["1.added_mass", "radius"]),
        ("start after the end", FILE, f"start = 9\n{FILE}", ["run.csv", "start = 9 s"]),
        ("side of the gearbox", "motor-axis", "rabbit-knee", ["'q'", "50", "side"]),
        ("one name twice", RECORDING, RECORDING * 2, ["recordings", "'run'"]),
        ("no recording", RECORDING, "", ["[[recordings]]"]),
        ("no unit", ', unit = "rad"', "", ["recordings.1.position.unit"]),
        ("no torque", "torque =", "# torque =", ["recordings.1"]),
        ("no mechanism", '[mechanism]\npreset = "motor-axis"', "", ["mechanism"]),
        ("no TOML", '"motor-axis"', "motor-axis", ["line 2"]),
        # priors
        ("reversed range", PRIOR, '"motor.inertia" = [2, 1]', ["priors", "[2, 1]"]),
        ("all fixed", PRIOR, "motor = {inertia=1, viscous=1, coulomb=1}\noffset = 0", ["priors"]),
        ("no such parameter", PRIOR, '"motor.inerta" = 1', ["priors", "'motor.inertia'"]),
        ("no delay", PRIOR, '"drive.delay" = 0.004', ["priors.drive.delay"]),
        ("fixed noise", PRIOR, '"noise.sigma" = 0.1', ["priors", "noise.sigma"]),
    ),
)
def test_configuration(bench, old, new, parts):
    bench.edit(old, new)
    message = bench.refused()
    files = ("c.toml", "run.csv", "ran.csv:", ".:")
    assert message.startswith(tuple(f"bayesfric: {file}" for file in files))
    has(message, *parts)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    cases(
        ("family", '"normal", loc = 1', ["'normal'", *DISTRIBUTIONS]),
        ("not listed", '"rice", b = 1', ["'rice'", *DISTRIBUTIONS]),
        ("argument", '"norm", mean = 1', ["'mean'", "loc, scale"]),
        ("misspelt", '"norm", scal = 1', ["'scal'", "'scale'"]),
        ("no shape", '"gamma", scale = 1', ["'a'"]),
        ("true", '"norm", scale = true', [".scale", "true"]),
        ("no mass", '"norm", loc = -100, scale = 1', []),
    ),
)
def test_distribution(bench, arguments, parts):
    bench.edit(PRIOR, f'"motor.inertia" = {{ distribution = {arguments} }}')
    has(bench.refused("check", "c.toml", "--json"), "c.toml: priors.motor.inertia", *parts)


def test_bad_prior_in_a_separate_process(bench):
    bench.edit(PRIOR, '"motor.inertia" = { distribution = "norm", loc = 1e300, scale = 1e-300 }')
    message = bench.refused("fit", "c.toml", "--json", run=bench.run_apart)
    has(message, "priors.motor.inertia")


@pytest.mark.parametrize("n", [90, 120])
def test_recording_too_short_for_its_processing(bench, n):
    bench.recording(lines(n))
    has(bench.refused(), "c.toml", "'run'")


def test_byte_order_mark(bench):
    bench.config(encoding="utf-8-sig")
    assert bench.run("check", "c.toml").code == 0


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_configuration_in_another_encoding(bench, encoding):
    bench.config("# Gelenk für den Prüfstand\n" + CONFIG, encoding=encoding)
    has(bench.refused(), "c.toml", "UTF-8")


@pytest.mark.parametrize("name", ["d.toml", ".", "run.csv/c.toml", "/dev/null", "c" * 300])
def test_configuration_that_cannot_be_read(bench, name):
    has(bench.refused("fit", name), f"bayesfric: {name}: ")


# -- output


@pytest.fixture
def places(bench):
    """A folder with something of everything that is in the way."""
    (bench.folder / "plain").write_text("a file, not a folder")
    for name in ("full", "full.csv", "full.truth.json", "new.truth.json"):
        (bench.folder / name).mkdir()
    (bench.folder / "full" / "summary.json").write_text("{}")
    (bench.folder / "measured.csv").write_text("t,q,tau\n1,2,3\n")
    (bench.folder / "broken").symlink_to(bench.folder / "no" / "where")
    return bench


COMMANDS = {
    "fit": ["fit", "c.toml"],
    "init": ["init", "motor-axis", "--json"],
    "simulate": ["simulate", "c.toml"],
}
OUTPUTS = {
    "fit": ["plain", "full", ".", "broken", "plain/x", "/proc/x", "a" * 300],
    "init": ["c.toml", "full", "", "plain/x.toml"],
    "simulate": ["x", "x.txt", "full.csv", "new.csv", "measured.csv", "plain/x.csv"],
}


@pytest.mark.parametrize(
    ("command", "output"), [(name, place) for name, places in OUTPUTS.items() for place in places]
)
def test_output(places, command, output):
    name = "new.truth.json" if output == "new.csv" else output or "."
    has(places.refused(*COMMANDS[command], "-o", output), f"bayesfric: {name}: ")


@pytest.mark.parametrize("output", ["plain", "/"])
def test_force_does_not_replace_what_is_not_a_run(places, output):
    has(places.refused("fit", "c.toml", "-o", output, "--force"), f"bayesfric: {output}: ")


def test_missing_folders_are_created(bench):
    assert bench.run("init", "motor-axis", "-o", "new/a.toml").code == 0
    bench.config(CONFIG + "\n[simulation]\nduration = 0.2\n")
    assert bench.run("simulate", "c.toml", "-o", "new/deep/er/x.csv").code == 0
    names = {path.name for path in (bench.folder / "new").rglob("*")}
    assert names == {"a.toml", "deep", "er", "x.csv", "x.truth.json"}


@pytest.mark.parametrize(
    ("options", "parts"),
    cases(
        ("excitation", 'excitation = "squares"', ["excitation", "'squares'", "'square'"]),
        ("unit", 'duration = "10 s"', ["duration", "'10 s'"]),
        ("short", "duration = 0.001", ["simulation.duration"]),
        ("endless", "duration = 1e5\nrate = 1e6", ["simulation.duration"]),
        ("no chirp", 'excitation = "chirp"\nfrequencies = []', ["simulation.frequencies"]),
        ("overflow", "amplitude = 1e300", ["simulation"]),
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
    ("arguments", "part"),
    [
        (["check", "c.toml", "--jsn"], "--jsn"),
        (["check"], "CONFIG"),
        (["chek", "c.toml"], "chek"),
        (["check", "c.toml", "d.toml"], "d.toml"),
        (["simulate", "c.toml"], "--output"),
        (["demo", "--seed", "9" * 30], "--seed"),
    ],
)
def test_slip_on_the_command_line(bench, arguments, part):
    before = bench.held()
    ended = bench.run(*arguments)
    assert (ended.code, ended.out) == (2, "")
    has(ended.err, "Usage: bayesfric", part)
    assert bench.held() == before
