"""Fleets: the same fit of hundreds of joints or days, on one machine or a cluster.

A unit is a fit in a separate run directory. Processes exchange texts only: the filled
configuration, and why a fit failed; recordings are read where the fit runs.
"""
