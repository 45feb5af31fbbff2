"""Every friction term is recovered from simulated recordings, and missed where left out.

Recordings are simulated with the forward model, measured through an encoder and a noisy torque,
read from a file and processed with the defaults, as a user's are.
"""

import json
from dataclasses import dataclass, field

import numpy as np
import pytest

from bayesfric.commands.simulate import simulate
from bayesfric.fit.model import Model
from bayesfric.inference.fitting import fit, make_target
from bayesfric.inference.priors import fixed
from bayesfric.inference.start import climb
from bayesfric.problem.config import parse_config

pytestmark = pytest.mark.usefixtures("nothing_explained")

COLUMNS = """
[[recordings]]
file = "recording.csv"
time = {{ column = "time", unit = "s" }}
position = {{ column = "position", unit = "rad"{side} }}
torque = {{ column = "torque", unit = "N m" }}
"""


@dataclass(frozen=True)
class Case:
    """A mechanism to simulate, and the terms whose absence must show."""

    preset: str
    missed: tuple
    elements: str = ""
    truth: dict = field(default_factory=dict)
    priors: str = ""
    side: str = ""
    simulation: dict = field(default_factory=dict)

    def text(self):
        usual = {"excitation": "multisine", "encoder_counts": 2**20, "torque_noise": 0.01}
        simulation = usual | {"seed": 13} | self.simulation | {"parameters": self.truth}
        written = "\n".join(f"{key} = {_toml(value)}" for key, value in simulation.items())
        return (
            f'[mechanism]\npreset = "{self.preset}"\n{self.elements}'
            f"{COLUMNS.format(side=self.side)}\n[priors]\n{self.priors}\n"
            f"[simulation]\n{written}\n[sampling]\nmin_ess = 600\n"
        )


def _toml(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f'"{name}" = {x}' for name, x in value.items()) + "}"
    return json.dumps(value)


SERVO = {"amplitude": 0.35, "frequencies": [0.2, 0.5, 0.9, 1.7], "torque_noise": 0.005}
# The knee has its known load fixed, as a CAD value would: without it leg and alpha have no scale
# (the paper).
CASES = {
    "rabbit-knee": Case(
        "rabbit-knee",
        ("motor.viscous", "joint.viscous", "gearbox.load_drive", "gearbox.load_back"),
        priors='"load.first_moment" = 0.42',
        side=', side = "motor"',
        simulation={"excitation": "square-multisine", "amplitude": 0.8, "torque_noise": 0.015,
                    "seed": 11},
    ),
    "motor-axis": Case(
        "motor-axis",
        ("motor.viscous", "motor.coulomb", "offset"),
        simulation={"amplitude": 1.0},
    ),
    "axis with viscous loss by direction": Case(
        "motor-axis",
        ("motor.viscous_positive", "motor.viscous_negative", "motor.coulomb", "offset"),
        'elements.motor.viscous = "by-direction"',
        truth={"motor.viscous_positive": 0.04, "motor.viscous_negative": 0.06},
        simulation={"amplitude": 1.0},
    ),
    "servo-pendulum": Case(
        "servo-pendulum",
        ("motor.viscous", "motor.coulomb", "gearbox.load"),
        simulation=SERVO,
    ),
}  # fmt: skip
# Sampled with every sample, half a minute of CPU each.
SLOW = {
    "axis with every term": Case(
        "motor-axis",
        ("motor.viscous", "motor.quadratic", "motor.stribeck_ratio"),
        'elements.motor = { coulomb = "by-direction", quadratic = true, stribeck = true }',
        truth={"offset": 0.0, "motor.coulomb_positive": 0.2, "motor.coulomb_negative": 0.26,
               "motor.quadratic": 0.004, "motor.stribeck_ratio": 0.5,
               "motor.stribeck_velocity": 1.0},
        priors="offset = 0.0",
        simulation={"amplitude": 1.2, "duration": 6, "seed": 14},
    ),
    "axis with a power of speed, springs and what repeats": Case(
        "motor-axis",
        ("motor.power", "load.spring", "load.spring_cubic", "motor.cogging_sin_7",
         "motor.periodic_friction_sin_3"),
        "elements.motor = { power = true, cogging = [7], periodic_friction = [3] }\n"
        'load.spring = "stiffening"',
        truth={"motor.power": 0.05, "motor.power_exponent": 0.5, "motor.cogging_sin_7": 0.02,
               "motor.cogging_cos_7": -0.01, "motor.periodic_friction_sin_3": 0.015,
               "motor.periodic_friction_cos_3": 0.01, "load.spring": 0.15,
               "load.spring_cubic": -0.002},
        priors='"motor.power_exponent" = 0.5',
        simulation={"amplitude": 1.2, "frequencies": [0.2, 0.5, 0.9, 1.7, 3.1], "duration": 10,
                    "seed": 15},
    ),
    "servo with load loss by direction and with the square of the load": Case(
        "servo-pendulum",
        ("gearbox.load_difference", "gearbox.load_square"),
        "elements.gearbox = { load_direction = true, load_square = true }",
        truth={"gearbox.load_difference": 0.02, "gearbox.load_square": 0.1},
        simulation=SERVO,
    ),
    "servo with load loss that grows with speed": Case(
        "servo-pendulum",
        ("gearbox.load_speed",),
        "elements.gearbox.load_speed = true",
        truth={"gearbox.load_speed": 0.05},
        simulation=SERVO,
    ),
    "axis that warms up": Case(
        "motor-axis",
        ("motor.viscous_warming", "motor.coulomb_warming"),
        'elements.motor.warming = "both"',
        truth={"motor.viscous_warming": -0.02, "motor.coulomb_warming": -0.05,
               "motor.warming_time": 3.0},
        simulation={"amplitude": 1.0, "duration": 12},
    ),
    "axis with Stribeck rises of constant and load loss apart": Case(
        "motor-axis",
        ("motor.stribeck_constant", "motor.stribeck_load"),
        'elements.motor = { load_loss = "one", stribeck = "apart" }\nload.first_moment = true',
        truth={"motor.load": 0.15, "motor.stribeck_constant": 1.5, "motor.stribeck_load": 2.5,
               "motor.stribeck_velocity": 1.0, "load.first_moment": 0.08},
        simulation={"amplitude": 1.2, "frequencies": [0.2, 0.5, 0.9, 1.7], "duration": 10,
                    "seed": 14},
    ),
    "axis whose loss falls towards standstill with a free exponent": Case(
        "motor-axis",
        ("motor.stribeck_change",),
        'elements.motor = { stribeck = "either", stribeck_exponent = true }',
        truth={"motor.stribeck_change": -0.5, "motor.stribeck_velocity": 1.0,
               "motor.stribeck_exponent": 1.5},
        simulation={"amplitude": 1.0, "duration": 10, "seed": 14},
    ),
}  # fmt: skip


