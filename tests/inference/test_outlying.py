"""Outputs too far off for noise: how often by chance, and what they must not hide."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bayesfric.inference.model_error import _asked, _of_groups, _Whitened
from bayesfric.inference.outlying import far_off, outlying


def test_chance_has_one_no_oftener_than_it_says():
    rng = np.random.default_rng(6)
    number = 4000
    named = sum(far_off(rng.standard_normal(60)).any() for _ in range(number))
    assert 0.5 * 0.05 < named / number < 0.05 + 3.0 * np.sqrt(0.05 / number)


def test_several_do_not_hide_each_other_and_are_told_in_sds_of_the_others():
    noise = np.random.default_rng(2).standard_normal(100)
    noise[[10, 40, 70]] = 12.0, -11.0, 13.0
    found = far_off(noise)
    assert np.array_equal(np.flatnonzero(found), [10, 40, 70])
    others = np.delete(noise, [10, 40, 70])
    # the nearest of them was held against all that are left
    assert found[40] == pytest.approx(11.0 / np.sqrt(others @ others / 97))


def test_noise_with_long_tails_has_no_outlying_outputs():
    noise = np.random.default_rng(3).standard_t(2, size=3000)
    assert np.abs(noise).max() > 10.0 * np.median(np.abs(noise))
    assert not far_off(noise).any()


def test_one_output_does_not_hide_what_the_others_show():
    """A step between halves of a motion, and one output that makes it look like noise."""
    rng = np.random.default_rng(4)
    n = 120
    place = rng.permutation(np.linspace(-1.0, 1.0, n))
    samples = 0.3 * rng.standard_normal(n) + 0.3 * np.sign(place)
    samples[np.argmax(place)] -= 12.0
    found = {}
    for kept in ("all", "others"):
        some = np.ones(n, dtype=bool)
        some[np.argmax(place)] = kept == "all"
        quarters = np.array_split(samples[some][np.argsort(place[some])], 4)
        found[kept] = stats.f_oneway(*quarters).pvalue
    assert found["all"] > 0.01 > 1e-3 > found["others"]
    told = _asked(*made(samples, place), 1)
    assert [one.time for one in told.outlying] == [float(np.argmax(place))]
    assert told.set_aside
    assert told.shown
    whole, likelihood = made(samples, place)
    assert not _of_groups(whole, np.ones(n, dtype=bool), likelihood, 1)[0].shown


@pytest.mark.parametrize(
    ("phases", "signs", "recurs"),
    [
        ((30, 30, 30), (1, 1, 1), [True, True, True]),
        ((30, 31, 55), (1, 1, 1), [True, True, False]),  # one output apart, and elsewhere
        ((30, 70, 170), (1, 1, 1), [False, False, False]),  # same position, going back; mirrored
        ((30, 30, 130), (1, -1, 1), [False, False, False]),  # off the other way
    ],
)
def test_what_is_off_at_the_same_place_of_a_motion_recurs(phases, signs, recurs):
    n, period = 1000, 200
    t = np.arange(n) / 100.0
    turn = 2.0 * np.pi * 100.0 / period
    innovations = np.random.default_rng(8).standard_normal(n)
    places = [period * k + phase for k, phase in enumerate(phases)]
    innovations[places] = 12.0 * np.array(signs)
    seen = SimpleNamespace(
        **{"name": "run", "q": np.sin(turn * t), "qd": turn * np.cos(turn * t)},
        **{"acceleration": -(turn**2) * np.sin(turn * t), "measured": innovations},
        **{"time": t, "period": 0.01},
        filter=SimpleNamespace(centres=np.arange(n)),
    )
    found, _ = outlying(innovations, [seen], 3, 0)
    told = {round(100.0 * one.time): one.recurs for one in found}
    assert [told[place] for place in places] == recurs


def test_one_push_of_several_outputs_does_not_recur():
    n = 400
    t = np.arange(n) / 100.0
    innovations = np.random.default_rng(8).standard_normal(n)
    innovations[200:203] = 12.0
    seen = SimpleNamespace(
        **{"name": "run", "q": np.sin(t), "qd": np.cos(t), "acceleration": -np.sin(t)},
        **{"measured": innovations, "time": t, "period": 0.01},
        filter=SimpleNamespace(centres=np.arange(n)),
    )
    found, _ = outlying(innovations, [seen], 3, 0)
    assert [one.recurs for one in found] == [False] * 3


def made(samples, place):
    """Regression on a constant, along one axis of a motion."""
    n, still = samples.size, np.zeros(samples.size)
    rows = np.full((n, 1), 1.0 / np.sqrt(n))
    residual = samples - samples.mean()
    root = np.array([[samples.std() / np.sqrt(n)]])
    whole = _Whitened(rows, residual / samples.std(), 1, still, root, np.zeros((1, 1)))
    seen = SimpleNamespace(
        **{"name": "run", "q": place, "qd": still, "acceleration": still, "measured": samples},
        **{"time": np.arange(float(n)), "period": 1.0},
        filter=SimpleNamespace(centres=np.arange(n)),
    )
    noise = SimpleNamespace(gaussian=True, order=0)
    chain = SimpleNamespace(motor_motion="rotary")
    return whole, SimpleNamespace(observations=(seen,), noise=noise, chain=chain)
