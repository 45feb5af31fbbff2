"""``bayesfric rollout``: recordings' inputs played to the joint of a finished run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bayesfric.base.atomic_write import add_files, jsonable, write_files
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import ProgressCallback
from bayesfric.base.safe_read import read_text
from bayesfric.commands.report import report
from bayesfric.report.figures.prediction import rollout_figure
from bayesfric.report.figures.registry import ROLL_OUT, read_captions
from bayesfric.report.figures.style import save
from bayesfric.report.summary.record import read_summary_file
from bayesfric.report.terminal import roll_out_messages
from bayesfric.report.words import filled, line_of
from bayesfric.rollouts.rollout import rollout as played


def rollout(
    run: Path,
    config: Path | None = None,
    *,
    draws: int,
    seed: int | None = None,
    every: bool = False,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Play recordings to a run's posterior, and add what comes of it to the run.

    Arguments as of :func:`bayesfric.rollout`. ``summary.json``, the page and ``figures/rollout``
    are written.
    """
    # whatever another version keeps there, stays there
    summary: dict[str, Any] = read_summary_file(run)
    caption_file = run / "text" / "captions.md"
    captions = read_captions(read_text(caption_file)) if caption_file.exists() else {}
    try:
        # made first: what cannot be written is not simulated
        with add_files(run / "figures") as beside:
            found = played(run, config, every=every, draws=draws, seed=seed, progress=progress)
            told = found.summary
            captions[ROLL_OUT.stem] = ROLL_OUT.caption_of(found)
            save(rollout_figure(found), beside, ROLL_OUT.stem)
    except OSError as error:
        raise BadInput(
            str(run), f"cannot be written ({error.strerror})", "copy the run to a folder of yours"
        ) from None
    text = json.dumps(
        {**summary, "rollout": jsonable(told)}, indent=1, ensure_ascii=False, allow_nan=False
    )
    lines = "\n".join(f"**{stem}**: {caption}\n" for stem, caption in captions.items())
    write_files({run / "summary.json": f"{text}\n", caption_file: lines}, replace=True)
    report(run)
    return told


def rollout_text(found: dict[str, Any]) -> Iterator[str]:
    """Word it for a terminal, line by line."""
    yield from filled("rollout.txt.j2", found=found).splitlines()
    yield from (f"WARNING: {line_of(*one)}" for one in roll_out_messages(found).items())
