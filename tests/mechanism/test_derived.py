"""Totals of the motor side are what steady speeds show, efficiencies what loads do."""

import numpy as np
import pytest

from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.element import STANDARD_GRAVITY, Element, Load
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS, Joint


def test_what_is_told_by_direction_makes_every_total_of_its_kind_so():
    """Motor torque per steady speed, each way: the element without directions is in both."""
    parts = Element("motor", viscous=True), Element("gearbox", ratio=5.0)
    chain = Joint((*parts, Element("joint", viscous="by-direction")))
    x = np.array([0.02, 0.5, 1.5])
    totals = {d.name: float(d.values[0]) for d in derive(chain, x[None], 1.0)}
    for way, name in ((1.0, "positive"), (-1.0, "negative")):
        torque = inverse_torque(chain, x, [0.0], [way * 2.0 / chain.ratio], [0.0])
        assert totals[f"total.viscous_{name}"] == pytest.approx(torque[0] / (way * 2.0), rel=1e-12)
    assert "total.viscous" not in totals


@pytest.mark.parametrize("angle", [0.4, -1.5, 2.9])
def test_what_an_angle_turns_has_a_size_of_another_name_than_its_sine_part(angle):
    """Least squares calls the sine part ``total.gravity``; the motor's torque at rest has both."""
    chain = Joint(
        (Element("motor"), Element("gearbox", ratio=5.0)),
        Load(first_moment=True, gravity_angle=True),
    )
    x = chain.vector({"load.first_moment": 3.0, "load.gravity_angle": angle})
    totals = {d.name: d.values[0] for d in derive(chain, x[None], 1.0)}
    still = np.zeros(2)
    cosine, sine = inverse_torque(chain, x, np.array([0.0, 0.5 * np.pi]), still, still)
    assert totals["total.gravity_size"] == pytest.approx(np.hypot(sine, cosine), rel=1e-12)
    assert "total.gravity" not in totals


@pytest.mark.parametrize("loss", ["one", "two"])
def test_an_efficiency_counts_what_grows_with_the_torque(loss):
    """Torque that slowly lifts and lowers a weight, over the weight; eq. (4) with all losses."""
    chain = Joint(
        (Element("motor"), Element("gearbox", 6.0, load_loss=loss, load_square=True)),
        Load(first_moment=True),
    )
    known = {"load": 0.1, "load_drive": 0.1, "load_back": 0.15, "load_square": 0.04}
    values = {f"gearbox.{name}": value for name, value in known.items()}
    values["load.first_moment"] = 2.0
    x = chain.vector({name: values[name] for name in chain.names})
    weight = 2.0 * STANDARD_GRAVITY
    derived = {d.name: d.values[0] for d in derive(chain, x[None], weight)}
    lifts, lowers = inverse_torque(
        chain, x, np.array([0.5, 0.5]) * np.pi, np.array([1e-9, -1e-9]), np.zeros(2)
    )
    drive, back = (derived[f"gearbox.efficiency_{side}"] for side in ("drive", "back"))
    assert drive == pytest.approx(weight / (6.0 * lifts), rel=1e-9)
    assert back == pytest.approx(6.0 * lowers / weight, rel=1e-9)
    # there is no total: what the motor feels of the inertia depends on the weight
    assert not [name for name in derived if name.startswith("total")]


def test_inertia_is_unseen_where_the_load_loss_does_not_change_with_it():
    """By the torque itself: the loss of the servo's gearbox depends on gravity alone."""
    geared = Element("gearbox", load_loss="one")
    behind = Joint((Element("motor"), geared), Load(inertia=True, first_moment=True))
    both = Joint((Element("motor", inertia=True), geared), Load(inertia=True, first_moment=True))
    bearing = Joint((Element("motor"), geared, Element("bearing", inertia=True)))
    joints = [*map(Joint.preset, PRESETS), behind, both]
    for joint in (*joints, bearing):
        values = dict.fromkeys(joint.names, 0.3)
        lossless = {n: 0.0 if n.startswith("gearbox.load") else x for n, x in values.items()}

        def loss(acceleration, joint=joint, values=values, lossless=lossless):
            motion = (0.4, 1.0, acceleration)
            return joint.torque(values, *motion) - joint.torque(lossless, *motion)

        lossy = any("gearbox.load" in name for name in joint.names)
        blind = lossy and np.isclose(loss(3.0), loss(0.0)).all()
        assert bool(joint.unseen_inertia) == blind
