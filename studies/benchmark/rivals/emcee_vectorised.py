"""emcee with a vectorised NumPy likelihood of half the walkers.

``emcee_vectorised.py PROBLEM RESULT [--seconds S] [--warm-up S] [--seed N]``
"""

from __future__ import annotations

import result  # first: it limits the process to one core

# isort: split

import posterior
from emcee_plain import sample

WALKERS = 128  # evaluated 64 at a time: fewer cost more per vector


def main() -> None:
    """Run emcee and write the result."""
    options = result.arguments(__doc__)
    problem = posterior.read(options.problem)
    difference = problem.check(lambda x: problem.log_density_many(x[None])[0])
    words = "vectorised NumPy likelihood"
    many = problem.log_density_many
    sample(options, problem, many, WALKERS, words, difference, vectorize=True)


if __name__ == "__main__":
    main()
