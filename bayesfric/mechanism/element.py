"""One element of the transmission, and the load at its end (section 2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from bayesfric.mechanism.parameter import Motion, Parameter, parameter

CoulombLoss = Literal["none", "symmetric", "by-direction"]
LoadLoss = Literal["none", "one", "two"]

STANDARD_GRAVITY = 9.80665  # m/s²


@dataclass(frozen=True)
class Element:
    """Motor, belt, gearbox, bearing: every one obeys the same equation.

    With ``T`` the torque at its output brought to its input side, ``T =
    torque_out / ratio``, and ``v``, ``a`` speed and acceleration of its input,

    ``torque_in = T + J a + (Fr + mu |T|)(1 + c exp(-(v/v0)²)) sign(v) + f v + f3 v|v|``

    which is section 2.2 of the paper with the friction law of eq. (2); eq. (1)
    is its ``mu = 0`` case. ``mu`` is ``mu_1`` while ``T v > 0`` (the motor side
    drives) and ``mu_2`` while ``T v < 0`` (the load drives).

    Attributes
    ----------
    name
        Used in parameter names.
    ratio
        Input speed over output speed, positive.
    inertia, viscous, quadratic, stribeck
        Whether the element has the term.
    coulomb
        Constant loss ``Fr``: none, one value, or one for each direction of speed.
    load_loss
        ``mu``: none, one value, or one for driving and one for back-driving.
    motion
        Whether the element's input turns or slides.
    subscript
        For the LaTeX symbols.
    """

    name: str
    ratio: float = 1.0
    inertia: bool = False
    coulomb: CoulombLoss = "none"
    viscous: bool = False
    quadratic: bool = False
    stribeck: bool = False
    load_loss: LoadLoss = "none"
    motion: Motion = "rotary"
    subscript: str = ""

    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the element, in a fixed order."""
        quantities: list[str] = []
        if self.inertia:
            quantities.append("inertia")
        if self.viscous:
            quantities.append("viscous")
        if self.coulomb == "symmetric":
            quantities.append("coulomb")
        elif self.coulomb == "by-direction":
            quantities += ["coulomb_positive", "coulomb_negative"]
        if self.quadratic:
            quantities.append("quadratic")
        if self.stribeck:
            quantities += ["stribeck_ratio", "stribeck_velocity"]
        if self.load_loss == "one":
            quantities.append("load")
        elif self.load_loss == "two":
            quantities += ["load_drive", "load_back"]
        # The paper writes mu_1, mu_2 without a name behind them.
        bare = {"load", "load_drive", "load_back"} if self.name == "gearbox" else set()
        return tuple(
            parameter(
                self.name, key, self.motion, "" if key in bare else self.subscript or self.name
            )
            for key in quantities
        )


@dataclass(frozen=True)
class Load:
    """What the last element moves: ``Gamma = Jc qdd + g ml sin(q + q_g)``, eq. (3).

    The printed paper leaves out ``g`` (see the notes on errata); ``ml`` is in kg m.

    Attributes
    ----------
    inertia, first_moment, gravity_angle
        Whether the load has the term. Real arms do not hang at ``q = 0``: that is
        what ``gravity_angle`` is for.
    gravity
        m/s².
    motion
        Whether the load turns or slides.
    subscript
        For the LaTeX symbols.
    """

    inertia: bool = False
    first_moment: bool = False
    gravity_angle: bool = False
    gravity: float = STANDARD_GRAVITY
    motion: Motion = "rotary"
    subscript: str = "c"

    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the load, in a fixed order."""
        present = {
            "inertia": self.inertia,
            "first_moment": self.first_moment,
            "gravity_angle": self.gravity_angle,
        }
        return tuple(
            parameter("load", key, self.motion, self.subscript) for key, on in present.items() if on
        )
