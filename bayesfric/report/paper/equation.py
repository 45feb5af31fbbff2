r"""The inverse model of a joint as equations: element by element, only the terms that it has.

Columns are written down by themselves (:mod:`bayesfric.report.answers.formula`), symbols are those
of the parameters, so that a term of the table is in the equation of any paper without another line.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import NamedTuple

from bayesfric.mechanism.element import Element
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import Parameter
from bayesfric.mechanism.quantities import SHAPES
from bayesfric.report.answers.formula import Formula, Unwritten, formula_of
from bayesfric.report.paper.latex import width


class Name(NamedTuple):
    """A variable or parameter: as LaTeX sets it, and as plain text writes it."""

    latex: str
    plain: str


# Points in a column of 3.4 inches, less some for what differs between TeX and Matplotlib.
_COLUMN = 235.0
Node = float | Name | list["str | Node"]
_Q, _QD, _QDD = Name("q", "q"), Name(r"\dot q", "qd"), Name(r"\ddot q", "qdd")
_SIGN: Node = ["sign", _QD]
_SIGNALS: Mapping[str, Node] = {
    "temperature": Name(r"\vartheta", "temperature"),
    "torque_rate": Name(r"\dot\Gamma", "torque_rate"),
}


def equations(joint: Joint) -> list[tuple[Name, Node]]:
    """Write the measured motor torque down, eqs. (3) to (9), from the motor to the load.

    ``q`` is the position of the joint; every element's line is the torque at its own input.
    """
    felt = {one.name: _felt(one.name) for one in joint.elements}
    behind = [felt[one.name] for one in joint.elements[1:]]
    behind.append(_felt("load"))
    first = felt[joint.elements[0].name]
    measured: Node = first
    own = _own(joint, "") | _own(joint, "drive")
    if joint.offset_names:
        name = own["offset"] if not joint.own_offsets else Name(r"\Gamma_{0,k}", "offset")
        measured = ["add", measured, name]
    if "gain" in own:
        measured = ["divide", measured, own["gain"]]
    if "delay" in own:
        measured = ["add", measured, ["multiply", own["delay"], _SIGNALS["torque_rate"]]]
    lines = [] if measured == first else [(Name(r"\Gamma", "torque"), measured)]
    for element, output in zip(joint.elements, behind, strict=True):
        lines.append((felt[element.name], _through(joint, element, output)))
    lines.append((behind[-1], _sum(_terms(joint, "load", joint.load.gravity))))
    return lines


def latex_equations(joint: Joint) -> str:
    """Set them as an ``align*``, which takes the package amsmath, broken for a narrow column."""
    lines = equations(joint)
    before = max(width(rf"{left.latex} = ") for left, _ in lines)
    rows = [row for left, right in lines for row in _rows(left, right, _COLUMN - before)]
    return "\\begin{align*}\n" + " \\\\\n".join(rows) + "\n\\end{align*}"


def _rows(left: Name, right: Node, room: float) -> Iterator[str]:
    """Break a sum before a term, and a long term before a factor, where a row is full."""
    begin, row = rf"{left.latex} &= ", ""
    room -= width(r"\quad")  # by which what goes on is indented
    terms = right[1:] if isinstance(right, list) and right[0] == "add" else [right]
    for k, term in enumerate(terms):
        parts = [f" + {latex(term)}" if k else latex(term)]
        if width(parts[0]) > room and isinstance(term, list) and term[0] == "multiply":
            first, *others = _factors(term)
            parts = [f" + {first}" if k else first, *others]
        for one in parts:
            part = one
            if row and width(row + part) > room:
                yield begin + row
                # without {} before it, a sign would be that of a number
                begin, row = r"&\quad {}", ""
                part = rf" \cdot {part[2:]}" if part.startswith(r"\,") else part
            row += part
    yield begin + row


def plain_equations(joint: Joint) -> list[str]:
    """Write them as text that most programming languages read."""
    return [f"{left.plain} = {plain(right)}" for left, right in equations(joint)]


def _felt(name: str) -> Name:
    return Name(rf"\Gamma_{{\mathrm{{{_upright(name)}}}}}", f"torque_{name}")


def _upright(name: str) -> str:
    return name.replace("_", r"\_")


def _named(p: Parameter) -> Name:
    # one load loss alone has no subscript
    return Name(p.symbol.replace("_{}", ""), p.name)


def _own(joint: Joint, owner: str) -> dict[str, Name]:
    return {p.quantity: _named(p) for p in joint.parameters if p.owner == owner}


def _sum(terms: list[Node]) -> Node:
    return ["add", *terms] if len(terms) > 1 else terms[0] if terms else 0.0


def _through(joint: Joint, element: Element, output: Name) -> Node:
    """Give the torque at an element's input, section 2.2 with eq. (2)."""
    torque: Node = output if element.ratio == 1.0 else ["divide", output, element.ratio]
    return _sum([torque, *_terms(joint, element.name), *_losses(joint, element, torque)])


