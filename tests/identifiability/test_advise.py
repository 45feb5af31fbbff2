"""The next experiment: predicted sds against closed forms, limits that are kept, the paper's gauge.

Simulated knee, Table 3 of the paper, and a plain axis whose torque is linear.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.identifiability.local import local_information
from bayesfric.identifiability.next_recording import (
    candidates,
    fastest,
    limits_of,
    longest,
    ranking,
    try_out,
)
from bayesfric.identifiability.simulated_recording import HEAVIEST, known_mass, simulate_recording
from bayesfric.mechanism import experiment
from bayesfric.mechanism.element import Load
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.observation import observe
from bayesfric.recordings.source import Processing
from tests.conftest import made_recording
from tests.identifiability.bench import AXIS, CHAIN, KNEE, PERIOD, VALUES, problem

N = 2000


def recorded(torque, *, added_mass=0.0, radius=0.0, name="made-up"):
    """Simulate the knee and prepare it as any recording is."""
    motion = simulate(CHAIN, VALUES, torque, PERIOD, inputs=Inputs(added_mass, radius), substeps=4)
    played = made_recording(
        motion.time, motion.q, torque, PERIOD, name=name, inputs=Inputs(added_mass, radius, name)
    )
    return observe(played, Processing())


def lagged(amplitude=0.8, hertz=1.0):
    time = PERIOD * np.arange(N)
    return experiment.current_loop(experiment.square(time, amplitude, hertz), PERIOD, 0.005)


def ranked(name, *observations, options=None, **given):
    target, point = problem(*observations, **given)
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
    for one in knee.advices:
        assert np.isfinite(one.after.data_sd) == (one.candidate.inputs.added_mass > 0.0)
        assert np.isfinite(one.after.sd)
        assert one.after.sd <= one.after.data_sd * (1.0 + 1e-9)
        # more data never widen a normal posterior
        assert one.after.sd <= knee.now.sd * (1.0 + 1e-9)
    assert knee.advices[0].candidate.kind == "known mass"
    assert knee.determined
    assert knee.worth
    sds = [one.after.sd for one in knee.advices]
    assert sds == sorted(sds)
    assert set(knee.frame["kind"]) == {"excitation", "known mass", "longer"}


def test_a_derived_quantity_is_known_as_well_as_what_it_is_made_of(square):
    """alpha = 1/(1 + mu): at one point its sd is alpha^2 that of mu, by the delta method."""
    name, options = "gearbox.load_drive", AdviceOptions(masses=())
    alpha = 1.0 / (1.0 + KNEE.values[name])
    loss = ranked(name, square, options=options)
    passed = ranked("gearbox.alpha_drive", square, options=options)
    assert passed.value == pytest.approx(alpha, rel=1e-12)
    for one, other in zip(loss.advices, passed.advices, strict=True):
        assert other.after.sd == pytest.approx(alpha**2 * one.after.sd, rel=1e-6)
    assert not loss.determined
    assert {one.after.data_sd for one in loss.advices} == {np.inf}


def test_what_no_scaling_changes_needs_no_mass_and_a_twin_halves_its_variance(square):
    found = ranked("total_drive.inertia", square, options=AdviceOptions(masses=()))
    assert np.isfinite(found.now.data_sd)
    assert all(np.isfinite(one.after.data_sd) for one in found.advices)
    assert found.advices[0].after.sd < found.now.sd
    (twin,) = [one for one in found.advices if one.candidate.kind == "longer"]
    assert twin.after.data_sd == pytest.approx(found.now.data_sd / np.sqrt(2.0), rel=1e-6)


def test_sds_are_those_of_a_linear_model(make_observation):
    """For the plain axis the torque is linear: (X'X/s^2 + Y'Y/s^2 + 1/prior^2)^-1."""
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values, n=600)
    given = {"chain": chain, "values": AXIS.values, "sigma": 0.05}
    options = AdviceOptions(torque_limit=0.6, speed_limit=1e3)
    found = ranked("motor.viscous", o, options=options, **given)

    def columns(o):
        at = o.filter.centres
        sign = np.sign(o.qd[at])
        return np.stack([o.qdd[at], o.qd[at], sign, np.ones(at.size)], axis=1) / 0.05

    values = chain.vector(AXIS.values)
    prior = np.diag([1.0 / p.sd() ** 2 for p in problem(o, **given)[0].priors[:4]])
    limits = limits_of(options, chain, [o], values)
    checked = 0
    for one in found.advices:
        _, tried = try_out(chain, values, o, one.candidate, limits)
        both = np.concatenate([columns(o), columns(tried)])
        told = both.T @ both
        assert one.after.data_sd == pytest.approx(np.sqrt(np.linalg.inv(told)[1, 1]), rel=1e-6)
        whole = np.sqrt(np.linalg.inv(told + prior)[1, 1])
        assert one.after.sd == pytest.approx(whole, rel=1e-6)
        checked += one.candidate.kind == "excitation"
    assert checked > 5


def test_every_limit_is_kept(square):
    options = AdviceOptions(torque_limit=0.7, speed_limit=1.2, angle_limits=(-0.4, 0.9))
    found = ranked("load.inertia", square, options=options)
    assert found.advices
    # the recording there is was faster: one more like it would break the limits, too
    assert square.torque.max() > 0.7
    dropped = [(one.kind, why) for one, why in found.dropped if one.made is not None]
    assert dropped == [("longer", "the torque limit"), ("known mass", "the torque limit")]
    for one in found.advices:
        assert np.abs(one.candidate.command).max() <= 0.7 * (1.0 + 1e-12)
        assert one.candidate.command[-1] == 0.0
        assert one.peak_speed <= 1.2
        assert -0.4 <= one.angles[0] < one.angles[1] <= 0.9
        assert (one.candidate.lowered < 1.0) == bool(one.candidate.because_of)
    assert any(one.candidate.because_of == "the speed limit" for one in found.advices)


def test_what_cannot_move_is_dropped_and_said_so(square):
    """Friction of Table 3 at rest is 0.087 N m + 5.03 N m/(50 alpha_1) = 0.22 N m at the motor."""
    at_rest = 0.087 + 5.03 / 50.0 / 0.7432
    options = AdviceOptions(torque_limit=0.99 * at_rest)
    found = ranked("load.inertia", square, options=options)
    assert found.advices == ()
    assert not found.determined
    assert not found.worth
    reasons = {one.kind: reason for one, reason in found.dropped}
    assert set(reasons) == {"longer", "excitation", "known mass"}
    assert reasons.pop("longer") == "the torque limit"
    assert set(reasons.values()) == {"the joint hardly moves"}
    assert set(found.left_out) == {"the torque limit", "the joint hardly moves"}
    assert found.left_out.total() == len(found.dropped) > 8


def test_a_flat_improper_prior_leaves_no_sd_without_a_mass(square):
    target, point = problem(square)
    local = local_information(target, point)
    flat = SimpleNamespace(sd=lambda: np.inf)
    open_ = SimpleNamespace(
        free=target.free,
        priors=(flat,) * len(target.priors),
        likelihood=target.likelihood,
        noise=target.noise,
        chain_values=target.chain_values,
    )
    options = AdviceOptions(masses=())
    found = ranking(open_, point, local, options, "load.inertia")
    assert found.now.sd == np.inf
    assert {one.after.sd for one in found.advices} == {np.inf}
    assert not found.worth
    with_mass = ranking(open_, point, local, AdviceOptions(), "load.inertia")
    assert np.isfinite(with_mass.advices[0].after.sd)


def test_the_mass_that_is_there_already_is_no_news():
    """Load and mass scale as one where every recording has the same mass."""
    loaded = recorded(1.4 * lagged(), added_mass=2.0, radius=0.35)
    found = ranked("load.inertia", loaded, options=AdviceOptions(masses=()))
    assert set(found.limits.masses) == {Inputs(), Inputs(2.0, 0.35)}
    # what was bolted on once is on hand, and nothing else is guessed
    assert ranked("load.inertia", loaded).limits.masses == found.limits.masses
    for one in found.advices:
        same = one.candidate.inputs.added_mass == 2.0
        assert np.isfinite(one.after.data_sd) == (not same)


def test_a_played_recording_is_prepared_like_a_real_one(square):
    """Play the same torque: the virtual recording is the recording, up to its last digits."""
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


def test_only_what_has_gone_round_has_no_stops(square):
    """A joint that swung, and any slide, may have stops where nothing was recorded."""
    far = replace(square, q=6.3 / np.ptp(square.q) * square.q)
    assert limits_of(AdviceOptions(), CHAIN, [far], VALUES).angles is None
    motor = replace(AXIS.chain().elements[0], motion="linear")
    slide = Joint([motor], load=Load(motion="linear"), offset=True)
    limits = limits_of(AdviceOptions(), slide, [far], slide.vector(AXIS.values))
    assert not limits.held
    assert limits.angles == (far.q.min(), far.q.max())
    wider = AdviceOptions(angle_limits=(-9.0, 9.0))
    assert limits_of(wider, slide, [far], slide.vector(AXIS.values)).angles == (-9.0, 9.0)


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
    assert longest([square, quick]) is square
    told = limits_of(AdviceOptions(duration=1.0, masses=()), CHAIN, [square], VALUES)
    lengths = {
        one.command.size for one in candidates(CHAIN, VALUES, [square], told) if one.made is None
    }
    assert lengths == {1000}


def test_the_recording_itself_keeps_the_limits_that_are_taken_from_it(square):
    """Also where a sample that is not used, a hand's push, was three times as fast."""
    starts, length = square.filter.starts, len(square.filter.taps)
    used = np.zeros(square.qd.size, dtype=bool)
    for first in starts:
        used[first : first + length] = True
    (unused,) = np.nonzero(~used)
    pushed = replace(square, qd=np.where(np.arange(used.size) == unused[0], 99.0, square.qd))
    # and where no output is at the fastest sample
    between = replace(pushed, speed=0.5 * pushed.speed)
    for recording in (square, pushed, between):
        limits = limits_of(AdviceOptions(), CHAIN, [recording], VALUES)
        first = next(iter(candidates(CHAIN, VALUES, [recording], limits)))
        assert first.kind == "longer"
        tried, _ = try_out(CHAIN, VALUES, recording, first, limits)
        assert tried is first


