"""What parameters amount to: transfer coefficients, totals, efficiencies.

The totals are the combinations that eq. (13) sees. They do not change when leg
parameters and alpha are scaled together, so they are known even where the
parameters behind them are not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.parameter import Parameter, effort_words, entry_of, parameter

Array = NDArray[np.float64]

# Totals that a quantity adds to, and with which power of speed its torque grows. Load losses are
# in what passes through them; a low-speed rise is none of what is felt at speed.
_TOTALS: dict[str, tuple[tuple[str, ...], int]] = {
    "inertia": (("inertia",), 1),
    "viscous": (("viscous",), 1),
    "coulomb": (("coulomb_positive", "coulomb_negative"), 0),
    "coulomb_positive": (("coulomb_positive",), 0),
    "coulomb_negative": (("coulomb_negative",), 0),
    "quadratic": (("quadratic",), 2),
    "first_moment": (("gravity",), 0),
    **dict.fromkeys(("stribeck_ratio", "stribeck_velocity"), ((), 0)),
    **dict.fromkeys(("load", "load_drive", "load_back"), ((), 0)),
    **dict.fromkeys(("gravity_angle", "offset", "gain"), ((), 0)),
}


@dataclass(frozen=True, eq=False)
class Derived:
    """One derived quantity.

    Attributes
    ----------
    name, unit, symbol, meaning
        As for parameters; the symbol is LaTeX without dollar signs.
    values
        ``(n,)``, one for each parameter vector.
    gauge_free
        Whether scaling leg parameters and alpha together leaves it unchanged.
    """

    name: str
    unit: str
    symbol: str
    meaning: str
    values: Array
    gauge_free: bool


def efficiencies(
    mu_drive: Array, mu_back: Array, constant_loss: Array, torque: float | Array
) -> tuple[Array, Array]:
    """Efficiencies of an element, eq. (4).

    Parameters
    ----------
    mu_drive, mu_back
        Load losses ``mu_1`` and ``mu_2``.
    constant_loss
        ``Fr`` in the unit of ``torque``.
    torque
        Transmitted torque ``Ts``, positive.

    Returns
    -------
    drive : ndarray
        ``1/(1 + mu_1 + Fr/Ts)``, the motor driving the load.
    back : ndarray
        ``1 - mu_2 - Fr/Ts``, the load driving the motor; ``nan`` where it would be
        negative: there the transmission is irreversible.
    """
    share = np.asarray(constant_loss) / np.asarray(torque)
    drive = 1.0 / (1.0 + np.asarray(mu_drive) + share)
    back = 1.0 - np.asarray(mu_back) - share
    return drive, np.where(back >= 0.0, back, np.nan)


def derive(chain: Chain, values: Array, load_torque: float) -> tuple[Derived, ...]:
    """Derive everything the chain allows from parameter vectors.

    Parameters
    ----------
    chain
        The mechanism.
    values
        ``(n, n_parameters)`` in the order of ``chain.names``.
    load_torque
        Joint torque at which efficiencies are stated, N m or N.
    """
    at = {name: values[:, i] for i, name in enumerate(chain.names)}
    return (*_totals(chain, at, values.shape[0]), *_coefficients(chain, at, load_torque))


def _totals(chain: Chain, at: dict[str, Array], n: int) -> Iterator[Derived]:
    """Sum up what the motor feels, Theta1 +- Theta2 of eq. (13) and their mean."""
    lossy = [element for element in chain.elements if element.load_loss != "none"]
    plain = _single(chain)
    # torque at the joint times these is torque at the motor
    for side, label in (("drive", "driving"), ("back", "back-driven")):
        reach = np.ones(n)
        parts: list[tuple[Parameter, Array, float]] = []
        for element in chain.elements:
            # the element's own terms act at its input side, before its load loss
            speed = _speed_ratio(chain, element.name) / chain.ratio
            parts += [(p, reach, speed) for p in element.parameters()]
            reach = reach * _transfer(element.name, element.load_loss, at, side) / element.ratio
        parts += [(p, reach, 1.0 / chain.ratio) for p in chain.load.parameters()]
        totals: dict[str, Array] = {}
        for p, through, speed in parts:
            kinds, power = entry_of(_TOTALS, p.quantity, "the totals")
            for kind in kinds:
                totals[kind] = totals.get(kind, 0.0) + at[p.name] * through * speed**power
        if "gravity" in totals:
            totals["gravity"] = totals["gravity"] * chain.load.gravity
        for key, total in totals.items():
            if key in plain:
                continue
            described = _described(chain, key)
            name = f"total_{side}.{key}" if lossy else f"total.{key}"
            mark = rf"^{{\mathrm{{{side}}}}}" if lossy else ""
            yield Derived(
                name,
                described.unit,
                described.symbol + mark,
                f"{described.meaning}, all seen by the motor" + (f", {label}" if lossy else ""),
                np.asarray(total),
                gauge_free=True,
            )
        if not lossy:
            return


def _single(chain: Chain) -> set[str]:
    """Totals that only one parameter at the motor's own shaft makes up: they say nothing new."""
    owners: dict[str, set[str]] = {}
    for p in chain.parameters:
        owner = p.name.rpartition(".")[0]
        for kind in entry_of(_TOTALS, p.quantity, "the totals")[0]:
            owners.setdefault(kind, set()).add(owner)
    motor = {chain.elements[0].name}
    return {kind for kind, names in owners.items() if names == motor}


