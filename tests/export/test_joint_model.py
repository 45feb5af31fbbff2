"""A joint at its output: identities, and what cannot be carried."""

import io
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.export.extra_terms import fold_extra_terms, lost_terms
from bayesfric.export.format import formats, pendulum
from bayesfric.export.joint_model import (
    Trajectory,
    joint_model,
    simulated_torque,
    torque_along,
)
from bayesfric.export.point_estimate import representative_draw
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import CHOICES, LOAD_CHOICES
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.measurement import AT_ROOM, Inputs

from .made import found, made, numbers, preset


def wave(n=300):
    t = np.linspace(0.0, 6.0, n)
    q, qd, qdd = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
    return [Trajectory(q, qd, qdd, t, Inputs())]


def test_a_chain_without_load_losses_is_carried_exactly():
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
    there = [replace(m, inputs=Inputs(added_mass=1.5, radius=0.3)) for m in wave()]
    numbers = joint_model(joint, values, there).values
    for k, one in enumerate(torque_along(joint, values, there)):
        theirs = simulated_torque(joint, {n: float(x[k]) for n, x in numbers.items()}, there)
        np.testing.assert_allclose(theirs, one, rtol=1e-12)
    # in the closed form: inertia times the square of the ratios before it
    column = dict(zip(joint.names, values.T, strict=True))
    armature = column["motor.inertia"] * 21.0**2 + column["belt.inertia"] * 7.0**2
    np.testing.assert_allclose(numbers["armature"], armature)
    np.testing.assert_allclose(numbers["quadratic"], column["belt.quadratic"] * 7.0**3)


@pytest.mark.parametrize("load", [0.5, 4.0])
def test_load_losses_are_right_at_the_reference_load_both_ways(load):
    joint = Joint(
        elements=(
            Element("motor", coulomb="symmetric", load_loss="two"),
            Element("gearbox", ratio=20.0, load_loss="two"),
        ),
        load=Load(inertia=True),
    )
    vector = joint.vector(
        {
            "motor.coulomb": 0.1,
            "motor.load_drive": 0.05,
            "motor.load_back": 0.1,
            "gearbox.load_drive": 0.3,
            "gearbox.load_back": 0.4,
            "load.inertia": 1.0,
        }
    )
    # of one element alone the line meets the law at both ends of the reference load
    one = vector.copy()
    one[[joint.names.index(f"motor.load_{side}") for side in ("drive", "back")]] = 0.0
    still = np.zeros(4)
    ends = [Trajectory(still, np.array([1.0, 1.0, -1.0, -1.0]), load * np.array([1, -1, 1, -1.0]),
                  still, Inputs())]  # fmt: skip
    numbers = joint_model(joint, one[None], ends, load).values
    theirs = simulated_torque(joint, {n: float(x[0]) for n, x in numbers.items()}, ends)
    np.testing.assert_allclose(theirs, torque_along(joint, one[None], ends)[0], rtol=1e-12)
    # without a reference of one's own it is the mean size of what passes, here the same
    np.testing.assert_allclose(joint_model(joint, one[None], ends).values["friction"],
                               numbers["friction"])  # fmt: skip
    # and of two, the torque that passes the second
    passes = joint_model(joint, vector[None], ends, load).reference["motor"][0]
    assert passes == pytest.approx(load * (1.0 + 0.5 * (0.3 - 0.4)))


@pytest.mark.slow
def test_an_open_scale_changes_no_export():
    done = found("rabbit-knee")
    joint, values = preset("rabbit-knee")
    vector = joint.vector(values)
    (scaling,) = scalings(joint)
    other = made(joint, dict(zip(joint.names, scaling.scaled(vector, 1.1), strict=True)), 0.6,
                 open_scale=True, spread=0.0)  # fmt: skip
    one = made(joint, values, 0.6, open_scale=True, spread=0.0)
    first, second = (numbers(bf.export(x, "csv")) for x in (one, other))
    assert first == pytest.approx(second, rel=1e-9)
    text = bf.export(done, "mujoco").text()
    assert "load.inertia" in text.partition("leave one scale")[2].partition("may all be")[0]
    # where the scale is known the link keeps its inertia, and the gain tells the mean loss
    known = made(joint, values, 0.6, spread=0.0)
    rows = numbers(bf.export(known, "csv"))
    drive, back = (values[f"gearbox.load_{x}"] for x in ("drive", "back"))
    assert rows["link_inertia"] == pytest.approx(values["load.inertia"])
    assert rows["gain"] == pytest.approx(50.0 / (1.0 + 0.5 * (drive - back)))


