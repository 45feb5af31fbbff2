"""The filter of the closed loop, against an exact Kalman filter of a linear joint."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from bayesfric.mechanism.closed_loop import follow, innovations
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import ACCELERATION, Inputs, Law, Signal

PERIOD, N = 5e-3, 300
INERTIA, VISCOUS, KP, KD, LATE = 0.02, 0.05, 4.0, 0.1, 7e-3
SLOW, TAU, WHITE, ENCODER, INSTANTS, RESOLUTION = 0.2, 0.03, 2e-3, 1e-4, 3e-4, 1e-3
JOINT = Joint([Element("motor", inertia=True, viscous=True)], Load(), delay=True, by_target=True)


def exact(target, y, stride):
    """Position, speed and slow torque under a held target that changes once between samples.

    White torque moves the speed at the end of a sample by its sum, the position by the mean of it.
    """
    a = np.array([[0, 1, 0], [-KP / INERTIA, -(KD + VISCOUS) / INERTIA, 1 / INERTIA], [0, 0, 0.0]])
    b = np.array([0.0, KP / INERTIA, 0.0])

    def over(span):
        big = np.zeros((4, 4))
        big[:3, :3], big[:3, 3] = a * span, b * span
        big = expm(big)
        return big[:3, :3], big[:3, 3]

    late = LATE / PERIOD
    whole, rest = int(late), (late - int(late)) * PERIOD
    (f1, g1), (f2, g2) = over(rest), over(PERIOD - rest)
    keeps = np.exp(-PERIOD / TAU)
    f, decay = f2 @ f1, np.diag([1.0, 1.0, keeps])
    kick = (WHITE / INERTIA) ** 2 * PERIOD
    q = np.diag([kick * PERIOD**2 / 3, kick, SLOW**2 * (1 - keeps**2)])
    q[0, 1] = q[1, 0] = 0.5 * kick * PERIOD
    base, speed = ENCODER**2 + RESOLUTION**2 / 12, (y[2] - y[0]) / (2 * PERIOD)
    x, p = (
        np.array([y[0], speed, 0.0]),
        np.diag([base, (0.3 * speed) ** 2 + base / PERIOD**2, SLOW**2]),
    )
    errors, variances = np.zeros(N), np.ones(N)
    for k in range(N):
        if k and k % stride == 0:
            s = p[0, 0] + base + (INSTANTS * x[1]) ** 2
            errors[k], variances[k] = y[k] - x[0], s
            gain = p[:, 0] / s
            x, p = x + gain * errors[k], p - np.outer(gain, gain) * s
        old, new = target[max(k - whole - 1, 0)], target[max(k - whole, 0)]
        x = f2 @ (f1 @ x + g1 * old) + g2 * new
        p = f @ p @ f.T
        x, p = decay @ x, decay @ p @ decay + q
    return errors, variances


@pytest.mark.parametrize("stride", [1, 4])
def test_a_linear_joint_has_the_kalman_filter(stride):
    """No friction but viscous: the cubature points carry mean and covariance exactly."""
    rng = np.random.default_rng(3)
    time = PERIOD * np.arange(N)
    target = 0.5 * np.sin(9.0 * time) + 0.1 * np.sin(40.0 * time)
    y = 0.4 * np.sin(9.0 * time - 0.5) + 1e-3 * rng.standard_normal(N)
    values = JOINT.vector(
        {"motor.inertia": INERTIA, "motor.viscous": VISCOUS, "target.delay": LATE}
    )
    noise = np.array([[SLOW, TAU, WHITE, ENCODER, INSTANTS]])
    law = Law(KP * target, np.ones(N), KP, KD, held=True)
    error, variance = innovations(
        JOINT, values[None], noise, law, PERIOD, [(0, N)], y, np.ones(N, bool),
        resolution=RESOLUTION, stride=stride, step=5e-4,
    )  # fmt: skip
    wanted_error, wanted_variance = exact(target, y, stride)
    np.testing.assert_allclose(variance[0], wanted_variance, rtol=1e-6)
    np.testing.assert_allclose(error[0], wanted_error, atol=1e-8)


HARD = Joint(
    [Element("motor", inertia=True, viscous=True, coulomb="symmetric")],
    Load(first_moment=True),
    delay=True,
    by_target=True,
)


def by_points(joint, values, target, limit, y):
    """The same by cubature points, each through the simulated joint with small steps."""
    whole, rest = int(LATE / PERIOD), LATE % PERIOD
    base, speed = ENCODER**2 + RESOLUTION**2 / 12, (y[2] - y[0]) / (2 * PERIOD)
    keeps = np.exp(-PERIOD / TAU)
    x, p = (
        np.array([y[0], speed, 0.0]),
        np.diag([base, (0.3 * speed) ** 2 + base / PERIOD**2, SLOW**2]),
    )
    kick = (WHITE / INERTIA) ** 2 * PERIOD
    noise = np.diag([kick * PERIOD**2 / 3, kick, SLOW**2 * (1 - keeps**2)])
    noise[0, 1] = noise[1, 0] = 0.5 * kick * PERIOD
    errors, variances, repeated = np.zeros(N), np.ones(N), 1
    for k in range(N):
        if k:
            repeated = repeated + 1 if y[k] == y[k - 1] else 1
            s = p[0, 0] + ENCODER**2 + RESOLUTION**2 / 12 * repeated + (INSTANTS * x[1]) ** 2
            errors[k], variances[k] = y[k] - x[0], s
            gain = p[:, 0] / s
            x, p = x + gain * errors[k], p - np.outer(gain, gain) * s
        root = np.sqrt(3.0) * np.linalg.cholesky(p)
        points = x + np.concatenate([root.T, -root.T])
        pairs = [(2 * i, 2 * i + 2) for i in range(6)]
        for span, j in ((rest, k - whole - 1), (PERIOD - rest, k - whole)):
            command = np.full(12, KP * target[max(j, 0)])
            law = Law(command, np.ones(12), KP, KD, limit=limit, held=True)
            q, qd = follow(
                joint, values[None], law, span, pairs, points[:, 0], points[:, 1],
                push=np.repeat(points[:, 2], 2)[None], step=1e-4,
            )  # fmt: skip
            points[:, 0], points[:, 1] = q[0, 1::2], qd[0, 1::2]
        points[:, 2] *= keeps
        x = points.mean(axis=0)
        p = np.cov(points.T, bias=True) + noise
    return errors, variances


@pytest.mark.parametrize("limit", [np.inf, 0.9])
def test_a_joint_that_reverses_and_saturates_has_the_points_moments(limit):
    """Where its motion is linear enough no points are moved; both say the same to a hundredth."""
    rng = np.random.default_rng(8)
    time = PERIOD * np.arange(N)
    target = 0.9 * np.sin(6.0 * time) + 0.1 * np.sin(31.0 * time)
    numbers = {"motor.inertia": INERTIA, "motor.viscous": VISCOUS, "motor.coulomb": 0.15}
    numbers |= {"load.first_moment": 0.03}
    plain = HARD.vector({**numbers, "target.delay": 0.0})
    law = Law(KP * target, np.ones(N), KP, KD, limit=limit, held=True)
    q, _ = follow(HARD, plain[None], law, PERIOD, [(0, N)], [0.0], [0.0])
    y = q[0] + 1e-3 * rng.standard_normal(N)
    noise = np.array([[SLOW, TAU, WHITE, ENCODER, INSTANTS]])
    values = HARD.vector({**numbers, "target.delay": LATE})
    error, variance = innovations(
        HARD, values[None], noise, law, PERIOD, [(0, N)], y, np.ones(N, bool),
        resolution=RESOLUTION, step=1e-3,
    )  # fmt: skip
    wanted_error, wanted_variance = by_points(HARD, plain, target, limit, y)
    assert np.abs(error[0] - wanted_error).max() < 0.01 * np.sqrt(wanted_variance.min())
    np.testing.assert_allclose(variance[0], wanted_variance, rtol=0.01)


def test_the_effect_of_a_torque_is_that_of_the_same_offset():
    """Against the errors of a joint whose motor has the torque as its offset; without kinks."""
    rng = np.random.default_rng(9)
    joint, time, small = replace(HARD, offset=True), PERIOD * np.arange(N), 1e-5
    numbers = {"motor.inertia": INERTIA, "motor.viscous": VISCOUS, "motor.coulomb": 0.0}
    numbers |= {"load.first_moment": 0.03, "target.delay": LATE}
    vectors = np.array([joint.vector({**numbers, "offset": x}) for x in (0.0, -small)])
    law = Law(KP * 0.9 * np.sin(6.0 * time), np.ones(N), KP, KD, held=True)
    q, _ = follow(joint, vectors[:1], law, PERIOD, [(0, N)], [0.0], [0.0])
    y = q[0] + 1e-3 * rng.standard_normal(N)
    noise = np.array([[SLOW, TAU, WHITE, ENCODER, 0.0]])  # gains then change by no speed
    arguments = (law, PERIOD, [(0, N)], y, np.ones(N, bool))
    errors, _ = innovations(
        joint, vectors, np.repeat(noise, 2, axis=0), *arguments, resolution=RESOLUTION
    )
    effects, _ = innovations(
        joint, vectors[:1], noise, *arguments, pushes=np.ones((1, N)), resolution=RESOLUTION
    )
    change = (errors[1] - errors[0]) / small
    assert np.linalg.norm(effects[0] - change) < 1e-3 * np.linalg.norm(change)


@pytest.mark.parametrize("computed", ["load_torque", "arm"])
def test_an_inertia_by_a_column_is_an_inertia(computed):
    """A torque that is an inertia times the recorded acceleration is no torque, but inertia."""
    rng = np.random.default_rng(4)
    time, y = PERIOD * np.arange(N), 1e-3 * rng.standard_normal(N).cumsum()
    law = Law(KP * np.sin(7.0 * time), np.ones(N), KP, KD, held=True)
    noise, more = np.array([[SLOW, TAU, WHITE, ENCODER, INSTANTS]]), 0.03
    recorded = rng.standard_normal(N)
    columns = {ACCELERATION: recorded, f"{computed} inertia": np.full(N, more)}
    columns |= {"arm": more * recorded} if computed == "arm" else {}
    pushed = Signal(time, -more * recorded) if computed == "load_torque" else None
    inputs = Inputs(load_torque=pushed, others={k: Signal(time, x) for k, x in columns.items()})
    numbers = {"motor.inertia": INERTIA, "motor.viscous": VISCOUS, "target.delay": LATE}
    signals = ("arm",) if computed == "arm" else ()
    joint = replace(JOINT, load=Load(signals=signals), own_inertia=True)
    outcomes = [
        innovations(
            chain, chain.vector(values)[None], noise, law, PERIOD, [(0, N)], y, np.ones(N, bool),
            resolution=RESOLUTION, inputs=known, time=time,
        )
        for chain, values, known in (
            (joint, numbers | ({"load.arm": 1.0} if signals else {}), inputs),
            (JOINT, numbers | {"motor.inertia": INERTIA + more}, Inputs()),
        )
    ]  # fmt: skip
    np.testing.assert_allclose(outcomes[0], outcomes[1], rtol=1e-9, atol=1e-12)


def test_a_joint_follows_its_target_under_a_changing_load():
    """Inertia and torque of the load that change with time, against SciPy's integrator."""
    time = PERIOD * np.arange(N)
    inertia, torque = 0.02 + 0.01 * np.sin(5.0 * time), 0.5 * np.cos(3.0 * time)
    columns = {ACCELERATION: 0.0 * time, "load_torque inertia": inertia}
    inputs = Inputs(
        load_torque=Signal(time, -torque), others={k: Signal(time, x) for k, x in columns.items()}
    )
    values = JOINT.vector({"motor.inertia": INERTIA, "motor.viscous": VISCOUS, "target.delay": 0.0})
    law = Law(KP * np.sin(7.0 * time), np.ones(N), KP, KD, held=False)
    q, _ = follow(
        replace(JOINT, own_inertia=True), values[None], law, PERIOD, [(0, N)], [0.0], [0.0],
        inputs=inputs, time=time,
    )  # fmt: skip

    def motion(t, x):
        aim = np.interp(t, time, law.command) - KP * x[0] - (KD + VISCOUS) * x[1]
        total = INERTIA + np.interp(t, time, inertia)
        return x[1], (aim - np.interp(t, time, torque)) / total

    wanted = solve_ivp(motion, (0.0, time[-1]), (0.0, 0.0), t_eval=time, rtol=1e-8, max_step=1e-3)
    # the load is held at its mean over each sample
    np.testing.assert_allclose(q[0], wanted.y[0], atol=1e-4 * np.ptp(wanted.y[0]))
