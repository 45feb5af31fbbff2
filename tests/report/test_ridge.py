"""The ridge: what theory says of it, in a sampled posterior and in the figure."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayesfric.inference.fitting import fit, make_target, read_priors
from bayesfric.inference.sampling import Sampling
from bayesfric.mechanism.joint import PRESETS
from bayesfric.report.figures.posterior import ridge, ridge_figure

KNEE = PRESETS["rabbit-knee"]
# So wide that only the lower ends, zero, and mu_2 <= 1 are ever met.
FLAT = {
    "motor.inertia": [0.0, 0.01],
    "motor.viscous": [0.0, 0.2],
    "motor.coulomb_positive": [0.0, 5.0],
    "motor.coulomb_negative": [0.0, 5.0],
    "gearbox.load_drive": [0.0, 50.0],
    "gearbox.load_back": [0.0, 1.0],
    "joint.viscous": [0.0, 300.0],
    "joint.coulomb_positive": [0.0, 300.0],
    "joint.coulomb_negative": [0.0, 300.0],
    "load.inertia": [0.0, 30.0],
    "load.first_moment": [0.0, 30.0],
}


@pytest.fixture(scope="module")
def flat(make_observation):
    """A sampled posterior of one made-up recording under flat priors."""
    chain = KNEE.chain()
    observation = make_observation(chain, KNEE.values, amplitude=2.0)
    priors = read_priors(chain, FLAT, [observation])
    target = make_target(chain, [observation], priors, "shared")
    return fit(target, Sampling(seed=1, ensembles=2, min_ess=1000))


@pytest.fixture(scope="module")
def loaded(flat, make_observation):
    """The same draws beside a second recording with a known mass."""
    mass = {"added_mass": 2.0, "radius": 0.35, "name": "loaded", "seed": 1}
    observations = [*flat.observations, make_observation(flat.chain, KNEE.values, **mass)]
    priors = read_priors(flat.chain, FLAT, observations)
    return replace(flat, target=make_target(flat.chain, observations, priors, "shared"))


def mu(fitted):
    return (fitted.posterior[f"gearbox.load_{side}"].ravel() for side in ("drive", "back"))


def distance(sample, independent):
    """Kolmogorov's distance from uniform(0, 1), over what chance exceeds once in 10 000 times."""
    return stats.kstest(sample, "uniform").statistic / stats.kstwo.isf(1e-4, int(independent))


def test_flat_priors_and_dissipativity_alone_make_the_posterior_of_the_scale(flat):
    r"""The scale has the distribution that a change of variables gives, and no other.

    The torque fixes Theta1 and Theta2 of eq. (13), not the factor k of five leg parameters and
    both alphas. With flat densities of the leg parameters (each k times something) and of
    ``mu_1 = 1/(alpha_1 k) - 1``, ``mu_2 = 1 - 1/(alpha_2 k)``, the volume element at given
    Theta is ``k^5 k^-2 d log k``: log k is not uniform, k^3 is. alpha_1 is k up to a factor and
    runs, at given Theta, from r = alpha_1/alpha_2 (where alpha_2 = 1) to 1; r is one of the
    numbers that Theta fixes. So whatever the posterior of Theta may be,
    ``(alpha_1^3 - r^3)/(1 - r^3)`` is uniform(0, 1).
    """
    assert flat.posterior.diagnostics.status == "reliable"
    mu_1, mu_2 = mu(flat)
    alpha, r = 1.0 / (1.0 + mu_1), (1.0 - mu_2) / (1.0 + mu_1)
    independent = flat.posterior.diagnostics.ess.min()
    place = (alpha**3 - r**3) / (1.0 - r**3)
    assert distance(place, independent) < 1.0
    # it fills the interval: chance would leave an outer hundredth empty with 0.99^1000 = 4e-5
    assert place.min() < 0.01
    assert place.max() > 0.99
    # two other readings of "flat" would be found out
    assert distance(np.log(alpha / r) / np.log(1.0 / r), independent) > 3.0
    assert distance((alpha - r) / (1.0 - r), independent) > 3.0
    # nothing that Theta fixes tells of the place
    for known in (r, flat.posterior["motor.inertia"].ravel()):
        assert abs(stats.spearmanr(place, known).statistic) < 4.0 / np.sqrt(independent)


def test_the_line_ends_where_an_alpha_is_one(flat):
    known, names = ridge(flat), list(flat.chain.names)
    mu_1, mu_2 = (known.line[:, names.index(f"gearbox.load_{side}")] for side in ("drive", "back"))
    assert mu_2[0] == pytest.approx(0.0, abs=1e-12)
    assert mu_1[-1] == pytest.approx(0.0, abs=1e-12)
    # in the paper's words 1/alpha_2 <= k <= 1/alpha_1, for the line and for every draw
    for values in (mu_1, mu_2, *mu(flat)):
        assert values.min() >= -1e-12
    # everything behind the gearbox times 1/alpha is what the motor feels: constant
    for name in names:
        values = known.line[:, names.index(name)]
        if name.startswith(("joint.", "load.")):
            np.testing.assert_allclose(
                values * (1.0 + mu_1), values[0] * (1.0 + mu_1[0]), rtol=1e-12
            )
        elif name.startswith("motor."):
            assert np.ptp(values) == 0.0
    # from end to end it is as long as the interval of factors
    low, high = known.bounds
    assert 1.0 + mu_1[0] == pytest.approx(high / low, rel=1e-12)
    median = np.median(flat.chain_draws(), axis=0)
    ends = [
        1.0 - median[names.index("gearbox.load_back")],
        1.0 + median[names.index("gearbox.load_drive")],
    ]
    assert known.bounds == pytest.approx(ends, rel=1e-14)


def test_a_known_mass_shows_in_the_torque_along_the_line(loaded):
    line = ridge(loaded).line[[0, 50, 100]]
    plain, heavy = (
        np.ptp(torque, axis=0).max() for torque in loaded.target.likelihood.predict(line)
    )
    assert plain <= 1e-10
    # k times the leg without, and once the mass with: g M r (k - 1)/(alpha N) does not cancel
    assert heavy > 0.01


def test_a_chain_without_a_scaling_has_no_ridge(slide):
    assert ridge(slide) is None
    assert ridge_figure(slide) is None
