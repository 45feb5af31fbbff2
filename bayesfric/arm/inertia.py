"""Which inertial parameters bodies can have, and draws of a Gaussian over those that they can.

Mass, first moment and inertia of a body are those of some distribution of mass if its
pseudo-inertia ``[[S, h], [h', m]]`` is positive definite, ``S = tr(I)/2 - I`` the second moments
(Traversaro et al. 2016; Wensing, Kim and Slotine 2018).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesfric.recordings.arrays import Array

OF_ONE = 10  # inertial parameters of a body
# Chains, and how far each goes, which of forty causes forgets where it began.
_CHAINS, _STEPS, _SHRINKS = 400, 150, 60
_ROUNDING = 1e-9  # of a pseudo-inertia's trace


def second_moments(inertia: Array) -> Array:
    """Give second moments of mass of inertia tensors, ``(..., 3, 3)`` both; ``I = tr(S) - S``."""
    trace = np.trace(inertia, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(0.5 * trace * np.eye(3) - inertia)


def inertia_of(second: Array) -> Array:
    """Give the inertia ``(..., 6)`` of second moments of mass ``(..., 3, 3)``, about the same."""
    trace = np.trace(second, axis1=-2, axis2=-1)[..., None, None]
    rows, columns = np.triu_indices(3)
    return np.asarray((trace * np.eye(3) - second)[..., rows, columns])


def tensor(six: Array) -> Array:
    """Lay out ``(..., 6)``, xx, xy, xz, yy, yz, zz, as symmetric matrices ``(..., 3, 3)``."""
    return np.asarray(six[..., [[0, 1, 2], [1, 3, 4], [2, 4, 5]]])


def pseudo_inertias(parameters: Array) -> Array:
    """Give the pseudo-inertias ``(..., n, 4, 4)`` of ``(..., 10 n)`` parameters."""
    each = parameters.reshape(*parameters.shape[:-1], -1, OF_ONE)
    out = np.empty((*each.shape[:-1], 4, 4))
    out[..., :3, :3] = second_moments(tensor(each[..., 4:]))
    out[..., :3, 3] = out[..., 3, :3] = each[..., 1:4]
    out[..., 3, 3] = each[..., 0]
    return out


def possible(parameters: Array) -> NDArray[np.bool_]:
    """Tell which bodies ``(..., n)`` can be of ``(..., 10 n)`` parameters; what is nothing can."""
    found = pseudo_inertias(parameters)
    least = np.linalg.eigvalsh(found)[..., 0]
    trace = np.trace(found, axis1=-2, axis2=-1)
    return np.asarray((trace >= 0.0) & (least >= -_ROUNDING * np.abs(trace)))


def completed(parameters: Array, nominal: Array) -> Array:
    """Bring what parameters are otherwise than ``nominal`` to second order, ``(..., 10 n)`` both.

    A body moved by ``d`` has second moments that are larger by ``m d d'``, which a Gaussian over
    parameters leaves out. It moves no torque that counts, but no body is without it.
    """
    each = parameters.reshape(*parameters.shape[:-1], -1, OF_ONE).copy()
    was = nominal.reshape(-1, OF_ONE)
    mass = each[..., 0]
    scale = np.divide(mass, was[:, 0], out=np.zeros_like(mass), where=was[:, 0] > 0.0)
    moved = each[..., 1:4] - scale[..., None] * was[:, 1:4]
    more = inertia_of(moved[..., :, None] * moved[..., None, :])
    each[..., 4:] += np.divide(
        more, mass[..., None], out=np.zeros_like(more), where=mass[..., None] > 0.0
    )
    return np.asarray(each.reshape(parameters.shape))


def drawn_possible(
    nominal: Array,
    spread: Array,
    mean: Array,
    covariance: Array,
    start: Array,
    rng: np.random.Generator,
) -> tuple[Array, float]:
    """Draw ``z``, of a Gaussian cut to where all bodies of ``nominal + spread @ z`` can be.

    They are :func:`completed` first.

    By elliptical slice sampling [1]_, from ``start``, where they can.

    Parameters
    ----------
    nominal, spread
        ``(10 n,)`` and ``(10 n, k)``; bodies that ``nominal`` says cannot be are left out of this.
    mean, covariance
        ``(k,)`` and ``(k, k)`` of the Gaussian.
    start
        ``(k,)``.
    rng
        Random numbers.

    Returns
    -------
    draws
        ``(400, k)``.
    share
        Of the Gaussian's own draws that can be.

    References
    ----------
    .. [1] I. Murray, R. P. Adams and D. J. C. MacKay, "Elliptical slice sampling", AISTATS 2010.
    """
    asked = possible(completed(nominal + spread @ start, nominal))

    def inside(z: Array) -> NDArray[np.bool_]:
        found = possible(completed(nominal + z @ spread.T, nominal))
        return np.asarray(found[..., asked].all(axis=-1))

    root = np.linalg.cholesky(covariance)

    def draw() -> Array:
        return np.asarray(rng.normal(size=(_CHAINS, mean.size)) @ root.T)

    share = float(np.mean(inside(mean + draw())))
    now = np.tile(start - mean, (_CHAINS, 1))
    for _ in range(_STEPS):
        beside, angle = draw(), rng.uniform(0.0, 2.0 * np.pi, _CHAINS)
        low, high, left = angle - 2.0 * np.pi, angle.copy(), np.arange(_CHAINS)
        before = now.copy()
        for _ in range(_SHRINKS):
            at = angle[left, None]
            tried = before[left] * np.cos(at) + beside[left] * np.sin(at)
            good = inside(mean + tried)
            now[left[good]] = tried[good]
            left = left[~good]
            if not left.size:
                break
            low[left] = np.where(angle[left] < 0.0, angle[left], low[left])
            high[left] = np.where(angle[left] < 0.0, high[left], angle[left])
            angle[left] = rng.uniform(low[left], high[left])
    return mean + now, share
