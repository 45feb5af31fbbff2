"""The next experiment: predicted sds against closed forms, limits that are kept, the paper's gauge.

Simulated knee, Table 3 of the paper, and a plain axis whose torque is linear.
"""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.identifiability.local import local_information
from bayesfric.identifiability.next_recording import (
    HEAVIEST,
    candidates,
    fastest,
    known_mass,
    limits_of,
    ranking,
    simulate_recording,
    try_out,
)
from bayesfric.mechanism import experiment
from bayesfric.mechanism.element import Load
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing
from tests.conftest import made_recording
from tests.identifiability.bench import AXIS, CHAIN, KNEE, PERIOD, VALUES, problem

N = 2000


def recorded(torque, *, added_mass=0.0, radius=0.0, name="made-up"):
    """Simulate the knee and prepare it as any recording is."""
    inputs = Inputs(added_mass, radius, name)
    motion = simulate(CHAIN, VALUES, torque, PERIOD, inputs=inputs, substeps=4)
    raw = made_recording(motion.time, motion.q, torque, PERIOD, name=name, inputs=inputs)
    return observe(raw, Processing())


def lagged(amplitude=0.8, hertz=1.0):
    time = PERIOD * np.arange(N)
    return experiment.current_loop(experiment.square(time, amplitude, hertz), PERIOD, 0.005)


def ranked(name, *observations, options=None, **more):
    target, point = problem(*observations, **more)
    local = local_information(target, point)
    return ranking(target, point, local, options or AdviceOptions(), name)


@pytest.fixture(scope="module")
def square():
    return recorded(lagged())


@pytest.fixture(scope="module")
def knee(square):
    return ranked("gearbox.alpha_drive", square)


def test_only_a_known_mass_lifts_the_scale(knee):
    """Leg and alpha scale together whatever torque is played (section 4.2 of the paper)."""
    assert knee.now.data_sd == np.inf
    for row in knee.candidates:
        assert np.isfinite(row.after.data_sd) == (row.inputs.added_mass > 0.0)
        assert np.isfinite(row.after.sd)
        assert row.after.sd <= row.after.data_sd * (1.0 + 1e-9)
        # more data never widen a normal posterior
        assert row.after.sd <= knee.now.sd * (1.0 + 1e-9)
    assert knee.candidates[0].kind == "known mass"
    assert knee.determined
    assert knee.worth
    sds = [row.after.sd for row in knee.candidates]
    assert sds == sorted(sds)
    assert set(knee.frame["kind"]) == {"excitation", "known mass", "longer"}


def test_a_derived_quantity_is_known_as_well_as_what_it_is_made_of(square):
    """alpha = 1/(1 + mu): at one point its sd is alpha^2 that of mu, by the delta method."""
    name, options = "gearbox.load_drive", AdviceOptions(masses=())
    alpha = 1.0 / (1.0 + KNEE.values[name])
    loss = ranked(name, square, options=options)
    passed = ranked("gearbox.alpha_drive", square, options=options)
    assert passed.value == pytest.approx(alpha, rel=1e-12)
    for row, other in zip(loss.candidates, passed.candidates, strict=True):
        assert other.after.sd == pytest.approx(alpha**2 * row.after.sd, rel=1e-6)
    assert not loss.determined
    assert {row.after.data_sd for row in loss.candidates} == {np.inf}


def test_a_recording_just_like_it_halves_the_variance_of_what_no_scaling_changes(square):
    advice = ranked("total_drive.inertia", square, options=AdviceOptions(masses=()))
    assert np.isfinite(advice.now.data_sd)
    assert all(np.isfinite(row.after.data_sd) for row in advice.candidates)
    assert advice.candidates[0].after.sd < advice.now.sd
    (again,) = [row for row in advice.candidates if row.kind == "longer"]
    assert again.after.data_sd == pytest.approx(advice.now.data_sd / np.sqrt(2.0), rel=1e-6)


