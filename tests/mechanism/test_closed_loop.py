"""A joint that a drive moves: closed forms, and what the open loop gives."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.mechanism.closed_loop import follow
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Law
from tests.mechanism.joints import EVERYTHING, EVERYTHING_VALUES, GEARED, KNEE, LIGHT

PERIOD = 0.004
N = 500
TIME = PERIOD * np.arange(N)
PLAIN = Joint([Element("motor", inertia=True, viscous=True)], Load())


def oscillation(kp, kd, inertia, viscous, target):
    """Closed form of a damped oscillator that begins at rest at zero."""
    roots = np.roots([inertia, kd + viscous, kp]).astype(complex)
    a = np.linalg.solve([[1.0, 1.0], roots], [-target, 0.0])
    return target + (a[0] * np.exp(roots[0] * TIME) + a[1] * np.exp(roots[1] * TIME)).real


def test_position_control_is_an_oscillator():
    """Inertia, viscous loss, PD gains a constant target; the error is that of Runge and Kutta."""
    inertia, viscous, kp, kd, target = 0.02, 0.05, 4.0, 0.1, 0.7
    wanted = oscillation(kp, kd, inertia, viscous, target)
    values = PLAIN.vector({"motor.inertia": inertia, "motor.viscous": viscous})
    law = Law(np.full(N, kp * target), np.ones(N), kp, kd)
    start = [(0, N)], np.zeros(1), np.zeros(1)
    errors = [
        np.abs(follow(PLAIN, values[None], law, PERIOD, *start, step=step)[0] - wanted).max()
        for step in (4e-3, 2e-3)
    ]
    assert errors[1] < 1e-7
    assert 12.0 < errors[0] / errors[1] < 20.0


CHAINS = {
    "everything": (EVERYTHING, EVERYTHING_VALUES, 0.5),
    "knee": (KNEE.chain(), KNEE.values, 0.8),
    "geared": (GEARED, LIGHT, 0.2),
}


@pytest.mark.parametrize("case", CHAINS)
def test_a_drive_that_does_not_look_is_a_torque(case):
    """Without feedback the closed loop is the forward model, in segments and between samples."""
    chain, values, size = CHAINS[case]
    time = np.arange(400) * 2e-3
    torque = size * (np.sin(9.0 * time) + 0.4 * np.sin(31.0 * time))
    law = Law(torque, np.ones(400), 0.0, 0.0, np.inf, 0.0, None)
    rows = chain.vector(values) * np.array([[1.0], [0.9], [-1.0]])
    segments, q0, qd0 = [(0, 150), (170, 400)], np.array([0.1, -0.2]), np.array([0.0, 0.5])
    q, qd = follow(chain, rows, law, 2e-3, segments, q0, qd0, step=2.5e-4)
    # between segments, and with a negative inertia, there is no motion
    assert np.isnan(q[:, 150:170]).all()
    assert np.isnan(q[2]).all()
    for v, row in enumerate(rows[:2]):
        for k, (a, b) in enumerate(segments):
            one = simulate(chain, row, torque[a:b], 2e-3, q0=q0[k], qd0=qd0[k], substeps=8)
            np.testing.assert_allclose(q[v, a:b], one.q, atol=1e-7)
            np.testing.assert_allclose(qd[v, a:b], one.qd, atol=1e-5)


@pytest.mark.parametrize("held", [False, True])
def test_a_drive_gives_the_torque_of_its_law(held):
    """Gains, limit, scale, back-EMF, switched off for a while, and a push: by the inverse model."""
    period, n = 1e-3, 1200
    time = period * np.arange(n)
    command, scale = 0.8 * np.sin(6.0 * time), 1.0 + 0.3 * np.cos(2.0 * time)
    off = (time > 0.5) & (time < 0.7)
    law = Law(command, scale, 0.5, 0.03, 0.35, 0.02, off, held)
    push = 0.05 * np.cos(5.0 * time)[None]
    q, qd = (
        x[0]
        for x in follow(
            GEARED, GEARED.vector(LIGHT)[None], law, period, [(0, n)], np.zeros(1), np.zeros(1),
            push=push, step=1e-4,
        )
    )  # fmt: skip
    aimed = np.clip(command - 0.5 * q - 0.03 * qd, -0.35, 0.35)
    given = np.where(off, 0.0, scale * aimed - 0.02 * qd) + push[0]
    assert (np.abs(aimed) == 0.35).mean() > 0.2
    # what the motion took, over the two samples that a central difference spans
    qdd = (qd[2:] - qd[:-2]) / (2.0 * period)
    taken = inverse_torque(GEARED, GEARED.vector(LIGHT), q[1:-1], qd[1:-1], qdd)
    smooth = np.ones(n - 2, dtype=bool)
    for edge in np.flatnonzero(np.diff(off.astype(int))):
        smooth[max(edge - 3, 0) : edge + 3] = False
    left = np.abs(taken - given[1:-1])[smooth]
    # held commands are half a sample late on average
    late = 0.5 * np.abs(np.gradient(scale * command)).max() if held else 0.0
    assert np.quantile(left, 0.95) < 2e-5 + late
    assert left.max() < 2e-3 + late


LATE = replace(PLAIN, delay=True, by_target=True)
LOOP = {"motor.inertia": 0.02, "motor.viscous": 0.05}


def late_loop(delay, command, period, held, chain=LATE, **more):
    law = Law(command, np.ones(command.size), 4.0, 0.1, held=held)
    values = LOOP | ({"target.delay": delay} if chain.delay else {})
    q, _ = follow(
        chain, chain.vector(values)[None], law, period, [(0, command.size)], np.zeros(1),
        np.zeros(1), **more,
    )  # fmt: skip
    return q[0]


@pytest.mark.parametrize("held", [False, True])
def test_a_target_some_samples_late_is_the_target_of_then(held):
    command = 2.0 * np.sin(9.0 * TIME)
    moved = np.concatenate([np.full(3, command[0]), command[:-3]])
    found = late_loop(3 * PERIOD, command, PERIOD, held)
    np.testing.assert_allclose(found, late_loop(0.0, moved, PERIOD, held, PLAIN), atol=1e-12)


@pytest.mark.parametrize("samples", [0.25, 1.3, 2.9])
def test_a_held_target_is_late_by_a_fraction_of_a_sample(samples):
    """Against the same steps laid out on a grid of a hundredth of the period."""
    fine, coarse = 100, 100
    period = 0.02
    command = 2.0 * np.sin(9.0 * period * np.arange(coarse))
    place = np.floor(np.arange(coarse * fine) / fine - samples + 1e-9).astype(int)
    steps = command[np.maximum(place, 0)]
    wanted = late_loop(0.0, steps, period / fine, True, PLAIN)[::fine]
    found = late_loop(samples * period, command, period, True)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


@pytest.mark.parametrize(("smoothness", "passage"), [(0.0, "line"), (0.5, "held"), (1.0, "curve")])
def test_how_a_target_passes_between_samples(smoothness, passage):
    """The smoothness of a sampled target moves the joint as one sampled a hundred times as fast.

    A held target is half a sample late, and attenuated by half as much as a line. What is left of
    it is its sawtooth about that, of the height of a step, at the sampling rate.
    """
    period, factor, n, kp, inertia = 0.02, 100, 300, 20.0, 0.02
    time = period / factor * np.arange(n * factor)
    curve = np.sin(2.0 * np.pi * 3.0 * time) + 0.5 * np.sin(2.0 * np.pi * 1.1 * time)
    target = curve[::factor]
    line = np.interp(time, time[::factor], target)
    passages = {"line": line, "held": np.repeat(target, factor), "curve": curve}
    values = {"motor.inertia": inertia, "motor.viscous": 0.3}
    start = np.zeros(1), np.zeros(1)

    def moved(target):
        law = Law(kp * target, np.ones(target.size), kp, 0.1)
        rows, pieces = PLAIN.vector(values)[None], [(0, target.size)]
        return follow(PLAIN, rows, law, period / factor, pieces, *start)[0][0, ::factor]

    wanted = moved(passages[passage])
    joint = replace(PLAIN, by_target=True, delay=True, smoothness=True)
    late = {"target.delay": 0.5 * period if passage == "held" else 0.0}
    vector = joint.vector(values | late | {"target.smoothness": smoothness})
    law = Law(kp * target, np.ones(n), kp, 0.1, held=None)
    q, _ = follow(joint, vector[None], law, period, [(0, n)], *start)
    settled = slice(n // 3, n - 5)  # a spline ends as a line, and all begin at rest
    error = np.abs(q[0] - wanted)[settled].max()
    if passage == "held":
        sawtooth = np.abs(np.diff(target)).max() / np.pi
        assert error < 2.0 * sawtooth * kp / (inertia * (2.0 * np.pi / period) ** 2)
    else:
        assert error < 0.02 * np.abs(moved(line) - moved(curve))[settled].max()
