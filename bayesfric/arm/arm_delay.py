"""One delay of an arm's efforts against its positions, by all joints.

A joint's model that lacks a term makes a delay of any sign and size; a log whose efforts come late
makes the same at all joints. So joints' delays are combined with the scatter between them (random
effects, DerSimonian and Laird 1986).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.estimates.input_error import input_error
from bayesfric.fit.model import Model
from bayesfric.inference.priors import as_knowledge, read_prior
from bayesfric.recordings.signals import retimed

# Longest delay to look for, s.
_LONGEST = 0.25


@dataclass(frozen=True)
class ArmDelay:
    """Time by which positions come after efforts, s: by all joints, and by each."""

    value: float
    sd: float
    joints: Mapping[str, tuple[float, float]]  # value and sd
    evident: bool  # by the Bayesian information criterion


def common_delay(models: Mapping[str, Model]) -> ArmDelay:
    """Combine the delays of models of joints by input error, repeated about the last one.

    A model whose delay is known has no say.
    """
    models = {name: model for name, model in models.items() if not model.chain.delay}
    outputs = sum(o.measured.size for model in models.values() for o in model.observations)
    delay = 0.0
    for _ in range(5):
        joints = {name: x for name, model in models.items() if (x := _delay_of(model, delay))}
        value, sd = combined(joints.values())
        evident = value**2 > sd**2 * (math.log(max(outputs, 1)) + 6.0)
        if not evident or abs(value - delay) < 0.5 * sd:
            break
        delay = value
    return ArmDelay(value, sd, joints, evident)


def _delay_of(model: Model, about: float) -> tuple[float, float] | None:
    """Estimate the delay of a joint and its sd, linear about a delay."""
    chain = replace(model.chain, delay=True)
    prior = read_prior(chain.delay_name, [-_LONGEST, _LONGEST], lower=-math.inf, upper=math.inf)
    knowledge = as_knowledge(chain, {**model.priors, chain.delay_name: prior})
    pairs = zip(model.recordings, model.observations, strict=True)
    shifted = [retimed(o, r.segments, r.period, about, r) for r, o in pairs]
    try:
        delay = input_error(chain, shifted, knowledge, model.evidence.options)[chain.delay_name]
    except BadInput:  # too few outputs
        return None
    sd = delay.larger_sd
    return (delay.value, sd) if delay.determined and sd > 0.0 else None


def combined(estimates: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Combine values and sds to the mean of random effects, and its sd; 0 and infinity of none."""
    pairs = np.array([*estimates]).reshape(-1, 2)
    if not len(pairs):
        return 0.0, math.inf
    value, variance = pairs[:, 0], pairs[:, 1] ** 2
    weight = 1.0 / variance
    mean = float(weight @ value / weight.sum())
    excess = float(weight @ (value - mean) ** 2) - (len(value) - 1)
    between = max(excess / max(float(weight.sum() - weight @ weight / weight.sum()), 1e-300), 0.0)
    weight = 1.0 / (variance + between * (len(value) > 1))
    return float(weight @ value / weight.sum()), float(1.0 / math.sqrt(weight.sum()))
