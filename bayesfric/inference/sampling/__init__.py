"""Walkers: where they start, how they move, when they have converged, how they are kept."""
