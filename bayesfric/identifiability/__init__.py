"""What recordings can and cannot determine, before anything is sampled, and what to record next.

- :mod:`~bayesfric.identifiability.identification`: parameters, null and weak directions, and what
  would lift them, for ``bayesfric identify``.
- :mod:`~bayesfric.identifiability.local`: the Fisher information at the estimate, which all rests
  on.
- :mod:`~bayesfric.identifiability.next_recording`: candidates for the next experiment, ranked by
  what they would leave of one quantity's standard deviation, for ``identify --advise``.
- :mod:`~bayesfric.identifiability.friction_curve`: what recordings cover, and friction over speed.
"""
