"""What the likelihood alone determines, where theory says so."""

import numpy as np
import pytest

from bayesfric.identifiability.local import local_information, verdict
from bayesfric.inference.fitting import make_target, read_priors
from bayesfric.mechanism.own_term import Term
from bayesfric.mechanism.presets import PRESETS

KNEE, AXIS = PRESETS["rabbit-knee"], PRESETS["motor-axis"]
SCALED = {
    "load.inertia",
    "load.first_moment",
    "joint.viscous",
    "joint.coulomb_positive",
    "joint.coulomb_negative",
    "gearbox.alpha_drive",
    "gearbox.alpha_back",
}


def information(chain, values, observations, texts=None):
    target = make_target(
        chain, observations, read_priors(chain, texts or {}, observations), "shared"
    )
    point = [values[name] for name in target.free] + [0.02]
    return local_information(target, np.array(point))


def test_the_papers_scaling_is_the_one_null_direction(make_observation):
    chain = KNEE.chain()
    found = information(chain, KNEE.values, [make_observation(chain, KNEE.values, amplitude=2.0)])
    assert len(found.null_directions) == 1
    exponents = found.null_directions[0].exponents
    assert set(exponents) == SCALED
    np.testing.assert_allclose(list(exponents.values()), 1.0, atol=1e-6)
    assert "multiplied by one factor" in str(found.null_directions[0].meaning)
    sd = dict(zip(found.names, found.data_sd, strict=True))
    assert np.isinf(sd["load.first_moment"])
    assert np.isfinite(sd["motor.inertia"])


def test_a_known_mass_lifts_it(make_observation):
    chain = KNEE.chain()
    both = [
        make_observation(chain, KNEE.values, amplitude=2.0),
        make_observation(
            chain, KNEE.values, amplitude=2.0, added_mass=2.0, radius=0.35, name="loaded"
        ),
    ]
    found = information(chain, KNEE.values, both)
    assert found.null_directions == ()
    assert np.isfinite(found.data_sd).all()


def test_a_fixed_first_moment_lifts_it(make_observation):
    chain = KNEE.chain()
    o = make_observation(chain, KNEE.values, amplitude=2.0)
    found = information(chain, KNEE.values, [o], {"load.first_moment": 0.42})
    assert found.null_directions == ()


def test_a_parameter_that_never_shows_is_named(make_observation):
    """No motion into gravity's reach: q stays 0 in a made-up copy."""
    chain = KNEE.chain()
    o = make_observation(chain, KNEE.values, amplitude=2.0)
    level = type(o)(**{**vars(o), "q": np.zeros_like(o.q)})
    found = information(chain, KNEE.values, [level])
    texts = [str(n.meaning) for n in found.null_directions]
    assert any("load.first_moment does not show" in text for text in texts)


def test_sds_of_a_linear_model_are_least_squares(make_observation):
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values, n=500)
    found = information(chain, AXIS.values, [o])
    x = np.stack([o.qdd, o.qd, np.sign(o.qd), np.ones_like(o.q)], axis=1)
    expected = 0.02 * np.sqrt(np.diag(np.linalg.inv(x.T @ x)))
    np.testing.assert_allclose(found.data_sd, expected, rtol=1e-6)


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
