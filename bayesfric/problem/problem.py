"""A joint, what was measured of it and what is believed beforehand: all that is asked about."""

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
from bayesfric.base.progress import Progress, Shown, by_method, silent
from bayesfric.diagnostics.explanation import Explanation, explain, too_few_outputs
from bayesfric.diagnostics.finding import Finding
from bayesfric.diagnostics.policy import MAX_EFFECTS
from bayesfric.estimates.input_error import contradicted
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.larger_model import Candidate, better
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.methods import ESTIMATORS, Given, estimate_by
from bayesfric.estimates.point_estimate import METHODS, Estimate, Method
from bayesfric.inference.fitting import make_target, target_of
from bayesfric.inference.likelihood.likelihood import Likelihood
from bayesfric.inference.likelihood.noise_choice import NoiseChoice, choose_noise
from bayesfric.inference.likelihood.position_likelihood import PositionLikelihood
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.noise.autoregressive import Autoregressive
from bayesfric.inference.prior.priors import Prior, as_knowledge
from bayesfric.inference.target import Target
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.own_term import Term
from bayesfric.problem.config import Config, read_config
from bayesfric.problem.config_text import with_settings, with_terms
from bayesfric.problem.preparation import prepare
from bayesfric.recordings.recording import Recording
from bayesfric.recordings.trajectory import Trajectory, trajectory

# Seconds after which the simulation of the output-error likelihood starts anew.
_SEGMENT = 0.5