CASES = [
    *(("motor", option, choice) for option, known in CHOICES.items() for choice in known),
    *(("load", option, choice) for option, known in LOAD_CHOICES.items() for choice in known),
    ("motor", "cogging", (3,)),
    ("motor", "periodic_friction", (2,)),
]


@pytest.mark.parametrize(("bearer", "option", "choice"), CASES)
def test_every_choice_of_the_table_has_a_place_or_is_told(bearer, option, choice):
    """What is added to the table later must not be dropped without a word."""
    beside = {"stribeck_exponent": {"stribeck": True}} if option == "stribeck_exponent" else {}
    if option.startswith("load_") and option != "load_loss":
        beside = {"load_loss": "two"}
    if option == "gravity_angle":
        beside = {"first_moment": True}
    chosen = {**beside, option: choice}
    of_element = {"inertia": True, **(chosen if bearer == "motor" else {})}
    of_load = {"inertia": True, **(chosen if bearer == "load" else {"first_moment": True})}
    joint = Joint(elements=(Element("motor", **of_element),), load=Load(**of_load))
    values = np.full((1, len(joint.names)), 0.3)
    there = [Trajectory(m.q, m.qd, m.qdd, m.time, AT_ROOM) for m in wave()]
    at = joint_model(joint, values, there)
    told = {name for one in lost_terms(joint, at, values[0], ()) for name in one["parameters"]}
    used = {name for names in at.made_from.values() for name in names}
    # these shape what another row stands for, which is told
    shapes = {"stribeck_velocity", "stribeck_exponent", "power_exponent", "warming_time"}
    assert {p.name for p in joint.parameters if p.quantity not in shapes} <= told | used


def test_a_power_of_speed_is_fitted_over_what_was_recorded():
    joint = Joint(elements=(Element("motor", inertia=True, power=True),), load=Load())
    vector = joint.vector({"motor.inertia": 0.1, "motor.power": 0.4, "motor.power_exponent": 1.0})
    at = joint_model(joint, vector[None], wave())
    # with an exponent of one it is viscous
    assert at.values["damping"][0] == pytest.approx(0.4)
    assert at.values["friction"][0] == pytest.approx(0.0, abs=1e-12)


def test_static_friction_is_what_the_stribeck_rise_ends_at():
    joint = Joint(
        elements=(Element("motor", ratio=4.0, inertia=True, coulomb="symmetric", stribeck=True),),
        load=Load(),
    )
    values = {"inertia": 0.1, "coulomb": 0.2, "stribeck_ratio": 0.5, "stribeck_velocity": 0.1}
    vector = joint.vector({f"motor.{k}": v for k, v in values.items()})
    numbers = joint_model(joint, vector[None], wave()).values
    assert numbers["friction"][0] == pytest.approx(0.8)
    assert numbers["static_friction"][0] == pytest.approx(1.2)


@pytest.mark.parametrize("name", ["urdf", "drake", "mujoco"])
def test_what_is_folded_keeps_the_torque_of_a_joint_alone(name):
    numbers = joint_model(*_knee(), wave())
    carries = formats()[name].names.values()
    kept, _ = fold_extra_terms(numbers, carries, wave(), _knee()[0])
    whole = numbers.values["armature"] + numbers.values["link_inertia"]
    np.testing.assert_allclose(kept["armature"] + kept["link_inertia"], whole)


def _knee():
    joint, values = preset("rabbit-knee")
    return joint, joint.vector(values)[None]


