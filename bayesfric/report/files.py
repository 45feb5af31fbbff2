"""Text files that are written beside and moved into place."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from bayesfric.errors import BadInput


def write_beside(texts: Mapping[Path, str], *, replace: bool = False) -> None:
    """Write several files, by name, all or none.

    ``BadInput`` if a file is there already and must not be replaced, or a folder is missing or
    cannot be written to; nothing is left behind.
    """
    beside: dict[Path, Path] = {}
    at = next(iter(texts))
    try:
        for at in texts:
            if at.is_dir():
                raise BadInput(str(at), "is a folder", "name a file with -o")
            if at.exists() and not replace:
                raise BadInput(str(at), "exists already", "name another file with -o")
        for at, text in texts.items():
            beside[at] = at.with_name(f".{at.name}.{os.getpid()}.partial")
            beside[at].write_text(text, encoding="utf-8")
        for at, partial in beside.items():
            partial.replace(at)
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInput(
            str(at), f"cannot be written ({reason})", "name another file with -o"
        ) from None
    finally:
        for partial in beside.values():
            with suppress(OSError):  # it was never made
                partial.unlink()
