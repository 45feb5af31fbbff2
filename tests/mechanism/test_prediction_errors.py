"""The filter of the closed loop, against an exact Kalman filter of a linear joint."""

import numpy as np
import pytest
from scipy.linalg import expm

from bayesfric.mechanism.closed_loop import innovations
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Law

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
