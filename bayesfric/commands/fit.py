"""``bayesfric fit`` and ``demo``: sample the posterior and write the run directory."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, Shown, silent
from bayesfric.base.written import check_free, parents_made, unwritable
from bayesfric.fit.model import Model
from bayesfric.problem.config import Config, read_config
from bayesfric.report.summary.record import Summary
from bayesfric.report.terminal import fit_text as fit_text

# What a disk without locks answers: better one fit without than none.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


def fit(
    config: Config,
    folder: Path,
    *,
    seed: int | None = None,
    force: bool = False,
    output_error: bool = False,
    paper: bool = False,
    progress: Shown = silent,
    found: Callable[[Summary], None] = lambda _: None,
) -> dict[str, Any]:
    """Fit a configuration, write the run directory, and return what ``summary.json`` holds.

    ``found`` takes the numbers as soon as they are there, before figures and pages are made.
    ``force`` keeps what stands there under another name. Whatever ends a fit early leaves nothing.
    """
    check_free(folder, force=force)
    with run_lock(folder):
        model = Model.from_config(config)
        result = model.fit(seed=seed, output_error=output_error, progress=progress)
        found(result.summary)
        progress(Progress("writing results"))
        summary = result.write(folder, paper=paper, progress=progress)
    return summary.as_dict()


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Refuse a run directory that another process is making; ``.NAME.lock`` stands beside it.

    The operating system releases the lock of a process that was killed.
    """
    target = Path(os.path.abspath(folder))  # noqa: PTH100  (links stay)
    lock = FileLock(target.with_name(f".{target.name}.lock"))
    with ExitStack() as stack:
        try:
            stack.enter_context(parents_made(target))
            lock.acquire(timeout=0)
        except Timeout:
            what = "another process is making this run"
            raise BadInput(str(folder), what, "wait for it, or name another with -o") from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise unwritable(folder, error, "folder") from None
        try:
            yield
        finally:
            with suppress(OSError):
                Path(lock.lock_file).unlink()
            lock.release()


def demo_config() -> Config:
    """Read the packaged configuration; its recording lies beside it in the package."""
    with as_file(files("bayesfric") / "examples") as folder:
        return read_config(folder / "knee.toml")
