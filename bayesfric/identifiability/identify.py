"""What recordings can and cannot tell, before anything is sampled.

The Jacobian of the observed quantity over its noise, in logarithms of the parameters,
is taken at the estimate and at other vectors that may be true. A direction is *null*
where its singular value is below 1e-7 of the largest, which is a thousand times what
rounding makes of an exact zero (1e-6 for a simulated position); it is *weak* where the
data leave the logarithm of a parameter more than 0.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.estimates.torque import typical_load
from bayesfric.identifiability.known_quantities import SpeedTerm, UnknownMass, unknown_mass
from bayesfric.identifiability.local import (
    LocalInformation,
    Verdict,
    in_natural_units,
    local_information,
    verdict,
)
from bayesfric.identifiability.plausible import Origin, Point
from bayesfric.identifiability.recording_facts import (
    RecordingFacts,
    back_driven,
    recording_facts,
)
from bayesfric.identifiability.remedies import HARDLY, WEAK, Remedy, left_along, remedies, trials
from bayesfric.identifiability.words import described, why
from bayesfric.inference.target import Target
from bayesfric.mechanism.derived import derive

Array = NDArray[np.float64]

# Entries of a direction smaller than this do not belong to it.
_MEMBER = 1e-5
# On a bound, up to rounding.
_ON_BOUND = 1e-6


@dataclass(frozen=True)
class OpenDirection:
    """Parameters that can change together, and the data say little or nothing.

    Attributes
    ----------
    null
        Whether nothing changes at all; else it is weak.
    exponents
        Parameter or alpha and its power of one factor; of those in ``shifted`` the change
        in their unit that goes with the factor e.
    shifted
        Parameters next to zero, of which no logarithm is taken, and their unit.
    log_sd
        Sd that the data leave of the factor's logarithm; infinite for a null direction.
    meaning, reasons
        In words: what can change, and why it does not show.
    remedies
        What lifts it.
    null_at, open_at
        At how many points it is null, and at how many it is null or weak.
    """

    null: bool
    exponents: dict[str, float]
    shifted: dict[str, str]
    log_sd: float
    meaning: str
    reasons: tuple[str, ...]
    remedies: tuple[Remedy, ...]
    null_at: int
    open_at: int


@dataclass(frozen=True)
class Prospect:
    """One parameter or derived quantity and how well it would be known.

    Attributes
    ----------
    name, unit, meaning
        As everywhere.
    value
        At the estimate; it means nothing where ``data_sd`` is infinite.
    data_sd
        What the data alone would leave.
    prior_sd
        Of the prior; ``nan`` for derived quantities.
    expected_sd
        Data and prior together.
    verdict
        To be expected of the posterior; ``None`` for derived quantities.
    on_bound
        ``lower`` or ``upper`` where the estimate stands on a bound: there these sds, made
        for a normal posterior, are too wide.
    """

    name: str
    unit: str
    meaning: str
    value: float
    data_sd: float
    prior_sd: float
    expected_sd: float
    verdict: Verdict | None = None
    on_bound: str | None = None


@dataclass(frozen=True)
class BackDriving:
    """How often the load drives one element, as a share of the moving outputs.

    Attributes
    ----------
    element
        Its name.
    load_loss
        ``one`` or ``two``.
    at_estimate
        Share at the estimate.
    plausible
        Least and largest share over the estimate and the points that suit the data.
    anywhere
        Least and largest share over all points.
    """

    element: str
    load_loss: str
    at_estimate: float
    plausible: tuple[float, float]
    anywhere: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Identification:
    """Everything that the local picture says.

    Attributes
    ----------
    method
        ``input-error`` or ``output-error``.
    origins
        Where each point comes from; the estimate first.
    singular_values
        ``(n_points, d)``, largest first.
    null_counts
        Number of null directions at each point.
    local
        The local picture at the estimate.
    directions
        Null ones first, then weak ones, the weakest first.
    parameters, combinations
        Prospects: free parameters and noise scales; what they amount to, of which no
        scaling changes any, best known first.
    recordings, back_driving
        Facts about the excitation.
    mass
        What rests on the added mass being known, where there is one.
    speed
        Parameters that a back-EMF cannot be told from; set by who knows of a voltage.
    notes
        What changes from point to point.
    """

    method: str
    origins: tuple[Origin, ...]
    singular_values: Array
    null_counts: tuple[int, ...]
    local: LocalInformation
    directions: tuple[OpenDirection, ...]
    parameters: tuple[Prospect, ...]
    combinations: tuple[Prospect, ...]
    recordings: tuple[RecordingFacts, ...]
    back_driving: tuple[BackDriving, ...]
    mass: UnknownMass | None
    speed: SpeedTerm | None
    notes: tuple[str, ...]


def identify(
    target: Target, points: Sequence[Point], *, speed: SpeedTerm | None = None
) -> Identification:
    """Find out what the recordings can tell.

    Parameters
    ----------
    target
        Likelihood, priors and noise.
    points
        The estimate first, then others that may be true; see
        :func:`bayesfric.identifiability.plausible.points_around`.
    speed
        What a back-EMF is confounded with, where the torque comes from a voltage.

    Raises
    ------
    BadInput
        If a simulation fails beside the estimate.
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    estimate = points[0].parameters
    k = len(target.free)
    points, locals_ = _locals(target, points)
    units = {p.name: p.unit for p in chain.parameters}
    local = locals_[0]
    vectors = target.chain_values(np.stack([p.parameters for p in points]))
    noise = target.noise.scales(estimate[None, k:])[0]
    facts = recording_facts(chain, observations, vectors[0], noise[:, 0])
    shares = back_driven(chain, observations, vectors)
    plausible = np.array([p.origin != "prior" for p in points])
    back = tuple(
        BackDriving(
            element.name,
            element.load_loss,
            float(share[0]),
            (float(share[plausible].min()), float(share[plausible].max())),
            (float(share.min()), float(share.max())),
        )
        for element in chain.elements
        if (share := shares.get(element.name)) is not None
    )
    rare = any(one.plausible[0] < HARDLY for one in back)
    tried = trials(target, estimate, local, facts, rare=rare)
    directions = []
    rows = _open_rows(local)
    for number, (row, null) in enumerate(rows):
        theory = number < local.from_theory
        wording = described(local, row, units, null=null, log_sd=left_along(local.information, row))
        others = [one for one, other in rows if other == null or other]
        at = (
            [(True, True)] * len(points)
            if theory
            else [_open_among(one, others, row) for one in locals_]
        )
        directions.append(
            OpenDirection(
                null,
                wording.exponents,
                wording.shifted,
                wording.log_sd,
                wording.meaning,
                why(local, row, null, theory, facts, shares, plausible),
                remedies(local, row, tried),
                sum(one for one, _ in at),
                sum(one for _, one in at),
            )
        )
    load = typical_load(chain, observations, vectors[0])
    return Identification(
        target.likelihood.method,
        tuple(p.origin for p in points),
        np.abs([one.directions.singular_values for one in locals_]),
        tuple(int(one.directions.null.sum()) for one in locals_),
        local,
        tuple(directions),
        _parameters(target, estimate, local),
        _combinations(target, estimate, local, load),
        facts,
        back,
        unknown_mass(target, estimate, local),
        speed,
        tuple(_changes(locals_, back, plausible)),
    )


