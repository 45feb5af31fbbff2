"""A sampling's steps on disk, so that an interrupted one goes on where it stopped.

No library's backend keeps the promise this keeps: a resumed run's bytes are those of one never
interrupted. Sampling is repeatable: the same seed, data and code make the same steps. A resumed
run therefore begins like a new one, and only takes the steps that it would make from the
checkpoint as long as there are any. Whatever depends on steps (walkers brought back, the proposal,
the likelihood prepared for the draws, when to stop) is worked out from them again, and so are the
draws of every other random generator; just the sampler's own generator, which those steps would
have moved on, is set to where it was.
"""

from __future__ import annotations

import json
import os
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.base.opened import read_json
from bayesfric.recordings.arrays import Array

# As numpy.random.RandomState gives and takes it.
RandomState = tuple[str, NDArray[np.uint32], int, int, float]

FORMAT = 3
# Share of the time that may go into saving.
_SHARE = 0.02
# Seconds of a long block that may be lost.
_LOSS = 5.0
# Bytes that are read in one go.
_PIECE = 2**24
# What rounding may do to a log-probability, evaluated beside others or alone.
_ROUNDING = 1e-9
_AFRESH = "undo that, or start afresh with --force"


@dataclass(frozen=True)
class Manifest:
    """What a checkpoint holds beside the steps; ``<name>.json``, with its own checksum."""

    facts: dict[str, Any]
    coordinates: str
    phase: str
    steps: int
    walkers: int
    dimension: int
    random_state: list[Any]  # of the sampler's generator, with a list for the array
    log_density: list[float]  # of the last step; -Infinity where it is impossible
    not_finite: int
    seconds: float
    checksum: int  # of the steps

    def text(self) -> str:
        """Write it as JSON."""
        content = vars(self)
        return json.dumps({"format": FORMAT, "own_checksum": _sum(content), **content}, indent=1)


def _sum(content: Mapping[str, Any]) -> int:
    return zlib.crc32(json.dumps(content, sort_keys=True).encode())


@dataclass(frozen=True)
class Steps:
    """Steps of all walkers."""

    coordinates: Array  # (steps, walkers, d)
    log_density: Array  # there, (steps, walkers)
    accepted: NDArray[np.bool_]  # whether a proposal was, (steps, walkers)

    def __len__(self) -> int:
        """Count the steps."""
        return len(self.log_density)


class StepFile:
    """Steps of so many walkers in a file, made with the first :meth:`append` if it is not there.

    It is readable whenever its writer is killed: rows of numbers, one walker's after the other, and
    nothing else; how many of them count the manifest tells. (HDF5 is no journal: a process killed
    while the library rewrites an index leaves a file that nobody opens again.)

    Every method raises OSError, with the system's reason, where the file cannot be read or
    written, and ValueError where it does not hold the steps asked for.
    """

    def __init__(self, path: Path, walkers: int, dimension: int) -> None:
        self.path, self.walkers, self.dimension = path, walkers, dimension
        self._kind = np.dtype(
            [("coordinates", "<f8", (dimension,)), ("log_density", "<f8"), ("accepted", "?")]
        )
        self._step_size = walkers * self._kind.itemsize

    def append(self, steps: Steps, first: int) -> bytes:
        """Put steps behind the first ``first`` ones, wait for the disk, and give what was put."""
        rows = np.empty(steps.log_density.shape, self._kind)
        for name in self._kind.names or ():
            rows[name] = getattr(steps, name)
        raw = rows.tobytes()
        with self.path.open("r+b" if self.path.exists() else "w+b") as file:
            # what a killed writer left there nobody counts
            file.truncate(first * self._step_size)
            file.seek(0, os.SEEK_END)
            file.write(raw)
            file.flush()
            os.fsync(file.fileno())
        return raw

    def read(self, begin: int, end: int) -> Steps:
        """Read some steps."""
        self._look_for(end)
        count, offset = (end - begin) * self.walkers, begin * self._step_size
        rows = np.fromfile(self.path, self._kind, count, offset=offset).reshape(-1, self.walkers)
        return Steps(*(np.ascontiguousarray(rows[name]) for name in self._kind.names or ()))

    def checksum(self, end: int) -> int:
        """Sum up the first ``end`` steps as :func:`zlib.crc32` does."""
        self._look_for(end)
        found, left = 0, end * self._step_size
        with self.path.open("rb") as file:
            while piece := file.read(min(left, _PIECE)):
                found, left = zlib.crc32(piece, found), left - len(piece)
        return found

    def _look_for(self, end: int) -> None:
        if self.path.stat().st_size < end * self._step_size:
            raise ValueError(f"holds fewer than {end} steps of {self.walkers} walkers")