def _coefficients(chain: Chain, at: dict[str, Array], load_torque: float) -> Iterator[Derived]:
    for element in chain.elements:
        if element.load_loss == "none":
            continue
        name = element.name
        mu_drive = at.get(f"{name}.load_drive", at.get(f"{name}.load"))
        mu_back = at.get(f"{name}.load_back", at.get(f"{name}.load"))
        assert mu_drive is not None
        assert mu_back is not None
        two = element.load_loss == "two"
        passed = "load torque over motor torque when the"
        # eq. (6); an irreversible gearbox, mu_2 >= 1, passes nothing back
        back = np.where(mu_back < 1.0, 1.0 - mu_back, np.nan)
        yield Derived(
            f"{name}.alpha_drive",
            "",
            r"\alpha_1",
            effort_words(f"{passed} motor drives, 1/(1 + mu{'_1' * two})", element.motion),
            1.0 / (1.0 + mu_drive),
            gauge_free=not two,
        )
        yield Derived(
            f"{name}.alpha_back",
            "",
            r"\alpha_2",
            effort_words(f"{passed} load drives, 1/(1 - mu{'_2' * two})", element.motion),
            1.0 / back,
            gauge_free=not two,
        )
        if two:
            # lambda_1 and lambda_2 of eq. (13)
            lambda_1 = (2.0 + mu_drive - mu_back) / 2.0
            lambda_2 = (mu_drive + mu_back) / 2.0
            yield Derived(
                f"{name}.lambda_1", "", r"\lambda_1", "mean of 1/alpha", lambda_1, gauge_free=False
            )
            yield Derived(
                f"{name}.lambda_2",
                "",
                r"\lambda_2",
                "half the difference of 1/alpha",
                lambda_2,
                gauge_free=False,
            )
            yield Derived(
                f"{name}.lambda_ratio",
                "",
                r"\lambda_1/\lambda_2",
                "mean of 1/alpha over half their difference, theta5/theta10 of eq. (13)",
                # a gearbox that loses nothing has none
                lambda_1 / np.where(lambda_2 != 0.0, lambda_2, np.nan),
                gauge_free=True,
            )
        constant = _constant_loss(chain, name, at)
        if load_torque > 0.0:
            drive, back_driven = efficiencies(mu_drive, mu_back, constant, load_torque)
            at_load = f"at {load_torque:.3g} {'N m' if chain.load.motion == 'rotary' else 'N'}"
            yield Derived(
                f"{name}.efficiency_drive",
                "",
                r"\eta_m",
                f"driving efficiency, eq. (4), {at_load} of load, viscous loss not counted",
                drive,
                gauge_free=False,
            )
            yield Derived(
                f"{name}.efficiency_back",
                "",
                r"\eta_r",
                f"back-driving efficiency, eq. (4), {at_load} of load, viscous loss not counted",
                back_driven,
                gauge_free=False,
            )


def _constant_loss(chain: Chain, name: str, at: dict[str, Array]) -> Array:
    """Sum the constant losses in and behind the element, brought to the joint: ``Fr`` of eq. (4).

    Section 4.4 takes the bearing's loss for it, which stands behind the gearbox.
    """
    total: Array = np.zeros(next(iter(at.values())).shape[0])
    behind = False
    for element in chain.elements:
        behind = behind or element.name == name
        if not behind:
            continue
        speed = _speed_ratio(chain, element.name)
        for key, weight in (("coulomb", 1.0), ("coulomb_positive", 0.5), ("coulomb_negative", 0.5)):
            if f"{element.name}.{key}" in at:
                total = total + weight * at[f"{element.name}.{key}"] * speed
    return total


def _speed_ratio(chain: Chain, name: str) -> float:
    """Speed of an element's input over the joint's."""
    ratio = 1.0
    for element in reversed(chain.elements):
        ratio *= element.ratio
        if element.name == name:
            return ratio
    raise KeyError(name)


def _transfer(name: str, loss: str, at: dict[str, Array], side: str) -> Array | float:
    if loss == "none":
        return 1.0
    key = f"{name}.load" if loss == "one" else f"{name}.load_{side}"
    return 1.0 + at[key] if side == "drive" else 1.0 - at[key]


def _described(chain: Chain, key: str) -> Parameter:
    if key != "gravity":
        return parameter("total", key, chain.motor_motion, "t")
    torque = parameter("total", "coulomb", chain.motor_motion, "t")
    return Parameter(
        "total.gravity", "gravity", torque.unit, r"G_{t}", -float("inf"), float("inf"),
        effort_words("gravity torque", chain.motor_motion),
    )  # fmt: skip
