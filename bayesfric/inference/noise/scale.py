"""The numbers that noise is described by, and which of them each recording has.

A bench gives every recording noise of one kind, but maybe not of one size: standard deviations can
be shared or be each recording's own, what shapes the noise is always shared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.sizes import TypicalSizes
from bayesfric.inference.prior.priors import Prior, PriorText, read_prior
from bayesfric.recordings.arrays import Array

NoiseScale = Literal["shared", "per-recording"]


@dataclass(frozen=True)
class Scale:
    """One number that noise is described by.

    Attributes
    ----------
    name
        Behind ``noise.`` in the parameter's name.
    symbol
        LaTeX without dollar signs.
    meaning
        One line for people, worded for what turns.
    prior
        Gives the default prior, as a configuration would say it, for the sizes of what was
        measured.
    lower, upper
        Support.
    unit
        What it is measured like: ``torque``, ``position``, or nothing.
    shared
        Whether all recordings have the same in any case, as with what correlates the noise.
    chosen
        Whether the residuals of an estimate say if the noise has it, and how much.
    """

    name: str
    symbol: str
    meaning: str
    prior: Callable[[TypicalSizes], PriorText]
    lower: float = 0.0
    upper: float = np.inf
    unit: Literal["torque", "position", ""] = "torque"
    shared: bool = False
    chosen: bool = False

    def read_prior(self, texts: Mapping[str, PriorText], sizes: TypicalSizes) -> Prior:
        """Take the prior that a configuration gives, or the default.

        Parameters
        ----------
        texts
            What a configuration says, by parameter's name; this one is ``noise.<name>``.
        sizes
            Of what was measured, which scale the default.

        Raises
        ------
        BadInput
            If the prior given cannot be.
        """
        name = f"noise.{self.name}"
        text, default = (texts[name], False) if name in texts else (self.prior(sizes), True)
        return read_prior(name, text, lower=self.lower, upper=self.upper, default=default)


def up_to(size: float, least: float | None = None) -> PriorText:
    """Spread a prior evenly in the logarithm up to a size.

    Parameters
    ----------
    size
        Upper end, such as the largest torque, N m or N.
    least
        Lower end; a millionth of the upper one if left out.

    Returns
    -------
    mapping
        A ``loguniform`` as a configuration says it, the ends rounded to one digit.
    """
    top = float(f"{size:.0e}")
    bottom = 1e-6 * top if least is None else float(f"{least:.0e}")
    return {"distribution": "loguniform", "a": bottom, "b": top}


class NoiseDescription:
    """What any noise model tells of itself.

    Attributes
    ----------
    scales
        The ``Q`` numbers that it is described by, in the order of every array of them.
    quantities
        Their names.
    description
        In words, for the record.
    accounts_for_correlation
        Whether it allows residuals of the output to be correlated.
    """

    def __init__(
        self, scales: Sequence[Scale], description: str, *, accounts_for_correlation: bool
    ) -> None:
        self.scales, self.description = tuple(scales), description
        self.accounts_for_correlation = accounts_for_correlation
        self.quantities = tuple(scale.name for scale in scales)


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise with scales shared by all recordings, or some for each.

    Attributes
    ----------
    names
        Of the sampled scales, ``noise.sigma`` or ``noise.sigma.<recording>``; those of the first
        recording first.
    symbols, quantities, priors
        Of each of them: LaTeX, the name of its :class:`Scale`, and prior.
    places
        ``(R, Q)`` which of the names each recording's scales are.
    """

    names: tuple[str, ...]
    symbols: tuple[str, ...]
    quantities: tuple[str, ...]
    priors: tuple[Prior, ...]
    places: NDArray[np.int64]

    def scales(self, parameters: Array) -> Array:
        """Scales of every recording, ``(n, len(names))`` to ``(n, R, Q)``."""
        return parameters[:, self.places]

    def fold(self, information: Array) -> Array:
        """Add up information on a scale that several recordings share.

        Parameters
        ----------
        information
            ``(R, Q, Q)`` Fisher information of each recording's scales.

        Returns
        -------
        ndarray
            ``(len(names), len(names))``.
        """
        out = np.zeros((len(self.names), len(self.names)))
        for own, one in zip(self.places, information, strict=True):
            out[np.ix_(own, own)] += one
        return out


def noise_of(
    recordings: Sequence[str],
    scales: Sequence[Scale],
    priors: Mapping[str, Prior],
    scale: NoiseScale,
) -> Noise:
    """Set up the noise of named recordings.

    Parameters
    ----------
    recordings
        Their names, in order.
    scales
        Of the noise model.
    priors
        By ``noise.<quantity>``; recordings with scales of their own have alike priors.
    scale
        ``shared``, or ``per-recording`` for scales of their own where a scale allows that.
    """
    own = scale == "per-recording" and len(recordings) > 1
    found: dict[str, tuple[str, str, Prior]] = {}
    places = np.zeros((len(recordings), len(scales)), dtype=np.int64)
    for i, recording in enumerate(recordings):
        for j, one in enumerate(scales):
            name, symbol = f"noise.{one.name}", one.symbol
            prior = priors[name]
            if own and not one.shared:
                name, symbol = f"{name}.{recording}", _numbered(symbol, i + 1)
            found.setdefault(name, (symbol, one.name, prior))
            places[i, j] = list(found).index(name)
    symbols, quantities, given = zip(*found.values(), strict=True)
    return Noise(tuple(found), symbols, quantities, given, places)


def _numbered(symbol: str, number: int) -> str:
    """Add a recording's number; a second subscript would not typeset, so it joins the first."""
    base, _, subscript = symbol.partition("_")
    return f"{base}_{{{subscript},{number}}}" if subscript else f"{symbol}_{{{number}}}"
