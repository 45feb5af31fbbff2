"""Write the tables of README.md from ``result.json``: ``python studies/scaling/show.py``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
NAMES = ("gearbox.alpha_drive", "gearbox.alpha_back", "load.first_moment")


def cell(row: dict[str, Any] | None) -> str:
    """Format an interval, with its verdict where that is not ``data``."""
    if row is None:
        return "-"
    low, high = row["interval"]
    text = f"{row['median']:.3f} [{low:.3f}, {high:.3f}]"
    return text if row["verdict"] == "data" else f"({text}: {row['verdict']})"


def tables(result: dict[str, Any]) -> dict[str, str]:
    """Format every table."""
    lines = ["| known in addition to the torque | " + " | ".join(NAMES) + " |", "|---|---|---|---|"]
    for case in result["cases"].values():
        lines.append(
            f"| {case['what']} | " + " | ".join(cell(case["rows"][n]) for n in NAMES) + " |"
        )
    predicted = [
        "| case | parameter | predicted sd | sampled sd | ratio |",
        "|---|---|---|---|---|",
    ]
    for case, prediction in result["predicted"].items():
        for name, row in prediction["parameters"].items():
            if row["verdict"] == "data":
                bound = " (estimate on a bound)" if row["on_bound"] else ""
                predicted.append(
                    f"| {case} | {name}{bound} | {row['predicted']:.3g} | {row['sampled']:.3g} "
                    f"| {row['ratio']:.2f} |"
                )
    advice = [
        "| rank | excitation | amplitude (N m) | mass (kg) | load drives | predicted sd "
        "| sampled sd |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in result["advice"]["candidates"]:
        share = 100.0 * max(row["back_driven"].values(), default=0.0)
        advice.append(
            f"| {row['rank']} | {row['form']} | {row['amplitude']:.2g} | {row['added_mass']:g} "
            f"| {share:.1f} % | {row['predicted']:.4f} | {row['sampled']:.4f} |"
        )
    position = result["cases"]["flat"]["place_of_scale"]
    lowest, low, _, high, highest = position["quantiles_0_5_50_95_100"]
    change = result["torque_along_the_ridge_changes_by"]
    return {
        "TORQUE_SENTENCE": f"Along the whole line no predicted torque changes by more than "
        f"{change:.1e} N m.",
        "FLAT_SENTENCE": f"Of the way from one bound to the other, draws lie between {lowest:.3f} "
        f"and {highest:.3f}, 90 % of them between {low:.2f} and {high:.2f}.",
        "CASES_TABLE": "\n".join(lines),
        "PREDICTED_TABLE": "\n".join(predicted),
        "ADVICE_TABLE": "\n".join(advice)
        + f"\n\nThe first one's sampled sd is {result['advice']['chosen_over_best']:.2f} times "
        "that of the best.",
    }


if __name__ == "__main__":
    result = json.loads((FOLDER / "result.json").read_text(encoding="utf-8"))
    for name, text in tables(result).items():
        print(f"{name}\n{text}\n")
