"""The next experiment: how well one quantity would be known after each candidate.

What a recording adds is its Fisher information, so the sd that a candidate would leave is
predicted from prior, present recordings and candidate without sampling anything: a local Bayesian
design (Chaloner and Verdinelli, Statistical Science 10, 1995), at the estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesfric.base.errors import BadInput, nearest
from bayesfric.estimates.assemble import open_directions
from bayesfric.estimates.information import directions
from bayesfric.estimates.torque import typical_load
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.identifiability.coverage import back_driven
from bayesfric.identifiability.identification import moved_beside, prior_rows
from bayesfric.identifiability.local import LocalInformation, fixed_in
from bayesfric.identifiability.proposals import (
    Candidate,
    Limits,
    candidates,
    fastest,
    limits_of,
    longest,
    try_out,
)
from bayesfric.identifiability.sentences import Statement, plain, stated
from bayesfric.identifiability.virtual_recording import TorqueNoise, scaled_jacobian, torque_noise
from bayesfric.inference.target import Target
from bayesfric.mechanism.derived import derive
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

if TYPE_CHECKING:
    import pandas as pd

# Singular values below this share of the largest are rounding once null directions are out.
_ROUNDING = 1e-13
# Anything that a candidate leaves of the sd above this share is not worth the effort.
WORTH = 0.95
# Share of what counts as a change of one that is next to zero, but is not.
_OFF_ZERO = 1e-3


@dataclass(frozen=True)
class Uncertainty:
    """How well the quantity is known."""

    sd: float  # recordings and prior together; infinite where neither confines it
    relative_sd: float | None  # the same as a share of the value, if recordings determine that
    data_sd: float  # of the recordings alone; infinite where they leave it open


@dataclass(frozen=True, eq=False)
class Advice:
    """One recording that could be made next, and what it would do."""

    candidate: Candidate
    after: Uncertainty  # how well the quantity would be known then
    load_drives: dict[str, float]  # element with a load loss: share in which the load drives it
    peak_speed: float  # rad/s or m/s
    angles: tuple[float, float]  # lowest and highest position, rad or m


@dataclass(frozen=True, eq=False)
class Ranking:
    """Candidates by the sd that they would leave of one quantity, the best first."""

    quantity: str  # what is to be known
    unit: str
    meaning: str
    value: float  # at the estimate; it means nothing where now.data_sd is infinite
    now: Uncertainty  # how well it is known at present
    advices: tuple[Advice, ...]  # the best first
    dropped: tuple[tuple[Candidate, Statement], ...]  # candidates that are no use, and why
    limits: Limits  # what they had to keep

    @property
    def determined(self) -> bool:
        """Whether the recordings, there and to come, would determine it without the prior."""
        return any(np.isfinite(one.after.data_sd) for one in self.advices)

    @property
    def worth(self) -> bool:
        """Whether the best candidate leaves noticeably less than is left now."""
        best = self.advices[0].after if self.advices else self.now
        if not np.isfinite(best.sd):
            return False
        return best.sd < WORTH * self.now.sd or not np.isfinite(self.now.sd)

    @property
    def assumption(self) -> Statement:
        """What all standard deviations here take for granted."""
        return stated("advice", "assumed")

    @property
    def verdict(self) -> Statement:
        """Whether any candidate is worth making."""
        best = self.advices[0].after if self.advices else None
        if best is None:
            kind = "not_playable"
        elif not np.isfinite(best.sd):
            kind = "no_sd"
        elif not self.determined:
            kind = "undetermined"
        elif not self.worth:
            kind = "not_worth"
        elif not np.isfinite(best.data_sd):
            kind = "left_to_priors"
        elif not np.isfinite(self.now.data_sd):
            kind = "would_determine"
        else:
            kind = "would_leave"
        share = best.sd / self.now.sd if best else float("nan")
        with_masses = any(one.added_mass for one in self.limits.masses)
        return stated("advice", kind, name=self.quantity, share=share, with_masses=with_masses)

    @property
    def left_out(self) -> Iterator[tuple[str, int, list[str]]]:
        """Reasons why candidates are no use, with how many there are of each, and what they are."""
        reasons: dict[str, list[str]] = {}
        for one, why in self.dropped:
            reasons.setdefault(str(why), []).append(one.described)
        for reason, forms in reasons.items():
            yield reason, len(forms), list(dict.fromkeys(forms))

    def _described(self, one: Candidate) -> dict[str, Any]:
        found = {"kind": one.kind, "form": one.form, "peak_torque": one.amplitude}
        return found | {"duration": one.duration, **_bolted(one), "start": one.q0}

    def as_json(self) -> dict[str, Any]:
        """Give what ``identify --advise --json`` prints; what is infinite is ``None``."""
        rows = []
        for rank, one in enumerate(self.advices, start=1):
            row = self._described(one.candidate) | {"rank": rank} | vars(one)
            row |= {"torque_lowered_to": one.candidate.lowered, "because_of": one.candidate.limit}
            rows.append({name: value for name, value in row.items() if name != "candidate"})
        masses = [(m.added_mass, m.radius) for m in self.limits.masses if m.added_mass]
        found = {name: getattr(self, name) for name in ("quantity", "unit", "meaning", "value")}
        found |= {"determined": bool(np.isfinite(self.now.data_sd)), "now": self.now}
        found |= {"limits": {**vars(self.limits), "masses": masses}}
        found |= {"assumption": self.assumption, "verdict": self.verdict, "candidates": rows}
        found["dropped"] = [{**self._described(one), "reason": why} for one, why in self.dropped]
        return {name: plain(value) for name, value in found.items()}

    @property
    def frame(self) -> pd.DataFrame:
        """One row a candidate, the best first."""
        import pandas as pd

        return pd.json_normalize(self.as_json()["candidates"]).set_index("rank")

    def _repr_html_(self) -> str:
        """Show the table in a notebook."""
        return str(self.frame.to_html(float_format="{:.4g}".format))


def _bolted(one: Candidate) -> dict[str, float]:
    return {"added_mass": one.inputs.added_mass, "radius": one.inputs.radius}


@dataclass(frozen=True, eq=False)
class _At:
    """What is known at the estimate, in logarithms of the parameters."""

    values: Array  # (n_parameters,)
    local: LocalInformation
    prior: Array  # (d, d) rows with the information of the priors
    gradient: Array  # (d,) of the quantity, by changes of one in the local units


def ranking(
    target: Target,
    point: Array,
    local: LocalInformation,
    options: AdviceOptions,
    name: str,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> Ranking:
    """Rank candidates for the next recording by what they would leave of one quantity.

    With the output error, a candidate still adds the information of its torque, at the noise of a
    torque sample. ``point`` ``(d,)`` is the estimate, whose picture is ``local``; ``name`` is a
    free parameter or a derived quantity. ``progress`` is called with each stage before it begins.

    Raises
    ------
    BadInput
        If there is no such quantity, if it is fixed, or if a limit cannot be.
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    at_estimate = target.chain_values(point[None])[0]
    load = typical_load(chain, observations, at_estimate)
    unit, meaning = _described(target, name, point, load)
    value = float(_values(target, name, point[None], load)[0])
    at = _at(target, point, local, name, load)
    limits = limits_of(options, chain, observations, at_estimate)
    base = longest(observations)
    number = next(i for i, o in enumerate(observations) if o is base)
    noise = torque_noise(target, point, number)
    advices, dropped = [], []
    for candidate in candidates(chain, at_estimate, observations, limits):
        progress(f"simulating {candidate.form}")
        tried = try_out(chain, at.values, base, candidate, limits)
        if isinstance(tried, Statement):
            dropped.append((candidate, tried))
            continue
        tried_one, o = tried
        shares = back_driven(chain, [o], at.values[None])
        drives = {element: float(share[0]) for element, share in shares.items()}
        peak = fastest(o) if tried_one.made is not None else float(np.abs(o.qd).max())
        after = _uncertainty(_sds(target, at, o, noise), value)
        ends = float(o.q.min()), float(o.q.max())
        advices.append(Advice(tried_one, after, drives, peak, ends))
    advices.sort(key=lambda one: (one.after.sd, one.after.data_sd))
    now = _uncertainty(_sds(target, at), value)
    return Ranking(name, unit, meaning, value, now, tuple(advices), tuple(dropped), limits)