def _scaled(reach: float, what: Name) -> Node:
    if reach == 1.0:
        return what
    return Name(rf"{reach:.6g}\,{what.latex}", f"{reach:.6g} * {what.plain}")


def _rise(joint: Joint, element: str, *names: str) -> Node | None:
    """Give the factor of the rise at low speed, if the element has one of these."""
    own = _own(joint, element)
    ratio = next((own[name] for name in names if name in own), None)
    if ratio is None:
        return None
    speed: Node = [
        "absolute",
        ["divide", _scaled(joint.reaches[element], _QD), own["stribeck_velocity"]],
    ]
    fallen: Node = ["exp", ["negative", ["power", speed, own.get("stribeck_exponent", 2.0)]]]
    return ["add", 1.0, ["multiply", ratio, fallen]]


def _terms(joint: Joint, owner: str, gravity: float = 0.0) -> list[Node]:
    """List the terms that do not depend on the transmitted torque."""
    own = _own(joint, owner)
    reach = joint.reaches[owner]
    angle: Node = ["add", _Q, own["gravity_angle"]] if "gravity_angle" in own else _Q
    state: dict[str, Node] = {
        "position": _scaled(reach, _Q),
        "speed": _scaled(reach, _QD),
        "acceleration": _scaled(reach, _QDD),
        "direction": _SIGN,
        "time": Name("t", "t"),
        "gravity": ["multiply", Name("g", f"{gravity:.6g}"), ["sin", angle]],
    }
    rise = _rise(joint, owner, "stribeck_ratio", "stribeck_change", "stribeck_constant")
    found: list[Node] = []
    for p in joint.parameters:
        if p.owner != owner or p.row.role != "own" or p.quantity in SHAPES:
            continue
        here = state | ({"shape": own[p.row.shape]} if p.row.shape else {})
        factors: list[str | Node] = ["multiply", _named(p)]
        if p.row.signal:
            signal = _SIGNALS[p.row.signal]
            factors.append(["subtract", signal, p.row.zero] if p.row.zero else signal)
        if p.row.column is not None:
            factors.append(_column(p, here))
        if p.row.rises and rise is not None:
            factors.append(rise)
        found.append(factors)
    return found


def _column(p: Parameter, state: Mapping[str, Node]) -> Node:
    assert p.row.column is not None
    try:
        return _filled(formula_of(p.row.column, shaped=bool(p.row.shape)), state)
    except Unwritten:  # a term of the user's own that only Python knows
        words = rf"h_{{\mathrm{{{_upright(p.quantity)}}}}}(q, \dot q, \ddot q)"
        return Name(words, f"{p.quantity}_column(q, qd, qdd)")


def _filled(formula: Formula, state: Mapping[str, Node]) -> Node:
    if isinstance(formula, str):
        return state[formula]
    if isinstance(formula, list):
        return [formula[0], *(_filled(one, state) for one in formula[1:])]
    return formula


