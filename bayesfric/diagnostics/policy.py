"""Thresholds of what is reported about a recording; ``studies/diagnostics`` measured them."""

from bayesfric.estimates.point_estimate import HALF

# Share of recordings with a right model in which anything is reported as missing.
FALSE_ALARMS = 0.05
# Simulated replicates; and samples of all recordings that are evaluated in full. Longer recordings
# are subsampled to half as many, so that a fit or check ends in reasonable time.
REPLICATES, LONGEST = 24, 100_000
# Outputs that a recording or replicate must have beyond the model's parameters.
LEAST_OUTPUTS = 20
# Share of a candidate's columns that must be left after projecting out the model's own columns;
# below it, this motion does not identify the candidate.
TESTABLE = 0.015
# Shift, in standard deviations, from which a finding makes a reported number doubtful: half the
# width of its 90 % interval.
MOVES = HALF
# Largest number of effects included one after the other.
MAX_EFFECTS = 4
# Cosine from which two candidates are collinear on this motion; and the gain by which one must be
# better, a factor of 150 in likelihood.
COLLINEAR, BETTER = 0.95, 10.0
