"""Simulated recordings of a known joint: excitation, motion, encoder and noise.

Every excitation is a function of times ``(N,)``, so signals add with ``+``. Square waves, as of the
paper's 1 Hz tests, let the load drive the motor; sines alone hardly do, and leave ``alpha_2``
unseen.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError
from scipy.signal import lfilter

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.options import Options, configuration_error
from bayesfric.mechanism import forward
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Hold, Inputs

if TYPE_CHECKING:
    import pandas as pd

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Simulation(Options):
    """The ``[simulation]`` table of a configuration."""

    duration: Positive = Field(10.0, le=1e5, description="of the recording, s")
    rate: Positive = Field(1000.0, le=1e6, description="samples a second")
    excitation: Literal["square", "sine", "multisine", "chirp", "square-multisine"] = Field(
        "square", description="form of the commanded motor torque"
    )
    amplitude: Positive = Field(0.8, description="of the commanded torque, N m or N")
    frequency: Positive = Field(1.0, description="of the square wave or sine, Hz")
    frequencies: tuple[Positive, ...] = Field(
        (0.3, 0.7, 1.3, 2.9, 5.3),
        max_length=1000,
        description="of the multisine, or first and last of the chirp, Hz",
    )
    lag: NotNegative = Field(0.005, description="time constant of the current loop, s")
    hold: Hold = Field(
        "linear",
        description="how the torque goes between samples: zero, held until the next; linear",
    )
    encoder_counts: int = Field(
        8192, ge=0, description="counts a turn of the encoder; 0 for a perfect one"
    )
    encoder_side: Literal["motor", "joint"] = Field("motor", description="shaft of the encoder")
    torque_noise: NotNegative = Field(0.02, description="standard deviation, N m or N")
    added_mass: NotNegative = Field(0.0, description="known mass on the load, kg")
    radius: NotNegative = Field(0.0, description="distance of that mass from the axis, m")
    seed: int = Field(1, ge=0, lt=2**63, description="of the noise and of multisine phases")
    parameters: dict[str, float] = Field(
        default_factory=dict,
        description="true values by name, in SI units; the preset's where left out",
    )

    def true_values(self, joint: Joint) -> dict[str, float]:
        """Return the value of every parameter of the joint, by name."""
        preset = PRESETS.get(joint.made_from)
        values = (preset.values if preset else {}) | self.parameters
        key = "simulation.parameters."
        for name in self.parameters:
            if name not in joint.names:
                problem = "the mechanism has no such parameter"
                raise BadInput(key + name, problem, nearest(name, joint.names))
        for p in joint.parameters:
            if p.name not in values:
                problem = "the preset has no value for it" if preset else "has no value"
                hint = f"add {p.name} = ... (in {p.unit or 'no unit'})"
                raise BadInput(key + p.name, problem, hint)
            if not (np.isfinite(values[p.name]) and p.lower <= values[p.name] <= p.upper):
                raise BadInput(
                    key + p.name,
                    f"{values[p.name]:g} is not a possible value",
                    f"it lies between {p.lower:g} and {p.upper:g}",
                )
        return {name: values[name] for name in joint.names}


def simulate(
    joint: Joint, parameters: Mapping[str, float] | None = None, **options: Any
) -> pd.DataFrame:
    """Simulate a recording of a joint on a bench.

    Parameters
    ----------
    joint
        The joint.
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
        raise configuration_error("simulation.", "simulation", error, keys, Simulation) from None
    columns, _, _ = record(joint, simulation)
    return pd.DataFrame(columns)


def record(
    joint: Joint, options: Simulation
) -> tuple[dict[str, Array], forward.Motion, dict[str, float]]:
    """Simulate a recording: its columns ``(N,)``, the true motion and the true values.

    The commanded torque passes the current loop, moves the joint, and is measured with noise; the
    position is read by an encoder.
    """
    values = options.true_values(joint)
    time = np.arange(round(options.duration * options.rate), dtype=np.float64) * (
        1.0 / options.rate
    )
    if time.size < 10:
        raise BadInput("simulation.duration", "makes fewer than 10 samples", "raise it")
    seeds = np.random.SeedSequence(options.seed).spawn(2)
    command = _command(options, time, int(seeds[0].generate_state(1)[0]))
    rng = np.random.default_rng(seeds[1])
    try:
        columns, motion = measure(joint, joint.vector(values), command, options, rng)
    except ValueError as error:
        hint = "change the amplitude, duration or parameters"
        raise BadInput("simulation", str(error), hint) from None
    return columns, motion, values


