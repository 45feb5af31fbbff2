"""Bad recordings and configurations, given to the real command: one line, exit code 2, no trace."""

import pytest

from bayesfric.inference.priors import DISTRIBUTIONS

from .bench import CONFIG, PRIOR, RECORDING, cases, has, lines

pytestmark = pytest.mark.usefixtures("nothing_explained")


# -- recordings


@pytest.mark.parametrize(("n", "parts"), [(90, ["'run'", "trim"]), (120, ["'run'"])])
def test_recording_too_short_for_its_processing(bench, n, parts):
    bench.recording(lines(n))
    has(bench.refused(), "c.toml", *parts)


# -- configuration: edits of the good one

FILE = '"run.csv"'


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    cases(
        # which file
        ("file-missing", FILE, '"ran.csv"', ["ran.csv"]),
        ("file-pattern", FILE, '"runs/*.csv"', ["recordings.1", "'runs/*.csv'"]),
        ("file-folder", FILE, '"."', ["is a folder"]),
        ("file-suffix", FILE, '"c.toml"', ["'.toml'"]),
        # units
        ("mass-for-angle", '"rad"', '"kg"', ["run.csv", "'q'", "'kg'"]),
        ("no-such-unit", '"rad"', '"radd"', ["run.csv", "'q'", "'radd'"]),
        ("speed", "order = 4", 'dead_zone = "5 m/s"', ["dead_zone", "'5 m/s'"]),
        # unknown keys
        ("recording", "[[recordings]]", "[[recording]]", ["recording:", "'recordings'"]),
        ("low_pass", "order = 4", "low_pass = 20", [".low_pass:", "'lowpass'"]),
        ("colum", 'column = "q"', 'colum = "q"', ["recordings.1.position.colum:", "'column'"]),
        ("preset", "motor-axis", "motor-axes", ["mechanism.preset", "'motor-axis'"]),
        ("no-preset", "motor-axis", "arm", ["mechanism.preset", "rabbit-knee"]),
        ("term", "preset", "elements.motor.inerta = true\npreset", ["inerta", "'inertia'"]),
        ("no-delay", PRIOR, '"drive.delay" = 0.004', ["priors.drive.delay"]),
        # wrong types and ranges
        ("true", "order = 4", "decimate = true", ["decimate", "true"]),
        ("windows", "order = 4", "decimate = 900", ["recording 'run', decimate", "400"]),
        ("nyquist", "order = 4", "lowpass = 500", ["recording 'run', lowpass", "50 Hz"]),
        ("column-0", 'column = "q"', "column = 0", [".column"]),
        ("column-9", 'column = "q"', "column = 9", ["run.csv, column 9", "3"]),
        (
            "two-drives",
            "torque =",
            'current = {column = 3, unit = "A", torque_constant = "1 N m/A"}\ntorque =',
            ["recordings.1", "'torque'", "'current'"],
        ),
        (
            "constant",
            "torque =",
            'current = {column = 3, unit = "A", torque_constant = "3 rpm/V"}\n# torque =',
            ["recordings.1.current.torque_constant", "3 rpm/V"],
        ),
        (
            "resistance",
            "torque =",
            'voltage = {column = 3, unit = "V", torque_constant = '
            '"1 N m/A", resistance = "3 N"}\n# torque =',
            ["1.voltage.resistance", "'3 N'"],
        ),
        ("mass", "file =", 'added_mass = "2 m"\nradius = 1\nfile =', ["added_mass", "'2 m'"]),
        ("marks", "file =", 'delimiter = ","\ndecimal = ","\nfile =', ["recordings.1"]),
        ("held", '"N m"', '"N m", held = "sometimes"', ["torque.held"]),
        ("back", "file =", "exclude = [[2, 1]]\nfile =", [".exclude"]),
        ("start", "file =", "start = 9\nfile =", ["run.csv", "start = 9 s"]),
        # what does not go together
        ("side", "motor-axis", "rabbit-knee", ["'q'", "50", "side"]),
        ("radius", "file =", 'added_mass = "2 kg"\nfile =', ["1.added_mass", "radius"]),
        ("doubled", RECORDING, RECORDING * 2, ["recordings", "'run'"]),
        ("no-recording", RECORDING, "", ["[[recordings]]"]),
        ("no-unit", ', unit = "rad"', "", ["recordings.1.position.unit"]),
        ("no-torque", "torque =", "# torque =", ["recordings.1"]),
        ("no-mechanism", '[mechanism]\npreset = "motor-axis"', "", ["mechanism"]),
        ("nothing", 'preset = "motor-axis"', "", ["mechanism"]),
        ("slides", "preset", 'motion = "linear"\npreset', ["'q'", "'rad'"]),
        # no TOML
        ("bare", '"motor-axis"', "motor-axis", ["line 2"]),
    ),
)
def test_configuration(bench, old, new, parts):
    bench.edit(old, new)
    message = bench.refused()
    files = ("c.toml:", "run.csv", "ran.csv:", ".:")
    assert message.startswith(tuple(f"bayesfric: {file}" for file in files))
    has(message, *parts)


