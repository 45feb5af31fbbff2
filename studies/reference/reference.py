"""Write the reference: every key, every warning and every error with its mend, out of the code.

``python studies/reference/reference.py`` writes ``keys.md``, ``warnings.md`` and ``errors.md``
beside itself. Words are read where they are declared: keys from the models, sentences from their
templates, and errors from the source, where each is ``BadInput(where, what, mend)``.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path

from bayesfric.commands.keys import keys_text

PACKAGE = Path(str(files("bayesfric")))
FOLDER = Path(__file__).parent
# What stands where only a run can tell.
OPEN = "…"
_LISTS = ("warnings", "problems")
# Rooms that only tell what others found.
_TELLERS = ("bayesfric/report", "bayesfric/export", "bayesfric/commands")
_TELLING = (ast.Call, ast.Assign, ast.AugAssign, ast.keyword, ast.Yield, ast.Return)
_CHECKS = ("field_validator", "model_validator")
_AFTER_READING = (
    "What a model refuses, such as a number beyond its bounds, is told with the key, as "
    "`got VALUE; give WHAT FITS`: [keys.md](keys.md)."
)


class Words:
    """What the strings of a function say; ``…`` and ``{name}`` are what only a run can tell."""

    def __init__(self, tree: ast.Module, function: ast.AST, use: ast.AST | None = None) -> None:
        self.assigned: dict[str, list[ast.expr]] = {}
        for node in tree.body:
            self._assign(node)
        for block in _blocks_to(function, use):
            # what a block around it says last stands for what was said before
            for node in block:
                plain = {
                    one.id for one in getattr(node, "targets", ()) if isinstance(one, ast.Name)
                }
                self.assigned = {k: v for k, v in self.assigned.items() if k not in plain}
                for inner in ast.walk(node):
                    self._assign(inner)

    def _assign(self, node: ast.AST) -> None:
        if isinstance(node, ast.Assign):
            for target in node.targets:
                self._put(target, node.value)
        elif isinstance(node, ast.AnnAssign | ast.NamedExpr) and node.value:
            self._put(node.target, node.value)

    def _put(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Name):
            self.assigned.setdefault(target.id, []).append(value)
        elif isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            for one, part in zip(target.elts, value.elts, strict=True):
                self._put(one, part)

    def of(self, node: ast.AST, seen: tuple[str, ...] = ()) -> str:
        """Write an expression that makes a text."""
        match node:
            case ast.Constant(value=str(text)):
                return text
            case ast.JoinedStr(values=parts):
                return "".join(self.of(part, seen) for part in parts)
            case ast.FormattedValue(value=inner):
                told = self.of(inner, seen) if isinstance(inner, ast.IfExp) else OPEN
                return told if told != OPEN else _named(inner)
            case ast.BinOp(op=ast.Add(), left=left, right=right):
                return self.of(left, seen) + self.of(right, seen)
            case ast.IfExp(body=body, orelse=other):
                return f"[{_either([self.of(body, seen), self.of(other, seen)])}]"
            case ast.Call(func=ast.Name(id="nearest")):
                return "did you mean the nearest name there is? Or use one of those that are listed"
            case ast.Call(func=ast.Name(id="str"), args=[inner]):
                return _named(inner)
            case ast.Name(id=name) if name in self.assigned and name not in seen:
                told = [self.of(one, (*seen, name)) for one in self.assigned[name]]
                return _either([one for one in told if one != OPEN]) or _named(node)
        return _named(node)


def _blocks_to(function: ast.AST, use: ast.AST | None) -> Iterator[list[ast.stmt]]:
    """Give the statements that come before a use, block by block from the outermost."""
    if use is None or not hasattr(use, "lineno"):
        yield [one for one in ast.walk(function) if isinstance(one, ast.stmt)][1:]
        return
    node: ast.AST | None = function
    while node is not None:
        inside = None
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            block = [one for one in getattr(node, name, ()) if isinstance(one, ast.AST)]
            holds = [k for k, one in enumerate(block) if _lines(use) <= _lines(one)]
            if holds:
                inside = block[holds[0]]
                # the condition of a branch may name something, too
                yield [one for one in block[: holds[0]] if isinstance(one, ast.stmt)]
                if isinstance(inside, ast.If | ast.While):
                    yield [ast.Expr(inside.test)]
                elif isinstance(inside, ast.stmt) and not hasattr(inside, "body"):
                    yield [inside]
        node = inside


def _lines(node: ast.AST) -> set[int]:
    """Lines that a node stands on."""
    part = node.pattern if isinstance(node, ast.match_case) else node
    last = node.body[-1] if isinstance(node, ast.match_case) else node
    return set(range(part.lineno, last.end_lineno + 1))


def _either(texts: Sequence[str]) -> str:
    return " / ".join(dict.fromkeys(text for text in texts if text))


def _named(node: ast.AST) -> str:
    """Name what a run fills in, where it has a plain name."""
    match node:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return f"{{{name}}}"
    return OPEN


@cache
def sources() -> dict[str, ast.Module]:
    """Every module of the package, by its path."""
    paths = sorted(PACKAGE.rglob("*.py"))
    names = (f"bayesfric/{path.relative_to(PACKAGE).as_posix()}" for path in paths)
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in paths)
    return dict(zip(names, trees, strict=True))


@cache
def told() -> dict[str, list[tuple[ast.AST, ast.AST]]]:
    """Give what may hold a text, with the innermost function it stands in, by module."""
    found: dict[str, list[tuple[ast.AST, ast.AST]]] = {}
    for name, tree in sources().items():
        waiting: list[tuple[ast.AST, ast.AST]] = [(tree, tree)]
        found[name] = []
        while waiting:
            function, node = waiting.pop()
            for inner in ast.iter_child_nodes(node):
                owner = inner if isinstance(inner, ast.FunctionDef) else function
                waiting.append((owner, inner))
                if isinstance(inner, _TELLING):
                    found[name].append((owner, inner))
    return found


@cache
def errors() -> dict[str, list[tuple[str, str, str]]]:
    """Where, what and mend of every bad input, by module."""
    found: dict[str, list[tuple[str, str, str]]] = {}
    for name, tree in sources().items():
        rows = {row for function, node in told()[name] for row in _error(tree, function, node)}
        if rows:
            found[name] = sorted(rows)
    return found


def _error(tree: ast.Module, function: ast.AST, node: ast.AST) -> Iterator[tuple[str, str, str]]:
    match node:
        case ast.Call(func=ast.Name(id="BadInput"), args=[where, ast.Starred()]):
            yield Words(tree, function, node).of(where), f"got {OPEN}", f"give {OPEN}"
        case ast.Call(func=ast.Name(id="BadInput"), args=[where, what, mend]):
            words = Words(tree, function, node)
            yield words.of(where), words.of(what), words.of(mend)
        case ast.Call(func=ast.Name(id="Unfit"), args=[wanted, what]):
            words = Words(tree, function, node)
            yield "the key", words.of(what), f"give {words.of(wanted)}"
        case ast.Call(func=ast.Name(id="ValueError"), args=[what]) if _checks(function):
            yield "the key", Words(tree, function, node).of(what), "correct it"


def _checks(function: ast.AST) -> bool:
    """Whether it is a model's check of a key."""
    decorators = function.decorator_list if isinstance(function, ast.FunctionDef) else []
    calls = (one.func for one in decorators if isinstance(one, ast.Call))
    return any(isinstance(one, ast.Name) and one.id in _CHECKS for one in calls)