def _described(target: Target, name: str, parameters: Array, load: float) -> tuple[str, str]:
    """Give unit and meaning of what can be advised on, at possible parameters ``(d,)``."""
    chain = target.likelihood.chain
    where = f"--advise {name}"
    described = {p.name: (p.unit, p.meaning) for p in chain.parameters}
    values = target.chain_values(parameters[None])
    described |= {q.name: (q.unit, q.meaning) for q in derive(chain, values, load)}
    if name not in described:
        raise BadInput(
            where, "no parameter or derived quantity has that name", nearest(name, described)
        )
    if name in chain.names and name not in target.free:
        what = f"is fixed at {values[0, chain.names.index(name)]:.6g} by its prior"
        raise BadInput(where, what, f"give priors.{name} a width, or ask for another quantity")
    return described[name]


def _values(target: Target, name: str, parameters: Array, load: float) -> Array:
    """Values of the quantity at sampled parameters ``(n, d)``, ``(n,)``."""
    if name in target.free:
        return np.asarray(parameters[:, target.free.index(name)])
    made = derive(target.likelihood.chain, target.chain_values(parameters), load)
    return next(q.values for q in made if q.name == name)


def _at(target: Target, point: Array, local: LocalInformation, name: str, load: float) -> _At:
    # central differences, exact up to rounding for what is next to linear
    moved, widths = moved_beside(local, point)
    up, down = _values(target, name, moved, load).reshape(2, -1)
    gradient = (up - down) / widths * local.units
    if not np.isfinite(gradient).all() or not gradient.any():
        what = "is not defined at the estimate, or made of fixed values only"
        raise BadInput(
            f"--advise {name}", what, "give these priors with a width, or ask for another quantity"
        )
    values = _movable(target, point, local)
    return _At(values, local, prior_rows(target, local), gradient)


