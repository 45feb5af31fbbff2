"""Sums of products of residuals: likelihoods whose cost does not grow with the recordings."""
