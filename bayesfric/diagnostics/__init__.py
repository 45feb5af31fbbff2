"""What may be wrong with a recording or a model, and how far a fit can be trusted.

- :mod:`~bayesfric.diagnostics.before_a_fit`: unexplained torque, feedback, negative losses.
- :mod:`~bayesfric.diagnostics.explanation`: what else explains the torque, as findings; its method
  is in :mod:`~bayesfric.diagnostics.regression` and :mod:`~bayesfric.diagnostics.statistics`, its
  table in :mod:`~bayesfric.diagnostics.candidates`.
- :mod:`~bayesfric.diagnostics.replicates`: simulated replicates of recordings (a parametric
  bootstrap), the null distribution of every statistic here.
  :func:`~bayesfric.diagnostics.explanation.calibration_check`: the bias of a fit, from these.
"""
