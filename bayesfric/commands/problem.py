"""From a configuration to everything a fit needs, read and checked."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from bayesfric.config import Config
from bayesfric.errors import BadInput
from bayesfric.inference.fit import make_target, read_priors
from bayesfric.inference.priors import Prior
from bayesfric.inference.target import Target
from bayesfric.mechanism.chain import Chain
from bayesfric.recordings.observation import Observation, observe
from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.recording import Recording


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
        As read and as prepared, in the same order.
    priors
        Of every parameter and of ``noise.sigma``.
    """

    config: Config
    chain: Chain
    recordings: list[Recording]
    observations: list[Observation]
    priors: dict[str, Prior]

    def target(self) -> Target:
        """Log-posterior of the problem."""
        return make_target(
            self.chain, self.observations, self.priors, self.config.tables.noise.scale
        )


def read_problem(config: Config) -> Problem:
    """Read every recording of a configuration and prepare it.

    Raises
    ------
    BadInput
        For anything that cannot be used.
    """
    tables = config.tables
    chain = tables.mechanism.chain()
    if not tables.recordings:
        raise BadInput(str(config.path), "names no recording", "add a [[recordings]] table")
    if not chain.parameters:
        raise BadInput(
            f"{config.path}: mechanism", "has no parameter", "give an element inertia or friction"
        )
    recordings: list[Recording] = []
    for source in tables.recordings:
        if source.added_mass and not source.radius and chain.load.motion == "rotary":
            raise BadInput(
                f"{config.path}: recordings.added_mass",
                "has no radius",
                'add radius, such as "0.35 m"',
            )
        recordings += read_recordings(
            source,
            config.folder,
            ratio=chain.ratio,
            motion=chain.load.motion,
            motor_motion=chain.motor_motion,
            processing=tables.processing,
        )
    for name, count in Counter(r.name for r in recordings).items():
        if count > 1:
            raise BadInput(
                f"{config.path}: recordings", f"{count} are called {name!r}", "give them a name"
            )
    observations = [observe(recording, tables.processing) for recording in recordings]
    priors = read_priors(chain, config.priors, observations)
    return Problem(config, chain, recordings, observations, priors)
