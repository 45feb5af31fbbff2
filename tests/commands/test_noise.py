"""What ``fit`` makes of noise that remembers, and of outliers, as a user sees it."""

import numpy as np
import pytest

from bayesfric.inference.likelihood.autoregression import simulated
from bayesfric.report.terminal import fit_text

from .bench import SMALL, has

pytestmark = pytest.mark.usefixtures("nothing_explained")

CONFIG = f"""{SMALL}
[processing]
lowpass = "100 Hz"
decimate = 1

[sampling]
min_ess = 1000

[simulation]
duration = 6.0
rate = 500
excitation = "multisine"
encoder_counts = 0
torque_noise = 0.0
"""
TRUTH = {"motor.inertia": 0.01, "motor.viscous": 0.05, "motor.coulomb": 0.2, "offset": 0.02}
RHO = 0.8


def with_noise(bench, make):
    """Simulate without noise, then add it to the torque that the file tells."""
    bench.simulated(CONFIG)

    def noisy(table):
        table[:, 2] += make(len(table))

    bench.altered(noisy)


def fitted(bench, *more):
    ended = bench.run("fit", "c.toml", "-o", "run", "--force", *more)
    assert ended.code == 0, ended
    return bench.summary()


@pytest.mark.usefixtures("no_figures")
def test_memory_is_found_and_widens_what_white_noise_claims(bench):
    follows = np.ones(2999, dtype=bool)
    rng = np.random.default_rng(6)
    with_noise(bench, lambda n: 0.01 * simulated(np.array([RHO]), follows[: n - 1], 1, rng)[0])
    summary = fitted(bench)
    noise = summary["noise"]
    assert noise["model"] == "AR(1)"
    assert noise["autoregression"]["small"][0] == pytest.approx(RHO, abs=0.05)
    assert noise["innovation_whiteness"]["white"] is True
    for name, value in TRUTH.items():
        row = summary["parameters"][name]
        assert abs(row["mean"] - value) < 4 * row["sd"], name
    # of a constant among such noise white noise claims sqrt((1 + rho)/(1 - rho)) = 3 times less
    white = summary["estimates"]["input-error"]["parameters"]["offset"]["sd"]
    assert summary["parameters"]["offset"]["sd"] / white == pytest.approx(3.0, rel=0.15)
    has(
        "\n".join(fit_text(summary, verbose=True)), "Noise: AR(1)", "chosen by BIC", "pass as white"
    )
