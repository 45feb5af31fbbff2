"""ArviZ in both its shapes: InferenceData up to 0.23, DataTree from 1.0.

Every difference between the two lives here, and nowhere else. A finished run's draws, predictions
and data go to one NetCDF file, ``posterior.nc``, that any tool around ArviZ or xarray reads.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Bytes beside the numbers: tables, names, labels. And bytes that are written in one go.
_TABLES = 2**18
_PIECE = 2**20

# Groups that are none of ArviZ's.
_OWN = ("derived", "told")

Groups = Mapping[str, Mapping[str, NDArray[Any]]]


def make_archive(
    groups: Groups,
    *,
    dims: Mapping[str, list[str]],
    coords: Mapping[str, Any],
    attrs: Mapping[str, str],
    variable_attrs: Mapping[str, Mapping[str, Mapping[str, str]]] | None = None,
) -> Any:
    """Put groups of named arrays together as the installed ArviZ has them.

    Parameters
    ----------
    groups
        Arrays by group, such as ``posterior``, and name. Those of sampled groups begin with the
        dimensions ``chain`` and ``draw``.
    dims
        Names of the dimensions behind these, by variable.
    coords
        Labels by dimension.
    attrs
        Root attributes; what ArviZ would put there itself is left out.
    variable_attrs
        What variables say of themselves, such as their units, by group and name; unknown names
        are passed over.

    Returns
    -------
    InferenceData or DataTree
        Without time stamps, so that two runs of one seed give the same file.
    """
    options = {"dims": dict(dims), "coords": dict(coords)}
    named = {group: dict(variables) for group, variables in groups.items()}
    arviz = _arviz()
    with warnings.catch_warnings():
        # walkers are stored as chains, and there may well be more of them than kept draws
        warnings.filterwarnings("ignore", "More chains", UserWarning)
        warnings.filterwarnings("ignore", "Found chain dimension to be longer", UserWarning)
        warnings.filterwarnings("ignore", ".* not defined in the InferenceData scheme", UserWarning)
        if int(arviz.__version__.partition(".")[0]) < 1:
            # groups of our own are no argument there
            own = {group: named.pop(group) for group in _OWN if group in named}
            data = arviz.from_dict(**named, **options)
            for group, variables in own.items():
                data.add_groups({group: arviz.convert_to_dataset(variables)})
            named |= own
        else:
            data = arviz.from_dict(named, **options)
    for group in groups:
        # a time stamp would make two runs of one seed differ
        data[group].attrs.pop("created_at", None)
    for group, told in (variable_attrs or {}).items():
        for name, words in told.items() if group in named else ():
            if name in named[group]:
                data[group][name].attrs.update(words)
    data.attrs.clear()
    data.attrs.update(attrs)
    return data


def write_archive(path: Path, groups: Groups, **named: Any) -> None:
    """Write what :func:`make_archive` makes, as NetCDF that any ArviZ reads.

    Parameters
    ----------
    path
        Of the file, in an existing folder.
    groups, **named
        As for :func:`make_archive`.

    Raises
    ------
    OSError
        If there is no room for it, or the folder cannot be written to.
    """
    data = make_archive(groups, **named)
    arrays = [array for variables in groups.values() for array in variables.values()]
    _try_room(path, sum(np.asarray(array).nbytes for array in arrays) + _TABLES)
    data.to_netcdf(str(path), engine="h5netcdf")


def _try_room(path: Path, size: int) -> None:
    """Raise the system's error where there is no room; HDF5 would crash on a full disk.

    As many zeros as the file may need are written in its place, and taken away again.
    """
    try:
        with path.open("wb") as file:
            for begin in range(0, size, _PIECE):
                file.write(bytes(min(_PIECE, size - begin)))
            file.flush()
            os.fsync(file.fileno())
    finally:
        path.unlink(missing_ok=True)


def read_archive(path: Path) -> Any:
    """Read what :func:`write_archive` wrote; groups are addressed as ``data["posterior"]``."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* not defined in the InferenceData scheme", UserWarning)
        return _arviz().from_netcdf(str(path), engine="h5netcdf")


def as_chains(draws: NDArray[np.float64]) -> NDArray[np.float64]:
    """Make ArviZ' chains of ensembles and walkers: ``(e, w, s, ...)`` to ``(e * w, s, ...)``."""
    return draws.reshape(-1, *draws.shape[2:])


def _arviz() -> Any:
    """Import ArviZ, with xarray and pandas, where it is needed: it takes a second or more.

    ``Any``: the two versions' signatures have nothing in common.
    """
    with warnings.catch_warnings():
        # 0.23 announces its own refactoring once a day, on import
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    return arviz
