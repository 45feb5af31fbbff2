"""Joints of which targets and encoder are known: the simulator, and one fit of the study again."""

import numpy as np
import pytest

from .bench import committed, medians_agree, scripts

study = scripts("motion_only", folders=["motion_only"])


def test_the_simulated_joint_is_a_damped_oscillator(study):
    """Against the closed form of a step, without friction and weight; the error is one step's."""
    inertia, viscous, kp, kd, step, n = 0.02, 0.05, 4.0, 0.1, 25e-6, 40_000
    p = (inertia, viscous, 0.0, 0.0, 0.0, 0.0)
    goal = np.array([0.0, *[0.7] * 9])
    q = study.played(goal, np.zeros(n), step, n // 10, 0, 1, p, kp, kd, 0.0, 0.0)
    time = step * np.arange(n - n // 10)
    roots = np.roots([inertia, kd + viscous, kp]).astype(complex)
    a = np.linalg.solve([[1.0, 1.0], roots], [-0.7, 0.0])
    exact = 0.7 + (a[0] * np.exp(roots[0] * time) + a[1] * np.exp(roots[1] * time)).real
    assert np.abs(q[n // 10 :] - exact).max() < 2.0 * step * 0.7 * np.sqrt(kp / inertia)


@pytest.mark.slow
def test_a_servo_again(study):
    row, number = "servo, 160 counts", 101
    before = next(
        x for x in committed("motion_only/motion_only.json")[row] if x["number"] == number
    )
    again = study.fitted(row, number)
    assert again["numbers"].keys() == before["numbers"].keys()
    for name, x in again["numbers"].items():
        old = before["numbers"][name]
        # 300 independent draws of each, by importance
        assert medians_agree(x["z"] * x["sd"], old["z"] * old["sd"], old["sd"], draws=300), name
