"""What the model's own error does to intervals: closed forms, and joints known to be otherwise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import bayesfric as bf
from bayesfric.commands.fit import demo_config
from bayesfric.inference.model_error import (
    ALLOWED,
    ModelError,
    _beside,
    _spread,
    _Whitened,
    model_error,
)
from tests.axis import AXIS, VALUES, swing

QUICK = {"min_ess": 400, "ensembles": 2, "walkers": 24}
UNCHECKED = {"self_check": {"recordings": 0}, "sampling": QUICK}
LINES = [(0.31, 0.9), (0.73, 0.5), (1.9, 0.15)]


def mean_of(samples):
    """Regression on a constant alone, noise of one, in units of the posterior's sd."""
    n = samples.size
    rows = np.full((n, 1), 1.0 / np.sqrt(n))
    residual = samples - samples.mean()
    return _Whitened(rows, residual, 1, residual, np.array([[1.0 / np.sqrt(n)]]), np.zeros((1, 1)))


def test_groups_of_a_mean_are_the_analysis_of_variance():
    """The F test of equal means, and the variance of a mean of independent groups."""
    rng = np.random.default_rng(1)
    groups = np.repeat(np.arange(4), 50)
    samples = rng.standard_normal(200) + np.array([1.0, -0.5, 0.3, 2.0])[groups]
    excess, p_value = _spread(mean_of(samples), groups)
    parts = np.split(samples, 4)
    means = np.array([part.mean() for part in parts])
    test = stats.f_oneway(*parts)
    assert p_value == pytest.approx(test.pvalue)
    between = (1.0 - 1.0 / test.statistic) * means.var(ddof=1) / 4
    assert excess[0, 0] / 200 == pytest.approx(between)


def test_groups_that_differ_as_noise_lets_them_add_next_to_nothing():
    """Of equal groups the variance over the posterior's is a chi square's, and F tells it."""
    rng = np.random.default_rng(2)
    groups = np.repeat(np.arange(4), 25)
    found = [_spread(mean_of(rng.standard_normal(100)), groups) for _ in range(2000)]
    between = stats.chi2.rvs(3, size=200_000, random_state=3) / 3.0
    within = stats.chi2.rvs(96, size=200_000, random_state=4) / 96.0
    expected = between * np.clip(1.0 - within / between, 0.0, None)
    error = expected.std() / np.sqrt(2000)
    added = np.mean([one[0][0, 0] for one in found])
    assert added == pytest.approx(expected.mean(), abs=4.0 * error)
    p_values = [one[1] for one in found]
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3


def test_one_group_says_nothing():
    assert _spread(mean_of(np.arange(20.0)), np.zeros(20, dtype=np.int64)) is None


def recording(**extra):
    """Simulate, by the inverse model, a swing of the joint, with terms that ``AXIS`` lacks."""
    time = np.arange(0.0, 30.0, 0.005)
    q, qd, qdd = swing(time, LINES)
    torque = (
        VALUES["motor.inertia"] * qdd
        + VALUES["motor.viscous"] * qd
        + VALUES["motor.coulomb"] * np.sign(qd)
        + 9.81 * VALUES["load.first_moment"] * np.sin(q)
        + VALUES["offset"]
        + extra.get("cubic", 0.0) * qd**3
    )
    noise = 0.02 * np.random.default_rng(extra.get("seed", 0)).standard_normal(time.size)
    return bf.Recording.from_arrays(time, q, torque + noise)


def fitted(**extra):
    return bf.Model(AXIS, recording(**extra), **UNCHECKED).fit(seed=1)


@pytest.fixture(scope="module")
def right():
    return fitted()


@pytest.fixture(scope="module")
def wrong():
    return fitted(cubic=0.005)


def test_a_right_model_keeps_its_intervals(right):
    assert right.summary.model_error.reason is None
    assert not right.summary.model_error.shown
    for row in right.summary.joint.values():
        assert row.model_error_interval is None
        assert row.told_interval == row.interval


def test_a_wrong_model_gets_wider_ones_and_keeps_its_posterior(wrong):
    assert wrong.summary.model_error.shown
    assert "speed" in wrong.summary.model_error.found
    row = wrong.summary.parameters["motor.viscous"]
    low, high = row.model_error_interval
    assert low < row.interval[0] < row.interval[1] < high
    assert row.told_sd > 3.0 * row.sd
    draws = wrong.fit.posterior.flat()[:, wrong.fit.posterior.names.index("motor.viscous")]
    assert row.interval == pytest.approx(np.quantile(draws, [0.05, 0.95]))


