"""One HDF5 file that sampled steps are appended to, readable whenever its writer is killed.

This is for the promise that a run can be resumed whatever ended it. HDF5 is no journal: a process
killed while the library rewrites an index leaves a file that nobody opens again. And it takes a
full disk badly: closing a file then ends in a crash (1.14 and 2.0). So the library makes the
tables of an empty file in memory, and reads; a file in use gets nothing but numbers, from here.
They have their place from the beginning, longer than needed; an append fills rows that nobody
counts yet, and then the count. When the place is full, a longer file is made beside, from the
shorter one, and moved over it.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Bytes that a new file has room for; a file system stores what was written of them.
_ROOM = 2**27
# Bytes that are read or copied in one go.
_PIECE = 2**24


@dataclass(frozen=True)
class Steps:
    """Steps of all walkers: coordinates, log density there, whether a proposal was accepted.

    ``(steps, walkers, d)`` and ``(steps, walkers)`` twice.
    """

    coordinates: Array
    log_density: Array
    accepted: Flags

    def __len__(self) -> int:
        """Count the steps."""
        return len(self.log_density)


class StepFile:
    """Steps of so many walkers in a file, made with the first :meth:`append` if it is not there.

    Every method raises OSError, with the system's reason, where the file cannot
    be read or written, and ValueError where it holds something else.
    """

    def __init__(self, path: Path, walkers: int, dimension: int) -> None:
        self.path, self.walkers, self.dimension = path, walkers, dimension
        self._kind = np.dtype(
            [("coordinates", "<f8", (dimension,)), ("log_density", "<f8"), ("accepted", "?")]
        )
        self._step_size = walkers * self._kind.itemsize

    def append(self, steps: Steps, first: int) -> bytes:
        """Put steps behind the first ``first`` ones: rows, then the count, then to the disk.

        Gives the rows, as :meth:`packed` does.
        """
        end = first + len(steps)
        if not self.path.exists():
            self._remake(0, max(_ROOM // self._step_size, end))
        room, place, counter = self._place()
        if end > room:
            self._remake(first, max(2 * room, end))
            _, place, counter = self._place()
        rows = self.packed(steps)
        with self.path.open("r+b") as file:
            file.seek(place + first * self._step_size)
            file.write(rows)
            file.flush()
            self._count(file, counter, end)
        return rows

    def packed(self, steps: Steps) -> bytes:
        """Give steps as they are in the file: one walker's coordinates, density, flag; the next."""
        rows = np.empty(steps.log_density.shape, self._kind)
        for name in self._kind.names or ():
            rows[name] = getattr(steps, name)
        return rows.tobytes()

    def read(self, begin: int, end: int) -> Steps:
        """Read some steps."""
        with _opened(self.path) as file:
            if not end <= int(file["steps"][0]):
                raise ValueError(f"holds fewer than {end} steps")
            rows = self._walk(file)[begin:end]
        return Steps(*(np.ascontiguousarray(rows[name]) for name in self._kind.names or ()))

    def pieces(self, end: int) -> Iterator[Steps]:
        """Read the first ``end`` steps, not all at once."""
        piece = max(1, _PIECE // self._step_size)
        for begin in range(0, end, piece):
            yield self.read(begin, min(begin + piece, end))

    def _remake(self, kept: int, room: int) -> None:
        """Move a file over this one that has room for more rows."""
        beside = self.path.with_name(f".{self.path.name}.partial")
        tables = _Tables()
        # tables of that version all stand in front of the numbers, and those are left out here
        with h5py.File(tables, "w", libver="v108") as empty:
            counter = _placed(empty, "steps", (1,), np.dtype("<i8"))
            place = _placed(empty, "walk", (room, self.walkers), self._kind)
        try:
            with beside.open("wb") as file:
                file.write(tables.getbuffer())
                file.truncate(tables.size)
                file.seek(place)
                for steps in self.pieces(kept):
                    file.write(self.packed(steps))
                self._count(file, counter, kept)
            beside.replace(self.path)
        finally:
            with suppress(OSError):  # it has its name already, or was never made
                beside.unlink()

    def _count(self, file: IO[bytes], counter: int, steps: int) -> None:
        """Write how many steps there are, behind them, and wait for the disk."""
        file.seek(counter)
        file.write(np.array(steps, dtype="<i8").tobytes())
        file.flush()
        os.fsync(file.fileno())

    def _place(self) -> tuple[int, int, int]:
        """Give how many steps there is room for, and where in the file they and the count are."""
        with _opened(self.path) as file:
            walk = self._walk(file)
            return walk.shape[0], walk.id.get_offset(), file["steps"].id.get_offset()

    def _walk(self, file: Any) -> Any:
        """Give the dataset of steps, after a look at whether it is ours."""
        walk = file["walk"]
        if walk.shape[1:] != (self.walkers,) or walk.dtype != self._kind:
            raise ValueError(f"holds no steps of {self.walkers} walkers")
        if walk.id.get_offset() is None:
            raise ValueError("holds steps in another order")
        return walk


def _placed(file: Any, name: str, shape: tuple[int, ...], kind: np.dtype[Any]) -> int:
    """Make a dataset that has its place in the file at once, and leave the place empty."""
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    plan.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    return int(file.create_dataset(name, shape, kind, dcpl=plan).id.get_offset())


class _Tables(io.BytesIO):
    """What HDF5 writes of a file without numbers; the rest of its size is left out."""

    size = 0

    def truncate(self, size: int | None = None) -> int:
        """Note the size of the file."""
        self.size = self.tell() if size is None else size
        return self.size


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open an HDF5 file for reading; what is wrong inside it becomes a ValueError."""
    with path.open("rb"):
        pass  # the system's own reason, where it cannot be opened at all
    try:
        # the run directory is locked; HDF5's own lock fails on some network disks
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except (OSError, RuntimeError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"is no HDF5 file with steps ({error})") from None
