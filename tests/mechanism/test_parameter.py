"""What is said of a quantity fits how its joint moves."""

import pytest

from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import effort_words, parameter
from bayesfric.mechanism.quantities import QUANTITIES, State


@pytest.mark.parametrize("quantity", ["offset", "gain", "load_drive", "load_back", "load"])
def test_what_slides_has_forces(quantity):
    turning, sliding = (
        parameter("motor", QUANTITIES[quantity], motion, "m") for motion in ("rotary", "linear")
    )
    assert "torque" in turning.meaning
    assert sliding.meaning == turning.meaning.replace("torque", "force")


def test_names_stay_names():
    words = "noise.torque, torque-steps and torque_constant are names, torques and a torque are not"
    assert effort_words(words, "rotary") == words
    assert effort_words(words, "linear") == (
        "noise.torque, torque-steps and torque_constant are names, forces and a force are not"
    )


def test_a_ripple_of_what_slides_is_told_in_metres():
    """Its column takes the position as it is: 2513 cycles in 2π m are 400 a metre."""
    slides = Joint([Element("motor", cogging=(2513,), motion="linear")], load=Load(motion="linear"))
    (sine, _) = (p for p in slides.parameters if "cogging" in p.name)
    assert sine.meaning == "force with the sine of 2513 cycles in 2π m"
    state = State(1.0 / 1600.0, 0.0, 0.0, 0.0, 0.0)
    assert sine.row.column(state) == pytest.approx(1.0, abs=1e-4)
