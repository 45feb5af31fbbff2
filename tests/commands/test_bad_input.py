"""Bad recordings and configurations, given to the real command: one line, exit code 2, no trace."""

import pytest

from .bench import CONFIG, PRIOR, RECORDING, cases, has, lines

pytestmark = pytest.mark.usefixtures("nothing_explained")


# -- recordings


@pytest.mark.parametrize(
    ("n", "parts"), [(90, ["'run'", "trim"]), (120, ["'run'", "too short", "4 parameters"])]
)
def test_recording_too_short_for_its_processing(bench, n, parts):
    bench.recording(lines(n))
    has(bench.refused(), "c.toml", *parts)


# -- configuration: edits of the good one

FILE = '"run.csv"'


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    cases(
        # which file
        ("file-missing", FILE, '"ran.csv"', ["ran.csv", "does not exist", "give a file"]),
        ("file-pattern", FILE, '"runs/*.csv"', ["c.toml: recordings.1", "'runs/*.csv'", "no file"]),
        ("file-folder", FILE, '"."', ["is a folder", "give a file"]),
        ("file-suffix", FILE, '"c.toml"', ["'.toml'", "set format to csv"]),
        ("file-number", FILE, "3", ["c.toml: recordings.1.file: got 3"]),
        ("file-long", FILE, f'"{"a" * 300}.csv"', ["c.toml: recordings.1.file", "too long"]),
        # units
        ("mass-for-angle", '"rad"', '"kg"', ["run.csv", "'q'", "an angle like", "'kg'"]),
        ("no-such-unit", '"rad"', '"radd"', ["run.csv", "'q'", "'radd' is not a known unit"]),
        ("speed", "order = 4", 'dead_zone = "5 m/s"', ["c.toml: processing, dead_zone", "'5 m/s'"]),
        # unknown keys
        ("recording", "[[recordings]]", "[[recording]]", ["recording: unknown", "'recordings'?"]),
        ("low_pass", "order = 4", "low_pass = 20", [".low_pass: unknown key", "'lowpass'?"]),
        ("colum", 'column = "q"', 'colum = "q"', ["recordings.1.position.colum: ", "'column'?"]),
        ("preset", "motor-axis", "motor-axes", ["c.toml: mechanism.preset", "'motor-axis'?"]),
        ("no-preset", "motor-axis", "arm", ["mechanism.preset", "use one of rabbit-knee, motor"]),
        ("term", "preset", "elements.motor.inerta = true\npreset", ["r.inerta", "'inertia'?"]),
        ("no-delay", PRIOR, '"drive.delay" = 0.004', ["priors.drive.delay", "no such parameter"]),
        # wrong types and ranges, worded plainly
        ("true", "order = 4", "decimate = true", ["decimate: got true"]),
        ("windows", "order = 4", "decimate = 900", ["c.toml: recording 'run', decimate", "400"]),
        ("nyquist", "order = 4", "lowpass = 500", ["c.toml: recording 'run', lowpass", "50 Hz"]),
        ("seed", "seed = 1", "seed = -1", ["sampling.seed: got -1"]),
        ("nan", "seed = 1", "max_rhat = nan", ["max_rhat: got nan"]),
        ("noise", '"shared"', '"share"', ["noise.scale: got 'share'; did you mean 'shared'?"]),
        ("sign", '"rad"', '"rad", sign = 2', [".sign: got 2"]),
        ("gear", "preset", "elements.motor.ratio = -50\npreset", ["ratio: got -50"]),
        ("column-0", 'column = "q"', "column = 0", [".column: columns are numbered from 1, got 0"]),
        ("column-9", 'column = "q"', "column = 9", ["run.csv, column 9", "from 1 to 3"]),
        ("two-times", "time =", 'rate = "1 kHz"\ntime =', ["recordings.1", "one of 'time'"]),
        (
            "two-drives",
            "torque =",
            'current = {column = 3, unit = "A", torque_constant = "1 N m/A"}\ntorque =',
            ["recordings.1: got 'torque' and 'current'"],
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
        ("mass", "file =", 'added_mass = "2 m"\nradius = 1\nfile =', ["added_mass: got '2 m'"]),
        ("marks", "file =", 'delimiter = ","\ndecimal = ","\nfile =', ["recordings.1", "both"]),
        ("mark", "file =", 'delimiter = "::"\nfile =', ["recordings.1.delimiter"]),
        ("held", '"N m"', '"N m", held = "sometimes"', ["torque.held"]),
        ("span", "file =", "exclude = [[1]]\nfile =", [".exclude.1: got [1]"]),
        ("back", "file =", "exclude = [[2, 1]]\nfile =", [".exclude: a span must end after"]),
        ("stop", "file =", "start = 3\nstop = 1\nfile =", ["c.toml: recordings.1: 'stop' (1 s)"]),
        ("start", "file =", "start = 9\nfile =", ["run.csv: ends 3.99 s", "start = 9 s"]),
        # what does not go together
        ("side", "motor-axis", "rabbit-knee", ["'q'", "gear ratio is 50", 'side = "motor"']),
        ("radius", "file =", 'added_mass = "2 kg"\nfile =', ["1.added_mass: has no radius"]),
        ("doubled", RECORDING, RECORDING * 2, ["c.toml: recordings: 2 are called 'run'; give ea"]),
        ("no-recording", RECORDING, "", ["c.toml: names no recording; add a [[recordings]]"]),
        ("no-unit", ', unit = "rad"', "", ["recordings.1.position.unit: is missing; add 'unit'"]),
        ("no-torque", "torque =", "# torque =", ["recordings.1: got none"]),
        ("no-time", "time =", "# time =", ["c.toml: recordings.1:", "give exactly one of 'time'"]),
        ("no-mechanism", '[mechanism]\npreset = "motor-axis"', "", ["mechanism: is missing; add"]),
        ("nothing", 'preset = "motor-axis"', "", ["c.toml: mechanism: describes no joint; set"]),
        ("slides", "preset", 'motion = "linear"\npreset', ["'q'", "a length like", "'rad'"]),
        # no TOML
        ("bare", '"motor-axis"', "motor-axis", ["c.toml: is no TOML", "line 2"]),
    ),
)
def test_configuration(bench, old, new, parts):
    bench.edit(old, new)
    has(bench.refused(), *parts)


