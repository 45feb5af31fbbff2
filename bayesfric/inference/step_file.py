"""One HDF5 file that sampled steps are appended to, readable whenever its writer is killed.

HDF5 is no journal: a process killed while the library rewrites an index leaves a file that
nobody opens again. And it takes a full disk badly: closing a file then ends in a crash (1.14 and
2.0). So the library makes the tables of an empty file in memory, and reads; a file in use gets
nothing but numbers, from here. Its datasets are contiguous and have their place from the
beginning, longer than needed; an append fills rows that nobody counts yet, and then the count.
When the places are full, a longer file is made beside, from the shorter one, and moved over it.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping
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
    """Steps of all walkers, one after the other.

    Attributes
    ----------
    coordinates
        ``(steps, walkers, d)`` after each step.
    log_density
        ``(steps, walkers)`` there.
    accepted
        ``(steps, walkers)``: whether the walker's proposal was.
    """

    coordinates: Array
    log_density: Array
    accepted: Flags

    def __len__(self) -> int:
        """Count the steps."""
        return len(self.log_density)


class StepFile:
    """Steps of so many walkers in a file.

    Parameters
    ----------
    path
        The file; made with the first :meth:`append` if it is not there.
    walkers, dimension
        Shape of a step.

    Notes
    -----
    Every method raises OSError, with the system's reason, where the file cannot
    be read or written, and ValueError where it holds something else.
    """

    def __init__(self, path: Path, walkers: int, dimension: int) -> None:
        self.path, self.walkers, self.dimension = path, walkers, dimension
        # a flag, a density and the coordinates of every walker
        self._step_size = walkers * (8 * dimension + 9)

    def append(self, steps: Steps, first: int) -> None:
        """Put steps behind the first ``first`` ones: rows, then the count, then to the disk."""
        end = first + len(steps)
        if not self.path.exists():
            self._remake(0, max(_ROOM // self._step_size, end))
        room, places = self._places()
        if end > room:
            self._remake(first, max(2 * room, end))
            room, places = self._places()
        with self.path.open("r+b") as file:
            _write_rows(file, places, steps, first)
            _write(file, places["steps"], np.array(end, dtype="<i8"))
            os.fsync(file.fileno())

    def read(self, begin: int, end: int) -> Steps:
        """Read some steps."""
        with _opened(self.path) as file:
            if not end <= int(file["steps"][0]):
                raise ValueError(f"holds fewer than {end} steps")
            rows = {name: data[begin:end] for name, data in self._datasets(file).items()}
        return Steps(**rows)

    def pieces(self, end: int) -> Iterator[Steps]:
        """Read the first ``end`` steps, not all at once."""
        piece = max(1, _PIECE // self._step_size)
        for begin in range(0, end, piece):
            yield self.read(begin, min(begin + piece, end))

    def _remake(self, kept: int, room: int) -> None:
        """Move a file over this one that has room for more rows."""
        beside = self.path.with_name(f".{self.path.name}.partial")
        tables = _Tables()
        with h5py.File(tables, "w", libver="earliest", meta_block_size=2**14) as empty:
            _create(empty, "steps", (1,), "<i8")
            _create(empty, "coordinates", (room, self.walkers, self.dimension), "<f8")
            _create(empty, "log_density", (room, self.walkers), "<f8")
            # as h5py stores NumPy's bool
            _create(empty, "accepted", (room, self.walkers), np.bool_)
            places = {name: dataset.id.get_offset() for name, dataset in empty.items()}
        try:
            with beside.open("wb") as file:
                file.write(tables.getbuffer())
                file.truncate(tables.size)
                end = 0
                for steps in self.pieces(kept):
                    _write_rows(file, places, steps, end)
                    end += len(steps)
                _write(file, places["steps"], np.array(kept, dtype="<i8"))
                file.flush()
                os.fsync(file.fileno())
            beside.replace(self.path)
        finally:
            with suppress(OSError):  # it has its name already, or was never made
                beside.unlink()

    def _places(self) -> tuple[int, dict[str, int]]:
        """Give how many rows there is room for, and where in the file each dataset begins."""
        with _opened(self.path) as file:
            datasets = self._datasets(file) | {"steps": file["steps"]}
            places = {name: dataset.id.get_offset() for name, dataset in datasets.items()}
            room = int(datasets["coordinates"].shape[0])
        if None in places.values():
            raise ValueError("holds no place for numbers")
        return room, places

    def _datasets(self, file: Any) -> dict[str, Any]:
        """Give the datasets by name, after a look at whether they are ours."""
        rows = (self.walkers,)
        wanted = {
            "coordinates": ((*rows, self.dimension), "f"),
            "log_density": (rows, "f"),
            "accepted": (rows, "b"),
        }
        found = {}
        for name, (shape, kind) in wanted.items():
            dataset = file.get(name)
            if (
                not isinstance(dataset, h5py.Dataset)
                or dataset.shape[1:] != shape
                or dataset.dtype.kind != kind
                or dataset.chunks is not None
            ):
                raise ValueError(f"holds no {name} of {shape[0]} walkers")
            found[name] = dataset
        return found


def _create(file: Any, name: str, shape: tuple[int, ...], kind: Any) -> None:
    """Make a dataset that has its place in the file at once, and leave the place empty."""
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    plan.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    file.create_dataset(name, shape, kind, dcpl=plan)


def _write_rows(file: IO[bytes], places: Mapping[str, int], steps: Steps, first: int) -> None:
    for name, kind in (("coordinates", "<f8"), ("log_density", "<f8"), ("accepted", "i1")):
        rows = np.ascontiguousarray(getattr(steps, name), dtype=kind)
        _write(file, places[name] + first * rows[0].nbytes, rows)


def _write(file: IO[bytes], place: int, numbers: NDArray[Any]) -> None:
    file.seek(place)
    file.write(numbers.tobytes())


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
    except (OSError, RuntimeError, KeyError, TypeError, IndexError) as error:
        raise ValueError(f"is no HDF5 file with steps ({error})") from None