def test_a_joint_that_was_held_is_asked_for_its_own_motion_only(square):
    """Far from where the leg hangs, as a controller alone can keep it."""
    held = replace(square, q=square.q + 2.0)
    limits = limits_of(AdviceOptions(), CHAIN, [held], VALUES)
    assert limits.held
    assert limits.angles == (held.q.min(), held.q.max())
    assert not limits_of(AdviceOptions(), CHAIN, [square], VALUES).held
    fed_back = replace(square, settings=square.settings | {"feedback": "position"})
    assert limits_of(AdviceOptions(), CHAIN, [fed_back], VALUES).held
    forms = {one.form for one in candidates(CHAIN, VALUES, [held], limits)}
    assert forms == {"another recording just like 'made-up'", "the motion of 'made-up' again"}
    # with what is bolted on, its motion asks for the torque of a heavier leg
    (carrying,) = [
        one for one in candidates(CHAIN, VALUES, [held], limits) if one.kind == "known mass"
    ]
    inertia, moment = carrying.inputs.load("rotary")
    more = {"load.inertia": inertia, "load.first_moment": moment}
    heavier = CHAIN.vector({k: v + more.get(k, 0.0) for k, v in KNEE.values.items()})
    expected = inverse_torque(CHAIN, heavier, held.q, held.qd, held.qdd)
    np.testing.assert_allclose(carrying.made.torque, expected, rtol=1e-9, atol=1e-12)
    # which it may be too much for the drive as it was used
    assert carrying.amplitude > limits.torque
    tight = ranked("load.first_moment", held)
    assert [why for _, why in tight.dropped] == ["the torque limit"]
    found = ranked("load.first_moment", held, options=AdviceOptions(torque_limit=20.0))
    assert found.advices[0].candidate.kind == "known mass"
    assert np.isfinite(found.advices[0].after.data_sd)
    assert np.isinf(found.now.data_sd)


