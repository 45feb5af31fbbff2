"""Whether load-dependent frictions one behind the other can be told apart."""

from __future__ import annotations

from collections.abc import Collection

from bayesfric.estimates.point_estimate import Estimate
from bayesfric.mechanism.joint import Joint

# A loss is told where its sd is less than this share of all of them together.
_TOLD = 0.5


def collinear_losses(chain: Joint, estimate: Estimate, known: Collection[str]) -> tuple[str, ...]:
    """Name load-dependent frictions of several elements where data identify none by itself.

    The torque that leaves one element is that which enters the next but for what stands between: a
    motion tells little more than the sum of their losses. Sampling that is slow: walkers wander
    along it, and two load losses make no moments that the likelihood would be cheap with (20000
    steps of 37 ms on the UR10e, where one load loss takes a minute).
    """
    lossy = [e.name for e in chain.elements if e.load_loss != "none"]
    names = [p.name for p in chain.parameters if p.owner in lossy and p.row.role == "loss"]
    if len(lossy) < 2 or any(n in known for n in names):
        return ()
    values = [estimate[n] for n in names]
    whole = sum(abs(v.value) for v in values)
    # what stands on a limit has no sd, and is not told either
    told = (v.determined and v.larger_sd < _TOLD * whole for v in values)
    return () if any(told) else tuple(names)
