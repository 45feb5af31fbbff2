"""One file that sampled steps are appended to, readable whenever its writer is killed.

This is for the promise that a run can be resumed whatever ended it: rows of numbers, one walker's
after the other, and nothing else. How many of them count, and their checksum, the manifest tells.
(HDF5 is no journal: a process killed while the library rewrites an index leaves a file that nobody
opens again, and on a full disk closing one ends in a crash.)
"""

from __future__ import annotations

import os
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesfric.recordings.arrays import Array

# Bytes that are read in one go.
_PIECE = 2**24


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
