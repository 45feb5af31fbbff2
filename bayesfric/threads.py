"""Names of the environment that keep libraries to one thread; read when they are imported."""

# Our matrices are small. Threads that share one wait for each other, where another process has
# the second core for hundreds of times as long as the work takes.
LINEAR_ALGEBRA = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
# And of a process that is to be one thread altogether.
ALL = (*LINEAR_ALGEBRA, "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
