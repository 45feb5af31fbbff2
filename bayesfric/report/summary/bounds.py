"""What it means that a bound holds a posterior, and what to do about it."""

from __future__ import annotations

import math

from bayesfric.report.summary.read_back import PosteriorRow


def told_by_data(row: PosteriorRow) -> bool:
    """Whether the data alone say how far from its bound a number may be."""
    return row.data_sd is not None and row.data_sd < 0.5 * (row.prior_sd or math.inf)


def held(row: PosteriorRow) -> bool:
    """Whether the data push a number against its bound; a prior alone leans on bounds too."""
    return row.at_bound is not None and (row.verdict != "prior" or told_by_data(row))


def bound_mend(name: str, row: PosteriorRow) -> str:
    """Say what to do about the bound that holds a number; nothing where none does.

    Parameters
    ----------
    name
        Of the parameter.
    row
        Its numbers; runs of older versions do not tell where the bound is.
    """
    if not held(row) or row.bound is None:
        return ""
    bound = f"{row.bound:.4g}{f' {row.unit}' if row.unit else ''}"
    if row.bound_physical:
        return (
            f"it cannot be beyond {bound}, and the data cannot tell it from that: there is nothing "
            "to widen, but where it cannot be that small, the model puts its effect elsewhere"
        )
    return f"widen priors.{name} beyond {bound}, unless that bound is physical"


def bound_warning(name: str, row: PosteriorRow) -> str | None:
    """Warn of a bound that was set, not given by physics: it cuts the posterior off."""
    if row.bound_physical or not (mend := bound_mend(name, row)):
        return None
    return f"{name} is held by the {row.at_bound} bound of its prior: {mend}"
