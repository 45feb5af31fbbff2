"""Each row of the table of quantities, at every place of a chain, on every path of the torque.

The expected torque is the element equation with the table's own columns, in plain Python.
"""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.estimates.assemble import open_scalings
from bayesfric.estimates.least_squares import least_squares, starting_values
from bayesfric.estimates.point_estimate import Knowledge
from bayesfric.estimates.torque import VariableProjection, filtered_torque, torque_form
from bayesfric.inference.fitting import make_target, read_priors
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import Term
from bayesfric.mechanism.quantities import (
    CHOICES,
    CYCLES,
    LOAD_CHOICES,
    QUANTITIES,
    TOTALS,
    Quantity,
    State,
)
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.measurement import Inputs, Signal

PLACES = ("motor", "gearbox", "joint", "load")
SHORT = 1e-9


def own(name, owner):
    """Give a term of one's own, of place and time."""
    column = {
        "cogging": lambda m: np.sin(6.0 * m.position + 0.3),
        "warming": lambda m: m.speed * np.exp(-0.4 * m.time),
        "cubic": lambda m: m.speed**3,
    }[name]
    return Term(f"{owner}.{name}", column, "N m")


OWN = ("cogging", "warming", "cubic")


def cases():
    """Every quantity at every place that may have it, and terms of one's own."""
    for q in QUANTITIES.values():
        owners = [p for p in PLACES if q.option in (LOAD_CHOICES if p == "load" else CHOICES)]
        yield from (pytest.param((q.name, p), id=f"{p}.{q.name}") for p in owners or [""])
    yield from (pytest.param((q, p), id=f"{p}.{q}") for q in CYCLES for p in ("motor", "load"))
    yield from (pytest.param((name, p), id=f"{p}.{name}") for name in OWN for p in PLACES)
    # gravity of the other sign: the joint hangs where it stood
    yield from (pytest.param((name, "upside down"), id=name) for name in ("load", "gravity_angle"))


def chain_with(name, owner) -> Joint:
    """Give a knee of motor, gearbox and joint whatever brings the quantity at that place."""
    if owner == "upside down":
        chain = chain_with(name, "gearbox" if name == "load" else "load")
        return replace(chain, load=replace(chain.load, gravity=-chain.load.gravity))
    options = {
        "motor": {"inertia": True, "coulomb": "symmetric", "viscous": True},
        "gearbox": {"load_loss": "two"},
        "joint": {"coulomb": "by-direction"},
        "load": {"inertia": True, "first_moment": True},
    }
    if name in CYCLES:
        options[owner] |= {name: (1, 5)}
    elif name in QUANTITIES and owner:
        q = QUANTITIES[name]
        needs = {"stribeck_exponent": {"stribeck": True}, "load_direction": {"load_loss": "one"}}
        options[owner] |= needs.get(q.option, {}) if owner != "gearbox" else {}
        options[owner] |= {q.option: q.choice[0] if isinstance(q.choice, tuple) else q.choice}
    elements = tuple(
        Element(place, ratio, **options[place])
        for place, ratio in (("motor", 1.5), ("gearbox", 8.0), ("joint", 2.0))
    )
    chain = Joint(elements, Load(**options["load"]), offset=name == "offset", gain=name == "gain")
    return chain if name in {**QUANTITIES, **CYCLES} else chain.with_term(own(name, owner))


def values_of(chain, seed=3):
    """Positive values whose torques at the motor are of about one size."""
    rng = np.random.default_rng(seed)
    size = {"inertia": 1e-3, "first_moment": 0.5, "gain": 1.0}
    sizes = []
    for p in chain.parameters:
        reach = chain.ratio / chain.reaches[p.owner]
        grows = reach ** (p.row.power + 1) if p.row.power else reach
        scale = 0.3 if p.row.role != "own" else 0.02 * grows
        sizes.append(size.get(p.quantity, scale) * rng.uniform(0.5, 1.5))
    return np.array(sizes)


