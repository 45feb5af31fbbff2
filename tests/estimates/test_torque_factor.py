"""A known value or mass that contradicts the torque says by which factor this is wrong."""

from dataclasses import replace

import pytest

import bayesfric as bf
from bayesfric.estimates.torque_factor import torque_factor

# A SIMULATED servo pendulum whose recorded torque is so many times what it was.
FULL = bf.Joint.preset("servo-pendulum")
LOSSLESS = replace(FULL, elements=tuple(replace(e, load_loss="none") for e in FULL.elements))
OPTIONS = {"rate": 250, "duration": 8.0, "excitation": "multisine", "torque_noise": 0.01}


def factor(joint, times, masses, **more):
    recordings = []
    for seed, kg in enumerate(masses):
        added = {"added_mass": kg, "radius": 0.1} if kg else {}
        made = replace(joint, gain=False).simulate(
            {}, amplitude=1.0, seed=seed + 1, **added, **OPTIONS
        )
        t, q, torque = (made[name].to_numpy() for name in ("time", "position", "torque"))
        one = bf.Recording.from_arrays(t, q, times * torque, name=f"run{seed}", **added)
        recordings.append(one)
    model = bf.Model(joint, recordings, **more)
    (found,) = model.estimates(["input-error"])
    return torque_factor(model.evidence, dict(found.point))


@pytest.mark.parametrize("joint", [FULL, LOSSLESS], ids=["loss", "no loss"])
@pytest.mark.parametrize("times", [1.0, 1.3])
def test_a_known_mass_tells_the_factor(joint, times):
    found = factor(joint, times, (0.0, 0.3))
    assert found.masses == (0.3,)
    # the noise's own 4 sds, and what encoder and filters do to an inertia
    assert abs(found.value - times) < 4.0 * found.sd + 0.005
    assert found.matters == (times > 1.0)


@pytest.mark.parametrize("times", [1.0, 0.7])
def test_a_fixed_inertia_tells_the_factor(times):
    # that of the simulation, see bayesfric.mechanism.presets
    found = factor(FULL, times, (0.0,), priors={"motor.inertia": 0.002})
    assert found.fixed == ("motor.inertia",)
    assert abs(found.value - times) < 4.0 * found.sd + 0.005
    assert found.matters == (times < 1.0)


def test_nothing_known_or_a_gain_that_is_fitted_tells_none():
    assert factor(FULL, 1.3, (0.0,)) is None
    # no torque has a scale from an angle, nor from a loss per torque, nor from what is zero
    known = {"load.gravity_angle": 0.02, "gearbox.load": 0.2, "motor.viscous": 0.0}
    assert factor(FULL, 1.3, (0.0,), priors=known) is None
    fixed = {"motor.inertia": 0.002}
    assert factor(replace(FULL, gain=True), 1.3, (0.0,), priors=fixed) is None
