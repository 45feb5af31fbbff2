"""Where inertia stands: whether a load loss sees it."""

import numpy as np

from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint

SERVO = Joint.preset("servo-pendulum")


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
