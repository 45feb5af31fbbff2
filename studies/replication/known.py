"""Values that others publish, beside what is printed and what the posterior has. MEASURED.

``python studies/replication/known.py`` fits EMPS, the UR10e's shoulder and the XL330 as their
studies' configurations write them (a minute of CPU time), and writes ``known.json``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bayesfric import Model

HERE = Path(__file__).resolve().parent
# Configuration, and published values; those of the XL330 are its authors' kt/R of 0.0963 N m/V
# over the nominal one, and those of the UR10e are of a model without load-dependent friction.
KNOWN = {
    "emps/emps-white.toml": {
        "motor.inertia": 95.1089,
        "motor.viscous": 203.5034,
        "motor.coulomb": 20.3935,
        "offset": -3.1648,
    },
    "ur10e/ur10e-joint2-no-load-friction.toml": {"motor.viscous": 20.22, "motor.coulomb": 13.27},
    "xl330/xl330.toml": {"drive.gain": 0.0963 / (0.354 / 3.40)},
}


def rows(config: str) -> list[dict[str, Any]]:
    """Fit a configuration, and give its known numbers."""
    summary = Model.from_config(HERE.parent / config).fit().summary
    return [
        {
            "name": name,
            "known": known,
            "printed": [row.value, row.reported.sd, row.reported.low, row.reported.high],
            "posterior": [row.middle, row.sd, *row.interval],
            "status": row.reported.status,
        }
        for name, known in KNOWN[config].items()
        if (row := summary.parameters.get(name)) is not None
    ]


def main() -> None:
    """Fit all, print a table and keep it."""
    result = {config: rows(config) for config in KNOWN}
    for config, lines in result.items():
        for line in lines:
            (value, sd, low, high), (median, *_) = line["printed"], line["posterior"]
            print(
                f"| {Path(config).stem} | {line['name']} | {line['known']:.4g} | {value:.4g} ± "
                f"{sd:.2g} [{low:.4g}, {high:.4g}] | {median:.4g} | {line['status']} |"
            )
    (HERE / "known.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
