"""Fleets: the same fit of hundreds of joints or days, on one machine or a cluster.

A unit is a whole fit in a run directory of its own. What travels between processes is text and
plain dicts: the filled configuration out, a unit's rows back; recordings are read where the fit is.
"""