class Problem:
    """What a configuration asks of recordings; :class:`bayesfric.Model` has its attributes."""

    @classmethod
    def from_config(
        cls,
        config: Config | Path | str,
        *,
        terms: Sequence[Term] = (),
        recordings: Sequence[Recording] | None = None,
    ) -> Self:
        """Read what a configuration names; a finished run's ``config.toml`` is one.

        Terms of one's own are functions, which no file holds: where it names some, give them.
        ``recordings`` stand for those that it names, where not all are in files.
        """
        problem = cls.__new__(cls)
        read = config if isinstance(config, Config) else read_config(Path(config))
        problem._read(read, recordings, terms)
        return problem

    def with_term(self, term: Term) -> Self:
        """Give the same with one more term of one's own; nothing is read from its result.

        It goes through estimates, identification, sampling and report like any other.

        Raises
        ------
        BadInput
            If the joint has no such element.
        """
        kept = [one for one in self.chain.terms if one.name != term.name]
        terms = [*kept, term]
        named = with_terms(self.config, [one.name for one in terms])
        return type(self).from_config(named, terms=terms, recordings=self.given or None)

    def _read(
        self,
        config: Config,
        recordings: Sequence[Recording] | None = None,
        terms: Sequence[Term] = (),
    ) -> None:
        self.config, self.given = config, recordings or ()
        self._estimates: dict[Method, Estimate] = {}  # those that were made
        found = prepare(config, recordings, terms)
        self.chain, self.priors, self.held_out = found.chain, found.priors, found.held_out
        self.recordings, self.observations = found.recordings, found.observations
        self.encoder = found.encoder
        self.references()  # refuses what they cannot be of

    def alone(self, k: int) -> Self:
        """Give the same with its recording ``k`` alone."""
        one = copy(self)
        one.recordings, one.observations = [self.recordings[k]], [self.observations[k]]
        one._estimates = {}
        return one

    def references(self) -> dict[str, dict[str, Any]]:
        """Values to compare with, by name of what they are of.

        Raises
        ------
        BadInput
            If one is of something that no result of this mechanism is.
        """
        units = {p.name: p.unit for p in self.chain.parameters}
        middle = np.ones((1, len(self.chain.names)))
        units |= {q.name: q.unit for q in derive(self.chain, middle, 1.0)}
        projection = TotalsProjection(self.chain, self.observations)
        for name, label in zip(projection.names, projection.labels, strict=True):
            units[label] = projection.describe(name)[0]
        found, aliases = {}, projection.aliases()
        for told, reference in self.config.references.items():
            name = told if told in units else aliases.get(told, told)
            if name not in units or (name != told and name in self.config.references):
                raise BadInput(
                    f"{self.config.path}: references.{told}",
                    "no result of this mechanism has that name",
                    nearest(told, units),
                )
            found[name] = {**reference.model_dump(), "unit": units[name]}
        return found

    def estimates(
        self, methods: Sequence[Method] = METHODS, *, progress: Shown = silent
    ) -> list[Estimate]:
        """Estimate the parameters by one or more of the paper's methods.

        Parameters
        ----------
        methods
            Which; the output error starts from the input error's result.
        progress
            Called before each method begins.

        Raises
        ------
        BadInput
            If there is no such method, or one cannot be used with these recordings.
        """
        with self.config.named():
            shown = by_method(progress)
            found = estimate_by(methods, self.evidence, self._estimates, progress=shown)
        self._estimates |= found
        return list(found.values())

    @cached_property
    def _knowledge(self) -> Knowledge:
        """What priors say to a point estimate; the moments of some take seconds."""
        return as_knowledge(self.chain, self.priors)

    @property
    def evidence(self) -> Given:
        """What point estimates are made from."""
        return Given(
            self.chain,
            self.observations,
            self._knowledge,
            self.config.tables.estimation,
            self.trajectories,
        )

    def trajectories(self, segment: float = np.inf) -> list[Trajectory]:
        """Fitted recordings as a simulation follows them, starting anew every ``segment`` s."""
        pairs = zip(self.recordings, self.observations, strict=True)
        return [trajectory(recording, observation, segment) for recording, observation in pairs]

    def explain(
        self,
        estimates: Sequence[Estimate] = (),
        *,
        seed: int | None = None,
        progress: Shown = silent,
    ) -> Explanation:
        """Ask what else explains the torque, judged by simulated replicates of these recordings.

        It begins at the first of the ``estimates`` that has all parameters, or at one of the input
        error; ``seed`` replaces that of the table ``sampling``.

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

    def _point(self, estimates: Sequence[Estimate], progress: Shown) -> dict[str, float]:
        """Give the first of the estimates that has all parameters, or one of the input error."""
        found = next((dict(one.point) for one in estimates if one.point), None)
        return found or dict(self.estimates(["input-error"], progress=progress)[0].point)

    def contradicted(self, start: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Compare priors with an estimate without them, which begins at a point.

        See :func:`bayesfric.estimates.input_error.contradicted`.
        """
        e = self.evidence
        return contradicted(e.chain, e.observations, e.knowledge, e.options, start)

    def completed(
        self, *, progress: Shown = silent
    ) -> tuple[Self, tuple[Finding, ...], Explanation]:
        """Put in what else explains the torque, one term after the other, until nothing is left.

        A term stays where the model with it tells more of what it has not seen, see
        :func:`bayesfric.estimates.larger_model.better`; else there is room for it. A delay changes
        other parameters by much, and goes in only where no other kind explains as much.

        That is what a fit does where ``terms = "auto"`` under ``[mechanism]``.

        Returns
        -------
        model
            With all that was put in; its ``config`` says so.
        taken
            What was put in, in the order of the ranking.
        left
            What else explains the torque of that model, and no key puts in.

        Raises
        ------
        BadInput
            If nothing can be estimated from these recordings.
        """
        model, taken = self, list[Finding]()
        if too_few_outputs(self.chain, self.observations):
            return self, (), self.explain()
        found = self._candidate(progress)
        while True:
            left = model.explain([found.estimate], progress=progress)
            tried = {one.hint for one in taken}
            wanted = [one for one in left.applicable if one.hint not in tried]
            for one in wanted[: MAX_EFFECTS - len(taken)]:
                if (trial := model._with(one)) is None:
                    continue
                if better(made := trial._candidate(progress), found):
                    model, found = trial, made
                    taken.append(one)
                    break
            else:
                return model, tuple(taken), left

    def _candidate(self, progress: Shown) -> Candidate:
        return Candidate(self.evidence, self.estimates(["input-error"], progress=progress)[0])

    def _with(self, one: Finding) -> Self | None:
        """Put in a finding; nothing where the configuration names what it would replace."""
        lines = [one.hint]
        if self.config.tables.mechanism.auto:  # what was found is written now
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
            Values near the mode, where the output-error likelihood takes its derivatives,
            and whose residuals say which noise there is.
        choice
            What :meth:`noise_choice` gives at the point, where it was asked already.

        Raises
        ------
        ValueError
            Where there is something to take or to choose at the point, and none is given.
        """
        tables, priors = self.config.tables, self.priors
        if tables.likelihood.method == "input-error":
            if point is None and choice is None and self._chooses_noise:
                raise ValueError(
                    "which noise there is, the residuals of a point estimate say: give one, or "
                    "take white_target() for white noise"
                )
            choice = choice or self.noise_choice(point)
            noise, priors = self.with_noise(choice)
            likelihood: Likelihood = TorqueLikelihood(self.chain, self.observations, noise)
        elif point is None:
            raise ValueError("the output-error likelihood needs a point estimate")
        else:
            whole = self.trajectories(_SEGMENT)
            with self.config.named():
                likelihood = PositionLikelihood(
                    self.chain, whole, self.observations, self.chain.vector(point)
                )
        return target_of(likelihood, priors, tables.noise.scale).with_circular_cut_at(point or {})

    def with_noise(self, choice: NoiseChoice | None) -> tuple[Autoregressive, dict[str, Prior]]:
        """Give the torque's noise of a choice, and priors in which it remembers as that says."""
        if choice is None:
            return Autoregressive(), self.priors
        return Autoregressive(choice.order), choice.priors(self.priors)

    def white_target(self) -> Target:
        """Log-posterior of the torque with white noise, whatever the configuration asks for."""
        scale = self.config.tables.noise.scale
        return make_target(self.chain, self.observations, self.priors, scale)

    def noise_choice(self, point: Mapping[str, float] | None) -> NoiseChoice | None:
        """Choose the noise that the torque residuals of a point ask for, if it is not told."""
        if point is None or not self._chooses_noise:
            return None
        apart = self.config.tables.noise.scale == "per-recording"
        return choose_noise(self.chain, self.observations, self.priors, point, per_recording=apart)

    @property
    def _chooses_noise(self) -> bool:
        tables = self.config.tables
        return tables.noise.model == "auto" and tables.likelihood.method == "input-error"


