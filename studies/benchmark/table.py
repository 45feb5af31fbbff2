"""Print ``result.json`` as the tables of the README: ``python studies/benchmark/table.py``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent


def ours(result: dict[str, Any]) -> Iterator[str]:
    """Rows of bayesfric itself."""
    yield "| samples | noise | ESS a second, sampling | with everything | us a draw | tau, steps |"
    yield "|---|---|---|---|---|---|"
    for row in result["ours"].values():
        yield (
            f"| {row['samples']:.0e} | {row['noise']} | {row['ess_per_second']:,.0f} | "
            f"{row['ess_per_second_with_everything']:,.0f} | "
            f"{row['microseconds_a_draw']:.1f} | {row['tau']:.1f} |"
        )


def rivals(result: dict[str, Any]) -> Iterator[str]:
    """Rows of everything else, beside the first of ours."""
    best = result["ours"]["1e+04 0"]["ess_per_second"]
    yield "| sampler | ESS a second | faster by | settled | mean, sd off by | versions |"
    yield "|---|---|---|---|---|---|"
    yield f"| bayesfric | {best:,.0f} | 1 | yes | | |"
    for name, row in result.get("rivals", {}).items():
        if "failed" in row:
            yield f"| {name} | failed: {row['failed']} | | | | |"
            continue
        off = row["disagreement"]
        versions = ", ".join(f"{k} {v}" for k, v in row["versions"].items() if k != "arviz")
        at_least = "" if row["settled"] else "at least "
        yield (
            f"| {row['sampler']} | {row['ess_per_second']:.3g} | "
            f"{at_least}{best / row['ess_per_second']:,.0f} | "
            f"{'yes' if row['settled'] else 'no'} | {off['mean']:.1f}, {off['sd']:.1f} errors | "
            f"{versions} |"
        )


def main() -> None:
    result = json.loads((HERE / "result.json").read_text(encoding="utf-8"))
    print("\n".join([*ours(result), "", *rivals(result)]))


if __name__ == "__main__":
    main()
