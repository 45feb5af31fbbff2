"""What we tell: tables, figures, pages. Called, it writes a run directory."""

import sys
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    """Lets ``bayesfric.report(posterior, folder)`` have the name of the package behind it."""

    def __call__(self, *given: Any, **named: Any) -> Any:
        from bayesfric.result import report

        return report(*given, **named)


sys.modules[__name__].__class__ = _Callable
