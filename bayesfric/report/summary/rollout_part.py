"""What a summary says of roll-outs: how far simulated motions are from the measured ones."""

from __future__ import annotations

from typing import Literal

from pydantic import FiniteFloat

from bayesfric.report.summary.rows import Name, NotNegative, Part, Share
from bayesfric.results.roll_out import Input, RollOut, tells_nothing
from bayesfric.results.roll_out import Part as Which

# Share inside 90 % bands below which they are called too narrow. Positions within a second of each
# other are nearly one, so that few recordings may well leave their bands for a tenth of the time.
FEWEST = 0.8


class MotionError(Part):
    """How far a motion is from the measured one, in its unit."""

    mae: NotNegative
    rmse: NotNegative
    inside: Share
    inside_alone: Share
    width: NotNegative | None = None


class RollOutRow(Part):
    """One recording, or all together.

    In a share ``blind`` of the time the position's band is wider than ``room``, beyond which it
    tells nothing; ``over`` is the share of the plays that went another way over the top.
    """

    part: Which | None = None
    input: Input | None = None
    position: MotionError
    speed: MotionError
    runaway: Share = 0.0
    room: NotNegative | None = None
    blind: Share = 0.0
    over: Share = 0.0

    @property
    def narrow(self) -> bool:
        """Whether the position leaves its bands far too often."""
        return self.position.inside < FEWEST

    @property
    def wide(self) -> bool:
        """Whether being inside the position's band says nothing."""
        return tells_nothing(self.blind, self.over)


class RollOutPart(Part):
    """Recordings played to draws of the posterior."""

    level: Share
    draws: int
    seed: int
    unit: Literal["rad", "m"]
    recordings: dict[Name, RollOutRow]
    pooled: RollOutRow
    unexplained: dict[Name, NotNegative]
    left: FiniteFloat
    torque_unit: str


def rollout_part(found: RollOut) -> RollOutPart:
    """Sum roll-outs up."""
    rows = {
        one.name: vars(one) | {"position": vars(one.at_position), "speed": vars(one.at_speed)}
        for one in found.rolled
    }
    mean = {key: sum(row[key] for row in rows.values()) / len(rows) for key in ("blind", "over")}
    errors = {key.removeprefix("at_"): vars(error) for key, error in found.pooled.items()}
    told = {"unit": found.rolled[0].unit, "recordings": rows, "pooled": mean | errors}
    return RollOutPart.model_validate(
        told | {key: getattr(found, key) for key in RollOutPart.model_fields if key not in told}
    )
