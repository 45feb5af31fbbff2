"""Priors against SciPy and against what cannot be."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.estimates.least_squares import typical_sizes
from bayesfric.inference.fitting import read_priors
from bayesfric.inference.noise import SCALES
from bayesfric.inference.priors import as_knowledge, default_prior, read_prior
from bayesfric.mechanism.joint import PRESETS
from bayesfric.mechanism.quantities import TypicalSizes

INF = math.inf


def positive(text):
    return read_prior("motor.inertia", text, lower=0.0, upper=INF)


FAMILIES = [
    ({"distribution": "norm", "loc": 0.2}, stats.norm(0.2)),
    ({"distribution": "norm", "loc": 2.0, "scale": 0.5}, stats.norm(2.0, 0.5)),
    ({"distribution": "halfnorm", "scale": 0.5}, stats.halfnorm(scale=0.5)),
    ({"distribution": "halfnorm", "loc": 1.0, "scale": 0.5}, stats.halfnorm(1.0, 0.5)),
    ({"distribution": "lognorm", "s": 0.5, "scale": 2.0}, stats.lognorm(0.5, scale=2.0)),
    ({"distribution": "loguniform", "a": 1e-3, "b": 10.0, "loc": 0.2, "scale": 2.0},
     stats.loguniform(1e-3, 10.0, 0.2, 2.0)),
    ({"distribution": "uniform", "loc": 1.0, "scale": 2.0}, stats.uniform(1.0, 2.0)),
    ({"distribution": "gamma", "a": 3.0, "scale": 0.2}, stats.gamma(3.0, scale=0.2)),
    ({"distribution": "truncnorm", "a": 0.0, "b": 2.0}, stats.truncnorm(0.0, 2.0)),
    ([0.1, 2.5], stats.uniform(0.1, 2.4)),
]  # fmt: skip


@pytest.mark.parametrize(("text", "reference"), FAMILIES, ids=lambda f: str(f)[:40])
def test_densities_and_draws_are_scipys_up_to_the_cut(text, reference):
    prior = positive(text)
    x = np.concatenate([np.linspace(-0.997, 12.003, 131), [1e-9, 1e3]])
    inside = x >= 0.0
    expected = reference.logpdf(x[inside]) - np.log(1.0 - reference.cdf(0.0))
    np.testing.assert_allclose(prior.log_density(x)[inside], expected, rtol=1e-12, atol=1e-12)
    outside = np.append(x[~inside], np.nan)
    assert np.isneginf(prior.log_density(outside)).all()
    below = reference.cdf(0.0)
    draws = prior.draw(4000, np.random.default_rng(1))
    # fixed seed; the threshold is a one-in-ten-thousand event
    assert stats.kstest(draws, lambda y: (reference.cdf(y) - below) / (1.0 - below)).pvalue > 1e-4


@given(st.floats(-1.0, 2.0), st.floats(0.4, 3.0))
def test_a_truncated_prior_integrates_to_one_and_has_its_moments(loc, scale):
    prior = positive({"distribution": "norm", "loc": loc, "scale": scale})

    # Gauss and Legendre: exact to rounding for a density that is smooth up to its cut
    nodes, weights = np.polynomial.legendre.leggauss(200)
    half = (loc + 12.0 * scale) / 2.0
    density = half * weights * np.exp(prior.log_density(half * (1.0 + nodes)))

    def moment(power):
        return float(density @ (half * (1.0 + nodes)) ** power)

    assert moment(0) == pytest.approx(1.0, abs=1e-7)
    assert prior.mean() == pytest.approx(moment(1), rel=1e-3)
    assert prior.sd() == pytest.approx(math.sqrt(moment(2) - moment(1) ** 2), rel=1e-3)


def angle(text):
    return read_prior("load.gravity_angle", text, lower=-INF, upper=INF, circular=True)


@pytest.mark.parametrize(
    "text", [[0.0, 6.283], [-math.pi, math.pi], [3.0, 9.2832], [-3.14, 3.14], [0, 6.3]]
)
def test_a_whole_turn_has_no_ends_and_is_cut_anywhere(text):
    prior = angle(text)
    assert prior.whole_turn
    assert prior.upper - prior.lower == pytest.approx(2.0 * math.pi, rel=1e-15)
    assert prior.limits == (-INF, INF)
    moved = prior.cut_opposite(-3.1)
    np.testing.assert_allclose([moved.lower, moved.upper], [-3.1 - math.pi, -3.1 + math.pi])
    x = np.array([3.1, -3.1 - 3.0, 0.0])
    expected = [-INF, *2 * [-math.log(2.0 * math.pi)]]
    np.testing.assert_allclose(moved.log_density(x), expected)
    assert moved.turned(x)[0] == pytest.approx(3.1 - 2.0 * math.pi)


def test_a_part_of_a_turn_stays_where_it_is_and_a_distribution_is_cut_round_its_median():
    part = angle([2.5, 4.0])
    assert part.cut_opposite(0.0) is part
    assert part.limits == (2.5, 4.0)
    normal = angle({"distribution": "norm", "loc": 3.14, "scale": 2.0})
    assert (normal.lower, normal.upper) == pytest.approx((3.14 - math.pi, 3.14 + math.pi))
    assert normal.cut_opposite(0.0) is normal
    with pytest.raises(BadInput, match="more than one turn") as caught:
        angle([0.0, 6.4])
    assert caught.value.hint


@pytest.mark.parametrize("preset", PRESETS)
def test_default_priors_hold_the_presets_own_values(preset):
    chain = PRESETS[preset].chain()
    scales = TypicalSizes(torque=1.0, speed=2.0, acceleration=30.0)
    for p in chain.parameters:
        prior = default_prior(chain, p, scales)
        assert prior.default
        assert p.lower <= prior.lower < prior.upper <= p.upper
        density = prior.log_density(np.array([PRESETS[preset].values[p.name]]))
        assert np.isfinite(density).all(), p.name


def test_stored_energy_may_exceed_the_motor_torque():
    """A pendulum at its own frequency: the motor makes up for friction only."""
    joint = bf.Joint(
        [bf.Element("motor", inertia=True, viscous=True)], load=bf.Load(first_moment=True)
    )
    t = np.arange(0.0, 20.0, 0.01)
    moment, inertia = 0.35, 0.18
    pace = math.sqrt(9.81 * moment / inertia)
    # grows and falls, or inertia and gravity would be one
    swing = (0.2 + 0.1 * np.sin(0.3 * t)) * np.sin(pace * t)
    qd, qdd = np.gradient(swing, t), np.gradient(np.gradient(swing, t), t)
    true = {"motor.inertia": inertia, "motor.viscous": 0.02, "load.first_moment": moment}
    torque = joint.torque(true, swing, qd, qdd)
    recording = bf.Recording.from_arrays(time=t, position=swing, torque=torque)
    scales = typical_sizes(joint, bf.Model(joint, recording).observations, {})
    assert scales.torque < 0.4 * 9.81 * moment * math.sin(0.3)
    sds = {p.name: default_prior(joint, p, scales).sd() for p in joint.parameters}
    assert sds["load.first_moment"] > 0.25 * moment
    assert sds["motor.inertia"] > 0.25 * inertia
    # friction is at most the motor torque
    least = default_prior(joint, joint.parameters[1], replace(scales, exchanged=0.0))
    assert sds["motor.viscous"] == least.sd()


def test_default_scales_follow_the_shaft():
    """A joint loss may be N times the motor's, a joint viscosity N² times."""
    chain = PRESETS["rabbit-knee"].chain()
    scales = TypicalSizes(torque=1.0, speed=2.0, acceleration=40.0)
    sd = {
        p.name: float(p_prior.distribution.kwds["scale"])
        for p in chain.parameters
        if "scale" in (p_prior := default_prior(chain, p, scales)).distribution.kwds
    }
    assert sd["motor.coulomb_positive"] == 1.0
    assert sd["joint.coulomb_positive"] == 50.0
    assert sd["motor.viscous"] == 0.01
    assert sd["joint.viscous"] == pytest.approx(25.0, abs=5.1)  # 25 to one digit
    assert sd["load.inertia"] == pytest.approx(1.25, abs=0.3)
    noise = SCALES["sigma"].read_prior({}, scales)
    assert (noise.lower, noise.upper) == (1e-6, 1.0)


