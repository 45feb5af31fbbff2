"""The numbers of a finished run in a simulator's terms. Called, it exports.

Files of a format, what they lose of the fitted joint, and how much torque that is.
"""

import sys
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    """Lets ``bayesfric.export(posterior, to)`` have the name of the package behind it."""

    def __call__(self, *given: Any, **named: Any) -> Any:
        from bayesfric.export.exported import export

        return export(*given, **named)


sys.modules[__name__].__class__ = _Callable
