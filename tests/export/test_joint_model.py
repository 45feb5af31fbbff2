"""Numbers of a simulator's joint: exact where it can express the law, nearest where it cannot."""

import io
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.export.exported import lost_terms
from bayesfric.export.formats import body_of, formats
from bayesfric.export.joint_model import (
    LOSSES,
    NUMBERS,
    Trajectory,
    exact_numbers,
    simulated_torque,
    simulator_numbers,
    standstill_friction,
    torque_along,
)
from bayesfric.export.point_estimate import representative_draw
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import CHOICES, LOAD_CHOICES
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.measurement import AT_ROOM, Inputs

from .made import finished_posterior, numbers, posterior_of, preset


def sine_motion(n=300):
    t = np.linspace(0.0, 6.0, n)
    q, qd, qdd = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
    return [Trajectory(q, qd, qdd, t, Inputs())]


def test_a_chain_without_load_dependent_friction_is_exact():
    joint = Joint(
        elements=(
            Element("motor", ratio=3.0, inertia=True, coulomb="symmetric", viscous=True),
            Element("belt", ratio=7.0, inertia=True, quadratic=True, coulomb="symmetric"),
        ),
        load=Load(inertia=True, first_moment=True, gravity_angle=True, spring="stiffening"),
        offset=True,
        gain=True,
    )
    values = np.random.default_rng(1).uniform(0.1, 2.0, (5, len(joint.names)))
    # what is known of the load is on a simulator's, too
    motions = [replace(m, inputs=Inputs(added_mass=1.5, radius=0.3)) for m in sine_motion()]
    exported = simulator_numbers(joint, values, motions, NUMBERS)
    expected = torque_along(joint, values, motions)
    np.testing.assert_allclose(simulated_torque(joint, exported, motions), expected, rtol=1e-10)
    # in the closed form: inertia times the square of the ratios before it
    column = dict(zip(joint.names, values.T, strict=True))
    armature = column["motor.inertia"] * 21.0**2 + column["belt.inertia"] * 7.0**2
    np.testing.assert_allclose(exported["armature"], armature)
    np.testing.assert_allclose(exported["quadratic"], column["belt.quadratic"] * 7.0**3)


