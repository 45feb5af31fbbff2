"""What the likelihood alone determines near one parameter vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.assemble import open_directions
from bayesfric.estimates.information import Directions, directions
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.inference.target import Target

Array = NDArray[np.float64]
Verdict = Literal["data", "weak", "prior"]


@dataclass(frozen=True)
class NullDirection:
    """Parameters that can change together without changing any predicted torque.

    Attributes
    ----------
    exponents
        Parameter (or alpha) and its relative change, the largest being one; a
        parameter that is next to zero changes in units of its prior sd.
    meaning
        The same in words.
    """

    exponents: dict[str, float]
    meaning: str


@dataclass(frozen=True, eq=False)
class LocalInformation:
    """Fisher information of the torque near one parameter vector.

    Attributes
    ----------
    names
        Free parameters of the chain.
    data_sd
        ``(d,)`` standard deviation that the data alone would leave, in the
        parameter's unit; infinite where a null direction touches it.
    null_directions
        What no torque can tell.
    directions
        Of the Jacobian over the noise scale, in log parameters.
    """

    names: tuple[str, ...]
    data_sd: Array
    null_directions: tuple[NullDirection, ...]
    directions: Directions

    def data_sd_of(self, gradient: Array) -> float:
        """Give the sd that the data alone would leave of a function of the parameters.

        Parameters
        ----------
        gradient
            ``(d,)`` derivative of the function by the free parameters.

        Returns
        -------
        float
            Infinite where the function changes along a null direction.
        """
        weight = self.directions.solve(gradient)
        return float("inf") if weight is None else float(np.sqrt(gradient @ weight))


def local_information(target: Target, parameters: Array) -> LocalInformation:
    """Look at the likelihood near one vector of sampled parameters.

    Parameters
    ----------
    target
        Likelihood, priors and noise.
    parameters
        ``(d,)``, noise scales last.
    """
    free = target.free
    point = parameters[: len(free)]
    scales = target.noise.scales(parameters[None, len(free) :])[0]
    units, labels = _units(target, point)
    chain = target.likelihood.chain
    known = Knowledge(dict.fromkeys(set(chain.names) - set(free), 0.0))
    open_ = open_directions(
        chain, known, target.likelihood.observations, target.chain_values(parameters[None])[0]
    )
    found = directions(
        _jacobian(target, parameters, units, scales),
        np.ones(units.size),
        known_null=open_ / units,
    )
    found = replace(found, units=units)
    named = tuple(_describe(labels, row) for row in _sparse(found.rows[found.null]))
    local = LocalInformation(tuple(free), np.full(units.size, np.nan), named, found)
    return replace(local, data_sd=np.array([local.data_sd_of(one) for one in np.eye(units.size)]))


def verdict(posterior_sd: float, prior_sd: float, data_sd: float) -> Verdict:
    """Say whether data or prior determined a parameter.

    ``data``: the posterior is about as wide as the data alone would leave it and
    at most half as wide as the prior. ``prior``: the data alone would leave it
    more than twice as wide as the posterior is, or they left the prior as it was.
    ``weak``: in between, or the posterior is much wider than the local picture
    says, as where it is curved or has several peaks.

    Parameters
    ----------
    posterior_sd, prior_sd
        Of the parameter; an infinite or undefined prior sd counts as very wide.
    data_sd
        From :func:`local_information`.
    """
    if not data_sd > 0.0 or not posterior_sd > 0.0:  # also where it is no number
        return "prior"
    left = posterior_sd / prior_sd if np.isfinite(prior_sd) and prior_sd > 0 else 0.0
    share = posterior_sd / data_sd
    if share < 0.5 or left > 0.9:
        return "prior"
    return "data" if 0.85 < share < 1.5 and left < 0.5 else "weak"


def _units(target: Target, point: Array) -> tuple[Array, list[str]]:
    """Step that counts as one, in each parameter's unit, and what it then is.

    Logarithms for parameters that cannot be negative; for load losses the
    logarithm of alpha, in which the paper's scaling is one straight line.
    """
    units = np.empty(point.size)
    labels = []
    chain = target.likelihood.chain
    support = {p.name: p for p in chain.parameters}
    for j, name in enumerate(target.free):
        element, _, quantity = name.rpartition(".")
        if quantity == "load_drive":
            units[j] = -(1.0 + point[j])  # alpha_1 = 1/(1 + mu_1)
            labels.append(f"{element}.alpha_drive")
        elif quantity == "load_back":
            units[j] = 1.0 - point[j]  # alpha_2 = 1/(1 - mu_2)
            labels.append(f"{element}.alpha_back")
        elif support[name].lower == 0.0:
            units[j] = point[j]
            labels.append(name)
        else:
            # relative where the value is not next to zero, else in prior sds
            sd = target.priors[j].sd()
            units[j] = point[j] if abs(point[j]) > 0.01 * sd else sd
            labels.append(name)
    return units, labels


def _jacobian(target: Target, parameters: Array, units: Array, scales: Array) -> Array:
    """Differentiate the modelled outputs over their noise, ``(n_outputs, d)``.

    The torque is linear in nearly every parameter, so central differences are
    exact up to rounding except where a step changes the direction of power.
    """
    k = units.size
    steps = 1e-6 * np.where(units == 0.0, 1e-12, units)
    plus, minus = np.tile(parameters, (k, 1)), np.tile(parameters, (k, 1))
    index = np.arange(k)
    plus[index, index] += steps
    minus[index, index] -= steps
    both = target.chain_values(np.concatenate([plus, minus]))
    blocks = [
        (output[:k] - output[k:]) / 2e-6 for output in target.likelihood.standardised(both, scales)
    ]
    return np.concatenate(blocks, axis=1).T


def _sparse(rows: Array) -> Array:
    """Turn a basis of the null space so that it has many zeros (reduced row echelon)."""
    basis = rows.copy()
    for i in range(basis.shape[0]):
        pivot = int(np.argmax(np.abs(basis[i])))
        basis[i] /= basis[i, pivot]
        for j in range(basis.shape[0]):
            if j != i:
                basis[j] -= basis[j, pivot] * basis[i]
    return basis


def _describe(labels: Sequence[str], row: Array) -> NullDirection:
    row = row / row[int(np.argmax(np.abs(row)))]
    exponents = {
        label: float(round(x, 9)) for label, x in zip(labels, row, strict=True) if abs(x) > 1e-5
    }
    same = all(abs(x - 1.0) < 1e-5 for x in exponents.values())
    names = ", ".join(exponents)
    if same and len(exponents) > 1:
        meaning = f"{names} can all be multiplied by one factor: no torque changes"
    elif len(exponents) == 1:
        meaning = f"{names} does not show in the torque at all"
    else:
        terms = ", ".join(f"{name} by k^{x:.3g}" for name, x in exponents.items())
        meaning = f"scaling {terms} together changes no torque, for k near 1"
    return NullDirection(exponents, meaning)
