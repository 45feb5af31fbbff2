"""From a configuration to everything a fit needs, read and checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.config import Config, NoiseOptions, Origin
from bayesfric.errors import BadInput, nearest
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.methods import Given
from bayesfric.estimates.torque import filtered_torque, torque_jacobian
from bayesfric.inference.fit import make_target, read_priors, target_of
from bayesfric.inference.likelihood.noise_choice import Choice, choose_order
from bayesfric.inference.likelihood.position_likelihood import PositionLikelihood
from bayesfric.inference.moments.residual_moments import follows
from bayesfric.inference.noise import NOISE_MODELS
from bayesfric.inference.noise.autoregressive import MOST
from bayesfric.inference.noise.residual_noise import ResidualNoise
from bayesfric.inference.prior.as_knowledge import as_knowledge
from bayesfric.inference.prior.priors import Prior
from bayesfric.inference.target import Target
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.derived import derive
from bayesfric.recordings.held_out import HeldOut, divide
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.options import Source
from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.recording import Recording
from bayesfric.recordings.trajectory import Trajectory, trajectory


@dataclass(frozen=True)
class Problem:
    """A configuration, read.

    Attributes
    ----------
    config
        The configuration.
    chain
        The mechanism it describes.
    recordings, observations
        Those to be fitted, as read and as prepared, in the same order.
    priors
        Of every parameter and noise scale.
    held_out
        What is to be predicted and not fitted.
    """

    config: Config
    chain: Chain
    recordings: list[Recording]
    observations: list[Observation]
    priors: dict[str, Prior]
    held_out: tuple[HeldOut, ...] = ()

    def target(
        self, point: Mapping[str, float] | None = None, choice: Choice | None = None
    ) -> Target:
        """Log-posterior of the problem.

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
            target = make_target(
                self.chain,
                self.observations,
                self.priors,
                tables.noise.scale,
                self._noise(choice or self.noise_choice(point)),
            )
            return target.uncut_at(point or {})
        if point is None:
            raise ValueError("the output-error likelihood needs a point estimate")
        with self.config.named():
            likelihood = PositionLikelihood(
                self.chain,
                self.trajectories(tables.likelihood.segment),
                self.observations,
                self.chain.vector(point),
            )
        return target_of(likelihood, self.priors, tables.noise.scale).uncut_at(point)

    def white_target(self) -> Target:
        """Log-posterior of the torque with white noise, whatever the configuration asks for."""
        scale = self.config.tables.noise.scale
        return make_target(self.chain, self.observations, self.priors, scale)

    def noise_choice(self, point: Mapping[str, float] | None) -> Choice | None:
        """Choose the noise that the torque residuals of a point ask for, if it is not told."""
        noise = self.config.tables.noise
        if point is None or not self._chooses_noise:
            return None
        values = self.chain.vector(point)[None]
        residuals = [
            o.measured - filtered_torque(self.chain, o, values)[0] for o in self.observations
        ]
        runs = [follows(o) for o in self.observations]
        effects = torque_jacobian(self.chain, self.observations, values[0], self._steps(values[0]))
        ends = np.cumsum([r.size for r in residuals])[:-1]
        return choose_order(
            residuals,
            runs,
            noise.scale == "per-recording",
            effects=np.split(effects * self._sds(), ends),
        )

    def _sds(self) -> NDArray[np.float64]:
        """Prior sds of the chain's parameters, 0 of fixed ones; 1 of those without any."""
        sds = np.array([self.priors[name].sd() for name in self.chain.names])
        return np.where(np.isfinite(sds), sds, 1.0)

    def _steps(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Give steps of differences by the chain's free parameters."""
        sds = self._sds()
        return np.where(sds > 0.0, 1e-6 * np.maximum(np.abs(values), 1e-3 * sds), 0.0)

    @property
    def _chooses_noise(self) -> bool:
        tables = self.config.tables
        wanted = NOISE_MODELS[tables.noise.model].chooses(tables.noise.order)
        return wanted and tables.likelihood.method == "input-error"

    def _noise(self, choice: Choice | None) -> ResidualNoise:
        return _residual_noise(self.config.tables.noise, choice.order if choice else 0)

    def trajectories(self, segment: float = np.inf) -> list[Trajectory]:
        """Make what a simulation needs of the recordings, cut after ``segment`` seconds."""
        return [
            trajectory(r, o, segment)
            for r, o in zip(self.recordings, self.observations, strict=True)
        ]

    def given(self) -> Given:
        """Put together what point estimates are made from."""
        return Given(
            self.chain,
            self.observations,
            as_knowledge(self.chain, self.priors),
            self.config.tables.estimation,
            self.trajectories,
        )

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
        found = {}
        for name, reference in self.config.references.items():
            if name not in units:
                raise BadInput(
                    f"{self.config.path}: references.{name}",
                    "no result of this mechanism has that name",
                    nearest(name, units),
                )
            found[name] = {**reference.model_dump(), "unit": units[name]}
        return found


def read_problem(config: Config) -> Problem:
    """Read every recording of a configuration and prepare it.

    Raises
    ------
    BadInput
        For anything that cannot be used.
    """
    tables = config.tables
    with config.named():
        chain = tables.mechanism.chain()
    if not tables.recordings:
        raise BadInput(str(config.path), "names no recording", "add a [[recordings]] table")
    if not chain.parameters:
        raise BadInput(
            f"{config.path}: mechanism", "has no parameter", "give an element inertia or friction"
        )
    recordings: list[Recording] = []
    folder = config.folder
    for number, source in enumerate(tables.recordings, start=1):
        recordings += _read(config, folder, chain, source, number)
    if config.origin is not None:
        recordings = [_changed_since(r, config.origin) for r in recordings]
    for name, count in Counter(r.name for r in recordings).items():
        if count > 1:
            raise BadInput(
                f"{config.path}: recordings",
                f"{count} are called {name!r}",
                "give each a name of its own with name = ...",
            )
        # posterior.nc names arrays after recordings, beside those named after parameters
        if "/" in name or name in {*chain.names, "chain", "draw", "lp", "ensemble"}:
            raise BadInput(
                f"{config.path}: recordings",
                f"a recording cannot be called {name!r}",
                "give it another name with name = ...",
            )
    _check_validation(config)
    with config.named():
        divided = divide(recordings, tables.processing, tables.validation)
        observations = divided.observations
    if tables.mechanism.offset == "per-recording":
        chain = replace(chain, own_offsets=tuple(o.name for o in observations))
    with config.named():
        outputs = sum(len(o.time) for o in observations)
        if outputs < len(chain.parameters):
            raise BadInput(
                ", ".join(f"recording {o.name!r}" for o in observations),
                f"too short: {outputs} outputs after filtering, {len(chain.parameters)} parameters",
                "record longer, or decimate less",
            )
        _check_names(config, chain)
        priors = read_priors(chain, config.priors, observations, _noise_quantities(config))
    problem = Problem(config, chain, divided.recordings, observations, priors, divided.held_out)
    problem.references()  # refuses what they cannot be of
    return problem


def _check_validation(config: Config) -> None:
    tables = config.tables
    wanted = tables.validation.recordings or tables.validation.hold_out is not None
    if wanted and tables.likelihood.method == "output-error":
        raise BadInput(
            f"{config.path}: validation",
            "is not offered for the output-error likelihood",
            'leave it out, or set likelihood.method = "input-error"',
        )


def _noise_quantities(config: Config) -> tuple[str, ...]:
    """Noise scales that may have a prior."""
    tables = config.tables
    if tables.likelihood.method == "output-error":
        return PositionLikelihood.noise.quantities
    noise = tables.noise
    if noise.order is not None and NOISE_MODELS[noise.model].order == "none":
        raise BadInput("noise.order", f"{noise.model} noise has none", "leave it out")
    return _residual_noise(noise, MOST).quantities


def _residual_noise(noise: NoiseOptions, chosen: int) -> ResidualNoise:
    """Make the noise that a configuration asks for; of order ``chosen`` where it names none."""
    model = NOISE_MODELS[noise.model]
    return model.make(0 if model.order == "none" else noise.order or chosen)


def _changed_since(recording: Recording, origin: Origin) -> Recording:
    """Warn of a file that is another one than the run was made of."""
    kept = origin.recordings.get(recording.name)
    if kept is None or kept.sha256 == recording.sha256:
        return recording
    text = f"changed since the run was made: its SHA-256 was {kept.sha256}"
    return replace(recording, warnings=(*recording.warnings, text))


def _read(
    config: Config, folder: Path, chain: Chain, source: Source, number: int
) -> list[Recording]:
    place = f"recordings.{number}"
    if source.added_mass and not source.radius and chain.load.motion == "rotary":
        raise BadInput(
            f"{config.path}: {place}.added_mass", "has no radius", 'add radius, such as "0.35 m"'
        )
    try:
        return read_recordings(
            source,
            folder,
            ratio=chain.ratio,
            motion=chain.load.motion,
            motor_motion=chain.motor_motion,
            processing=config.tables.processing,
        )
    except BadInput as error:
        # what is not about a file is about a key
        key = error.where.partition(" = ")[0].partition(",")[0]
        if key in ("file", "name"):
            with config.named(place):
                raise
        if key == "processing":
            with config.named():
                raise
        raise
    except OSError as error:
        raise BadInput(
            f"{config.path}: {place}.file",
            f"cannot be read ({error.strerror})",
            "check the file's name",
        ) from None


def _check_names(config: Config, chain: Chain) -> None:
    """Refuse a table that stands for a prior but names no distribution."""
    for name in config.priors:
        parameter = name.rpartition(".")[0]
        if parameter in chain.names or parameter.startswith("noise."):
            raise BadInput(
                f"priors.{parameter}",
                "its table names no distribution",
                'write for example {distribution = "norm", loc = 0.4, scale = 0.05}',
            )