def test_what_was_recorded_is_tried_again_with_a_known_mass(square):
    """The cheapest experiment that parts alpha from the leg: bolt it on, run the program again."""
    limits = limits_of(AdviceOptions(), CHAIN, [square], VALUES)
    assert not limits.held
    (bolted,) = [one for one in limits.masses if one.added_mass]
    again = {
        one.form: one
        for one in candidates(CHAIN, VALUES, [square], limits)
        if one.kind == "known mass" and one.form.endswith(" again")
    }
    assert set(again) == {"the torque of 'made-up' again", "the motion of 'made-up' again"}
    played = again["the torque of 'made-up' again"]
    assert (played.inputs, played.lag, played.made) == (bolted, 0.0, None)
    assert played.amplitude <= limits.torque
    longer = next(iter(candidates(CHAIN, VALUES, [square], limits)))
    np.testing.assert_array_equal(played.command, longer.command)
    # it takes no torque that was not there, and determines what no mass leaves open
    found = ranked("load.inertia", square)
    (one,) = [a for a in found.advices if a.candidate.form == played.form]
    assert np.isinf(found.now.data_sd)
    assert np.isfinite(one.after.data_sd)
    # with the mass on the recording already it is what there is, and without it is another
    carried = replace(square, inputs=bolted)
    limits = limits_of(AdviceOptions(), CHAIN, [carried], VALUES)
    masses = {
        one.inputs.added_mass
        for one in candidates(CHAIN, VALUES, [carried], limits)
        if one.form.endswith(" again")
    }
    assert masses == {0.0}


