"""What the likelihood alone determines, where theory says so."""

import numpy as np
import pytest

from bayesfric.identifiability.local import local_information, verdict
from bayesfric.inference.fitting import make_target, read_priors
from bayesfric.mechanism.own_term import Term
from bayesfric.mechanism.presets import PRESETS

KNEE, AXIS = PRESETS["rabbit-knee"], PRESETS["motor-axis"]


def information(chain, values, observations):
    target = make_target(chain, observations, read_priors(chain, {}, observations), "shared")
    point = [values[name] for name in target.free] + [0.02]
    return local_information(target, np.array(point))


def test_a_parameter_that_never_shows_is_named(make_observation):
    """No motion into gravity's reach: q stays 0 in a made-up copy."""
    chain = KNEE.chain()
    o = make_observation(chain, KNEE.values, amplitude=2.0)
    level = type(o)(**{**vars(o), "q": np.zeros_like(o.q)})
    found = information(chain, KNEE.values, [level])
    texts = [n.meaning for n in found.null_directions]
    assert any("load.first_moment does not show" in text for text in texts)


@pytest.mark.parametrize(
    ("posterior_sd", "prior_sd", "data_sd", "word"),
    [
        (1.0, 100.0, 1.0, "data"),
        (1.0, np.inf, 1.0, "data"),
        (0.95, 1.0, 3.0, "prior"),
        (0.1, 10.0, np.inf, "prior"),  # bounded by something else than data or prior width
        (0.7, 1.0, 1.0, "weak"),
        (0.3, 10.0, 1.0, "weak"),  # the data alone tell it, bounds of others tell more
        (0.3, 1.5, 1.0, "prior"),
        (0.1, 10.0, 1.0, "prior"),  # a hundredth of what is known is the data's
        (0.95, 1.0, 0.96, "prior"),
        (0.1, 0.5, 0.02, "weak"),  # far wider than the local picture says
        (0.1, 0.5, np.nan, "prior"),
        (0.0, 0.0, 0.0, "prior"),
    ],
)
def test_verdicts(posterior_sd, prior_sd, data_sd, word):
    assert verdict(posterior_sd, prior_sd, data_sd) == word


def test_a_term_of_ones_own_keeps_its_name_and_its_own_unit(make_observation):
    """Whatever it is called: only a load loss by the direction of power has an alpha."""
    ripple = Term("motor.load_drive_ripple", lambda m: np.sin(6.0 * m.position), "N m")
    chain = AXIS.chain().with_term(ripple)
    values = {**AXIS.values, ripple.name: 0.0}
    found = information(chain, values, [make_observation(chain, values, amplitude=2.0)])
    j = found.names.index(ripple.name)
    assert (found.labels[j], found.ways[j], found.shifted[j]) == (ripple.name, 0, True)
    assert found.data_sd[j] > 0.0
