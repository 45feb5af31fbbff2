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


# -- which file


@pytest.mark.parametrize(
    ("file", "parts"),
    cases(
        ("missing", '"ran.csv"', ["ran.csv", "does not exist", "give a file"]),
        ("pattern", '"runs/*.csv"', ["c.toml: recordings.1", "'runs/*.csv'", "no file"]),
        ("folder", '"."', ["is a folder", "give a file"]),
        ("suffix", '"c.toml"', ["'.toml'", "set format to csv"]),
        ("none", "[]", ["c.toml: recordings.1.file", "names no file"]),
        ("number", "3", ["c.toml: recordings.1.file: got 3"]),
        ("list-of-number", '["run.csv", 3]', ["recordings.1.file.2: got 3"]),
        ("long", f'"{"a" * 300}.csv"', ["c.toml: recordings.1.file", "too long"]),
        ("nul", r'"a\u0000.csv"', ["c.toml", "NUL"]),
    ),
)
def test_file(bench, file, parts):
    bench.edit('"run.csv"', file)
    has(bench.refused(), *parts)


# -- configuration: edits of the good one


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    cases(
        # units
        ("mass-for-angle", '"rad"', '"kg"', ["run.csv", "'q'", "an angle like", "'kg'"]),
        ("no-such-unit", '"rad"', '"radd"', ["run.csv", "'q'", "'radd' is not a known unit"]),
        ("force", '"N m"', '"N"', ["run.csv", "'tau'", "a torque like", "'N'"]),
        ("time", "[processing]", '[processing]\ntrim = "5 m"', [".trim: got '5 m'"]),
        ("lowpass", "[processing]", '[processing]\nlowpass = "20"', [".lowpass: got '20'"]),
        ("speed", "order = 4", 'dead_zone = "5 m/s"', ["c.toml: processing, dead_zone", "'5 m/s'"]),
        # unknown keys
        ("recording", "[[recordings]]", "[[recording]]", ["recording: unknown", "'recordings'?"]),
        ("low_pass", "order = 4", "low_pass = 20", [".low_pass: unknown key", "'lowpass'?"]),
        ("walker", "seed = 1", "walker = 20", ["sampling.walker: unknown key", "'walkers'?"]),
        ("presett", "preset =", "presett =", ["mechanism.presett: unknown key", "'preset'?"]),
        ("scales", "scale =", "scales =", ["noise.scales: unknown key", "'scale'?"]),
        ("colum", 'column = "q"', 'colum = "q"', ["recordings.1.position.colum: ", "'column'?"]),
        ("delimeter", "file =", 'delimeter = ";"\nfile =', [".delimeter: unknown", "'delimiter'?"]),
        ("preset", "motor-axis", "motor-axes", ["c.toml: mechanism.preset", "'motor-axis'?"]),
        ("no-preset", "motor-axis", "arm", ["mechanism.preset", "use one of rabbit-knee, motor"]),
        ("element", "preset", "elements.moter.inertia = true\npreset", [".moter", "'motor'?"]),
        ("term", "preset", "elements.motor.inerta = true\npreset", ["r.inerta", "'inertia'?"]),
        ("delay", "preset", 'delay = "2 ms"\npreset', ["mechanism.delay"]),
        ("no-delay", PRIOR, '"drive.delay" = 0.004', ["priors.drive.delay", "no such parameter"]),
        ("load", "preset", "load.first_momnt = true\npreset", ["momnt", "'first_moment'?"]),
        # wrong types and ranges, worded plainly
        ("ten", "order = 4", 'decimate = "ten"', ["decimate: got 'ten'"]),
        ("half", "order = 4", "decimate = 2.5", ["decimate: got 2.5"]),
        ("true", "order = 4", "decimate = true", ["decimate: got true"]),
        ("zero", "order = 4", "decimate = 0", ["decimate: got 0"]),
        ("windows", "order = 4", "decimate = 900", ["c.toml: recording 'run', decimate", "400"]),
        ("nyquist", "order = 4", "lowpass = 500", ["c.toml: recording 'run', lowpass", "50 Hz"]),
        ("list", "order = 4", "dead_zone = [1]", [".dead_zone: got [1]"]),
        ("seed", "seed = 1", "seed = -1", ["sampling.seed: got -1"]),
        ("walkers", "seed = 1", "walkers = 3", ["walkers: got 3"]),
        ("ensembles", "seed = 1", "ensembles = 1", ["ensembles: got 1"]),
        ("nan", "seed = 1", "max_rhat = nan", ["max_rhat: got nan"]),
        ("date", "seed = 1", "seed = 2020-01-01", ["seed: got '2020-01-01'"]),
        ("noise", '"shared"', '"share"', ["noise.scale: got 'share'; did you mean 'shared'?"]),
        ("hyphen", '"shared"', '"per-recoding"', ["did you mean 'per-recording'?"]),
        ("sign", '"rad"', '"rad", sign = 2', [".sign: got 2"]),
        ("bool", "preset", 'offset = "no"\npreset', ["offset: got 'no'"]),
        ("gear", "preset", "elements.motor.ratio = -50\npreset", ["ratio: got -50"]),
        ("column-0", 'column = "q"', "column = 0", [".column: columns are numbered from 1, got 0"]),
        ("column-9", 'column = "q"', "column = 9", ["run.csv, column 9", "from 1 to 3"]),
        ("no-number", "order = 4", "lowpass = nan", ["c.toml: processing.lowpass"]),
        ("negative", "order = 4", 'lowpass = "-3 Hz"', ["processing.lowpass"]),
        ("narrow", "order = 4", "band = 0", ["processing.band: got 0"]),
        ("order", "order = 4", "order = 0", ["processing.order: got 0"]),
        ("slow", "order = 4", "dead_zone = -1.0", ["processing.dead_zone"]),
        ("unnamed", '"run.csv"', '""', ["recordings.1.file", "names no file"]),
        ("two-times", "time =", 'rate = "1 kHz"\ntime =', ["recordings.1", "one of 'time'"]),
        ("rate", 'time = { column = "t", unit = "s" }', 'rate = "5 ms"', ["1.rate", "'5 ms'"]),
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
        ("less-mass", "file =", "added_mass = -1\nradius = 1\nfile =", ["added_mass: got -1"]),
        ("skip", "file =", "skip_rows = -1\nfile =", ["recordings.1.skip_rows: got -1"]),
        ("format", "file =", 'format = "xls"\nfile =', ["recordings.1.format: got 'xls'"]),
        ("marks", "file =", 'delimiter = ","\ndecimal = ","\nfile =', ["recordings.1", "both"]),
        ("mark", "file =", 'delimiter = "::"\nfile =', ["recordings.1.delimiter"]),
        ("left", 'unit = "rad"', 'unit = "rad", side = "left"', ["position.side: got 'left'"]),
        ("sampled", '"N m"', '"N m", sampled = "sometimes"', ["torque.sampled"]),
        ("held", '"N m"', '"N m", held = "sometimes"', ["torque.held"]),
        ("whose", '"rad"', '"rad", sampled = "start"', ["position.sampled: unknown key"]),
        ("span", "file =", "exclude = [[1]]\nfile =", [".exclude.1: got [1]"]),
        ("back", "file =", "exclude = [[2, 1]]\nfile =", [".exclude: a span must end after"]),
        ("stop", "file =", "start = 3\nstop = 1\nfile =", ["c.toml: recordings.1: 'stop' (1 s)"]),
        ("start", "file =", "start = 9\nfile =", ["run.csv: ends 3.99 s", "start = 9 s"]),
        # what does not go together
        ("side", "motor-axis", "rabbit-knee", ["'q'", "gear ratio is 50", 'side = "motor"']),
        ("radius", "file =", 'added_mass = "2 kg"\nfile =', ["1.added_mass: has no radius"]),
        ("doubled", RECORDING, RECORDING * 2, ["c.toml: recordings: 2 are called 'run'; give ea"]),
        ("second", RECORDING, RECORDING + RECORDING.replace("f", "ff", 1), ["recordings.2.ffile"]),
        ("no-recording", RECORDING, "", ["c.toml: names no recording; add a [[recordings]]"]),
        ("single", "[[recordings]]", "[recordings]", ["recordings: got a table"]),
        ("no-unit", ', unit = "rad"', "", ["recordings.1.position.unit: is missing; add 'unit'"]),
        ("no-torque", "torque =", "# torque =", ["recordings.1: got none"]),
        ("no-time", "time =", "# time =", ["c.toml: recordings.1:", "give exactly one of 'time'"]),
        ("no-mechanism", '[mechanism]\npreset = "motor-axis"', "", ["mechanism: is missing; add"]),
        ("nothing", 'preset = "motor-axis"', "", ["c.toml: mechanism: describes no joint; set"]),
        ("slides", "preset", 'motion = "linear"\npreset', ["'q'", "a length like", "'rad'"]),
        # no TOML
        ("quote", '"motor-axis"', '"motor-axis', ["c.toml: is no TOML", "line 2", '"quotes"']),
        ("bare", '"motor-axis"', "motor-axis", ["c.toml: is no TOML", "line 2"]),
        ("twice", "order = 4", "order = 4\norder = 5", ["c.toml: is no TOML", "line 12"]),
        ("digits", "seed = 1", "seed = 1" + "1" * 5000, ["c.toml: is no TOML"]),
        ("brackets", PRIOR, "a = " + "[" * 9000, ["c.toml: is no TOML"]),
        ("deep", PRIOR, "a = " + "[" * 250 + "]" * 250, ["c.toml: is nested too deep"]),
    ),
)
def test_configuration(bench, old, new, parts):
    bench.edit(old, new)
    has(bench.refused(), *parts)


