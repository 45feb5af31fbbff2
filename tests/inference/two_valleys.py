"""A density to sample that needs no joint, with everything that may go wrong on the way.

As a program, it samples with a checkpoint in the folder it is told, to be killed while it does.
"""

import sys
import time
from copy import copy
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from bayesfric.inference.sampling.checkpoint import Checkpoint
from bayesfric.inference.sampling.sampling import Sampling, sample
from bayesfric.inference.sampling.start import Start

SETTINGS = Sampling(seed=11, min_ess=1e6, max_steps=110, walkers=12, ensembles=2)
FACTS = {"version": {"bayesfric": "0"}, "configuration": {"priors": {"x": [0.0, 1.0]}}}
# so wide that most of what the first proposal makes lies in the hopeless peak
START = Start(np.zeros(3), np.diag([400.0, 1.0, 0.25]))


class TwoValleys:
    """A normal, beside it a hopeless second peak, and a place where the density is no number.

    Preparing it shifts it by what it was prepared for, so that a run that goes on with other
    draws than before has another density.
    """

    dimension = 3
    names = ("x", "y", "z")
    priors = ()
    likelihood = SimpleNamespace(cheap=False, method="input-error")
    coordinates = SimpleNamespace(bends=False)

    def __init__(self, pause=0.0, scale=1.0):
        self.pause, self.scale = pause, scale
        self.shift, self.not_finite = 0.0, 0

    def prepared(self, u):
        out = copy(self)
        out.shift = float(np.sin(u.sum() * 1e3))
        return out

    def to_parameters(self, u):
        return u, np.zeros(len(u))

    def __call__(self, u):
        time.sleep(self.pause)
        main = -0.5 * np.sum((u / self.scale) ** 2 / [1.0, 0.25, 0.0625], axis=1)
        far = np.abs(u[:, 0]) > 2.5
        lost = -80.0 - np.sum((np.abs(u) - [4.0, 0.0, 0.0]) ** 2, axis=1)
        bad = (u[:, 1] > 1.0) & (u[:, 1] < 1.1)
        self.not_finite += int(bad.sum())
        return np.where(bad, -np.inf, np.where(far, lost, main)) + self.shift


def run(folder, *, settings=SETTINGS, facts=FACTS, target=None, **options):
    """Sample, going on where a checkpoint in ``folder`` ends; what ends it early saves first."""
    checkpoint = None
    if folder is not None:
        asked = options.pop("asked_to_stop", lambda: False)
        checkpoint = Checkpoint(Path(folder), "steps", facts, asked_to_stop=asked)
    try:
        return sample(
            target or TwoValleys(), START, settings, checkpoint=checkpoint, **options
        ), checkpoint
    except BaseException:
        if checkpoint is not None:
            checkpoint.save()
        raise


if __name__ == "__main__":
    run(sys.argv[1], target=TwoValleys(pause=0.002))
