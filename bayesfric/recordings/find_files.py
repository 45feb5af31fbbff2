"""The files that a source names, and what their recordings are called."""

from __future__ import annotations

import glob
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from bayesfric.errors import BadInput
from bayesfric.recordings.source import Source


def find_files(source: Source, folder: Path) -> list[tuple[Path, str]]:
    """Find every file once, in the order of the source and sorted inside a pattern; and a name."""
    paths = _expand(source, folder)
    if source.name is None:
        return list(zip(paths, _names(paths), strict=True))
    if len(paths) > 1:
        raise BadInput(
            f"name = '{source.name}'",
            f"one name for {len(paths)} files",
            "leave name out, or give every file its own entry",
        )
    return [(paths[0], source.name)]


def _expand(source: Source, folder: Path) -> list[Path]:
    paths: list[Path] = []
    for pattern in source.files:
        if (folder / pattern).exists() or not glob.has_magic(pattern):
            paths.append(folder / pattern)
            continue
        matches = sorted(path for path in _matching(pattern, folder) if path.is_file())
        if not matches:
            raise BadInput(
                f"file = '{pattern}'",
                f"no file in {folder} matches it",
                "check the pattern and the folder",
            )
        paths.extend(matches)
    for path in paths:
        if not _is_text(str(path)):
            raise BadInput(str(path), "its name is not UTF-8", "rename the file")
    # a file named twice, say by two patterns, would count its measurements twice
    return list(dict.fromkeys(paths))


def _matching(pattern: str, folder: Path) -> Iterator[Path]:
    """Find files as the shell does; ** enters no linked folder, which may hold itself."""
    anchor = Path(pattern).anchor
    root = Path(anchor) if anchor else folder
    relative = pattern[len(anchor) :]
    # a last ** means folders only in some versions of Python
    parts = Path(relative).parts
    if parts and parts[-1] == "**":
        relative += "/*"
    hidden = any(part.startswith(".") for part in parts)
    try:
        for path in root.glob(relative):
            if hidden or not any(p.startswith(".") for p in path.relative_to(root).parts):
                yield path
    except (ValueError, NotImplementedError) as error:
        raise BadInput(
            f"file = '{pattern}'", f"is no pattern ({error})", "write ** between slashes"
        ) from None


def _is_text(name: str) -> bool:
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _names(paths: Sequence[Path]) -> list[str]:
    names = [path.stem for path in paths]
    depth = max((len(path.parts) for path in paths), default=0)
    for level in range(1, depth):
        doubled = {name for name, count in Counter(names).items() if count > 1}
        if not doubled:
            break
        names = [
            "/".join((*path.parts[-1 - level : -1], path.stem)) if name in doubled else name
            for path, name in zip(paths, names, strict=True)
        ]
    doubled = {name for name, count in Counter(names).items() if count > 1}
    # left over are files that differ in their suffix only
    return [
        "/".join(path.parts[-2:]) if name in doubled else name
        for path, name in zip(paths, names, strict=True)
    ]