def test_number_where_a_table_belongs(bench):
    bench.config("processing = 3\n" + CONFIG.replace("[processing]\norder = 4", ""))
    has(bench.refused(), "c.toml: processing: got 3")


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
        ("empty", "/dev/null", ["is no ordinary file"]),
    ),
)
@pytest.mark.parametrize("command", ["check", "fit"])
def test_configuration_that_cannot_be_read(bench, command, name, parts):
    has(bench.refused(command, name), *parts)


# -- priors


@pytest.mark.parametrize(
    ("prior", "parts"),
    cases(
        ("negative", '"motor.inertia" = -1e-3', ["inertia: -0.001 is no", "0 or more"]),
        ("reversed", '"motor.inertia" = [2, 1]', ["[2, 1] is no range"]),
        ("outside", '"motor.inertia" = [-1, 1]', ["[-1, 1] reaches outside", "0 or more"]),
        ("true", '"motor.inertia" = true', ["true/false is no prior"]),
        ("nan", '"motor.inertia" = nan', ["nan is no possible value"]),
        ("inf", '"motor.inertia" = inf', ["inf is no possible value"]),
        ("to-inf", '"motor.inertia" = [0, inf]', ["[0, inf] is no range"]),
        ("huge", f'"motor.inertia" = 1{"0" * 400}', ["is no possible value"]),
        ("text", '"motor.inertia" = "1e-3"', ["'1e-3' is no prior"]),
        ("date", '"motor.inertia" = 2020-01-01', ["'2020-01-01' is no prior"]),
        ("three", '"motor.inertia" = [1, 2, 3]', ["[1, 2, 3] is no prior"]),
        ("all-fixed", "motor = {inertia=1, viscous=1, coulomb=1}\noffset = 0", ["leave at le"]),
        ("unknown", '"motor.inerta" = 1', ["no such parameter; did you mean 'motor.inertia'?"]),
        ("unknown-dotted", "motor.inerta = 1", ["no such parameter", "'motor.inertia'?"]),
        ("twice", '"motor.inertia" = 1\nmotor.inertia = 2', ["motor.inertia: is given twice"]),
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
        ("text", '"norm", loc = "1"', [".loc: got '1'"]),
        ("list", '"norm", loc = [1, 2]', [".loc: got [1, 2]"]),
        ("true", '"norm", scale = true', [".scale: got true"]),
        ("inf", '"norm", scale = inf', [".scale: got inf"]),
        ("negative", '"norm", scale = -1', ["there is no norm(scale=-1)"]),
        ("overflow", '"norm", loc = 1e300, scale = 1e-300', ["there is no norm("]),
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