def test_position_noise_may_be_as_small_as_the_encoder_resolves():
    """2^20 counts at a motor behind a ratio of 50: a step is 4e-9 of the joint's range."""
    step = 2.0 * np.pi / 2**20 / 50.0
    sizes = TypicalSizes(
        torque=1.0, speed=2.0, acceleration=40.0, position=30.0, position_step=step
    )
    prior = SCALES["position"].read_prior({}, sizes)
    rounding = step / math.sqrt(12.0)
    assert 0.2 * rounding < prior.lower < 0.5 * rounding
    assert prior.upper == 30.0
    smooth = SCALES["position"].read_prior({}, replace(sizes, position_step=0.0))
    assert smooth.lower == pytest.approx(1e-10 * sizes.position)


def test_a_point_estimate_takes_fixed_values_ranges_and_known_values(make_observation):
    chain = PRESETS["motor-axis"].chain()
    o = make_observation(chain, PRESETS["motor-axis"].values)
    texts = {
        "motor.inertia": 0.01,
        "motor.viscous": [0.01, 0.2],
        "motor.coulomb": {"distribution": "norm", "loc": 0.2, "scale": 0.02},
    }
    knowledge = as_knowledge(chain, read_priors(chain, texts, [o]))
    assert knowledge.fixed == {"motor.inertia": 0.01}
    assert knowledge.bounds["motor.viscous"] == (0.01, 0.2)
    # ten sds above its bound: the cut does not show
    assert knowledge.priors == {"motor.coulomb": pytest.approx((0.2, 0.02))}
    # a default prior is a guess of ours, not knowledge
    assert knowledge.bounds["offset"] == (-math.inf, math.inf)
