"""Profile likelihoods, exact where the model is linear or the ridge is."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.estimates.descent import Terms, TorqueProblem, descend
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.identifiability.profile import DROP_90, profile_likelihoods, profiles
from bayesfric.inference.fitting import fit, make_target, read_priors
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.mechanism.presets import PRESETS
from bayesfric.mechanism.scaling import scalings
from bayesfric.report.figures.style import PAGE, save
from tests.conftest import REPOSITORY, imported


def study_figure():
    """Import the figure from beside its study."""
    return imported(REPOSITORY / "studies" / "scaling" / "profile_figure.py").profile_figure


AXIS, KNEE = PRESETS["motor-axis"], PRESETS["rabbit-knee"]


def regressors(o):
    """Columns of eq. (11) for the motor axis: inertia, Coulomb, viscous, offset."""
    columns = {
        "motor.inertia": o.qdd,
        "motor.coulomb": np.sign(o.qd),
        "motor.viscous": o.qd,
        "offset": np.ones_like(o.qd),
    }
    return np.stack([columns[name] for name in AXIS.chain().names], axis=1)


def least_squares_of(x, y):
    solution, (squares,), _, _ = np.linalg.lstsq(x, y, rcond=None)
    return solution, squares, np.linalg.inv(x.T @ x)


@pytest.fixture(scope="module")
def axis(make_observation):
    return make_observation(AXIS.chain(), AXIS.values, sigma=0.02, n=600)


def test_of_a_linear_model_the_sum_of_squares_is_the_parabola_of_least_squares(axis):
    """-n/2 log(SS/SSmin), SS = SSmin + (theta - best)^2 / C_jj, C = (X'X)^-1."""
    chain = AXIS.chain()
    solution, squares, covariance = least_squares_of(regressors(axis), axis.measured)
    n, d = axis.measured.size, solution.size
    t = np.linspace(-3.0, 3.0, 13)
    sd = np.sqrt(np.diag(covariance) * squares / (n - d))
    grids = {name: solution[j] + sd[j] * t for j, name in enumerate(chain.names)}
    found = profile_likelihoods(
        chain, [axis], Knowledge(), grids, [np.array([AXIS.values[k] for k in chain.names])]
    )
    assert [p.name for p in found] == list(chain.names)
    for p in found:
        expected = -0.5 * n * np.log1p(t**2 / (n - d))
        np.testing.assert_allclose(p.drop, expected, atol=1e-6)
        assert p.drop.max() == pytest.approx(0.0, abs=1e-9)
        assert p.on_bound == ((),) * t.size


def test_where_the_line_of_90_percent_crosses_is_the_interval_of_least_squares(axis):
    """1.645 sds to either side, up to the shape that n - d degrees of freedom give."""
    chain = AXIS.chain()
    solution, squares, covariance = least_squares_of(regressors(axis), axis.measured)
    n, d = axis.measured.size, solution.size
    sd = np.sqrt(np.diag(covariance) * squares / (n - d))
    grid = solution[0] + sd[0] * np.linspace(0.0, 2.5, 26)
    (p,) = profile_likelihoods(chain, [axis], Knowledge(), {chain.names[0]: grid}, [solution])
    reach = np.interp(-DROP_90, -p.drop, (p.values - solution[0]) / sd[0])
    assert reach == pytest.approx(1.6449, rel=0.01)


def test_a_held_coulomb_loss_stands_on_zero_where_least_squares_would_make_it_negative(axis):
    """Other parameters on their bound: the profile is that of the smaller linear model."""
    chain = AXIS.chain()
    x, y = regressors(axis), axis.measured
    solution, squares, covariance = least_squares_of(x, y)
    j, k = chain.names.index("motor.viscous"), chain.names.index("motor.coulomb")
    # along the profile the others move with the covariance; where Coulomb's reaches zero
    slope = covariance[k, j] / covariance[j, j]
    crossing = solution[j] - solution[k] / slope
    grid = solution[j] + (crossing - solution[j]) * np.array([0.0, 0.5, 0.9, 1.1, 1.5])
    order = np.argsort(grid)
    (p,) = profile_likelihoods(
        chain, [axis], Knowledge(), {"motor.viscous": grid[order]}, [solution]
    )
    for value, drop, names in zip(p.values, p.drop, p.on_bound, strict=True):
        beyond = abs(value - solution[j]) > abs(crossing - solution[j])
        assert names == (("motor.coulomb",) if beyond else ())
        free = [i for i in range(4) if i != j and not (beyond and i == k)]
        left = y - value * x[:, j]
        _, smaller, _ = least_squares_of(x[:, free], left)
        assert drop == pytest.approx(-0.5 * y.size * np.log(smaller / squares), abs=1e-6)


def test_recordings_of_their_own_noise_count_by_their_own_noise(axis, make_observation):
    """The drop of -n1/2 log SS1 - n2/2 log SS2, from weighted least squares in closed steps."""
    chain = AXIS.chain()
    noisy = make_observation(chain, AXIS.values, sigma=0.2, n=600, seed=4, name="noisy")
    xs, ys = [regressors(o) for o in (axis, noisy)], [axis.measured, noisy.measured]

    def best(held=None):
        """Iterate sds and weighted least squares; the viscous loss may be held."""
        j = chain.names.index("motor.viscous")
        free = [i for i in range(4) if held is None or i != j]
        shift = [0.0 if held is None else held * x[:, j] for x in xs]
        scale = np.ones(2)
        for _ in range(60):
            a = np.concatenate([x[:, free] / s for x, s in zip(xs, scale, strict=True)])
            b = np.concatenate([(y - c) / s for y, c, s in zip(ys, shift, scale, strict=True)])
            solution = np.linalg.lstsq(a, b, rcond=None)[0]
            left = [y - c - x[:, free] @ solution for x, y, c in zip(xs, ys, shift, strict=True)]
            scale = np.array([np.sqrt(np.mean(r**2)) for r in left])
        return solution, sum(-0.5 * r.size * np.log(r @ r) for r in left)

    solution, top = best()
    j = chain.names.index("motor.viscous")
    grid = solution[j] * np.array([0.97, 0.99, 1.0, 1.01, 1.03])
    (own,) = profile_likelihoods(
        chain, [axis, noisy], Knowledge(), {"motor.viscous": grid}, [solution], own_noise=True
    )
    expected = [best(value)[1] - top for value in grid]
    np.testing.assert_allclose(own.drop, expected, atol=1e-5)


@pytest.fixture(scope="module")
def knee(make_observation):
    chain = KNEE.chain()
    return chain, make_observation(chain, KNEE.values, amplitude=2.0)


def test_along_the_ridge_the_profile_is_flat_and_falls_only_beyond_dissipativity(knee):
    """A first moment of k times the best fits as well for 1/alpha_2 <= k <= 1/alpha_1."""
    chain, o = knee
    truth = chain.vector(KNEE.values)
    (scaling,) = scalings(chain)
    # the bounds are those of the best fit
    problem = TorqueProblem(chain, [o], Knowledge())
    best = problem.vector(descend(problem, Terms(np.ones(o.measured.size)), truth).x)
    low, high = scaling.bounds(best)
    k = np.array([0.9 * low, 0.97 * low, 1.001 * low, 0.9, 1.0, 0.999 * high, 1.03 * high])
    grid = k * best[chain.names.index("load.first_moment")]
    (p,) = profile_likelihoods(chain, [o], Knowledge(), {"load.first_moment": grid}, [best])
    inside = (k > low) & (k < high)
    np.testing.assert_allclose(p.drop[inside], 0.0, atol=1e-6)
    assert (p.drop[~inside] < -0.05).all()
    for factor, names in zip(k, p.on_bound, strict=True):
        # alpha_2 = 1 at the lower end, alpha_1 = 1 at the upper one
        assert ("gearbox.load_back" in names) == (factor < low), factor
        assert ("gearbox.load_drive" in names) == (factor > high), factor


def test_what_a_scale_that_is_open_can_move_off_a_bound_is_not_on_it(knee):
    chain, o = knee
    (scaling,) = scalings(chain)
    truth = chain.vector(KNEE.values)
    at_end = scaling.scaled(truth, scaling.bounds(truth)[1])  # mu_1 = 0
    grid = KNEE.values["motor.inertia"] * np.array([0.99, 1.0, 1.01])
    (p,) = profile_likelihoods(chain, [o], Knowledge(), {"motor.inertia": grid}, [at_end])
    assert all("gearbox.load_drive" not in names for names in p.on_bound)


@pytest.fixture(scope="module")
def sampled(axis):
    chain = AXIS.chain()
    priors = read_priors(chain, {"offset": 0.02}, [axis])
    return fit(
        make_target(chain, [axis], priors, "shared"), Sampling(seed=3, ensembles=2, min_ess=500)
    )


def test_of_a_fit_what_is_fixed_stays_and_grids_span_the_posterior(sampled):
    found = profiles(sampled, points=7)
    assert tuple(p.name for p in found) == sampled.target.free
    assert "offset" not in sampled.target.free
    for p in found:
        draws = sampled.posterior[p.name]
        ends = np.quantile(draws, [0.005, 0.995])
        np.testing.assert_allclose(p.values[[0, -1]], ends, rtol=1e-9)
        # flat enough priors: beyond 2.58 sds the likelihood has fallen by 3.3
        np.testing.assert_allclose(p.drop[[0, -1]], -3.3, atol=1.0)
        assert p.drop.max() <= 0.0


def test_figure(sampled, tmp_path):
    found = profiles(sampled, points=5)
    held = [replace(p, on_bound=(("motor.coulomb",), (), (), (), ())) for p in found]
    figure = study_figure()(sampled, held)
    assert figure.get_figwidth() == PAGE
    assert [ax.get_gid() for ax in figure.axes] == [p.name for p in found]
    for ax, p in zip(figure.axes, held, strict=True):
        by_gid = {a.get_gid(): a for a in ax.get_children() if a.get_gid()}
        np.testing.assert_array_equal(by_gid["profile"].get_ydata(), p.drop)
        np.testing.assert_array_equal(by_gid["held"].get_ydata(), p.drop[:1])
        assert by_gid["held"].get_markerfacecolor() == "white"
        assert by_gid["free"].get_ydata().size == 4
        assert by_gid["chi-square"].get_ydata()[0] == pytest.approx(-2.7055 / 2, abs=1e-4)
        assert by_gid["on bound"].get_text().startswith("$C_")
    save(figure, tmp_path, "profile")
    pdf = tmp_path / "profile.pdf"
    assert b"/Type3" not in pdf.read_bytes()
    assert b"/FontFile2" in pdf.read_bytes()