def test_mark_in_front_of_a_configuration_does_no_harm(bench):
    bench.config(encoding="utf-8-sig")
    assert bench.run("check", "c.toml").code == 0


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_configuration_in_another_encoding(bench, encoding):
    bench.config("# Gelenk für den Prüfstand\n" + CONFIG, encoding=encoding)
    has(bench.refused(), "c.toml", "UTF-8")


@pytest.mark.parametrize(
    ("name", "parts"),
    cases(
        ("missing", "d.toml", ["d.toml"]),
        ("folder", ".", ["is a folder"]),
        ("below-a-file", "run.csv/c.toml", ["run.csv/c.toml"]),
        ("device", "/dev/null", ["/dev/null"]),
        ("long", "c" * 300, ["c" * 300]),
    ),
)
@pytest.mark.parametrize("command", ["check", "fit"])
def test_configuration_that_cannot_be_read(bench, command, name, parts):
    has(bench.refused(command, name), *parts)


# -- priors


@pytest.mark.parametrize(
    ("prior", "parts"),
    cases(
        ("reversed", '"motor.inertia" = [2, 1]', ["motor.inertia", "[2, 1]"]),
        ("outside", '"motor.inertia" = [-1, 1]', ["motor.inertia", "[-1, 1]"]),
        ("true", '"motor.inertia" = true', ["motor.inertia"]),
        ("nan", '"motor.inertia" = nan', ["motor.inertia", "nan"]),
        ("all-fixed", "motor = {inertia=1, viscous=1, coulomb=1}\noffset = 0", []),
        ("unknown", '"motor.inerta" = 1', ["motor.inerta", "'motor.inertia'"]),
        ("noise-fixed", '"noise.sigma" = 0.1', ["noise.sigma"]),
        ("no-family", '"motor.inertia" = {dist = "norm"}', ["motor.inertia"]),
    ),
)
def test_prior(bench, prior, parts):
    bench.edit(PRIOR, prior)
    has(bench.refused("fit", "c.toml", "--json"), "c.toml: priors", *parts)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    cases(
        ("family", '"normal", loc = 1', ["'normal'", *DISTRIBUTIONS]),
        ("not-listed", '"rice", b = 1', ["'rice'", *DISTRIBUTIONS]),
        ("number", "3", ["3", *DISTRIBUTIONS]),
        ("argument", '"norm", mean = 1', ["'mean'", "loc, scale"]),
        ("misspelt", '"norm", scal = 1', ["'scal'", "'scale'"]),
        ("shape", '"gamma", scale = 1', ["'a'"]),
        ("true", '"norm", scale = true', [".scale", "true"]),
        ("no-mass", '"norm", loc = -100, scale = 1', []),
    ),
)
def test_distribution(bench, arguments, parts):
    bench.edit(PRIOR, f'"motor.inertia" = {{ distribution = {arguments} }}')
    has(bench.refused("check", "c.toml", "--json"), "c.toml: priors.motor.inertia", *parts)


# -- the same in a process of its own


def test_bad_prior_in_a_process_of_its_own(bench):
    bench.edit(PRIOR, '"motor.inertia" = { distribution = "norm", loc = 1e300, scale = 1e-300 }')
    has(bench.refused("fit", "c.toml", run=bench.run_apart), "priors.motor.inertia")