@pytest.mark.parametrize(("inertia", "moment", "angle"), [(0.2, 0.4, 0.3), (0.0, 0.05, 0.0)])
def test_the_body_has_inertia_and_first_moment(inertia, moment, angle):
    numbers = {
        "link_inertia": inertia,
        "armature": 0.01,
        "link_moment": moment,
        "link_gravity_angle": angle,
    }
    body = pendulum(numbers, rotary=True)
    distance = np.hypot(body.com[0], body.com[2])
    assert body.mass * distance == pytest.approx(moment)
    about = body.about_axis + body.mass * distance**2
    assert about + body.armature == pytest.approx(inertia + 0.01)
    assert 2.0 * body.across >= body.about_axis > 0.0  # a body can have it
    assert body.armature > 0.0
    # a pendulum has at least the inertia of its mass at its distance
    lightest = moment**2 / (inertia or 0.01)
    assert lightest < body.mass < (2.01 if inertia else 1.25) * lightest


@pytest.mark.parametrize("rotary", [True, False])
def test_a_rotors_inertia_stays_the_rotors_where_no_link_weighs_anything(rotary):
    names = ("link_inertia", "link_moment", "link_gravity_angle")
    body = pendulum(dict.fromkeys(names, 0.0) | {"armature": 95.0}, rotary)
    assert body.armature == pytest.approx(95.0, rel=2e-3)
    assert body.armature + body.inertia == pytest.approx(95.0, rel=1e-12)
    assert 0.0 < body.mass <= 0.1
    assert 2.0 * body.across >= body.about_axis > 0.0


def test_a_link_of_its_own_inertia_alone_is_of_any_mass():
    numbers = {"link_inertia": 0.2, "armature": 0.1, "link_moment": 0.0, "link_gravity_angle": 0.0}
    body = pendulum(numbers, rotary=True)
    assert (body.inertia, body.armature) == (0.2, 0.1)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"to": "mojoco"}, "did you mean 'mujoco'"),
        ({"to": "urdf", "draws": 3}, "has no effect in the format urdf"),
        ({"to": "csv", "draws": 1000}, "the run has 60"),
        ({"to": "csv", "draws": 0}, "give 1 or more"),
        ({"to": "mujoco", "at_load": -1.0}, "zero or more"),
        ({"to": "mujoco", "joint": 'a"b'}, "is no name"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_a_line(options, words):
    with pytest.raises(BadInput, match=words):
        bf.export(found("motor-axis"), **options)


def test_the_table_of_draws_names_units_and_holds_the_parameters():
    done = found("motor-axis")
    exported = bf.export(done, "csv", draws=20)
    table = pd.read_csv(io.BytesIO(exported.main))
    assert len(table) == 20
    assert "friction [N m]" in table.columns
    np.testing.assert_array_equal(table["friction [N m]"], table["motor.coulomb [N m]"])
    offset = done.values(done.picked(20))[:, done.joint.names.index("offset")]
    np.testing.assert_array_equal(table["offset [N m]"], offset)
    assert bf.export(done, "csv", draws=20).main == exported.main


def test_one_draw_stands_for_all_where_medians_would_not_fit():
    """Rotor and link inertia of which only the sum is known: their medians sum up to less."""
    there = wave()
    joint = Joint(
        elements=(Element("motor", inertia=True), Element("belt", inertia=True)),
        load=Load(inertia=True),
    )
    shares = np.random.default_rng(4).dirichlet([0.2, 0.2, 0.2], 400)
    middle = np.median(shares, axis=0)
    assert middle.sum() < 0.7
    found_one = representative_draw(joint, shares, middle, there)
    assert found_one.sum() == pytest.approx(1.0)
    assert (shares == found_one).all(axis=1).any()
    # where parameters are known apart, the medians are it
    known = np.random.default_rng(5).normal(1.0, 0.01, (400, 3))
    assert representative_draw(joint, known, np.median(known, axis=0), there) is None


def test_a_run_of_any_name_ends_no_comment():
    done = replace(found("motor-axis"), name='a-->b*/c"""d\\e\nf')
    ElementTree.fromstring(bf.export(done, "mujoco").main)
    ElementTree.fromstring(bf.export(done, "urdf").main)
    for text in (bf.export(done, "python").main, *bf.export(done, "isaac").files.values()):
        assert "a- ->b* /c'''d/e" in text
    compile(bf.export(done, "python").main, "feedforward.py", "exec")
    assert bf.export(done, "c").files["joint_feedforward.h"].count("*/") == 1


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"verdict": "prior"}, "unidentified"),
        ({"verdict": "weak", "undoubted": "data", "doubted": ["delay"]}, "doubtful"),
    ],
)
@pytest.mark.parametrize("form", ["mujoco", "c"])
def test_a_number_says_what_of_it_the_data_leave_open(form, change, status):
    done = made(*preset("motor-axis"), 0.6)
    done = replace(done, summary=done.summary.with_rows({"motor.inertia": change}))
    exported = bf.export(done, form)
    rows = [x for x in exported.record["numbers"] if "motor.inertia" in x["made_from"]]
    assert [x["not_identified"] for x in rows] == [{"motor.inertia": status}]
    assert [x for x in exported.files.values() if f"motor.inertia ({status})" in x]


