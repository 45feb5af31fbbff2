"""The rule every bad input is held to, and the command run on it in this process.

`bayesfric check` ends with 0 or 2, soon; with 2 it says one line that names the place and
the mend; and it writes nothing.
"""

import io
import re
import signal
import sys
import time
import traceback
import warnings
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from unittest import mock

from bayesfric.commands import cli
from tests.commands.bench import has

# Of the processor; what waits for something takes none, and may take this much longer.
SECONDS = 10
PATIENCE = 20
_LINE = re.compile(r"bayesfric: [^\n]+: [^\n]+; [^\n]+\n")
_FOREIGN = ("Traceback", "Input should", "pydantic", "ufunc", "<class", "object at 0x")
_LONGEST = 3000


class TooLong(BaseException):
    """Raised by the alarm; no reader's ``except Exception`` may swallow it."""


@dataclass
class Outcome:
    code: object
    out: str
    err: str
    seconds: float


@contextmanager
def at_most(seconds):
    """End what runs inside if it takes longer: of the processor, so that a busy machine may."""

    def stop(*_):
        raise TooLong(f"more than {seconds} s")

    clocks = (
        (signal.SIGPROF, signal.ITIMER_PROF, seconds),
        (signal.SIGALRM, signal.ITIMER_REAL, PATIENCE * seconds),
    )
    old = [signal.signal(number, stop) for number, _, _ in clocks]
    for _, clock, limit in clocks:
        signal.setitimer(clock, limit)
    try:
        yield
    finally:
        for (number, clock, _), before in zip(clocks, old, strict=True):
            signal.setitimer(clock, 0)
            signal.signal(number, before)


def held(folder):
    """What a folder holds, as cheap to take as it is certain to change with a write."""
    return {
        str(path): (path.lstat().st_size, path.lstat().st_mtime_ns)
        for path in sorted(folder.rglob("*"))
    }


def check(config, *, seconds=SECONDS):
    """Run ``bayesfric check CONFIG --json`` here."""
    return run("check", str(config), "--json", seconds=seconds)


def run(*words, seconds=SECONDS):
    """Run a command here; libraries' warnings count as errors."""
    out, err = io.StringIO(), io.StringIO()
    begin = time.perf_counter()
    with (
        redirect_stdout(out),
        redirect_stderr(err),
        mock.patch.object(sys, "argv", ["bayesfric", *words]),
        mock.patch.object(sys, "warnoptions", ["error"]),
        warnings.catch_warnings(),
        at_most(seconds),
    ):
        warnings.simplefilter("error")
        try:
            cli.main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
    return Outcome(code, out.getvalue(), err.getvalue(), time.perf_counter() - begin)


def broken_rule(config, *names, seconds=SECONDS, told=None):
    """Run the command; how it breaks the rule, or None.

    ``names`` are words of which the complaint must hold one: the file, the key. The outcome is
    added to the list ``told``.
    """
    before = held(config.parent)
    try:
        outcome = check(config, seconds=seconds)
    except (Exception, TooLong):
        return traceback.format_exc()
    if told is not None:
        told.append(outcome)
    if outcome.code not in (0, 2):
        return f"exit code {outcome.code}: {outcome.err}"
    if held(config.parent) != before:
        return "the folder changed"
    if outcome.code == 0:
        return None if outcome.out.startswith("{") else f"no JSON: {outcome.out[:200]}"
    problems = [
        outcome.out and f"stdout is not empty: {outcome.out[:200]}",
        not _LINE.fullmatch(outcome.err) and "not one line of where: what; mend",
        not outcome.err[:-1].isprintable() and "unprintable characters",
        len(outcome.err) > _LONGEST and f"a line of {len(outcome.err)} characters",
        any(word in outcome.err for word in _FOREIGN) and "foreign words",
        names and not any(name in outcome.err for name in names) and f"names none of {names}",
    ]
    wrong = [problem for problem in problems if problem]
    return f"{'; '.join(map(str, wrong))}: {outcome.err[:600]}" if wrong else None


def refuses(config, *parts, seconds=SECONDS):
    """The command refuses in one line, which holds some words."""
    told = []
    assert broken_rule(config, seconds=seconds, told=told) is None
    (outcome,) = told
    assert outcome.code == 2, outcome
    has(outcome.err, *parts)
