"""Benches of SIMULATED joints: right models, models that lack one effect, faulty recordings."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "calibration"))

from bench import CASES, PLAIN, Bench, Drive
from bench import recorded as recorded_
from compliant import Compliant

from bayesfric import Element, Joint, Load, Term

__all__ = ["BENCHES", "LACKING", "RIGHT", "SIZES", "UNLISTED", "USUAL", "recorded"]


def recorded(bench: Bench | Compliant, rng: np.random.Generator, folder: Path) -> tuple[Any, ...]:
    """Write the files of one recording."""
    if isinstance(bench, Compliant):
        return bench.recorded(rng, folder)
    return recorded_(bench, rng, folder)


RIGHT = (
    "plain", "slow", "geared", "plain, 100 Hz", "plain, 1 kHz", "geared, encoder at the joint",
    "sticking", "current", "knee", "knee, loaded pair",
)  # fmt: skip
WORST = ("sticking", "knee")
Array = NDArray[np.float64]

# An arm with inertia on both sides of the gearbox, fast enough to excite both.
_VALUES = {**PLAIN, "motor.inertia": 0.02, "load.inertia": 0.03}
_DRIVE = Drive(3.0, square=0.3, hertz=0.7)


def _arm(**options: object) -> Joint:
    motor: dict[str, object] = {"inertia": True, "coulomb": "symmetric", "viscous": True}
    load = Load(first_moment=True, inertia=True)
    terms = options.pop("terms", ())
    element = Element("motor", **(motor | options))  # type: ignore[arg-type]
    return Joint(elements=(element,), load=load, offset=True, terms=terms)  # type: ignore[arg-type]


# the fitted model has one inertia: without load-dependent friction the two are not identifiable
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


# Name: usual size, correct kinds of finding, and the bench as a function of size.
EFFECTS: dict[str, tuple[float, tuple[str, ...], Callable[[float], Bench]]] = {
    "torque constant sags by": (0.05, ("saturation",), lambda x: replace(_arm_bench, sag=x)),
    "load loss": (
        0.15,
        ("load_loss", "load_loss_by_power"),
        lambda x: _lacking(_arm(load_loss="one"), **{"motor.load": x}),
    ),
    "Stribeck rise": (
        0.4,
        ("stribeck",),
        lambda x: _lacking(
            _arm(stribeck=True), **{"motor.stribeck_ratio": x, "motor.stribeck_velocity": 0.5}
        ),
    ),
    "viscous by direction": (
        0.3,
        ("viscous_by_direction",),
        lambda x: _lacking(
            _arm(viscous="by-direction"),
            **{
                "motor.viscous_positive": 0.1 * (1.0 + x / 2.0),
                "motor.viscous_negative": 0.1 * (1.0 - x / 2.0),
            },
        ),
    ),
    "12 times a turn": (0.02, ("repeating",), lambda x: replace(_arm_bench, ripple=(x, 12))),
    "once a turn": (0.03, ("repeating", "gravity"), lambda x: replace(_arm_bench, ripple=(x, 1))),
    "a push for 0.3 s": (
        0.3,
        ("push",),
        lambda x: _lacking(
            _arm(terms=(_term("push", lambda m: np.exp(-(((m.time - 7.3) / 0.2) ** 2))),)),
            **{"motor.push": x},
        ),
    ),
    "a loss with the root of speed": (
        0.15,
        ("power",),
        lambda x: _lacking(
            _arm(terms=(_term("root", lambda m: m.direction * np.abs(m.speed) ** 0.5),)),
            **{"motor.root": x},
        ),
    ),
    "quadratic loss": (
        0.01,
        ("quadratic",),
        lambda x: _lacking(_arm(quadratic=True), **{"motor.quadratic": x}),
    ),
    "warming": (
        0.3,
        ("coulomb_warming",),
        lambda x: _lacking(
            _arm(warming="constant"),
            **{"motor.coulomb_warming": -0.3 * x, "motor.warming_time": 8.0},
        ),
    ),
    "late by samples": (1.5, ("delay",), lambda x: replace(_arm_bench, late=x)),
    "a spring": (
        0.1,
        ("spring",),
        lambda x: _lacking(
            _arm(terms=(_term("stiff", lambda m: m.position),)), **{"motor.stiff": x}
        ),
    ),
}
COMPLIANT: dict[str, tuple[tuple[str, ...], Compliant]] = {
    **{
        f"elastic, {x} Hz": (("elastic",), Compliant(_FITTED, elastic=float(x)))
        for x in (15, 25, 40)
    },
    **{
        f"a gap of {x}°": (("backlash",), Compliant(_FITTED, gap=np.radians(x)))
        for x in (0.1, 0.3, 0.5)
    },
    **{
        f"a bristle of {x} rad": (("presliding",), Compliant(_FITTED, bristle=x))
        for x in (0.003, 0.01, 0.03)
    },
}


def _smooth(time: Array, x: Array, hertz: float) -> Array:
    sections = butter(4, hertz, fs=1.0 / (time[1] - time[0]), output="sos")
    return np.asarray(sosfiltfilt(sections, x))


def _speed(time: Array, position: Array) -> Array:
    return _smooth(time, np.gradient(position, time), 15.0)


def _duty(time: Array, position: Array, torque: Array) -> Array:
    """Return the duty cycle; peak torque and peak speed contribute half each."""
    speed = _speed(time, position)
    return 0.5 * torque / np.abs(torque).max() + 0.5 * speed / np.abs(speed).max()


# Faults of the recorded signals: cut-off of a filter; amplitude and cycles of a torque constant.
FAULTS: dict[str, tuple[tuple[str, ...], Bench]] = {
    **{
        f"smoothed at {f:g} Hz": (
            ("smoothed",),
            replace(_arm_bench, fault=lambda t, q, y, f=f: (_smooth(t, q, f), _smooth(t, y, f))),
        )
        for f in (1.5, 3.0, 6.0, 12.0)
    },
    **{
        f"current {name}": (("current_column",), replace(_arm_bench, fault=fault))
        for name, fault in (
            ("of the supply", lambda t, q, y: (q, y * np.abs(_duty(t, q, y)))),
            ("of the supply, signed by power", lambda t, q, y: (q, y * _duty(t, q, y))),
            ("signed by power", lambda t, q, y: (q, y * np.sign(_speed(t, q)))),
            ("without a sign", lambda _, q, y: (q, np.abs(y))),
        )
    },
    **{
        f"torque constant swings by {x:g}, {k} a turn": (
            ("torque_constant_by_angle",),
            replace(
                _arm_bench,
                fault=lambda _, q, y, x=x, k=k: (q, y / (1.0 + x * np.sin(k * q + 1.0))),
            ),
        )
        for x in (0.03, 0.1)
        for k in (1, 7)
    },
}
# Effects that no candidate describes: intervals must include them nevertheless.
UNLISTED: dict[str, tuple[tuple[str, ...], Bench]] = {
    name: ((), _lacking(_arm(terms=(_term("extra", column),)), **{"motor.extra": x}))
    for name, x, column in (
        ("a spring that stiffens", 0.05, lambda m: m.position**3),
        ("viscous by angle", 0.03, lambda m: m.speed * np.cos(3.0 * m.position)),
        ("a wandering offset", 0.1, lambda m: np.sin(2.0 * np.pi * m.time / 6.0 + 1.0)),
        ("damping that saturates", 0.2, lambda m: np.tanh(m.speed / 2.0)),
    )
}
LACKING: dict[str, tuple[tuple[str, ...], Bench | Compliant]] = {
    **{f"{name} {x:g}": (kinds, build(x)) for name, (x, kinds, build) in EFFECTS.items()},
    **{
        f"{name} {times * x:g}": (kinds, build(times * x))
        for times in (0.5, 2.0)
        for name, (x, kinds, build) in EFFECTS.items()
    },
    **COMPLIANT,
    **{
        f"late by {x:g} s": (("delay",), replace(_arm_bench, late=x * _arm_bench.rate))
        for x in (0.02, 0.05, 0.11, 0.2)
    },
}
USUAL = {
    name: LACKING[name]
    for name in [*(f"{name} {x:g}" for name, (x, *_) in EFFECTS.items()), *COMPLIANT]
}
# Cases of one effect: half, usual and double size; compliances have sizes of their kind.
SIZES = {
    **{
        name: tuple(f"{name} {times * x:g}" for times in (0.5, 1.0, 2.0))
        for name, (x, *_) in EFFECTS.items()
    },
    **{
        word: tuple(name for name in COMPLIANT if name.startswith(word))
        for word in ("elastic", "a gap", "a bristle")
    },
    **{name: (name,) for name in UNLISTED},
}
BENCHES: dict[str, tuple[tuple[str, ...], Bench | Compliant]] = {
    **{name: ((), CASES[name]) for name in RIGHT},
    "arm": ((), _arm_bench),
    **{
        f"{name}, {memory} noise": ((), replace(CASES[name], memory=memory))
        for memory in ("ar2", "1/f")
        for name in WORST
    },
    **LACKING,
    "closed loop": ((), replace(_arm_bench, loop=4.0)),
    "closed loop, ar2 noise": ((), replace(_arm_bench, loop=4.0, memory="ar2")),
    **{
        f"closed loop, {name}": (kinds, replace(bench, loop=4.0))
        for name, (kinds, bench) in USUAL.items()
    },
    **{
        f"ar2 noise, {name}": (kinds, replace(bench, memory="ar2"))
        for name, (kinds, bench) in USUAL.items()
        if isinstance(bench, Bench)
    },
    **UNLISTED,
    **{
        f"closed loop, {name}": (kinds, replace(bench, loop=4.0))
        for name, (kinds, bench) in (LACKING | UNLISTED).items()
        if name not in USUAL
    },
    **FAULTS,
    **{
        f"closed loop, {name}": (kinds, replace(bench, loop=4.0))
        for name, (kinds, bench) in FAULTS.items()
    },
}
