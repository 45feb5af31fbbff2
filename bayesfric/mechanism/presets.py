"""Named joints: the paper's knee, a motor axis, a servo pendulum."""

from __future__ import annotations

from dataclasses import dataclass

from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.element import Element, Load


@dataclass(frozen=True)
class Preset:
    """A named chain with values to simulate it with."""

    name: str  # as written in a configuration
    meaning: str  # one line
    when: str  # kind of joint to choose it for, one line
    elements: tuple[Element, ...]
    load: Load
    values: dict[str, float]  # true parameter values for simulation, by name, SI
    source: str  # where these are from
    offset: bool = False

    def chain(self) -> Chain:
        """Make the chain, which keeps the preset's name as ``made_from``."""
        return Chain(self.elements, self.load, self.offset, made_from=self.name)


def _mu(alpha_drive: float, alpha_back: float) -> dict[str, float]:
    # alpha_1 = 1/(1 + mu_1), alpha_2 = 1/(1 - mu_2), eq. (6)
    return {
        "gearbox.load_drive": 1.0 / alpha_drive - 1.0,
        "gearbox.load_back": 1.0 - 1.0 / alpha_back,
    }


PRESETS: dict[str, Preset] = {
    preset.name: preset
    for preset in (
        Preset(
            "rabbit-knee",
            "motor, gearbox that passes torque differently when driving and back-driven, leg",
            "a leg or an arm behind a gearbox of high ratio that loses more the more it carries",
            # eqs. (3) to (9)
            (
                Element("motor", inertia=True, coulomb="by-direction", viscous=True, subscript="m"),
                Element("gearbox", ratio=50.0, load_loss="two"),
                Element("joint", coulomb="by-direction", viscous=True, subscript="c"),
            ),
            Load(inertia=True, first_moment=True),
            {
                "motor.inertia": 3.56e-4,
                "motor.viscous": 4.0e-3,
                "motor.coulomb_positive": 0.087,
                "motor.coulomb_negative": 0.091,
                **_mu(0.7432, 1.408),
                "joint.viscous": 3.12,
                "joint.coulomb_positive": 5.03,
                "joint.coulomb_negative": 5.15,
                "load.inertia": 0.206,
                "load.first_moment": 0.42,
            },
            "Table 3 of the 2005 IFAC paper",
        ),
        Preset(
            "motor-axis",
            "one axis with inertia, Coulomb and viscous friction and a torque offset",
            "a motor, a wheel or a stage that gravity does not pull",
            (Element("motor", inertia=True, coulomb="symmetric", viscous=True, subscript="m"),),
            Load(),
            {"motor.inertia": 0.01, "motor.viscous": 0.05, "motor.coulomb": 0.2, "offset": 0.02},
            "values of a small rotary stage, made up for simulation",
            offset=True,
        ),
        Preset(
            "servo-pendulum",
            "a geared servo that swings a pendulum, all referred to its output shaft",
            "a pendulum or an arm that gravity pulls, with torque and position of the joint",
            (
                Element("motor", inertia=True, coulomb="symmetric", viscous=True, subscript="m"),
                Element("gearbox", load_loss="one"),
            ),
            Load(first_moment=True, gravity_angle=True),
            {
                "motor.inertia": 2.0e-3,
                "motor.viscous": 0.02,
                "motor.coulomb": 0.02,
                "gearbox.load": 0.2,
                "load.first_moment": 0.049,
                "load.gravity_angle": 0.02,
            },
            "values near those of a small hobby servo, made up for simulation",
        ),
    )
}
