"""A joint and what was measured of it: every question that can be asked of the two."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from bayesfric.diagnostics.explanation import Explanation, explain, unasked
from bayesfric.diagnostics.finding import Finding
from bayesfric.diagnostics.policy import MOST
from bayesfric.errors import BadInput, nearest
from bayesfric.estimates.descent import few_threads
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.methods import Given, estimate_by
from bayesfric.estimates.point_estimate import METHODS, Estimate, Method
from bayesfric.identifiability.identification import Identification, identify
from bayesfric.identifiability.known_quantities import speed_term
from bayesfric.identifiability.local import local_information
from bayesfric.identifiability.next_recording import Ranking, ranking
from bayesfric.identifiability.plausible import estimate_point, points_around
from bayesfric.inference.fitting import make_target, target_of
from bayesfric.inference.likelihood.likelihood import Likelihood
from bayesfric.inference.likelihood.noise_choice import Choice, choice_at
from bayesfric.inference.likelihood.position_likelihood import PositionLikelihood
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.noise import NOISE_MODELS
from bayesfric.inference.prior.as_knowledge import as_knowledge
from bayesfric.inference.sampling.checkpoint import Checkpoint
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.inference.target import Target
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import Term
from bayesfric.notebook import html_table
from bayesfric.problem.config import Config, read_config
from bayesfric.problem.config_text import (
    config_of,
    mechanism_table,
    prior_value,
    recording_table,
    with_settings,
    with_terms,
)
from bayesfric.problem.preparation import prepare, residual_noise
from bayesfric.progress import Progress, Shown, by_method, progress_shown, silent
from bayesfric.recordings.recording import Recording
from bayesfric.recordings.trajectory import Trajectory, trajectory
from bayesfric.report.summary.summary import estimate_summary

if TYPE_CHECKING:
    import pandas as pd

    from bayesfric.pooled_fit import Pooled
    from bayesfric.result import Result
    from bayesfric.whole_fit import Beginning

Array = NDArray[np.float64]


def _first_point(estimates: Sequence[Estimate]) -> dict[str, float] | None:
    return next((dict(one.point) for one in estimates if one.point), None)


# Points besides the estimate that recordings to make next are simulated at.
_AROUND = 6


class Model:
    """A joint and its recordings, with what is believed beforehand.

    Parameters
    ----------
    joint
        The mechanism.
    recordings
        One or more.
    noise
        The model of the torque residuals (``"auto"``, ``"white"``, ``"autoregressive"``,
        ``"student-t"``), or a whole ``[noise]`` table.
    priors
        By parameter: a number fixes, a pair is uniform; a frozen distribution of
        :mod:`scipy.stats`, or the text of a configuration.
    tables
        The other tables of a configuration, as dicts of the same keys: ``processing``,
        ``references``, ``estimation``, ``likelihood``, ``sampling``, ``validation``,
        ``self_check``, ``pooling``, ``advice``.
    vary
        Parameters that may differ between recordings, ``{"motor.viscous": "recording"}``: the
        table ``pooling``, for :meth:`pool`.

    Attributes
    ----------
    config
        The configuration that says the same.
    chain
        The mechanism, with the offsets of the recordings.
    recordings, observations
        Those to be fitted, as read and as prepared, in the same order.
    encoder
        The same as ``observations`` with the motion that their encoders tell.
    priors
        Of every parameter and noise scale.
    held_out
        What is to be predicted and not fitted.

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
        if wrong := [one for one in recordings if not isinstance(one, Recording)]:
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
        """Read what a configuration names; a finished run's ``config.toml`` is one.

        Terms of one's own are functions, which no file holds: where it names some, give them.
        ``recordings`` stand for those that it names, where not all are in files.
        """
        model = cls.__new__(cls)
        read = config if isinstance(config, Config) else read_config(Path(config))
        model._read(read, recordings, terms)
        return model

    def with_term(self, term: Term) -> Self:
        """Give the same model with one more term of one's own; nothing is read from its result.

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
        found = prepare(config, recordings, terms)
        self.chain, self.priors, self.held_out = found.chain, found.priors, found.held_out
        self.recordings, self.observations = found.recordings, found.observations
        self.encoder = found.encoder
        self.references()  # refuses what they cannot be of

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

    # What a point estimate says

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
            found = estimate_by(methods, self.evidence, progress=by_method(progress))
        return list(found.values())

    @property
    def evidence(self) -> Given:
        """What point estimates are made from."""
        return Given(
            self.chain,
            self.observations,
            as_knowledge(self.chain, self.priors),
            self.config.tables.estimation,
            self.trajectories,
        )

    def estimate(self, *methods: Method) -> pd.DataFrame:
        """Tabulate what :meth:`estimates` finds, a row for each method and number.

        Without names it is all methods. Columns are those of ``estimates`` in ``summary.json``;
        what these recordings do not determine has no value, but a ``span`` that fits as well.

        Raises
        ------
        BadInput
            If there is no such method, or one cannot be used with these recordings.
        """
        import pandas as pd

        rows = {
            (one.method, name): row
            for one in self.estimates(methods or METHODS)
            for name, row in estimate_summary(one)["parameters"].items()
        }
        frame = pd.DataFrame.from_dict(rows, orient="index")
        frame.index.names = ["method", "name"]
        frame.loc[~frame["determined"], ["value", "sd", "sd_robust"]] = np.nan
        first = ["value", "sd", "sd_robust", "unit"]
        frame = frame[[*first, *(name for name in frame.columns if name not in first)]]
        return frame.droplevel("method") if len(methods) == 1 else frame

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
        """Ask what else explains the torque, judged by simulated twins of these recordings.

        It begins at the first of the ``estimates`` that has all parameters, or at one of the input
        error; ``seed`` replaces that of the table ``sampling``.

        Raises
        ------
        BadInput
            If nothing can be estimated from these recordings.
        """
        if reason := unasked(self.chain, self.recordings, self.observations):
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
        return _first_point(estimates) or dict(
            self.estimates(["input-error"], progress=progress)[0].point
        )

    def completed(
        self, *, progress: Shown = silent
    ) -> tuple[Self, tuple[Finding, ...], Explanation]:
        """Put in what else explains the torque, one term after the other, until nothing is left.

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
        while True:
            left = model.explain(progress=progress)
            tried = {"", *(one.hint for one in taken)}
            wanted = [one for one in left.findings if one.hint not in tried]
            better = next(filter(None, map(model._with, wanted[: MOST - len(taken)])), None)
            if better is None:
                return model, tuple(taken), left
            one, model = better
            taken.append(one)

    def _with(self, one: Finding) -> tuple[Finding, Self] | None:
        """Put in a finding; nothing where the configuration names what it would replace."""
        lines = [one.hint]
        if self.config.tables.mechanism.auto:  # what was found is written now
            lines.append('mechanism.terms = "as written"')
        with suppress(BadInput):
            config, given = with_settings(self.config, lines), self.given or None
            return one, type(self).from_config(config, terms=self.chain.terms, recordings=given)
        return None

    # What can be known

    def identify(self) -> pd.DataFrame:
        """Tabulate what :meth:`identification` finds, a row for each parameter."""
        return self.identification().frame

    def identification(self, *, progress: Shown = silent) -> Identification:
        """Tell what these recordings can and cannot determine, before anything is sampled.

        The likelihood is looked at where an estimate is.

        Raises
        ------
        BadInput
            If nothing can be estimated from these recordings.
        """
        target, point = self._at_estimate(progress)
        with self.config.named(), few_threads(self.observations):
            speed = speed_term(target, point, self.recordings)
            return identify(target, point, speed=speed)

    def advise(self, name: str, *, progress: Shown = silent) -> Ranking:
        """Rank recordings to make next by what they would leave of one quantity.

        Parameters
        ----------
        name
            A free parameter or a derived quantity.
        progress
            Called as work goes on.

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
        with self.config.named(), few_threads(self.observations):
            local = local_information(target, point)
            rng = self._stream(5)
            others = points_around(target, point, local, rng, around=_AROUND)
            options = self.config.tables.advice
            points = [point, *others]
            return ranking(
                target,
                points,
                local,
                options,
                name,
                progress=lambda stage: progress(Progress(stage)),
            )

    def _stream(self, key: int) -> np.random.Generator:
        """Random numbers of one analysis: the seed of the whole, in a stream of its own."""
        seed = self.config.tables.sampling.seed
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(key,)))

    def _at_estimate(self, progress: Shown) -> tuple[Target, Array]:
        """Look at the likelihood at an estimate by the method that it belongs to.

        Load losses are held by their priors there. Where the load never drives the motor,
        nothing but noise says what is lost when it does, and an estimate by the data alone ends
        in a corner: a gearbox that cannot be driven back at all. What the data do tell outweighs
        these priors by far.
        """
        method, given = self.config.tables.likelihood.method, self.evidence
        losses = {
            p.name: (prior.mean(), prior.sd())
            for p in self.chain.parameters
            if p.quantity in ("load_drive", "load_back")
            and not (prior := self.priors[p.name]).fixed
        }
        finite = {name: pair for name, pair in losses.items() if np.isfinite(pair).all()}
        knowledge = replace(given.knowledge, told={**finite, **given.knowledge.told})
        given = replace(given, knowledge=knowledge)
        with self.config.named():
            found = estimate_by([method], given, progress=by_method(progress))[method]
        progress(Progress("identifiability"))
        place = dict(found.point)
        target = self.target(place)
        with self.config.named(), few_threads(self.observations):
            return target, estimate_point(target, place)

    # What is believed of it

    def target(
        self, point: Mapping[str, float] | None = None, choice: Choice | None = None
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
        tables = self.config.tables
        if tables.likelihood.method == "input-error":
            if point is None and choice is None and self._chooses_noise:
                raise ValueError(
                    "which noise there is, the residuals of a point estimate say: give one, or "
                    "take white_target() for white noise"
                )
            choice = choice or self.noise_choice(point)
            noise = residual_noise(tables.noise, choice.order if choice else 0)
            likelihood: Likelihood = TorqueLikelihood(self.chain, self.observations, noise)
        elif point is None:
            raise ValueError("the output-error likelihood needs a point estimate")
        else:
            whole = self.trajectories(tables.likelihood.segment)
            with self.config.named():
                likelihood = PositionLikelihood(
                    self.chain, whole, self.observations, self.chain.vector(point)
                )
        return target_of(likelihood, self.priors, tables.noise.scale).uncut_at(point or {})

    def white_target(self) -> Target:
        """Log-posterior of the torque with white noise, whatever the configuration asks for."""
        scale = self.config.tables.noise.scale
        return make_target(self.chain, self.observations, self.priors, scale)

    def noise_choice(self, point: Mapping[str, float] | None) -> Choice | None:
        """Choose the noise that the torque residuals of a point ask for, if it is not told."""
        if point is None or not self._chooses_noise:
            return None
        apart = self.config.tables.noise.scale == "per-recording"
        return choice_at(self.chain, self.observations, self.priors, point, per_recording=apart)

    @property
    def _chooses_noise(self) -> bool:
        tables = self.config.tables
        wanted = NOISE_MODELS[tables.noise.model].chooses(tables.noise.order)
        return wanted and tables.likelihood.method == "input-error"

    @cached_property
    def _begun(self) -> Beginning:
        from bayesfric.whole_fit import begin  # asks the model

        return begin(self)

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled parameters in the order of :meth:`log_density`, noise scales last."""
        return self._begun.target.names

    def log_density(self, theta: Any) -> Any:
        """Log of the posterior density, not normalised, for any other sampler.

        Parameters
        ----------
        theta
            ``(d,)`` or ``(n, d)`` parameters in SI units in the order of :attr:`names`, or a
            mapping from these names to numbers.

        Returns
        -------
        float or ndarray
            One number for each vector; ``-inf`` where it is impossible.
        """
        target = self._begun.target
        if isinstance(theta, Mapping):
            if set(theta) != set(target.names):
                raise BadInput("theta", "names other parameters", f"name {', '.join(target.names)}")
            theta = [theta[name] for name in target.names]
        values = np.asarray(theta, dtype=np.float64)
        rows = np.atleast_2d(values)
        if rows.ndim != 2 or rows.shape[1] != len(target.names):
            what = f"has the shape {values.shape}"
            raise BadInput("theta", what, f"give {len(target.names)} numbers, as Model.names says")
        density = target.log_prior(rows)
        density[np.isnan(density)] = -np.inf
        if (possible := density > -np.inf).any():
            likely = target.log_likelihood(rows[possible])
            density[possible] += np.where(np.isfinite(likely), likely, -np.inf)
        return density if values.ndim == 2 else float(density[0])

    def fit(
        self,
        *,
        seed: int | None = None,
        output_error: bool = False,
        progress: Shown = silent,
        checkpoint: Callable[[str, Sampling], Checkpoint | None] = lambda *_: None,
    ) -> Result:
        """Sample the posterior, and sum it up.

        Parameters
        ----------
        seed
            Replaces the configuration's.
        output_error
            Make the output-error estimate too, as ``estimation.output_error`` asks for it.
        progress
            Called as work goes on.
        checkpoint
            Gives each sampling, by its name and settings, a place to keep its steps.

        Raises
        ------
        BadInput
            For anything that cannot be used.
        """
        from bayesfric.whole_fit import whole_fit

        sampling = self.config.tables.sampling
        if seed is not None:
            sampling = sampling.model_copy(update={"seed": seed})
        return whole_fit(
            self,
            sampling,
            output_error=output_error,
            progress=progress,
            checkpoint=checkpoint,
        )

    def pool(self, *, seed: int | None = None, progress: Shown = silent) -> Pooled:
        """Say what recordings of which some parameters differ tell together.

        ``vary``, or the table ``pooling``, names these parameters; ``seed`` replaces that of the
        table ``sampling``.

        Raises
        ------
        BadInput
            If no parameter is named, or recordings are too few, or too many for one posterior.
        """
        from bayesfric.pooled_fit import pooled  # asks the model

        auto = self.config.tables.mechanism.auto
        model = self.completed(progress=progress)[0] if auto else self
        return pooled(model, seed, progress)

    def sample(
        self,
        *,
        seed: int | None = None,
        output_error: bool = False,
        progress: bool | Shown = False,
    ) -> Any:
        """Sample the posterior as ``bayesfric fit`` does.

        Parameters
        ----------
        seed
            Replaces that of the table ``sampling``.
        output_error
            Make the output-error estimate too.
        progress
            Whether to show a bar, or what to call as work goes on.

        Returns
        -------
        InferenceData or DataTree
            What ``posterior.nc`` holds; :func:`bayesfric.summary`, :mod:`bayesfric.plot` and
            :func:`bayesfric.report` take it. Its draws take the model for right. Where the
            recordings show that it is not, the group ``told`` holds draws with room for that:
            those to go on with, whose intervals pages and tables print.
        """
        with progress_shown(progress) as tell:
            found = self.fit(seed=seed, output_error=output_error, progress=tell)
            return found.inference_data()

    def _repr_html_(self) -> str:
        seen = ", ".join(f"{escape(o.name)}: {len(o.time)} outputs" for o in self.observations)
        told = [f"{o.name}: {text}" for o in self.observations for text in o.warnings]
        rows = ((n, p.text, "default" if p.default else "given") for n, p in self.priors.items())
        warned = "".join(f"<p>WARNING: {escape(text)}</p>" for text in told)
        return f"<p>{seen}</p>{warned}{html_table(rows, ('parameter', 'prior', ''))}"
