"""Intervals of right models hold, and nothing is found, on three benches of ten recordings."""

import numpy as np
import pytest
from scipy import stats

from tests.studies.bench import scripts

pytestmark = pytest.mark.slow

RECORDINGS = 10
SEED = 62  # used for nothing else
CHANCE = 1e-3  # that a right package fails

whole_path = scripts("whole_path", folders=["calibration"])


@pytest.mark.parametrize("case", ["plain", "geared", "knee"])
def test_intervals_hold_and_nothing_is_found(case, whole_path):
    runs = [whole_path.one((SEED, case, number)) for number in range(RECORDINGS)]
    held = [
        np.mean([whole_path._held(row) for row in run["rows"].values()])
        for run in runs
        if run["rows"]
    ]
    # quantities of one recording err together: as few as if each recording were two numbers
    independent = 2 * len(held)
    least = stats.binom.ppf(CHANCE, independent, 0.9) / independent
    assert np.mean(held) >= least
    # one in twenty right recordings has a finding
    found = sum(bool(run["findings"]) for run in runs)
    assert found <= stats.binom.ppf(1.0 - CHANCE, RECORDINGS, 0.05)
