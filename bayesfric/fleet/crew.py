"""The workers: Dask distributed, on this machine or on a cluster that runs.

Dask pickles what goes through its scheduler: here the name of one function of this package, and
dicts of text and numbers both ways (:class:`~bayesfric.fleet.work.Task`,
:class:`~bayesfric.fleet.work.Done`), whatever the recordings' size; no file is ever unpickled. Who
may connect to a scheduler can have any code run by its workers: a local one takes Dask's temporary
credentials, and one on a network what Dask's own configuration says (``distributed.comm.tls``).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from bayesfric.base import LINEAR_ALGEBRA_THREADS
from bayesfric.base.errors import BadInput
from bayesfric.fleet.plan import ClusterOptions
from bayesfric.fleet.work import Done, Task, do_unit

if TYPE_CHECKING:
    from distributed import Client

# How often what is the machine's fault is tried again, and how often a unit's worker may die.
_RETRIES, _DEATHS = 2, 5
# Bytes that a worker may be given: less than what imports take is none.
_LEAST_MEMORY, _MOST_MEMORY = 2**27, 2**60
# How long and how often a scheduler is called, s.
_CONNECT, _TRIALS = 10.0, 2
# A worker is one thread; what it calls must not start more. And what was freed goes back to the
# system: else a worker's memory grows with the number of its units.
_ENVIRONMENT = {
    **dict.fromkeys((*LINEAR_ALGEBRA_THREADS, "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"),
    "MALLOC_TRIM_THRESHOLD_": "65536",
    "MALLOC_ARENA_MAX": "2",
}
_SETTINGS = {
    "distributed.scheduler.allowed-failures": _DEATHS,
    "distributed.nanny.pre-spawn-environ": _ENVIRONMENT,
    # what it samples of every fit stays in a worker's memory
    "distributed.worker.profile.enabled": False,
    # a fit holds Python's lock for seconds while it compiles
    "distributed.admin.tick.limit": "1 h",
}

# Takes a unit's name and what came of it; words instead where the machine failed it.
Arrived = Callable[[str, Done | str], None]


def work_through(tasks: Sequence[Task], options: ClusterOptions, arrived: Arrived) -> None:
    """Have every task done, and tell of each.

    Raises
    ------
    BadInput
        If no scheduler answers, or it is gone meanwhile.
    """
    from distributed import as_completed

    with _crew(options) as client:
        given = client.map(do_unit_here, tasks, pure=False, retries=_RETRIES)
        names = {future: task["name"] for future, task in zip(given, tasks, strict=True)}
        del given  # what is done is forgotten on both sides
        for future in as_completed(names, loop=client.loop):
            if future.status not in ("finished", "error"):
                raise _no_scheduler(options)
            done = future.result() if future.status == "finished" else _told(future.exception())
            arrived(names.pop(future), done)
            future.release()


def _no_scheduler(options: ClusterOptions) -> BadInput:
    mend = "see whether it runs, and has memory; then go on with --resume"
    return BadInput(str(options.scheduler or "bayesfric fleet"), "no scheduler answers", mend)


def check_engine(options: ClusterOptions) -> None:
    """Refuse what no cluster can be made of, before anything is written.

    Raises
    ------
    BadInput
        If Dask is not installed, or the limit of memory is none.
    """
    try:
        import cryptography  # noqa: F401 (makes a local cluster's credentials)
        import distributed  # noqa: F401
        from dask.utils import parse_bytes
    except ImportError:
        what = "works with Dask distributed, which is not installed"
        raise BadInput("bayesfric fleet", what, "pip install 'bayesfric[fleet]'") from None
    try:
        enough = _LEAST_MEMORY <= parse_bytes(options.memory_limit) < _MOST_MEMORY
    except (ValueError, OverflowError):
        enough = False
    if not enough:
        where = f"cluster.memory_limit = {options.memory_limit!r}"
        raise BadInput(where, "is no size for a worker", 'write such as "2 GiB"')


@contextmanager
def _crew(options: ClusterOptions) -> Iterator[Client]:
    import dask
    from distributed import Client, LocalCluster

    given: Any = options.scheduler
    told = {
        "n_workers": options.workers,
        "threads_per_worker": 1,
        "memory_limit": options.memory_limit,
        "dashboard_address": None,
        "security": True,
        "host": "127.0.0.1",
        "silence_logs": logging.CRITICAL,
    }
    with dask.config.set({} if given else _SETTINGS), ExitStack() as opened:
        for left in reversed(range(_TRIALS)):
            try:
                cluster = given or opened.enter_context(LocalCluster(**told))
                client = Client(cluster, timeout=_CONNECT, set_as_default=False)
                break
            except (RuntimeError, OSError, ValueError, TypeError):
                # no address, say, or a worker that died while it started
                if not left:
                    raise _no_scheduler(options) from None
        opened.callback(client.close, timeout=2.0)
        yield client


def do_unit_here(task: Task) -> Done:
    """Do a unit on a worker, on its one thread: ArviZ writes files by Dask where it finds one."""
    import dask

    with dask.config.set(scheduler="synchronous"):
        return do_unit(task)


def _told(error: Any) -> str:
    """Say in a line what a machine did to a unit."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return f"its worker died {_DEATHS + 1} times, by its memory limit or from outside"
    return " ".join(f"{type(error).__name__}: {error}".split())
