"""The workers: Dask distributed, on this machine or on a cluster that runs.

Dask pickles what goes through its scheduler: here the name of one function of this package, and
dicts of text and numbers both ways (:class:`~bayesfric.fleet.work.Task`,
:class:`~bayesfric.fleet.work.Done`), whatever the recordings' size; no file is ever unpickled. Who
may connect to a scheduler can have any code run by its workers. So a local cluster speaks TLS with
certificates made for it alone, and one on a network should.
"""

from __future__ import annotations

import importlib.util
import logging
import os
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from bayesfric import threads
from bayesfric.errors import BadInput
from bayesfric.fleet.plan import ClusterOptions
from bayesfric.fleet.work import Done, Task, do_unit

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

# How often what is the machine's fault is tried again, and how often a unit's worker may die.
_RETRIES, _DEATHS = 2, 5
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

# Takes a unit's name and what came of it; words instead where the machine failed it.
Arrived = Callable[[str, Done | str], None]


class _Gone(Exception):
    """The scheduler is gone, or does not answer."""


def work_through(tasks: Sequence[Task], options: ClusterOptions, arrived: Arrived) -> None:
    """Have every task done, and tell of each; a scheduler that is gone is waited for.

    Raises
    ------
    BadInput
        If no scheduler answers.
    """
    waiting = deque(tasks)
    lost: float | None = None
    while waiting:
        left = len(waiting)
        try:
            with _crew(options, Path(tasks[0]["folder"]).parent) as client:
                _serve(client, waiting, arrived)
        except _Gone:
            if len(waiting) < left or lost is None:
                # before anything was done the address is wrong, not the scheduler gone
                wrong = options.scheduler and lost is None and len(waiting) == len(tasks)
                lost = time.monotonic() - (options.patience if wrong else 0.0)
            if time.monotonic() - lost >= options.patience:
                raise _unanswered(options) from None
            time.sleep(1.0)


def _unanswered(options: ClusterOptions) -> BadInput:
    if options.scheduler is None:
        mend = "see whether memory and processes are left; then go on with --resume"
        return BadInput("bayesfric fleet", "its workers do not start", mend)
    mend = "check address and certificates, or start one; then go on with --resume"
    return BadInput(options.scheduler, "no scheduler answers", mend)


def check_engine(options: ClusterOptions) -> None:
    """Refuse what no cluster can be made of, before anything is written.

    Raises
    ------
    BadInput
        If Dask is not installed, or the limit of memory is none.
    """
    try:
        import cryptography  # noqa: F401 (makes a local cluster's certificates)
        import distributed  # noqa: F401
        from dask.utils import parse_bytes
    except ImportError:
        what = "works with Dask distributed, which is not installed"
        raise BadInput("bayesfric fleet", what, "pip install 'bayesfric[fleet]'") from None
    if options.slurm is not None:
        if importlib.util.find_spec("dask_jobqueue") is None:
            what = "works with dask-jobqueue, which is not installed"
            raise BadInput("cluster.slurm", what, "pip install dask-jobqueue")
        if shutil.which("sbatch") is None:
            mend = "start the fleet on a machine that submits jobs"
            raise BadInput("cluster.slurm", "there is no sbatch here", mend)
    try:
        enough = parse_bytes(options.memory_limit) > 0
    except ValueError:
        enough = False
    if not enough:
        where = f"cluster.memory_limit = {options.memory_limit!r}"
        raise BadInput(where, "is no size", 'write such as "2 GiB"')


@contextmanager
def _crew(options: ClusterOptions, place: Path) -> Iterator[Client]:
    import dask
    from distributed import Client
    from distributed.security import Security

    if options.scheduler is not None:
        security = Security(
            tls_ca_file=options.ca,
            tls_client_cert=options.certificate,
            tls_client_key=options.key,
            require_encryption=options.ca is not None,
        )
        try:
            client = Client(
                options.scheduler, security=security, timeout=_CONNECT, set_as_default=False
            )
        except (OSError, ValueError, TypeError) as error:
            raise _Gone from error
        try:
            yield client
        finally:
            with suppress(OSError):
                client.close(timeout=2.0)
        return
    chosen = {
        "distributed.scheduler.allowed-failures": _DEATHS,
        "distributed.nanny.pre-spawn-environ": _ENVIRONMENT,
        # what it samples of every fit stays in a worker's memory
        "distributed.worker.profile.enabled": False,
        # a fit holds Python's lock for seconds while it compiles
        "distributed.admin.tick.limit": "1 h",
    }
    with dask.config.set(chosen), ExitStack() as stack:
        try:
            if options.slurm is None:
                cluster = stack.enter_context(_processes(options))
            else:
                certificates = stack.enter_context(_aside(place))
                cluster = stack.enter_context(_jobs(options, certificates))
            client = stack.enter_context(Client(cluster, set_as_default=False))
        except (RuntimeError, OSError) as error:
            raise _Gone from error  # a worker that died while it started, say
        yield client


def _processes(options: ClusterOptions) -> LocalCluster:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=options.workers or _cores(),
        threads_per_worker=1,
        memory_limit=options.memory_limit,
        dashboard_address=None,
        security=True,
        protocol="tls://",
        host="127.0.0.1",
        silence_logs=logging.CRITICAL,
    )


@contextmanager
def _aside(place: Path) -> Iterator[str]:
    place.mkdir(exist_ok=True)
    # dask-jobqueue removes its own files late, or twice
    with TemporaryDirectory(prefix=".certificates-", dir=place, ignore_cleanup_errors=True) as name:
        yield name


def _jobs(options: ClusterOptions, certificates: str) -> Any:
    """Ask SLURM for workers; what is not said here, dask-jobqueue's own configuration says.

    Their certificates are in a folder that they see.
    """
    import dask
    from dask_jobqueue.slurm import SLURMCluster

    # no port that another may have
    told = dask.config.get("jobqueue.slurm.scheduler-options", {}) | {"dashboard_address": ":0"}
    cluster: Any = SLURMCluster(
        cores=1,
        processes=1,
        memory=options.memory_limit,
        security=True,
        shared_temp_directory=certificates,
        scheduler_options=told,
        job_script_prologue=[f"export {name}={value}" for name, value in _ENVIRONMENT.items()],
    )
    cluster.scale(jobs=options.slurm)
    return cluster


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
            compiled = compiled or (not isinstance(done, str) and _sampled(done))
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


def _sampled(done: Done) -> bool:
    return not done["again"] and bool(done["record"]["rows"])


def _told(error: Any) -> str:
    """Say in a line what a machine did to a unit."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return f"its worker died {_DEATHS + 1} times, by its memory limit or from outside"
    return " ".join(f"{type(error).__name__}: {error}".split())
