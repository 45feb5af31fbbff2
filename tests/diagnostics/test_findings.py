"""From what was taken in to a finding: what it names and doubts, and the line that mends it."""

import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.base.templates import placed
from bayesfric.diagnostics.candidates import BY_NAME, KINDS
from bayesfric.diagnostics.explanation import Explanation, finding_of, setting_of
from bayesfric.diagnostics.motion import MotionSignals, scales_of
from bayesfric.diagnostics.regression import Finding
from bayesfric.estimates.point_estimate import HALF as MOVES
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.measurement import Inputs, Signal
from tests.axis import swing
from tests.conftest import made_observation, made_recording
from tests.diagnostics.bench import axis, every_sample

EFFECT = Finding(
    "quadratic", "note", shape="0.5", statistic=6.0, p=0.04, share=0.1,
    recording="in one", span=(1.0, 2.0), coefficients=np.array([1.0]), rivals=("power",),
    moves={"a": 0.5, "b": -MOVES - 0.01, "c": MOVES + 5.0, "d": MOVES - 0.01},
)  # fmt: skip


def test_a_finding_has_its_effects_numbers_and_doubts_what_it_moves_far():
    result = finding_of(axis(), EFFECT)
    assert (result.kind, result.hint) == ("quadratic", "mechanism.elements.motor.quadratic = true")
    assert (result.severity, result.parameters) == ("doubt", ("c", "b"))  # the most first
    assert result.physical
    assert set(result.as_dict()) == {
        "kind", "severity", "statistic", "p", "shape", "recording", "span", "share", "rivals",
        "moves", "physical", "parameters", "hint",
    }  # fmt: skip
    near = finding_of(axis(), replace(EFFECT, moves={"a": 0.5, "d": -MOVES + 0.01}))
    assert (near.severity, near.moves) == ("note", {})
    # what is no candidate of the table has no setting
    tone = finding_of(axis(), replace(EFFECT, kind="tone"))
    assert (tone.kind, tone.setting, tone.physical) == ("tone", "", True)


@pytest.mark.parametrize(
    ("kind", "sizes", "alike", "named", "hint"),
    [
        ("stribeck", [-1.0], (), "stribeck", 'motor.stribeck = "either"'),
        ("quadratic", [-1.0], (), "quadratic", ""),  # nothing that loses energy gives any
        ("quadratic", [0.0], (), "quadratic", "motor.quadratic = true"),
        ("load_loss_by_power", [1.0, -1.0], (), "load_loss_by_power", ""),
        ("load_loss_by_power", [1.0, 1.0], (), "load_loss_by_power", 'motor.load_loss = "two"'),
        ("quadratic", [-1.0], ("power", "tone", "spring"), "spring", "load.spring = true"),
        ("quadratic", [-1.0], ("smoothed",), "quadratic", ""),  # no fault of the log stands for it
        ("drift", [-1.0], ("spring",), "drift", ""),  # which may have any sign
    ],
)
def test_an_effect_of_an_impossible_sign_is_named_after_a_rival(kind, sizes, alike, named, hint):
    effect = replace(EFFECT, kind=kind, coefficients=np.array(sizes), rivals=alike)
    result = finding_of(axis(), effect)
    where = "mechanism." if hint.startswith("load.") else "mechanism.elements."
    assert result.kind == named
    assert result.hint == (hint and where + hint)
    assert result.physical == (bool(hint) or kind == "drift")
    assert result.shape == ("0.5" if named == kind else "")
    assert result.rivals == ((kind, *(x for x in alike if x != named)) if named != kind else alike)


@pytest.mark.parametrize("kind", ["smoothed", "current_column", "torque_constant_by_angle"])
def test_a_fault_of_the_recording_is_always_a_doubt(kind):
    fault, term = (
        finding_of(axis(), replace(EFFECT, kind=k, moves={})) for k in (kind, "quadratic")
    )
    assert (fault.severity, term.severity) == ("doubt", "note")
    room = SimpleNamespace(kinds={kind: (), "quadratic": ()})
    result = Explanation((fault, replace(term, severity="doubt")), missing=room)
    assert [x.severity for x in result.with_severity(widened=True)] == ["doubt", "note"]
    assert [x.severity for x in result.with_severity(widened=False)] == ["doubt", "doubt"]