def by_the_table(chain, values, o):
    """Torque by section 2.2, written with the columns of the table."""
    at = dict(zip(chain.names, values.tolist(), strict=True))
    inertia, moment = o.inputs.load(chain.load.motion)
    gravity = chain.load.gravity * np.sin(o.q + at.get("load.gravity_angle", 0.0))
    torque = inertia * o.qdd + moment * gravity
    if o.inputs.load_torque is not None:
        torque = torque - o.inputs.load_torque.at(o.stamps)
    for place in ("load", *(e.name for e in chain.elements[::-1])):
        reach = chain.reaches[place]
        if place != "load":
            torque = torque / next(e.ratio for e in chain.elements if e.name == place)
        state = State(
            reach * o.q, reach * o.qd, reach * o.qdd, np.sign(o.qd), o.stamps, torque, gravity
        )

        def of(name, place=place):
            return at.get(f"{place}.{name}", 0.0)

        low = 0.0
        if f"{place}.stribeck_velocity" in at:
            exponent = at.get(f"{place}.stribeck_exponent", 2.0)
            low = np.exp(-(np.abs(state.speed / of("stribeck_velocity")) ** exponent))
        both = of("stribeck_ratio") + of("stribeck_change")
        rises = {
            "own": 1.0 + (both + of("stribeck_constant")) * low,
            "loss": 1.0 + (both + of("stribeck_load")) * low,
        }
        total = torque
        for p in chain.parameters:
            if p.owner == place and p.row.role != "form":
                shape = [at[f"{place}.{p.row.shape}"]] if p.row.shape else []
                column = p.row.column(state, *shape)
                if p.row.signal:
                    column = column * (o.inputs.signal(p.row.signal).at(o.stamps) - p.row.zero)
                total = total + at[p.name] * column * (rises[p.row.role] if p.row.rises else 1.0)
        # by direction, the loss of either flow of power is that much larger one way
        drives = torque * state.direction > 0.0
        differs = np.where(drives, of("load_drive_difference"), of("load_back_difference"))
        differs = (differs + of("load_difference")) * state.direction * rises["loss"]
        mu = differs + of("load_speed") * np.abs(state.speed) + of("load_square") * np.abs(torque)
        torque = total + mu * np.abs(torque) * state.direction
    return (torque + at.get("offset", 0.0)) / at.get("drive.gain", 1.0)


def recorded(make_observation, chain, values, **inputs):
    """Torque by the table, along a motion that does not depend on the term."""
    bare = chain_with("inertia", "motor")
    named = dict(zip(bare.names, values_of(bare).tolist(), strict=True))
    o = make_observation(bare, named, n=400, factor=2)
    signals = {
        "temperature": Signal(o.stamps[::40], 20.0 + 5.0 * np.sin(o.stamps[::40])),
        "load_torque": Signal(o.stamps, 3.0 * np.sin(9.0 * o.stamps)),
    }
    inputs |= {name: signals[name] for name in inputs if name in signals}
    o = replace(o, inputs=replace(o.inputs, **inputs))
    torque = by_the_table(chain, values, o) + 0.01 * np.random.default_rng(1).normal(size=o.q.size)
    return chain, values, replace(o, torque=torque, measured=o.filter.apply(torque))


@pytest.fixture(params=list(cases()))
def case(request, make_observation):
    chain = chain_with(*request.param)
    inputs = {"added_mass": 0.2, "radius": 0.3, "temperature": True}
    return recorded(make_observation, chain, values_of(chain), **inputs)


def close(computed, expected):
    np.testing.assert_allclose(computed, expected, rtol=SHORT, atol=SHORT * np.abs(expected).max())


def test_plain_and_compiled(case):
    chain, values, o = case
    expected = by_the_table(chain, values, o)
    close(inverse_torque(chain, values, o.q, o.qd, o.qdd, inputs=o.inputs, time=o.stamps), expected)
    close(filtered_torque(chain, o, values[None])[0], o.filter.apply(expected))


