"""A model read from a configuration gives the numbers of ``bayesfric fit``."""

import numpy as np
import pytest

from bayesfric.inference.archive import read_archive
from bayesfric.inference.likelihood.autoregression import simulated
from bayesfric.model import Model

from .bench import SMALL

pytestmark = pytest.mark.usefixtures("nothing_explained")

CONFIG = f"""{SMALL}
[sampling]
min_ess = 200
walkers = 24
ensembles = 2
seed = 5

[simulation]
duration = 6.0
rate = 200
excitation = "multisine"
encoder_counts = 0
torque_noise = 0.0
"""


@pytest.fixture
def remembering(bench):
    """A recording whose noise has a memory, so that it matters who chooses the noise."""
    (bench.folder / "knee.toml").write_text(CONFIG)
    bench.simulated(CONFIG)

    def noisy(table):
        follows = np.ones(len(table) - 1, dtype=bool)
        table[:, 2] += 0.01 * simulated(np.array([0.9]), follows, 1, np.random.default_rng(1))[0]

    bench.altered(noisy)
    return bench


@pytest.mark.usefixtures("no_figures")
def test_a_model_of_the_configuration_is_the_fit(remembering):
    draws = Model.from_config(remembering.folder / "knee.toml").sample()["posterior"]
    ended = remembering.run("fit", "knee.toml", "-o", "run")
    assert ended.code == 0, ended
    kept = read_archive(remembering.folder / "run" / "posterior.nc")["posterior"]
    assert set(kept.data_vars) == set(draws.data_vars)
    assert any("pacf" in name for name in draws.data_vars)
    for name in draws.data_vars:
        assert kept[name].values.tobytes() == draws[name].values.tobytes(), name


def test_noise_that_is_to_be_chosen_is_not_silently_white(remembering):
    problem = Model.from_config(remembering.folder / "knee.toml")
    with pytest.raises(ValueError, match="white_target"):
        problem.target()
    noise = problem.config.tables.noise.model_copy(update={"model": "white"})
    tables = problem.config.tables.model_copy(update={"noise": noise})
    told = Model.from_config(problem.config.model_copy(update={"tables": tables}))
    assert told.target().names == problem.white_target().names
