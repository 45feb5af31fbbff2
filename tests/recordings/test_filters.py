"""Filters against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesfric.base.errors import BadInput
from bayesfric.recordings.filters import (
    derivative,
    lay_windows,
    lowpass,
    parallel_taps,
    reach_of,
)

FS = 1000.0


@pytest.mark.parametrize("order", [2, 4, 6])
@pytest.mark.parametrize("cutoff", [20.0, 100.0, 300.0])
@pytest.mark.parametrize("times", [0.3, 1.0, 1.4])
def test_a_sine_has_butterworths_gain_and_no_shift(order, cutoff, times):
    """1/(1 + (w/wc)^(2n)) of two passes, w = tan(pi f/fs) by the bilinear transform."""
    turn = 2 * np.pi * times * cutoff * np.arange(4000) / FS
    passed = lowpass(np.sin(turn), [(0, 4000)], FS, cutoff, order)
    middle = slice(1000, 3000)
    basis = np.array([np.sin(turn), np.cos(turn)])[:, middle]
    in_phase, shifted = np.linalg.lstsq(basis.T, passed[middle], rcond=None)[0]
    ratio = np.tan(np.pi * times * cutoff / FS) / np.tan(np.pi * cutoff / FS)
    assert in_phase == pytest.approx(1.0 / (1.0 + ratio ** (2 * order)), abs=1e-6)
    assert shifted == pytest.approx(0.0, abs=1e-6)


def test_segments_do_not_leak():
    x = np.concatenate([np.zeros(200), np.ones(200)])
    pieces = [(0, 200), (200, 400)]
    np.testing.assert_allclose(lowpass(x, pieces, FS, 50, 4), x, atol=1e-12)
    np.testing.assert_allclose(derivative(x, pieces, 1 / FS), 0, atol=1e-12)


@pytest.mark.parametrize("cutoff", [500.0, 600.0])
def test_cutoff_at_nyquist_is_refused(cutoff):
    with pytest.raises(BadInput, match="half the sampling rate"):
        lowpass(np.zeros(100), [(0, 100)], FS, cutoff, 4)
    with pytest.raises(BadInput, match="half the sampling rate"):
        lay_windows(parallel_taps(1, cutoff, FS), [(0, 100)], 1, np.ones(100, dtype=bool))


@pytest.mark.parametrize("reach", [1, 2, 4, 7, 16])
def test_a_differentiator_is_exact_for_polynomials_of_its_degree(reach):
    t = np.linspace(-1, 1, 60)
    rng = np.random.default_rng(reach)
    poly = np.polynomial.Polynomial(rng.normal(size=2 * reach + 1))
    slope = derivative(poly(t), [(0, 60)], t[1] - t[0], reach)
    inside = slice(reach, 60 - reach)
    exact = poly.deriv()(t)[inside]
    # rounding grows with the degree's largest slope
    np.testing.assert_allclose(slope[inside], exact, atol=1e-10 * np.abs(exact).max())


@pytest.mark.parametrize("share", [0.01, 0.05, 0.1, 0.2, 0.3])
def test_differentiation_has_the_right_gain_in_the_pass_band(share):
    """A sine's second derivative is -w^2 sin; central differences lack 12 % of it at fs/10."""
    cutoff = share * FS
    t = np.arange(3000) / FS
    reach = reach_of("exact", cutoff, FS)
    for frequency in (0.1 * cutoff, 0.5 * cutoff, cutoff):
        w = 2 * np.pi * frequency
        wave = np.sin(w * t)
        twice = wave
        for _ in range(2):
            twice = derivative(twice, [(0, 3000)], 1 / FS, reach)
        middle = slice(50, -50)
        assert np.abs(twice[middle] + w**2 * wave[middle]).max() / w**2 < 2.5e-4


def test_ends_are_differentiated_by_what_is_there():
    t = np.arange(40) / FS
    slope = derivative(3 * t**2 + t, [(0, 40)], 1 / FS, 8)
    np.testing.assert_allclose(slope, 6 * t + 1, atol=1e-9)


@settings(deadline=None)
@given(
    st.integers(1, 12),
    st.one_of(st.none(), st.floats(5, 400)),
    st.lists(st.integers(0, 400), min_size=2, max_size=6, unique=True),
    st.integers(0, 2**32 - 1),
)
def test_parallel_filter(factor, band, edges, seed):
    edges = sorted(edges)
    pieces = list(zip(edges[::2], edges[1::2], strict=False))
    rng = np.random.default_rng(seed)
    usable = rng.random(400) > 0.01
    used = lay_windows(parallel_taps(factor, band, FS), pieces, factor, usable)
    length = len(used.taps)
    assert used.taps.sum() == pytest.approx(1)
    assert length % 2 == 1
    np.testing.assert_allclose(used.taps, used.taps[::-1], atol=1e-15)
    # every window in one segment
    for start in used.starts:
        assert any(a <= start and start + length <= b for a, b in pieces)
        share = np.abs(used.taps) @ ~usable[start : start + length] / np.abs(used.taps).sum()
        assert share <= 0.02
    # linear, keeps constants, equals a convolution
    x, y = rng.normal(size=(2, 400))
    np.testing.assert_allclose(used.apply(np.ones(400)), 1)
    np.testing.assert_allclose(
        used.apply(2 * x - 3 * y), 2 * used.apply(x) - 3 * used.apply(y), atol=1e-12
    )
    # some of its outputs, from the samples that they are made of
    some = np.flatnonzero(rng.random(used.n_outputs) < 0.5)
    if some.size:
        short, samples = used.excerpt(some)
        np.testing.assert_array_equal(short.apply(x[samples]), used.apply(x)[some])
    if length <= 400:
        # what cannot be used counts for nothing, the rest for that much more
        whole = np.convolve(x * usable, used.taps, mode="valid")[used.starts]
        there = np.convolve(usable, used.taps, mode="valid")[used.starts]
        np.testing.assert_allclose(used.apply(x), whole / there, atol=1e-12)
        poisoned = np.where(usable, x, 1e6)
        np.testing.assert_allclose(used.apply(poisoned), used.apply(x), atol=1e-12)
        both = used.apply(np.stack([x, y]).reshape(2, 1, 400))
        assert both.shape == (2, 1, used.n_outputs)
        np.testing.assert_allclose(both[1, 0], used.apply(y), atol=1e-12)


@pytest.mark.parametrize("factor", [2, 3, 10, 43])
def test_white_noise_comes_out_of_the_default_parallel_filter_white(factor):
    # the autocorrelation of outputs is that of the weights at multiples of the factor
    taps = parallel_taps(factor, None, 1.0)
    of_samples = np.correlate(taps, taps, "full")
    found = of_samples[len(taps) - 1 :: factor]
    assert np.abs(found[1:]).max() < 0.003 * found[0]
