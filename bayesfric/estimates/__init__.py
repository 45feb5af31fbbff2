"""Point estimates and their standard deviations by the paper's three methods.

``least_squares`` (section 4.1) gives the totals seen at the motor, ``input_error`` (section 4.2)
every parameter from the error of the modelled torque, ``output_error`` (section 4.3) every
parameter from the error of a simulated position. They start the sampler and are reported next to
the posterior.
"""

from typing import Literal, get_args

Method = Literal["least-squares", "input-error", "output-error"]
METHODS: tuple[Method, ...] = get_args(Method)
