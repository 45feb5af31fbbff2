"""Run a study: fit its configurations and keep its figures in ``figures/``.

``python studies/run.py emps`` fits every configuration in ``studies/emps``; run directories go to
``studies-runs/`` (not committed), corner and prediction figures to ``figures/emps/``. The study
``demo`` is the packaged configurations.
"""

from __future__ import annotations

import shutil
import sys
from importlib.resources import files
from pathlib import Path

from bayesfric.commands.fit import fit, fit_text
from bayesfric.problem.config import read_config
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.comparison.layout import comparison_text
from bayesfric.report.figures.forest import forest_figure
from bayesfric.report.figures.style import save

ROOT = Path(__file__).resolve().parents[1]
KEPT = ("corner", "prediction", "methods")


def run(study: str) -> None:
    """Fit all configurations of a study and copy their figures."""
    folder = (
        Path(str(files("bayesfric") / "examples")) if study == "demo" else ROOT / "studies" / study
    )
    runs = ROOT / "studies-runs"
    runs.mkdir(exist_ok=True)
    figures = ROOT / "figures" / study
    figures.mkdir(parents=True, exist_ok=True)
    summaries = {}
    for path in sorted(folder.glob("*.toml")):
        target = runs / path.stem
        if target.exists():
            shutil.rmtree(target)
        # the three of the paper beside the demo's posterior
        summary = fit(read_config(path), target, paper=True, output_error=study == "demo")
        print(f"=== {study}/{path.name}")
        print("\n".join(fit_text(summary)))
        if path.stem.endswith("-held-out"):
            # less data: not to be compared with the others, only its prediction counts
            for suffix in (".pdf", ".png"):
                made = target / "figures" / f"validation{suffix}"
                shutil.copyfile(made, figures / f"{path.stem}-validation{suffix}")
            continue
        summaries[path.stem] = summary
        for name in KEPT:
            stem = name if study == "demo" and path.stem == "knee" else f"{path.stem}-{name}"
            for suffix in (".pdf", ".png"):
                shutil.copyfile(target / "figures" / f"{name}{suffix}", figures / f"{stem}{suffix}")
    if len(summaries) > 1 and study != "demo":
        if study == "emps":  # one recording, so one set of estimates
            for name in list(summaries)[1:]:
                summaries[name] = {**summaries[name], "estimates": {}}
        side_by_side = comparison(summaries, estimates=study == "emps")
        print("\n".join(comparison_text(side_by_side)))
        save(forest_figure(side_by_side), figures, "comparison")


if __name__ == "__main__":
    for name in sys.argv[1:] or ("demo", "emps", "ur10e", "xl330"):
        run(name)
