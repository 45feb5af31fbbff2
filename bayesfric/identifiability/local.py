"""What the likelihood alone determines near one parameter vector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.estimates.assemble import open_directions
from bayesfric.estimates.information import NULL, Directions, directions
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.torque import torque_jacobian
from bayesfric.identifiability.sentences import Statement, stated
from bayesfric.inference.target import Target

Array = NDArray[np.float64]
Verdict = Literal["data", "weak", "prior"]

# Central differences of a torque that is linear are wrong by rounding alone: some 1e-16 of
# the torque over twice this step. That is 1e-10 of the largest singular value, a thousandth
# of what NULL allows; what any real recording leaves open is far above both.
_STEP = 1e-6
# A simulation's rounding is larger by the number of its steps, and it is not quite linear.
_NULL_SIMULATED = 1e-6
# Values below this share of their prior sd are next to zero: those that are zero or
# positive, and those of either sign.
_SMALL = 1e-3
# Share of the measured torque that counts as one for values the data cannot tell from zero.
_FELT = 0.1
_SMALL_SIGNED = 1e-2


@dataclass(frozen=True)
class NullDirection:
    """Parameters that can change together without changing any predicted torque.

    Attributes
    ----------
    exponents
        Parameter (or alpha) and its relative change, the largest being one; a
        parameter that is next to zero changes in units of its prior sd.
    """

    exponents: dict[str, float]

    @property
    def meaning(self) -> str:
        """The same in words."""
        return str(null_meaning(self.exponents))


@dataclass(frozen=True, eq=False)
class LocalInformation:
    """Fisher information of the torque near one parameter vector.

    Attributes
    ----------
    names
        Free parameters of the chain.
    labels
        What a change of one is called: the parameter, or its alpha for load losses.
    units
        ``(d,)`` change of each parameter that counts as one: its own value, so that ones
        are changes of logarithms; something else where the value is next to zero.
    shifted
        ``(d,)`` where it is something else.
    effects
        ``(d,)`` root of the summed squares that a change of one makes, in noise sds.
    data_sd
        ``(d,)`` standard deviation that the data alone would leave, in the
        parameter's unit; infinite where a null direction touches it.
    null_rows
        ``(n_null, d)`` what no torque can tell, in units, the largest entry of each being one.
    directions
        Of the Jacobian over the noise scale, in log parameters.
    from_theory
        How many null directions, the first ones, are scalings that hold at every point.
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    units: Array
    shifted: NDArray[np.bool_]
    effects: Array
    data_sd: Array
    null_rows: Array
    directions: Directions
    from_theory: int = 0

    @property
    def null_directions(self) -> tuple[NullDirection, ...]:
        """What no torque can tell, by name."""
        return tuple(
            NullDirection(
                {
                    label: float(round(x, 9))
                    for label, x in zip(self.labels, row, strict=True)
                    if abs(x) > 1e-5
                }
            )
            for row in self.null_rows
        )

    @property
    def told(self) -> Array:
        """Jacobian ``(rank, d)`` with the same information in units, null directions left out."""
        found, kept = self.directions, ~self.directions.null
        return np.asarray(found.rows[kept] * found.singular_values[kept, None])

    @property
    def information(self) -> Array:
        """Fisher information ``(d, d)`` in those units; exactly nothing along null directions."""
        told = self.told
        return np.asarray(told.T @ told)

    def data_sd_of(self, gradient: Array, *, gauge_free: bool = False) -> float:
        """Give the sd that the data alone would leave of a function of the parameters.

        Parameters
        ----------
        gradient
            ``(d,)`` derivative of the function by the free parameters.
        gauge_free
            Whether theory says that no scaling of leg and alpha changes it.

        Returns
        -------
        float
            Infinite where the function changes along a null direction.
        """
        if gauge_free:
            gradient = self.directions.off_known(gradient)
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

    Raises
    ------
    BadInput
        If a simulation fails beside these parameters.
    """
    free = target.free
    point = parameters[: len(free)]
    scales = target.noise.scales(parameters[None, len(free) :])[0]
    units, labels, shifted = units_of(target, point)
    chain = target.likelihood.chain
    at = target.chain_values(parameters[None])[0]
    known = Knowledge({n: float(x) for n, x in zip(chain.names, at, strict=True) if n not in free})
    open_ = open_directions(chain, known, target.likelihood.observations, at)
    jacobian = jacobian_of(target, parameters, units, scales)
    if not np.isfinite(jacobian).all():
        raise BadInput(
            "identifiability",
            "the simulated motion cannot be differentiated at these parameters",
            'use method = "input-error", or priors that keep parameters off their bounds',
        )
    tolerance = NULL if target.likelihood.method == "input-error" else _NULL_SIMULATED
    found = directions(jacobian, np.ones(units.size), tolerance, known_null=open_ / units)
    # the Jacobian was taken in these units already
    found = replace(found, units=units)
    rows = _null_basis(found.rows[found.null], open_ / units)
    local = LocalInformation(
        tuple(free),
        tuple(labels),
        units,
        shifted,
        np.linalg.norm(jacobian, axis=0),
        np.full(units.size, np.nan),
        rows,
        found,
        len(open_),
    )
    return replace(local, data_sd=np.array([local.data_sd_of(one) for one in np.eye(units.size)]))


def in_natural_units(
    target: Target, parameters: Array, local: LocalInformation
) -> LocalInformation:
    """Measure a value that is small beside what the data leave of it by what torque feels.

    Of a value that may as well be zero, the logarithm says nothing. Where the sd from the
    data is finite and larger than the value, a change that makes a tenth of the measured
    torque counts as one instead (or the prior's sd, if that is less). Null directions do
    not touch such parameters.

    Parameters
    ----------
    target, parameters
        As for :func:`local_information`.
    local
        What it found.
    """
    likelihood = target.likelihood
    values = target.chain_values(parameters[None])[0]
    k = len(target.free)
    columns = [likelihood.chain.names.index(name) for name in target.free]
    steps = np.zeros(values.size)
    steps[columns] = _STEP * np.abs(local.units)
    jacobian = torque_jacobian(likelihood.chain, likelihood.observations, values, steps)
    effect = np.linalg.norm(jacobian[:, columns], axis=0)
    measured = np.concatenate([o.measured for o in likelihood.observations])
    sds = np.array([p.sd() for p in target.priors[:k]])
    with np.errstate(divide="ignore"):
        floor = np.fmin(_FELT * np.linalg.norm(measured) / effect, sds)
    loss = np.array([name != label for name, label in zip(local.names, local.labels, strict=True)])
    value = parameters[:k]
    small = np.isfinite(local.data_sd) & (np.abs(value) < local.data_sd) & ~loss
    small &= np.abs(value) < floor
    units = np.where(small, floor, local.units)
    ratio = units / local.units
    found = directions(local.told * ratio, np.ones(k), local.directions.tolerance)
    return replace(
        local,
        units=units,
        shifted=local.shifted | small,
        effects=local.effects * np.abs(ratio),
        directions=replace(found, units=units),
    )


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


def units_of(target: Target, point: Array) -> tuple[Array, list[str], NDArray[np.bool_]]:
    """Step that counts as one, in each parameter's unit, and what it then is.

    Logarithms for parameters that cannot be negative; for load losses the
    logarithm of alpha, in which the paper's scaling is one straight line. A value next
    to zero, as on a bound, has no logarithm worth the name: there the prior sd counts
    as one, and the third array says so.
    """
    units = np.empty(point.size)
    shifted = np.zeros(point.size, dtype=np.bool_)
    labels = []
    chain = target.likelihood.chain
    support = {p.name: p for p in chain.parameters}
    for j, name in enumerate(target.free):
        element, _, quantity = name.rpartition(".")
        if quantity == "load_drive":
            units[j] = -(1.0 + point[j])  # alpha_1 = 1/(1 + mu_1)
            labels.append(f"{element}.alpha_drive")
        elif quantity == "load_back":
            # alpha_2 = 1/(1 - mu_2), endless where the gearbox is irreversible
            units[j] = 1.0 - point[j] if abs(1.0 - point[j]) > 1e-3 else 1e-3
            labels.append(f"{element}.alpha_back")
        else:
            sd = target.priors[j].sd()
            sd = sd if np.isfinite(sd) else 1.0
            small = _SMALL if support[name].lower == 0.0 else _SMALL_SIGNED
            shifted[j] = abs(point[j]) <= small * sd
            units[j] = sd if shifted[j] else point[j]
            labels.append(name)
    return units, labels, shifted


def jacobian_of(target: Target, parameters: Array, units: Array, scales: Array) -> Array:
    """Differentiate the modelled outputs over their noise, ``(n_outputs, d)``.

    The torque is linear in nearly every parameter, so central differences are
    exact up to rounding except where a step changes the direction of power.
    """
    k = units.size
    support = {p.name: (p.lower, p.upper) for p in target.likelihood.chain.parameters}
    low, high = np.array([support[name] for name in target.free]).T
    point, steps = parameters[:k], _STEP * units
    plus, minus = np.tile(parameters, (k, 1)), np.tile(parameters, (k, 1))
    index = np.arange(k)
    # on a bound one side alone: nothing can be simulated beyond it
    plus[index, index] = np.clip(point + steps, low, high)
    minus[index, index] = np.clip(point - steps, low, high)
    widths = (plus[index, index] - minus[index, index]) / units
    both = target.chain_values(np.concatenate([plus, minus]))
    blocks = [
        (output[:k] - output[k:]) / widths[:, None]
        for output in target.likelihood.standardised(both, scales)
    ]
    return np.concatenate(blocks, axis=1).T


def _null_basis(rows: Array, theory: Array) -> Array:
    """Basis of the null space with many zeros, what theory names first, ``(n_null, d)``.

    The others are only given up to what theory names: one entry of each of those is
    eliminated, the one that leaves fewest entries.
    """
    named = [row / row[int(np.argmax(np.abs(row)))] for row in theory if row.any()]
    rest = rows
    for row in named:
        if len(rest) < 2:
            rest = rest[:0]
            break
        choices = [
            _sparse(_independent(rest - np.outer(rest[:, c] / row[c], row), len(rest) - 1))
            for c in np.flatnonzero(np.abs(row) > 1e-6)
        ]
        rest = min(choices, key=lambda basis: float(np.abs(basis).sum()))
    return np.array([*named, *_sparse(rest)]).reshape(-1, rows.shape[1])


def _independent(rows: Array, rank: int) -> Array:
    return np.asarray(np.linalg.svd(rows)[2][:rank])


def _sparse(rows: Array) -> Array:
    """Turn a basis of the null space so that it has many zeros (reduced row echelon)."""
    basis = rows.copy()
    for i in range(basis.shape[0]):
        pivot = int(np.argmax(np.abs(basis[i])))
        basis[i] /= basis[i, pivot]
        for j in range(basis.shape[0]):
            if j != i:
                basis[j] -= basis[j, pivot] * basis[i]
    return np.array([row / row[int(np.argmax(np.abs(row)))] for row in basis]).reshape(rows.shape)


def null_meaning(exponents: Mapping[str, float]) -> Statement:
    """Say what a null direction is whose entries are powers of one factor, the largest one."""
    if len(exponents) == 1:
        kind = "unseen"
    else:
        same = all(abs(x - 1.0) < 1e-5 for x in exponents.values())
        kind = "factor" if same else "powers"
    return stated("meaning", kind, exponents=exponents)
