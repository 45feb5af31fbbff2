"""Fit twelve MEASURED runs of the XL330 and predict the four of each gain held out.

``python studies/xl330/held_out.py`` prints a row for each gain and noise, and writes
``held_out.json``; ``--noises A B`` updates some noise models only.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayesfric.base.atomic_write import jsonable
from bayesfric.fit.model import Model
from bayesfric.inference.fitting import fit
from bayesfric.inference.posterior import predict_held_out
from bayesfric.problem.config import parse_config
from bayesfric.report.summary.parts import validation_record

PATH = Path(__file__).with_name("xl330-held-out.toml")
GAINS = {
    100: ("10h28m10", "10h28m17", "10h28m24", "10h28m32"),
    200: ("10h28m42", "10h28m49", "10h28m57", "10h29m04"),
    400: ("10h29m14", "10h29m21", "10h29m29", "10h29m37"),
    800: ("10h29m47", "10h29m54", "10h30m02", "10h30m10"),
}
NOISES = {
    "white, one scale": {"model": "white", "scale": "shared"},
    "white, a scale each": {"model": "white", "scale": "per-recording"},
    "AR, one scale": {"model": "auto", "scale": "shared"},
}


def held_out(gain: int, noise: str) -> tuple[str, dict[str, Any]]:
    """Fit without the runs of a gain; return the noise model and their validation record."""
    config = parse_config(PATH.read_text(encoding="utf-8"), PATH)
    tables = config.tables
    names = tuple(f"2026-01-15_{name}" for name in GAINS[gain])
    tables = tables.model_copy(
        update={
            "validation": tables.validation.model_copy(update={"recordings": names}),
            "noise": tables.noise.model_copy(update=NOISES[noise]),
        }
    )
    problem = Model.from_config(replace(config, tables=tables))
    estimates = problem.estimates(("least-squares", "input-error"))
    points = [dict(estimate.point) for estimate in estimates if estimate.point]
    result = fit(problem.target(points[0]), tables.sampling, estimates=estimates)
    predictions = predict_held_out(result.target, result.posterior, problem.held_out)
    record = validation_record(replace(result, held_out=predictions))
    return result.target.likelihood.noise.description, record


def main() -> None:
    """Print and save a row for each gain and noise model."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--noises", nargs="*", default=list(NOISES), choices=list(NOISES))
    options = parser.parse_args()
    path = PATH.with_name("held_out.json")
    result = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    print("| gain held out | noise | outputs | 50 % | 90 % | 99 % | rms | predicted | off by |")
    print("|---|---|---|---|---|---|---|---|---|")
    for noise in options.noises:
        for gain in GAINS:
            description, record = held_out(gain, noise)
            pooled = record["pooled"]
            result.setdefault(noise, {})[str(gain)] = pooled
            path.write_text(json.dumps(jsonable(result), indent=1) + "\n", encoding="utf-8")
            shares = " | ".join(
                f"{100 * coverage['share']:.0f} ± {100 * coverage['standard_error']:.0f} %"
                for coverage in pooled["coverage"].values()
            )
            discrepancy = pooled["discrepancy"]
            low, high = discrepancy["interval"]
            print(
                f"| {gain} | {noise} ({description}) | {pooled['outputs']} | {shares} | "
                f"{pooled['residual_rms']:.4f} | {pooled['predictive_sd']:.4f} | "
                f"{discrepancy['value']:.4f} [{low:.4f}, {high:.4f}] |",
                flush=True,
            )


if __name__ == "__main__":
    main()
