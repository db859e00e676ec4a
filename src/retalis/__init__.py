"""Event rules and a Prolog knowledge base for robots, on ROS 1 and without it."""

import sys
from importlib import import_module
from pkgutil import extend_path
from types import ModuleType
from typing import Any

# catkin puts the generated retalis.msg and retalis.srv into a folder of their own, in devel space: both are `retalis`
__path__ = extend_path(__path__, __name__)

__all__ = ["Compound", "Engine", "foreign"]

_HOMES = {"Compound": "prolog.foreign.functions", "Engine": "engine", "foreign": "prolog.foreign.functions"}
"""Where names of this package stand: they are imported when somebody asks, so ``retalis.srv`` costs no engine."""

_HOMES_OF_MODULES = {"errors": "foundation.errors", "explain": "engine.explaining", "terms": "prolog.terms"}
"""Where the modules stand that programs name without their room."""


def __getattr__(name: str) -> Any:
    """Import what is asked for."""
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


class _LazyModule(ModuleType):
    """A module under a name without its room; imported when something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        return getattr(
            import_module(f"{__name__}.{_HOMES_OF_MODULES[self.__name__.rpartition('.')[2]]}"), name
        )


for _name, _home in _HOMES_OF_MODULES.items():
    _module = f"{__name__}.{_name}"
    globals()[_name] = sys.modules[_module] = _LazyModule(_module, f"See `{__name__}.{_home}`.")