def test_no_mass_is_guessed_for_a_load_that_is_far_heavier(square):
    heavy = CHAIN.vector(
        {k: v * (1e3 if k.startswith("load") else 1) for k, v in KNEE.values.items()}
    )
    assert known_mass(CHAIN, heavy).added_mass == HEAVIEST
    limits = limits_of(AdviceOptions(), CHAIN, [square], heavy)
    assert [one.added_mass for one in limits.masses] == [0.0]


def test_a_mass_is_proposed_that_weighs_about_as_much_as_there_is():
    """Inertia and moment of the leg; of the axis, which has no load, all its inertia."""
    inertia, moment = known_mass(CHAIN, VALUES).load("rotary")
    # both are rounded to two digits
    assert moment == pytest.approx(KNEE.values["load.first_moment"], rel=0.06)
    assert inertia == pytest.approx(KNEE.values["load.inertia"], rel=0.12)
    chain = AXIS.chain()
    inertia, _ = known_mass(chain, chain.vector(AXIS.values)).load("rotary")
    assert inertia == pytest.approx(AXIS.values["motor.inertia"], rel=0.06)


def test_a_stribeck_velocity_on_its_bound_leaves_no_candidate_out():
    """No simulation has a value for a rise at exactly zero; beside it there is one."""
    chain = Joint([replace(AXIS.chain().elements[0], stribeck="either")], offset=True)
    values = AXIS.values | {"motor.stribeck_change": 0.1, "motor.stribeck_velocity": 0.0}
    torque = lagged(amplitude=0.6)
    truth = chain.vector(values | {"motor.stribeck_velocity": 1e-6})
    motion = simulate(chain, truth, torque, PERIOD, substeps=4)
    observed = observe(
        made_recording(motion.time, motion.q, torque, PERIOD, name="slow"), Processing()
    )
    options = AdviceOptions(duration=0.5, masses=())
    found = ranked("motor.viscous", observed, options=options, chain=chain, values=values)
    assert not [why for _, why in found.dropped if "greater than zero" in why]
    assert {one.candidate.kind for one in found.advices} == {"excitation", "longer"}
    assert all(np.isfinite(one.after.sd) for one in found.advices)
