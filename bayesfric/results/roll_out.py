"""Results of roll-outs: simulated and measured motions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.results.reported import LEVEL as LEVEL

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
# Input of the simulation, and part of the run.
Input = Literal["torque", "voltage", "target"]
Part = Literal["fitted", "held out", "new"]
# Quantities that are compared, and the denominator of their unit.
Which = Literal["at_position", "at_speed"]
WHICH: dict[Which, str] = {"at_position": "", "at_speed": "/s"}

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


@dataclass(frozen=True)
class RollOutRow:
    """What ``summary.json`` holds of one recording, or of all together."""

    position: Error
    speed: Error
    blind: float = 0.0  # share of the time in which the position's band is too wide
    over: float = 0.0  # share of the draws that went another way over the top
    part: Part | None = None
    input: Input | None = None

    @property
    def narrow(self) -> bool:
        """Whether the position leaves its bands far too often."""
        return self.position.inside < FEWEST

    @property
    def wide(self) -> bool:
        """Whether being inside the position's band says nothing."""
        return tells_nothing(self.blind, self.over)


@dataclass(frozen=True)
class RollOutPart:
    """What ``summary.json`` holds of recordings simulated with draws of the posterior."""

    recordings: dict[str, RollOutRow]
    pooled: RollOutRow
    unit: str  # of the position
    level: float
    draws: int
    seed: int
    unexplained: dict[str, float]
    left: float
    torque_unit: str


@dataclass(frozen=True, eq=False)
class Rolled:
    """One recording simulated with draws of the posterior; arrays are ``(N,)``, NaN elsewhere."""

    name: str
    part: Part
    input: Input
    unit: str  # of the position
    time: Array  # s
    position: Array  # measured
    speed: Array  # as filtered and differentiated from it, or as measured
    middle: Array  # median position over the parameters alone
    band: tuple[Array, Array]  # of the position, 90 %
    alone: tuple[Array, Array]  # of the parameters alone
    at_position: Error
    at_speed: Error
    runaway: float  # share of the draws that leave any range, or have no motion
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
    def pooled(self) -> dict[Which, Error]:
        """Mean errors over the recordings; root mean squares of the RMSE."""
        pooled: dict[Which, Error] = {}
        for which in WHICH:
            rows = [vars(getattr(rolled, which)) for rolled in self.rolled]
            mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
            mean["rmse"] = float(np.sqrt(np.mean([row["rmse"] ** 2 for row in rows])))
            pooled[which] = Error(**mean)
        return pooled

    @property
    def summary(self) -> RollOutPart:
        """Its numbers for ``summary.json``."""
        rows = {
            r.name: RollOutRow(r.at_position, r.at_speed, r.blind, r.over, r.part, r.input)
            for r in self.rolled
        }
        blind = sum(row.blind for row in rows.values()) / len(rows)
        over = sum(row.over for row in rows.values()) / len(rows)
        pooled = RollOutRow(self.pooled["at_position"], self.pooled["at_speed"], blind, over)
        return RollOutPart(
            rows,
            pooled,
            self.rolled[0].unit,
            self.level,
            self.draws,
            self.seed,
            self.unexplained,
            self.left,
            self.torque_unit,
        )

    @property
    def frame(self) -> pd.DataFrame:
        """A row for each recording and quantity, in its unit, and for all together."""
        import pandas as pd

        rows = {}
        for which, per in WHICH.items():
            quantity = which.removeprefix("at_")
            named = [(rolled.name, getattr(rolled, which)) for rolled in self.rolled]
            for name, error in [*named, ("all together", self.pooled[which])]:
                rows[name, quantity] = {"unit": self.rolled[0].unit + per, **vars(error)}
        frame = pd.DataFrame.from_dict(rows, orient="index")
        frame.index.names = ["recording", "quantity"]
        return frame

    def __repr__(self) -> str:
        return self.frame.to_string()
