"""What is held out of a fit: which samples, how far from the others, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.recordings.held_out import Validation, divide, fitted
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing
from tests.conftest import made_recording

PROCESSING = Processing(lowpass=20.0, decimate=5)
N, PERIOD = 4000, 0.002


def recording(name="run", n=N, segments=None, moves=slice(None)):
    time = PERIOD * np.arange(n)
    position = np.zeros(n)
    position[moves] = np.sin(2 * np.pi * 0.9 * time[moves])
    torque = np.random.default_rng(n).standard_normal(n)
    return made_recording(time, position, torque, PERIOD, name=name, segments=segments or ((0, n),))


def test_a_named_recording_is_prepared_as_usual_but_not_fitted():
    runs = [recording(name) for name in ("a", "b", "c")]
    parts = divide(runs, PROCESSING, Validation(recordings=("b",)))
    assert [o.name for o in fitted(parts)[1]] == ["a", "c"]
    assert [p.held_out for p in parts] == ["", "whole recording", ""]
    np.testing.assert_array_equal(
        parts[1].observation.measured, observe(runs[1], PROCESSING).measured
    )


@pytest.mark.parametrize("share", [0.1, 0.2, 0.5])
def test_the_end_is_the_share_asked_for_and_a_window_away(share):
    first, held = divide([recording()], PROCESSING, Validation(hold_out=share))
    o = first.observation
    assert (first.held_out, held.held_out) == ("", f"last {100 * share:g} %")
    assert held.recording.time.size == round(share * N)
    assert held.recording.time[-1] == PERIOD * (N - 1)
    # no output of either has a sample nearer than a window to those of the other, nor is noise
    # with an autocorrelation of ten outputs shared
    window = (len(o.filter.taps) - 1) * PERIOD
    assert held.observation.time[0] - o.time[-1] > window + max(window, 10 * o.period)


def test_the_torque_that_is_held_out_changes_nothing_that_is_fitted():
    run = recording()
    changed = replace(run, torque=run.torque + 5.0 * (run.time >= PERIOD * N * 0.8))
    before, after = (divide([r], PROCESSING, Validation(hold_out=0.2)) for r in (run, changed))
    np.testing.assert_array_equal(before[0].observation.measured, after[0].observation.measured)
    np.testing.assert_array_equal(before[0].recording.torque, after[0].recording.torque)
    assert np.all(after[1].observation.measured - before[1].observation.measured > 4)


def test_gaps_in_time_stay_and_stumps_go():
    # the cut at 80 % lies 20 samples into the third segment: too few to fit
    end = 3200 - 37
    segments = ((0, 1000), (1000, end - 65), (end - 65, 3600), (3600, N))
    run = recording(segments=segments)
    first, last = divide([run], PROCESSING, Validation(hold_out=0.2))
    assert first.recording.segments == ((0, 1000), (1000, end - 65))
    held = last.recording
    assert held.segments == ((0, 400), (400, 800))
    np.testing.assert_array_equal(held.time, run.time[3200:])


def refused(runs, processing=PROCESSING, **options):
    with pytest.raises(BadInput) as caught:
        divide(runs, processing, Validation(**options))
    return str(caught.value)


LAST = "validation.hold_out: the last {} % of recording 'run'"


@pytest.mark.parametrize(
    ("runs", "options", "problem"),
    [
        ([recording("a")], {"recordings": ("a",)}, "every recording"),
        ([recording()], {"hold_out": 0.995}, "leaves nothing of recording 'run'"),
        ([recording()], {"hold_out": 0.97}, "what is left of recording 'run'"),
        ([recording()], {"hold_out": 1e-9}, LAST.format("1e-07")),
        ([recording()], {"hold_out": 0.02}, LAST.format("2")),
        (
            [recording("a"), recording("b", n=160)],
            {"recordings": ("b",)},
            "recording 'b' is too short",
        ),
    ],
)
def test_too_much_or_too_little(runs, options, problem):
    assert problem in refused(runs, **options)


@pytest.mark.parametrize(
    ("dead_zone", "dither"), [(None, 0.0), (0.0, 0.0), ("0.05 rad/s", 0.0), (None, 1e-6)]
)
def test_an_end_in_which_the_joint_stands_still(dead_zone, dither):
    """The speeds of a dither would set a dead zone below it; those of the fitted part do not."""
    run = recording(moves=slice(0, 3000))
    run.position[3000:] = dither * np.sin(40.0 * run.time[3000:])
    processing = PROCESSING.model_copy(update={"dead_zone": dead_zone})
    message = refused([run], processing, hold_out=0.2)
    assert message.startswith("validation.hold_out: the last 20 % of recording 'run'")
    assert "never" in message
