"""Simulate joints with elasticity, backlash or pre-sliding (bristle) friction.

The package's simulator has none of these. Motor and pendulum are two masses, joined by a
spring with or without a gap; or one mass whose Coulomb friction follows a bristle (Dahl 1968). The
equations are solved at 50 kHz, friction exactly, the spring semi-implicitly. The position is the
motor's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bench import LINES, PLAIN, Bench, Drive, as_recorded, gains, measured
from numba import njit
from numpy.typing import NDArray

from bayesfric import Joint, Recording
from bayesfric.mechanism import experiment
from bayesfric.mechanism.forward import Motion

Array = NDArray[np.float64]
GRAVITY, FINE = 9.80665, 50_000.0  # m/s², Hz
MOTOR, LOAD = 0.02, 0.03  # kg m²
DRIVE = Drive(3.0, square=0.3, hertz=0.7)
# Hz of the teeth's contact, and damping ratio of the spring.
CONTACT, DAMPING = 300.0, 0.02


@dataclass(frozen=True)
class Compliant:
    """A bench like those of ``calibration`` with elasticity, gap or bristle."""

    joint: Joint  # fitted joint
    elastic: float = 0.0  # Hz, resonance with the motor locked
    gap: float = 0.0  # rad, total
    bristle: float = 0.0  # rad
    loop: float = 0.0  # Hz of a position loop; else torque is commanded
    tables: dict[str, Any] = field(default_factory=dict)

    def recorded(
        self, rng: np.random.Generator, folder: Path
    ) -> tuple[dict[str, float], list[Recording], float]:
        """Write the file of one recording."""
        bench = Bench(self.joint, PLAIN, (DRIVE,), duration=20.0, counts=16384, loop=self.loop)
        truth = bench.truth(rng)
        time = np.arange(round((bench.duration + 0.2) * FINE)) / FINE
        sines = experiment.multisine(time, 1.0, LINES, seed=int(rng.integers(2**31)))
        sines *= (1.0 - DRIVE.square) / np.sqrt(len(LINES) / 2.0)
        square = experiment.square(time + rng.uniform(), DRIVE.square, DRIVE.hertz)
        torque = DRIVE.amplitude * (sines + square)
        torque = experiment.current_loop(torque, 1.0 / FINE, DRIVE.lag)
        if self.loop:  # the target; _moved replaces it by the loop's torque
            torque = experiment.multisine(
                time, bench.path, LINES[:-1], seed=int(rng.integers(2**31))
            )
        hertz = self.elastic or CONTACT * bool(self.gap)
        factor = truth["motor.inertia"] / PLAIN["motor.inertia"]
        q, qd = _moved(
            torque, truth["offset"], *gains(self.loop, MOTOR + LOAD), 1.0 / FINE,
            factor * MOTOR, factor * LOAD,
            truth["load.first_moment"] * GRAVITY, truth["motor.coulomb"], truth["motor.viscous"],
            factor * LOAD * (2.0 * math.pi * hertz) ** 2, DAMPING, 0.5 * self.gap, self.bristle,
        )  # fmt: skip
        still = qd == 0.0
        motion = Motion(time, q, qd, np.gradient(qd, time), torque, still, 0, 0, 0.0, 1)
        columns = measured(bench, motion, time, torque, rng)
        path = folder / "recording-0.csv"
        table = np.stack(list(columns.values()), axis=1)
        header = ",".join(columns)
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")
        return truth, [as_recorded(bench, DRIVE, path)], float(np.mean(still))


@njit(cache=True)
def _moved(
    torque, offset, kp, kd, h, motor, load, weight, coulomb, viscous, stiff, damping, half, bristle
):  # type: ignore[no-untyped-def]
    """Return the motor's position and speed ``(N,)``; without stiffness the masses are one.

    Under a position loop ``torque`` is the target, and is overwritten by the loop's torque.
    """
    q, qd = np.zeros(torque.size), np.zeros(torque.size)
    x = v = y = w = z = 0.0
    damper = 2.0 * damping * math.sqrt(stiff * load)
    mass = motor + (0.0 if stiff else load)
    if kp:
        x = y = torque[0]
    for i in range(torque.size):
        if kp:
            torque[i] = kp * (torque[i] - x) - kd * v
        between = 0.0
        if stiff:
            wound = x - y
            if abs(wound) > half:
                between = stiff * (wound - math.copysign(half, wound)) + damper * (v - w)
        force = (
            torque[i] - offset - viscous * v - between - (0.0 if stiff else weight * math.sin(x))
        )
        if bristle:
            v += h * (force - coulomb * z) / mass
            side = 1.0 if v > 0.0 else -1.0
            z = side + (z - side) * math.exp(-abs(h * v) / bristle)
        else:  # friction can stop the mass, not reverse it
            free = v + h * force / mass
            v = math.copysign(max(abs(free) - h * coulomb / mass, 0.0), free) if free else 0.0
        x += h * v
        if stiff:
            w += h * (between - weight * math.sin(y)) / load
            y += h * w
        q[i], qd[i] = x, v
    return q, qd
