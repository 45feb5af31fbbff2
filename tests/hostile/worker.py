"""Runs cases one after the other in a process that may take little memory, and may die.

``python -m tests.hostile.worker SEED FIRST COUNT`` prints one line of JSON for every case that
breaks the rule, and at the end how many cases were accepted and refused. Before each case its
number goes to stderr's place in the file given by ``--at``, so that a crash has a name.
"""

import argparse
import faulthandler
import json
import resource
import tempfile
from collections import Counter
from pathlib import Path

from tests.hostile.cases import case
from tests.hostile.good import config, content
from tests.hostile.rule import PATIENCE, SECONDS, Outcome, broken_rule, check

MEMORY = 2**30


def limit_memory(extra=MEMORY):
    """Refuse this process more than ``extra`` bytes beyond what it has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + extra
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def warm_up(folder):
    """Import everything that reading imports, so that only the input's memory counts."""
    for form in ("csv", "json", "npz", "mat", "parquet", "h5", "mcap", "bag", "db3"):
        (folder / f"run.{form}").write_bytes(content(form))
        (folder / "c.toml").write_text(config(f"run.{form}"))
        outcome = check(folder / "c.toml", seconds=120)
        assert outcome.code == 0, outcome


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("seed", type=int)
    parser.add_argument("first", type=int)
    parser.add_argument("count", type=int)
    parser.add_argument("--at", type=Path)
    options = parser.parse_args()
    faulthandler.enable()
    told: Counter[str] = Counter()
    codes: Counter[object] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        warm_up(folder)
        limit_memory()
        for index in range(options.first, options.first + options.count):
            if options.at:
                options.at.write_text(str(index))
            made = case(options.seed, index)
            # what hangs where no signal comes through ends here, with a trace
            faulthandler.dump_traceback_later(2 * PATIENCE * SECONDS, exit=True)
            outcomes: list[Outcome] = []
            broken = broken_rule(made.write(folder), *made.named, told=outcomes)
            faulthandler.cancel_dump_traceback_later()
            told[made.kind] += 1
            codes.update(outcome.code for outcome in outcomes)
            if broken:
                print(json.dumps({"index": index, "kind": made.kind, "broken": broken}), flush=True)
    print(json.dumps({"cases": dict(told), "accepted": codes[0], "refused": codes[2]}))


if __name__ == "__main__":
    main()
