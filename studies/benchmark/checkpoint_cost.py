"""What checkpoints cost: the demo's sampling with and without, in turn, in one process.

``python studies/benchmark/checkpoint_cost.py`` prints the time of each pair, the median of
their ratio, and the share of the sampling that went into saving, by wrapping the calls.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

from bayesfric.commands.fit import demo_config
from bayesfric.fit.model import Model
from bayesfric.inference.fitting import fit
from bayesfric.inference.sampling.checkpoint import Checkpoint


def main() -> None:
    """Sample in turn with and without a checkpoint."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--min-ess", type=float, default=200_000.0, help="longer than the demo")
    options = parser.parse_args()
    config = demo_config()
    target = Model.from_config(config).white_target()
    settings = config.tables.sampling.model_copy(update={"min_ess": options.min_ess})
    spent = [0.0]
    save = Checkpoint.save

    def timed(self: Checkpoint) -> None:
        begin = time.perf_counter()
        save(self)
        spent[0] += time.perf_counter() - begin

    Checkpoint.save = timed  # type: ignore[method-assign]
    fit(target, settings)  # compiles what is not compiled
    ratios, shares = [], []
    for pair in range(options.pairs):
        plain = fit(target, settings).posterior.diagnostics
        with tempfile.TemporaryDirectory() as folder:
            spent[0] = 0.0
            kept = fit(
                target, settings, checkpoint=Checkpoint(Path(folder), "posterior", {})
            ).posterior.diagnostics
        ratios.append(kept.seconds / plain.seconds)
        shares.append(spent[0] / kept.seconds)
        print(
            f"pair {pair + 1}: {plain.seconds:.2f} s without, {kept.seconds:.2f} s with, "
            f"{100 * shares[-1]:.2f} % of it saving ({kept.steps} steps)"
        )
    print(
        f"median: with/without {statistics.median(ratios):.3f}, "
        f"saving {100 * statistics.median(shares):.2f} %"
    )


if __name__ == "__main__":
    main()
