"""Terms that a model lacks are found, and none where none is missing."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.estimates.estimation import Estimation
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.methods import Given
from bayesfric.explain.candidates import Candidate, candidates
from bayesfric.explain.explanation import explain
from bayesfric.explain.ladder import searched
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.presets import PRESETS
from tests.axis import AXIS, VALUES, swing


def keys(ladder):
    return [rung.added.candidate.key for rung in ladder.rungs if rung.added]


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_found_where_nothing_is_missing(make_observation, seed):
    """At most one of twenty by Markov's inequality; in practice far fewer."""
    o = make_observation(AXIS, VALUES, sigma=0.05, n=3000, factor=5, seed=seed)
    assert keys(searched(AXIS, [o], VALUES).climbed()) == []


@pytest.mark.parametrize(
    ("key", "options", "values"),
    [
        (
            ("motor", "viscous", "by-direction"),
            {"viscous": "by-direction"},
            {"motor.viscous_positive": 0.08, "motor.viscous_negative": 0.12},
        ),
        (("motor", "quadratic", "True"), {"quadratic": True}, {"motor.quadratic": 0.02}),
        (
            ("motor", "power", "True"),
            {"power": True},
            {"motor.power": 0.3, "motor.power_exponent": 0.5},
        ),
        (
            ("motor", "stribeck", "True"),
            {"stribeck": True},
            {"motor.stribeck_ratio": 0.5, "motor.stribeck_velocity": 0.4},
        ),
        (
            ("motor", "stribeck", "either"),
            {"stribeck": "either"},
            {"motor.stribeck_change": -0.5, "motor.stribeck_velocity": 0.4},
        ),
        (("motor", "load_loss", "one"), {"load_loss": "one"}, {"motor.load": 0.1}),
    ],
)
def test_what_is_missing_is_found_first(make_observation, key, options, values):
    motor = bf.Element(
        "motor", **({"inertia": True, "coulomb": "symmetric", "viscous": True} | options)
    )
    true = bf.Joint([motor], load=AXIS.load, offset=True)
    known = {name: (VALUES | values)[name] for name in true.names}
    o = make_observation(true, known, sigma=0.02, n=6000, factor=5, amplitude=1.5)
    found = searched(AXIS, [o], VALUES).climbed()
    first = found.rungs[1].added
    same = [first.candidate, *first.others]
    assert key in [c.key for c in same] + [t.candidate.key for t in found.rungs[1].rivals]
    assert found.rungs[1].score.held_out < found.rungs[0].score.held_out
    # and after it nothing
    assert len(found.rungs) == 2


def test_every_candidate_is_the_model_where_it_is_neutral(make_observation):
    """At the values that it is tried at, the torque is that of the model."""
    chain = bf.Joint.preset("rabbit-knee")
    values = PRESETS["rabbit-knee"].values
    o = make_observation(chain, values, n=400)
    expected = inverse_torque(chain, chain.vector(values), o.q, o.qd, o.qdd)
    found = candidates(chain, [o], values)
    assert {c.option for c in found} >= {"power", "stribeck", "load_speed", "spring", "cogging"}
    for c in found:
        again = inverse_torque(c.chain, c.chain.vector(c.point), o.q, o.qd, o.qdd, time=o.stamps)
        np.testing.assert_allclose(again, expected, rtol=1e-12, err_msg=str(c.key))
        assert set(c.new) <= set(c.chain.names)
        assert not set(c.new) & set(chain.names)


def test_cycles_add_up():
    chain = bf.Joint([bf.Element("motor", inertia=True, cogging=(1,))])
    one = Candidate("motor", "cogging", (3,), "", chain, {}, (), 0)
    assert one.added_to(chain).elements[0].choices["cogging"] == (1, 3)
    assert one.setting == "mechanism.elements.motor.cogging = [3]"


def test_of_two_that_do_the_same_the_simpler_is_named(make_observation):
    """A spring that stiffens can be a sine, with two parameters for one."""
    bare = bf.Joint([bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True)])
    true = bf.Joint(bare.elements, load=bf.Load(first_moment=True))
    values = {name: VALUES[name] for name in true.names}
    o = make_observation(true, values, sigma=0.02, n=4000, factor=5, amplitude=0.8)
    found = searched(bare, [o], {name: VALUES[name] for name in bare.names}).climbed()
    assert keys(found)[0] == ("load", "first_moment", "True")


def given(chain, o):
    return Given(chain, [o], Knowledge({}, {}, {}), Estimation(), tuple)


@pytest.mark.parametrize("angle", [0.0, 0.4, 3.0])
def test_gravity_comes_before_a_ripple_once_a_turn(make_observation, angle):
    """A sine and a cosine of the joint's angle are gravity, wherever its zero is."""
    axis = PRESETS["motor-axis"].chain()
    true = replace(axis, load=bf.Load(first_moment=True, gravity_angle=True))
    known = {"motor.inertia": 0.02, "motor.viscous": 0.1, "motor.coulomb": 0.1, "offset": 0.0}
    values = known | {"load.first_moment": 0.05, "load.gravity_angle": angle}
    o = make_observation(true, values, sigma=0.02, n=4000, factor=5, amplitude=15.0)
    (term,) = explain(given(axis, o), known).asked
    assert term.owner == "load"
    assert "first_moment = true" in term.setting
    assert term.presets == ("servo-pendulum",)
    assert any("cogging = [1]" in setting for setting in term.also)


