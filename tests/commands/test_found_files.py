"""A noise model is one new file: nothing else has to name it."""

import json
import subprocess
import sys

from .test_estimate import CONFIG

# Imports a package with one more folder to look for its files in.
FOUND = """
import importlib.util, sys
package, folder = sys.argv[1:3]
spec = importlib.util.find_spec(package)
spec.submodule_search_locations.append(folder)
module = importlib.util.module_from_spec(spec)
sys.modules[package] = module
spec.loader.exec_module(module)
parent, _, name = package.rpartition(".")
setattr(sys.modules[parent], name, module)
"""
SUMMARY = """
import json
from pathlib import Path
from bayesfric.diagnostics import explanation
from bayesfric.model import Model
explanation.LONGEST = 0  # what else explains the torque is not asked
print(json.dumps(Model.from_config(Path("c.toml")).fit().summary.as_dict()))
"""

NOISE = """
from dataclasses import dataclass, replace
from bayesfric.inference.noise.residual_noise import NoiseModel
from bayesfric.inference.noise.student_t import StudentT, SCALES as STUDENT
from bayesfric.inference.noise.residual_noise import SIGMA

TAILS = replace(STUDENT[0], name="tails", symbol=r"\\\\eta", meaning="how thin its tails are")

@dataclass(frozen=True)
class Tailed(StudentT):
    scales = (SIGMA, TAILS)
    description = "noise with tails"

SCALES = (TAILS,)
MODELS = (NoiseModel("tailed", lambda _: Tailed()),)
"""


def run(package, folder, script, *arguments):
    found = subprocess.run(
        [sys.executable, "-c", FOUND + script, package, str(folder), *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    return json.loads(found.stdout)


def test_a_noise_model_is_one_file(bench, tmp_path):
    (tmp_path / "tailed.py").write_text(NOISE)
    bench.simulated(CONFIG)
    options = '\n[noise]\nmodel = "tailed"\n\n[sampling]\nmax_steps = 200\nmin_ess = 100\n'
    (bench.folder / "c.toml").write_text(CONFIG + options)
    found = run("bayesfric.inference.noise", tmp_path, SUMMARY)
    assert found["noise"]["model"] == "noise with tails"
    assert found["noise"]["accounts_for_correlation"] is False
    tails = found["parameters"]["noise.tails"]
    assert (tails["meaning"], tails["unit"]) == ("how thin its tails are", "")
    assert tails["prior_default"]
