"""The workers: Dask distributed, on this machine or on a cluster that runs.

Dask pickles what goes through its scheduler: here the name of one function of this package, and
dicts of text and numbers both ways (:class:`~bayesfric.fleet.work.Task`,
:class:`~bayesfric.fleet.work.Done`), whatever the recordings' size; no file is ever unpickled. Who
may connect to a scheduler can have any code run by its workers: a local one takes Dask's temporary
credentials, and one on a network what Dask's own configuration says (``distributed.comm.tls``).
"""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from bayesfric import threads
from bayesfric.errors import BadInput
from bayesfric.fleet.plan import ClusterOptions
from bayesfric.fleet.work import Done, Task, do_unit

if TYPE_CHECKING:
    from distributed import Client, Future

# How often what is the machine's fault is tried again, how often a unit's worker may die, and how
# often a scheduler may be gone with nothing done in between.
_RETRIES, _DEATHS, _GONE = 2, 5, 2
# Units handed out at once, and for each thread if that is more: the rest waits here, where it
# takes no memory of the scheduler's.
_HANDED_OUT, _PER_THREAD = 256, 4
_CONNECT = 10.0  # s
# A worker is one thread; what it calls must not start more. And what was freed goes back to the
# system: else a worker's memory grows with the number of its units.
_ENVIRONMENT = {
    **dict.fromkeys(threads.ALL, "1"),
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


class _Gone(Exception):
    """The scheduler is gone, or does not answer."""


def work_through(tasks: Sequence[Task], options: ClusterOptions, arrived: Arrived) -> None:
    """Have every task done, and tell of each.

    Raises
    ------
    BadInput
        If no scheduler answers.
    """
    waiting, idle = deque(tasks), 0
    while waiting:
        left = len(waiting)
        try:
            with _crew(options) as client:
                _serve(client, waiting, arrived)
        except _Gone:
            idle = idle + 1 if len(waiting) == left else 0
            if idle == _GONE:
                where = str(options.scheduler or "bayesfric fleet")
                mend = "see whether it runs, and has memory; then go on with --resume"
                raise BadInput(where, "no scheduler answers", mend) from None


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
        enough = parse_bytes(options.memory_limit) > 0
    except ValueError:
        enough = False
    if not enough:
        where = f"cluster.memory_limit = {options.memory_limit!r}"
        raise BadInput(where, "is no size", 'write such as "2 GiB"')


@contextmanager
def _crew(options: ClusterOptions) -> Iterator[Client]:
    import dask
    from distributed import Client, LocalCluster

    cluster: Any = options.scheduler
    with dask.config.set({} if cluster else _SETTINGS):
        try:
            if not cluster:
                cluster = LocalCluster(
                    n_workers=options.workers or _cores(),
                    threads_per_worker=1,
                    memory_limit=options.memory_limit,
                    dashboard_address=None,
                    security=True,
                    host="127.0.0.1",
                    silence_logs=logging.CRITICAL,
                )
            client = Client(cluster, timeout=_CONNECT, set_as_default=False)
        except (RuntimeError, OSError, ValueError, TypeError) as error:
            if cluster is not options.scheduler:
                cluster.close()
            raise _Gone from error  # no address, say, or a worker that died while it started
        try:
            yield client
        finally:
            client.close(timeout=2.0)
            if cluster is not options.scheduler:
                cluster.close()


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _serve(client: Client, waiting: deque[Task], arrived: Arrived) -> None:
    """Hand out and take in until nothing waits; what is not done waits again if that ends early.

    The first unit goes alone until one was sampled: it compiles what all others then load.
    """
    from distributed import as_completed

    flying: dict[Future, Task] = {}
    coming = as_completed(loop=client.loop)
    most = max(_HANDED_OUT, _PER_THREAD * sum(client.nthreads().values()))
    compiled = False
    try:
        while waiting or flying:
            while waiting and len(flying) < (most if compiled else 1):
                task = waiting.popleft()
                future = client.submit(do_unit_here, task, pure=False, retries=_RETRIES)
                flying[future] = task
                coming.add(future)
            future = next(coming)
            if future.status not in ("finished", "error"):
                raise _Gone
            task = flying.pop(future)
            done = future.result() if future.status == "finished" else _told(future.exception())
            if not isinstance(done, str) and not done["again"] and done["record"]["rows"]:
                compiled = True
            arrived(task["name"], done)
            future.release()
    except (OSError, TimeoutError) as error:
        # of the connection: what the disk refuses is bad input by now
        raise _Gone from error
    finally:
        waiting.extendleft(reversed(flying.values()))


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
