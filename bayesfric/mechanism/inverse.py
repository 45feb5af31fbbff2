"""Inverse model: the motor torque that a motion takes, eqs. (3) to (9) and (13)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayesfric.mechanism import kernels
from bayesfric.mechanism.chain import Chain
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.inputs import Inputs


def inverse_torque(
    chain: Chain,
    values: ArrayLike,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    *,
    inputs: Inputs = Inputs(),  # noqa: B008  (frozen)
    time: Array | None = None,
) -> Array:
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
    inputs
        What the joint feels besides, and whose own offset the torque has.
    time
        ``(N,)`` s; without it a term that depends on time is NaN.

    Returns
    -------
    ndarray
        ``(N,)`` or ``(n, N)``, N m or N.
    """
    vectors = np.atleast_2d(np.asarray(values, dtype=np.float64))
    samples = chain.samples(q, qd, qdd, inputs, time)
    torque: Array = kernels.inverse_many(*chain.tables(vectors, inputs), samples)
    return torque[0] if np.ndim(values) == 1 else torque


def load_torque(
    chain: Chain,
    values: ArrayLike,
    q: ArrayLike,
    qdd: ArrayLike,
    *,
    inputs: Inputs = Inputs(),  # noqa: B008  (frozen)
    time: Array | None = None,
) -> Array:
    """Torque that moves the load itself, ``Gamma`` of eq. (3), before any loss.

    Parameters and shapes as in :func:`inverse_torque`, for one parameter vector.
    """
    load = chain.tables(np.atleast_2d(np.asarray(values, dtype=np.float64))).load
    inertia, moment = inputs.load(chain.load.motion)
    position = np.asarray(q, dtype=np.float64)
    weight = load[0, kernels.GRAVITY] * (load[0, kernels.FIRST_MOMENT] + moment)
    swing = weight * np.sin(position + load[0, kernels.GRAVITY_ANGLE])
    torque: Array = (load[0, kernels.LOAD_INERTIA] + inertia) * np.asarray(qdd) + swing
    if inputs.load_torque is not None:
        torque = torque - inputs.load_torque.at(
            np.full(position.shape, np.nan if time is None else time)
        )
    return torque


def load_reach(
    chain: Chain, values: Array, *, open_scale: bool, passed: int | None = None
) -> Array:
    """Factors ``(n,)`` from the load's torque at the joint to its loss-free torque at the motor.

    ``1/N``, or ``lambda_1/N`` where the scale between leg and alpha is open: the mean of what the
    motor feels of the load while it drives and while it is driven, which no scaling changes. Of the
    true torque: ``drive.gain`` has no part in it. ``values`` are ``(n, n_parameters)``; ``passed``
    is how many elements the torque passes, all if left out.
    """
    elements = chain.tables(values).elements[:, :passed]
    ratio = np.prod(elements[:, :, kernels.RATIO], axis=1)
    if not open_scale:
        return np.asarray(1.0 / ratio)
    drive = np.prod(1.0 + elements[:, :, kernels.LOAD_DRIVE], axis=1)
    back = np.prod(1.0 - elements[:, :, kernels.LOAD_BACK], axis=1)
    return np.asarray(0.5 * (drive + back) / ratio)
