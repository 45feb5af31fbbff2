"""A torque once a turn that gravity does not explain: found where it is, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.checked import check
from bayesfric.estimates.least_squares import least_squares
from bayesfric.estimates.once_a_turn import gravity_like
from bayesfric.mechanism.excitation import current_loop, multisine
from bayesfric.mechanism.forward import simulate
from tests.axis import AXIS, VALUES

RATE, FINE = 500.0, 20
MOTOR = bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True)
ANGLED = replace(AXIS, load=bf.Load(first_moment=True, gravity_angle=True))


def bench(seed, ripple=0.0, phase=1.0, zero=0.0, joint=AXIS):
    """SIMULATED: finely, with a ripple in N m once a turn, and a position whose zero is off."""
    rng = np.random.default_rng(seed)
    step = 1.0 / (RATE * FINE)
    time = np.arange(round(10.0 * RATE) * FINE) * step
    command = 2.0 * multisine(time, 1.0, (0.31, 0.73, 1.37, 2.9, 5.3), seed=seed)
    torque = current_loop(command, step, 0.003)
    term = bf.Term("motor.ripple", lambda m: np.sin(m.position + phase))
    moved = replace(joint, terms=(term,))
    vector = moved.vector({**VALUES, term.name: ripple})
    motion = simulate(moved, vector, torque, step, substeps=1)
    counts = np.round((motion.q[::FINE] - zero) * 4096 / (2 * np.pi))
    noise = 0.05 * rng.standard_normal(counts.size)
    columns = time[::FINE], counts * 2 * np.pi / 4096, torque[::FINE] + noise
    return bf.Recording.from_arrays(*columns, name=f"bench-{seed}")


def test_the_cosine_of_a_ripple_is_found():
    found = bf.Model(AXIS, bench(4, 0.04)).once_a_turn()
    assert found.value == pytest.approx(0.04 * np.sin(1.0), abs=4.0 * found.sd)
    assert found.matters


def test_what_takes_the_cosine_up_is_named_with_what_an_angle_would_change():
    recording = bench(4, 0.04)
    model = bf.Model(AXIS, recording)
    found = model.once_a_turn()
    plain, angled = (least_squares(joint, model.observations) for joint in (AXIS, ANGLED))
    assert set(found.others) == {"motor.inertia", "motor.viscous", "motor.coulomb", "offset"}
    for name, by in found.others.items():
        sd = max(plain[name].sd, plain[name].sd_robust)
        assert by == pytest.approx((plain[name].value - angled[name].value) / sd, abs=1e-6)
    assert "motor.coulomb" in found.moved
    assert all(abs(by) > 0.5 for by in found.moved.values())


def test_a_ripple_in_phase_with_gravity_moves_it_and_shows_nowhere():
    """That is why identify says it of every such joint."""
    model = bf.Model(AXIS, bench(4, 0.04, phase=0.0))
    assert not model.once_a_turn().matters
    row = model.estimate("least-squares").loc["total.gravity"]
    assert row["value"] == pytest.approx(0.3 * 9.80665 + 0.04, abs=4.0 * row["sd"])


def test_a_zero_that_is_off_is_found_and_taken_up_by_a_free_angle():
    recording = bench(4, zero=0.05)
    found = bf.Model(AXIS, recording).once_a_turn()
    assert found.value == pytest.approx(0.3 * 9.80665 * np.sin(0.05), abs=4.0 * found.sd)
    assert found.matters
    assert bf.Model(ANGLED, recording).once_a_turn() is None
    # one that is known is no place for it to hide
    for angle, off in ((0.05, False), (0.0, True)):
        fixed = bf.Model(ANGLED, recording, priors={"load.gravity_angle": angle})
        assert fixed.once_a_turn().matters is off


@pytest.mark.parametrize("seeds", [8, pytest.param(40, marks=pytest.mark.slow)])
def test_no_false_alarm_without_one(seeds):
    shares = []
    for seed in range(seeds):
        found = bf.Model(AXIS, bench(seed)).once_a_turn()
        assert not found.matters
        shares.append(found.value / found.sd)
    # standard normal, were there nothing but noise
    assert abs(np.mean(shares)) < 1.0
    assert 0.4 < np.std(shares) < 1.8


def test_the_packaged_knee_raises_no_alarm():
    from bayesfric.commands.fit import demo_config

    assert not bf.Model.from_config(demo_config()).once_a_turn().matters


def test_a_joint_without_gravity_has_none():
    bare = bf.Joint([MOTOR], offset=True)
    assert bf.Model(bare, bench(4, 0.04)).once_a_turn() is None


def test_a_motor_ripples_at_the_pace_of_gravity_unless_a_gear_slows_the_joint():
    def geared(ratio, **load):
        return bf.Joint([bf.Element("motor", inertia=True, ratio=ratio)], load=bf.Load(**load))

    assert [gravity_like(geared(ratio)) for ratio in (1.0, 0.5, 0.7, 50.0, 1.5)] == [1, 2, 0, 0, 0]
    assert gravity_like(geared(1.0, motion="linear")) == 0


def test_check_says_it():
    model = bf.Model(AXIS, bench(4, 0.04))
    found = check(model)
    (doubt,) = found.as_json()["doubts"]
    assert doubt["kind"] == "once-a-turn"
    (line,) = [line for line in found.text().splitlines() if line.startswith("WARNING")]
    assert "gravity_angle = true mends" in line
    assert "ripple of the motor's torque once a turn" in line
    assert check(bf.Model(AXIS, bench(4))).warnings == ()