def test_sds_are_those_of_a_linear_model(make_observation):
    """For the plain axis the torque is linear: (X'X/s^2 + Y'Y/s^2 + 1/prior^2)^-1."""
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values, n=600)
    setup = {"chain": chain, "values": AXIS.values, "sigma": 0.05}
    options = AdviceOptions(torque_limit=0.6, speed_limit=1e3)
    advice = ranked("motor.viscous", o, options=options, **setup)

    def columns(o):
        at = o.filter.centres
        sign = np.sign(o.qd[at])
        return np.stack([o.qdd[at], o.qd[at], sign, np.ones(at.size)], axis=1) / 0.05

    values = chain.vector(AXIS.values)
    prior = np.diag([1.0 / p.sd() ** 2 for p in problem(o, **setup)[0].priors[:4]])
    limits = limits_of(options, chain, [o], values)
    for row in advice.candidates:
        _, tried = try_out(chain, values, o, row, limits)
        both = np.concatenate([columns(o), columns(tried)])
        exact = [np.linalg.inv(both.T @ both + p)[1, 1] ** 0.5 for p in (0.0 * prior, prior)]
        assert [row.after.data_sd, row.after.sd] == pytest.approx(exact, rel=1e-6)
    assert sum(row.kind == "excitation" for row in advice.candidates) > 5


def test_every_limit_is_kept(square):
    options = AdviceOptions(torque_limit=0.7, speed_limit=1.2, angle_limits=(-0.4, 0.9))
    advice = ranked("load.inertia", square, options=options)
    assert advice.candidates
    # the recording there is had more torque: another just like it is left out
    dropped = [(row.kind, why) for row, why in advice.dropped if row.made is not None]
    assert dropped == [("longer", "the torque limit"), ("known mass", "the torque limit")]
    for row in advice.candidates:
        assert np.abs(row.command).max() <= 0.7 * (1.0 + 1e-12)
        assert row.command[-1] == 0.0
        assert row.peak_speed <= 1.2
        assert -0.4 <= row.angles[0] < row.angles[1] <= 0.9
        assert (row.lowered < 1.0) == bool(row.because_of)
    assert any(row.because_of == "the speed limit" for row in advice.candidates)


def test_candidates_that_cannot_move_are_dropped(square):
    """Friction of Table 3 at rest is 0.087 N m + 5.03 N m/(50 alpha_1) = 0.22 N m at the motor."""
    at_rest = 0.087 + 5.03 / 50.0 / 0.7432
    advice = ranked("load.inertia", square, options=AdviceOptions(torque_limit=0.99 * at_rest))
    assert advice.candidates == ()
    assert not advice.determined
    assert not advice.worth
    reasons = {(row.kind, reason) for row, reason in advice.dropped}
    assert reasons >= {("longer", "the torque limit"), ("excitation", "the joint hardly moves")}
    assert set(advice.left_out) == {"the torque limit", "the joint hardly moves"}
    assert advice.left_out.total() == len(advice.dropped) > 8


def test_the_mass_of_every_recording_determines_nothing():
    """Load and mass scale as one where every recording has the same mass."""
    loaded = recorded(1.4 * lagged(), added_mass=2.0, radius=0.35)
    advice = ranked("load.inertia", loaded, options=AdviceOptions(masses=()))
    assert set(advice.limits.masses) == {Inputs(), Inputs(2.0, 0.35)}
    # no other mass is proposed
    assert ranked("load.inertia", loaded).limits.masses == advice.limits.masses
    for row in advice.candidates:
        same = row.inputs.added_mass == 2.0
        assert np.isfinite(row.after.data_sd) == (not same)


def test_a_simulated_recording_is_prepared_like_a_measured_one(square):
    """Of the same torque it is that recording, up to its last digits."""
    again = simulate_recording(CHAIN, VALUES, square, square.torque, Inputs(), (0.0, 0.0))
    np.testing.assert_array_equal(again.filter.starts, square.filter.starts)
    np.testing.assert_allclose(again.qdd, square.qdd, atol=1e-9 * np.abs(square.qdd).max())
    np.testing.assert_array_equal(again.measured, square.measured)


