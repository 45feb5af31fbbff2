"""The benchmark's posterior is the same for bayesfric, for the rivals, and by hand."""

import importlib.util
import json
import math

import numpy as np
import pytest

from tests.conftest import REPOSITORY, imported

FOLDER = REPOSITORY / "studies" / "benchmark"
N = 3000


@pytest.fixture(scope="module")
def problem():
    return imported(FOLDER / "problem.py")


@pytest.fixture(scope="module")
def written(problem, tmp_path_factory):
    path = tmp_path_factory.mktemp("benchmark") / "problem.npz"
    return path, problem.write(path, n_samples=N)


def by_hand(file, x):
    """Log density of logarithms from eqs. (3) to (9), element by element, up to a constant."""
    jm, fm, cm1, cm2, mu1, mu2, fc, cc1, cc2, jc, ml, sigma = np.exp(x)
    n, g = float(file["ratio"]), float(file["gravity"])
    total = 0.0
    for q, qd, qdd, measured in zip(
        file["q"], file["qd"], file["qdd"], file["torque"], strict=True
    ):
        load = jc * qdd + g * ml * math.sin(q)
        joint = load + (cc1 if qd > 0 else -cc2) + fc * qd
        alpha = 1.0 / (1.0 + mu1) if joint * qd > 0 else 1.0 / (1.0 - mu2)
        motor = jm * n * qdd + (cm1 if qd > 0 else -cm2) + fm * n * qd + joint / (alpha * n)
        total -= 0.5 * ((measured - motor) / sigma) ** 2 + math.log(sigma)
    for value, row in zip(x, json.loads(str(file["prior"])), strict=True):
        # log-normal density times the Jacobian of the logarithm: normal in the logarithm
        total -= 0.5 * ((value - math.log(row["median"])) / row["sd"]) ** 2
    return total


def test_stored_densities_follow_from_the_equations(written):
    path, _ = written
    with np.load(path) as file:
        density = np.array([by_hand(file, x) for x in file["reference_logarithms"]])
        stored = file["reference_log_density"]
    top = int(np.argmax(stored))
    difference = np.abs((density - density[top]) - (stored - stored[top]))
    # sums of 3000 terms in another order; relative where the density is far below its top
    assert np.all(difference < 1e-8 * np.maximum(1.0, stored[top] - stored))


def test_the_rivals_densities_are_the_same_posterior(written, problem):
    path, target = written
    rivals = imported(FOLDER / "rivals" / "posterior.py").read(path)
    assert rivals.check(rivals.log_density) < 1e-8
    assert rivals.check(lambda x: rivals.log_density_many(x[None])[0]) < 1e-8
    with pytest.raises(AssertionError, match="not the same posterior"):
        rivals.check(lambda x: rivals.log_density(x) + 1e-3 * x[0])
    beyond = rivals.starts[:1].copy()
    beyond[0, problem.knee().names.index("gearbox.load_back")] = 1e-9
    assert rivals.log_density(beyond[0]) == rivals.log_density_many(beyond)[0] == -np.inf
    assert target.log_prior(np.exp(beyond))[0] == -np.inf


def test_the_recording_is_the_true_model_with_white_noise(problem):
    o = problem.observation(N)
    assert o.measured.shape == o.q.shape == (N,)
    assert np.all(o.qd != 0.0)
    values = problem.knee().vector(
        {name: value for name, value in problem.truth().items() if name != "noise.sigma"}
    )
    likelihood = problem.target(N).likelihood
    residual = o.measured - likelihood.predict(values[None])[0][0]
    # N normal numbers: four standard errors of sd, mean and lag-1 correlation
    assert residual.std() == pytest.approx(problem.TORQUE_NOISE, rel=4 / math.sqrt(2 * N))
    assert abs(residual.mean()) < 4 * problem.TORQUE_NOISE / math.sqrt(N)
    assert abs(np.corrcoef(residual[1:], residual[:-1])[0, 1]) < 4 / math.sqrt(N)


def test_the_density_that_gradient_samplers_get_is_the_targets(written, problem, monkeypatch):
    """In coordinates and from moments, with the gradient by hand, near the posterior and off it."""
    path, target = written
    with np.load(path) as file:
        draws = np.exp(file["starts"])
    target = target.with_widths(draws.std(axis=0))
    target = target.precomputed(target.from_parameters(draws[:300]))
    # by its own name, which what Numba keeps compiled asks for
    monkeypatch.syspath_prepend(FOLDER / "same_density")
    density = importlib.import_module("density")
    medians = np.array([problem.PRIOR_MEDIANS[name] for name in target.names])
    reduced = density.Reduced.of(target, draws, medians, problem.PRIOR_SD)
    u = target.from_parameters(draws[:300])
    sds = u.std(axis=0)
    u[100:] += sds * np.random.default_rng(1).standard_normal((200, sds.size))
    u = u[reduced.distance(target.to_parameters(u)[0]) < density.RADIUS]
    assert len(u) > 100
    assert density.check(target(u), np.array([reduced.with_gradient(x)[0] for x in u])) < 1e-8
    for x in u[:: len(u) // 20]:
        steps = 1e-4 * np.diag(sds)
        up, down = (
            np.array([reduced.with_gradient(x + sign * s)[0] for s in steps]) for sign in (1, -1)
        )
        by_differences = (up - down) / 2e-4
        # kinks and the third derivative of a density whose sds are one in these units
        np.testing.assert_allclose(
            reduced.with_gradient(x)[1] * sds, by_differences, rtol=1e-4, atol=1e-2
        )
