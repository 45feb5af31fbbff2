"""Simulated recordings of a known joint: torque, motion, encoder and noise."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.options import Options
from bayesfric.mechanism import excitation
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.forward import Motion, simulate
from bayesfric.mechanism.presets import PRESETS
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Hold, Inputs

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Simulation(Options):
    """The ``[simulation]`` table of a configuration."""

    duration: Positive = Field(10.0, le=1e5, description="of the recording, s")
    rate: Positive = Field(1000.0, le=1e6, description="samples a second")
    excitation: Literal["square", "sine", "multisine", "chirp", "square-multisine"] = Field(
        "square", description="form of the commanded motor torque"
    )
    amplitude: Positive = Field(
        0.8,
        description="of the commanded torque, N m or N",
    )
    frequency: Positive = Field(1.0, description="of the square wave or sine, Hz")
    frequencies: tuple[Positive, ...] = Field(
        (0.3, 0.7, 1.3, 2.9, 5.3),
        max_length=1000,
        description="of the multisine, or first and last of the chirp, Hz",
    )
    lag: NotNegative = Field(0.005, description="time constant of the current loop, s")
    hold: Hold = Field(
        "linear",
        description="how the torque goes between samples: zero, held until the next; linear; cubic",
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

    def true_values(self, chain: Chain) -> dict[str, float]:
        """Return the value of every parameter of the chain, by name."""
        preset = PRESETS.get(chain.made_from)
        values = dict(preset.values) if preset else {}
        for name, value in self.parameters.items():
            if name not in chain.names:
                raise BadInput(
                    f"simulation.parameters.{name}",
                    "the mechanism has no such parameter",
                    nearest(name, chain.names),
                )
            values[name] = value
        for p in chain.parameters:
            if p.name not in values:
                raise BadInput(
                    f"simulation.parameters.{p.name}",
                    "the preset has no value for it" if preset else "has no value",
                    f"add {p.name} = ... (in {p.unit or 'no unit'})",
                )
            if not (np.isfinite(values[p.name]) and p.lower <= values[p.name] <= p.upper):
                raise BadInput(
                    f"simulation.parameters.{p.name}",
                    f"{values[p.name]:g} is no possible value",
                    f"it lies between {p.lower:g} and {p.upper:g}",
                )
        return {name: values[name] for name in chain.names}


def record(chain: Chain, options: Simulation) -> tuple[dict[str, Array], Motion, dict[str, float]]:
    """Simulate a recording: its columns ``(N,)``, the true motion and the true values.

    The commanded torque passes the current loop, moves the joint, and is measured with noise; the
    position is read by an encoder.
    """
    values = options.true_values(chain)
    period = 1.0 / options.rate
    time = np.arange(round(options.duration * options.rate), dtype=np.float64) * period
    if time.size < 10:
        raise BadInput("simulation.duration", "makes fewer than 10 samples", "raise it")
    seeds = np.random.SeedSequence(options.seed).spawn(2)
    command = _command(options, time, int(seeds[0].generate_state(1)[0]))
    try:
        columns, motion = measure(
            chain,
            chain.vector(values),
            command,
            options,
            np.random.default_rng(seeds[1]),
        )
    except ValueError as error:
        raise BadInput(
            "simulation", str(error), "change the amplitude, duration or parameters"
        ) from None
    return columns, motion, values


def measure(
    chain: Chain,
    values: Array,
    command: Array,
    options: Simulation,
    rng: np.random.Generator,
    *,
    q0: float = 0.0,
    qd0: float = 0.0,
) -> tuple[dict[str, Array], Motion]:
    """Play any command to a joint and measure what it does.

    The encoder rounds the position to ``2 pi / encoder_counts``, rad (or that many m of what
    slides). The torque's noise is white and Gaussian, added to what comes behind the current loop.
    """
    period = 1.0 / options.rate
    torque = excitation.current_loop(command, period, options.lag)
    motion = simulate(
        chain,
        values,
        torque,
        period,
        q0=q0,
        qd0=qd0,
        inputs=Inputs(options.added_mass, options.radius),
        hold=options.hold,
    )
    ratio = chain.ratio if options.encoder_side == "motor" else 1.0
    position = motion.q * ratio
    if options.encoder_counts:
        count = 2.0 * np.pi / options.encoder_counts
        position = np.round(position / count) * count
    noise = options.torque_noise * rng.standard_normal(command.size)
    time = np.arange(command.size, dtype=np.float64) * period
    return {"time": time, "position": position, "torque": torque + noise}, motion


def _command(options: Simulation, time: Array, seed: int) -> Array:
    """Make the commanded torque ``(N,)``; of k sines each has the amplitude over sqrt(k)."""
    a, f = options.amplitude, options.frequency
    if options.excitation == "square":
        return excitation.square(time, a, f)
    if options.excitation == "sine":
        return excitation.sine(time, a, f)
    if options.excitation == "chirp":
        return excitation.chirp(time, a, options.frequencies[0], options.frequencies[-1])
    many = excitation.multisine(
        time, a / len(options.frequencies) ** 0.5, options.frequencies, seed=seed
    )
    return many if options.excitation == "multisine" else excitation.square(time, a, f) + many
