"""``bayesfric demo``: the whole way on the packaged simulated knee."""

from __future__ import annotations

from importlib.resources import as_file, files

from bayesfric.config import Config, read_config


def demo_config() -> Config:
    """Read the packaged configuration; its recording lies beside it in the package."""
    with as_file(files("bayesfric") / "examples") as folder:
        return read_config(folder / "knee.toml")
