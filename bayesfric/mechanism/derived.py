"""Quantities derived from parameters: transfer coefficients, totals at the motor, efficiencies.

The totals are the combinations that eq. (13) sees (base parameters). They do not change when leg
parameters and alpha are scaled together (section 4.2), so data identify them even where they
do not identify the parameters behind them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from bayesfric.mechanism.element import Element
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import (
    QUANTITIES,
    TOTALS,
    Parameter,
    effort_words,
    parameter,
    scales_with_torque,
)
from bayesfric.recordings.arrays import Array


@dataclass(frozen=True, eq=False)
class Derived:
    """One derived quantity."""

    name: str  # this and the next three as of a Parameter
    unit: str
    symbol: str
    meaning: str
    values: Array  # (n,), one for each parameter vector
    gauge_free: bool  # unchanged where leg parameters and alpha are scaled (section 4.2)
    of_motion: bool = False  # depends on the motion, too


def efficiencies(
    mu_drive: ArrayLike, mu_back: ArrayLike, constant_loss: ArrayLike, torque: float | Array
) -> tuple[Array, Array]:
    """Efficiencies of an element, eq. (4).

    Parameters
    ----------
    mu_drive, mu_back
        Load-dependent friction ``mu_1`` (driving) and ``mu_2`` (back-driving), without unit.
    constant_loss
        Coulomb friction ``Fr`` in the unit of ``torque``.
    torque
        Transmitted torque ``Ts``, positive, N m or N.

    Returns
    -------
    drive : ndarray
        ``1/(1 + mu_1 + Fr/Ts)``, the motor driving the load.
    back : ndarray
        ``1 - mu_2 - Fr/Ts``, the load driving the motor; ``nan`` where it would be
        negative: there the transmission is irreversible.

    Notes
    -----
    Arguments are broadcast against each other. Both efficiencies fall with the load, because ``Fr``
    does not (section 2.3).
    """
    share = np.asarray(constant_loss) / np.asarray(torque)
    drive = 1.0 / (1.0 + np.asarray(mu_drive) + share)
    back = 1.0 - np.asarray(mu_back) - share
    return drive, np.where(back >= 0.0, back, np.nan)


def derive(joint: Joint, values: Array, load_torque: float) -> tuple[Derived, ...]:
    """Derive everything the joint allows from parameter vectors.

    Parameters
    ----------
    joint
        The mechanism.
    values
        ``(n, n_parameters)`` in the order of ``joint.names``.
    load_torque
        Joint torque at which efficiencies are stated, N m or N; none are where it is zero.

    Returns
    -------
    tuple of Derived
        Totals ``total_drive.*`` and ``total_back.*`` (``total.*`` without load-dependent friction),
        then, for every element with load-dependent friction, ``alpha_drive``, ``alpha_back``,
        ``efficiency_drive`` and ``efficiency_back``; where it differs by power flow also
        ``lambda_1``, ``lambda_2`` and ``lambda_ratio``.

    Notes
    -----
    With ``mu_1, mu_2`` of the element,

    - eq. (6): ``alpha_1 = 1/(1 + mu_1)``, ``alpha_2 = 1/(1 - mu_2)``; NaN for ``mu_2 >= 1``;
    - eq. (13): ``lambda_1 = (1/alpha_1 + 1/alpha_2)/2``, ``lambda_2 = (1/alpha_1 - 1/alpha_2)/2``;
    - totals are ``Theta1 + Theta2`` while the motor drives and ``Theta1 - Theta2`` while the load
      does. There are none where load-dependent friction grows with speed or load: what the motor
      feels of one term then depends on all others.

    Coulomb friction in an efficiency is that of the element and of all behind it, brought to the
    joint, as in section 4.4. Viscous friction is not counted.
    """
    at = {name: values[:, i] for i, name in enumerate(joint.names)}
    lossy = (element for element in joint.elements if element.load_loss != "none")
    coefficients = (row for e in lossy for row in _of_loss(joint, e, at, load_torque))
    totals = [*_totals(joint, at, values.shape[0])]
    return (*totals, *coefficients, *_over_gain(joint, at, totals))


def derivatives(
    joint: Joint, values: Array, steps: Array, load_torque: float
) -> Iterator[tuple[Derived, float, Array]]:
    """Yield each derived quantity, its value and its derivatives ``(d,)`` at parameters ``(d,)``.

    By central differences; zero where the step ``(d,)`` is.
    """
    moving = np.flatnonzero(steps)
    shifts = np.diag(steps)[moving]
    vectors = values + np.concatenate([shifts, -shifts, np.zeros((1, values.size))])
    for q in derive(joint, vectors, load_torque):
        slopes, (up, down) = np.zeros(values.size), q.values[:-1].reshape(2, -1)
        slopes[moving] = (up - down) / (2.0 * steps[moving])
        yield q, float(q.values[-1]), slopes


def _over_gain(joint: Joint, at: dict[str, Array], totals: Sequence[Derived]) -> Iterator[Derived]:
    """Divide by an unknown gain of the drive: targets and positions alone determine that."""
    gain = next((p for p in joint.parameters if p.name == "drive.kp"), None)
    if gain is None:
        return
    kp = np.where(at[gain.name] > 0.0, at[gain.name], np.nan)
    rows: list[tuple[Parameter | Derived, Array]] = [(p, at[p.name]) for p in joint.parameters]
    for row, values in [*rows, *((total, total.values) for total in totals)]:
        if scales_with_torque(row.unit) and row is not gain:
            yield Derived(
                f"{row.name}_over_kp",
                f"{row.unit}/({gain.unit})",
                rf"{row.symbol}/{gain.symbol}",
                f"{row.meaning}, over the gain of the drive",
                values / kp,
                gauge_free=True,
            )


def _totals(joint: Joint, at: dict[str, Array], n: int) -> Iterator[Derived]:
    """Sum up what is seen at the motor, Theta1 +- Theta2 of eq. (13)."""
    lossy = [element for element in joint.elements if element.load_loss != "none"]
    # where a loss depends on speed or load, the torque of a term at the motor depends on all others
    steady = ("load_loss", "load_direction")
    if any(o.startswith("load_") and o not in steady for e in lossy for o in e.choices):
        return
    terms: dict[str, list[Parameter]] = {}
    for p in joint.parameters:
        for kind in _kinds(joint, p):
            terms.setdefault(kind, []).append(p)
    # gravity that an angle turns has a size; least squares calls its sine part by the whole's name
    turned = any(p.circular for p in joint.parameters)
    weight = replace(TOTALS["gravity"], symbol="G_{{{}}}", meaning="gravity torque")
    if turned:
        weight = replace(weight, name="gravity_size", meaning="size of the gravity torque")
    pull = abs(joint.load.gravity) if turned else joint.load.gravity
    for side, label in (("drive", "driving"), ("back", "back-driven"))[: 2 if lossy else 1]:
        # torque at an owner's input times this is torque at the motor; an element's own terms
        # act at its input side, before its load-dependent friction
        reach: dict[str, Array] = {}
        through = np.ones(n)
        for element in joint.elements:
            reach[element.name] = through
            drive, back = _losses(element, at)
            through = through * (1.0 + drive if side == "drive" else 1.0 - back) / element.ratio
        reach["load"] = through
        mark = rf"^{{\mathrm{{{side}}}}}" if lossy else ""
        at_motor = ", all seen by the motor" + (f", {label}" if lossy else "")
        for kind, parts in terms.items():
            if {p.owner for p in parts} == {joint.elements[0].name}:
                continue  # a total of the motor's shaft alone is that parameter
            total: Array = np.zeros(n)
            for p in parts:
                assert p.row.power is not None
                speed = joint.reaches[p.owner] / joint.ratio
                total = total + at[p.name] * reach[p.owner] * speed**p.row.power
            row = parameter("total", QUANTITIES.get(kind, weight), joint.motor_motion, "t")
            yield Derived(
                f"total_{side}.{row.quantity}" if lossy else row.name,
                row.unit,
                row.symbol + mark,
                row.meaning + at_motor,
                total * pull if kind == "gravity" else total,
                gauge_free=True,
            )


def _kinds(joint: Joint, p: Parameter) -> tuple[str, ...]:
    """Name the totals that a parameter adds to; most have one, some none."""
    # Load-dependent friction is in the factors, a low-speed rise vanishes at speed, and a term with
    # a separate shape adds to no other.
    row = p.row
    if row.role != "own" or row.power is None or p.owner in ("", "drive"):
        return ()
    split = row.by_direction
    if split and any(other.quantity in split for other in joint.parameters):
        return split
    return row.totals or (row.name,)


def _losses(element: Element, at: dict[str, Array]) -> tuple[Array | float, Array | float]:
    """Load-dependent friction while the motor drives and while the load does; zero for none."""
    if element.load_loss == "none":
        return 0.0, 0.0
    ways = ("_drive", "_back") if element.load_loss == "two" else ("", "")
    drive, back = (at[f"{element.name}.load{way}"] for way in ways)
    return drive, back


def _of_loss(
    joint: Joint, element: Element, at: dict[str, Array], load_torque: float
) -> Iterator[Derived]:
    """Derive alphas, lambdas and efficiencies of one element, eqs. (4), (6) and (13)."""
    name, two = element.name, element.load_loss == "two"

    def row(quantity: str, symbol: str, meaning: str, values: Array, gauge_free: bool) -> Derived:
        return Derived(f"{name}.{quantity}", "", symbol, meaning, values, gauge_free)

    mu_drive, mu_back = map(np.asarray, _losses(element, at))
    # friction that grows with torque or speed is still zero there
    slow = " at low speed" if element.has("load_speed") else ""
    where = slow + (" under a small load" if element.has("load_square") else "")
    passed = f"load torque over motor torque{where} when the"
    # eq. (6); an irreversible gearbox, mu_2 >= 1, passes nothing back
    back = np.where(mu_back < 1.0, 1.0 - mu_back, np.nan)
    for side, symbol, condition, alpha in (
        ("drive", r"\alpha_1", f"motor drives, 1/(1 + mu{'_1' * two})", 1.0 / (1.0 + mu_drive)),
        ("back", r"\alpha_2", f"load drives, 1/(1 - mu{'_2' * two})", 1.0 / back),
    ):
        meaning = effort_words(f"{passed} {condition}", element.motion)
        yield row(f"alpha_{side}", symbol, meaning, alpha, not two)
    if two:
        # lambda_1 and lambda_2 of eq. (13); a gearbox that loses nothing has no ratio of them
        lambda_1, lambda_2 = (2.0 + mu_drive - mu_back) / 2.0, (mu_drive + mu_back) / 2.0
        ratio = lambda_1 / np.where(lambda_2 != 0.0, lambda_2, np.nan)
        meaning = "mean of 1/alpha over half their difference, theta5/theta10 of eq. (13)"
        yield row("lambda_1", r"\lambda_1", "mean of 1/alpha", lambda_1, False)
        yield row("lambda_2", r"\lambda_2", "half the difference of 1/alpha", lambda_2, False)
        yield row("lambda_ratio", r"\lambda_1/\lambda_2", meaning, ratio, True)
    if load_torque > 0.0:
        # of the torque at its input, as the loss itself
        grown = at.get(f"{name}.load_square", 0.0) * (load_torque / joint.reaches[name])
        behind = joint.elements[joint.elements.index(element) :]
        # Fr of eq. (4), at the joint; section 4.4 takes the bearing's, behind the gearbox, for it
        weights = {"coulomb": 1.0, "coulomb_positive": 0.5, "coulomb_negative": 0.5}
        constant = sum(
            weight * at[f"{e.name}.{key}"] * joint.reaches[e.name]
            for e in behind
            for key, weight in weights.items()
            if f"{e.name}.{key}" in at
        )
        drive, driven = efficiencies(mu_drive + grown, mu_back + grown, constant, load_torque)
        at_load = f"{load_torque:.3g} {'N m' if joint.load.motion == 'rotary' else 'N'} of load"
        meaning = f"efficiency of {name} with the constant loss behind it, eq. (4), at {at_load}"
        meaning += f"{slow}; viscous loss and all before {name} are not counted"
        yield row("efficiency_drive", r"\eta_m", f"driving {meaning}", drive, False)
        yield row("efficiency_back", r"\eta_r", f"back-driving {meaning}", driven, False)
