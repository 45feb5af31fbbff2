"""The command line in a process of its own, with a likelihood that takes its time, to be stopped.

Waiting costs the test machine nothing, and changes no number.
"""

import sys
import time

from bayesfric.commands import cli
from bayesfric.inference.target import Target
from bayesfric.report import run_directory

PAUSE = 0.01


def main():
    original = Target.__call__

    def slow(self, u):
        time.sleep(PAUSE)
        return original(self, u)

    Target.__call__ = slow
    run_directory.FIGURES = {}
    run_directory.save = lambda *_: None
    cli.main()


if __name__ == "__main__":
    sys.argv[0] = "bayesfric"
    main()
