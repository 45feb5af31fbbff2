"""Results of roll-outs: simulated and measured motions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.results.reported import LEVEL as LEVEL

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
# Input of the simulation, and part of the run.
Input = Literal["torque", "voltage", "target"]
Part = Literal["fitted", "held out", "new"]

# Share of the simulations that may go another way over the top, as few as a band leaves out.
MOST_OVER = 1.0 - LEVEL
# Share inside 90 % bands below which they are called too narrow. Positions within a second of each
# other are nearly one, so that few recordings may well leave their bands for a tenth of the time.
FEWEST = 0.8


def tells_nothing(blind: float, over: float, *, most_blind: float = 0.2) -> bool:
    """Whether bands are too wide to judge by, from the shares of :class:`Rolled`.

    They may be as wide as anything that moves for a share ``most_blind`` of the time.
    """
    return blind > most_blind or over > MOST_OVER


@dataclass(frozen=True, eq=False)
class Error:
    """How far the simulated motion is from the measured one, in its unit."""

    mae: float  # mean absolute error of the middle of the draws
    rmse: float
    inside: float  # share of samples inside the band
    inside_alone: float  # and inside that of the parameters alone
    width: float  # median width of the band


@dataclass(frozen=True, eq=False)
class Rolled:
    """One recording simulated with draws of the posterior; arrays are ``(N,)``, NaN elsewhere."""

    name: str
    part: Part
    input: Input
    unit: str  # of the position
    time: Array  # s
    position: Array  # measured
    middle: Array  # median position over the parameters alone
    band: tuple[Array, Array]  # of the position, 90 %
    alone: tuple[Array, Array]  # of the parameters alone
    errors: dict[str, Error]  # of ``position`` and ``speed``
    # largest useful width of a band of the position: how far the joint moved, or half a turn where
    # gravity acts; and the share of the time in which it is wider
    room: float
    blind: float
    # share of the simulations half a turn or more away where gravity acts: few are left out of
    # bands and middle
    over: float = 0.0

    @property
    def wide(self) -> bool:
        """Whether being inside the band says nothing."""
        return tells_nothing(self.blind, self.over)


@dataclass(frozen=True, eq=False)
class RollOut:
    """Recordings simulated with a posterior."""

    run: str
    rolled: tuple[Rolled, ...]
    draws: int
    seed: int
    # factor on the unexplained torque that calibrates the bands of each fitted recording; a draw
    # takes that of one of them
    unexplained: dict[str, float]
    left: float  # root mean square of that torque before, N m or N
    torque_unit: str
    level: float = LEVEL

    @property
    def pooled(self) -> dict[str, Error]:
        """Mean errors over the recordings; root mean squares of the RMSE."""
        pooled = {}
        for quantity in ("position", "speed"):
            rows = [vars(rolled.errors[quantity]) for rolled in self.rolled]
            mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
            mean["rmse"] = float(np.sqrt(np.mean([row["rmse"] ** 2 for row in rows])))
            pooled[quantity] = Error(**mean)
        return pooled

    @property
    def summary(self) -> dict[str, Any]:
        """Its numbers for ``summary.json``: of each recording, and of all together."""

        def row(errors: dict[str, Error], **columns: Any) -> dict[str, Any]:
            return {quantity: vars(error) for quantity, error in errors.items()} | columns

        keys = ("blind", "over", "part", "input")
        shares = {key: float(np.mean([getattr(r, key) for r in self.rolled])) for key in keys[:2]}
        recordings = {
            r.name: row(r.errors, **{key: getattr(r, key) for key in keys}) for r in self.rolled
        }
        totals = ("level", "draws", "seed", "unexplained", "left", "torque_unit")
        return {
            "recordings": recordings,
            "pooled": row(self.pooled, **shares, part=None, input=None),
            "unit": self.rolled[0].unit,  # of the position
            **{key: getattr(self, key) for key in totals},
        }

    @property
    def frame(self) -> pd.DataFrame:
        """A row for each recording and quantity, in its unit, and for all together."""
        import pandas as pd

        named = [*((r.name, r.errors) for r in self.rolled), ("all together", self.pooled)]
        units = {"position": self.rolled[0].unit, "speed": f"{self.rolled[0].unit}/s"}
        rows = {
            (name, quantity): {"unit": unit, **vars(errors[quantity])}
            for quantity, unit in units.items()
            for name, errors in named
        }
        frame = pd.DataFrame.from_dict(rows, orient="index")
        frame.index.names = ["recording", "quantity"]
        return frame

    def __repr__(self) -> str:
        return self.frame.to_string()
