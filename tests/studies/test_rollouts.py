"""What the committed studies of roll-outs claim, and a small form of the simulated one again."""

import numpy as np
import pytest

from .bench import committed, scripts

study = scripts("rollouts", folders=["rollouts"])


def test_bands_of_simulated_joints_hold_another_recording():
    found = committed("rollouts/rollouts.json")
    for name, rows in found.items():
        assert len(rows) == 30
        for loop in ("closed", "open"):
            inside = np.array([row[loop]["inside"] for row in rows])
            error = inside.std(ddof=1) / np.sqrt(len(rows))
            assert inside.mean() > 0.9 - max(0.06, 3.0 * error), (name, loop)


def test_the_measured_servo_moves_as_told():
    """Held-out gains below saturation are held; at the highest the command warns."""
    found = committed("xl330/rollout.json")["rollouts"]
    for gains in found.values():
        for gain, one in gains.items():
            inside = one["pooled"]["position"]["inside"]
            assert (inside < 0.8) == (gain == "800"), gain
        assert gains["400"]["pooled"]["position"]["mae"] < 0.035


@pytest.mark.slow
def test_two_joints_again(study):
    before = committed("rollouts/rollouts.json")
    for name in ("nothing", "Stribeck rise"):
        again = study.joint_of(name, 0)
        for loop in ("closed", "open"):
            new, old = again[loop], before[name][0][loop]
            # MAE is of the median of a hundred draws: five standard errors of the difference of two
            sd = new["alone_width"] / 3.29
            error = sd * np.sqrt(np.pi / 2.0 * 2.0 / 100.0)
            assert abs(new["mae"] - old["mae"]) < 5.0 * error, (name, loop)