@dataclass(frozen=True)
class StartingPoint:
    """What sampling starts from."""

    estimates: list[Estimate]  # least squares first
    missing: list[str]  # a sentence for each that was wanted and cannot be had
    choice: NoiseChoice | None  # how the order of the noise was chosen, where it was
    target: Target  # the log-posterior

    @property
    def searched(self) -> Estimate:
        """The first estimate that tells every parameter; there always is one."""
        return next(one for one in self.estimates if one.point)


def starting_point(
    problem: Problem, *, output_error: bool = False, progress: Shown = silent
) -> StartingPoint:
    """Estimate, choose the noise, and make the log-posterior that is sampled.

    The output error simulates. It is asked for, or its likelihood needs a place to start
    from: then however long it takes, as sampling that goes on later must start from the
    same place. A mechanism that cannot be simulated still has a posterior of the torque.
    """
    tables, given = problem.config.tables, problem.evidence
    simulating = [one.name for one in ESTIMATORS.values() if one.simulates]
    plain = [name for name in ESTIMATORS if name not in simulating]
    made = {e.method: e for e in problem.estimates(plain, progress=progress)}
    if tables.likelihood.method in simulating:
        given = replace(given, options=given.options.model_copy(update={"max_seconds": np.inf}))
    elif not (output_error or tables.estimation.output_error):
        simulating = []
    missing = []
    for name in simulating:
        try:
            with problem.config.named():
                made |= estimate_by([name], given, made, progress=by_method(progress))
        except BadInput as error:
            missing.append(f"no {name} estimate: {error.what}")
    found = list(made.values())
    points = [dict(e.point) for e in found if e.point]
    choice = problem.noise_choice(points[0])
    return StartingPoint(found, missing, choice, _first_target(problem, points, choice))


def _first_target(
    problem: Problem, points: Sequence[Mapping[str, float]], choice: NoiseChoice | None
) -> Target:
    """Make the log-posterior; where it simulates, near the first point that can be simulated.

    The simulation is linearised there first, and anew at every mode this leads to.
    """
    for point in points[:-1]:
        with suppress(BadInput):
            return problem.target(point, choice)
    return problem.target(points[-1], choice)
