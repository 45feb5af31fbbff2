"""Print ``result.json`` as the table of the README: ``python studies/calibration/table.py``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent


def lines(result: dict[str, Any]) -> Iterator[str]:
    """Yield one row per case."""
    yield (
        "| case | recordings | coverage of 90 % intervals, lowest and highest of all quantities | "
        "outside their band | not reliable |"
    )
    yield "|---|---|---|---|---|"
    for name, case in result.items():
        rows = case["quantities"]
        low, high = (f(rows, key=lambda n: rows[n]["coverage"]) for f in (min, max))
        outside = [n for n, row in rows.items() if not row["inside"]]
        cell = f"{len(outside)} of {len(rows)}"
        if outside:
            cell += f" ({', '.join(outside[:3])}{' ...' if len(outside) > 3 else ''})"
        unreliable = case["recordings"] - case["statuses"].get("reliable", 0)
        yield (
            f"| {name} | {case['recordings']} | {100 * rows[low]['coverage']:.1f} % ({low}) to "
            f"{100 * rows[high]['coverage']:.1f} % ({high}) | {cell} | {unreliable} |"
        )


def main() -> None:
    """Print the table."""
    result = json.loads((FOLDER / "result.json").read_text(encoding="utf-8"))
    print("\n".join(lines(result)))


if __name__ == "__main__":
    main()