# A line of a configuration adds the column of its candidate

TIME = 0.002 * np.arange(2000)
MOTION = swing(TIME, ((0.45, 1.2), (1.3, 0.4)))
WARM = Inputs(temperature=Signal(TIME, 25.0 + TIME), torque_rate=Signal(TIME, np.cos(TIME)))
VALUES = {"inertia": 0.1, "first_moment": 0.5, "coulomb": 0.4, "viscous": 0.2, "load": 0.1}
SHAPES = ("stribeck_velocity", "warming_time", "power_exponent")
RATIO = 3.0


def put_in(chain, line):
    """Give the joint of a configuration that has the line."""
    where, text = placed(line)
    ((key, value),) = tomllib.loads(text).items()
    value = tuple(value) if isinstance(value, list) else value
    match where.split("."):
        case ["mechanism"] if key == "load":
            return replace(chain, load=bf.Load(**{**chain.load.choices, **value}))
        case ["mechanism"]:
            return replace(chain, **{key: value})
        case ["mechanism", "load"]:
            return replace(chain, load=bf.Load(**{**chain.load.choices, key: value}))
        case ["mechanism", "elements", name]:
            more = [replace(e, choices={**e.choices, key: value}) for e in chain.elements]
            pairs = zip(chain.elements, more, strict=True)
            return replace(chain, elements=[n if e.name == name else e for e, n in pairs])
    raise AssertionError(line)


def sensitivities(chain, shape):
    """Derivatives of a joint's torque by its parameters, those that shape at values of a grid."""
    shapes = dict.fromkeys(SHAPES, shape) | {"stribeck_velocity": RATIO * shape}  # the motor's
    values = np.array([(VALUES | shapes).get(p.quantity, 0.0) for p in chain.parameters])
    columns = []
    for i, p in enumerate(chain.parameters):
        if p.quantity in SHAPES:
            continue
        step = np.where(np.arange(values.size) == i, 1e-6, 0.0)
        sides = (
            inverse_torque(chain, v, *MOTION, inputs=WARM, time=TIME)
            for v in (values + step, values)
        )
        columns.append((next(sides) - next(sides)) / 1e-6)
    return np.column_stack(columns)


INERT = bf.Element("motor", inertia=True, ratio=RATIO)
HEAVY = bf.Load(first_moment=True)
PLAIN = bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True, ratio=RATIO)
LOSSY = replace(PLAIN, choices={**PLAIN.choices, "load_loss": "one"})
BY_LOAD = ("load_square", "load_speed", "load_loss_by_direction")
WAVES = ("repeating", "friction_by_angle")
SETTINGS = [
    *(
        (kind.name, bf.Joint([PLAIN, bf.Element("arm")] if kind.name in WAVES else [PLAIN], HEAVY))
        for kind in KINDS
        if kind.option not in ("", "inertia", "delay", "coulomb") and kind.name not in BY_LOAD
    ),
    *((name, bf.Joint([LOSSY], HEAVY)) for name in (*BY_LOAD, "load_loss_by_power")),
    ("coulomb", bf.Joint([INERT], HEAVY)),
    ("viscous", bf.Joint([INERT], HEAVY)),
    ("gravity", bf.Joint([INERT], bf.Load())),
]