def test_moments_prepared_and_fused(case):
    chain, values, o = case
    rng = np.random.default_rng(2)
    draws = values * rng.uniform(0.9, 1.1, (9, values.size))
    plain = TorqueLikelihood(chain, [o])
    scales = np.full((9, 1, 1), 0.02)
    expected = [
        float(np.sum((o.measured - o.filter.apply(by_the_table(chain, v, o))) ** 2)) for v in draws
    ]
    density = -0.5 * (np.array(expected) / 0.02**2 + o.measured.size * np.log(2 * np.pi * 0.02**2))
    close(plain.sum_of_squares(draws)[:, 0], np.array(expected))
    close(plain.log_density(draws, scales), density)
    # forms that the chain does not have are not prepared, and stay the plain ones
    close(plain.precomputed(np.tile(values, (300, 1))).log_density(draws, scales), density)


def test_variable_projection(case):
    """At the true Theta2 it finds the Theta1 that leaves nothing of a torque without noise."""
    chain, values, o = case
    o = replace(o, inputs=Inputs(temperature=o.inputs.temperature))
    torque = by_the_table(chain, values, o)
    o = replace(o, torque=torque, measured=o.filter.apply(torque))
    form = torque_form(chain, [o])
    if form is None:  # what shapes other terms, and several load losses, are not of the form
        shaped = any(p.row.role == "form" and not p.circular for p in chain.parameters)
        assert shaped or sum(e.load_loss != "none" for e in chain.elements) > 1
        return
    left = VariableProjection(form, [o]).residual(form.thetas(values)[1])
    assert np.abs(left).max() < SHORT * np.abs(torque).max()


def test_forward_then_inverse(case):
    chain, values, o = case
    push = 0.8 * np.sign(np.sin(2 * np.pi * 1.5 * o.stamps)) + 0.3 * np.sin(20.0 * o.stamps)
    motion = simulate(chain, values, push, 2e-3, inputs=o.inputs, hold="zero", substeps=2)
    moving = motion.qd != 0.0
    assert moving.sum() > 300
    back = inverse_torque(
        chain, values, motion.q, motion.qd, motion.qdd, inputs=o.inputs, time=motion.time
    )
    np.testing.assert_allclose(back[moving], push[moving], rtol=0.0, atol=1e-12)


def test_every_other_form_takes_it(case):
    chain, values, o = case
    priors = read_priors(chain, {}, [o])
    assert set(chain.names) <= set(priors)
    make_target(chain, [o], priors, "shared")
    totals = least_squares(chain, [o])
    assert set(starting_values(chain, totals, 0.1, 0.5)) == set(chain.names)
    derive(chain, values[None], 1.0)
    # one load loss with two values, and all that is behind it; low speed tells where it rises
    assert len(scalings(chain)) == sum(
        e.load_loss == "two" and not e.choices.get("stribeck") for e in chain.elements
    )


def test_every_power_of_speed_has_a_total():
    # what does not grow with a power of speed is a total of its own
    own = [q for q in QUANTITIES.values() if q.role == "own" and q.power is not None]
    filled_columns = {kind for q in own for kind, _ in q.fills}
    assert filled_columns - set(TOTALS) == {"spring", "spring_cubic"}  # not of the motor's motion


def test_every_choice_brings_something():
    for options in (CHOICES, LOAD_CHOICES):
        for option, (choices, _) in options.items():
            for choice in choices:
                rows = [q for q in QUANTITIES.values() if q.option == option]
                assert any(q.brought_by(choice) for q in rows)
                kind, name = (Load, {}) if options is LOAD_CHOICES else (Element, {"name": "motor"})
                assert kind(**name, **{option: choice}).choices == {option: choice}


def test_a_ripple_of_what_slides_is_told_in_metres():
    """Its column takes the position as it is: 2513 cycles in 2π m are 400 a metre."""
    slides = Joint([Element("motor", cogging=(2513,), motion="linear")], load=Load(motion="linear"))
    (sine, _) = (p for p in slides.parameters if "cogging" in p.name)
    assert sine.meaning == "force with the sine of 2513 cycles in 2π m"
    state = State(1.0 / 1600.0, 0.0, 0.0, 0.0, 0.0)
    assert sine.row.column(state) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("role", ["form", "loss", "own"])
