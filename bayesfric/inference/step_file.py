"""One HDF5 file that sampled steps are appended to, readable whenever its writer is killed.

HDF5 is no journal: a process killed while the library rewrites an index leaves a file that
nobody opens again. So nothing but numbers is ever written into a file that is in use. Its
datasets are contiguous and have their place from the beginning, longer than needed; an append
fills rows that nobody counts yet, and then the count. When the places are full, a longer file is
made beside, from the shorter one, and moved over it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
        with _opened(self.path, "r+") as file:
            room = self._datasets(file)["coordinates"].shape[0]
        if end > room:
            self._remake(first, max(2 * room, end))
        with _opened(self.path, "r+") as file:
            for name, dataset in self._datasets(file).items():
                dataset[first:end] = getattr(steps, name)
            file.flush()
            file["steps"][()] = end
        _to_disk(self.path)

    def read(self, begin: int, end: int) -> Steps:
        """Read some steps."""
        with _opened(self.path, "r") as file:
            if not end <= int(file["steps"][()]):
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
        beside = self.path.with_name(f".{self.path.name}.{os.getpid()}.partial")
        shape = (room, self.walkers)
        try:
            with _opened(beside, "w") as file:
                _create(file, "coordinates", (*shape, self.dimension), "<f8")
                _create(file, "log_density", shape, "<f8")
                # as h5py stores NumPy's bool
                _create(file, "accepted", shape, np.bool_)
                _create(file, "steps", (), "<i8")
                datasets, end = self._datasets(file), 0
                for steps in self.pieces(kept):
                    begin, end = end, end + len(steps)
                    for name, dataset in datasets.items():
                        dataset[begin:end] = getattr(steps, name)
                file["steps"][()] = kept
            _to_disk(beside)
            beside.replace(self.path)
        finally:
            with suppress(OSError):  # it has its name already, or was never made
                beside.unlink()

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


@contextmanager
def _opened(path: Path, mode: str) -> Iterator[Any]:
    """Open an HDF5 file for a moment; its errors become the system's, or a ValueError."""
    if mode != "w" and not path.exists():
        raise FileNotFoundError(2, "No such file or directory", str(path))
    try:
        # the run directory is locked; HDF5's own lock fails on some network disks
        with h5py.File(path, mode, libver="earliest", locking=False) as file:
            yield file
    except (OSError, RuntimeError) as error:
        # h5py hands on a paragraph, in which the system's reason stands
        found = re.search(r"errno = (\d+)", str(error))
        number = int(found[1]) if found else getattr(error, "errno", None)
        if number:
            raise OSError(number, os.strerror(number), str(path)) from None
        raise ValueError(f"is no HDF5 file that can be read ({error})") from None
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError(f"holds something else ({error})") from None


def _to_disk(path: Path) -> None:
    """Wait until a file is on the disk and not only in memory."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())