def _losses(joint: Joint, element: Element, torque: Node) -> Iterator[Node]:
    """Give what is lost of the transmitted torque; where nothing shapes it, as in eq. (13)."""
    if element.load_loss == "none":
        return
    forms = _own(joint, element.name)
    rise = _rise(joint, element.name, "stribeck_ratio", "stribeck_change", "stribeck_load")

    def shaped(mu: Node, difference: str) -> Node:
        half = forms.get("load_difference") or forms.get(difference)
        out: Node = mu if half is None else ["add", mu, ["multiply", half, _SIGN]]
        out = out if rise is None else ["multiply", out, rise]
        if "load_speed" in forms:
            speed: Node = ["absolute", _scaled(joint.reaches[element.name], _QD)]
            out = ["add", out, ["multiply", forms["load_speed"], speed]]
        return out

    size: Node = ["absolute", torque]
    drive = forms.get("load") or forms["load_drive"]
    back = forms.get("load") or forms["load_back"]
    mu1, mu2 = shaped(drive, "load_drive_difference"), shaped(back, "load_back_difference")
    if mu1 == mu2:
        yield ["multiply", _SIGN, mu1, size]
    else:  # lambda_1 = (1/alpha_1 + 1/alpha_2)/2, lambda_2 = (1/alpha_1 - 1/alpha_2)/2
        yield ["multiply", ["divide", ["subtract", mu1, mu2], 2.0], torque]
        yield ["multiply", _SIGN, ["divide", ["add", mu1, mu2], 2.0], size]
    if "load_square" in forms:
        yield ["multiply", _SIGN, forms["load_square"], ["power", torque, 2.0]]


_FUNCTIONS = {name: rf"\{name}" for name in ("sin", "cos", "tan", "exp", "log")}
_FUNCTIONS |= {"maximum": r"\max", "minimum": r"\min"}
_LOOSE = ("add", "subtract", "negative")
_WORDS = {"maximum": "max", "minimum": "min"}


def latex(x: str | Node) -> str:
    """Set an expression in LaTeX."""
    if isinstance(x, list) and x[0] == "multiply":
        return "".join(_factors(x))
    power, absolute = r"{{\left({}\right)}}^{{{}}}", r"\left|{}\right|"
    return _written(x, latex, r"\frac{{{}}}{{{}}}", power, absolute)


def plain(x: str | Node) -> str:
    """Write an expression as text."""
    if isinstance(x, list) and x[0] in ("multiply", "divide"):
        tight = (_tight(one, plain(one), (*_LOOSE, "divide")) for one in x[1:])
        return {"multiply": " * ", "divide": "/"}[str(x[0])].join(tight)
    return _written(x, plain, "", "({})**({})", "abs({})")


def _written(
    x: str | Node, write: Callable[[str | Node], str], divide: str, power: str, absolute: str
) -> str:
    """Write what both do alike, with the forms in which they differ."""
    if isinstance(x, Name):
        return x.latex if write is latex else x.plain
    if not isinstance(x, list):
        return f"{x:g}"
    op, parts = str(x[0]), [write(one) for one in x[1:]]
    last = _tight(x[-1], parts[-1])
    if op == "add":
        return " + ".join(parts)
    if op in ("subtract", "negative"):
        return f"{parts[0]} - {last}" if op == "subtract" else f"-{last}"
    forms = {"divide": divide, "power": power, "absolute": absolute}
    if op in forms:
        return forms[op].format(*parts)
    function = _WORDS.get(op, op)
    if write is latex:
        function = _FUNCTIONS.get(op, rf"\operatorname{{{op}}}")
    return f"{function}({', '.join(parts)})"


def _tight(x: str | Node, text: str, loose: Collection[str] = _LOOSE) -> str:
    return f"({text})" if isinstance(x, list) and x[0] in loose else text


def _factors(product: list[str | Node]) -> list[str]:
    """Set the factors of a product, numbers first, each with what joins it to the one before."""
    tight = [_tight(one, latex(one)) for one in product[1:]]
    ordered = sorted(tight, key=lambda text: not text[:1].isdigit())
    return [
        text if not k else (r" \cdot " if text[:1].isdigit() else r"\,") + text
        for k, text in enumerate(ordered)
    ]


def of_eq_13(joint: Joint) -> bool:
    """Whether it has the form of eq. (13): one load loss, and nothing else that shapes it."""
    lossy = [one.name for one in joint.elements if one.load_loss != "none"]
    shaped = any(p.owner in lossy and p.row.role == "form" for p in joint.parameters)
    return len(lossy) == 1 and not shaped
