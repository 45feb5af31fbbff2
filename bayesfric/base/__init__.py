"""Errors, files, progress, options and templates for all rooms; and the version."""

__version__ = "0.2.0"

# Variables of the environment that keep linear algebra to one thread, read when NumPy is imported.
# Our matrices are small: several threads wait for each other where another process has a core.
LINEAR_ALGEBRA_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
