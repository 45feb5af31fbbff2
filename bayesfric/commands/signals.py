"""Ctrl-C and SIGTERM while something is being done that should not break off anywhere."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@dataclass
class Asked:
    """Whether the user asked to stop.

    Attributes
    ----------
    by
        The signal.
    again
        Whether they asked a second time, and want no more waiting.
    """

    by: int | None = None
    again: bool = False


@contextmanager
def asked_to_stop(worth_waiting: Callable[[], bool]) -> Iterator[Asked]:
    """Note a signal while ``worth_waiting``; raise KeyboardInterrupt at any other moment.

    A second signal always does. Signals that are ignored, as those of a run under ``nohup``
    are, stay so, and the previous handlers are put back at the end.
    """
    asked = Asked()

    def note(number: int, _: FrameType | None) -> None:
        asked.again = asked.by is not None
        asked.by = asked.by or number
        if asked.again or not worth_waiting():
            raise KeyboardInterrupt

    before = {}
    # Python lets only the main thread have handlers
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.getsignal(number) for number in _SIGNALS}
    heard = {n: h for n, h in before.items() if h is not None and h is not signal.SIG_IGN}
    try:
        for number in heard:
            signal.signal(number, note)
        yield asked
    finally:
        for number, handler in heard.items():
            signal.signal(number, handler)
