"""SIMULATED joints with one thing missing in the model that is fitted, and right ones."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "calibration"))

from bench import CASES, PLAIN, Bench, Drive, recorded

from bayesfric import Element, Joint, Load, Term

__all__ = ["BENCHES", "LACKING", "RIGHT", "recorded"]

RIGHT = (
    "plain", "slow", "geared", "plain, 100 Hz", "plain, 1 kHz", "geared, encoder at the joint",
    "sticking", "current", "knee", "knee, loaded pair",
)  # fmt: skip
WORST = ("sticking", "knee")

# An arm with its inertia before and behind the gearbox, fast enough to show both.
_VALUES = {**PLAIN, "motor.inertia": 0.02, "load.inertia": 0.03}
_DRIVE = Drive(3.0, square=0.3, hertz=0.7)


def _arm(**options: object) -> Joint:
    motor: dict[str, object] = {"inertia": True, "coulomb": "symmetric", "viscous": True}
    load = Load(first_moment=True, inertia=True)
    terms = options.pop("terms", ())
    element = Element("motor", **(motor | options))  # type: ignore[arg-type]
    return Joint(elements=(element,), load=load, offset=True, terms=terms)  # type: ignore[arg-type]


# the model that is fitted takes all inertia together: nothing tells the two apart without losses
_FITTED = Joint(
    elements=(Element("motor", inertia=True, coulomb="symmetric", viscous=True),),
    load=Load(first_moment=True),
    offset=True,
)
_arm_bench = Bench(_FITTED, _VALUES, (_DRIVE,), duration=20.0, counts=16384, true=_arm())


def _lacking(true: Joint, **values: float) -> Bench:
    return replace(_arm_bench, true=true, values={**_VALUES, **values})


def _term(name: str, column: object) -> Term:
    return Term(f"motor.{name}", column)  # type: ignore[arg-type]


# Name, kinds that are right, and the bench; sizes in shares of the torque's rms, or as said.
LACKING: dict[str, tuple[tuple[str, ...], Bench]] = {
    "torque constant sags by 5 %": (("saturation",), replace(_arm_bench, sag=0.05)),
    "load loss 15 %": (
        ("load_loss", "load_loss_by_power"),
        _lacking(_arm(load_loss="one"), **{"motor.load": 0.15}),
    ),
    "Stribeck rise 40 %": (
        ("stribeck",),
        _lacking(
            _arm(stribeck=True), **{"motor.stribeck_ratio": 0.4, "motor.stribeck_velocity": 0.5}
        ),
    ),
    "viscous by direction 30 %": (
        ("viscous_by_direction",),
        _lacking(
            _arm(viscous="by-direction"),
            **{"motor.viscous_positive": 0.115, "motor.viscous_negative": 0.085},
        ),
    ),
    "12 times a turn, 2 %": (("repeating",), replace(_arm_bench, ripple=(0.02, 12))),
    "once a turn, 3 %": (
        ("repeating", "gravity"),
        replace(_arm_bench, ripple=(0.03, 1)),
    ),
    "a push, 20 % for 0.3 s": (
        ("push",),
        _lacking(
            _arm(terms=(_term("push", lambda m: np.exp(-(((m.time - 7.3) / 0.2) ** 2))),)),
            **{"motor.push": 0.3},
        ),
    ),
    "a loss with the root of speed": (
        ("power",),
        _lacking(
            _arm(terms=(_term("root", lambda m: m.direction * np.abs(m.speed) ** 0.5),)),
            **{"motor.root": 0.15},
        ),
    ),
    "quadratic loss": (("quadratic",), _lacking(_arm(quadratic=True), **{"motor.quadratic": 0.01})),
    "warming 30 %": (
        ("coulomb_warming",),
        _lacking(
            _arm(warming="constant"),
            **{"motor.coulomb_warming": -0.09, "motor.warming_time": 8.0},
        ),
    ),
    "3 ms late": (("delay",), replace(_arm_bench, late=1.5)),
    "a spring": (
        ("spring",),
        _lacking(_arm(terms=(_term("stiff", lambda m: m.position),)), **{"motor.stiff": 0.1}),
    ),
}
BENCHES: dict[str, tuple[tuple[str, ...], Bench]] = {
    **{name: ((), CASES[name]) for name in RIGHT},
    "arm": ((), _arm_bench),
    **{
        f"{name}, {memory} noise": ((), replace(CASES[name], memory=memory))
        for memory in ("ar2", "1/f")
        for name in WORST
    },
    **LACKING,
}