@cache
def warnings_of_recordings() -> dict[str, list[str]]:
    """Sentences that reading, filtering and sampling warn with, by module.

    They are what is put on a list of warnings or problems, and what functions give whose results
    are.
    """
    trees = {name: tree for name, tree in sources().items() if not name.startswith(_TELLERS)}
    makers = {
        call.func.attr if isinstance(call.func, ast.Attribute) else call.func.id
        for name in trees
        for _, node in told()[name]
        for given in _onto_lists(node)
        for call in ast.walk(given)
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute | ast.Name)
    }
    found = {}
    for name, tree in trees.items():
        rows = {
            Words(tree, function).of(text)
            for function, node in told()[name]
            for text in _texts(function, node, makers)
        }
        if kept := sorted(row for row in rows if len(row.split()) > 3):
            found[name] = kept
    return found


def _onto_lists(node: ast.AST) -> Iterator[ast.expr]:
    """Give what is put on a list of warnings."""
    match node:
        case ast.AugAssign(target=ast.Name(id=name), value=value) if name in _LISTS:
            yield value
        case ast.Assign(targets=[ast.Name(id=name)], value=value) if name in _LISTS:
            yield value
        case ast.Call(
            func=ast.Attribute(value=ast.Name(id=name), attr="append" | "insert"), args=a
        ):
            if name in _LISTS:
                yield a[-1]
        case ast.keyword(arg="warnings", value=value):
            yield value


def _texts(function: ast.AST, node: ast.AST, makers: set[str]) -> Iterator[ast.expr]:
    makes = isinstance(function, ast.FunctionDef) and function.name in makers
    match node:
        case ast.Yield(value=value) | ast.Return(value=value) if makes and value is not None:
            yield from _strings(value)
        case ast.Call(func=ast.Attribute(attr="append"), args=[value]) if makes:
            yield from _strings(value)
        case _:
            for value in _onto_lists(node):
                yield from _strings(value)


