"""Gaussian likelihood of the measured motor torque around the inverse model.

Model output and measured torque pass the same parallel filter, so what the
filter removes is removed from both and does not bias the comparison.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from bayesfric.estimates.torque import filtered_torque
from bayesfric.inference.likelihood import LikelihoodMethod, Outputs, normal_terms
from bayesfric.mechanism import kernels
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.inverse import added_load
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]

# Samples in one call below which starting threads costs more than it saves.
_WORTH_THREADS = 50_000


class TorqueLikelihood:
    """How probable the measured torques are, given the joint's parameters.

    See :class:`bayesfric.inference.likelihood.Likelihood`.

    Parameters
    ----------
    chain
        The mechanism.
    observations
        One or more prepared recordings. They share the chain's parameters.
    """

    method: LikelihoodMethod = "input-error"
    noise_quantities: tuple[str, ...] = ("sigma",)

    def __init__(self, chain: Chain, observations: Sequence[Observation]) -> None:
        self.chain = chain
        self.observations = tuple(observations)
        rotary = chain.motor_motion == "rotary"
        self.outputs = tuple(
            Outputs(
                name=o.name,
                quantity="motor torque" if rotary else "motor force",
                unit="N m" if rotary else "N",
                time=o.time,
                measured=o.measured,
                period=o.period,
                segment_of=o.segment_of,
                follows=_neighbours(o),
            )
            for o in self.observations
        )
        self.sizes = np.array([o.measured.size for o in self.observations])
        self._arrays = [
            (
                *added_load(chain, o.added_mass, o.radius),
                np.sin(o.q),
                np.cos(o.q),
                np.ascontiguousarray(o.qd),
                np.ascontiguousarray(o.qdd),
                o.filter.taps,
                o.filter.starts,
                np.ascontiguousarray(o.measured),
            )
            for o in self.observations
        ]

    def sum_of_squares(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum of squared residuals of each recording.

        Parameters
        ----------
        values
            ``(n, n_parameters)`` in the order of ``chain.names``.

        Returns
        -------
        ndarray
            ``(n, n_recordings)``, torque unit squared.
        """
        elements, load = self.chain.tables(values)
        return np.stack([_sum_of_squares(elements, load, a) for a in self._arrays], axis=1)

    def about(self, values: Array) -> TorqueLikelihood:  # noqa: ARG002
        """Give itself: nothing about it is approximate."""
        return self

    def log_density(self, values: Array, scales: Array) -> Array:
        """Log-likelihood with white Gaussian noise.

        Parameters
        ----------
        values
            ``(n, n_parameters)``.
        scales
            ``(n, n_recordings, 1)`` noise scales.

        Returns
        -------
        ndarray
            ``(n,)``
        """
        squares, sigma = self.sum_of_squares(values), scales[..., 0]
        terms = squares / sigma**2 + self.sizes * (2.0 * np.log(sigma) + math.log(2.0 * math.pi))
        total: Array = -0.5 * terms.sum(axis=1)
        return total

    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.Likelihood`."""
        sds = [scales[:, r] for r in range(len(self.outputs))]
        z = [
            (o.measured - torque) / sd
            for o, torque, sd in zip(self.outputs, self.predict(values), sds, strict=True)
        ]
        return normal_terms(z, sds)

    def predict(self, values: Array) -> list[Array]:
        """Predict the filtered torque of each recording, ``(n, n_outputs)`` each."""
        return [filtered_torque(self.chain, o, values) for o in self.observations]

    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.Likelihood`."""
        return [
            torque / sigma for torque, sigma in zip(self.predict(values), scales[:, 0], strict=True)
        ]

    def noise_information(self, scales: Array) -> Array:
        """See :class:`bayesfric.inference.likelihood.Likelihood`: ``2n`` for ``log sigma``."""
        return 2.0 * self.sizes[:, None, None] * np.ones_like(scales[..., None])

    def noise_sd(self, scales: Array) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.Likelihood`."""
        return [np.full(n, sigma) for n, sigma in zip(self.sizes, scales[:, 0], strict=True)]

    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.Likelihood`."""
        return [
            scales[:, r] * rng.standard_normal((scales.shape[0], n))
            for r, n in enumerate(self.sizes)
        ]


def _neighbours(o: Observation) -> NDArray[np.bool_]:
    """Which outputs are followed, one step later in the same segment, by the next."""
    step = np.diff(o.filter.starts)
    return np.asarray((step == step.min(initial=step[:1].sum())) & (np.diff(o.segment_of) == 0))


@njit(cache=True)
def _squares(
    elements: NDArray[np.float64],
    load: NDArray[np.float64],
    added_inertia: float,
    added_moment: float,
    sin_q: NDArray[np.float64],
    cos_q: NDArray[np.float64],
    speed: NDArray[np.float64],
    acceleration: NDArray[np.float64],
    taps: NDArray[np.float64],
    starts: NDArray[np.int64],
    measured: NDArray[np.float64],
) -> float:
    torque = np.empty(speed.shape[0])
    kernels.inverse_one(
        elements, load, added_inertia, added_moment, sin_q, cos_q, speed, acceleration, torque
    )
    total = 0.0
    whole = taps.shape[0] // 4 * 4
    for m in range(starts.shape[0]):
        window = torque[starts[m] : starts[m] + taps.shape[0]]
        # Four sums side by side are as fast as letting the compiler reorder one, and
        # unlike that they come out the same wherever this is compiled.
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        for k in range(0, whole, 4):
            a += taps[k] * window[k]
            b += taps[k + 1] * window[k + 1]
            c += taps[k + 2] * window[k + 2]
            d += taps[k + 3] * window[k + 3]
        for k in range(whole, taps.shape[0]):
            a += taps[k] * window[k]
        residual = measured[m] - ((a + b) + (c + d))
        total += residual * residual
    return total


@njit(cache=True)
def _in_line(elements: NDArray[np.float64], load: NDArray[np.float64], *arrays: Any) -> Any:
    out = np.empty(elements.shape[0])
    for i in range(elements.shape[0]):
        out[i] = _squares(elements[i], load[i], *arrays)
    return out


@njit(cache=True, parallel=True)
def _in_threads(elements: NDArray[np.float64], load: NDArray[np.float64], *arrays: Any) -> Any:
    out = np.empty(elements.shape[0])
    for i in prange(elements.shape[0]):
        out[i] = _squares(elements[i], load[i], *arrays)
    return out


def _sum_of_squares(
    elements: NDArray[np.float64], load: NDArray[np.float64], arrays: tuple[Any, ...]
) -> NDArray[np.float64]:
    samples = arrays[2].shape[0] * elements.shape[0]
    run = _in_threads if samples > _WORTH_THREADS else _in_line
    squares: NDArray[np.float64] = run(elements, load, *arrays)
    return squares
