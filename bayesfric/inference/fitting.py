"""The whole way from prepared recordings to a posterior.

Priors are read, a likelihood is put on the recordings, point estimates give places to start from,
the mode is climbed to, coordinates are chosen for the posterior's widths there, and the posterior
is sampled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, Shown, silent
from bayesfric.estimates.least_squares import least_squares, starting_values
from bayesfric.estimates.methods import ESTIMATORS
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.estimates.sizes import measured_scales
from bayesfric.inference.discrepancy import Discrepancy
from bayesfric.inference.likelihood.likelihood import Likelihood
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.linearisation import linearisation_change
from bayesfric.inference.noise import SCALES
from bayesfric.inference.noise.autoregressive import Autoregressive
from bayesfric.inference.noise.scale import NoiseScale, noise_of
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.predictive import Prediction
from bayesfric.inference.prior.defaults import default_prior
from bayesfric.inference.prior.priors import Prior, PriorText, read_prior
from bayesfric.inference.sampling.sampling import Sampling, sample
from bayesfric.inference.sampling.start import CLIMBS, Start, climb, gauss_newton
from bayesfric.inference.target import Target
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

# Draws of the expected posterior that a cheaper likelihood is prepared for.
_DRAWS = 300
# Predicted outputs, over all draws, that a mean residual is made of.
_PREDICTED = 2_000_000
# Draws that are enough for intervals with the model's error, each of which is tried.
_WIDE = 8000
# Evaluations of a climb's step that may be dear before it is prepared anew.
_OUTSIDE = 50
# How often the simulation is linearised anew at the mode it led to.
_ROUNDS = 2
# Steps of a climb that simulates.
_MOST_SIMULATED = 20


@dataclass(frozen=True)
class Fit:
    """A finished fit; the target's likelihood holds mechanism and observations."""

    target: Target  # The log-posterior, in the coordinates that were sampled
    posterior: Posterior  # Draws, the model taken for true
    estimates: tuple[Estimate, ...]  # Point estimates of the same recordings, least squares first
    held_out: tuple[Prediction, ...] = ()  # Predictions of what the likelihood did not see
    # What :func:`linearisation_change` said before sampling; far below 1 it does not matter. None
    # where nothing is linearised
    linearisation: float | None = None
    discrepancy: Discrepancy | None = None  # How far the model may be off, where that was asked
    # (n, d) reported draws, widened by model discrepancy, as a finished run holds them; they are
    # made from discrepancy where left out
    widened_draws: Array | None = None

    @cached_property
    def wide(self) -> Fit:
        """The same fit with what the model may lack marginalised in its draws.

        At most about 8000 of the draws, thinned along steps, are moved by
        :meth:`Discrepancy.widened`; the fit itself where there is no discrepancy. Draws of a
        finished run have no log density: it is nan.
        """
        posterior = self.posterior
        if self.widened_draws is not None:
            held = self.widened_draws[None, None]
            unknown = np.full(held.shape[:-1], np.nan)
            # whose walkers are not told: those that never moved were left out
            diagnostics = replace(posterior.diagnostics, acceptance=np.ones(held.shape[:2]))
            changed = replace(posterior, draws=held, log_density=unknown, diagnostics=diagnostics)
            return replace(self, posterior=changed, widened_draws=None)
        if self.discrepancy is None or not self.discrepancy.moved:
            return self
        rng = np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(12,)))
        e, w, steps, d = posterior.draws.shape
        some = slice(None, None, -(-e * w * steps // _WIDE))
        draws = posterior.draws[:, :, some]
        moved = self.discrepancy.widened(self.target, draws.reshape(-1, d), rng)
        changed = replace(
            posterior,
            draws=moved.reshape(draws.shape),
            log_density=posterior.log_density[:, :, some],
        )
        return replace(self, posterior=changed, discrepancy=None)

    @property
    def chain(self) -> Joint:
        """The mechanism."""
        return self.target.likelihood.chain

    @property
    def observations(self) -> tuple[Observation, ...]:
        """The prepared recordings."""
        return self.target.likelihood.observations

    @property
    def predicting(self) -> Array:
        """Draws ``(n, d)`` that predict every output: 200, of long recordings fewer."""
        outputs = sum(o.measured.size for o in self.target.likelihood.outputs)
        return self.posterior.flat(max(10, min(200, _PREDICTED // outputs)))

    @cached_property
    def residuals(self) -> list[Array]:
        """Measured minus posterior mean output of each recording, ``(M,)`` in the outputs' unit.

        The mean is over the draws of :attr:`predicting`.
        """
        likelihood = self.target.likelihood
        predicted = likelihood.predict(self.target.chain_values(self.predicting))
        pairs = zip(likelihood.outputs, predicted, strict=True)
        return [o.measured - rows.mean(axis=0) for o, rows in pairs]

    def chain_draws(self, n: int | None = None) -> Array:
        """Draws of all parameters of the mechanism, fixed ones included.

        Shapes: returns (n, n_parameters).
        """
        return self.target.chain_values(self.posterior.flat(n))


def read_priors(
    chain: Joint,
    texts: Mapping[str, PriorText],
    observations: Sequence[Observation],
    noise: Sequence[str] = ("sigma",),
) -> dict[str, Prior]:
    """Complete the configured priors of parameters and noise scales with defaults."""
    noises = [f"noise.{quantity}" for quantity in noise]
    # one prior for the offset stands for those of all recordings that have none of their own
    if "offset" in texts and chain.own_offsets:
        texts = dict.fromkeys(chain.offset_names, texts["offset"]) | {
            name: text for name, text in texts.items() if name != "offset"
        }
    known = [*chain.names, *noises]
    for name in texts:
        if name not in known:
            raise BadInput(
                f"priors.{name}", "the mechanism has no such parameter", nearest(name, known)
            )
    scales = measured_scales(chain, observations)
    priors = {
        p.name: read_prior(p.name, texts[p.name], lower=p.lower, upper=p.upper, circular=p.circular)
        if p.name in texts
        else default_prior(chain, p, scales)
        for p in chain.parameters
    }
    for name, quantity in zip(noises, noise, strict=True):
        priors[name] = SCALES[quantity].read_prior(texts, scales)
        if priors[name].fixed:
            raise BadInput(f"priors.{name}", "cannot be fixed", "give a narrow range instead")
    if all(priors[name].fixed for name in chain.names):
        raise BadInput("priors", "fix every parameter", "leave at least one free")
    return priors


def make_target(
    chain: Joint,
    observations: Sequence[Observation],
    priors: Mapping[str, Prior],
    noise_scale: NoiseScale,
    noise: Autoregressive | None = None,
) -> Target:
    """Put the likelihood of the torque, priors and noise together."""
    return target_of(TorqueLikelihood(chain, observations, noise), priors, noise_scale)


def target_of(
    likelihood: Likelihood, priors: Mapping[str, Prior], noise_scale: NoiseScale
) -> Target:
    """Put any likelihood and its priors together."""
    recordings = [o.name for o in likelihood.observations]
    noise = noise_of(recordings, likelihood.noise.scales, priors, noise_scale)
    return Target(likelihood, priors, noise)


def fit(
    target: Target,
    sampling: Sampling,
    *,
    estimates: Sequence[Estimate] = (),
    progress: Shown = silent,
) -> Fit:
    """Estimate, climb to the mode, sample.

    Estimates that simulate, and only stand beside a posterior of the torque, are not started from:
    they may be cut off by the clock, and a fit must be repeatable. Everything else random comes
    from ``sampling.seed``.
    """
    likelihood = target.likelihood
    if not estimates:
        estimates = (least_squares(likelihood.chain, likelihood.observations),)
    progress(Progress("searching the mode"))
    rng = np.random.default_rng(np.random.SeedSequence(sampling.seed, spawn_key=(2**31,)))
    # what only stands beside the posterior, and may be cut off by the clock, must not move it
    beside = {one.name for one in ESTIMATORS.values() if one.simulates} - {likelihood.method}
    begin = [e for e in estimates if e.method not in beside]
    points = _points(target, begin)
    target = target.with_circular_cut_at(points[0])
    prior_draws = np.stack([prior.draw(500, rng) for prior in target.priors], axis=1)
    try:
        candidates = _candidates(target, begin, points, prior_draws)
        # estimates with a point searched from several starts, and are beside the mode already
        climbs = 1 if any(e.point for e in begin) else CLIMBS
        heights = target.subsample()(candidates)
        candidates = candidates[np.argsort(-heights)[:climbs]]
        prior_places = target.from_parameters(prior_draws)
        best = gauss_newton(target, candidates[0], prior_places)
        target = _prepared(target, best, rng)
        if likelihood.method == "input-error":
            search = _Search(target, prior_places, rng)
            widths = 1.0 / np.sqrt(np.diag(np.linalg.inv(best.covariance)))
            mode = climb(
                search, candidates, climbs=climbs, widths=widths, moved=search.prepare_again
            )
        else:
            target, mode = _simulated_mode(target, candidates)
    except ValueError:
        raise BadInput(
            "priors", "leave no possible starting point near the data", "widen the narrowest ones"
        ) from None
    # Once the posterior's widths are known, better coordinates than logarithms are too.
    first = gauss_newton(target, mode, prior_places)
    place, widths = _place_and_widths(target, first)
    shaped = target.with_circular_cut_at(dict(zip(target.free, place, strict=False))).with_widths(widths)
    prior_draws = _on_turn(shaped, prior_draws)
    start = gauss_newton(
        shaped, shaped.from_parameters(place[None])[0], shaped.from_parameters(prior_draws)
    )
    shaped = _prepared(shaped, start, rng)
    simulated = likelihood.method == "output-error"
    change = linearisation_change(shaped, start, rng) if simulated else None
    try:
        posterior = sample(shaped, start, sampling, progress=progress)
    except RuntimeError as error:
        raise BadInput("priors", str(error), "widen the narrowest ones") from None
    return Fit(shaped, posterior, tuple(estimates), linearisation=change)


class _Search:
    """Log density of a target that is prepared anew once a climb has left where it is cheap.

    With a million samples a vector outside costs ten thousand times one inside.
    """

    def __init__(self, target: Target, prior_places: Array, rng: np.random.Generator) -> None:
        self.target, self._prior_places, self._rng = target, prior_places, rng
        self._outside = target.likelihood.slow_evaluations

    def __call__(self, u: Array) -> Array:
        return self.target(u)

    def prepare_again(self, place: Array) -> None:
        """Prepare at coordinates ``(d,)`` if the last step was mostly outside."""
        before, self._outside = self._outside, self.target.likelihood.slow_evaluations
        if self._outside - before > _OUTSIDE:
            start = gauss_newton(self.target, place, self._prior_places)
            self.target = _prepared(self.target, start, self._rng)
            self._outside = self.target.likelihood.slow_evaluations


def _simulated_mode(target: Target, candidates: Array) -> tuple[Target, Array]:
    """Climb with few simulations, and linearise the simulation anew at what is found."""
    mode = climb(target, candidates, climbs=1, max_steps=_MOST_SIMULATED)
    for _ in range(_ROUNDS):
        target = target.relinearised_at(target.to_parameters(mode[None])[0][0])
        mode = climb(target, mode[None], climbs=1, max_steps=_MOST_SIMULATED)
    return target, mode


def _prepared(target: Target, start: Start, rng: np.random.Generator) -> Target:
    """Make a target cheap where a normal lies; the draws decide the cost, not the value."""
    root = np.linalg.cholesky(start.covariance)
    return target.precomputed(start.mode + rng.standard_normal((_DRAWS, start.mode.size)) @ root.T)


def _place_and_widths(target: Target, start: Start) -> tuple[Array, Array]:
    """Carry a normal in coordinates over to parameters: its centre and sds, ``(d,)`` each."""
    spread = np.sqrt(np.diag(start.covariance))
    sds = np.minimum(spread, 1.0 + np.abs(start.mode))
    centre, _ = target.to_parameters(start.mode[None])
    shifted, _ = target.to_parameters(start.mode + np.concatenate([np.diag(sds), -np.diag(sds)]))
    d = start.mode.size
    # of every parameter with every coordinate: a gearbox' are not one for one
    change = (shifted[:d] - shifted[d:]) / 2.0
    together = start.covariance / np.outer(spread, spread)
    widths = np.sqrt(np.einsum("ij,ik,kj->j", change, together, change).clip(0.0))
    widths = np.where(np.isfinite(widths), widths, np.abs(centre[0]))
    return centre[0], np.maximum(widths, 1e-12 * np.abs(centre[0]) + 1e-300)


def _points(target: Target, estimates: Sequence[Estimate]) -> list[dict[str, float]]:
    """Parameters to start from, by name: estimates, and base parameters split in several ways.

    Least squares gives the quantities seen at the motor; coefficients of load-dependent friction
    and the leg's share of each are tried on a grid.
    """
    points = [dict(e.point) for e in estimates if e.point]
    # a simulation costs more than an inverse model, and starts from a simulation's estimate
    if target.likelihood.method == "input-error" or not points:
        points += [
            starting_values(target.likelihood.chain, e, mu, share)
            for e in estimates
            if not e.point
            for mu in (0.02, 0.1, 0.2, 0.4)
            for share in (0.2, 0.5, 0.8)
        ]
    return points


def _on_turn(target: Target, parameters: Array) -> Array:
    """Bring angles of parameters ``(n, d)`` or ``(n, free)`` to the turn of their priors."""
    columns = zip(target.priors, parameters.T, strict=False)
    return np.stack([prior.turned(column) for prior, column in columns], axis=1)


def _candidates(
    target: Target,
    estimates: Sequence[Estimate],
    points: Sequence[Mapping[str, float]],
    prior_draws: Array,
) -> Array:
    """Places to start from, ``(n, d)`` in coordinates: points, and draws from the priors.

    Each with several noise scales. What lies on a bound is put inside of it, where coordinates are
    finite.
    """
    likelihood = target.likelihood
    k = len(target.free)
    rows = _on_turn(target, np.array([[p[name] for name in target.free] for p in points]))
    # a start at a bound would have no finite coordinates
    inner = np.quantile(prior_draws, [0.002, 0.998], axis=0)
    for j, prior in enumerate(target.priors[:k]):
        outside = (rows[:, j] <= prior.lower) | (rows[:, j] >= prior.upper)
        rows[outside, j] = np.clip(rows[outside, j], *inner[:, j])
    if likelihood.method == "input-error":
        rms = max(e.residual_rms for e in estimates if e.method == "least-squares")
        # whatever drawn parameters leave unexplained is about as large as the torque itself
        measured = np.concatenate([o.measured for o in likelihood.outputs])
        unexplained = float(np.sqrt(np.mean(measured**2)))
        candidates = np.concatenate(
            [
                np.column_stack([some, np.tile(scales, (len(some), 1))])
                for some, size in ((rows, rms), (prior_draws[:100, :k], unexplained))
                for scales in _noise_starts(target, size)
            ]
        )
    else:
        scales = _noise_grid(target, inner[:, k:])
        candidates = np.column_stack(
            [np.repeat(rows, len(scales), axis=0), np.tile(scales, (len(rows), 1))]
        )
    candidates[:, k:] = np.clip(candidates[:, k:], *inner[:, k:])
    return target.from_parameters(candidates)


def _noise_starts(target: Target, size: float) -> Array:
    """Noise scales for residuals of this size, the same for all recordings, ``(m, scales)``."""
    likelihood = target.likelihood
    assert isinstance(likelihood, TorqueLikelihood)
    columns = [likelihood.noise.quantities.index(kind) for kind in target.noise.quantities]
    return np.asarray(likelihood.noise.starts(size)[:, columns])


def _noise_grid(target: Target, inner: Array) -> Array:
    """Noise scales over their priors' ranges, the same for all recordings, ``(n, scales)``."""
    kinds = target.noise.quantities
    own = list(dict.fromkeys(kinds))
    ends = [inner[:, kinds.index(kind)] for kind in own]
    axes = [np.geomspace(low, high, 9) for low, high in ends]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(own))
    return grid[:, [own.index(kind) for kind in kinds]]
