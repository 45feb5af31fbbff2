"""Commands run one after the other in a process that may take 3 GB and 60 s a command.

With ``COSTS=FILE`` in the environment every command's CPU seconds and what it takes of memory, MB
and at its peak, is a line of JSON there.
"""

import json
import os
import resource
import select
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

from tests.hostile.rule import Outcome, run

MEMORY, SECONDS = 3 * 2**30, 60


class Bounded:
    """A process that runs commands, started anew where one of them ended it."""

    def __init__(self):
        self._process = None

    def run(self, folder, *words):
        """Run a command in a folder; it fails where it takes more than it may."""
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.hostile.bounded"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        told = json.dumps([str(folder), *map(str, words)])
        self._process.stdin.write(f"{told}\n")
        self._process.stdin.flush()
        # the processor's seconds end it inside; what waits for something ends here
        ready, _, _ = select.select([self._process.stdout], [], [], 5 * SECONDS)
        line = self._process.stdout.readline() if ready else ""
        if not line:
            self.close()
        assert line, f"{words} took more than {SECONDS} s or {MEMORY} bytes"
        return Outcome(**json.loads(line))

    def refused(self, folder, *words, parts=()):
        """Run a command that ends with one line, which holds some words."""
        outcome = self.run(folder, *words)
        assert outcome.code == 2, outcome
        assert outcome.err.startswith("bayesfric: "), outcome
        assert outcome.err.count("\n") == 1, outcome
        assert all(part in outcome.err for part in parts), (parts, outcome.err)

    def close(self):
        if self._process is not None:
            self._process.kill()
            self._process.communicate()


def main():
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    for line in sys.stdin:
        folder, *words = json.loads(line)
        os.chdir(folder)
        # in a process of its own nothing else ends what holds the processor
        used = int(sum(resource.getrusage(resource.RUSAGE_SELF)[:2]))
        resource.setrlimit(resource.RLIMIT_CPU, (used + SECONDS, resource.RLIM_INFINITY))
        print(
            json.dumps(asdict(costed(*words) if "COSTS" in os.environ else told(*words))),
            flush=True,
        )


def told(*words):
    return run(*words, seconds=SECONDS)


def costed(*words):
    """Run a command, and write down what it took."""
    began, before = time.process_time(), resident("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    outcome = told(*words)
    cost = {"cpu_seconds": round(time.process_time() - began, 2), "before": before}
    cost |= {"peak": resident("VmHWM"), "code": outcome.code, "error": outcome.err[:200]}
    with Path(os.environ["COSTS"]).open("a") as file:
        file.write(f"{json.dumps(cost)}\n")
    return outcome


def resident(what):
    """Memory of this process, MB: ``VmRSS`` now, ``VmHWM`` at its peak."""
    status = Path("/proc/self/status").read_text()
    return round(int(status.partition(f"{what}:")[2].split()[0]) / 1024)


if __name__ == "__main__":
    main()