@pytest.mark.parametrize("share", [0.0, 0.2, 0.9, 1.0])
@pytest.mark.parametrize("excess", [0.0, 0.5, 1e6])
def test_model_error_is_in_what_the_data_tell(share, excess):
    """Precisions add: the prior's share of one as it is, the data's with its variance grown."""
    data = 1.0 - share
    with np.errstate(divide="ignore"):
        variance = np.inf if data == 0.0 else 1.0 / data + excess / data**2
    whole = 1.0 / (share + 1.0 / variance)
    found = _beside(np.array([[share]]), np.array([[excess]]))[0, 0]
    assert 1.0 + found == pytest.approx(whole)


def test_what_is_told_stays_as_narrow_as_it_is_told(wrong):
    """A loss told to 1 % was widened to 7 % by data that do not suit it."""
    free = wrong.summary.parameters["motor.viscous"]
    told = {"distribution": "norm", "loc": free.median, "scale": 0.5 * free.sd}
    model = bf.Model(AXIS, recording(cubic=0.005), priors={"motor.viscous": told}, **UNCHECKED)
    found = model.fit(seed=1).summary
    assert found.model_error.shown
    # draws: 400 independent ones at least, a standard deviation known to 3.5 %, three of them
    assert found.parameters["motor.viscous"].told_sd < 1.1 * 0.5 * free.sd
    assert found.parameters["motor.coulomb"].told_sd > 1.5 * found.parameters["motor.coulomb"].sd


def test_another_motion_lies_within(wrong):
    """A cubic loss is another line without its fastest quarter: that is still in the interval."""
    time = np.arange(0.0, 30.0, 0.005)
    _, qd, _ = swing(time, LINES)
    slow = np.abs(qd) < np.quantile(np.abs(qd), 0.75)
    columns = np.stack([qd[slow], np.sign(qd[slow])], axis=1)
    cubic = np.linalg.lstsq(columns, 0.005 * qd[slow] ** 3, rcond=None)[0]
    row = wrong.summary.parameters["motor.viscous"]
    best = VALUES["motor.viscous"] + cubic[0]
    assert row.told_interval[0] < best < row.told_interval[1]
    assert not row.interval[0] < best < row.interval[1]


def test_draws_move_by_the_covariance_and_stay_within_bounds(right):
    target, posterior = right.fit.target, right.fit.posterior
    draws = posterior.flat()
    d = len(target.names)
    root = np.diag(np.where(np.arange(d) == target.names.index("motor.coulomb"), 30.0, 0.0))
    # however badly a draw then fits
    misfit = 1e12 * np.eye(d)
    error = ModelError((bf.inference.model_error.Axis("speed", 4, 0.0),), root, misfit)
    moved = error.widened(target, draws, np.random.default_rng(1))
    assert np.array_equal(moved, error.widened(target, draws, np.random.default_rng(1)))
    j = target.names.index("motor.coulomb")
    assert (moved[:, j] > 0.0).all()
    assert moved[:, j].std() > 5.0 * draws[:, j].std()
    others = [k for k in range(d) if k != j]
    np.testing.assert_allclose(moved[:, others], draws[:, others], rtol=1e-9)


def test_a_draw_that_would_not_fit_is_moved_by_less(right):
    """Where the torque is not linear, a move is halved until its chi squared is as foretold."""
    target, posterior = right.fit.target, right.fit.posterior
    draws, d = posterior.flat(2000), len(target.names)
    axes = (bf.inference.model_error.Axis("speed", 4, 0.0),)
    u = target.from_parameters(draws)
    root = 20.0 * np.linalg.cholesky(np.cov(u.T))
    free = ModelError(axes, root, 1e12 * np.eye(d))
    held = ModelError(axes, root, np.zeros((d, d)))

    def worse(moved):
        return 2.0 * (target.log_likelihood(draws) - target.log_likelihood(moved))

    rng = np.random.default_rng
    assert np.median(worse(free.widened(target, draws, rng(1)))) > 100.0
    assert worse(held.widened(target, draws, rng(1))).max() <= ALLOWED * d


def test_a_knee_is_widened_where_its_torque_is_straight():
    """Draws with room for the model's error still fit the recording they are from.

    The packaged knee's posterior is bent in the leg's shares; moved along those, most draws left
    the recording by thirty times its noise.
    """
    found = bf.Model.from_config(demo_config()).fit(seed=1).fit
    # its model is right; were it not, this much room it would get
    assert not found.model_error.shown
    found = replace(found, model_error=model_error(found.target, found.posterior, wrong=True))
    assert found.model_error.shown
    target = found.target
    worse = np.array([
        2.0 * (np.median(target.log_likelihood(found.posterior.flat(500)))
               - np.quantile(target.log_likelihood(found.wide.posterior.flat(500)), q))
        for q in (0.5, 0.05)
    ])  # fmt: skip
    # a misfit of model error's size: some hundreds for eleven parameters, not a million
    assert worse[0] < 200.0
    assert worse[1] < 1000.0