def _strings(node: ast.expr) -> Iterator[ast.expr]:
    """Texts in an expression: itself, or those of a list or tuple."""
    if isinstance(node, ast.List | ast.Tuple):
        for one in node.elts:
            yield from _strings(one)
    elif isinstance(node, ast.JoinedStr | ast.BinOp | ast.Name) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    ):
        yield node


def sentences() -> dict[str, str]:
    """Sentences that a run warns and doubts with, by their kind."""
    text = (PACKAGE / "report" / "templates" / "sentences.txt.j2").read_text(encoding="utf-8")
    macros = re.findall(r"\{% macro (\w+)\(.*?\) %\}(.*?)\{% endmacro %\}", text, re.DOTALL)
    helpers = {"listed", "percent", "lacking"}
    return {name: plain(body) for name, body in macros if name not in helpers}


def statements() -> dict[str, dict[str, str]]:
    """Sentences of ``identify``, by topic and kind."""
    path = PACKAGE / "identifiability" / "wording" / "sentences.toml"
    topics = tomllib.loads(path.read_text(encoding="utf-8"))
    return {topic: {kind: plain(x) for kind, x in rows.items()} for topic, rows in topics.items()}


def plain(template: str) -> str:
    """Write a template so that a person can read it: ``[a / b]`` where a run decides."""
    quoted = r"'([^']*)'|\"([^\"]*)\""

    def value(found: re.Match[str]) -> str:
        inner = found[1]
        if " if " not in inner:
            return OPEN
        words = ["".join(pair) for pair in re.findall(quoted, inner)]
        return f"[{_either(words)}]" if _either(words) else OPEN

    text = re.sub(r"\{#.*?#\}|\\\n", "", template, flags=re.DOTALL)
    text = re.sub(r"\{\{(.*?)\}\}", value, text, flags=re.DOTALL)
    for tag, put in (("(?:else|elif)", " / "), ("if", "["), ("endif", "]")):
        text = re.sub(rf"\{{%-? {tag}\b.*?%\}}", put, text, flags=re.DOTALL)
    text = re.sub(r"\{%.*?%\}", "", text, flags=re.DOTALL)
    # what only joins the items of a list
    text = re.sub(r"\[(, of |, )?( / )?(, )?\]", "", text)
    text = re.sub(r"(?:…[,\s]*){2,}", f"{OPEN} ", text)
    return " ".join(text.split())


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    cells = [[" ".join(cell.split()).replace("|", "\\|") for cell in row] for row in rows]
    lines = [f"| {' | '.join(row)} |" for row in [list(head), *cells]]
    return [lines[0], "|" + "---|" * len(head), *lines[1:], ""]


def errors_text() -> str:
    """Every error with its mend, as Markdown."""
    lines = [
        "# Every error with its mend",
        "",
        "Bad input ends a command with one line, `where: what; mend`, and exit code 2; nothing is "
        "half written. In Python it is `bayesfric.errors.BadInput` with these three parts. "
        f"`{OPEN}` and `{{names}}` are filled in by what was read; `[a / b]` is one of both.",
        "",
        _AFTER_READING,
        "",
    ]
    for module, rows in errors().items():
        lines += [f"## {module}", "", *_table(("where", "what", "mend"), rows)]
    return "\n".join(lines)


def warnings_text() -> str:
    """Every warning, as Markdown."""
    lines = [
        "# Every warning",
        "",
        f"A warning is one sentence that says what to do about it, where that is known. `{OPEN}` "
        "and `{names}` are filled in by a run; `[a / b]` is one of both.",
        "",
        "## Of a run: `bayesfric fit`, its page, `summary.json`",
        "",
        *_table(("kind", "sentence"), list(sentences().items())),
        "## Of recordings and of the sampling: `bayesfric check`, `bayesfric fit`",
        "",
    ]
    told = [(module, row) for module, rows in warnings_of_recordings().items() for row in rows]
    lines += _table(("where it is worded", "sentence"), told)
    lines += ["## Of `bayesfric identify`", ""]
    of_identify = [
        (f"{t}, {kind}", x) for t, rows in statements().items() for kind, x in rows.items()
    ]
    lines += _table(("kind", "sentence"), of_identify)
    return "\n".join(lines)


def texts() -> dict[str, str]:
    """Make what is written, by file name."""
    keys = f"{keys_text('configuration')}\n{keys_text('fleet')}"
    return {"keys.md": keys, "warnings.md": warnings_text(), "errors.md": errors_text()}


if __name__ == "__main__":
    for name, text in texts().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(f"{name}: {len(text.splitlines())} lines")
