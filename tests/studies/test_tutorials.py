"""The tutorials: what their committed outputs say, and, slowly, what they say when run anew."""

import importlib
import json
import re
import sys

import pytest
from scipy import stats

from bayesfric.diagnostics.statistics import FALSE_ALARMS
from tests.conftest import REPOSITORY

FOLDER = REPOSITORY / "studies" / "tutorials"
NAMES = sorted(path.stem for path in FOLDER.glob("*.ipynb"))
NUMBER = r"(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)"


def printed(notebook):
    """Text that the cells printed or showed, in order; fails where one of them did."""
    found = []
    for cell in notebook["cells"]:
        for output in cell.get("outputs", ()):
            assert output["output_type"] != "error", cell["source"]
            text = output.get("text") or output.get("data", {}).get("text/plain", "")
            found.append("".join(text))
    return "\n".join(found)


def numbers(pattern, text):
    (found,) = re.findall(pattern.replace("#", NUMBER), text)
    return [float(x) for x in ([found] if isinstance(found, str) else found)]


def first_joint(text):
    assert "reliable" in text
    assert numbers("# of 6 true values in their 90 % interval", text)[0] >= 4


def what_the_data_cannot_tell(text):
    assert numbers("largest difference: # °", text)[0] < 1e-9
    (null,) = re.findall("^null: (.*)$", text, re.M)
    for name in ("gearbox.alpha_drive", "load.inertia", "load.first_moment", "joint.viscous"):
        assert name in null
    assert "null directions left: 0" in text
    predicted, sampled = numbers("predicted #%, sampled #% of it", text)
    assert predicted == pytest.approx(sampled, rel=0.3)


def which_friction_model(text):
    assert 'put in: mechanism.elements.servo.load_loss = "one"' in text
    assert re.search(r"simulated, complete: of \d+ kinds 0 are found", text)


def commands_and_encoders(text):
    assert numbers("# of 4 true values in their 90 % interval", text)[0] >= 3
    assert "drive.kp can all be multiplied by one factor" in text
    for value, sd, true in re.findall(rf"_over_kp: {NUMBER} ± {NUMBER}, true {NUMBER}", text):
        assert abs(float(value) - float(true)) < 4.0 * float(sd)
    (came,) = numbers("the file as it came: # mrad", text)
    (fitted,) = numbers("with fitted numbers: # mrad", text)
    (best,) = numbers("with the true ones:  # mrad", text)
    assert fitted < 1.2 * best < 0.2 * came


def to_mujoco_and_a_controller(text):
    assert "gearbox.load = " in text
    (plain,) = numbers("MuJoCo as it is, from our roll-out: +# mrad", text)
    (mended,) = numbers("with friction set at each step: +# mrad", text)
    assert mended < 0.2 * plain
    (max_count,) = numbers("feed-forward: up to # N m", text)
    (off,) = numbers("off the truth by at most # mN m", text)
    assert off < 0.01 * 1e3 * max_count
    if "no C compiler here" not in text:
        assert numbers("compiled C and Python agree within # N m", text)[0] < 1e-12


def a_fleet(text):
    found = re.search(r"24 units: \{'good': (\d+)(?:, 'usable': (\d+))?\} failed: \{\}", text)
    assert found
    good, usable = (int(x or 0) for x in found.groups())
    assert good + usable == 24
    # of right models 5 % have a finding: no more than chance makes of 24 once in 200 times
    assert usable <= stats.binom.ppf(0.995, 24, FALSE_ALARMS)
    outliers = re.findall(r"^(axis-\d\d): motor.viscous, probability ([\d.]+)$", text, re.M)
    assert sorted(name for name, _ in outliers) == ["axis-05", "axis-17"]
    assert min(float(p) for _, p in outliers) > 0.99
    _, low, high = numbers(r"spread of motor.viscous: # \[#, #\]", text)
    (true,) = numbers("spread of the healthy ones' true values: # N m s", text)
    (every,) = numbers("of all, worn ones in it: +# N m s", text)
    assert low < true < high < every


def a_whole_arm(text):
    held, of = numbers("# of # true values in their 90 % interval", text)
    assert of == 12
    assert held >= 9
    held, of = numbers("# of # sums within 1.645 sd", text)
    assert held >= 0.6 * of
    # of the first sum, which gravity takes, the URDF is well off
    first = r"mz of upper_arm \+0.4 mass of forearm in kg m\n"
    urdf, found, _, true = numbers(rf"{first} +URDF #, found # ± #, true #", text)
    assert abs(found - true) < 0.1 * abs(urdf - true)
    assert numbers("than now, # times narrower than a motion at random", text)[0] > 1.0
    plain = numbers("PD alone +# mrad rms", text)[0]
    bodies = numbers("and the URDF's bodies +# mrad rms", text)[0]
    whole = numbers("and feedforward.py +# mrad rms", text)[0]
    assert 10.0 * whole < bodies < plain
    assert numbers("PD alone in robot.xml +# mrad rms", text)[0] == pytest.approx(plain, rel=0.2)
    low, high, below, above = numbers(r"motor.load +log \[#, #\], next \[#, #\]", text)
    assert above - below < 0.6 * (high - low)


@pytest.mark.parametrize("name", NAMES)
def test_committed_outputs_say_what_the_words_say(name):
    notebook = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
    globals()[name](printed(notebook))
    source = "".join("".join(cell["source"]) for cell in notebook["cells"])
    assert "simulated" in source
    # outputs are of the cells as they are
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_it_runs_and_says_it_again(name, monkeypatch):
    for module in ("nbclient", "ipykernel", "mujoco", "distributed", "idyntree", "rosbags"):
        pytest.importorskip(module, reason="wants bayesfric[tutorials]")
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.delitem(sys.modules, "run", raising=False)
    run = importlib.import_module("run")
    assert sorted(run.NAMES) == NAMES
    globals()[name](printed(run.executed(name)))