def measure(
    joint: Joint,
    values: Array,
    command: Array,
    options: Simulation,
    rng: np.random.Generator,
    *,
    q0: float = 0.0,
    qd0: float = 0.0,
) -> tuple[dict[str, Array], forward.Motion]:
    """Play any command to a joint and measure what it does.

    The encoder rounds the position to ``2 pi / encoder_counts``, rad (or that many m of what
    slides). The torque's noise is white and Gaussian, added to what comes behind the current loop.
    """
    period = 1.0 / options.rate
    torque = current_loop(command, period, options.lag)
    inputs = Inputs(options.added_mass, options.radius)
    motion = forward.simulate(
        joint, values, torque, period, q0=q0, qd0=qd0, inputs=inputs, hold=options.hold
    )
    position = motion.q * (joint.ratio if options.encoder_side == "motor" else 1.0)
    if options.encoder_counts:
        count = 2.0 * np.pi / options.encoder_counts
        position = np.round(position / count) * count
    noise = options.torque_noise * rng.standard_normal(command.size)
    return {"time": motion.time, "position": position, "torque": torque + noise}, motion


# --- excitations: torques in N m or N, frequencies in Hz -------------------------------


def _command(options: Simulation, time: Array, seed: int) -> Array:
    """Make the commanded torque ``(N,)``; of k sines each has the amplitude over sqrt(k)."""
    amplitude, hertz, kind = options.amplitude, options.frequencies, options.excitation
    if kind == "sine":
        return sine(time, amplitude, options.frequency)
    if kind == "chirp":
        return chirp(time, amplitude, hertz[0], hertz[-1])
    command = np.zeros(time.size)
    if "square" in kind:
        command += square(time, amplitude, options.frequency)
    if "multisine" in kind:
        command += multisine(time, amplitude / len(hertz) ** 0.5, hertz, seed=seed)
    return command


def square(time: ArrayLike, amplitude: float, frequency: float) -> Array:
    """Torque ``amplitude`` for half a period, then its negative.

    A switch that falls on a sample, up to rounding, has happened at that sample.
    """
    halves = np.floor(2.0 * frequency * np.asarray(time, dtype=np.float64) + 1e-9)
    return np.where(halves % 2 == 0, amplitude, -amplitude).astype(np.float64)


def sine(time: ArrayLike, amplitude: float, frequency: float, phase: float = 0.0) -> Array:
    """Sine with ``phase`` (rad) at time zero."""
    turns = frequency * np.asarray(time, dtype=np.float64)
    return np.asarray(amplitude * np.sin(2.0 * np.pi * turns + phase), dtype=np.float64)


def multisine(
    time: ArrayLike, amplitude: ArrayLike, frequencies: ArrayLike, *, seed: int | None = None
) -> Array:
    """Sum of sines with random phases, or those of Schroeder (IEEE Trans. Inf. Theory 16, 1970)."""
    hertz = np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    each = np.broadcast_to(np.asarray(amplitude, dtype=np.float64), hertz.shape)
    order = np.arange(hertz.size)
    phases = -np.pi * order * (order + 1) / hertz.size
    if seed is not None:
        phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, hertz.size)
    total = np.zeros(np.shape(time))
    for a, f, phase in zip(each.tolist(), hertz.tolist(), phases.tolist(), strict=True):
        total += sine(time, a, f, phase)
    return total


def chirp(time: ArrayLike, amplitude: float, first: float, last: float) -> Array:
    """Sine whose frequency rises evenly from ``first`` to ``last``; its first phase is zero."""
    t = np.asarray(time, dtype=np.float64)
    since = t - t[0]
    turns = first * since + 0.5 * (last - first) * since**2 / (since[-1] or 1.0)
    return np.asarray(amplitude * np.sin(2.0 * np.pi * turns), dtype=np.float64)


def current_loop(torque: ArrayLike, period: float, lag: float) -> Array:
    """Torque behind a current loop, a first-order lag from zero on, at the command's samples.

    The lag matters for identification: where the torque is piecewise constant, the equation of
    motion itself makes the regressors linearly dependent.
    """
    command = np.asarray(torque, dtype=np.float64)
    if lag == 0.0:
        return command.copy()
    decay = np.exp(-period / lag)
    actual = lfilter([0.0, -np.expm1(-period / lag)], [1.0, -decay], command)
    return np.asarray(actual, dtype=np.float64)