def test_bad_names_and_limits_are_refused(square):
    with pytest.raises(BadInput, match=r"is fixed at 0\.206"):
        ranked("load.inertia", square, texts={"load.inertia": 0.206})
    fixed = {name: KNEE.values[name] for name in ("gearbox.load_drive", "gearbox.load_back")}
    with pytest.raises(BadInput, match="fixed values only"):
        ranked("gearbox.alpha_drive", square, texts=fixed)
    with pytest.raises(BadInput, match=r"advice\.masses\.1\.radius"):
        ranked("load.inertia", square, options=AdviceOptions(masses=({"mass": 2.0},)))
    with pytest.raises(BadInput, match=r"advice\.angle_limits"):
        ranked("load.inertia", square, options=AdviceOptions(angle_limits=(0.5, 0.9)))


def test_limits_left_out_come_from_the_recordings(square):
    quick = replace(square, qd=2.0 * square.qd)
    limits = limits_of(AdviceOptions(), CHAIN, [square, quick], VALUES)
    assert limits.torque == np.abs(square.measured).max()
    assert limits.speed == pytest.approx(2.4 * fastest(square))
    # reversals are not used, and what lies between outputs is
    assert np.abs(square.speed).max() <= fastest(square) <= np.abs(square.qd).max()
    assert limits.angles == (square.q.min(), square.q.max())
    assert limits.start == 0.0
    # no longer than what was recorded; trimming takes a little off its ends
    assert 0.95 * N * PERIOD < limits.duration <= N * PERIOD
    short = limits_of(AdviceOptions(duration=1.0, masses=()), CHAIN, [square], VALUES)
    every = candidates(CHAIN, VALUES, [square], short)
    assert {row.command.size for row in every if row.made is None} == {1000}
    # a joint that swung, and any slide, may have stops where nothing was recorded
    far = replace(square, q=6.3 / np.ptp(square.q) * square.q)
    assert limits_of(AdviceOptions(), CHAIN, [far], VALUES).angles is None
    motor = replace(AXIS.chain().elements[0], motion="linear")
    slide = Joint([motor], load=Load(motion="linear"), offset=True)
    for wanted, angles in ((None, (far.q.min(), far.q.max())), ((-9.0, 9.0),) * 2):
        options = AdviceOptions(angle_limits=wanted)
        assert limits_of(options, slide, [far], slide.vector(AXIS.values)).angles == angles


def test_the_recording_itself_keeps_the_limits_that_are_taken_from_it(square):
    """Also where a sample that is not used, a hand's push, was three times as fast."""
    windows = square.filter.starts[:, None] + np.arange(len(square.filter.taps))
    unused = np.setdiff1d(np.arange(square.qd.size), windows)[0]
    pushed = replace(square, qd=np.where(np.arange(square.qd.size) == unused, 99.0, square.qd))
    for recording in (square, pushed):
        limits = limits_of(AdviceOptions(), CHAIN, [recording], VALUES)
        first = next(iter(candidates(CHAIN, VALUES, [recording], limits)))
        assert first.kind == "longer"
        assert try_out(CHAIN, VALUES, recording, first, limits)[0] is first


def test_a_joint_that_was_held_repeats_its_own_motion_only(square):
    """Far from where the leg hangs, as a controller alone can keep it."""
    held = replace(square, q=square.q + 2.0)
    limits = limits_of(AdviceOptions(), CHAIN, [held], VALUES)
    assert limits.held
    assert limits.angles == (held.q.min(), held.q.max())
    assert not limits_of(AdviceOptions(), CHAIN, [square], VALUES).held
    fed_back = replace(square, settings=square.settings | {"feedback": "position"})
    assert limits_of(AdviceOptions(), CHAIN, [fed_back], VALUES).held
    longer, carrying = candidates(CHAIN, VALUES, [held], limits)
    assert (longer.kind, carrying.kind) == ("longer", "known mass")
    # with a mass its motion needs the torque of a heavier leg
    inertia, moment = carrying.inputs.load("rotary")
    more = {"load.inertia": inertia, "load.first_moment": moment}
    heavier = CHAIN.vector({k: v + more.get(k, 0.0) for k, v in KNEE.values.items()})
    expected = inverse_torque(CHAIN, heavier, held.q, held.qd, held.qdd)
    np.testing.assert_allclose(carrying.made.torque, expected, rtol=1e-9, atol=1e-12)
    # which may be more than the drive gave
    tight = ranked("load.first_moment", held)
    assert [why for _, why in tight.dropped] == ["the torque limit"]
    advice = ranked("load.first_moment", held, options=AdviceOptions(torque_limit=20.0))
    assert advice.candidates[0].kind == "known mass"
    assert np.isinf(advice.now.data_sd) > np.isinf(advice.candidates[0].after.data_sd)


