"""A joint, its recordings and priors, and the questions that can be asked of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, ProgressCallback, by_method, no_progress
from bayesfric.diagnostics.explanation import Explanation, explain, too_few_outputs
from bayesfric.diagnostics.regression import Finding
from bayesfric.diagnostics.statistics import MAX_EFFECTS
from bayesfric.estimates import METHODS, Method
from bayesfric.estimates.input_error import contradicted
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.methods import (
    EstimationInputs,
    FittedModel,
    estimate_by,
    predicts_better,
)
from bayesfric.estimates.point_estimate import Estimate, Knowledge
from bayesfric.inference.fitting import make_target, target_of
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.noise import Autoregressive, NoiseChoice, choose_noise
from bayesfric.inference.position_likelihood import PositionLikelihood
from bayesfric.inference.priors import Prior, as_knowledge
from bayesfric.inference.target import Likelihood, Target
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.own_term import Term
from bayesfric.problem.config import Config, read_config
from bayesfric.problem.config_text import with_settings
from bayesfric.problem.preparation import prepare
from bayesfric.recordings.source import Recording
from bayesfric.recordings.trajectory import Trajectory, trajectory


class Problem:
    """Joint, recordings and priors of a configuration; see :class:`bayesfric.Model`."""

    @classmethod
    def from_config(
        cls,
        config: Config | Path | str,
        *,
        terms: Sequence[Term] = (),
        recordings: Sequence[Recording] | None = None,
    ) -> Self:
        """Read a configuration and its recordings; a finished run's ``config.toml`` is one.

        ``terms`` are the functions of custom terms that it names. ``recordings`` replace those
        that it names, if not all are in files.
        """
        problem = cls.__new__(cls)
        read = config if isinstance(config, Config) else read_config(Path(config))
        problem._read(read, recordings, terms)
        return problem

    def _read(
        self,
        config: Config,
        recordings: Sequence[Recording] | None = None,
        terms: Sequence[Term] = (),
    ) -> None:
        self.config, self.given = config, recordings or ()
        self._estimates: dict[Method, Estimate] = {}  # cache
        self.chain, self.priors, divided, self.encoder = prepare(config, recordings, terms)
        self.recordings, self.observations = divided.recordings, divided.observations
        self.held_out = divided.held_out
        self.references()  # validates them

    def alone(self, k: int) -> Self:
        """Return the same problem with recording ``k`` alone."""
        single = copy(self)
        single.recordings, single.observations = [self.recordings[k]], [self.observations[k]]
        single._estimates = {}
        return single

    def references(self) -> dict[str, dict[str, Any]]:
        """Values to compare with, by name.

        Raises
        ------
        BadInput
            If no result of this mechanism has such a name.
        """
        units = {p.name: p.unit for p in self.chain.parameters}
        middle = np.ones((1, len(self.chain.names)))
        units |= {q.name: q.unit for q in derive(self.chain, middle, 1.0)}
        projection = TotalsProjection(self.chain, self.observations)
        for name, label in zip(projection.names, projection.labels, strict=True):
            units[label] = projection.describe(name)[0]
        converted, aliases = {}, projection.aliases()
        for key, reference in self.config.references.items():
            name = key if key in units else aliases.get(key, key)
            if name not in units or (name != key and name in self.config.references):
                raise BadInput(
                    f"{self.config.path}: references.{key}",
                    "no result of this mechanism has that name",
                    nearest(key, units),
                )
            converted[name] = {**reference.model_dump(), "unit": units[name]}
        return converted

    def estimates(
        self, methods: Sequence[Method] = METHODS, *, progress: ProgressCallback = no_progress
    ) -> list[Estimate]:
        """Estimate the parameters by one or more methods.

        Parameters
        ----------
        methods
            Which; the output error starts from the input error's result.
        progress
            Progress callback.

        Raises
        ------
        BadInput
            If there is no such method, or one cannot be used with these recordings.
        """
        with self.config.named():
            shown = by_method(progress)
            new = estimate_by(methods, self.evidence, self._estimates, progress=shown)
        self._estimates |= new
        return list(new.values())

    @cached_property
    def _knowledge(self) -> Knowledge:
        """Priors for point estimates; the moments of some take seconds."""
        return as_knowledge(self.chain, self.priors)

    @property
    def evidence(self) -> EstimationInputs:
        """Inputs of point estimates."""
        return EstimationInputs(
            self.chain,
            self.observations,
            self._knowledge,
            self.config.tables.estimation,
            self.trajectories,
        )

    def trajectories(self, segment: float = np.inf) -> list[Trajectory]:
        """Trajectories of fitted recordings, restarting every ``segment`` s."""
        pairs = zip(self.recordings, self.observations, strict=True)
        return [trajectory(recording, observation, segment) for recording, observation in pairs]

    def explain(
        self,
        estimates: Sequence[Estimate] = (),
        *,
        seed: int | None = None,
        progress: ProgressCallback = no_progress,
    ) -> Explanation:
        """Find what else explains the torque, tested against simulated replicates.

        It starts from the first of the ``estimates`` with all parameters, or from the input error;
        ``seed`` replaces that of the table ``sampling``.

        Raises
        ------
        BadInput
            If nothing can be estimated from these recordings.
        """
        if reason := too_few_outputs(self.chain, self.observations):
            return Explanation(reason=reason)
        point = self._point(estimates, progress)
        progress(Progress("what else explains the torque"))
        return explain(
            self.chain,
            self.recordings,
            self.observations,
            self.config.tables.processing,
            point,
            sorted(self.evidence.knowledge.fixed),
            self.config.tables.sampling.seed if seed is None else seed,
        )

    def _point(self, estimates: Sequence[Estimate], progress: ProgressCallback) -> dict[str, float]:
        """Return the first estimate with all parameters, or that of the input error."""
        point = next((dict(estimate.point) for estimate in estimates if estimate.point), None)
        return point or dict(self.estimates(["input-error"], progress=progress)[0].point)

    def contradicted(self, start: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Compare priors with an estimate without them, started at a point.

        See :func:`bayesfric.estimates.input_error.contradicted`.
        """
        e = self.evidence
        return contradicted(e.chain, e.observations, e.knowledge, e.options, start)

    def completed(
        self, *, progress: ProgressCallback = no_progress
    ) -> tuple[Self, tuple[Finding, ...], Explanation]:
        """Add effects that explain the torque, one after the other, until none is left.

        A term is kept if the model with it predicts held-out data better, see
        :func:`bayesfric.estimates.methods.predicts_better`; else it is part of the model
        discrepancy. A delay, which moves other parameters by much, is added only without rivals. A
        fit does so with ``terms = "auto"`` under ``[mechanism]``.

        Returns
        -------
        model
            With all terms added, also in its ``config``.
        included
            Their findings, in the order of selection.
        remaining
            What else explains the torque of that model.

        Raises
        ------
        BadInput
            If nothing can be estimated from these recordings.
        """
        model, included = self, list[Finding]()
        if too_few_outputs(self.chain, self.observations):
            return self, (), self.explain()
        current = self._candidate(progress)
        while True:
            remaining = model.explain([current.estimate], progress=progress)
            tried = {finding.hint for finding in included}
            candidates = [finding for finding in remaining.applicable if finding.hint not in tried]
            for finding in candidates[: MAX_EFFECTS - len(included)]:
                if (trial := model._with_finding(finding)) is None:
                    continue
                if predicts_better(candidate := trial._candidate(progress), current):
                    model, current = trial, candidate
                    included.append(finding)
                    break
            else:
                return model, tuple(included), remaining

    def _candidate(self, progress: ProgressCallback) -> FittedModel:
        return FittedModel(self.evidence, self.estimates(["input-error"], progress=progress)[0])

    def _with_finding(self, finding: Finding) -> Self | None:
        """Add a finding's setting; ``None`` if it conflicts with the configuration."""
        lines = [finding.hint]
        if self.config.tables.mechanism.auto:  # terms are written explicitly
            lines.append('mechanism.terms = "as written"')
        with suppress(BadInput):
            config, given = with_settings(self.config, lines), self.given or None
            return type(self).from_config(config, terms=self.chain.terms, recordings=given)
        return None

    def target(
        self, point: Mapping[str, float] | None = None, choice: NoiseChoice | None = None
    ) -> Target:
        """Log-posterior, in the coordinates that the sampler sees.

        Parameters
        ----------
        point
            Values near the mode, where the output-error likelihood is linearised, and whose
            residuals determine the noise.
        choice
            Result of :meth:`noise_choice` at the point, if available.

        Raises
        ------
        ValueError
            If the point is needed and not given.
        """
        tables, priors = self.config.tables, self.priors
        if tables.likelihood.method == "input-error":
            if point is None and choice is None and self._chooses_noise:
                raise ValueError(
                    "the noise is chosen from the residuals of a point estimate: give one, or use "
                    "white_target() for white noise"
                )
            choice = choice or self.noise_choice(point)
            noise, priors = self.with_noise(choice)
            likelihood: Likelihood = TorqueLikelihood(self.chain, self.observations, noise)
        elif point is None:
            raise ValueError("the output-error likelihood needs a point estimate")
        else:
            trajectories = self.trajectories(0.5)  # s after which its simulation restarts
            with self.config.named():
                likelihood = PositionLikelihood(
                    self.chain, trajectories, self.observations, self.chain.vector(point)
                )
        return target_of(likelihood, priors, tables.noise.scale).with_circular_cut_at(point or {})

    def with_noise(self, choice: NoiseChoice | None) -> tuple[Autoregressive, dict[str, Prior]]:
        """Return the noise of a choice, and priors restricted to its autocorrelation."""
        if choice is None:
            return Autoregressive(), self.priors
        return Autoregressive(choice.order), choice.priors(self.priors)

    def white_target(self) -> Target:
        """Log-posterior of the torque with white noise, independent of the configuration."""
        scale = self.config.tables.noise.scale
        return make_target(self.chain, self.observations, self.priors, scale)

    def noise_choice(self, point: Mapping[str, float] | None) -> NoiseChoice | None:
        """Choose the noise from the torque residuals of a point, if it is not configured."""
        if point is None or not self._chooses_noise:
            return None
        per_recording = self.config.tables.noise.scale == "per-recording"
        return choose_noise(
            self.chain, self.observations, self.priors, point, per_recording=per_recording
        )

    @property
    def _chooses_noise(self) -> bool:
        tables = self.config.tables
        return tables.noise.model == "auto" and tables.likelihood.method == "input-error"