@pytest.mark.parametrize(("name", "chain"), SETTINGS)
def test_the_line_that_a_finding_gives_adds_its_candidates_columns(name, chain):
    """Each is a sum of what moves the torque of the new configuration's joint."""
    windows = every_sample(TIME.size)
    settings = {"lowpass": 0.0, "order": 2, "reach": 8, "band": 12.0}
    o = made_observation("one", TIME, MOTION, TIME, windows, 0.002, WARM, settings=settings)
    values = np.array([VALUES.get(p.quantity, 0.0) for p in chain.parameters])
    scales = scales_of(chain, values, [o])
    along = MotionSignals(chain, values, o, made_recording(TIME, o.q, TIME, 0.002), scales)
    kind, some = BY_NAME[name], 0
    every = [*kind.shapes(along).items()]
    for shape, columns in (*every[:1], *every[-1:]):  # terms that are new take their compilation
        line = setting_of(chain, kind, shape)
        if not line:
            assert name == "viscous"  # which the joint has
            continue
        if "inertia behind" in shape and not shape.startswith("0%"):
            continue  # this joint has none behind what loses
        wanted = put_in(chain, line)
        at = float(shape) if shape.replace(".", "").replace("e-", "").isdigit() else 0.5
        new = sensitivities(wanted, at)
        for column in columns:
            left = column - project(new, column)
            assert np.linalg.norm(left) < 2e-2 * np.linalg.norm(column), (line, shape)
        some += 1
        # and one that has it is told nothing more
        if name not in WAVES:
            assert setting_of(wanted, kind, shape) == "" or name == "gravity"
    assert some or name == "viscous"


def project(x, y):
    x = x[:, np.linalg.norm(x, axis=0) > 1e-12]
    x = x / np.linalg.norm(x, axis=0)
    return x @ np.linalg.lstsq(x, y, rcond=1e-10)[0]


FIRST = bf.Element("motor", coulomb="symmetric", ratio=10.0)
LOSING = replace(FIRST, choices={"load_loss": "one"})
ARM = bf.Element("arm")
BARE = bf.Joint([FIRST, ARM], bf.Load(inertia=True))
INERT_ARM = bf.Element("arm", inertia=True)
LOSING_FIRST = {"elements": [LOSING, ARM]}
LOSING_INERT = {"load": bf.Load(), "elements": [LOSING, INERT_ARM]}


@pytest.mark.parametrize(
    ("kind", "more", "line"),
    [
        # the first element that does not have it yet, none where all do
        ("coulomb", {}, 'elements.arm.coulomb = "symmetric"'),
        ("coulomb", {"elements": [FIRST, replace(FIRST, name="arm", ratio=1.0)]}, ""),
        # a load-dependent loss is the last element's, or that of one that has it already
        ("load_loss", {}, 'elements.arm.load_loss = "one"'),
        ("load_loss_by_power", LOSING_FIRST, 'elements.motor.load_loss = "two"'),
        ("load_loss", LOSING_FIRST, ""),
        # what shapes such a loss needs one first
        ("load_square", {}, 'elements.arm.load_loss = "one"'),
        ("load_square", LOSING_FIRST, "elements.motor.load_square = true"),
        ("load_speed", LOSING_FIRST, "elements.motor.load_speed = true"),
        ("load_loss_by_direction", LOSING_FIRST, "elements.motor.load_direction = true"),
        # it needs a load, or inertia, behind it
        ("load_loss", {"load": bf.Load()}, ""),
        ("load_loss", {"load": bf.Load(), "elements": [FIRST, INERT_ARM]}, ""),
        ("load_square", LOSING_INERT, "elements.motor.load_square = true"),
        # of the joint and its load
        ("offset", {}, "offset = true"),
        ("offset", {"offset": True}, ""),
        ("delay", {}, "delay = true"),
        ("delay", {"delay": True}, ""),
        ("spring", {}, "load.spring = true"),
        ("spring", {"load": bf.Load(spring=True)}, ""),
        ("gravity", {}, "load = { first_moment = true, gravity_angle = true }"),
        ("gravity", {"load": bf.Load(first_moment=True)}, "load.gravity_angle = true"),
        ("torque_constant", {}, ""),
        ("elastic", {}, ""),
        # waves belong to the shaft that turns so often
        ("repeating: 12 a turn of the motor", {}, "elements.motor.cogging = [12]"),
        ("repeating: 3 a turn of the joint", {}, "elements.arm.cogging = [3]"),
    ],
)
def test_settings_name_the_element_that_can_have_them(kind, more, line):
    name, _, shape = kind.partition(": ")
    setting = setting_of(replace(BARE, **more), BY_NAME[name], shape)
    assert setting == (line and f"mechanism.{line}")
