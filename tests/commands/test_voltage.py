"""A joint driven by a voltage: what the nominal back-EMF is off by stands with every number."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.report.terminal import messages_of

pytestmark = pytest.mark.usefixtures("nothing_explained")

T = 0.002 * np.arange(8000)
KT, R, RATIO = 0.4, 4.0, 10.0
INERTIA, COULOMB, VISCOUS = 0.002, 0.02, 0.03
# the motor's true kt²/R over the nominal one, at a torque constant over R that is right
MORE = 1.25


def fitted(delay=False, **options):
    """Fit an axis whose voltage is the torque's, and the true back-EMF's: eq. (1) with a drive."""
    joint = bf.Joint.preset("motor-axis")
    elements = (replace(joint.elements[0], ratio=RATIO, **options),)
    joint = replace(joint, elements=elements, delay=delay)
    q = 0.9 * np.sin(2 * np.pi * 0.4 * T) + 0.3 * np.sin(2 * np.pi * 1.1 * T + 1)
    speed = RATIO * np.gradient(q, T)
    torque = INERTIA * np.gradient(speed, T) + COULOMB * np.sign(speed) + VISCOUS * speed
    torque += 0.005 * np.random.default_rng(4).standard_normal(T.size)
    volts = R / KT * (torque + MORE * KT**2 / R * speed)
    recording = bf.Recording.from_arrays(
        T,
        q,
        side="joint",
        voltage=volts,
        torque_constant=f"{KT} N m/A",
        resistance=f"{R} ohm",
        name="bench",
    )
    return bf.Model(joint, recording).fit()


@pytest.fixture(scope="module")
def one():
    return fitted()


def test_viscous_loss_takes_up_the_back_emfs_error(one):
    row = one.summary.parameters["motor.viscous"]
    # torque is kt V/R less the nominal back-EMF: the rest of the true one is left in it
    # three sds: an interval of 90 % is to miss it in one recording of ten
    low, high = row.mean - 3.0 * row.sd, row.mean + 3.0 * row.sd
    assert low < VISCOUS + (MORE - 1.0) * KT**2 / R < high
    assert not low < VISCOUS < high


@pytest.mark.parametrize("options", [{}, {"viscous": "by-direction", "delay": True}])
def test_which_numbers_hold_it_is_told(one, options):
    found = fitted(**options) if options else one
    told = found.summary.fit.back_emf
    names = [n for n in found.summary.parameters if "viscous" in n]
    assert list(told.same_as_back_emf) == names
    assert told.nominal == pytest.approx(KT**2 / R)
    assert [a.kind for a in messages_of(found.summary)].count("back-EMF") == 1
