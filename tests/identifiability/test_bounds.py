"""Which noise identify's sds are for, and that a limit is none of the determined."""

import numpy as np

import bayesfric as bf

AXIS, MEMORY = bf.Joint.preset("motor-axis"), 0.97


def test_a_limit_is_not_called_determined():
    """Without a load loss in the recording its alphas stand at one: what fit calls the bounds'."""
    pendulum = bf.Joint.preset("servo-pendulum")
    values = {"gearbox.load": 0.0, "motor.coulomb": 0.1}
    made = pendulum.simulate(values, rate=200, duration=10.0, excitation="multisine",
                             amplitude=1.0, torque_noise=0.05, seed=3)  # fmt: skip
    t, q, torque = (made[name].to_numpy() for name in ("time", "position", "torque"))
    # an efficiency above one, which is none, is asked for: the loss is held at zero
    lifted = torque - 0.02 * np.abs(torque) * np.sign(np.gradient(q, t))
    found = bf.Model(pendulum, bf.Recording.from_arrays(t, q, lifted)).identification()
    (loss,) = (p for p in found.parameters if p.name == "gearbox.load")
    assert loss.on_bound == "lower"
    named = {one.name: one for one in found.combinations}
    assert named["gearbox.alpha_drive"].on_bound == "lower"
    determined = [one.name for one in found.determined]
    assert "total_drive.gravity_size" in determined
    assert not any("alpha" in name or "efficiency" in name for name in determined)