LAWS = {
    "load-dependent friction": {"load_loss": "two"},
    "by direction": {"coulomb": "by-direction", "viscous": "by-direction"},
    "Stribeck": {"coulomb": "symmetric", "viscous": True, "stribeck": True},
    "power": {"power": True},
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("losses", [("friction", "damping", "quadratic"), ("damping",)])
def test_no_other_losses_are_nearer_to_the_law(law, losses):
    """Least squares over the recorded motion, none below zero, by steps in every direction."""
    joint = Joint(
        elements=(Element("motor", inertia=True, **LAWS[law]),),
        load=Load(inertia=True, first_moment=True),
    )
    given = {"stribeck_velocity": 0.6, "power_exponent": 0.5}
    given |= {"coulomb_negative": 0.5, "load_back": 0.4}
    values = {name: given.get(name.rpartition(".")[2], 0.2) for name in joint.names}
    vector, motions = joint.vector(values)[None], sine_motion()
    carried = {*NUMBERS} - {*LOSSES} | {*losses}
    exported = simulator_numbers(joint, vector, motions, carried)
    law_torque = torque_along(joint, vector, motions)

    def error(numbers):
        difference = numbers["gain"][:, None] * (
            simulated_torque(joint, numbers, motions) - law_torque
        )
        return float(np.sum(difference**2))

    smallest = error(exported)
    for name in LOSSES:
        assert exported[name][0] >= 0.0
        assert name in losses or exported[name][0] == 0.0
    for name in losses:
        for step in (-1e-4, 1e-4):
            moved = exported | {name: exported[name] + step}
            assert error(moved) > smallest or moved[name][0] < 0.0


def test_static_friction_is_the_law_as_speed_vanishes():
    elements = (
        Element("motor", ratio=4.0, inertia=True, coulomb="symmetric", stribeck=True),
        Element("gearbox", ratio=5.0, load_loss="two"),
    )
    joint = Joint(elements=elements, load=Load(inertia=True, first_moment=True))
    values = dict.fromkeys(joint.names, 0.1)
    values |= {"motor.coulomb": 0.2, "motor.stribeck_ratio": 0.5}
    values |= {"gearbox.load_drive": 0.3, "gearbox.load_back": 0.1}
    vector = joint.vector(values)[None]
    # (mu_1 + mu_2)/2 of the weight at the motor, whichever way it acts
    (motion,) = sine_motion()
    weight = np.abs(0.1 * joint.load.gravity * np.sin(motion.q)).mean() / 20.0
    expected = 0.2 * 1.5 + 0.5 * (0.3 + 0.1) * weight
    assert standstill_friction(joint, vector, [motion])[0] == pytest.approx(expected)
    exported = simulator_numbers(joint, vector, [motion], formats()["isaac"].carried)
    assert exported["static_friction"][0] == pytest.approx(20.0 / 1.1 * expected)


@pytest.mark.slow
def test_an_open_scale_changes_no_export():
    run = finished_posterior("rabbit-knee")
    joint, values = preset("rabbit-knee")
    vector = joint.vector(values)
    (scaling,) = scalings(joint)
    scaled = dict(zip(joint.names, scaling.scaled(vector, 1.1), strict=True))
    other = posterior_of(joint, scaled, 0.6, open_scale=True, spread=0.0)
    exact = posterior_of(joint, values, 0.6, open_scale=True, spread=0.0)
    first, second = (numbers(bf.export(x, "csv")) for x in (exact, other))
    assert first == pytest.approx(second, rel=1e-9)
    text = bf.export(run, "mujoco").text()
    assert "load.inertia" in text.partition("leave one scale")[2].partition("may all be")[0]
    # where the scale is known the link keeps its inertia, and the gain has the mean loss
    known = posterior_of(joint, values, 0.6, spread=0.0)
    rows = numbers(bf.export(known, "csv"))
    drive, back = (values[f"gearbox.load_{x}"] for x in ("drive", "back"))
    assert rows["link_inertia"] == pytest.approx(values["load.inertia"])
    assert rows["gain"] == pytest.approx(50.0 / (1.0 + 0.5 * (drive - back)))


CASES = [
    *(("motor", option, choice) for option, (known, _) in CHOICES.items() for choice in known),
    *(("load", option, choice) for option, (known, _) in LOAD_CHOICES.items() for choice in known),
    ("motor", "cogging", (3,)),
    ("motor", "periodic_friction", (2,)),
]


@pytest.mark.parametrize(("bearer", "option", "choice"), CASES)
def test_every_choice_of_the_table_has_a_number_or_is_listed_as_lost(bearer, option, choice):
    """What is added to the table later must not be dropped without a word."""
    chosen = {option: choice}
    if option == "stribeck_exponent":
        chosen |= {"stribeck": True}
    if option.startswith("load_") and option != "load_loss":
        chosen |= {"load_loss": "two"}
    if option == "gravity_angle":
        chosen |= {"first_moment": True}
    of_load = {"inertia": True, **(chosen if bearer == "load" else {"first_moment": True})}
    element = Element("motor", **{"inertia": True, **(chosen if bearer == "motor" else {})})
    joint = Joint(elements=(element,), load=Load(**of_load))
    values = np.full((1, len(joint.names)), 0.3)
    motions = [replace(m, inputs=AT_ROOM) for m in sine_motion()]
    without = exact_numbers(joint, values)
    shapes = {"stribeck_velocity", "stribeck_exponent", "power_exponent", "warming_time"}
    lost = {
        name
        for row in lost_terms(joint, formats()["mujoco"], values[0], motions)[0]
        for name in row["parameters"]
    }
    for k, p in enumerate(joint.parameters):
        if p.quantity in shapes or p.name in lost:
            continue
        values[:, k] = 0.6
        changed = exact_numbers(joint, values)
        values[:, k] = 0.3
        assert any(not np.array_equal(changed[name], without[name]) for name in NUMBERS), p.name


@pytest.mark.parametrize("name", ["urdf", "drake", "mujoco"])
def test_folding_keeps_the_inertia_of_a_joint_alone(name):
    joint, values = preset("rabbit-knee")
    vector = joint.vector(values)[None]
    exported = simulator_numbers(joint, vector, sine_motion(), formats()[name].carried)
    exact = exact_numbers(joint, vector)
    total = exact["armature"] + exact["link_inertia"]
    np.testing.assert_allclose(exported["armature"] + exported["link_inertia"], total)


@pytest.mark.parametrize(("inertia", "moment", "angle"), [(0.2, 0.4, 0.3), (0.0, 0.05, 0.0)])
def test_the_body_has_inertia_and_first_moment(inertia, moment, angle):
    names = ("link_inertia", "armature", "link_moment", "link_gravity_angle")
    body = body_of(dict(zip(names, (inertia, 0.01, moment, angle), strict=True)), rotary=True)
    distance = np.hypot(body["com"][0], body["com"][2])
    assert body["mass"] * distance == pytest.approx(moment)
    about = body["about_axis"] + body["mass"] * distance**2
    assert about + body["armature"] == pytest.approx(inertia + 0.01)
    assert 2.0 * body["across"] >= body["about_axis"] > 0.0  # a body can have it
    assert body["armature"] > 0.0
    # a pendulum has at least the inertia of its mass at its distance
    lightest = moment**2 / (inertia or 0.01)
    assert lightest < body["mass"] < (2.01 if inertia else 1.25) * lightest


@pytest.mark.parametrize("rotary", [True, False])
@pytest.mark.parametrize("inertia", [0.0, 0.2])
def test_a_rotors_inertia_stays_the_rotors_where_no_link_has_weight(rotary, inertia):
    names = dict.fromkeys(("link_moment", "link_gravity_angle"), 0.0)
    body = body_of(names | {"armature": 95.0, "link_inertia": inertia}, rotary)
    assert body["armature"] == pytest.approx(95.0, rel=0.0 if inertia else 2e-3)
    assert body["armature"] + body["inertia"] == pytest.approx(95.0 + inertia, rel=1e-12)
    assert body["mass"] > 0.0
    assert 2.0 * body["across"] >= body["about_axis"] > 0.0


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"to": "mojoco"}, "did you mean 'mujoco'"),
        ({"to": "urdf", "into": "leg.xml"}, "--into"),
        ({"to": "csv", "draws": 1000}, "--draws"),
        ({"to": "csv", "draws": 0}, "--draws"),
        ({"to": "mujoco", "joint": 'a"b'}, "--joint"),
    ],
)
def test_impossible_options_are_refused(options, key):
    with pytest.raises(BadInput, match=key):
        bf.export(finished_posterior("motor-axis"), **options)


