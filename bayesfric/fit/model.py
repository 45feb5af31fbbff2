"""A joint and its recordings with priors, and the posterior of their parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.base.progress import (
    Progress,
    ProgressCallback,
    by_method,
    no_progress,
    progress_shown,
)
from bayesfric.diagnostics.closed_loop import explain_closed_loop
from bayesfric.diagnostics.explanation import Explanation, explain, too_few_outputs
from bayesfric.diagnostics.regression import Finding
from bayesfric.diagnostics.statistics import MAX_EFFECTS
from bayesfric.estimates import METHODS, Method
from bayesfric.estimates.input_error import contradicted, few_threads
from bayesfric.estimates.methods import (
    EstimationInputs,
    FittedModel,
    estimate_by,
)
from bayesfric.estimates.point_estimate import Estimate, Knowledge
from bayesfric.estimates.trajectory import Trajectory, trajectory
from bayesfric.fit.conclusion import StartingPoint, conclude, refuse_collinear_losses
from bayesfric.fit.saved_draws import flat_draws, read_draws, saved_fit
from bayesfric.identifiability.identification import Identification, identify, speed_term
from bayesfric.identifiability.local import estimate_point, local_information
from bayesfric.inference.closed_loop import ClosedLoopLikelihood
from bayesfric.inference.closed_loop_fit import ClosedLoopMode, closed_loop_mode
from bayesfric.inference.discrepancy import discrepancy
from bayesfric.inference.fitting import Fit, make_target, target_of
from bayesfric.inference.fitting import fit as sample_posterior
from bayesfric.inference.likelihood import LikelihoodMethod, TorqueLikelihood
from bayesfric.inference.noise import Autoregressive, NoiseChoice, choose_noise
from bayesfric.inference.position_likelihood import PositionLikelihood
from bayesfric.inference.posterior import predict_held_out
from bayesfric.inference.priors import Prior, as_knowledge
from bayesfric.inference.sampling import Sampling
from bayesfric.inference.target import Likelihood, Target
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import Term
from bayesfric.problem.config import (
    Config,
    config_of,
    mechanism_table,
    prior_value,
    read_config,
    recording_table,
    saved_name,
    with_settings,
)
from bayesfric.problem.preparation import prepare, references
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.held_out import fitted
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.readers import sha256
from bayesfric.recordings.source import Recording
from bayesfric.report.summary.record import Summary, read_summary_file
from bayesfric.report.summary.summary import estimate_table

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from bayesfric.identifiability.next_recording import Ranking

# Attribute by which the tree that Model.sample returns refers to its Result; copies and trees read
# from a file have none.
RESULT = "_bayesfric_result"


class Model:
    """A joint and its recordings, with priors.

    Parameters
    ----------
    joint
        The mechanism.
    recordings
        One or more.
    noise
        The model of the torque residuals (``"auto"``, ``"white"``), or a ``[noise]`` table.
    priors
        By parameter: a number fixes, a pair is uniform; a frozen distribution of
        :mod:`scipy.stats`, or the text of a configuration.
    tables
        The other tables of a configuration, as dicts of the same keys: ``processing``,
        ``references``, ``estimation``, ``likelihood``, ``sampling``, ``validation``,
        ``self_check``, ``pooling``, ``advice``.
    vary
        Parameters that may differ between recordings, ``{"motor.viscous": "recording"}``: the
        table ``pooling``, for :func:`bayesfric.pool`.

    Attributes
    ----------
    config
        The equivalent configuration.
    chain
        The joint, with the offsets of the recordings.
    recordings, observations
        Those to be fitted, as read and as preprocessed, in the same order.
    encoder
        ``observations`` with the motion of the encoder alone.
    priors
        Of every parameter and noise scale.
    held_out
        Recordings to be predicted and not fitted.
    references
        Values to compare with, by name.

    Raises
    ------
    BadInput
        For anything that cannot be used; it names the key.
    """

    def __init__(
        self,
        joint: Joint,
        recordings: Recording | Sequence[Recording],
        *,
        noise: str | Mapping[str, Any] = "auto",
        priors: Mapping[str, Any] | None = None,
        vary: Mapping[str, str] | None = None,
        **tables: Any,
    ) -> None:
        recordings = [recordings] if isinstance(recordings, Recording) else list(recordings)
        if wrong := [recording for recording in recordings if not isinstance(recording, Recording)]:
            raise BadInput("Model: recordings", f"got {wrong[0]!r}", "give objects of Recording")
        document = {
            "mechanism": mechanism_table(joint),
            "recordings": [recording_table(r, n) for n, r in enumerate(recordings, start=1)],
            "noise": {"model": noise} if isinstance(noise, str) else noise,
            "priors": {name: prior_value(prior) for name, prior in (priors or {}).items()},
            **({} if vary is None else {"pooling": {"vary": dict(vary)}}),
            **tables,
        }
        self._read(config_of(document), recordings, joint.terms)

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
        model = cls.__new__(cls)
        read = config if isinstance(config, Config) else read_config(Path(config))
        model._read(read, recordings, terms)
        return model

    def _read(
        self,
        config: Config,
        recordings: Sequence[Recording] | None = None,
        terms: Sequence[Term] = (),
    ) -> None:
        self.config, self.given = config, recordings or ()
        self._estimates: dict[Method, Estimate] = {}  # cache
        # parameters, by name, near which the mode of a closed loop is searched
        self.near: Mapping[str, float] = {}
        self.chain, self.priors, parts, self.encoder = prepare(config, recordings, terms)
        self.recordings, self.observations = fitted(parts)
        self.held_out = tuple(part for part in parts if part.held_out)
        self.references = references(config, self.chain, self.observations)

    @property
    def method(self) -> LikelihoodMethod:
        """Of the likelihood: a target without a torque leaves no other than the closed loop's."""
        return "closed-loop" if self.chain.closed_loop else self.config.tables.likelihood.method

    def alone(self, k: int) -> Self:
        """Return the same model with recording ``k`` alone."""
        single = copy(self)
        single.recordings, single.observations = [self.recordings[k]], [self.observations[k]]
        single._estimates = {}
        return single

    def estimate(self, *methods: Method) -> pd.DataFrame:
        """Tabulate point estimates, a row for each method and parameter; by default all methods.

        Columns are those of ``estimates`` in ``summary.json``; an unidentified parameter has no
        value, but a ``span`` that fits as well.

        Raises
        ------
        BadInput
            If there is no such method, or one cannot be used with these recordings.
        """
        import pandas as pd

        rows = {
            (estimate.method, name): row
            for estimate in self.estimates(methods)
            for name, row in estimate_table(estimate).as_dict()["parameters"].items()
        }
        frame = pd.DataFrame.from_dict(rows, orient="index")
        frame.index.names = ["method", "name"]
        numbers = ["value", "sd", "sd_robust"]
        open_rows = ~frame["determined"].astype(bool) & frame["at_bound"].isna()
        frame.loc[open_rows, numbers] = np.nan
        first = [*numbers, "unit"]
        frame = frame[[*first, *frame.columns.difference(first, sort=False)]]
        return frame.droplevel("method") if len(methods) == 1 else frame

    def estimates(
        self, methods: Sequence[Method] = (), *, progress: ProgressCallback = no_progress
    ) -> list[Estimate]:
        """Estimate the parameters by one or more methods.

        Parameters
        ----------
        methods
            Which; the output error starts from the input error's result. By default all, without
            the output error where a recording has no position.
        progress
            Progress callback.

        Raises
        ------
        BadInput
            If there is no such method, or one cannot be used with these recordings.
        """
        if not methods:
            simulates = not any(r.integrated for r in self.recordings)
            methods = [name for name in METHODS if simulates or name != "output-error"]
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
        seed = self.config.tables.sampling.seed if seed is None else seed
        if self.method == "closed-loop":
            progress(Progress("what else explains the motion"))
            mode = self.closed_loop_mode
            return explain_closed_loop(mode.target, mode.parameters, seed)
        points = (estimate.point for estimate in estimates if estimate.point)
        point = next(points, None) or self.estimates(["input-error"], progress=progress)[0].point
        progress(Progress("what else explains the torque"))
        return explain(
            self.chain,
            self.recordings,
            self.observations,
            self.config.tables.processing,
            dict(point),
            sorted(self.evidence.knowledge.fixed),
            seed,
        )

    def contradicted(self, start: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Compare priors with an estimate without them, started at a point.

        See :func:`bayesfric.estimates.input_error.contradicted`.
        """
        e = self.evidence
        if self.method == "closed-loop":  # the estimate of a law's torque is biased
            return {}
        return contradicted(e.chain, e.observations, e.knowledge, e.options, start)

    def completed(
        self, *, progress: ProgressCallback = no_progress
    ) -> tuple[Self, tuple[Finding, ...], Explanation]:
        """Add effects that explain the torque, one after the other, until none is left.

        A term is kept if the model with it predicts held-out data better, see
        :class:`bayesfric.estimates.methods.FittedModel`; else it is part of the model discrepancy.
        A delay, which moves other parameters by much, is added only without rivals. A fit does so
        with ``terms = "auto"`` under ``[mechanism]``.

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
            estimates = [current.estimate] if isinstance(current, FittedModel) else []
            remaining = model.explain(estimates, progress=progress)
            tried = {finding.hint for finding in included}
            candidates = [finding for finding in remaining.applicable if finding.hint not in tried]
            for finding in candidates[: MAX_EFFECTS - len(included)]:
                if (trial := model._with_finding(finding)) is None:
                    continue
                candidate = trial._candidate(progress)
                if candidate.predicts_better(current):
                    model, current = trial, candidate
                    included.append(finding)
                    break
            else:
                return model, tuple(included), remaining

    def _candidate(self, progress: ProgressCallback) -> Any:
        """Return what :meth:`completed` compares: an estimate, or the mode of a closed loop."""
        if self.method == "closed-loop":
            return self.closed_loop_mode
        return FittedModel(self.evidence, self.estimates(["input-error"], progress=progress)[0])

    @cached_property
    def closed_loop_mode(self) -> ClosedLoopMode:
        """Mode of the posterior of a closed loop."""
        start, seed = self._start, self.config.tables.sampling.seed
        return closed_loop_mode(start.target, start.estimates, seed, near=self.near)

    def _with_finding(self, finding: Finding) -> Self | None:
        """Add a finding's setting; ``None`` if it conflicts with the configuration."""
        lines = [finding.hint]
        if self.config.tables.mechanism.auto:  # terms are written explicitly
            lines.append('mechanism.terms = "as written"')
        with suppress(BadInput):
            config, given = with_settings(self.config, lines), self.given or None
            trial = type(self).from_config(config, terms=self.chain.terms, recordings=given)
            if self.method == "closed-loop":
                trial.near = self.closed_loop_mode.by_name
            return trial
        return None

    def identify(self) -> pd.DataFrame:
        """Tabulate :meth:`identification`, a row for each parameter."""
        return self.identification().frame

    def identification(self, *, progress: ProgressCallback = no_progress) -> Identification:
        """Find what these recordings can and cannot determine, by the likelihood at an estimate.

        Raises
        ------
        BadInput
            If nothing can be estimated from these recordings.
        """
        target, point = self._at_estimate(progress)
        with self.config.named(), few_threads(self.observations):
            speed = speed_term(target, self.recordings)
            return identify(target, point, speed=speed)

    def advise(self, name: str, *, progress: ProgressCallback = no_progress) -> Ranking:
        """Rank next recordings by the standard deviation they would leave of one quantity.

        Parameters
        ----------
        name
            A free parameter or a derived quantity.
        progress
            Progress callback.

        Returns
        -------
        Ranking
            ``frame`` is its table, the best first.

        Raises
        ------
        BadInput
            If nothing has that name, it is fixed, or nothing can be estimated here.
        """
        target, point = self._at_estimate(progress)
        from bayesfric.identifiability.next_recording import ranking

        with self.config.named(), few_threads(self.observations):
            local = local_information(target, point)
            return ranking(
                target,
                point,
                local,
                self.config.tables.advice,
                name,
                progress=lambda stage: progress(Progress(stage)),
            )

    def _at_estimate(self, progress: ProgressCallback) -> tuple[Target, Array]:
        """Make the target at an estimate by the likelihood's own method.

        Load-dependent friction has its priors there: if the load never drives the motor, an
        estimate by the data alone ends at a gearbox that cannot be back-driven.
        """
        if self.method == "closed-loop":
            progress(Progress("identifiability"))
            mode = self.closed_loop_mode
            return mode.target, mode.parameters
        method, evidence = self.method, self.evidence
        losses = {
            p.name: (prior.mean(), prior.sd())
            for p in self.chain.parameters
            if p.quantity in ("load_drive", "load_back")
            and not (prior := self.priors[p.name]).fixed
        }
        finite = {name: pair for name, pair in losses.items() if np.isfinite(pair).all()}
        knowledge = replace(evidence.knowledge, priors={**finite, **evidence.knowledge.priors})
        evidence = replace(evidence, knowledge=knowledge)
        with self.config.named():
            estimate = estimate_by([method], evidence, progress=by_method(progress))[method]
        progress(Progress("identifiability"))
        point = dict(estimate.point)
        target = self.target(point)
        with self.config.named(), few_threads(self.observations):
            return target, estimate_point(target, point)

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
        if self.method == "closed-loop":
            if point is None:
                raise ValueError("the closed-loop likelihood needs a point estimate")
            likelihood: Likelihood = ClosedLoopLikelihood(
                self.chain, self.recordings, self.observations, self.chain.vector(point)
            )
        elif self.method == "input-error":
            if point is None and choice is None and self._chooses_noise:
                raise ValueError(
                    "the noise is chosen from the residuals of a point estimate: give one, or use "
                    "white_target() for white noise"
                )
            choice = choice or self.noise_choice(point)
            noise, priors = self.with_noise(choice)
            likelihood = TorqueLikelihood(self.chain, self.observations, noise)
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
        return tables.noise.model == "auto" and self.method == "input-error"

    def starting_point(
        self, *, output_error: bool = False, progress: ProgressCallback = no_progress
    ) -> StartingPoint:
        """Estimate, choose the noise, and make the log-posterior that is sampled.

        The output error is estimated on request, or without a time limit to start its likelihood,
        for reproducibility. A mechanism that cannot be simulated still has a posterior of the
        torque, and the log-posterior is linearised at the first estimate that can be simulated.
        """
        tables, evidence = self.config.tables, self.evidence
        direct: list[Method] = ["least-squares", "input-error"]
        estimates = {e.method: e for e in self.estimates(direct, progress=progress)}
        missing = []
        sampled = self.method == "output-error"
        if sampled:
            options = evidence.options.model_copy(update={"max_seconds": np.inf})
            evidence = replace(evidence, options=options)
        if sampled or output_error or tables.estimation.output_error:
            try:
                with self.config.named():
                    estimates |= estimate_by(
                        ["output-error"], evidence, estimates, progress=by_method(progress)
                    )
            except BadInput as error:
                missing.append(f"no output-error estimate: {error.problem}")
        points = [dict(e.point) for e in estimates.values() if e.point]
        choice = self.noise_choice(points[0])
        for point in points[:-1]:
            with suppress(BadInput):
                target = self.target(point, choice)
                break
        else:
            target = self.target(points[-1], choice)
        return StartingPoint([*estimates.values()], missing, choice, target)

    @cached_property
    def _start(self) -> StartingPoint:
        return self.starting_point()

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled parameters in the order of :meth:`log_density`, noise scales last."""
        return self._start.target.names

    def log_density(self, theta: Any) -> Any:
        """Log posterior density, not normalised, for other samplers.

        Parameters
        ----------
        theta
            ``(d,)`` or ``(n, d)`` parameters in SI units in the order of :attr:`names`, or a
            mapping from these names to numbers.

        Returns
        -------
        float or ndarray
            Of each vector; ``-inf`` if it is impossible.
        """
        target = self._start.target
        if isinstance(theta, Mapping):
            if set(theta) != set(target.names):
                raise BadInput("theta", "names other parameters", f"name {', '.join(target.names)}")
            theta = [theta[name] for name in target.names]
        values = np.asarray(theta, dtype=np.float64)
        rows = np.atleast_2d(values)
        if rows.ndim != 2 or rows.shape[1] != len(target.names):
            problem = f"has the shape {values.shape}"
            raise BadInput(
                "theta", problem, f"give {len(target.names)} numbers, as Model.names says"
            )
        density = target.log_prior(rows)
        density[np.isnan(density)] = -np.inf
        if (possible := density > -np.inf).any():
            likelihood = target.log_likelihood(rows[possible])
            density[possible] += np.where(np.isfinite(likelihood), likelihood, -np.inf)
        return density if values.ndim == 2 else float(density[0])

    def fit(
        self,
        *,
        seed: int | None = None,
        output_error: bool = False,
        progress: ProgressCallback = no_progress,
    ) -> Result:
        """Sample the posterior, and summarise it.

        Parameters
        ----------
        seed
            Replaces the configuration's.
        output_error
            Make the output-error estimate, too, as by ``estimation.output_error``.
        progress
            Progress callback.

        Raises
        ------
        BadInput
            For anything that cannot be used.
        """
        if self.config.tables.pooling.vary:
            raise BadInput(
                "pooling.vary",
                "is for 'bayesfric pool': a fit shares all parameters between recordings",
                "run that, or leave the table out",
            )
        # choose the model
        model, included, explained = self, tuple[Finding, ...](), None
        if self.config.tables.mechanism.auto:
            model, included, explained = self.completed(progress=progress)
        config = model.config
        # estimate
        start = model.starting_point(output_error=output_error, progress=progress)
        refuse_collinear_losses(config, model.chain, model.priors, start)
        explained = explained or model.explain(start.estimates, progress=progress)
        # sample
        settings = self.settings(seed)
        with config.named():
            fit = sample_posterior(
                start.target,
                settings,
                estimates=start.estimates,
                closed_loop=model.closed_loop_mode if model.chain.closed_loop else None,
                progress=progress,
            )
        if model.held_out:
            fit = replace(fit, held_out=predict_held_out(fit.target, fit.posterior, model.held_out))
        # examine and conclude
        progress(Progress("model discrepancy"))
        errors = discrepancy(fit.target, fit.posterior, explained.missing)
        fit = replace(fit, discrepancy=errors)
        contradicted = model.contradicted(dict(start.searched.point))
        progress(Progress("identifiability"))
        summary = conclude(
            config,
            model.recordings,
            model.references,
            start,
            fit,
            explained,
            included,
            contradicted,
        )
        return Result(model, summary, config.path.stem, fit.wide.posterior.flat(), fit)

    def settings(self, seed: int | None) -> Sampling:
        """Return the table ``sampling``, with another seed if one is given."""
        sampling = self.config.tables.sampling
        return sampling if seed is None else sampling.model_copy(update={"seed": seed})

    def sample(
        self,
        *,
        seed: int | None = None,
        output_error: bool = False,
        progress: bool | ProgressCallback = False,
    ) -> xr.DataTree:
        """Sample the posterior as ``bayesfric fit`` does.

        Parameters
        ----------
        seed
            Replaces that of the table ``sampling``.
        output_error
            Make the output-error estimate, too.
        progress
            Whether to show a bar, or a progress callback.

        Returns
        -------
        xarray.DataTree
            What ``posterior.nc`` holds, in ArviZ's groups; :func:`bayesfric.summary`,
            :mod:`bayesfric.plot` and :func:`bayesfric.report` take it. Its draws assume the model.
            If the recordings contradict it, the group ``widened`` holds draws that include the
            model discrepancy: use these, whose intervals pages and tables print.
        """
        with progress_shown(progress) as progress_callback:
            return self.fit(seed=seed, output_error=output_error, progress=progress_callback).tree()

    def __repr__(self) -> str:
        lines = [f"{o.name}: {len(o.time)} outputs" for o in self.observations]
        lines += [f"WARNING: {o.name}: {text}" for o in self.observations for text in o.warnings]
        for name, prior in self.priors.items():
            lines.append(f"{name} ~ {prior.text}{' (default)' if prior.default else ''}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A model, the summary of its posterior, and draws that allow for model discrepancy."""

    model: Model
    summary: Summary  # of ``summary.json``; after a fit without the place of recordings
    name: str  # of the run, for messages and captions
    draws: Array  # (n, len(names)) in SI units
    sampled: Fit | None = None  # draws, point estimates and predictions of a fit in this process
    folder: Path | None = None  # run directory that it was read from

    @classmethod
    def read(cls, run: Path) -> Result:
        """Read a run directory.

        Raises
        ------
        BadInput
            If it is not complete, or its recordings cannot be read.
        """
        summary = Summary.read(read_summary_file(run), str(run))
        model = Model.from_config(run / "config.toml")
        groups = read_draws(run, summary)
        free = [name for name in model.chain.names if not model.priors[name].fixed]
        if missing := [name for name in free if name not in summary.parameters]:
            raise BadInput(
                str(run / "config.toml"), f"{missing[0]} was not sampled", "fit the run again"
            )
        draws = groups.get("widened", groups["posterior"])
        return cls(model, summary, run.resolve().name, flat_draws(draws), folder=run)

    def __repr__(self) -> str:
        return str(self.summary)

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled parameters in the order of the draws, noise scales last."""
        return tuple(self.summary.parameters)

    @property
    def joint(self) -> Joint:
        """The joint, with the offsets of its recordings."""
        return self.model.chain

    @property
    def recordings(self) -> list[Measurement]:
        """All recordings, also held-out ones."""
        return [*self.model.recordings, *(part.recording for part in self.model.held_out)]

    def picked(self, max_count: int) -> Array:
        """Return at most so many draws ``(n, len(names))``, evenly spaced."""
        if max_count >= len(self.draws):
            return self.draws
        return np.asarray(self.draws[np.linspace(0, len(self.draws) - 1, max_count).astype(int)])

    def values(self, draws: Array) -> Array:
        """Insert fixed parameters: ``(n, d)`` to ``(n, n_parameters)``."""
        columns = dict(zip(self.names, draws.T, strict=True))
        parameters = [
            columns[name] if name in columns else np.full(len(draws), self.model.priors[name].value)
            for name in self.joint.names
        ]
        return np.stack(parameters, axis=1)

    @cached_property
    def fit(self) -> Fit:
        """The fit; of a run directory made again from draws and recordings, without estimates."""
        if self.sampled is not None:
            return self.sampled
        assert self.folder is not None
        groups = read_draws(self.folder, self.summary)
        # the medians of what was sampled, and what was fixed
        point = {n: p.value for n, p in self.model.priors.items() if p.fixed} | {
            name: float(np.median(x)) for name, x in groups["posterior"].items()
        }
        noise = self.summary.noise
        target = self.model.target(
            {name: point[name] for name in self.joint.names},
            NoiseChoice(noise.order or 0, (), tuple(noise.memory), noise.room),
        )
        if self.model.method == "closed-loop":
            stride = int(self.summary.likelihood.get("stride", 1))
            target = target.at(np.array([point[name] for name in target.names]), stride)
        return saved_fit(target, self.model.held_out, self.summary, groups)

    def tree(self) -> xr.DataTree:
        """Return the contents of ``posterior.nc``."""
        from bayesfric.report.posterior_file import posterior_tree

        text = self.model.config.text
        tree = posterior_tree(self.fit, self.summary, text, self.recordings)
        object.__setattr__(tree, RESULT, self)
        return tree

    def write(
        self,
        folder: Path,
        *,
        draws: int | None = None,
        paper: bool = False,
        progress: ProgressCallback = no_progress,
    ) -> Summary:
        """Write a run directory, and return what its ``summary.json`` holds.

        Nothing is left behind if the folder cannot be written. ``draws`` makes it a light one, see
        :func:`~bayesfric.report.run_directory.write_run`; ``paper`` adds LaTeX, and figures as PDF
        and PNG.
        """
        from bayesfric.report.run_directory import write_run  # brings Matplotlib with it

        config, recordings = self.model.config, self.recordings
        # tables in memory are saved in the run
        files = {
            recording.source.name or f"recording-{n}": (saved_name(n), recording)
            for n, recording in enumerate(self.model.given, start=1)
            if recording.table is not None
        }
        with TemporaryDirectory() as name:
            for k, measured in enumerate(recordings):
                if measured.name in files:
                    file, recording = files[measured.name]
                    saved = Path(name, file)
                    saved.parent.mkdir(exist_ok=True)
                    recording.saved(saved)
                    recordings[k] = replace(measured, path=folder / file, sha256=sha256(saved))
            origin = config.origin_of(recordings, folder if self.model.given else config.folder)
            summary = self.summary.model_copy(update={"source": origin})
            write_run(
                folder,
                self.fit,
                summary,
                config.text,
                recordings,
                Path(name),
                draws,
                paper=paper,
                progress=progress,
            )
        return summary
