"""What is said of a quantity fits how its joint moves."""

import pytest

from bayesfric.mechanism.parameter import effort_words, parameter
from bayesfric.mechanism.quantities import QUANTITIES


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
