"""Mechanism: what the joint is, what torque a motion takes, and what motion a torque makes.

A joint is a chain of elements from the motor to the load (section 2.2 of the paper), each with
inertia, friction, load-dependent friction and a ratio. ``quantities`` is the table of all terms,
``element`` and ``joint`` put them together, ``kernels`` holds the element equation once,
``inverse`` (eq. 13) and ``forward`` (section 4.3) evaluate it, ``scaling`` and ``derived`` say
which combinations of parameters a torque can show.
"""
