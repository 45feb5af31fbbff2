"""A term that is rows of the table and nothing else goes through every command."""

import pytest

pytestmark = pytest.mark.usefixtures("nothing_explained")

CONFIG = """
[mechanism]
preset = "servo-pendulum"
[mechanism.elements.motor]
viscous = "by-direction"
[[recordings]]
file = "servo.csv"
time = { column = "time", unit = "s" }
position = { column = "position", unit = "rad" }
torque = { column = "torque", unit = "N m" }
[simulation]
excitation = "multisine"
amplitude = 0.35
frequencies = [0.2, 0.5, 0.9, 1.7]
torque_noise = 0.005
encoder_counts = 1048576
seed = 13
[simulation.parameters]
"motor.viscous_positive" = 0.015
"motor.viscous_negative" = 0.025
[sampling]
min_ess = 600
"""
TERMS = {"motor.viscous_positive": 0.015, "motor.viscous_negative": 0.025}


@pytest.mark.usefixtures("no_figures")
def test_every_command(bench):
    (bench.folder / "servo.toml").write_text(CONFIG, encoding="utf-8")
    told = bench.told
    assert bench.run("simulate", "servo.toml", "-o", "servo.csv").code == 0
    priors = told("check", "servo.toml")["priors"]
    assert priors["motor.viscous_positive"] == priors["motor.viscous_negative"]
    found = told("identify", "servo.toml")["parameters"]
    assert {found[name]["verdict"] for name in TERMS} == {"data"}
    rows = told("estimate", "servo.toml")["estimates"]
    assert {"total.viscous", "total.viscous_difference"} <= set(rows["least-squares"]["parameters"])
    for method in ("input-error", "output-error"):
        for name, true in TERMS.items():
            row = rows[method]["parameters"][name]
            assert abs(row["value"] - true) < 5.0 * row["sd_robust"], (method, name)
    summary = told("fit", "servo.toml", "-o", "run")
    for name, true in TERMS.items():
        row = summary["parameters"][name]
        assert row["verdict"] == "data"
        assert abs(row["median"] - true) < 5.0 * row["sd"]
    assert bench.run("report", "run").code == 0
    page = (bench.folder / "run" / "report.html").read_text(encoding="utf-8")
    assert all(name in page for name in TERMS)
    assert bench.run("compare", "run", "-o", "side").code == 0
    page = (bench.folder / "side" / "report.html").read_text(encoding="utf-8")
    assert "motor.viscous_negative" in page


def test_init_names_it(bench):
    assert '"by-direction"' in bench.run("init", "--all-keys").out