def test_what_nothing_knows_is_refused(role, monkeypatch):
    """Dropped, it would count as zero."""
    column = None if role == "own" else lambda m: m.speed
    row = Quantity("strange", ("", ""), "", "", option="strange", role=role, column=column)
    monkeypatch.setitem(QUANTITIES, "strange", row)
    for options in (CHOICES, LOAD_CHOICES):
        monkeypatch.setitem(options, "strange", ((True,), ""))
    with pytest.raises(KeyError, match="strange"):
        Joint((Element("motor", inertia=True, strange=True),), Load())
    with pytest.raises(KeyError, match="strange"):
        Joint((Element("motor", inertia=True),), Load(strange=True))


MOTOR = Joint((Element("motor", inertia=True),), Load())


def test_a_term_replaces_one_of_its_name():
    term = own("cogging", "motor")
    chain = MOTOR.with_term(term).with_term(term)
    assert chain.names.count("motor.cogging") == 1


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: Term("cogging", lambda m: m.speed), ValueError, "element.quantity"),
        (lambda: Term("motor.viscous", lambda m: m.speed), ValueError, "another name"),
        (lambda: Term("motor.x", lambda m: m.acceleration), TypeError, "speed, direction"),
        (lambda: Term("motor.x", lambda m: [m.nothing]), TypeError, "cannot be compiled"),
        (
            lambda: Joint([Element("motor")], terms=(own("cogging", "moter"),)),
            ValueError,
            "'motor'",
        ),
        (lambda: Element("motor", viscos=True), ValueError, "did you mean 'viscous'"),
        (lambda: Element("motor", coulomb="by direction"), ValueError, "by-direction"),
        (lambda: Load(viscous=True), ValueError, "no option"),
    ],
)
def test_what_cannot_be_is_refused(make, error, words):
    with pytest.raises(error, match=words):
        make()


def test_a_choice_replaces_what_was_chosen():
    element = Element("gearbox", inertia=True, load_loss="two")
    one = replace(element, load_loss="one", viscous=True)
    assert [q.name for q in one.quantities] == ["inertia", "viscous", "load"]
    assert replace(one, inertia=False, load_loss="none").choices == {"viscous": True}


@pytest.fixture(params=[("viscous", "motor"), ("power", "motor"), ("spring", "load")])
def pushed(request, make_observation):
    """A joint whose load is pushed by a measured torque as well."""
    chain = chain_with(*request.param)
    return recorded(make_observation, chain, values_of(chain), load_torque=True)


def test_a_measured_load_torque_on_every_path(pushed):
    test_plain_and_compiled(pushed)
    test_moments_prepared_and_fused(pushed)
    test_forward_then_inverse(pushed)


def test_a_column_up_to_its_coefficient_on_every_path(pushed):
    """Of minus one it is what a measured load torque is."""
    chain, values, o = pushed
    chain = replace(chain, load=replace(chain.load, signals=("push",)))
    named = dict(zip(pushed[0].names, values.tolist(), strict=True))
    inputs = replace(o.inputs, load_torque=None, others={"push": o.inputs.load_torque})
    signal = chain, chain.vector({**named, "load.push": -1.0}), replace(o, inputs=inputs)
    np.testing.assert_allclose(by_the_table(*signal), by_the_table(*pushed))
    test_a_measured_load_torque_on_every_path(signal)


def test_a_measured_load_torque_takes_the_scaling_away(pushed):
    chain, values, o = pushed
    assert scalings(chain)
    assert open_scalings(chain, Knowledge(), [o]) == ()
    form = torque_form(chain, [o])
    if form is not None:
        left = VariableProjection(
            form, [replace(o, measured=o.filter.apply(by_the_table(chain, values, o)))]
        )
        assert np.abs(left.residual(form.thetas(values)[1])).max() < SHORT * np.abs(o.torque).max()