def test_the_recorded_torque_is_tried_again_with_a_known_mass(square):
    """The cheapest experiment that distinguishes alpha and leg."""
    limits = limits_of(AdviceOptions(), CHAIN, [square], VALUES)
    longer, *others = candidates(CHAIN, VALUES, [square], limits)
    (played,) = [row for row in others if row.form == "the torque of 'made-up' again"]
    assert played.inputs.added_mass
    assert (played.lag, played.made) == (0.0, None)
    assert played.amplitude <= limits.torque
    np.testing.assert_array_equal(played.command, longer.command)
    # it determines what no mass leaves open
    advice = ranked("load.inertia", square)
    (row,) = [a for a in advice.candidates if a.form == played.form]
    assert np.isinf(advice.now.data_sd) > np.isinf(row.after.data_sd)
    # a recording that has the mass is repeated without it
    carried = replace(square, inputs=played.inputs)
    limits = limits_of(AdviceOptions(), CHAIN, [carried], VALUES)
    every = candidates(CHAIN, VALUES, [carried], limits)
    assert {row.inputs.added_mass for row in every if row.form.endswith(" again")} == {0.0}


def test_a_mass_is_proposed_that_weighs_about_as_much_as_there_is(square):
    """Inertia and moment of the leg; of the axis, which has no load, all its inertia."""
    inertia, moment = known_mass(CHAIN, VALUES).load("rotary")
    # both are rounded to two digits
    assert moment == pytest.approx(KNEE.values["load.first_moment"], rel=0.06)
    assert inertia == pytest.approx(KNEE.values["load.inertia"], rel=0.12)
    chain = AXIS.chain()
    inertia, _ = known_mass(chain, chain.vector(AXIS.values)).load("rotary")
    assert inertia == pytest.approx(AXIS.values["motor.inertia"], rel=0.06)
    # and none for a load that is far heavier than can be bolted on
    factors = {name: 1e3 if name.startswith("load") else 1.0 for name in KNEE.values}
    heavy = CHAIN.vector({name: x * factors[name] for name, x in KNEE.values.items()})
    assert known_mass(CHAIN, heavy).added_mass == HEAVIEST
    limits = limits_of(AdviceOptions(), CHAIN, [square], heavy)
    assert [row.added_mass for row in limits.masses] == [0.0]


def test_a_stribeck_velocity_on_its_bound_leaves_no_candidate_out():
    """No simulation has a value for a rise at exactly zero; near it there is one."""
    chain = Joint([replace(AXIS.chain().elements[0], stribeck="either")], offset=True)
    values = AXIS.values | {"motor.stribeck_change": 0.1, "motor.stribeck_velocity": 0.0}
    torque = lagged(amplitude=0.6)
    truth = chain.vector(values | {"motor.stribeck_velocity": 1e-6})
    motion = simulate(chain, truth, torque, PERIOD, substeps=4)
    observed = observe(
        made_recording(motion.time, motion.q, torque, PERIOD, name="slow"), Processing()
    )
    options = AdviceOptions(duration=0.5, masses=())
    advice = ranked("motor.viscous", observed, options=options, chain=chain, values=values)
    assert not [why for _, why in advice.dropped if "greater than zero" in why]
    assert {row.kind for row in advice.candidates} == {"excitation", "longer"}
    assert all(np.isfinite(row.after.sd) for row in advice.candidates)