def test_the_table_of_draws_has_units_and_parameters():
    run = finished_posterior("motor-axis")
    exported = bf.export(run, "csv", draws=20)
    table = pd.read_csv(io.StringIO(exported.main))
    assert len(table) == 20
    np.testing.assert_allclose(table["friction [N m]"], table["motor.coulomb [N m]"])
    offset = run.values(run.picked(20))[:, run.joint.names.index("offset")]
    np.testing.assert_array_equal(table["offset [N m]"], offset)
    assert bf.export(run, "csv", draws=20).main == exported.main


def test_a_draw_is_exported_where_medians_do_not_fit_together():
    """Rotor and link inertia of which only the sum is known: their medians sum up to less."""
    joint = Joint(
        elements=(Element("motor", inertia=True), Element("belt", inertia=True)),
        load=Load(inertia=True),
    )
    shares = np.random.default_rng(4).dirichlet([0.2, 0.2, 0.2], 400)
    medians = np.median(shares, axis=0)
    assert medians.sum() < 0.7
    draw = representative_draw(joint, shares, medians, sine_motion())
    assert draw.sum() == pytest.approx(1.0)
    assert (shares == draw).all(axis=1).any()
    # where each parameter is identified, the medians are it
    known = np.random.default_rng(5).normal(1.0, 0.01, (400, 3))
    assert representative_draw(joint, known, np.median(known, axis=0), sine_motion()) is None


def test_a_run_of_any_name_ends_no_comment():
    run = replace(finished_posterior("motor-axis"), name='a-->b*/c"""d\\e\nf')
    ElementTree.fromstring(bf.export(run, "mujoco").main)
    ElementTree.fromstring(bf.export(run, "urdf").main)
    for text in (bf.export(run, "python").main, *bf.export(run, "isaac").files.values()):
        assert "a- ->b* /c'''d/e" in text
    compile(bf.export(run, "python").main, "feedforward.py", "exec")
    assert bf.export(run, "c").files["joint_feedforward.h"].count("*/") == 1


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"verdict": "prior"}, "unidentified"),
        ({"verdict": "weak", "undoubted": "data", "doubted": ["delay"]}, "doubtful"),
    ],
)
@pytest.mark.parametrize("form", ["mujoco", "c"])
def test_a_number_states_what_of_it_is_not_identified(form, change, status):
    run = posterior_of(*preset("motor-axis"), 0.6)
    run = replace(run, summary=run.summary.with_rows({"motor.inertia": change}))
    exported = bf.export(run, form)
    rows = [x for x in exported.record["numbers"] if "motor.inertia" in x["made_from"]]
    assert [x["not_identified"] for x in rows] == [{"motor.inertia": status}]
    assert [x for x in exported.files.values() if f"motor.inertia ({status})" in x]


def test_a_lost_term_is_listed_with_its_torque_and_what_remains():
    run = finished_posterior("plain")
    drake = bf.export(run, "drake").record
    (friction,) = [x for x in drake["lost"] if x["parameters"] == ["joint.coulomb"]]
    assert friction["torque"] == pytest.approx(5.0 / 50.0, rel=0.01)
    assert 0.0 < friction["left"] < friction["torque"]
    assert friction["fitted"] == ["damping"]
    assert not bf.export(run, "mujoco").record["lost"]


def test_separate_offsets_of_recordings_are_not_the_joints():
    joint = Joint(
        elements=(Element("motor", inertia=True, coulomb="symmetric", viscous=True),),
        load=Load(),
        offset=True,
        own_offsets=("a", "b"),
    )
    values = dict.fromkeys(joint.names, 5.0) | {"motor.coulomb": 3.0, "motor.viscous": 2.0}
    exported = simulator_numbers(joint, joint.vector(values)[None], sine_motion(), NUMBERS)
    assert exported["torque_offset"][0] == (5.0 if "offset" in joint.names else 0.0)
    np.testing.assert_allclose([exported["friction"][0], exported["damping"][0]], [3.0, 2.0])


def test_what_holds_at_standstill_is_no_less_than_what_slides():
    """Isaac's friction pair, of a load-dependent law whose fit over the motion is larger."""
    value = numbers(bf.export(finished_posterior("servo-pendulum"), "isaac"))
    assert value["friction"] >= value["dynamic_friction"] > 0.0
