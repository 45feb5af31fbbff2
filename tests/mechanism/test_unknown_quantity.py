"""A quantity that a form does not know is refused: dropped, it would count as zero."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.estimates.least_squares import least_squares, starting_values
from bayesfric.estimates.torque_form import torque_form
from bayesfric.inference.fit import make_target, read_priors
from bayesfric.inference.moments.linear_torque import linear_torque
from bayesfric.inference.prior.defaults import Scales, default_prior
from bayesfric.mechanism import chain as chain_module
from bayesfric.mechanism import kernels, parameter
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.presets import PRESETS
from bayesfric.mechanism.scaling import scalings

KNEE = PRESETS["rabbit-knee"]
SCALES = Scales(torque=1.0, speed=2.0, acceleration=30.0)


@pytest.fixture(scope="module")
def recorded(make_observation):
    """Recording of the knee and its totals, made before anything is strange."""
    o = make_observation(KNEE.chain(), KNEE.values, n=400)
    return o, least_squares(KNEE.chain(), [o])


@pytest.fixture(params=["joint", "load"])
def strange(request, monkeypatch):
    """Give the knee whose joint, or load, has a loss with the cube of speed."""
    monkeypatch.setitem(
        parameter._QUANTITIES,
        "cubic",
        replace(parameter._QUANTITIES["quadratic"], meaning="loss growing with the cube of speed"),
    )
    owner = Load if request.param == "load" else Element
    original = owner.parameters

    def parameters(self):
        found = original(self)
        if getattr(self, "name", "load") != request.param:
            return found
        return (*found, parameter.parameter(request.param, "cubic", "rotary", "x"))

    monkeypatch.setattr(owner, "parameters", parameters)
    made = Chain(KNEE.chain().elements, KNEE.chain().load)
    assert f"{request.param}.cubic" in made.names
    return made


def values_of(chain):
    return np.array([KNEE.values.get(name, 0.1) for name in chain.names])


def prepared(chain, o):
    priors = read_priors(chain, {name: [0.0, 99.0] for name in chain.names}, [o])
    likelihood = make_target(chain, [o], priors, "shared").likelihood
    return likelihood.prepared(np.tile(values_of(chain), (9, 1)))


PATHS = {
    "plain": lambda c, o, _: inverse_torque(c, values_of(c), o.q, o.qd, o.qdd),
    "forward": lambda c, *_: simulate(c, values_of(c), np.zeros(10), 1e-3),
    "torque form": lambda c, *_: torque_form(c),
    "linear torque": lambda c, o, _: linear_torque(c, [o]),
    "scalings": lambda c, *_: scalings(c),
    "totals": lambda c, o, _: least_squares(c, [o]),
    "starts": lambda c, _, totals: starting_values(c, totals, 0.1, 0.5),
    "derived": lambda c, *_: derive(c, values_of(c)[None], 1.0),
    "priors": lambda c, *_: [default_prior(c, p, SCALES) for p in c.parameters],
    "prepared": lambda c, o, _: prepared(c, o),
}


@pytest.mark.parametrize("path", PATHS)
def test_no_path_drops_it(path, strange, recorded):
    with pytest.raises(KeyError, match="cubic"):
        PATHS[path](strange, *recorded)


def test_every_slot_has_its_place_in_the_kernels():
    for slots, names in (
        (chain_module.ELEMENT_SLOTS, [slot.upper() for slot in chain_module.ELEMENT_SLOTS]),
        (
            chain_module.LOAD_SLOTS,
            ["LOAD_INERTIA", *(slot.upper() for slot in chain_module.LOAD_SLOTS[1:])],
        ),
    ):
        assert [getattr(kernels, name) for name in names] == list(range(len(slots)))


QUADRATIC = {
    "motor.viscous": 0.02,
    "motor.coulomb": 0.1,
    "motor.quadratic": 3e-4,
    "belt.quadratic": 2e-3,
    "belt.load": 0.1,
    "gearbox.load_drive": 0.3,
    "gearbox.load_back": 0.4,
    "joint.viscous": 0.5,
    "joint.quadratic": 0.7,
    "load.first_moment": 60.0,
}


@pytest.mark.parametrize("lossy", [True, False])
def test_the_quadratic_total_is_what_steady_speeds_show(lossy):
    """Second differences of the torque over steady motor speeds leave the quadratic loss."""
    chain = Chain(
        (
            Element("motor", coulomb="symmetric", viscous=True, quadratic=True),
            Element("belt", ratio=2.5, quadratic=True, load_loss="one" if lossy else "none"),
            Element("gearbox", ratio=6.0, load_loss="two" if lossy else "none"),
            Element("joint", ratio=1.2, viscous=True, quadratic=True),
        ),
        Load(first_moment=True),
    )
    x = chain.vector({name: QUADRATIC[name] for name in chain.names})
    found = {d.name: d for d in derive(chain, x[None], 1.0)}
    step = 0.5  # rad/s at the motor
    speeds = np.array([1.0, 2.0, 3.0]) * step / chain.ratio
    # the weight holds back at one side, and drives at the other
    for side, q in (("drive", 0.5 * np.pi), ("back", -0.5 * np.pi)):
        torque = inverse_torque(chain, x, np.full(3, q), speeds, np.zeros(3))
        seen = (torque[0] - 2.0 * torque[1] + torque[2]) / (2.0 * step**2)
        total = found[f"total_{side}.quadratic" if lossy else "total.quadratic"]
        assert float(total.values[0]) == pytest.approx(seen, rel=1e-6)
        assert total.gauge_free
        assert total.unit == "N m s²"
