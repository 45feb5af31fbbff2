"""Text files that are written beside and moved into place."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from bayesfric.errors import BadInput


def write_beside(texts: Mapping[Path, str]) -> None:
    """Write several files, all or none.

    Parameters
    ----------
    texts
        Contents by file name.

    Raises
    ------
    BadInput
        If a folder is missing or cannot be written to; nothing is left behind.
    """
    beside = {path: path.with_name(f".{path.name}.{os.getpid()}.partial") for path in texts}
    try:
        for path, text in texts.items():
            beside[path].write_text(text, encoding="utf-8")
        for path, partial in beside.items():
            partial.replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInput(
            str(next(iter(texts))), f"cannot be written ({reason})", "name another file with -o"
        ) from None
    finally:
        for partial in beside.values():
            partial.unlink(missing_ok=True)