def test_a_rise_at_low_speed_is_in_the_constants_of_a_format_that_has_no_rise():
    """Least squares over the recorded motion: no other constant and damping are nearer."""
    joint = Joint((Element("motor", coulomb="symmetric", viscous=True, stribeck=True),), Load())
    values = {"viscous": 0.3, "coulomb": 0.2, "stribeck_ratio": 0.5, "stribeck_velocity": 2.0}
    vector = joint.vector({f"motor.{k}": v for k, v in values.items()})[None]
    at, (motion,) = joint_model(joint, vector, wave()), wave()
    law = torque_along(joint, vector, wave())[0] * np.sign(motion.qd)
    basis = np.stack([np.ones(law.size), np.abs(motion.qd)], axis=1)
    nearest = np.linalg.lstsq(basis, law, rcond=None)[0]
    kept, _ = fold_extra_terms(at, ("friction", "damping", "static_friction"), wave(), joint)
    np.testing.assert_allclose([kept["friction"][0], kept["damping"][0]], nearest, rtol=1e-9)
    # what holds at rest is no less than what slides
    assert kept["static_friction"][0] == pytest.approx(max(0.3, kept["friction"][0]))
    # where it falls all the way a loss that grows would be negative: the mean is nearest then
    vector[0, joint.names.index("motor.viscous")] = 0.0
    kept, _ = fold_extra_terms(
        joint_model(joint, vector, wave()), ("friction", "damping"), wave(), joint
    )
    law = torque_along(joint, vector, wave())[0] * np.sign(motion.qd)
    assert (kept["damping"][0], kept["friction"][0]) == (0.0, pytest.approx(law.mean()))
    # without a constant the damping that is nearest
    only, _ = fold_extra_terms(joint_model(joint, vector, wave()), ("damping",), wave(), joint)
    slope = law.mean() * np.abs(motion.qd).sum() / (motion.qd @ motion.qd)
    assert (only["damping"][0], only["friction"][0]) == (pytest.approx(slope), 0.0)
    # a format with a rise of its own keeps the law's
    own, _ = fold_extra_terms(at, ("friction", "damping"), wave(), joint, ("stribeck_ratio",))
    assert (own["friction"][0], own["damping"][0]) == pytest.approx((0.2, 0.3))


def test_an_export_says_how_far_its_friction_is_from_the_fitted():
    exact = bf.export(found("plain"), "mujoco").record["error"]["friction"]
    drake = bf.export(found("plain"), "drake")
    far = drake.record["error"]["friction"]
    assert exact["rms"] < 0.01 * exact["curve_rms"] < far["rms"] < far["curve_rms"]
    assert f"{far['rms']:.3g} N m rms from the median of the fitted friction" in drake.main
    assert "friction" not in bf.export(found("plain"), "c").record["error"]
