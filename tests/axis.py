"""A motor that swings a load, and motions that are known exactly: what many tests are made of."""

import numpy as np

import bayesfric as bf

AXIS = bf.Joint(
    [bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True)],
    load=bf.Load(first_moment=True),
    offset=True,
)
VALUES = {
    "motor.inertia": 0.05,
    "motor.viscous": 0.1,
    "motor.coulomb": 0.3,
    "load.first_moment": 0.3,
    "offset": 0.05,
}


def recording_of(frame, **more):
    """Give the recording of a table that a simulation makes."""
    return bf.Recording.from_arrays(
        *(frame[name].to_numpy() for name in ("time", "position", "torque")), **more
    )


def swing(time, lines):
    """Give position, speed and acceleration of a sum of sines, pairs of Hz and rad."""
    q, qd, qdd = np.zeros((3, time.size))
    for f, a in lines:
        w = 2.0 * np.pi * f
        q += a * np.sin(w * time)
        qd += a * w * np.cos(w * time)
        qdd -= a * w**2 * np.sin(w * time)
    return q, qd, qdd


def torque_columns(q, qd, qdd):
    """Give the columns ``(n, parameters)`` of the axis' torque."""
    columns = {
        "motor.inertia": qdd,
        "motor.viscous": qd,
        "motor.coulomb": np.sign(qd),
        "load.first_moment": 9.80665 * np.sin(q),
        "offset": np.ones(q.size),
    }
    return np.stack([columns[name] for name in AXIS.names], axis=1)
