"""Recordings of one joint whose measured torques are shifted by different constants."""

import pytest

from .bench import JOINT, recorded, simulation

pytestmark = pytest.mark.usefixtures("nothing_explained")

OFFSETS = {"one": 0.08, "two": -0.05}
SHORT = "\n[sampling]\nwalkers = 32\nmax_steps = 400\nmin_ess = 200\n"


@pytest.fixture
def two(bench):
    for seed, (name, offset) in enumerate(OFFSETS.items(), start=1):
        made = simulation(
            duration=4.0, rate=500, encoder_counts=2**20, torque_noise=0.01, seed=seed
        )
        made += f"parameters = {{ offset = {offset} }}\n"
        bench.simulated(JOINT + recorded(name) + made, name)
    both = "".join(map(recorded, OFFSETS))
    bench.config(JOINT + 'offset = "per-recording"\n' + both + SHORT)
    return bench


def test_every_method_finds_each_offset(two):
    for method, estimate in two.told("estimate", "c.toml")["estimates"].items():
        rows = estimate["parameters"]
        assert "offset" not in rows
        for name, value in OFFSETS.items():
            row = rows[f"offset.{name}"]
            assert abs(row["value"] - value) < 5 * row["sd_robust"] < 0.05, (method, name)
        row = rows["motor.coulomb"]
        assert abs(row["value"] - 0.2) < 5 * row["sd_robust"], method


@pytest.mark.usefixtures("no_figures")
def test_the_posterior_has_each_and_one_prior_stands_for_all(two):
    text = (two.folder / "c.toml").read_text()
    two.config(text + '\n[priors]\noffset = {distribution = "norm", loc = 0.0, scale = 0.3}\n')
    found = two.told("fit", "c.toml", "-o", "run", codes=(0, 3))["parameters"]
    for name, value in OFFSETS.items():
        row = found[f"offset.{name}"]
        assert row["prior_sd"] == pytest.approx(0.3)
        assert abs(row["mean"] - value) < 5 * row["sd"] < 0.05
        assert row["verdict"] == "data"