@dataclass(frozen=True)
class StartingPoint:
    """Estimates, noise and log-posterior to start sampling from."""

    estimates: list[Estimate]  # least squares first
    missing: list[str]  # a sentence for each that failed
    choice: NoiseChoice | None  # None if the noise is configured
    target: Target  # the log-posterior

    @property
    def searched(self) -> Estimate:
        """The first estimate with all parameters; there always is one."""
        return next(estimate for estimate in self.estimates if estimate.point)


def starting_point(
    problem: Problem, *, output_error: bool = False, progress: ProgressCallback = no_progress
) -> StartingPoint:
    """Estimate, choose the noise, and make the log-posterior that is sampled.

    The output error is estimated on request, or without a time limit to start its likelihood, for
    reproducibility. A mechanism that cannot be simulated still has a posterior of the torque.
    """
    tables, given = problem.config.tables, problem.evidence
    simulating: list[Method] = ["output-error"]
    direct: list[Method] = ["least-squares", "input-error"]
    estimates = {e.method: e for e in problem.estimates(direct, progress=progress)}
    if tables.likelihood.method in simulating:
        given = replace(given, options=given.options.model_copy(update={"max_seconds": np.inf}))
    elif not (output_error or tables.estimation.output_error):
        simulating = []
    missing = []
    for name in simulating:
        try:
            with problem.config.named():
                estimates |= estimate_by([name], given, estimates, progress=by_method(progress))
        except BadInput as error:
            missing.append(f"no {name} estimate: {error.what}")
    ordered = list(estimates.values())
    points = [dict(e.point) for e in ordered if e.point]
    choice = problem.noise_choice(points[0])
    return StartingPoint(ordered, missing, choice, _first_target(problem, points, choice))


def _first_target(
    problem: Problem, points: Sequence[Mapping[str, float]], choice: NoiseChoice | None
) -> Target:
    """Make the log-posterior, linearised at the first point that can be simulated."""
    for point in points[:-1]:
        with suppress(BadInput):
            return problem.target(point, choice)
    return problem.target(points[-1], choice)
