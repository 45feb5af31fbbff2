"""What roll-outs find: simulated motions beside the measured ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
# What drives a recording, and what it was to the run.
Input = Literal["torque", "voltage", "target"]
Part = Literal["fitted", "held out", "new"]
# What is compared, and what its unit is per.
Which = Literal["at_position", "at_speed"]
WHICH: dict[Which, str] = {"at_position": "", "at_speed": "/s"}

LEVEL = 0.9
# Share of the time in which bands may be as wide as anything that moves, before they tell nothing.
BLIND = 0.2
# Share of the plays that may go another way over the top, as few as a band leaves out, before
# nothing can be judged by the others.
MOST_OVER = 1.0 - LEVEL


def tells_nothing(blind: float, over: float) -> bool:
    """Whether bands tell nothing, by the shares of :class:`Rolled`."""
    return blind > BLIND or over > MOST_OVER


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
    """One recording played to draws of the posterior; arrays are ``(N,)``, NaN where not played."""

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
    # what a band of the position tells nothing beyond: how far the joint moved, or half a turn
    # where gravity acts; and the share of the time in which it is wider
    room: float
    blind: float
    # share of the plays that came half a turn or more away where gravity acts: few are left out of
    # bands and middle
    over: float = 0.0

    @property
    def wide(self) -> bool:
        """Whether being inside the band says nothing."""
        return tells_nothing(self.blind, self.over)


@dataclass(frozen=True, eq=False)
class RollOut:
    """Recordings played to a posterior."""

    run: str
    rolled: tuple[Rolled, ...]
    draws: int
    seed: int
    # by how much the torque that the model leaves unexplained is multiplied for bands of each
    # fitted recording to hold what they say; a draw takes that of one of them
    unexplained: dict[str, float]
    left: float  # root mean square of that torque before, N m or N
    torque_unit: str
    level: float = LEVEL

    @property
    def pooled(self) -> dict[Which, Error]:
        """Means over the recordings; root mean squares of what is a root mean square."""
        found: dict[Which, Error] = {}
        for which in WHICH:
            rows = [vars(getattr(one, which)) for one in self.rolled]
            mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
            mean["rmse"] = float(np.sqrt(np.mean([row["rmse"] ** 2 for row in rows])))
            found[which] = Error(**mean)
        return found

    @property
    def frame(self) -> pd.DataFrame:
        """A row for each recording and quantity, in its unit, and for all together."""
        import pandas as pd

        rows = {}
        for which, per in WHICH.items():
            quantity = which.removeprefix("at_")
            named = [(one.name, getattr(one, which)) for one in self.rolled]
            for name, error in [*named, ("all together", self.pooled[which])]:
                rows[name, quantity] = {"unit": self.rolled[0].unit + per, **vars(error)}
        found = pd.DataFrame.from_dict(rows, orient="index")
        found.index.names = ["recording", "quantity"]
        return found

    def __repr__(self) -> str:
        return self.frame.to_string()
