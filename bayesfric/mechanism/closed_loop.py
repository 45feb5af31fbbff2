"""How a joint moves under a drive whose torque depends on the motion: position control, back-EMF.

The drive's law is closed over the forward model of :mod:`bayesfric.mechanism.integrate` at short
steps, so simulated replicates of a recording react to their own motion as the real joint did.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.dynamics import CarriedValues, moved
from bayesfric.mechanism.forward import carried_values, possible
from bayesfric.mechanism.integrate import POSITION, SPEED, integrate
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.drive_law import Law
from bayesfric.recordings.inputs import Inputs


class _Drive(NamedTuple):
    """A :class:`Law` for the compiled functions, ``(N,)`` arrays.

    ``on (scale clip(command - kp q - kd qd, limit) - back_emf qd)``, in units of the measured
    torque.
    """

    command: Array
    scale: Array
    on: Array  # 1 where the drive gives a torque, else 0
    kp: float
    kd: float
    limit: float
    back_emf: float


def follow(
    chain: Chain,
    values: ArrayLike,
    law: Law,
    period: float,
    segments: ArrayLike,
    q0: ArrayLike,
    qd0: ArrayLike,
    *,
    push: ArrayLike | None = None,
    inputs: Inputs = Inputs(),  # noqa: B008  (frozen)
    begin: float = 0.0,
    held: bool = False,
    step: float = 2e-3,
) -> tuple[Array, Array]:
    """Simulate the joint while a drive follows its command, anew in every segment.

    Parameters
    ----------
    chain
        The mechanism; a delay of the target is that of a drive in closed loop, one of positions is
        left out here.
    values
        ``(n, n_parameters)`` in the order of ``chain.names``.
    law
        Of the drive, ``(N,)`` samples.
    period, begin
        s from one sample to the next, and the time of the first.
    segments
        ``(K, 2)`` half-open ranges of samples that do not overlap.
    q0, qd0
        ``(K,)``: position and speed at the first sample of each, rad or m, SI.
    push
        ``(n, N)``, or ``(1, N)`` for all, motor torque besides, N m or N, as if measured; it goes
        straight between samples.
    inputs
        What the joint feels besides.
    held
        Whether the command is held until the next sample; else it goes straight.
    step
        The loop is closed at least so often, s.

    Returns
    -------
    q, qd : ndarray
        ``(n, N)``, rad or m, SI; NaN outside the segments, for a vector that has no motion, and
        from where the joint runs away.

    Raises
    ------
    ValueError
        If a term is multiplied by a signal that the inputs do not hold.

    Notes
    -----
    Between two closings of the loop the torque goes straight from its value at the begin to that at
    the end. The latter depends on the motion: it is predicted with a constant torque and corrected
    once (Heun's method).
    """
    vectors = np.ascontiguousarray(values, dtype=np.float64)
    ranges = np.asarray(segments, dtype=np.int64)
    tables = chain.tables(vectors, inputs)
    n, samples = len(vectors), law.command.size
    on = np.ones(samples) if law.off is None else np.where(law.off, 0.0, 1.0)
    given = (law.command, law.scale, on)
    command, scale, on = (np.ascontiguousarray(x, dtype=np.float64) for x in given)
    drive = _Drive(command, scale, on, law.kp, law.kd, law.limit, law.back_emf)
    pushed = np.zeros((1, samples)) if push is None else np.asarray(push, dtype=np.float64)
    load = inputs.load(chain.load.motion)
    late = chain.by_target and law.closed
    return _follow(
        tables.elements,
        tables.load,
        carried_values(chain, tables.carried, inputs),
        load,
        drive,
        np.ascontiguousarray(pushed),
        float(period),
        float(begin),
        held,
        chain.delays(vectors) / period if late else np.zeros(n),
        ranges,
        np.asarray(q0, dtype=np.float64),
        np.asarray(qd0, dtype=np.float64),
        int(np.ceil(period / step - 1e-9)),
        possible(chain, vectors, tables, load[0]),
        np.full((n, samples), np.nan),
        np.full((n, samples), np.nan),
    )


@njit(cache=True, error_model="numpy", inline="always")
def _between(command: Array, first: int, last: int, place: float) -> float:
    """Command on a straight line at a place, in samples, of those from ``first`` to ``last``."""
    place = min(max(place, float(first)), float(last))
    i = min(int(place), last - 1)
    return float(command[i] + (place - i) * (command[i + 1] - command[i]))


@njit(cache=True, error_model="numpy", inline="always")
def _standing(command: Array, first: int, place: float, step: float) -> float:
    """Mean of a held command over a step, both in samples; before the ``first`` it is as there."""
    begin = max(int(np.floor(place)), first)
    end = max(int(np.floor(place + step * (1.0 - 1e-9))), first)
    share = (end - place) / step if end > begin else 0.0
    return float(share * command[begin] + (1.0 - share) * command[end])


@njit(cache=True, error_model="numpy", inline="always")
def _torque(
    drive: _Drive, i: int, share: float, command: float, push: float, q: float, qd: float
) -> float:
    """Torque of the drive between samples i and i + 1."""
    j = min(i + 1, drive.command.shape[0] - 1)
    scale = drive.scale[i] + share * (drive.scale[j] - drive.scale[i])
    aimed = command - drive.kp * q - drive.kd * qd
    aimed = min(max(aimed, -drive.limit), drive.limit)
    return float(drive.on[i] * (scale * aimed - drive.back_emf * qd) + push)


@njit(cache=True, error_model="numpy", parallel=True)
def _follow(
    elements: Array,
    load: Array,
    carried: CarriedValues | None,
    added: tuple[float, float],
    drive: _Drive,
    push: Array,
    period: float,
    begin: float,
    held: bool,
    delays: Array,
    segments: NDArray[np.int64],
    q0: Array,
    qd0: Array,
    steps: int,
    valid: NDArray[np.bool_],
    q_out: Array,
    qd_out: Array,
) -> tuple[Array, Array]:
    """Integrate every vector and segment in parallel; one job has one vector and one segment.

    ``elements`` ``(n, n_elements, n_slots)`` and ``load`` ``(n, n_slots)`` are of :class:`Tables`,
    ``added`` the known mass's inertia and first moment, ``steps`` the closings of the loop a
    sample.
    """
    n, pieces = elements.shape[0], segments.shape[0]
    h = period / steps
    for job in prange(n * pieces):
        v, k = job // pieces, job % pieces
        if not valid[v]:
            continue
        joint = moved(elements[v], load[v], carried, added[0], added[1], v)
        row = v if push.shape[0] > 1 else 0
        torque, out, counts = np.empty(2), np.empty((4, 2)), np.zeros(3, dtype=np.int64)
        a, b = segments[k]
        q, qd = q0[k], qd0[k]
        for i in range(a, b):
            q_out[v, i], qd_out[v, i] = q, qd
            if i == b - 1 or np.isnan(q):
                continue
            for s in range(steps):
                now, then = (0.0, 0.0) if held else (s / steps, (s + 1) / steps)
                more = push[row, i + 1] - push[row, i]
                before = push[row, i] + s / steps * more
                after = push[row, i] + (s + 1) / steps * more
                time = begin + i * period + s * h
                place = i + s / steps - delays[v]
                first = last = _standing(drive.command, a, place, 1.0 / steps)
                if not held:
                    first = _between(drive.command, a, b - 1, place)
                    last = _between(drive.command, a, b - 1, place + 1.0 / steps)
                torque[0] = torque[1] = _torque(drive, i, now, first, before, q, qd)
                done = 2
                for _ in range(2):  # what the motion makes of the torque at the end, then with it
                    found = integrate(joint, torque, h, time, True, q, qd, 1, out, counts)
                    done = min(done, found)
                    end, fast = out[POSITION, 1], out[SPEED, 1]
                    torque[1] = _torque(drive, i, then, last, after, end, fast)
                q, qd = (out[POSITION, 1], out[SPEED, 1]) if done == 2 else (np.nan, np.nan)
    return q_out, qd_out