def _movable(target: Target, parameters: Array, local: LocalInformation) -> Array:
    """Values of the chain ``(n_parameters,)`` that can be simulated, at sampled ones ``(d,)``.

    What shapes others and is zero, as a Stribeck velocity on its bound, gives a term no one value
    at rest: so little more that no sample shows it does.
    """
    chain, moved = target.likelihood.chain, parameters.copy()
    for k, name in enumerate(target.free):
        row = chain.parameters[chain.names.index(name)].row
        if row.role == "form" and row.lower == 0.0 < row.default:
            moved[k] = max(moved[k], _OFF_ZERO * abs(float(local.units[k])))
    return np.asarray(target.chain_values(moved[None])[0])


def _sds(
    target: Target, at: _At, added: Observation | None = None, noise: TorqueNoise | None = None
) -> tuple[float, float]:
    """Posterior sd and the sd that recordings alone leave, with one more recording or none.

    Both come from singular values, not from squares of them, and what theory says that no
    torque tells is taken out first: rounding never makes a finite sd.
    """
    chain, observations = target.likelihood.chain, list(target.likelihood.observations)
    k = len(target.free)
    rows, known = at.local.told, None
    if added is not None and noise is not None:
        more = scaled_jacobian(target, added, at.values, at.local, noise)
        rows = np.concatenate([rows, more])
        # which scalings are open depends on the masses in all recordings together
        fixed = fixed_in(target, at.values)
        open_ = open_directions(chain, fixed, [*observations, added], at.values)
        known = open_ / at.local.units
        if not np.isfinite(rows).all():
            return float("inf"), float("inf")
    tolerance = at.local.directions.tolerance
    told = directions(rows, np.ones(k), tolerance, known_null=known)
    kept = told.rows[~told.null] * told.singular_values[~told.null, None]
    both = directions(np.concatenate([kept, at.prior]), np.ones(k), _ROUNDING)

    def left(weight: Array | None) -> float:
        return float("inf") if weight is None else float(np.sqrt(at.gradient @ weight))

    return left(both.solve(at.gradient)), left(told.solve(at.gradient))


def _uncertainty(sds: tuple[float, float], value: float) -> Uncertainty:
    sd, data_sd = sds
    # a share of a value that is not determined would mean nothing
    relative = sd / abs(value) if np.isfinite(data_sd) and value != 0.0 else None
    return Uncertainty(sd, relative, data_sd)