def test_a_ripple_of_a_geared_motor_is_no_gravity(make_observation):
    """Once a turn of the motor is not once a turn of the joint."""
    motor = {"inertia": True, "coulomb": "symmetric", "viscous": True}
    gearbox = bf.Element("gearbox", ratio=7.0)
    bare = bf.Joint([bf.Element("motor", **motor), gearbox])
    true = bf.Joint([bf.Element("motor", **motor, cogging=(1,)), gearbox])
    known = {"motor.inertia": 0.02, "motor.viscous": 0.1, "motor.coulomb": 0.1}
    values = known | {"motor.cogging_sin_1": 0.3, "motor.cogging_cos_1": 0.2}
    o = make_observation(true, values, sigma=0.02, n=4000, factor=5, amplitude=15.0)
    (term,) = explain(given(bare, o), known).asked
    assert (term.owner, term.setting) == ("motor", "mechanism.elements.motor.cogging = [1]")
    assert not any("first_moment" in setting for setting in term.also)
    assert term.presets == ()


def test_a_linear_axis_has_no_gravity_of_an_angle(make_observation):
    linear = {"motion": "linear"}
    axis = bf.Joint([bf.Element("motor", inertia=True, **linear)], load=bf.Load(**linear))
    point = {"motor.inertia": 5.0}
    found = candidates(axis, [make_observation(axis, point)], point)
    assert found
    assert not {c.option for c in found} & {"first_moment", "gravity_angle", "cogging"}


def test_a_richer_choice_that_only_repeats_the_simple_one_is_not_named_beside_it():
    """One mu in both directions: two that come out alike are that one, and no alternative."""
    whole = bf.Joint.preset("servo-pendulum")
    options = {"rate": 200, "duration": 10, "excitation": "multisine", "torque_noise": 0.01}
    made = whole.simulate({"gearbox.load": 0.3}, encoder_side="joint", **options)
    bare = replace(whole, elements=tuple(replace(e, load_loss="none") for e in whole.elements))
    one = bf.Recording.from_dataframe(made, time="time", position="position", torque="torque")
    (term,) = bf.Model(bare, one).explain().asked
    # where it is, motor or gearbox, nothing tells
    assert {term.setting, *term.also} == {
        'mechanism.elements.gearbox.load_loss = "one"',
        'mechanism.elements.motor.load_loss = "one"',
    }


@pytest.mark.parametrize("late", [0.0, 0.008])
def test_a_position_that_comes_late_with_and_without_terms_is_said(late):
    """SIMULATED, a viscous loss by direction besides: with it the delay is still there."""
    time = np.arange(0.0, 30.0, 0.005)
    q, qd, qdd = swing(time, [(0.31, 0.9), (0.73, 0.5), (1.9, 0.15)])
    ends = swing(time - late, [(0.31, 0.9), (0.73, 0.5), (1.9, 0.15)])[0]
    of = VALUES
    torque = of["motor.inertia"] * qdd + of["motor.coulomb"] * np.sign(qd) + of["offset"]
    torque += np.where(qd > 0.0, 1.3, 0.7) * of["motor.viscous"] * qd
    torque += 9.81 * of["load.first_moment"] * np.sin(q)
    torque += 0.01 * np.random.default_rng(3).standard_normal(time.size)
    found = bf.Model(AXIS, bf.Recording.from_arrays(time, ends, torque)).explain()
    assert 'mechanism.elements.motor.viscous = "by-direction"' in {t.setting for t in found.asked}
    _, after = found.late
    if late:
        assert after.value == pytest.approx(late, abs=4.0 * after.sd)
    else:
        assert after is None


def test_a_second_load_loss_is_not_offered(make_observation):
    """One behind the other, they could be told apart only as a difference that no joint has."""
    chain = bf.Joint.preset("servo-pendulum")
    values = PRESETS["servo-pendulum"].values
    o = make_observation(chain, values, n=400)
    found = {(c.owner, c.option) for c in candidates(chain, [o], values)}
    assert ("motor", "load_loss") not in found
    # a richer one where one is
    assert ("gearbox", "load_loss") in found
    # of a joint without any, in either place, but not in both
    bare = replace(chain, elements=tuple(replace(e, load_loss="none") for e in chain.elements))
    without = {name: values[name] for name in bare.names}
    search = searched(bare, [make_observation(chain, values, n=2000, factor=5)], without)
    places = {"motor", "gearbox"}
    both = [c.owner for c in search.found if c.option == "load_loss"]
    assert set(both) == places
    one = next(t for t in search.beside([]) if t.candidate.option == "load_loss")
    assert not [t for t in search.beside([one]) if t.candidate.option == "load_loss"]


def test_of_terms_about_as_good_the_simpler_is_asked_for(make_observation):
    """A small angle of gravity in a small motion is all but a constant torque, as any joint has."""
    bare = replace(AXIS, offset=False)
    true = replace(bare, load=bf.Load(first_moment=True, gravity_angle=True))
    known = {name: (VALUES | {"load.gravity_angle": 0.003})[name] for name in true.names}
    o = make_observation(true, known, sigma=0.03, n=4000, factor=5, amplitude=0.5, seed=3)
    (term,) = explain(given(bare, o), {name: known[name] for name in bare.names}).asked
    assert (term.setting, term.table, term.line) == (
        "mechanism.offset = true", "mechanism", "offset = true",
    )  # fmt: skip
    # which fits a little better
    (rival,) = [one for one in term.rivals if "gravity_angle" in one.setting]
    assert rival.evidence > term.evidence
    # of fewer numbers before that
    trials = searched(bare, [o], {name: known[name] for name in bare.names}).beside([])
    one = {t.candidate.option: t.richness for t in trials}
    assert one["offset"] < one["gravity_angle"] < one["cogging"]
