"""Fit units in parallel by Dask distributed, on this machine or on a running cluster.

Only texts and numbers pass the scheduler. Anybody who can connect to it can run code on its
workers: a local one takes Dask's temporary credentials, one on a network those of Dask's
configuration (``distributed.comm.tls``).
"""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesfric.base import LINEAR_ALGEBRA_THREADS
from bayesfric.base.errors import BadInput
from bayesfric.fit.model import Model
from bayesfric.fleet.plan import ClusterOptions
from bayesfric.problem.config import parse_config
from bayesfric.recordings.read import recorded_files

if TYPE_CHECKING:
    from distributed import Client

# The filled configuration, written into a unit's run directory when the fit is finished.
UNIT = "unit.toml"
_SETTINGS = {
    "distributed.nanny.pre-spawn-environ": {
        # a worker is one thread
        **dict.fromkeys((*LINEAR_ALGEBRA_THREADS, "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"),
        # return freed memory to the system, or a worker's grows with the number of its units
        "MALLOC_TRIM_THRESHOLD_": "65536",
        "MALLOC_ARENA_MAX": "2",
    },
    # profiles of every fit stay in a worker's memory
    "distributed.worker.profile.enabled": False,
    # a fit holds Python's lock for seconds while it compiles
    "distributed.admin.tick.limit": "1 h",
}


def fit_units(
    configurations: Mapping[str, str],
    folder: Path,
    template: Path,
    draws: int | None,
    options: ClusterOptions,
) -> Iterator[tuple[str, str, bool, float]]:
    """Fit units by name, each into a run directory in ``folder``, and report each when finished.

    By its name, why its fit failed (or nothing), whether by the machine, and CPU seconds.
    """
    from distributed import KilledWorker, as_completed

    if not configurations:
        return
    with _client(options) as client:
        futures = client.map(
            fit_unit,
            list(configurations.values()),
            [str(folder / name) for name in configurations],
            template=str(template),
            draws=draws,
            pure=False,
        )
        names = dict(zip(futures, configurations, strict=True))
        del futures  # so that Dask releases results
        for future in as_completed(names, loop=client.loop):
            name = names.pop(future)
            if future.status == "finished":
                why, seconds = future.result()
                yield name, why, False, seconds
            elif future.status == "error":
                error = future.exception()
                why = " ".join(f"{type(error).__name__}: {error}".split())
                if isinstance(error, KilledWorker):
                    why = "its workers died, by their memory limit or from outside"
                yield name, why, True, 0.0
            else:
                raise _no_scheduler(options)
            future.release()


def fit_unit(text: str, folder: str, *, template: str, draws: int | None) -> tuple[str, float]:
    """Fit a unit, and return why it cannot be fitted (or nothing) and CPU seconds.

    File names in ``text`` are relative to the folder of ``template``. Dask runs a task again whose
    worker died before it reported: what was stored by then is not fitted again.
    """
    import dask

    start = time.process_time()
    if is_fitted(Path(folder), text, Path(template)):
        return "", 0.0
    try:
        # otherwise xarray locks files by the scheduler
        with dask.config.set(scheduler="synchronous"):
            config = parse_config(text, Path(template))
            shutil.rmtree(folder, ignore_errors=True)
            Model.from_config(config).fit().write(Path(folder), draws=draws)
        why = ""
        Path(folder, UNIT).write_text(text, encoding="utf-8")
    except BadInput as error:
        why = str(error)
    return why, time.process_time() - start


def is_fitted(folder: Path, text: str, template: Path) -> bool:
    """Whether a unit was fitted by this configuration, later than its recordings changed."""
    mark = folder / UNIT
    try:
        if mark.read_text(encoding="utf-8") != text:
            return False
        config = parse_config(text, template)
        sources = config.tables.recordings
        files = [path for source in sources for path in recorded_files(source, config.folder)]
        return all(path.stat().st_mtime < mark.stat().st_mtime for path in files)
    except (OSError, ValueError, BadInput):
        return False


def check_dask(options: ClusterOptions) -> None:
    """Check what must be installed, and a worker's memory limit, before anything is written."""
    try:
        import cryptography  # noqa: F401 (makes a local cluster's credentials)
        import distributed  # noqa: F401
        import pyarrow  # noqa: F401 (writes the table of results)
        from dask.utils import parse_bytes
    except ImportError:
        problem = "needs Dask distributed and pyarrow, which are not installed"
        raise BadInput("bayesfric fleet", problem, "pip install 'bayesfric[fleet]'") from None
    try:
        if parse_bytes(options.memory_limit) < 2**27:  # what imports take
            raise ValueError
    except (ValueError, OverflowError):
        where = f"cluster.memory_limit = {options.memory_limit!r}"
        raise BadInput(where, "is no size for a worker", 'write a size such as "2 GiB"') from None


@contextmanager
def _client(options: ClusterOptions) -> Iterator[Client]:
    """Connect to the scheduler that is given, or start workers on this machine."""
    import dask
    from distributed import Client, LocalCluster

    scheduler: Any = options.scheduler
    local: dict[str, Any] = {
        "n_workers": options.workers,
        "threads_per_worker": 1,
        "memory_limit": options.memory_limit,
        "dashboard_address": None,
        "security": True,
        "host": "127.0.0.1",
        "silence_logs": logging.CRITICAL,
    }
    with dask.config.set({} if scheduler else _SETTINGS), ExitStack() as stack:
        try:
            cluster = scheduler or stack.enter_context(LocalCluster(**local))
            client = Client(cluster, timeout=10.0, set_as_default=False)
        except (RuntimeError, OSError, ValueError, TypeError):  # not an address, or a dead worker
            raise _no_scheduler(options) from None
        stack.callback(client.close, timeout=2.0)
        yield client


def _no_scheduler(options: ClusterOptions) -> BadInput:
    hint = "check that it runs and has memory, then use --resume"
    return BadInput(str(options.scheduler or "bayesfric fleet"), "no scheduler answers", hint)
