"""Inverse model: the motor torque along a motion, eqs. (3) to (9) and (13)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Inputs


def inverse_torque(
    joint: Joint,
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
    joint
        The mechanism.
    values
        ``(n_parameters,)`` or ``(n, n_parameters)`` in the order of ``joint.names``.
    q, qd, qdd
        ``(N,)`` position, speed and acceleration of the joint (rad or m, SI). At
        ``qd = 0`` the losses that depend on direction are zero: static
        friction is then not determined.
    inputs
        Known mass, signals and offset of the recording.
    time
        ``(N,)`` s; without it a term that depends on time is NaN.

    Returns
    -------
    ndarray
        ``(N,)`` or ``(n, N)``, N m or N.

    Raises
    ------
    ValueError
        If a term is a signal that the inputs do not hold: the rate of the torque for an unknown
        delay, or the temperature.

    Notes
    -----
    From the load's torque, eq. (3), less a measured torque on the load, through every element by
    the equation of section 2.2; then ``(torque + offset)/gain``, and an unknown delay ``d`` as ``+
    d dtorque/dt``, to first order. For the Rabbit knee this is eq. (13).
    """
    vectors = np.atleast_2d(np.asarray(values, dtype=np.float64))
    samples = joint.samples(q, qd, qdd, inputs, time)
    torque: Array = kernels.inverse_many(*joint.tables(vectors, inputs), samples)
    return torque[0] if np.ndim(values) == 1 else torque


def load_torque(
    joint: Joint, values: Array, q: Array, qdd: Array, inputs: Inputs, time: Array
) -> Array:
    """Compute the torque ``(N,)`` on the load, ``Gamma`` of eq. (3), less the measured one."""
    load = joint.tables(np.atleast_2d(values), inputs).load[0]
    weight = load[kernels.GRAVITY] * load[kernels.FIRST_MOMENT]
    swing = weight * np.sin(q + load[kernels.GRAVITY_ANGLE])
    torque: Array = load[kernels.LOAD_INERTIA] * qdd + swing
    return torque if inputs.load_torque is None else torque - inputs.load_torque.at(time)


def load_reach(joint: Joint, values: Array, *, open_scale: bool) -> Array:
    """Return factors ``(n,)`` from the load's torque to its loss-free torque at the motor.

    ``1/N``, or the mean ``lambda_1/N`` of both power flows where the scale is open (section 4.2).
    """
    elements = joint.tables(values).elements
    ratio = np.prod(elements[:, :, kernels.RATIO], axis=1)
    if not open_scale:
        return np.asarray(1.0 / ratio)
    drive = np.prod(1.0 + elements[:, :, kernels.LOAD_DRIVE], axis=1)
    back = np.prod(1.0 - elements[:, :, kernels.LOAD_BACK], axis=1)
    return np.asarray(0.5 * (drive + back) / ratio)
