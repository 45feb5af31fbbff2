"""Names of the environment that keep libraries to few threads; read when they are imported."""

# Our matrices are small. Threads that share one wait for each other, where another process has
# the second core for hundreds of times as long as the work takes.
LINEAR_ALGEBRA = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
# And of a process that is to be one thread altogether.
ALL = (*LINEAR_ALGEBRA, "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
# What a command sets: threads of compiled kernels that wait do not turn in circles meanwhile,
# where another process could have the core.
QUIET = {**dict.fromkeys(LINEAR_ALGEBRA, "1"), "OMP_WAIT_POLICY": "PASSIVE"}
