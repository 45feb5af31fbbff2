"""Where inertia stands: what it is called, and whether a load loss sees it."""

import numpy as np

import bayesfric as bf
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.report.summary.summary import summarise
from tests.report.conftest import build

SERVO = Joint.preset("servo-pendulum")


def meaning(joint, name):
    return next(p.meaning for p in joint.parameters if p.name == name)


def test_the_only_inertia_is_told_as_that_of_everything():
    assert meaning(SERVO, "motor.inertia") == "inertia of everything that moves, seen by the motor"
    knee = Joint.preset("rabbit-knee")
    assert "everything" not in meaning(knee, "motor.inertia") + meaning(knee, "load.inertia")


def test_it_is_unseen_where_the_load_loss_does_not_change_with_it():
    """By the torque itself: the loss of the servo's gearbox depends on gravity alone."""
    geared = Element("gearbox", load_loss="one")
    behind = Joint((Element("motor"), geared), Load(inertia=True, first_moment=True))
    both = Joint((Element("motor", inertia=True), geared), Load(inertia=True, first_moment=True))
    bearing = Joint((Element("motor"), geared, Element("bearing", inertia=True)))
    joints = [SERVO, Joint.preset("rabbit-knee"), Joint.preset("motor-axis"), behind, both]
    for joint in (*joints, bearing):
        values = dict.fromkeys(joint.names, 0.3)
        lossless = {n: 0.0 if n.startswith("gearbox.load") else x for n, x in values.items()}

        def loss(acceleration, joint=joint, values=values, lossless=lossless):
            motion = (0.4, 1.0, acceleration)
            return joint.torque(values, *motion) - joint.torque(lossless, *motion)

        lossy = any("gearbox.load" in name for name in joint.names)
        blind = lossy and np.isclose(loss(3.0), loss(0.0)).all()
        assert bool(joint.unseen_inertia) == blind


def test_check_and_run_say_so_with_the_mend():
    time = np.arange(3000) * 0.002
    q = np.sin(4.0 * time) + 0.4 * np.sin(11.0 * time)
    checked = bf.check(bf.Model(SERVO, bf.Recording.from_arrays(time, q, np.cos(4.0 * time))))
    assert "unseen-inertia" in [one["kind"] for one in checked.found["doubts"]]
    said = " ".join(summarise(build(SERVO, samples=300)).warnings)
    assert "the load loss sees no inertia" in said
    assert "inertia = true under [mechanism.load], in place of motor.inertia" in said
    assert "the load loss sees no inertia" not in " ".join(summarise(build(samples=300)).warnings)
