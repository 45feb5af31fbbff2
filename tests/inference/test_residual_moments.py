"""Moments of the residuals against their definition, written out in loops."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.estimates.autoregression import follows
from bayesfric.estimates.torque import filtered_torque
from bayesfric.inference.moments import PlainMoments
from bayesfric.mechanism.joint import PRESETS
from bayesfric.recordings.filters import ParallelFilter

KNEE = PRESETS["rabbit-knee"]


def with_gaps(o, dropped):
    """The same recording without some of its outputs, and with samples that do not count."""
    kept = np.setdiff1d(np.arange(o.filter.n_outputs), dropped)
    used, gains = np.ones(o.q.size), np.ones(kept.size)
    if o.filter.taps.size > 1:
        used[np.random.default_rng(9).integers(o.q.size, size=o.q.size // 50)] = 0.0
        windows = np.lib.stride_tricks.sliding_window_view(used, o.filter.taps.size)
        gains = 1.0 / (windows[o.filter.starts[kept]] @ o.filter.taps)
    filter_ = ParallelFilter(o.filter.taps, o.filter.starts[kept], used, gains)
    return replace(
        o,
        filter=filter_,
        time=o.time[kept],
        measured=filter_.apply(o.torque),
        speed=o.speed[kept],
        segment_of=o.segment_of[kept],
    )


def by_definition(chain, observations, values, order):
    lagged = np.zeros((len(values), len(observations), order + 1, order + 1))
    heads = [np.zeros((len(values), len(observations), k, k)) for k in range(1, order + 1)]
    counts = np.zeros(len(observations), dtype=int)
    head_counts = np.zeros((len(observations), order), dtype=int)
    for i, o in enumerate(observations):
        residual = o.measured - filtered_torque(chain, o, values)
        ends = np.append(np.flatnonzero(~follows(o)) + 1, o.measured.size)
        begin = 0
        for end in ends:
            r = residual[:, begin:end]
            for m in range(order, end - begin):
                past = r[:, m - order : m + 1][:, ::-1]
                lagged[:, i] += past[:, :, None] * past[:, None, :]
            counts[i] += max(end - begin - order, 0)
            k = min(order, end - begin)
            if k:
                heads[k - 1][:, i] += r[:, :k, None] * r[:, None, :k]
                head_counts[i, k - 1] += 1
            begin = end
    return lagged, heads, counts, head_counts


@pytest.mark.parametrize("factor", [1, 5])
@pytest.mark.parametrize("order", [0, 1, 2, 4])
def test_moments_are_their_definition(make_observation, factor, order):
    chain = KNEE.chain()
    whole = make_observation(chain, KNEE.values, n=400 * factor, factor=factor)
    # runs of 30, 1, 2, 3 and many outputs
    gaps = with_gaps(whole, np.array([30, 32, 35, 39]))
    loaded = make_observation(
        chain, KNEE.values, n=300 * factor, factor=factor, seed=1, added_mass=2.0, radius=0.3
    )
    observations = [whole, gaps, loaded]
    rng = np.random.default_rng(0)
    values = chain.vector(KNEE.values) * rng.uniform(0.5, 1.5, (5, len(chain.names)))
    plain = PlainMoments(chain, observations, order)
    found = plain.at(values)
    lagged, heads, counts, head_counts = by_definition(chain, observations, values, order)
    bound = 1e-11 * np.trace(lagged, axis1=2, axis2=3)[:, :, None, None]
    assert (np.abs(found.lagged - lagged) <= bound).all()
    assert len(found.heads) == order
    for head, expected in zip(found.heads, heads, strict=True):
        assert (np.abs(head - expected) <= bound).all()
    np.testing.assert_array_equal(plain.counts, counts)
    np.testing.assert_array_equal(plain.head_counts, head_counts)
    squares = np.stack(
        [((o.measured - filtered_torque(chain, o, values)) ** 2).sum(axis=1) for o in observations],
        axis=1,
    )
    np.testing.assert_allclose(found.sum_of_squares, squares, rtol=1e-11)


def test_many_vectors_are_each_by_itself(make_observation):
    chain = KNEE.chain()
    o = make_observation(chain, KNEE.values, n=20_000)
    plain = PlainMoments(chain, [o], 2)
    rng = np.random.default_rng(0)
    values = chain.vector(KNEE.values) * rng.uniform(0.5, 1.5, (6, len(chain.names)))
    together = plain.at(values)
    for i in range(6):
        # sums of other shapes round differently
        alone = plain.at(values[i : i + 1]).lagged[0]
        np.testing.assert_allclose(alone, together.lagged[i], rtol=1e-12)
    lagged, *_ = by_definition(chain, [o], values[:1], 2)
    np.testing.assert_allclose(together.lagged[:1], lagged, rtol=1e-10)
