"""Inverse model: the motor torque that a motion takes, eqs. (3) to (9) and (13)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesfric.mechanism import kernels
from bayesfric.mechanism.chain import Chain


def inverse_torque(
    chain: Chain,
    values: ArrayLike,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    *,
    added_mass: float = 0.0,
    radius: float = 0.0,
    recording: str = "",
) -> NDArray[np.float64]:
    """Measured motor torque along a motion.

    Parameters
    ----------
    chain
        The mechanism.
    values
        ``(n_parameters,)`` or ``(n, n_parameters)`` in the order of ``chain.names``.
    q, qd, qdd
        ``(N,)`` position, speed and acceleration of the joint (rad or m, SI). At
        ``qd = 0`` the losses that depend on direction are zero: what static
        friction then takes, no inverse model can tell.
    added_mass, radius
        Known mass in kg bolted to the load at a radius in m; a sliding load
        takes the mass alone.
    recording
        Whose own offset the torque has, where the chain knows any.

    Returns
    -------
    ndarray
        ``(N,)`` or ``(n, N)``, N m or N.
    """
    vectors = np.atleast_2d(np.asarray(values, dtype=np.float64))
    elements, load = chain.tables(vectors, recording)
    position = np.asarray(q, dtype=np.float64)
    inertia, moment = added_load(chain, added_mass, radius)
    torque: NDArray[np.float64] = kernels.inverse_many(
        elements,
        load,
        inertia,
        moment,
        np.sin(position),
        np.cos(position),
        np.ascontiguousarray(qd, dtype=np.float64),
        np.ascontiguousarray(qdd, dtype=np.float64),
    )
    return torque[0] if np.ndim(values) == 1 else torque


def load_torque(
    chain: Chain,
    values: ArrayLike,
    q: ArrayLike,
    qdd: ArrayLike,
    *,
    added_mass: float = 0.0,
    radius: float = 0.0,
) -> NDArray[np.float64]:
    """Torque that moves the load itself, ``Gamma`` of eq. (3), before any loss.

    Parameters and shapes as in :func:`inverse_torque`, for one parameter vector.
    """
    _, load = chain.tables(np.atleast_2d(np.asarray(values, dtype=np.float64)))
    inertia, moment = added_load(chain, added_mass, radius)
    position = np.asarray(q, dtype=np.float64)
    weight = load[0, kernels.GRAVITY] * (load[0, kernels.FIRST_MOMENT] + moment)
    swing = weight * np.sin(position + load[0, kernels.GRAVITY_ANGLE])
    torque: NDArray[np.float64] = (load[0, kernels.LOAD_INERTIA] + inertia) * np.asarray(
        qdd
    ) + swing
    return torque


def added_load(chain: Chain, added_mass: float, radius: float) -> tuple[float, float]:
    """Inertia and first moment that a known added mass brings to the load.

    Returns
    -------
    tuple of float
        kg m² and kg m for a turning load, kg and 0 for a sliding one.
    """
    if chain.load.motion == "linear":
        return added_mass, 0.0
    return added_mass * radius**2, added_mass * radius
