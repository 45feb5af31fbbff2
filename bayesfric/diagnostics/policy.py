"""The few probabilities and sizes by which it is decided what is said of a recording.

The rate of false alarms, the number of replicates, how far an effect must move a reported number for a
doubt, and when two candidates count as one. ``studies/diagnostics`` says what they give.
"""

from bayesfric.estimates.point_estimate import HALF

# Of recordings whose model is right, the share in which anything is said to be missing.
FALSE_ALARMS = 0.05
# Replicates that tell what chance does, and samples of recordings that are asked whole at most; of more
# an excerpt of half as many is asked, as a fit and a check are to end before anybody gives up.
REPLICATES, LONGEST = 24, 100_000
# Outputs beyond the model's parameters that a recording or replicate must have to be asked.
LEAST_OUTPUTS = 20
# Share of a candidate's columns that must be left beside the model's own, or this motion does not
# tell the one from the other.
TESTABLE = 0.015
# Standard deviations that a certain effect must move a reported number by for that to be doubted:
# half the width of its 90 % interval.
MOVES = HALF
# Most effects that are looked for one after the other.
MOST = 4
# Cosine from which two candidates are one group: this motion does not tell them apart; and the
# gain by which one must be better, a factor of 150 in likelihood.
ALIKE, BETTER = 0.95, 10.0
