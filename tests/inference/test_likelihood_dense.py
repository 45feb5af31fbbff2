"""Both likelihoods against covariance matrices written out for whole recordings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import block_diag, null_space, toeplitz
from scipy.signal import lsim

from bayesfric.estimates.trajectory import Trajectory
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.noise import Autoregressive
from bayesfric.inference.position_likelihood import PositionLikelihood
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.checks import Rest
from bayesfric.recordings.filters import lay_windows, parallel_taps
from bayesfric.recordings.measurement import Inputs
from tests.axis import AXIS, VALUES, torque_columns
from tests.conftest import made_observation
from tests.inference.test_autoregression import covariance

PARTIAL = np.array([0.7, -0.4, 0.3, 0.2])


class Corners:
    """Stands in for random numbers: draws are the axes, so that noise is its covariance's root."""

    def standard_normal(self, shape):
        return np.eye(*shape)


# --- torque -----------------------------------------------------------------------------------


def observed(name, segments, factor, seed, rest=None):
    """A recording of random motion, some of it not to be used, and torque of the axis but noise."""
    n, rng = segments[-1][1], np.random.default_rng(seed)
    usable = np.ones(n, dtype=bool)
    usable[n // 2 : n // 2 + 9] = False
    taken = lay_windows(parallel_taps(factor, None, 500.0), segments, factor, usable, 0.0)
    time, (q, qd, qdd) = np.arange(n) / 500.0, rng.standard_normal((3, n))
    torque = torque_columns(q, qd, qdd) @ AXIS.vector(VALUES) + 0.1 * rng.standard_normal(n)
    observation = made_observation(
        name, time, (q, qd, qdd), torque, taken, factor / 500.0, Inputs(recording=name)
    )
    number = np.searchsorted([b for _, b in segments], taken.starts, side="right")
    return replace(observation, segment_of=number, rest=rest)


RESTED = Rest(np.array([0.0, 0.5, -0.7]), np.array([0.1, 1.4, -2.0]), np.zeros(3))
OBSERVED = (
    observed("first", ((0, 90), (90, 130), (140, 143), (150, 151)), 1, 0),
    observed("second", ((0, 200), (200, 331)), 5, 1, RESTED),
    observed("third", ((0, 60),), 2, 2),
)


def dense(o, sigma, partial):
    """Covariance of the outputs: autoregressive from window to next window, else independent."""
    near = np.diff(o.filter.starts) == round(o.period * 500.0)
    ends = np.flatnonzero(~(near & (np.diff(o.segment_of) == 0))) + 1
    lengths = np.diff(np.concatenate([[0], ends, [o.measured.size]]))
    return sigma**2 * block_diag(*(covariance(partial, k) for k in lengths))


@pytest.fixture(scope="module", params=[0, 1, 2, 4])
def torque(request):
    order = request.param
    likelihood = TorqueLikelihood(AXIS, OBSERVED, Autoregressive(order))
    rng = np.random.default_rng(order)
    values = AXIS.vector(VALUES) * rng.uniform(0.8, 1.2, (3, len(AXIS.names)))
    scales = np.empty((3, 3, 1 + order))
    scales[..., 0] = rng.uniform(0.1, 0.3, (3, 3))
    scales[..., 1:] = PARTIAL[:order] * rng.uniform(0.5, 1.0, (3, 1, 1))
    residuals = [
        o.measured - o.filter.apply(values @ torque_columns(o.q, o.qd, o.qdd).T) for o in OBSERVED
    ]
    return likelihood, values, scales, residuals


def test_torque_is_the_multivariate_normal_of_every_recording_s_own(torque):
    likelihood, values, scales, residuals = torque
    for r, (o, predicted) in enumerate(zip(OBSERVED, likelihood.predict(values), strict=True)):
        np.testing.assert_allclose(o.measured - predicted, residuals[r], atol=1e-12)
    terms = likelihood.pointwise(values, scales)
    total = likelihood.log_density(values, scales)
    for v in range(3):
        expected = 0.0
        for r, o in enumerate(OBSERVED):
            normal = stats.multivariate_normal(cov=dense(o, scales[v, r, 0], scales[v, r, 1:]))
            density = normal.logpdf(residuals[r][v])
            assert terms[r][v].sum() == pytest.approx(density, rel=1e-9)
            expected += density
        # what standstill says: the noise of one output takes the torque into the limits
        value = dict(zip(AXIS.names, values[v], strict=True))
        middle = 9.80665 * value["load.first_moment"] * np.sin(RESTED.q) + value["offset"]
        sd = np.sqrt(dense(OBSERVED[2], scales[v, 1, 0], scales[v, 1, 1:])[0, 0])
        low, high = middle - value["motor.coulomb"], middle + value["motor.coulomb"]
        stays = (
            stats.norm.logcdf((high - RESTED.torque) / sd),
            stats.norm.logcdf((low - RESTED.torque) / sd),
        )
        expected += np.sum(stays[0] + np.log1p(-np.exp(stays[1] - stays[0])))
        assert total[v] == pytest.approx(expected, rel=1e-6)
    squares = [np.sum(x**2, axis=1) for x in residuals]
    np.testing.assert_allclose(likelihood.sum_of_squares(values), np.transpose(squares), rtol=1e-9)


def test_torque_noise_is_drawn_and_whitened_by_its_covariance(torque):
    likelihood, _, scales, residuals = torque
    scale = scales[1]
    white = likelihood.innovations(residuals, scale)
    sds = likelihood.noise_sd(scale)
    for r, o in enumerate(OBSERVED):
        cov = dense(o, scale[r, 0], scale[r, 1:])
        square = np.einsum("vm,vm->v", residuals[r], np.linalg.solve(cov, residuals[r].T).T)
        np.testing.assert_allclose(np.sum(white[r] ** 2, axis=1), square, rtol=1e-9)
        np.testing.assert_allclose(sds[r], np.sqrt(np.diag(cov)), rtol=1e-9)
    # draws, whitened, are the random numbers that they are made of
    rng = np.random.default_rng(5)
    drawn = likelihood.draw_noise(scales, np.random.default_rng(5))
    for r, (o, draws) in enumerate(zip(OBSERVED, drawn, strict=True)):
        roots = [np.linalg.cholesky(dense(o, s[r, 0], s[r, 1:])) for s in scales]
        normals = [np.linalg.solve(root, d) for root, d in zip(roots, draws, strict=True)]
        np.testing.assert_allclose(normals, rng.standard_normal(draws.shape), atol=1e-8)


@pytest.mark.parametrize("order", [0, 1, 3])
def test_information_of_scales_is_that_of_a_long_normal_vector(order):
    """Half the trace of ``V^-1 dV V^-1 dV'``, to first order in one over the outputs."""
    n, scales = 600, np.array([0.3, *PARTIAL[:order]])
    noise = Autoregressive(order)

    def cov(s):
        return s[0] ** 2 * covariance(s[1:], n)

    slopes = []
    for step in 1e-5 * np.eye(scales.size):
        slope = (cov(scales + step) - cov(scales - step)) / 2e-5
        slopes.append(np.linalg.solve(cov(scales), slope))
    exact = np.array([[0.5 * np.trace(a @ b) for a in slopes] for b in slopes])
    information = noise.information(scales, n)
    root = np.sqrt(np.diag(exact))
    np.testing.assert_allclose(
        information / root / root[:, None], exact / root / root[:, None], atol=0.03
    )


# --- position ---------------------------------------------------------------------------------

# inertia and viscous loss alone: position is linear in torque and state
LINEAR = Joint(elements=(Element("motor", inertia=True, viscous=True),), load=Load())
INERTIA, VISCOUS, PERIOD = 0.01, 0.2, 0.002
POINT = np.array([INERTIA, VISCOUS])
SYSTEM = ([[0.0, 1.0], [0.0, -VISCOUS / INERTIA]], [[0.0], [1.0 / INERTIA]], [[1.0, 0.0]], [[0.0]])
SCALES = np.array([[0.05, 1e-3], [0.4, 2e-3], [1e-3, 1e-3]])


def response(torque, state, hold):
    """Position by SciPy, exact for a torque that is held or linear between samples."""
    time = PERIOD * np.arange(torque.size)
    return lsim(SYSTEM, torque, time, X0=state, interp=hold == "linear")[1]


def by_samples(n, hold):
    """How each torque sample moves each position: all but the first alike, later and later."""
    first, second = (response(row, (0.0, 0.0), hold) for row in np.eye(n)[:2])
    moved = toeplitz(np.append(second[1:], 0.0), np.zeros(n))
    moved[:, 0] = first
    return moved


class Run:
    """One recording of the linear joint, with the matrices of its likelihood."""

    def __init__(self, name, segments, factor, hold, seed):
        rng = np.random.default_rng(seed)
        n = segments[-1][1] + 5
        torque, time = np.sin(0.3 * np.arange(n)), 1.0 + PERIOD * np.arange(n)
        position = 1e-3 * rng.standard_normal(n)
        self.averaged, self.time, self.free, self.noise, self.parts = [], [], [], [], []
        for a, b in segments:
            position[a:b] += response(torque[a:b], (0.1, 0.3), hold)
            blocks = (b - a) // factor
            if blocks < 4:
                continue
            mean = np.kron(np.eye(blocks), np.full(factor, 1.0 / factor))
            mean = np.pad(mean, ((0, 0), (0, b - a - blocks * factor)))
            by_torque = mean @ by_samples(b - a, hold)
            rest = np.zeros(b - a)
            state = mean @ np.stack([response(rest, x, hold) for x in np.eye(2)], axis=1)
            self.averaged.append(mean @ position[a:b])
            self.time.append(mean @ time[a:b])
            free = null_space(state.T)
            self.free.append(free)
            exact = mean @ response(torque[a:b], (0.1, 0.3), hold)
            self.noise.append(self.averaged[-1] - exact)
            self.parts.append((by_torque @ by_torque.T, np.eye(blocks) / factor, state))
        starts = np.array(segments)
        # not quite where it starts
        states = np.full(len(segments), 0.11), np.full(len(segments), 0.25)
        self.trajectory = Trajectory(
            name, time, position, torque, PERIOD, starts, *states, inputs=Inputs(), hold=hold
        )

    def covariances(self, scales):
        """What noise of both kinds does to the averaged positions, a segment each."""
        return [scales[0] ** 2 * s + scales[1] ** 2 * w for s, w, _ in self.parts]

    def fits(self, covariances):
        """Projections of residuals onto the states, by generalised least squares."""
        for cov, (*_, x) in zip(covariances, self.parts, strict=True):
            weighted = np.linalg.solve(cov, x)
            yield x @ np.linalg.solve(x.T @ weighted, weighted.T)


@pytest.fixture(scope="module", params=["zero", "linear"])
def runs(request):
    recordings = [
        Run("short", ((0, 60), (63, 90), (90, 93)), 1, request.param, 0),
        Run("long", ((4, 310), (310, 517), (520, 526)), 2, request.param, 1),
    ]
    return recordings, PositionLikelihood(LINEAR, [r.trajectory for r in recordings], [], POINT)


def test_position_is_the_normal_of_what_no_state_moves(runs):
    recordings, likelihood = runs
    values, scales = np.tile(POINT, (3, 1)), np.stack([SCALES, SCALES[::-1]], axis=1)
    terms = likelihood.pointwise(values, scales)
    for r, run in enumerate(recordings):
        for v in range(3):
            expected = sum(
                stats.multivariate_normal(cov=f.T @ c @ f).logpdf(f.T @ x)
                for f, c, x in zip(run.free, run.covariances(scales[v, r]), run.noise, strict=True)
            )
            assert terms[r][v].sum() == pytest.approx(expected, rel=1e-4)
    total = sum(t.sum(axis=1) for t in terms)
    np.testing.assert_allclose(likelihood.log_density(values, scales), total)
    for z, t, r in zip(likelihood.standardised(values, scales[0]), terms, (0, 1), strict=True):
        # a normal's exponent is half of the square
        sd = np.concatenate(
            [
                np.sqrt(np.linalg.eigvalsh(f.T @ c @ f))
                for f, c in zip(
                    recordings[r].free, recordings[r].covariances(scales[0, r]), strict=True
                )
            ]
        )
        logs = np.log(sd).sum() + 0.5 * sd.size * np.log(2.0 * np.pi)
        np.testing.assert_allclose(-0.5 * np.sum(z[0] ** 2) - logs, t[0].sum(), rtol=1e-4)


def test_outputs_are_averages_of_segments_that_are_long_enough(runs):
    recordings, likelihood = runs
    for run, out in zip(recordings, likelihood.outputs, strict=True):
        np.testing.assert_allclose(out.measured, np.concatenate(run.averaged), rtol=1e-12)
        np.testing.assert_allclose(out.time, np.concatenate(run.time), rtol=1e-12)
        steps = np.diff(out.time)
        np.testing.assert_allclose(steps[out.follows], out.period)
        number = np.repeat(np.arange(2), [x.size for x in run.averaged])
        np.testing.assert_array_equal(out.segment_of, number)
        np.testing.assert_array_equal(out.follows, np.diff(number) == 0)
        assert (out.name, out.quantity, out.unit) == (run.trajectory.name, "joint position", "rad")


def test_position_noise_is_drawn_about_the_best_states(runs):
    recordings, likelihood = runs
    scales = SCALES[:2]
    n = 1 + max(x.size for run in recordings for x in run.averaged)
    drawn = likelihood.draw_noise(np.tile(scales, (n, 1, 1)), Corners())
    sds = likelihood.noise_sd(scales)
    for run, draws, sd, s in zip(recordings, drawn, sds, scales, strict=True):
        cov = run.covariances(s)
        remaining = [c - fit @ c for c, fit in zip(cov, run.fits(cov), strict=True)]
        np.testing.assert_allclose(
            sd**2, np.concatenate([np.diag(c) for c in remaining]), rtol=1e-4
        )
        borders = np.cumsum([0, *(len(c) for c in remaining)])
        for c, a, b in zip(remaining, borders[:-1], borders[1:], strict=True):
            block = draws[:, a:b]
            np.testing.assert_allclose(block.T @ block, c, atol=1e-4 * np.abs(c).max())


def test_predicted_positions_start_where_torque_s_noise_would_have_it(runs):
    recordings, likelihood = runs
    predicted = likelihood.predict(POINT[None])
    for run, positions in zip(recordings, predicted, strict=True):
        # what the joint integrates, and next to nothing of the encoder's, which it leaves open
        cov = [s + 1e-9 * np.trace(s) * np.eye(len(s)) for s, *_ in run.parts]
        expected = [
            x - e + fit @ e
            for x, e, fit in zip(run.averaged, run.noise, run.fits(cov), strict=True)
        ]
        np.testing.assert_allclose(positions[0], np.concatenate(expected), atol=1e-6)


def test_information_of_both_noises_is_that_of_a_normal_vector(runs):
    recordings, likelihood = runs
    scales = SCALES[:2]
    information = likelihood.noise_information(scales)
    for run, s, block in zip(recordings, scales, information, strict=True):
        exact = np.zeros((2, 2))
        for f, c, (*parts, _) in zip(run.free, run.covariances(s), run.parts, strict=True):
            inverse = np.linalg.inv(f.T @ c @ f)
            slopes = [inverse @ (f.T @ (2.0 * a * p) @ f) for a, p in zip(s, parts, strict=True)]
            exact += [[0.5 * np.trace(x @ y) for x in slopes] for y in slopes]
        np.testing.assert_allclose(block, exact, rtol=1e-4)


def test_a_joint_that_sticks_stays_where_its_positions_have_it():
    """No torque moves it: what is left of the encoder's noise is white, all but the state's."""
    held = Joint(elements=(Element("motor", inertia=True, coulomb="symmetric"),), load=Load())
    noise = 1e-4 * np.random.default_rng(6).standard_normal(240)
    time, still = PERIOD * np.arange(240), np.zeros(2)
    t = Trajectory(
        "held", time, 0.1 + noise, np.full(240, 0.02), PERIOD, np.array([(0, 120), (120, 240)]),
        0.1 + still, still, inputs=Inputs(),
    )  # fmt: skip
    point = np.array([0.01, 0.3])
    likelihood = PositionLikelihood(held, [t], [], point)
    scales = np.array([[[0.5, 1e-4]]])
    # a speed would carry it no further than the first sample
    state = np.stack([np.ones(120), np.arange(120) > 0], axis=1)
    free = null_space(state.T)
    normal = stats.multivariate_normal(cov=1e-8 * np.eye(118))
    expected = sum(normal.logpdf(x @ free) for x in np.split(noise, 2))
    assert likelihood.log_density(point[None], scales)[0] == pytest.approx(expected, rel=1e-6)
    (positions,) = likelihood.predict(point[None])
    for part, x in zip(np.split(positions[0], 2), np.split(0.1 + noise, 2), strict=True):
        np.testing.assert_allclose(part[1:], x[1:].mean(), atol=1e-9)


def test_where_one_segment_runs_away_the_vector_is_impossible():
    run = Run("short", ((0, 60), (63, 123)), 1, "linear", 0)
    torque = run.trajectory.torque.copy()
    torque[63:] = 1e12
    t = replace(run.trajectory, torque=torque)
    likelihood = PositionLikelihood(LINEAR, [t], [], POINT)
    assert likelihood.log_density(POINT[None], SCALES[:1, None])[0] == -np.inf
