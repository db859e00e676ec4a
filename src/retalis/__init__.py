"""Event rules and a Prolog knowledge base for robots, on ROS 1 and without it.

An `Engine` takes a program and events, and gives events and answers::

    engine = Engine()
    engine.load(rules="fever(Who) <- (temperature(Who, A) seq temperature(Who, B)) where (A > 38, B > 38).")
    engine.on_event(lambda term, start, end: print(engine.show(term)))
    engine.event("temperature(ann, 38.4)", 1)
    engine.event("temperature(ann, 38.6)", 2)

prints the two events and ``fever(ann)``. Instants are nanoseconds since the epoch. `Playback` runs a program over a
bag.
"""

import sys
from importlib import import_module
from pkgutil import extend_path
from types import ModuleType
from typing import TYPE_CHECKING, Any, List

if TYPE_CHECKING:  # for type checkers; a program gets them by `__getattr__`
    from .engine import Engine, OnEvent, OnOutput, Settings
    from .engine.playback import BagError, BagReader, BagWriter, Output, Playback
    from .engine.runtime import Clock, StreamClock
    from .foundation import MessageError, ProgramErrors, RetalisError, RuleError, SyntaxFault, UsageError
    from .messages import Definitions
    from .prolog.foreign import Compound, foreign
    from .prolog.machine import Limits, PrologError

# catkin puts the generated retalis.msg and retalis.srv into a folder of their own, in devel space: both are `retalis`
__path__ = extend_path(__path__, __name__)

__all__ = [
    "BagError",
    "BagReader",
    "BagWriter",
    "Clock",
    "Compound",
    "Definitions",
    "Engine",
    "foreign",
    "Limits",
    "MessageError",
    "OnEvent",
    "OnOutput",
    "Output",
    "Playback",
    "ProgramErrors",
    "PrologError",
    "RetalisError",
    "RuleError",
    "Settings",
    "StreamClock",
    "SyntaxFault",
    "UsageError",
]

_HOMES = {
    "BagError": "engine.playback",
    "BagReader": "engine.playback",
    "BagWriter": "engine.playback",
    "Clock": "engine.runtime",
    "Compound": "prolog.foreign",
    "Definitions": "messages",
    "Engine": "engine",
    "foreign": "prolog.foreign",
    "Limits": "prolog.machine",
    "MessageError": "foundation",
    "OnEvent": "engine",
    "OnOutput": "engine",
    "Output": "engine.playback",
    "Playback": "engine.playback",
    "ProgramErrors": "foundation",
    "PrologError": "prolog.machine",
    "RetalisError": "foundation",
    "RuleError": "foundation",
    "Settings": "engine",
    "StreamClock": "engine.runtime",
    "SyntaxFault": "foundation",
    "UsageError": "foundation",
}
"""Where names of this package stand: they are imported when somebody asks, so ``retalis.srv`` costs no engine."""

_HOMES_OF_MODULES = {"errors": "foundation.errors", "explain": "engine.explaining", "terms": "prolog.terms"}
"""Where the modules stand that programs name without their room."""


def __dir__() -> List[str]:
    """Return what a user needs, and the modules that programs name."""
    return [*__all__, *_HOMES_OF_MODULES, *(name for name in globals() if name.startswith("__"))]


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
        return getattr(self._home(), name)

    def __dir__(self) -> List[str]:
        return list(self._home().__all__)

    def _home(self) -> ModuleType:
        return import_module(f"{__name__}.{_HOMES_OF_MODULES[self.__name__.rpartition('.')[2]]}")


for _name, _home in _HOMES_OF_MODULES.items():
    _module = f"{__name__}.{_name}"
    globals()[_name] = sys.modules[_module] = _LazyModule(_module, f"See `{__name__}.{_home}`.")
