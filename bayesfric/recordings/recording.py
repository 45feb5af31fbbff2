"""A recording given by a user: a file or columns in memory, and the meaning of its numbers."""

from __future__ import annotations

import glob
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.options import configuration_error
from bayesfric.recordings.source import CHANNELS, SI, Columns, Source
from bayesfric.recordings.tables import Table

if TYPE_CHECKING:
    import pandas as pd

_MOTOR = ("torque_constant", "resistance")
_CONSTANTS = {"current": _MOTOR, "voltage": _MOTOR, "target": (*_MOTOR, "kp", "kd", "limit")}
_Keys = TypeVar("_Keys", bound=Columns)
Column = str | int | Mapping[str, Any]
Side = Literal["motor", "joint"]


@dataclass(frozen=True, eq=False)
class Recording:
    """One or more recorded files, or a table in memory, with the meaning of its columns.

    A model reads it for its joint, with the same checks for all three. Make one by
    :meth:`from_arrays`, :meth:`from_dataframe` or :meth:`from_file`; what these take besides is
    called as in a ``[[recordings]]`` table of a configuration (``name``, ``added_mass``,
    ``radius``, ``rate``, ``start``, ``stop``, ``exclude``, ``valid``), and numbers may be text
    with a unit there too; what cannot be used is refused at once. ``torque_constant`` and
    ``resistance`` are those of the ``current`` or ``voltage`` channel that is given in place of
    ``torque``.
    """

    source: Columns  # what the columns mean, and for files which they are
    folder: Path = field(default_factory=Path)  # that file names are relative to
    table: Table | None = None  # columns in memory

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike | None,
        position: ArrayLike,
        torque: ArrayLike | None = None,
        *,
        units: Mapping[str, str] | None = None,
        side: Side | None = None,
        **keys: Any,
    ) -> Recording:
        """Take columns from arrays.

        Parameters
        ----------
        time
            Shape (n,); None if ``rate`` is given.
        position, torque
            Shape (n,). In place of torque, ``current`` or ``voltage`` may be given.
        units
            By channel, such as ``{"time": "ms", "position": "deg"}``; SI where none is given.
        side
            Of position and velocity; may be left out only if the gear ratio is 1.
        **keys
            ``velocity``, ``current``, ``voltage``, ``target`` and ``valid``, arrays of shape
            (n,); and what else there is to say.
        """
        keys |= {"time": time, "position": position, "torque": torque}
        names = [key for key in (*CHANNELS, "valid") if keys.get(key) is not None]
        # copied, as the caller may change them
        arrays = [np.array(keys[name]) for name in names]
        source = _checked(Columns, keys | {name: name for name in names}, units, side)
        return cls(source, table=Table("recording", names, arrays.__getitem__))

    @classmethod
    def from_dataframe(
        cls,
        frame: pd.DataFrame,
        *,
        position: Column,
        time: Column | None = None,
        torque: Column | None = None,
        units: Mapping[str, str] | None = None,
        side: Side | None = None,
        **keys: Any,
    ) -> Recording:
        """Take columns from a DataFrame.

        Parameters
        ----------
        frame
            One row a sample.
        position, time, torque
            Name of a column, or its number from 1, or a table of keys as in a configuration:
            ``{"column": "q", "unit": "turn/4096", "sign": -1}``. Without time give ``rate``, and
            without torque ``current`` or ``voltage``.
        units, side
            As in :meth:`from_arrays`.
        **keys
            ``velocity``, ``current``, ``voltage``, ``target`` and ``valid``, columns as well; and
            what else there is to say.
        """
        keys |= {"position": position, "time": time, "torque": torque}
        names = [str(name) for name in frame.columns]
        columns = [frame.iloc[:, i].to_numpy(copy=True) for i in range(len(names))]
        table = Table("recording", names, columns.__getitem__)
        return cls(_checked(Columns, keys, units, side), table=table)

    @classmethod
    def from_file(
        cls,
        path: str | Path,
        *,
        position: Column,
        time: Column | None = None,
        torque: Column | None = None,
        units: Mapping[str, str] | None = None,
        side: Side | None = None,
        **keys: Any,
    ) -> Recording:
        """Take a file, or all that match a pattern, whose format goes by the suffix.

        It is opened when a model reads it.

        Parameters
        ----------
        path
            A file; ``*``, ``?`` and ``**`` are wildcards.
        position, time, torque, units, side, **keys
            As in :meth:`from_dataframe`, and ``format``, ``delimiter``, ``decimal``,
            ``skip_rows``, ``table`` and ``where``.
        """
        keys |= {"file": str(path), "position": position, "time": time, "torque": torque}
        return cls(_checked(Source, keys, units, side))

    def saved(self, path: Path) -> Recording:
        """Write the columns used of a table in memory as CSV, and return that file's recording.

        Reading it gives the same measurement to the last bit.
        """
        import pandas as pd

        if self.table is None:
            raise ValueError("the recording is in files already")
        names = self._header.items()
        frame = pd.DataFrame({name: self.table.column(column) for column, name in names})
        frame.to_csv(path, index=False)
        return type(self)(self.filed(glob.escape(path.name)), path.parent)

    def filed(self, file: str) -> Source:
        """Give the keys of the recording once :meth:`saved` has made it a file of that name."""
        keys = self.source.model_dump(exclude_unset=True, exclude_none=True)
        for channel in (keys[key] for key in CHANNELS if key in keys):
            channel |= {k: self._header[channel[k]] for k in ("column", "times") if k in channel}
        if "valid" in keys:
            keys["valid"] = self._header[keys["valid"]]
        return Source(file=file, **keys)

    def __repr__(self) -> str:
        keys = self.source.model_dump(mode="json", exclude_unset=True, exclude_none=True)
        return "\n".join(f"{key}: {value}" for key, value in keys.items())

    @property
    def _header(self) -> dict[str | int, str]:
        return {c: c if isinstance(c, str) else f"column {c}" for c in self.source.columns}


def _checked(
    kind: type[_Keys], keys: Mapping[str, Any], units: Mapping[str, str] | None, side: Side | None
) -> _Keys:
    """Check keys as those of a ``[[recordings]]`` table."""
    document = {key: value for key, value in keys.items() if value is not None}
    for key in CHANNELS:
        if key in document:
            column = document[key]
            channel = dict(column) if isinstance(column, Mapping) else {"column": column}
            channel.setdefault("unit", (units or {}).get(key, SI))
            if side is not None and key in ("position", "velocity", "target"):
                channel.setdefault("side", side)
            channel |= {k: keys[k] for k in _CONSTANTS.get(key, ()) if keys.get(k) is not None}
            for k in _CONSTANTS.get(key, ()):
                document.pop(k, None)
            document[key] = channel
    whose = f"recording {keys['name']!r}" if keys.get("name") else "recording"
    for key in units or {}:
        if key not in document or key not in CHANNELS:
            known = [name for name in CHANNELS if name in document]
            raise BadInput(f"{whose}: units.{key}", "no such channel is given", nearest(key, known))
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        raise configuration_error(f"{whose}: ", whose, error, document, kind) from None
