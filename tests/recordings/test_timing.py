"""A torque taken some samples earlier, and its rate."""

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.estimates.trajectory import trajectory
from bayesfric.recordings.filters import later
from bayesfric.recordings.measurement import Law
from bayesfric.recordings.signals import (
    observe,
    retimed,
    target_torque,
    timed,
    unlimited_command,
)
from bayesfric.recordings.source import Processing
from tests.conftest import made_recording

PERIOD = 2e-3
TIME = np.arange(3000) * PERIOD


def wave(time, hertz=2.0):
    return np.sin(2 * np.pi * hertz * time)


@pytest.mark.parametrize("samples", [0.0, 0.3, -0.3, 2.0, -7.0, 11.6])
@pytest.mark.parametrize("share", [0.01, 0.05, 0.1])
def test_a_wave_is_later_by_fractions_of_a_sample(samples, share):
    w = 2 * np.pi * share
    delayed = later(np.sin(w * np.arange(400)), samples)
    exact = np.sin(w * (np.arange(400) - samples))
    atol = 1e-12 if samples == int(samples) else 3e-5
    np.testing.assert_allclose(delayed[20:-20], exact[20:-20], atol=atol)


@pytest.mark.parametrize("delay", [0.0, 0.0011, -0.004])
@pytest.mark.parametrize("back_emf", [0.0, 0.3])
def test_torque_and_rate_are_those_of_before(delay, back_emf):
    """A back-EMF comes with the position, not with the torque before."""
    back_emf = back_emf * wave(TIME, 3.0)
    r = made_recording(TIME, wave(TIME), wave(TIME) - back_emf, PERIOD, back_emf=back_emf)
    o = timed(observe(r, Processing()), r, delay)
    rate = 4.0 * np.pi * np.cos(4.0 * np.pi * (TIME - delay))
    np.testing.assert_allclose(o.inputs.torque_rate.values[20:-20], rate[20:-20], atol=1e-3)
    earlier = o.filter.apply(wave(TIME - delay) - back_emf + delay * rate)
    np.testing.assert_allclose(o.measured, earlier, atol=1e-5)
    assert o.settings["delay"] == delay


def test_nothing_comes_across_a_gap():
    segments = ((0, 1500), (1500, 3000))
    rates = []
    for after in (1.0, 100.0):
        torque = np.where(TIME < 3.0, wave(TIME), after)
        r = made_recording(TIME, wave(TIME), torque, PERIOD, segments=segments)
        o = retimed(observe(r, Processing()), segments, PERIOD, 0.01)
        rates.append(o.inputs.torque_rate.values[:1500])
    np.testing.assert_array_equal(*rates)


def test_delays_that_are_refused():
    r = made_recording(TIME, wave(TIME), wave(TIME), PERIOD, back_emf=0.3 * wave(TIME, 3.0))
    o = observe(r, Processing())
    with pytest.raises(BadInput, match=r"delay.*trimmed off the ends.*time stamps"):
        timed(o, r, 0.5)
    assert trajectory(r, o, np.inf).position.size == TIME.size
    with pytest.raises(BadInput, match="computed from a voltage"):
        trajectory(r, timed(o, r, 0.003), np.inf)


KP, KD, LIMIT = 8.0, 0.3, 5.0


def by_target(goal, held=False, limit=np.inf, **more):
    """A drive that goes for ``goal(t)``; position and speed as it knows them."""
    q, qd = wave(TIME, 1.3), 2 * np.pi * 1.3 * np.cos(2 * np.pi * 1.3 * TIME)
    law = Law(KP * goal(TIME), np.full(TIME.size, 0.5), KP, KD, limit, 0.0, None, held)
    torque = law.drives(q, qd)
    return made_recording(TIME, q, torque, PERIOD, feedback=KP * q + KD * qd, law=law, **more)


@pytest.mark.parametrize("delay", [0.0, 0.0011, 0.02])
@pytest.mark.parametrize("held", [False, True])
def test_a_late_target_moves_the_target_alone(delay, held):
    """What a drive holds is a period wide: its wave comes half of one later, sinc times as high."""
    r = by_target(lambda t: 1.2 * wave(t), held)
    late = delay + 0.5 * PERIOD * held
    sinc = np.sinc(2.0 * PERIOD) if held else 1.0
    expected = 0.5 * (KP * 1.2 * sinc * wave(TIME - late) - r.feedback)
    assert target_torque(r, delay)[20:-20] == pytest.approx(expected[20:-20], abs=1e-6)


def test_the_rate_of_a_late_target_is_the_derivative_by_its_delay():
    """At its limit a drive does not look at its target."""
    r, step = by_target(lambda t: 1.2 * wave(t), limit=LIMIT), 1e-5
    o = observe(r, Processing(lowpass=0.0, decimate=1))
    rate = retimed(o, r.segments, PERIOD, 0.01, r).inputs.torque_rate.values
    slope = (target_torque(r, 0.01 - step) - target_torque(r, 0.01 + step)) / (2.0 * step)
    inside = np.abs(np.abs(unlimited_command(r, 0.01)) - LIMIT) > 0.01
    inside[:20] = inside[-20:] = False
    assert (rate[inside] == 0.0).mean() > 0.1
    assert rate[inside] == pytest.approx(slope[inside], abs=2e-3 * np.abs(slope).max())