@pytest.fixture(
    scope="module",
    params=[*CASES, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)],
)
def case(request, tmp_path_factory):
    case = (CASES | SLOW)[request.param]
    folder = tmp_path_factory.mktemp("recovery")
    config = parse_config(case.text(), folder / "case.toml")
    truth = simulate(config, folder / "recording.csv")
    model = Model.from_config(config)
    return model, fit(model.white_target(), config.tables.sampling), truth, case.missed


def test_every_term_is_recovered(case):
    model, result, truth, _ = case
    assert result.posterior.diagnostics.status == "reliable"
    for name in result.target.free:
        draws = result.posterior[name]
        true = truth["parameters"][name]["value"]
        assert abs(draws.mean() - true) < 4.0 * draws.std(), name
        # the data narrowed the prior
        assert draws.std() < 0.7 * model.priors[name].sd(), name
    # the residual is the torque's own noise, as the filter passes it, not model error
    taps = model.observations[0].filter.taps
    expected = truth["simulation"]["torque_noise"] * np.sqrt((taps**2).sum())
    assert result.posterior["noise.sigma"].mean() == pytest.approx(expected, rel=0.25)


@pytest.mark.slow
def test_each_term_left_out_is_missed_in_the_residual(case):
    """A nested model without the term fits worse than chance: 1 degree of freedom, 5 sigma."""
    model, result, _, terms = case
    best = result.posterior.flat().mean(axis=0)[None]
    full = result.target.likelihood.sum_of_squares(result.target.chain_values(best)).sum()
    variance = result.posterior["noise.sigma"].mean() ** 2
    for term in terms:
        priors = model.priors | {term: fixed(0.0)}
        target = make_target(model.chain, model.observations, priors, "shared")
        others = [j for j, name in enumerate(result.target.names) if name != term]
        draws = result.posterior.flat()[:: max(1, len(result.posterior.flat()) // 50)][:, others]
        mode = climb(target, target.from_parameters(draws))
        parameters, _ = target.to_parameters(mode[None])
        without = target.likelihood.sum_of_squares(target.chain_values(parameters)).sum()
        assert (without - full) / variance > 25.0, term