def _locals(target: Target, points: Sequence[Point]) -> tuple[list[Point], list[LocalInformation]]:
    """Look at every point; those beside which a simulation fails are left out."""
    kept, found = [], []
    for p in points:
        try:
            local = local_information(target, p.parameters)
        except BadInput:
            if p is points[0]:
                raise
            continue
        kept.append(p)
        found.append(in_natural_units(target, p.parameters, local))
    return kept, found


def expected_covariance(target: Target, local: LocalInformation) -> Array:
    """Covariance of the free parameters that data and priors would leave, ``(k, k)``.

    The inverse of the Fisher information plus the priors' ``1/sd²``, in the local units.
    A parameter that neither confines makes all of it infinite along its direction.
    """
    sds = np.array([p.sd() for p in target.priors[: len(target.free)]])
    ratio = np.abs(local.units) / sds
    precision = local.information + np.diag(np.where(np.isfinite(ratio), ratio, 0.0) ** 2)
    values, vectors = np.linalg.eigh(precision)
    open_ = values <= 1e-15 * values[-1]
    inverse = np.where(open_, 0.0, 1.0 / np.where(open_, 1.0, values))
    covariance = (vectors * inverse) @ vectors.T
    for i in np.flatnonzero(open_):
        touched = np.abs(vectors[:, i]) > 1e-6
        covariance[np.ix_(touched, touched)] = np.inf
    return np.asarray(covariance)


def _open_rows(local: LocalInformation) -> list[tuple[Array, bool]]:
    """Null and weak directions in the local units, the largest entry of each one."""
    found = [(row, True) for row in local.null_rows]
    d = local.directions
    for value, row in sorted(
        zip(d.singular_values[~d.null], d.rows[~d.null], strict=True), key=lambda pair: pair[0]
    ):
        if np.abs(row).max() > WEAK * value:
            sparse = _without(row, local.null_rows)
            found.append((sparse / sparse[int(np.argmax(np.abs(sparse)))], False))
    return found


