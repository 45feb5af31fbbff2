"""What is laid beside each other of recordings and replicates, before anything is asked of it."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric.diagnostics.regression as regression
from bayesfric.diagnostics.along import Along
from bayesfric.diagnostics.candidates import KINDS, filtered_columns
from bayesfric.diagnostics.disturbances import delay_columns
from bayesfric.diagnostics.policy import LEAST_OUTPUTS
from bayesfric.diagnostics.regression import Regression
from bayesfric.diagnostics.replicates import ReplicateError
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import lay_windows, parallel_taps
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.source import Processing
from tests.axis import AXIS, VALUES, swing
from tests.conftest import made_observation, made_recording

PERIOD, FACTOR = 0.004, 5
TOLD = {"lowpass": 30.0, "order": 2, "reach": 8, "band": 12.0}
AT = AXIS.vector(VALUES)


def seen(name, n, begin=0.0, sigma=0.02, seed=1):
    """A recording of a known motion; what is measured passes the parallel filter."""
    time = PERIOD * np.arange(n)
    motion = swing(time + begin, ((0.4, 1.0), (1.3, 0.3)))
    torque = inverse_torque(AXIS, AT, *motion)
    torque = torque + sigma * np.random.default_rng(seed).standard_normal(n)
    taken = lay_windows(parallel_taps(FACTOR, None, 250.0), ((0, n),), FACTOR, np.ones(n, bool))
    o = made_observation(
        name, time, motion, torque, taken, FACTOR * PERIOD, Inputs(), settings=TOLD
    )
    return o, made_recording(time, motion[0], torque, PERIOD, name=name)


@pytest.fixture
def pair():
    return seen("one", 1200), seen("two", 800, 1.1)


def made(pair, monkeypatch, replicates=None, number=6, known=("motor.viscous",), values=AT):
    """A regression whose replicates are recordings of the same motion, without a simulation."""

    def simulated(chain, vectors, r, o, processing, seeds):  # noqa: ARG001
        for k, _ in enumerate(seeds):
            yield (
                replace(o, measured=o.measured + 0.01 * k)
                if replicates is None
                else replicates(k, o)
            )

    monkeypatch.setattr(regression, "replicates", simulated)
    observations, recordings = zip(*pair, strict=True)
    return Regression(AXIS, recordings, observations, Processing(), values, known, 3, number)


def test_the_models_columns_are_derivatives_of_its_filtered_torque(pair, monkeypatch):
    off = AT * [1.1, 0.9, 1.0, 1.2, 1.0]
    d = made(pair, monkeypatch, values=off).data
    begin = 0
    for o, _ in pair:
        part = slice(begin, begin := begin + o.measured.size)
        now = inverse_torque(AXIS, off, o.q, o.qd, o.qdd)
        np.testing.assert_allclose(d.residual[part], o.measured - o.filter.apply(now), atol=1e-12)
        columns = [o.qdd, 0.0 * o.q, np.sign(o.qd), 9.80665 * np.sin(o.q), np.ones_like(o.q)]
        exact = np.stack([o.filter.apply(x) for x in columns], axis=1)
        np.testing.assert_allclose(d.base[part][:, [0, 2, 4]], exact[:, [0, 2, 4]], atol=1e-5)
        np.testing.assert_allclose(d.base[part][:, 3], exact[:, 3], rtol=1e-2, atol=1e-3)
        assert not d.base[part][:, 1].any()  # which is known
    assert begin == d.residual.size


def test_candidates_pass_the_filter_of_the_torque(pair, monkeypatch):
    r = made(pair, monkeypatch)
    d, begin, all_keys = r.data, 0, []
    for o, recording in pair:
        part = slice(begin, begin := begin + o.measured.size)
        a = Along(AXIS, AT, o, recording, r.scales)
        exact = []
        for kind in KINDS:
            for shape, columns in kind.columns(a).items():
                exact += [(kind.name, shape, k, False, 0.0, x) for k, x in enumerate(columns)]
            exact += [(kind.name, "", k, True, 0.0, x) for k, x in enumerate(kind.nuisance(a))]
        for delay, columns in delay_columns(a).items():
            label = f"by about {delay:.2g} s"
            exact += [("delay", label, k, False, delay, x) for k, x in enumerate(columns)]
        told = [(k.kind, k.shape, k.number, k.nuisance, k.delay) for k in d.keys]
        assert told == [x[:-1] for x in exact]
        all_keys.append(told)
        filtered = np.stack([o.filter.apply(x[-1]) for x in exact], axis=1)
        np.testing.assert_allclose(d.others[part], filtered, rtol=1e-9, atol=1e-12)
    assert all_keys[0] == all_keys[1]


def test_samples_that_are_no_number_count_for_nothing(pair):
    o, _ = pair[0]
    x = np.cos(o.stamps)
    holed = np.where(np.arange(x.size) % 97 == 5, np.nan, x)
    many = [0.0 * x, x, holed, *[x * k for k in range(1, 12)]]
    exact = [np.where(np.isfinite(one), one, 0.0) for one in many]
    found = filtered_columns(o, many)
    np.testing.assert_allclose(found.T, [o.filter.apply(one) for one in exact], atol=1e-12)


def test_twins_are_of_parameters_that_the_recordings_hold_possible(pair, monkeypatch):
    """Normal about the estimate, by its covariance, but for widths beyond a tenth."""
    # little is told of the offset, whose column is small
    values = AT * [1.0, 1.0, 1.0, 1.0, 1e-3]
    r = made(pair, monkeypatch, values=values)
    r.number = 4000
    found = r._draw_parameters(np.random.default_rng(1))
    assert found.shape == (4000, 5)
    np.testing.assert_array_equal(found[:, 1], values[1])  # which is known
    x, free = r.data.base, [0, 2, 3, 4]
    left = r.data.residual - x @ np.linalg.lstsq(x, r.data.residual)[0]
    variance = left @ left / (left.size - 5)
    rows = x[:, free] * np.abs(values[free])
    power, vectors = np.linalg.eigh(rows.T @ rows)
    told = power > 1e-7 * power.max()
    sds = np.minimum(np.sqrt(variance / power[told]), 0.1)
    exact = (vectors[:, told] * sds**2) @ vectors[:, told].T
    assert (sds == 0.1).any() or told.sum() < 4
    relative = (found[:, free] - values[free]) / values[free]
    got = relative.T @ relative / 4000
    scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    np.testing.assert_allclose(got, exact, atol=5.0 * np.sqrt(2.0 / 4000) * scale.max())
    np.testing.assert_allclose(np.diag(got)[:3], np.diag(exact)[:3], rtol=0.12)
    # none below zero of what cannot be
    low = np.array([p.lower for p in AXIS.parameters])
    r.values = np.where(np.isfinite(low), 1e-9, values)
    r.data = replace(r.data, residual=1e3 * r.data.residual)
    assert (r._draw_parameters(np.random.default_rng(1)) >= low).all()


def test_twins_that_cannot_be_or_leave_too_little_are_left_out(pair, monkeypatch):
    def few(o, n):
        taken = replace(o.filter, starts=o.filter.starts[:n], gains=o.filter.gains[:n])
        cut = {key: getattr(o, key)[:n] for key in ("time", "measured", "speed", "segment_of")}
        return replace(o, filter=taken, **cut)

    least = 5 + LEAST_OUTPUTS

    def losing(lost):
        def replicate(k, o):
            first = o.name == "one"
            if k < lost and first:
                return None
            if k in (lost, lost + 1):
                return few(o, least - 10 if first else 9 + (k - lost))
            return replace(o, measured=o.measured + 0.01 * k)

        return made(pair, monkeypatch, replicate, number=8)

    r = losing(1)
    assert [t.layout.outputs for t in r.simulated][:1] == [least]
    assert len(r.simulated) == len(r.replicates) == 6
    for t, clean in zip(r.simulated, r._clean, strict=True):
        np.testing.assert_array_equal(t.residual, clean)
    # at least half must have come out
    assert len(losing(3).replicates) == 4
    with pytest.raises(ReplicateError):
        losing(4)
