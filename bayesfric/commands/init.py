"""``bayesfric init``: a commented configuration to start from."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from bayesfric.config import LikelihoodOptions, NoiseOptions
from bayesfric.errors import BadInput, nearest
from bayesfric.estimates.estimation import Estimation
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.mechanism.experiment import Simulation
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.presets import PRESETS
from bayesfric.mechanism.quantities import CHOICES, OPTION_MEANINGS
from bayesfric.recordings.held_out import Validation
from bayesfric.recordings.processing import Processing


def configuration(preset: str) -> str:
    """Text of a commented configuration for a preset.

    Raises
    ------
    BadInput
        If there is no such preset.
    """
    if preset not in PRESETS:
        raise BadInput(preset, "there is no such preset", nearest(preset, PRESETS))
    chosen = PRESETS[preset]
    chain = chosen.chain()
    return "\n".join(
        [
            f"# bayesfric configuration: {chosen.meaning}.",
            "# Lines that begin with '#' are defaults or examples; remove the '#' to change them.",
            "",
            *_mechanism(preset, chain),
            "",
            *_recordings(chain),
            "",
            "[processing]",
            *_options(Processing),
            "",
            *_priors(chain),
            "",
            "# Values to compare results with, from a data sheet or CAD; they enter no fit.",
            "# [references]",
            *_references(chain),
            "",
            "[estimation]",
            *_options(Estimation),
            "",
            "[likelihood]",
            *_options(LikelihoodOptions),
            "",
            "[noise]",
            *_options(NoiseOptions),
            "",
            "[sampling]",
            *_options(Sampling),
            "",
            "# What the fit does not see, so that 'bayesfric fit' can say how well it predicts:",
            "[validation]",
            *_options(Validation),
            "",
            "# Only for 'bayesfric identify --advise':",
            "[advice]",
            *_options(AdviceOptions),
            "",
            "# Only for 'bayesfric simulate':",
            "[simulation]",
            *_options(Simulation),
            f"# Parameters are those of {chosen.source}, unless given here:",
            "# [simulation.parameters]",
            *(f'# "{name}" = {value:.6g}' for name, value in chosen.values.items()),
            "",
        ]
    )


def _mechanism(preset: str, chain: Joint) -> Iterator[str]:
    yield "[mechanism]"
    yield f'preset = "{preset}"'
    yield (
        f"# offset = {str(chain.offset).lower()}  # unknown constant in the motor torque; "
        'or "per-recording"'
    )
    yield f"# gain = {str(chain.gain).lower()}  # unknown factor of the torque constant"
    for element in chain.elements:
        yield f"# [mechanism.elements.{element.name}]"
        yield f"# ratio = {element.ratio:g}  # input speed over output speed"
        for option, choices in CHOICES.items():
            plain = False if True in choices else "none"
            known = ", ".join(_toml(choice) for choice in (plain, *choices))
            chosen = _toml(element.choices.get(option, plain))
            yield f"# {option} = {chosen}  # {OPTION_MEANINGS[option]}: {known}"


def _recordings(chain: Joint) -> Iterator[str]:
    linear = chain.motor_motion == "linear"
    yield "# One table for each file; 'file' may be a list or hold wildcards."
    yield "[[recordings]]"
    yield 'file = "recording.csv"'
    yield 'time = { column = "time", unit = "s" }'
    side = ', side = "motor"' if chain.ratio != 1 else ""
    yield f'position = {{ column = "position", unit = "{"m" if linear else "rad"}"{side} }}'
    yield f'torque = {{ column = "torque", unit = "{"N" if linear else "N m"}" }}'
    yield "# or the current times a known constant:"
    yield '# current = { column = "current", unit = "A", torque_constant = "0.32 N m/A" }'
    yield "# or the voltage, with the back-EMF taken off:"
    yield (
        '# voltage = { column = "voltage", unit = "V", torque_constant = "0.32 N m/A", '
        'resistance = "1.2 ohm" }'
    )
    yield '# added_mass = "2 kg"  # known mass bolted to the load'
    yield '# radius = "0.35 m"'


def _priors(chain: Joint) -> Iterator[str]:
    yield "# A number fixes, a range is uniform, a distribution is SciPy's by name."
    yield "# What is left out gets a wide default, which 'bayesfric check' prints."
    yield "[priors]"
    yield '# "motor.inertia" = 3.3e-4'
    yield '# "motor.inertia" = [1e-4, 1e-3]'
    yield '# "motor.inertia" = { distribution = "norm", loc = 3.3e-4, scale = 2e-5 }'
    for p in chain.parameters:
        yield f"# {p.name:<26} {p.unit or '-':<8} {p.meaning}"


def _references(chain: Joint) -> Iterator[str]:
    name = "load.first_moment" if "load.first_moment" in chain.names else chain.names[0]
    yield f'# "{name}" = {{ value = 0.41, source = "CAD" }}'


def _options(model: type[BaseModel]) -> Iterator[str]:
    for key, field in model.model_fields.items():
        if key == "parameters":
            continue
        text = f"{key}: {field.description}"
        yield from textwrap.wrap(text, 92, initial_indent="# ", subsequent_indent="#   ")
        shown = field.examples[0] if field.examples else field.default
        yield f"# {key} = {_toml(shown)}"


def _toml(value: Any) -> str:
    if value is None or value is PydanticUndefined:
        return '"..."  # found by itself when left out'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
