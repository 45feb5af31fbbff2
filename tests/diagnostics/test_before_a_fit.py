"""What makes any fit doubtful, on motions and torques that are known exactly."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayesfric.diagnostics.before_a_fit import (
    best_share,
    doubts_before,
    few_outputs,
    little_explained,
    strange_velocity,
)
from bayesfric.diagnostics.explanation import too_few_outputs
from bayesfric.diagnostics.statistics import LEAST_OUTPUTS
from bayesfric.estimates.point_estimate import EstimatedValue
from tests.axis import AXIS, VALUES


def totals(**values):
    rows = [
        EstimatedValue(name.replace("__", "."), "", "", "", value, sd, robust)
        for name, (value, sd, robust) in values.items()
    ]
    return SimpleNamespace(values=rows)


@pytest.mark.parametrize("sigma", [0.01, 0.3])
def test_the_best_share_is_that_of_dense_least_squares(make_observation, sigma):
    observations = [
        make_observation(AXIS, VALUES, sigma=sigma, seed=k, n=900 + 100 * k) for k in (1, 2)
    ]
    rows = [
        np.stack([o.qdd, o.qd, np.sign(o.qd), np.sin(o.q), np.ones_like(o.q)], axis=1)
        for o in observations
    ]
    x, y = np.concatenate(rows), np.concatenate([o.measured for o in observations])
    left = y - x @ np.linalg.lstsq(x, y)[0]
    share, residual = best_share(AXIS, observations)
    assert share == pytest.approx(1.0 - np.var(left) / np.var(y))
    np.testing.assert_allclose(residual, left, atol=1e-9)


def test_unexplained_torque_is_doubted_where_it_is_no_white_noise(make_observation):
    """From a fifth of the variance on."""
    o = make_observation(AXIS, VALUES, sigma=0.0, amplitude=1.2)
    slow = np.sin(2.0 * np.pi * 9.0 * o.stamps)
    white = np.random.default_rng(1).standard_normal(o.q.size)
    for extra, doubted in ((0.6 * slow, False), (0.85 * slow, True), (1.0 * white, False)):
        torque = o.torque + o.measured.std() * extra
        observations = [replace(o, torque=torque, compared=torque, measured=o.filter.apply(torque))]
        share = best_share(AXIS, observations)[0]
        assert (share < 0.8) == (np.ptp(extra) > 1.5)
        doubts = little_explained(AXIS, observations)
        assert [x["share"] for x in doubts] == [share] * doubted


def test_too_few_outputs_say_how_many_would_do():
    def observations(*outputs):
        return [SimpleNamespace(measured=np.zeros(n), steady=False) for n in outputs]

    enough, few = (observations(10, LEAST_OUTPUTS - missing) for missing in (5, 6))
    assert list(few_outputs(enough, 5)) == []
    assert [too_few_outputs(AXIS, x) for x in (enough, few)] == [None, "few"]
    (doubt,) = few_outputs(few, 5)
    assert doubt["wanted"] == 5 + LEAST_OUTPUTS
    assert doubt["times"] == (5 + LEAST_OUTPUTS) / (4 + LEAST_OUTPUTS)


def test_settings_of_preprocessing_are_doubts_of_recordings():
    settings = {
        "a": {"velocity_factor": 0.0, "feedback": "sign"},
        "b": {},
        "c": {"feedback": "sign"},
        "d": {"feedback": "position", "velocity_factor": 57.3},
        "e": {"band_doubted": 9.0, "band_narrower": 4.0, "inertia_narrower": 1.3},
        "f": {"band_doubted": 7.0, "band_narrower": 3.0, "inertia_narrower": 1.9},
    }
    observations = [SimpleNamespace(name=name, settings=x) for name, x in settings.items()]
    factors = [(x["recording"], x["factor"]) for x in strange_velocity(observations)]
    assert factors == [("a", 0.0), ("d", 57.3)]
    assert doubts_before(totals(), observations) == [
        {"kind": "feedback", "law": "sign", "recordings": ["a", "c"]},
        {"kind": "feedback", "law": "position", "recordings": ["d"]},
        {"kind": "attenuated", "bands": {"e": [9.0, 4.0], "f": [7.0, 3.0]}, "times": 1.9},
    ]
    assert doubts_before(totals(), observations[1:2]) == []


def test_losses_and_inertias_below_zero_by_three_sds_are_doubted():
    """The larger sd counts; what may have either sign, or bends a curve, is none."""
    rows = doubts_before(
        totals(
            inertia=(-3.1, 1.0, 0.5), viscous=(-3.1, 0.5, 1.0), coulomb=(-2.9, 1.0, 0.5),
            difference=(-9.0, 1.0, 1.0), offset=(-9.0, 1.0, 1.0), quadratic=(-9.0, 1.0, 1.0),
            gravity=(-9.0, 1.0, 1.0), motor__viscous=(-3.1, 1.0, np.nan),
            motor__coulomb=(-9.0, 1.0, np.inf), joint__viscous_positive=(-9.0, 1.0, 2.0),
            gearbox__load=(-9.0, 1.0, 1.0), load__spring=(-9.0, 1.0, 1.0),
        ),
        [],
    )  # fmt: skip
    below = {"inertia": -3.1, "viscous": -3.1, "joint.viscous_positive": -9.0}
    assert rows == [{"kind": "negative", "values": below}]
