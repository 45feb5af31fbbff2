"""Methods of point estimation, one file each, found here: each has an ``ESTIMATOR``.

The files import what they need when they run, so that the command line can name them at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from bayesfric.errors import BadInput, nearest

if TYPE_CHECKING:
    from bayesfric.estimates.estimation import Estimation
    from bayesfric.estimates.knowledge import Knowledge
    from bayesfric.estimates.point_estimate import Estimate
    from bayesfric.mechanism.joint import Joint
    from bayesfric.recordings.observation import Observation
    from bayesfric.recordings.trajectory import Trajectory


@dataclass(frozen=True)
class Given:
    """What may be estimated from; ``trajectories`` makes the recordings, undivided."""

    chain: Joint
    observations: Sequence[Observation]
    knowledge: Knowledge
    options: Estimation
    trajectories: Callable[[], Sequence[Trajectory]]


@dataclass(frozen=True)
class Estimator:
    """A method of point estimation."""

    name: str  # as asked for
    title: str  # as a heading
    rank: int  # place in every list; those it starts from have lower ones
    # makes the estimate, from the ones that were made before, by name
    estimate: Callable[[Given, Mapping[str, Estimate]], Estimate]
    starts_from: str = ""  # name of the method whose estimate it needs, if any
    simulates: bool = False  # whether it is dear, and some mechanisms have none


_FOUND: list[Estimator] = [
    import_module(f"{__name__}.{file.name}").ESTIMATOR for file in iter_modules(__path__)
]
ESTIMATORS = {one.name: one for one in sorted(_FOUND, key=lambda one: one.rank)}


def estimate_by(
    methods: Sequence[str],
    given: Given,
    found: Mapping[str, Estimate] | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Estimate]:
    """Estimate by some methods, and by those they start from unless ``found`` has them.

    ``progress`` is called with the name of each method before it begins. Gives estimates by every
    name in ``methods``, in the order of their ranks.

    Raises
    ------
    BadInput
        If there is no such method, or one cannot be used with these recordings.
    """
    for name in methods:
        if name not in ESTIMATORS:
            raise BadInput(f"method {name!r}", "there is none", nearest(name, ESTIMATORS))
    made = dict(found or {})
    wanted = {name for name in methods if name not in made}
    for one in reversed(ESTIMATORS.values()):
        if one.name in wanted and one.starts_from and one.starts_from not in made:
            wanted.add(one.starts_from)
    for name, one in ESTIMATORS.items():
        if name in wanted:
            progress(name)
            made[name] = one.estimate(given, made)
    return {name: made[name] for name in ESTIMATORS if name in methods}