def test_mark_in_front_of_a_configuration_does_no_harm(bench):
    bench.config(encoding="utf-8-sig")
    assert bench.run("check", "c.toml").code == 0


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_configuration_in_another_encoding(bench, encoding):
    bench.config("# Gelenk für den Prüfstand\n" + CONFIG, encoding=encoding)
    has(bench.refused(), "c.toml: is not UTF-8", "save it as UTF-8")


@pytest.mark.parametrize(
    ("name", "parts"),
    cases(
        ("missing", "d.toml", ["d.toml: does not exist"]),
        ("folder", ".", ["is a folder; name the .toml file"]),
        ("below-a-file", "run.csv/c.toml", ["run.csv/c.toml: cannot be read (Not a directory)"]),
        ("endless", "/dev/zero", ["is no ordinary file"]),
        ("long", "c" * 300, ["cannot be read (File name too long)"]),
    ),
)
@pytest.mark.parametrize("command", ["check", "fit"])
def test_configuration_that_cannot_be_read(bench, command, name, parts):
    has(bench.refused(command, name), *parts)


# -- priors


@pytest.mark.parametrize(
    ("prior", "parts"),
    cases(
        ("reversed", '"motor.inertia" = [2, 1]', ["[2, 1] is no range"]),
        ("outside", '"motor.inertia" = [-1, 1]', ["[-1, 1] reaches outside", "0 or more"]),
        ("true", '"motor.inertia" = true', ["true/false is no prior"]),
        ("nan", '"motor.inertia" = nan', ["nan is no possible value"]),
        ("to-inf", '"motor.inertia" = [0, inf]', ["[0, inf] is no range"]),
        ("three", '"motor.inertia" = [1, 2, 3]', ["[1, 2, 3] is no prior"]),
        ("all-fixed", "motor = {inertia=1, viscous=1, coulomb=1}\noffset = 0", ["leave at le"]),
        ("unknown", '"motor.inerta" = 1', ["no such parameter; did you mean 'motor.inertia'?"]),
        ("noise-fixed", '"noise.sigma" = 0.1', ["noise.sigma: cannot be fixed"]),
        ("no-family", '"motor.inertia" = {dist = "norm"}', ["inertia: its table names no distr"]),
    ),
)
def test_prior(bench, prior, parts):
    bench.edit(PRIOR, prior)
    has(bench.refused("fit", "c.toml", "--json"), "c.toml: priors", *parts)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    cases(
        ("family", '"normal", loc = 1', ["'normal' is no continuous distribution of scipy.stats"]),
        ("number", "3", ["3 is no continuous distribution of scipy.stats"]),
        ("argument", '"norm", mean = 1', ["norm takes no 'mean'; use one of loc, scale"]),
        ("misspelt", '"norm", scal = 1', ["norm takes no 'scal'; did you mean 'scale'?"]),
        ("shape", '"gamma", scale = 1', ["gamma needs 'a'; add a = ..."]),
        ("true", '"norm", scale = true', [".scale: got true"]),
        ("no-mass", '"norm", loc = -100, scale = 1', ["lies outside", "0 or more"]),
    ),
)
def test_distribution(bench, arguments, parts):
    bench.edit(PRIOR, f'"motor.inertia" = {{ distribution = {arguments} }}')
    has(bench.refused("check", "c.toml", "--json"), "c.toml: priors.motor.inertia", *parts)


# -- the same in a process of its own


def test_bad_prior_in_a_process_of_its_own(bench):
    bench.edit(PRIOR, '"motor.inertia" = { distribution = "norm", loc = 1e300, scale = 1e-300 }')
    has(bench.refused("fit", "c.toml", run=bench.run_apart), "priors.motor.inertia")
