"""Checks of a signal: that it moves, is not clipped, and how coarse it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput

# Shorter runs of one value are chance in a quantised signal
_RUN = 4
_CLIPPED_SHARE = 0.01
_HUGE = 1e15


def check_moves(values: NDArray[np.float64], where: str, what: str) -> None:
    """Refuse a signal that never changes.

    Parameters
    ----------
    values
        The signal, shape (n,).
    where
        File and column.
    what
        What the signal is.

    Raises
    ------
    BadInput
        If all values are the same.
    """
    if np.ptp(values) == 0:
        raise BadInput(
            where,
            f"the {what} is {values[0]:.6g} in every sample",
            "check that this is the right column and that the joint moved",
        )


def check_not_huge(values: NDArray[np.float64], where: str, what: str) -> None:
    """Refuse a signal with a value that no joint has, or that left floating point.

    Parameters are as for :func:`check_moves`.

    Raises
    ------
    BadInput
        If an absolute value is 1e15 or more, in SI units.
    """
    fine = np.abs(values) < _HUGE
    if not fine.all():
        raise BadInput(
            where,
            f"the {what} reaches {values[int(np.argmin(fine))]:.3g} in SI units",
            "check its unit",
        )


def check_size(values: NDArray[np.float64], where: str, what: str) -> None:
    """Refuse a signal of a size that no joint has: its products would leave floating point.

    Parameters are as for :func:`check_moves`.

    Raises
    ------
    BadInput
        If the largest absolute value is below 1e-15 or above 1e15, in SI units.
    """
    largest = float(np.abs(values).max())
    if not 1 / _HUGE < largest < _HUGE:
        raise BadInput(where, f"the {what} is at most {largest:.3g} in SI units", "check its unit")


def clipped(values: NDArray[np.float64], what: str) -> list[str]:
    """Warn if a signal stays at its largest or smallest value.

    Parameters
    ----------
    values
        Raw signal, shape (n,).
    what
        What the signal is.

    Returns
    -------
    list of str
        One warning a limit at which at least 1 % of the samples lie, in runs of 4 and more.
    """
    warnings = []
    for word, limit in (("maximum", values.max()), ("minimum", values.min())):
        if 2 * abs(limit) < np.abs(values).max():
            continue  # an idle drive, not a limited one
        share = _in_runs(values == limit) / len(values)
        if share >= _CLIPPED_SHARE:
            warnings.append(
                f"{what}: stays at {limit:.6g} (raw), its {word} in this recording, for "
                f"{100 * share:.2g} % of the samples; does the drive or sensor saturate there?"
            )
    return warnings


def quantisation(values: NDArray[np.float64]) -> float | None:
    """Return the step of a coarsely quantised signal.

    Parameters
    ----------
    values
        The signal, shape (n,).

    Returns
    -------
    float or None
        The step, or None if the signal has too many values to be coarse.
    """
    levels = np.unique(values)
    if not 3 <= len(levels) <= len(values) / 3:
        return None
    gaps = np.diff(levels)
    step = float(gaps.min())
    multiples = gaps / step
    return step if bool(np.all(np.abs(multiples - np.round(multiples)) < 0.05)) else None


def _in_runs(flags: NDArray[np.bool_]) -> int:
    padded = np.concatenate([[False], flags, [False]]).astype(np.int8)
    change = np.diff(padded)
    lengths = np.flatnonzero(change == -1) - np.flatnonzero(change == 1)
    return int(lengths[lengths >= _RUN].sum())
