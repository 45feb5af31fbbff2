"""A joint and its recordings: estimate, identify, sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.base.progress import (
    Progress,
    ProgressCallback,
    by_method,
    no_progress,
    progress_shown,
)
from bayesfric.estimates import METHODS, Method
from bayesfric.estimates.input_error import few_threads
from bayesfric.estimates.methods import estimate_by
from bayesfric.fit.fit import fit
from bayesfric.fit.pooled_fit import Pooled, pooled
from bayesfric.fit.result import Result
from bayesfric.identifiability.identification import Identification, identify, speed_term
from bayesfric.identifiability.local import estimate_point, local_information
from bayesfric.inference.target import Target
from bayesfric.mechanism.joint import Joint
from bayesfric.problem.config_text import config_of, mechanism_table, prior_value, recording_table
from bayesfric.problem.problem import Problem, StartingPoint, starting_point
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.source import Recording
from bayesfric.report.summary.summary import estimate_table

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from bayesfric.identifiability.next_recording import Ranking


class Model(Problem):
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
        table ``pooling``, for :meth:`pool`.

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
            for estimate in self.estimates(methods or METHODS)
            for name, row in estimate_table(estimate).as_dict()["parameters"].items()
        }
        frame = pd.DataFrame.from_dict(rows, orient="index")
        frame.index.names = ["method", "name"]
        frame.loc[np.isinf(frame["sd"]), ["value", "sd", "sd_robust"]] = np.nan
        first = ["value", "sd", "sd_robust", "unit"]
        frame = frame[[*first, *(name for name in frame.columns if name not in first)]]
        return frame.droplevel("method") if len(methods) == 1 else frame

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
        method, evidence = self.config.tables.likelihood.method, self.evidence
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

    @cached_property
    def _start(self) -> StartingPoint:
        return starting_point(self)

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
            what = f"has the shape {values.shape}"
            raise BadInput("theta", what, f"give {len(target.names)} numbers, as Model.names says")
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
        sampling = self.config.tables.sampling
        if seed is not None:
            sampling = sampling.model_copy(update={"seed": seed})
        return fit(self, sampling, output_error=output_error, progress=progress)

    def pool(self, *, seed: int | None = None, progress: ProgressCallback = no_progress) -> Pooled:
        """Fit recordings together of which some parameters differ.

        ``vary``, or the table ``pooling``, names these parameters; ``seed`` replaces that of the
        table ``sampling``.

        Raises
        ------
        BadInput
            If no parameter is named, or recordings are too few, or too many for one posterior.
        """
        auto = self.config.tables.mechanism.auto
        model = self.completed(progress=progress)[0] if auto else self
        return pooled(model, seed, progress)

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
