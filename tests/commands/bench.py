"""A folder with a configuration and a tiny recording, and the command run in it."""

import json
import re
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from bayesfric.commands import cli
from bayesfric.commands.simulate import simulate
from bayesfric.problem.config import read_config
from bayesfric.report import run_directory
from tests.recordings.samples import has as has

CONFIG = """\
[mechanism]
preset = "motor-axis"

[[recordings]]
file = "run.csv"
time = { column = "t", unit = "s" }
position = { column = "q", unit = "rad" }
torque = { column = "tau", unit = "N m" }

[processing]
order = 4

[noise]
scale = "shared"

[sampling]
seed = 1

[priors]
"motor.coulomb" = [0.0, 1.0]
"""
RECORDING = CONFIG[CONFIG.index("[[recordings]]") : CONFIG.index("[processing]")]
PRIOR = '"motor.coulomb" = [0.0, 1.0]'
JOINT = '[mechanism]\npreset = "motor-axis"\n'


def recorded(name="small"):
    """Table of a recording that ``simulate`` wrote."""
    return f"""
[[recordings]]
file = "{name}.csv"
time = {{ column = "time", unit = "s" }}
position = {{ column = "position", unit = "rad" }}
torque = {{ column = "torque", unit = "N m" }}
"""


def simulation(**changes):
    """Table of a recording that is simulated in a moment."""
    keys = {"duration": 3.0, "rate": 200, "excitation": "multisine"} | changes
    return "\n[simulation]\n" + "".join(f"{key} = {json.dumps(x)}\n" for key, x in keys.items())


SMALL = JOINT + recorded()
# Simulated and sampled in a moment.
SAMPLED = f"""{SMALL}
[sampling]
min_ess = 200
walkers = 24
ensembles = 2
seed = 5

[noise]
model = "white"
{simulation(encoder_counts=2**20)}"""


def simulated(path, text, name="small", seed=None):
    """Write a configuration and, next to it, the recording that it simulates."""
    path.write_text(text, encoding="utf-8")
    simulate(read_config(path), path.with_name(f"{name}.csv"), seed=seed)


def lines(n=400):
    """Lines of a recording; time stamps are exact decimals."""
    t = np.round(np.arange(n) * 0.01, 9)
    q = np.sin(2 * np.pi * 0.7 * t) + 0.3 * np.sin(2 * np.pi * 1.9 * t)
    rows = np.stack([t, q, 0.3 * np.cos(2 * np.pi * 0.7 * t) + 0.01 * t], axis=1)
    return ["t,q,tau", *(",".join(map(repr, row)) for row in rows.tolist())]


def cases(*rows):
    """Parametrise by rows whose first entry is the name."""
    return [pytest.param(*row[1:], id=row[0]) for row in rows]


@dataclass
class Outcome:
    code: int
    out: str
    err: str


class Bench:
    def __init__(self, folder, monkeypatch, capture):
        self.folder, self._monkeypatch, self._capture = folder, monkeypatch, capture
        self.config()
        self.recording(lines())

    def config(self, text=CONFIG, encoding="utf-8"):
        (self.folder / "c.toml").write_bytes(text.encode(encoding))

    def simulated(self, text, name="small", seed=None):
        simulated(self.folder / "c.toml", text, name, seed)

    def edit(self, old, new):
        assert old in CONFIG
        self.config(CONFIG.replace(old, new, 1))

    def recording(self, rows):
        (self.folder / "run.csv").write_text("\n".join(rows) + "\n")

    def held(self):
        """Content of the folder, hidden files too."""
        return {
            path.relative_to(self.folder): path.read_bytes() if path.is_file() else None
            for path in self.folder.rglob("*")
        }

    def run(self, *arguments):
        """Run the command in this process."""
        self._capture.readouterr()
        with self._monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["bayesfric", *map(str, arguments)])
            # no warning may reach the user: here they are errors, as in every test
            patch.setattr(sys, "warnoptions", ["error"])
            try:
                cli.main()
                code = 0
            except SystemExit as stop:
                code = stop.code
        return Outcome(code, *self._capture.readouterr())

    def record(self, *arguments, codes=(0,)):
        """Run the command with ``--json``, which succeeds, and return its record."""
        ended = self.run(*arguments, "--json")
        assert ended.code in codes, ended
        return json.loads(ended.out)

    def summary(self, run="run"):
        """Read ``summary.json`` of a run."""
        return json.loads((self.folder / run / "summary.json").read_text(encoding="utf-8"))

    def altered(self, change, name="small"):
        """Change the table of a simulated recording by a function."""
        path = self.folder / f"{name}.csv"
        header = path.read_text().split("\n", 1)[0]
        table = change(np.loadtxt(path, delimiter=",", skiprows=1))
        np.savetxt(path, table, "%.17g", ",", header=header, comments="")

    def run_apart(self, *arguments):
        """Run the command the way a user does, in a separate process."""
        ended = subprocess.run(
            [sys.executable, "-m", "bayesfric", *map(str, arguments)],
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
        return Outcome(ended.returncode, ended.stdout, ended.stderr)

    def refused(self, *arguments, run=None):
        """Run on bad input, and return its line of error."""
        before = self.held()
        outcome = (run or self.run)(*(arguments or ("check", "c.toml")))
        assert outcome.code == 2, outcome
        assert outcome.out == ""
        assert re.fullmatch(r"bayesfric: [^\n]+: [^\n]+; [^\n]+\n", outcome.err), outcome.err
        for internal in ("Traceback", "Input should", "pydantic", "ufunc", "<class"):
            assert internal not in outcome.err
        assert self.held() == before
        return outcome.err


def without_figures(patch):
    """Write runs without drawing: that takes longer than small samplings."""
    patch.setattr(run_directory, "FIGURES", {})