LOSSY = bf.Joint(
    [
        bf.Element("motor", coulomb="symmetric", viscous=True),
        bf.Element("gearbox", load_loss="one"),
    ],
    load=bf.Load(inertia=True, first_moment=True, gravity_angle=True),
    offset=True,
)
OF_LOSSY = {
    "motor.viscous": 0.1, "motor.coulomb": 0.3, "gearbox.load": 0.01, "load.inertia": 0.05,
    "load.first_moment": 0.3, "load.gravity_angle": 0.1, "offset": 0.05,
}  # fmt: skip


@pytest.fixture(scope="module")
def lossy(lossy_recording):
    """Fit that."""
    return bf.Model(LOSSY, lossy_recording, **UNCHECKED).fit(seed=1)


@pytest.fixture(scope="module")
def lossy_recording():
    """Simulate, by the inverse model, a joint that hardly loses of its load, and a cubic loss."""
    time = np.arange(0.0, 30.0, 0.005)
    q, qd, qdd = swing(time, LINES)
    torque = LOSSY.torque(OF_LOSSY, q, qd, qdd) + 0.005 * qd**3
    noise = 0.02 * np.random.default_rng(5).standard_normal(time.size)
    return bf.Recording.from_arrays(time, q, torque + noise)


def test_no_coordinate_is_scaled_by_rounding(lossy):
    """A gearbox' coordinates are not one for one with parameters: some went by widths of 1e-12."""
    target, posterior = lossy.fit.target, lossy.fit.posterior
    sds = target.from_parameters(posterior.flat(2000)).std(axis=0)
    assert (sds < 100.0).all()


def test_model_error_leaves_sizes_beside_a_load_loss_near_nothing(lossy):
    """MEASURED, it once gave a moment of 11.1 kg m the interval from -240 to 290."""
    assert lossy.summary.model_error.shown
    wide = lossy.fit.wide.posterior
    assert np.isfinite(lossy.fit.target.log_prior(wide.flat())).all()
    for name in ("load.first_moment", "load.inertia"):
        row = lossy.summary.parameters[name]
        assert row.told_interval[0] <= row.median <= row.told_interval[1]
        assert row.told_interval[0] < OF_LOSSY[name] < row.told_interval[1]
        assert row.told_sd < 0.3 * OF_LOSSY[name]


def test_a_loss_that_may_be_none_for_the_models_error_makes_limits(lossy):
    """Measured, UR10e: mu at most 0.020, and alpha from 0.980 to 0.9996 beside it as data's."""
    rows = lossy.summary.rows
    assert rows["gearbox.load"].at_bound == "lower"
    assert rows["gearbox.alpha_drive"].at_bound == "upper"
    assert rows["gearbox.alpha_back"].at_bound == "lower"


def test_a_known_load_loss_is_allowed_for(lossy_recording):
    """Fixing what the data cannot tell from nothing is the natural mend; it once crashed."""
    model = bf.Model(LOSSY, lossy_recording, priors={"gearbox.load": 0.0}, **UNCHECKED)
    assert model.fit(seed=1).summary.model_error.shown


def test_a_move_s_size_does_not_go_by_the_coordinates(wrong):
    """Some coordinates a million million times as large: the same groups, the same widening."""
    target, posterior = wrong.fit.target, wrong.fit.posterior
    other = target.with_widths(np.where(np.arange(len(target.names)) % 2, 1e-12, 1.0))
    draws, moved, chances = posterior.flat(2000), [], []
    for t in (target, other):
        error = model_error(t, posterior)
        chances.append([axis.p_value for axis in error.axes])
        moved.append(error.widened(t, draws, np.random.default_rng(1)))
    # lines are drawn through coordinates that are bent otherwise
    assert chances[0] == pytest.approx(chances[1], rel=0.1)
    # near a bound they are skewed otherwise, and that is not what this asks
    one, two = (each.std(axis=0) for each in moved)
    np.testing.assert_allclose(one, two, rtol=0.3)


def test_without_model_error_draws_are_the_same(right):
    error = model_error(right.fit.target, right.fit.posterior)
    draws = right.fit.posterior.flat()
    assert error.widened(right.fit.target, draws, np.random.default_rng(1)) is draws
