"""A joint by name or by its elements, that can be simulated and evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationError

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.options import configuration_error
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.presets import PRESETS
from bayesfric.recordings.measurement import AT_ROOM

if TYPE_CHECKING:
    import pandas as pd


class Joint(Chain):
    """A :class:`Chain`, by its elements or by name, that can be moved, simulated and shown.

    Examples
    --------
    >>> joint = Joint.preset("rabbit-knee")
    >>> recording = joint.simulate(duration=10.0, seed=2)
    """

    @classmethod
    def preset(cls, name: str) -> Self:
        """Make the joint of that name, such as ``rabbit-knee``.

        Parameters
        ----------
        name
            Of :data:`bayesfric.mechanism.presets.PRESETS`.

        Raises
        ------
        BadInput
            If there is none.
        """
        if name not in PRESETS:
            raise BadInput("preset", f"there is no preset {name!r}", nearest(name, PRESETS))
        chain = PRESETS[name].chain()
        return cls(**{field.name: getattr(chain, field.name) for field in fields(chain)})

    def __repr__(self) -> str:
        return "\n".join(f"{p.name} ({p.unit or '1'}): {p.meaning}" for p in self.parameters)

    def simulate(
        self, parameters: Mapping[str, float] | None = None, **options: Any
    ) -> pd.DataFrame:
        """Simulate a recording of the joint on a bench.

        Parameters
        ----------
        parameters
            True values; the preset's where left out.
        **options
            Keys of the table ``simulation`` of a configuration, such as ``duration``, ``rate``,
            ``excitation``, ``amplitude``, ``encoder_counts``, ``torque_noise`` and ``seed``.

        Returns
        -------
        DataFrame
            ``time`` in s, ``position`` in rad or m on the encoder's side, ``torque`` as measured
            in N m or N. It is simulated, not measured.

        Raises
        ------
        BadInput
            If a value is impossible or the simulation runs away.
        """
        import pandas as pd

        keys = {**options, "parameters": dict(parameters or {})}
        try:
            simulation = Simulation.model_validate(keys)
        except ValidationError as error:
            raise configuration_error(
                "simulation.", "simulation", error, keys, Simulation
            ) from None
        columns, _, _ = record(self, simulation)
        return pd.DataFrame(columns)

    def torque(
        self,
        values: Mapping[str, ArrayLike],
        position: ArrayLike,
        speed: ArrayLike,
        acceleration: ArrayLike,
        *,
        time: ArrayLike | None = None,
    ) -> NDArray[np.float64]:
        """Give the motor torque that a motion of the joint takes, as it would be recorded.

        Where ``drive.gain`` is a parameter, the true torque is that times it. A delay of recorded
        positions has no part in a motion that is given, and losses are those at 20 degC.

        Parameters
        ----------
        values
            A number for each parameter, or ``(n,)`` draws of it, such as
            ``posterior.posterior[name].values.ravel()``.
        position, speed, acceleration
            ``(N,)`` of the joint, or one number for all (rad or m, SI). Where it stands still,
            losses that depend on direction are zero.
        time
            ``(N,)`` s, for terms that depend on it, which are NaN without.

        Returns
        -------
        ndarray
            ``(N,)``, or ``(n, N)`` of draws, N m or N.

        Raises
        ------
        KeyError
            If a parameter is missing or a name is unknown.
        ValueError
            If lengths differ.
        """
        draws = np.broadcast_arrays(*values.values())
        vectors = self.vector(dict(zip(values, draws, strict=True)))
        motion = np.broadcast_arrays(*np.atleast_1d(position, speed, acceleration))
        stamps = None if time is None else np.asarray(time, dtype=np.float64)
        return inverse_torque(self, vectors, *motion, inputs=AT_ROOM, time=stamps)
