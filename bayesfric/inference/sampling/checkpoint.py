"""A sampling's steps on disk, so that an interrupted one goes on where it stopped.

No library's backend keeps the promise this keeps: a resumed run's bytes are those of one never
interrupted. Sampling is repeatable: the same seed, data and code make the same steps. A resumed
run therefore begins like a new one, and only takes the steps that it would make from the
checkpoint as long as there are any. Whatever depends on steps (walkers brought back, the proposal,
the likelihood prepared for the draws, when to stop) is worked out from them again, and so are the
draws of every other random generator; just the sampler's own generator, which those steps would
have moved on, is set to where it was.

The file is a journal: a line of JSON that says what the steps depend on, then a row of bytes for
each step, with the generator's state after it and its own checksum. Rows are only ever put behind
the others. So it can be read whenever its writer is killed, and what is damaged, from there on, is
sampled again. (HDF5 is no journal: a process killed while the library rewrites an index leaves a
file that nobody opens again.)
"""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.recordings.arrays import Array

# As numpy.random.RandomState gives and takes it.
RandomState = tuple[str, NDArray[np.uint32], int, int, float]

FORMAT = 4
# Share of the time that may go into saving.
_SHARE = 0.02
# Bytes of the first line at most.
_LONGEST = 2**24
# What rounding may do to a log-probability, evaluated beside others or alone.
_ROUNDING = 1e-9


def _row(walkers: int, dimension: int) -> np.dtype[np.void]:
    """Lay out a step of so many walkers in so many dimensions."""
    return np.dtype(
        [
            ("coordinates", "<f8", (walkers, dimension)),
            ("log_density", "<f8", (walkers,)),
            ("accepted", "?", (walkers,)),  # whether a proposal was
            # of the sampler's generator, see RandomState
            ("key", "<u4", (624,)),
            ("place", "<i8"),
            ("has_gauss", "<i8"),
            ("gauss", "<f8"),
            ("not_finite", "<i8"),  # how often there was no number so far
            ("seconds", "<f8"),  # spent so far
            ("checksum", "<u4"),  # of all before
        ]
    )


