"""Print the README's tables, of ``result.json`` and ``whose.json``.

``python studies/benchmark/table.py``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent


def ours(result: dict[str, Any]) -> Iterator[str]:
    """Yield the rows of bayesfric."""
    yield "| samples | noise | ESS a second, sampling | with everything | us a draw | tau, steps |"
    yield "|---|---|---|---|---|---|"
    for row in result["ours"].values():
        yield (
            f"| {row['samples']:.0e} | {row['noise']} | {row['ess_per_second']:,.0f} | "
            f"{row['ess_per_second_with_everything']:,.0f} | "
            f"{row['microseconds_a_draw']:.1f} | {row['tau']:.1f} |"
        )


def rivals(result: dict[str, Any]) -> Iterator[str]:
    """Yield the rows of the rivals, relative to bayesfric."""
    first = result["ours"]["1e+04 0"]
    best, seconds = first["ess_per_second"], first["seconds"]
    yield (
        "| sampler | ESS a second | faster by | in all: s by the clock, CPU s | settled | "
        "mean, sd off by | versions |"
    )
    yield "|---|---|---|---|---|---|---|"
    yield f"| bayesfric | {best:,.0f} | 1 | {seconds:.0f}, not taken | yes | | |"
    for name, row in result.get("rivals", {}).items():
        if "failed" in row:
            yield f"| {name} | failed: {row['failed']} | | | | | |"
            continue
        seconds = row["seconds"] + row["warm_up_seconds"]
        errors = row["disagreement"]
        versions = ", ".join(f"{k} {v}" for k, v in row["versions"].items() if k != "arviz")
        at_least = "" if row["settled"] else "at least "
        yield (
            f"| {row['sampler']} | {row['ess_per_second']:.3g} | "
            f"{at_least}{best / row['ess_per_second']:,.0f} | "
            f"{seconds:.0f}, {row['cpu_seconds_in_all']:.0f} | "
            f"{'yes' if row['settled'] else 'no'} | "
            f"{errors['mean']:.1f}, {errors['sd']:.1f} errors | "
            f"{versions} |"
        )


def whose(result: dict[str, Any]) -> Iterator[str]:
    """Yield the rows of all samplers on the same density, and of ours without its parts."""
    arms = result["arms"]
    best = arms["ours"]["ess_per_cpu_second"]
    yield (
        "| sampler | ESS a CPU second | ours over it | evaluations an effective draw | "
        "CPU us an evaluation | warm-up, compiling: CPU s | R-hat | quantiles off by | remark |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for name, row in sorted(arms.items(), key=_slowness):
        if "failed" in row:
            yield f"| {name} | failed: {row['failed']} | | | | | | | |"
            continue
        rate = f"{row['ess_per_cpu_second']:,.0f}"
        if len(row["rates"]) > 1:
            rate += f" ({min(row['rates']):,.0f}-{max(row['rates']):,.0f})"
        right = "" if row["right"] else "at least "
        rhat = "" if row["rhat"] is None else f"{row['rhat']:.3f}"
        yield (
            f"| {name} | {rate} | {right}{best / row['ess_per_cpu_second']:,.3g} | "
            f"{row['evaluations_per_effective_draw']:,.3g} | "
            f"{row['cpu_microseconds_per_evaluation']:.3g} | {row['warm_up_cpu_seconds']:.1f} | "
            f"{rhat} | {row['quantiles_off_by_errors']:.1f} errors | "
            f"{_remark(row)} |"
        )


def steps(result: dict[str, Any], parts: dict[str, Any]) -> Iterator[str]:
    """Yield the factors from NumPyro on the full-length density in logarithms to ours."""
    numpyro, arms = result["rivals"]["numpyro_nuts"], parts["arms"]
    nuts, hmc, best = arms["blackjax NUTS"], arms["blackjax HMC"], arms["ours"]
    gradients = numpyro["evaluations"] / numpyro["ess"] / nuts["evaluations_per_effective_draw"]
    gradient_cost = numpyro["microseconds_per_evaluation"] / nuts["cpu_microseconds_per_evaluation"]
    rates = [row["ess_per_cpu_second"] for row in (nuts, hmc, best)]
    yield "| from NumPyro's NUTS to ours | times |"
    yield "|---|---|"
    yield f"| coordinates, whitened: fewer gradients an effective draw | {gradients:,.0f} |"
    yield f"| moments for the full length: cheaper gradients | {gradient_cost:.1f} |"
    yield f"| HMC of many chains at once for NUTS of one | {rates[1] / rates[0]:.1f} |"
    yield f"| our sampler for that HMC | {rates[2] / rates[1]:.1f} |"
    yield f"| all | {gradients * gradient_cost * rates[2] / rates[0]:,.0f} |"


def _slowness(item: tuple[str, dict[str, Any]]) -> tuple[bool, float]:
    """Return the sort key: ours and its variants, then by speed."""
    name, row = item
    return not name.startswith("ours"), -row.get("ess_per_cpu_second", 0.0)


def _remark(row: dict[str, Any]) -> str:
    return "; ".join(filter(None, ["" if row["right"] else "wrong", row["note"]]))


def main() -> None:
    """Print all tables."""
    result, parts = (
        json.loads((FOLDER / name).read_text(encoding="utf-8"))
        for name in ("result.json", "whose.json")
    )
    print(
        "\n".join(
            [*ours(result), "", *rivals(result), "", *whose(parts), "", *steps(result, parts)]
        )
    )


if __name__ == "__main__":
    main()