class _Step(NamedTuple):
    coordinates: Array
    log_density: Array
    accepted: NDArray[np.bool_]
    random_state: RandomState
    not_finite: int
    phase: str


class Checkpoint:
    """The steps of one sampling on disk: those it has made, and those it need not make again.

    ``<name>.steps`` in an existing folder holds the steps, ``<name>.json`` the rest. ``facts`` are
    what the steps depend on, as JSON would give it back: a checkpoint of others is refused
    (BadInput), naming the first that differs. When ``asked_to_stop``, which is asked after every
    step, everything is saved and KeyboardInterrupt raised.

    There are so many steps ``saved``, which took so many ``seconds`` before; ``walking`` is whether
    steps are being made at this moment, so that it is worth waiting for one.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        facts: Mapping[str, Any],
        *,
        asked_to_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self._folder, self._asked_to_stop = folder, asked_to_stop
        self._manifest_path, self._steps_path = folder / f"{name}.json", folder / f"{name}.steps"
        self._facts: dict[str, Any] = json.loads(json.dumps(facts))
        self.saved, self.seconds, self.walking = 0, 0.0, False
        self._checksum = self._replayed = 0
        self._pending: list[_Step] = []
        self._file: StepFile | None = None
        self._description, self._spent = "", 0.0
        self._began = self._last = time.perf_counter()
        self._resumed = self._read()
        if self._resumed is not None:
            self.saved, self.seconds = self._resumed.steps, self._resumed.seconds

    def begin(self, walkers: int, dimension: int, coordinates: str) -> None:
        """Tell what is going to be sampled; BadInput if a checkpoint's steps have another shape."""
        self._file = StepFile(self._steps_path, walkers, dimension)
        self._description = coordinates
        self._began = self._last = time.perf_counter()
        if (was := self._resumed) is not None:
            then = {"walkers": was.walkers, "parameters": was.dimension}
            now = {"walkers": walkers, "parameters": dimension, "coordinates": coordinates}
            self._compare(then | {"coordinates": was.coordinates}, now)

    def replay(self, most: int) -> Steps | None:
        """Give the next steps that need not be made again, at most so many."""
        resumed = self._resumed
        if resumed is None or self._replayed == resumed.steps:
            return None
        assert self._file is not None
        begin, end = self._replayed, min(self._replayed + most, resumed.steps)
        try:
            steps = self._file.read(begin, end)
        except (OSError, ValueError) as error:
            raise self._unreadable(self._steps_path, error) from None
        self._replayed = end
        return steps

    def where_it_stopped(self, log_density: Callable[[], Array]) -> tuple[RandomState, int] | None:
        """Give the random state and how often there was no number, once all is replayed.

        ``log_density`` evaluates the density of the last step again, ``(walkers,)``; BadInput if
        that is not what it was.
        """
        resumed = self._resumed
        if resumed is None or self._replayed < resumed.steps:
            return None
        then = np.array(resumed.log_density)
        now = log_density()
        same = np.isclose(now, then, rtol=_ROUNDING, atol=_ROUNDING)
        if not same.all():
            worst = int(np.argmin(same))
            raise self._differs(
                f"log-probability (walker {worst + 1} after step {resumed.steps}; the code, or a "
                "library, is another)",
                float(then[worst]),
                float(now[worst]),
            )
        kind, key, *rest = resumed.random_state
        return (kind, np.array(key, dtype=np.uint32), *rest), resumed.not_finite

    @contextmanager
    def recording(self, phase: str, accepted: Array) -> Iterator[Callable[[Any, Array, int], None]]:
        """Keep every step of a block; give what is to be called after each.

        ``accepted``: how many proposals each walker accepted before, ``(walkers,)``.
        """
        before = accepted.copy()

        def record(state: Any, accepted: Array, not_finite: int) -> None:
            flags = accepted > before
            before[:] = accepted
            # emcee goes on in the same arrays
            coords, height = state.coords.copy(), state.log_prob.copy()
            step = _Step(coords, height, flags, state.random_state, not_finite, phase)
            self._pending.append(step)
            self._stop_if_asked()
            if self._affordable() and time.perf_counter() - self._last > _LOSS:
                self.save()

        self.walking = True
        try:
            yield record
            if self._affordable():
                self.save()
        finally:
            self.walking = False
        # who asked during the last step
        self._stop_if_asked()

    def save(self) -> None:
        """Put everything recorded on disk: steps, their count, then the manifest.

        OSError if that cannot be; what was saved before is as it was.
        """
        if not self._pending:
            return
        assert self._file is not None
        began = time.perf_counter()
        pending, last = self._pending, self._pending[-1]
        steps = Steps(*(np.stack(column) for column in list(zip(*pending, strict=True))[:3]))
        checksum = zlib.crc32(self._file.append(steps, self.saved), self._checksum)
        kind, key, *rest = last.random_state
        manifest = Manifest(
            facts=self._facts,
            coordinates=self._description,
            phase=last.phase,
            steps=self.saved + len(pending),
            walkers=self._file.walkers,
            dimension=self._file.dimension,
            random_state=[kind, key.tolist(), *rest],
            log_density=last.log_density.tolist(),
            not_finite=last.not_finite,
            seconds=self.seconds + began - self._began,
            checksum=checksum,
        )
        _replace(self._manifest_path, manifest.text())
        self.saved, self._checksum = manifest.steps, checksum
        del self._pending[: len(pending)]
        self._last = time.perf_counter()
        self._spent += self._last - began

    def remove(self) -> None:
        """Take it off the disk: the sampling is done."""
        for path in (self._manifest_path, self._steps_path):
            path.unlink(missing_ok=True)

    def _stop_if_asked(self) -> None:
        if self._asked_to_stop():
            self.save()
            raise KeyboardInterrupt

    def _affordable(self) -> bool:
        return self._spent < _SHARE * (time.perf_counter() - self._began)

    def _read(self) -> Manifest | None:
        path = self._manifest_path
        if not path.exists():
            return None
        try:
            content = read_json(path)
            number, own = content.pop("format", None), content.pop("own_checksum", None)
        except (BadInput, AttributeError, TypeError) as error:
            raise self._unreadable(path, error) from None
        if number != FORMAT:
            raise self._differs("checkpoint format", number, FORMAT)
        if own != _sum(content):
            raise self._unreadable(path, "it is not what was written")
        found = Manifest(**content)
        self._compare(found.facts, self._facts)
        file = StepFile(self._steps_path, found.walkers, found.dimension)
        try:
            self._checksum = file.checksum(found.steps)
        except (OSError, ValueError) as error:
            raise self._unreadable(self._steps_path, error) from None
        if self._checksum != found.checksum:
            raise self._unreadable(
                self._steps_path, f"its steps are not those that {path.name} tells of"
            )
        return found

    def _compare(self, then: Mapping[str, Any], now: Mapping[str, Any]) -> None:
        for difference in _differences(then, now):
            raise self._differs(*difference)

    def _unreadable(self, path: Path, error: Exception | str) -> BadInput:
        reason = getattr(error, "strerror", None) or str(error)
        return BadInput(str(path), f"cannot be resumed ({reason})", "start afresh with --force")

    def _differs(self, what: str, then: Any, now: Any) -> BadInput:
        return BadInput(
            str(self._folder),
            f"cannot be resumed: {what} was {_short(then)} and is {_short(now)} now",
            _AFRESH,
        )


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


def _replace(path: Path, text: str) -> None:
    """Write a text beside, wait for the disk, move it into place."""
    beside = path.with_name(f".{path.name}.partial")
    with beside.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