class Checkpoint:
    """The steps of one sampling on disk: those it has made, and those it need not make again.

    Parameters
    ----------
    folder, name
        ``<name>.steps`` in an existing folder holds them.
    facts
        What the steps depend on, as JSON would give it back.
    asked_to_stop
        Asked after every step; when it says so everything is saved and KeyboardInterrupt raised.

    Attributes
    ----------
    saved
        Steps on disk.
    seconds
        Time that those took which were there before, s.
    walking
        Whether steps are being made at this moment, so that it is worth waiting for one.

    Raises
    ------
    BadInput
        If there is a checkpoint that cannot be read, or of other facts; it names the first that
        differs.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        facts: Mapping[str, Any],
        *,
        asked_to_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.path, self._asked_to_stop = folder / f"{name}.steps", asked_to_stop
        self._head: dict[str, Any] = json.loads(json.dumps({"checkpoint format": FORMAT, **facts}))
        self.saved, self.seconds, self.walking = 0, 0.0, False
        self._begin, self._kind = 0, np.dtype(np.void)
        self._pending: list[NDArray[np.void]] = []
        self._due = 0.0  # when saving is worth its time again
        self._found = self._read()
        self._replayed, self._resumed = 0, self.saved
        self._began = time.perf_counter()

    def begin(self, walkers: int, dimension: int) -> None:
        """Tell what is going to be sampled.

        Parameters
        ----------
        walkers, dimension
            Of all ensembles together, and parameters of each.

        Raises
        ------
        BadInput
            If a checkpoint's steps have another shape.
        """
        self._head |= {"walkers": walkers, "parameters": dimension}
        if self.saved:
            self._compare(self._found, self._head)
        self._kind, self._began = _row(walkers, dimension), time.perf_counter()

    def replay(self, most: int) -> NDArray[np.void] | None:
        """Give the next steps that need not be made again.

        Parameters
        ----------
        most
            At most so many.

        Returns
        -------
        structured array or None
            Rows as :func:`_row` lays them out; ``None`` once there are no more.

        Raises
        ------
        BadInput
            If they cannot be read any more.
        """
        if self._replayed == self._resumed:
            return None
        begin, self._replayed = self._replayed, min(self._replayed + most, self._resumed)
        try:
            return self._rows(begin, self._replayed)
        except OSError as error:
            raise self._unreadable(error.strerror) from None

    def where_it_stopped(self, log_density: Callable[[], Array]) -> RandomState | None:
        """Give the state of the sampler's generator once all is replayed.

        Parameters
        ----------
        log_density
            Evaluates the density of the last step again, ``(walkers,)``.

        Returns
        -------
        tuple or None
            As ``numpy.random.RandomState.set_state`` takes it; ``None`` while steps are left, or
            where there were none.

        Raises
        ------
        BadInput
            If the density is not what it was: code or data have changed.
        """
        if not self._resumed or self._replayed < self._resumed:
            return None
        (last,) = self._rows(self._resumed - 1, self._resumed)
        then, now = last["log_density"], log_density()
        same = np.isclose(now, then, rtol=_ROUNDING, atol=_ROUNDING)
        if not same.all():
            worst = int(np.argmin(same))
            raise self._differs(
                f"log-probability (walker {worst + 1} after step {self._resumed}; the code, or a "
                "library, is another)",
                float(then[worst]),
                float(now[worst]),
            )
        state = ("MT19937", last["key"].copy(), int(last["place"]), int(last["has_gauss"]))
        return (*state, float(last["gauss"]))

    @contextmanager
    def recording(self, accepted: Array) -> Iterator[Callable[[Any, Array, int], None]]:
        """Keep every step of a block; give what is to be called after each.

        Parameters
        ----------
        accepted
            ``(walkers,)`` how many proposals each walker accepted before.

        Yields
        ------
        callable
            Of emcee's state, the same counts after the step, and how often the likelihood was no
            number.

        Raises
        ------
        KeyboardInterrupt
            If asked to stop, all steps saved.
        """
        before = accepted.copy()

        def record(state: Any, accepted: Array, not_finite: int) -> None:
            row = np.zeros((), self._kind)
            row["coordinates"], row["log_density"] = state.coords, state.log_prob
            row["accepted"], before[:] = accepted > before, accepted
            _, row["key"], row["place"], row["has_gauss"], row["gauss"] = state.random_state
            row["not_finite"] = not_finite
            row["seconds"] = self.seconds + time.perf_counter() - self._began
            self._pending.append(row)
            self._stop_if_asked()
            if time.perf_counter() >= self._due:
                self.save()

        self.walking = True
        try:
            yield record
        finally:
            self.walking = False
        # who asked during the last step
        self._stop_if_asked()

    def save(self) -> None:
        """Put everything recorded on disk.

        Raises
        ------
        OSError
            If that cannot be; what was saved before is as it was.
        """
        if not self._pending:
            return
        began, rows = time.perf_counter(), np.stack(self._pending)
        rows["checksum"] = [_checksum(row) for row in rows]
        with self.path.open("r+b" if self.saved else "wb") as file:
            if self.saved:
                # what a killed writer left behind, or is damaged, nobody counts
                file.seek(file.truncate(self._begin + self.saved * self._kind.itemsize))
            else:
                self._begin = file.write(json.dumps(self._head).encode() + b"\n")
            file.write(rows.tobytes())
        self.saved += len(rows)
        del self._pending[: len(rows)]
        now = time.perf_counter()
        self._due = now + (now - began) / _SHARE

    def remove(self) -> None:
        """Take it off the disk: the sampling is done."""
        self.path.unlink(missing_ok=True)

    def _stop_if_asked(self) -> None:
        if self._asked_to_stop():
            self.save()
            raise KeyboardInterrupt

    def _read(self) -> dict[str, Any]:
        """Read the first line, and count the steps up to one that is not what was written."""
        try:
            with self.path.open("rb") as file:
                line = file.readline(_LONGEST)
            if not line.endswith(b"\n"):
                return {}  # its writer was killed before there was a step
            head: dict[str, Any] = json.loads(line)
            self._compare({name: head.get(name, "not there") for name in self._head}, self._head)
            self._kind = _row(head["walkers"], head["parameters"])
            self._begin = len(line)
            while (row := self._rows(self.saved, self.saved + 1)).size:
                if row["checksum"][0] != _checksum(row[0]):
                    break
                self.saved, self.seconds = self.saved + 1, float(row["seconds"][0])
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise self._unreadable(error.strerror) from None
        except (ValueError, TypeError, AttributeError, LookupError, RecursionError):
            raise self._unreadable("it is not what was written") from None
        return head

    def _rows(self, begin: int, end: int) -> NDArray[np.void]:
        """Read some steps; fewer where the file ends."""
        offset = self._begin + begin * self._kind.itemsize
        return np.fromfile(self.path, self._kind, end - begin, offset=offset)

    def _compare(self, then: Any, now: Any) -> None:
        for difference in _differences(then, now):
            raise self._differs(*difference)

    def _unreadable(self, reason: str | None) -> BadInput:
        mend = "start afresh with --force"
        return BadInput(str(self.path), f"cannot be resumed ({reason})", mend)

    def _differs(self, what: str, then: Any, now: Any) -> BadInput:
        return BadInput(
            str(self.path.parent),
            f"cannot be resumed: {what} was {_short(then)} and is {_short(now)} now",
            "undo that, or start afresh with --force",
        )


def _checksum(row: np.void) -> int:
    return zlib.crc32(row.tobytes()[:-4])


def _differences(then: Any, now: Any, place: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Name everything that differs between two trees of JSON."""
    if isinstance(then, Mapping) and isinstance(now, Mapping):
        for key in [*then, *(key for key in now if key not in then)]:
            inner = f"{place}.{key}" if place else key
            yield from _differences(then.get(key, "not there"), now.get(key, "not there"), inner)
    elif isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        for number, (one, other) in enumerate(zip(then, now, strict=True), start=1):
            yield from _differences(one, other, f"{place}.{number}")
    elif then != now:
        yield place, then, now


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 80 else f"{text[:76]} ..."
