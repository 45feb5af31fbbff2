"""Terms that a joint may lack: every option of the table that it has not chosen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bayesfric.estimates.sizes import Scales, measured_scales, sizes_at
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import TURN
from bayesfric.mechanism.quantities import (
    CHOICES,
    CYCLE_PHRASES,
    CYCLES,
    LOAD_CHOICES,
)
from bayesfric.recordings.observation import Observation

# Numbers of cycles a turn that are tried, where so many fit into the motion: fewer are no more
# than some dependence on position.
_MOST_CYCLES = 12
_PERIODS = 2.0
# An inertia elsewhere is one with that which is there; the unknown offset and delay of a whole
# chain have their own checks.
_LEFT_OUT = frozenset({"inertia"})
# What most joints have: gravity, and the offset of a drive's current.
_USUAL = frozenset({"first_moment", "gravity_angle", "offset"})
# Options of a load that come with another one: a real arm does not hang at zero.
_ON_TOP = {"gravity_angle": "first_moment"}


# Owner, option, choice.
Key = tuple[str, str, str]


@dataclass(frozen=True, eq=False)
class Candidate:
    """One change of a joint, at one value of what shapes it."""

    owner: str  # name of the element, ``load``, or empty for the whole chain
    option: str
    choice: Any
    phrase: str  # what it is called in a sentence
    chain: Joint  # with it
    point: Mapping[str, float]  # of that chain; what it brings is neutral there, or small
    new: tuple[str, ...]  # parameters that it brings
    sign: int  # of what it brings, where that can have one only; 0 where it can have both
    shape: tuple[str, float] | None = None  # what shapes it, and at which value it is tried
    shapes: tuple[float, ...] = ()  # all values at which that is tried
    instead: bool = False  # whether it takes the place of something

    @property
    def brings(self) -> tuple[str, ...]:
        """Parameters that it brings, with what shapes it."""
        return (*self.new, self.shape[0]) if self.shape else self.new

    @property
    def place(self) -> tuple[str, str]:
        """What it fills: one element's option, or that of all elements.

        Of two load losses one behind the other a motion hardly tells more than their product; and
        were they free to be negative, which nothing in a linear search forbids, their difference
        would pass for anything.
        """
        return ("" if self.option == "load_loss" else self.owner), self.option

    @property
    def usual(self) -> bool:
        """Whether most joints have it."""
        return self.option in _USUAL

    @property
    def key(self) -> Key:
        """What it is, whatever shapes it and however often it repeats."""
        return self.owner, self.option, "" if self.option in CYCLES else str(self.choice)

    def added_to(self, chain: Joint) -> Joint:
        """Give another chain with this change as well."""
        if not self.owner:
            return replace(chain, offset=True)
        bearers: list[Element | Load] = [*chain.elements, chain.load]
        bearer = next(one for one in bearers if one.name == self.owner)
        choice = self.choice
        if self.option in CYCLES:
            choice = tuple(sorted({*bearer.choices.get(self.option, ()), *self.choice}))
        return with_choice(chain, bearer, self.option, choice)

    @property
    def setting(self) -> str:
        """Where and how a configuration says it."""
        if len(self.new) > 1 and self.option in _ON_TOP:
            both = f"{_ON_TOP[self.option]} = true, {self.option} = true"
            return f"mechanism.{self.owner} = {{ {both} }}"
        if not self.owner:
            return f"mechanism.{self.option} = true"
        place = "load" if self.owner == "load" else f"elements.{self.owner}"
        value = {True: "true"}.get(self.choice, f'"{self.choice}"')
        if isinstance(self.choice, tuple):
            value = str(list(self.choice))
        return f"mechanism.{place}.{self.option} = {value}"


def candidates(
    chain: Joint, observations: Sequence[Observation], point: Mapping[str, float]
) -> list[Candidate]:
    """List what a chain with these parameters may lack, the same at several values of a shape."""
    scales = measured_scales(chain, observations)
    found: list[Candidate] = []
    bearers: list[Element | Load] = [*chain.elements, chain.load]
    lossy = [e.name for e in chain.elements if e.load_loss != "none"]
    warmth = all(o.inputs.temperature is not None for o in observations)
    for bearer in bearers:
        options = LOAD_CHOICES if isinstance(bearer, Load) else CHOICES
        for option, choices in options.items():
            for choice, phrase in choices.items():
                shows = option not in _LEFT_OUT and (option != "temperature" or warmth)
                second = option == "load_loss" and bearer.name not in lossy and lossy
                if shows and not second and _goes(bearer, option, choice):
                    found += _changed(chain, bearer, option, choice, phrase, point, scales)
        turns = scales.position * chain.reaches[bearer.name] / TURN
        for option in CYCLES if bearer.motion == "rotary" else ():
            has = bearer.choices.get(option, ())
            for cycles in range(1, _MOST_CYCLES + 1):
                if cycles not in has and cycles * turns >= _PERIODS:
                    phrase = f"{CYCLE_PHRASES[option]} {cycles} times a turn"
                    more = (*has, cycles)
                    found += _changed(chain, bearer, option, more, phrase, point, scales)
    if not chain.offset_names:
        made = replace(chain, offset=True)
        phrase = "a constant torque"
        values = {**point, "offset": 0.0}
        found.append(_candidate(made, "", "offset", True, phrase, point, values))
    return found


def with_choice(chain: Joint, bearer: Element | Load, option: str, choice: Any) -> Joint:
    """Give a chain in which one of its elements, or the load, has another option."""
    chosen: dict[str, Any] = {_ON_TOP[option]: True} if option in _ON_TOP else {}
    changed = replace(bearer, **{**chosen, option: choice})
    if isinstance(changed, Load):
        return replace(chain, load=changed)
    elements = [changed if e.name == bearer.name else e for e in chain.elements]
    return replace(chain, elements=tuple(elements))


def _goes(bearer: Element | Load, option: str, choice: Any) -> bool:
    """Whether a choice is more than what is there, and has what it changes."""
    now = bearer.choices.get(option)
    if now == choice:
        return False
    if isinstance(bearer, Load):
        sliding = bearer.motion == "linear" and option in ("first_moment", "gravity_angle")
        return not sliding and (now is None or choice == "stiffening")
    if now is not None:
        # from the simpler to the richer only, in the order of the table
        known = list(CHOICES[option])
        return known.index(choice) > known.index(now) and choice != "either"
    lossy = bearer.load_loss != "none"
    wants = {
        "stribeck_exponent": "stribeck" in bearer.choices,
        "load_direction": lossy and (choice is True) == (bearer.load_loss == "one"),
        "load_speed": lossy,
        "load_square": lossy,
    }
    if option == "stribeck" and choice == "apart":
        return lossy and bearer.has("coulomb", "coulomb_positive")
    if option == "stribeck":
        return lossy or bearer.has("coulomb", "coulomb_positive")
    return wants.get(option, True)


def _changed(
    chain: Joint,
    bearer: Element | Load,
    option: str,
    choice: Any,
    phrase: str,
    point: Mapping[str, float],
    scales: Scales,
) -> Iterator[Candidate]:
    """Give the chain with one choice, once for every value at which its shape is tried."""
    made = with_choice(chain, bearer, option, choice)
    values: dict[str, float] = {}
    shapes: list[tuple[str, tuple[float, ...]]] = []
    replaced = [q for q in bearer.quantities if q.option == option]
    below = _ON_TOP.get(option, "")
    if below and not bearer.has(below):
        phrase = f"{LOAD_CHOICES[below][True]}, with {phrase}"
    for p in made.parameters:
        if p.name in point:
            values[p.name] = point[p.name]
            continue
        # what takes another's place begins as that one, such as one direction of a loss
        same = [q for q in replaced if q.role == p.row.role and not p.row.tries]
        values[p.name] = point[f"{bearer.name}.{same[0].name}"] if same else p.default
        if p.quantity == below and p.row.spread is not None:
            # of nothing no angle shows
            values[p.name] = p.row.spread(sizes_at(chain, bearer.name, scales))
        if p.row.tries is not None:
            shapes.append((p.name, p.row.tries(sizes_at(chain, bearer.name, scales))))
    if not shapes:
        yield _candidate(made, bearer.name, option, choice, phrase, point, values)
    for name, tried in shapes:
        for value in tried:
            at = {**values, name: value}
            shape = (name, value)
            one = _candidate(made, bearer.name, option, choice, phrase, point, at, shape)
            yield replace(one, shapes=tried)


def _candidate(
    made: Joint,
    owner: str,
    option: str,
    choice: Any,
    phrase: str,
    point: Mapping[str, float],
    values: Mapping[str, float],
    shape: tuple[str, float] | None = None,
) -> Candidate:
    new = [p for p in made.parameters if p.name not in point and p.row.tries is None]
    instead = any(n not in made.names and n.partition(".")[0] == owner for n in point)
    sign = 1 if all(p.lower == 0.0 for p in new) and not instead else 0
    # the same column as a rise has, the other way round
    if (option, choice) == ("stribeck", "either"):
        sign = -1
    names = tuple(p.name for p in new)
    return Candidate(
        owner, option, choice, phrase, made, values, names, sign, shape, instead=instead
    )
