"""Formats to export to, one file each; see :mod:`bayesfric.export.format`."""