def _without(row: Array, null: Array) -> Array:
    """Take null directions off a direction, which changes no output, to make it short.

    The sum of absolute entries is least where one of them is zero, so those are tried.
    """
    for other in null:
        hits = np.flatnonzero(np.abs(other) > 1e-6)
        choices = [row] + [row - row[c] / other[c] * other for c in hits]
        row = min(choices, key=lambda one: float(np.abs(one).sum()))
    return row


def _open_among(there: LocalInformation, rows: Sequence[Array], row: Array) -> tuple[bool, bool]:
    """Say whether the members of a direction are null, and null or weak, at another point.

    Their powers may differ from point to point; what counts is whether changes of these
    parameters alone can leave the output as it is, in as many ways as at the estimate.
    """
    members = np.abs(row) > _MEMBER
    ways = sum(bool(np.all(np.abs(other[~members]) <= _MEMBER)) for other in rows)
    d = there.directions
    whole = np.where(d.null, 0.0, d.singular_values)[:, None] * d.rows
    told = whole[:, members]
    values, vectors = np.linalg.svd(told)[1:]
    null = values <= d.tolerance * float(d.singular_values[0])
    weak = np.abs(vectors).max(axis=1) > WEAK * values
    return int(null.sum()) >= ways, int((null | weak).sum()) >= ways


def _parameters(target: Target, estimate: Array, local: LocalInformation) -> tuple[Prospect, ...]:
    described_ = {p.name: p for p in target.likelihood.chain.parameters}
    expected = np.sqrt(np.diag(expected_covariance(target, local))) * np.abs(local.units)
    rows = []
    for j, (name, prior) in enumerate(zip(target.free, target.priors, strict=False)):
        p = described_[name]
        prior_sd = prior.sd()
        value = float(estimate[j])
        width = _ON_BOUND * max(abs(value), prior_sd if np.isfinite(prior_sd) else 0.0)
        low, high = prior.limits
        bound = "lower" if value - low <= width else None
        bound = "upper" if high - value <= width else bound
        rows.append(
            Prospect(
                name,
                p.unit,
                p.meaning,
                value,
                float(local.data_sd[j]),
                float(prior_sd),
                float(expected[j]),
                verdict(float(expected[j]), prior_sd, float(local.data_sd[j])),
                bound,
            )
        )
    return tuple(rows)


def _combinations(
    target: Target, estimate: Array, local: LocalInformation, load: float
) -> tuple[Prospect, ...]:
    """Derive what the parameters amount to, best known first."""
    chain, k = target.likelihood.chain, len(target.free)
    steps = 1e-5 * np.abs(local.units)
    moved = np.tile(estimate, (2 * k + 1, 1))
    index = np.arange(k)
    moved[index, index] += steps
    moved[k + index, index] -= steps
    covariance = expected_covariance(target, local)
    found = []
    for q in derive(chain, target.chain_values(moved), load):
        value = float(q.values[-1])
        gradient = (q.values[:k] - q.values[k : 2 * k]) / (2.0 * steps)
        if not np.isfinite(value) or not np.isfinite(gradient).all() or not gradient.any():
            continue
        data_sd = local.data_sd_of(gradient)
        scaled = gradient * local.units
        used = scaled != 0.0
        expected = float(scaled[used] @ covariance[np.ix_(used, used)] @ scaled[used])
        found.append(
            Prospect(
                q.name,
                q.unit,
                q.meaning,
                value,
                data_sd,
                float("nan"),
                float(np.sqrt(expected)) if expected >= 0.0 else float("inf"),
            )
        )
    return tuple(sorted(found, key=lambda one: one.data_sd / max(abs(one.value), 1e-300)))


def _changes(
    locals_: Sequence[LocalInformation], back: Sequence[BackDriving], plausible: NDArray[np.bool_]
) -> list[str]:
    """Say where the local picture at the estimate is not that of other points."""
    found = []
    counts = np.array([int(one.directions.null.sum()) for one in locals_], dtype=np.int_)
    if np.ptp(counts):
        found.append(
            f"the number of null directions changes from point to point: {counts[0]} at the "
            f"estimate, {_range(counts[plausible])} at the {plausible.sum()} points that suit the "
            f"data, {_range(counts)} over all {counts.size}"
        )
    for one in back:
        low, high = one.anywhere
        name = f"{one.element}.load_back" if one.load_loss == "two" else f"{one.element}.load"
        if one.load_loss == "two" and low == 0.0 < high:
            found.append(
                f"{name} matters only where the load drives {one.element}: in 0 to "
                f"{100 * high:.2g} % of the moving outputs, depending on the point"
            )
    return found


def _range(counts: NDArray[np.int_]) -> str:
    low, high = int(counts.min()), int(counts.max())
    return f"{low}" if low == high else f"{low} to {high}"
