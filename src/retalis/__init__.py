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

import gc
from importlib import import_module
from pkgutil import extend_path
from typing import TYPE_CHECKING, Any, List

if TYPE_CHECKING:  # for type checkers; a program gets them by `__getattr__`
    from .engine import (
        AwaitedMemory,
        Engine,
        LeftOut,
        MemoryStatus,
        OnEvent,
        OnOutput,
        RuleStatus,
        Settings,
        Status,
        SubscriptionStatus,
        WaitingStatus,
        Work,
    )
    from .engine.explaining import Explanation, ExplanationLine, explain, record_origins
    from .engine.playback import BagError, BagReader, BagWriter, Output, Playback, Record, Topic
    from .engine.runtime import Clock, Reports, StreamClock, collect_when_idle, limit_gc_pauses, restore_gc
    from .events.program import TopicType
    from .foundation import (
        MessageError,
        Omission,
        Place,
        ProgramErrors,
        RetalisError,
        RuleError,
        SyntaxFault,
        UsageError,
    )
    from .messages import Decoder, Definition, Definitions, Encoder
    from .prolog.foreign import Compound, foreign, to_python, to_term
    from .prolog.machine import Limits, PrologError
    from .prolog.syntax import Operators
    from .prolog.terms import Atom, Functor, String, Term, Var, atom, deref, functor, list_items, make_list

# catkin puts the generated retalis.msg and retalis.srv into a folder of their own, in devel space: both are `retalis`
__path__ = extend_path(__path__, __name__)

__all__ = [
    "Atom",
    "atom",
    "AwaitedMemory",
    "BagError",
    "BagReader",
    "BagWriter",
    "Clock",
    "collect_when_idle",
    "Compound",
    "Decoder",
    "Definition",
    "Definitions",
    "deref",
    "Encoder",
    "Engine",
    "explain",
    "Explanation",
    "ExplanationLine",
    "foreign",
    "Functor",
    "functor",
    "LeftOut",
    "limit_gc_pauses",
    "Limits",
    "list_items",
    "make_list",
    "MemoryStatus",
    "MessageError",
    "Omission",
    "OnEvent",
    "OnOutput",
    "Operators",
    "Output",
    "Place",
    "Playback",
    "ProgramErrors",
    "PrologError",
    "Record",
    "record_origins",
    "Reports",
    "restore_gc",
    "RetalisError",
    "RuleError",
    "RuleStatus",
    "Settings",
    "Status",
    "StreamClock",
    "String",
    "SubscriptionStatus",
    "SyntaxFault",
    "Term",
    "to_python",
    "to_term",
    "Topic",
    "TopicType",
    "UsageError",
    "Var",
    "WaitingStatus",
    "Work",
]

_ROOMS = (
    "foundation",
    "prolog.terms",
    "messages",
    "prolog.syntax",
    "prolog.machine",
    "prolog.foreign",
    "events.program",
    "engine.runtime",
    "engine",
    "engine.explaining",
    "engine.playback",
)
"""Where the names stand: a room comes after those that it imports.

They are looked for when somebody asks, so that ``retalis.srv`` costs no engine, and an error no bag.
"""


def __dir__() -> List[str]:
    """Return what a user needs."""
    return [*__all__, *(name for name in globals() if name.startswith("__"))]


def __getattr__(name: str) -> Any:
    """Import what is asked for, and keep it."""
    if name in __all__:
        # The imports make 100,000 objects and no garbage: looking for some would take a tenth of their time.
        was_enabled = gc.isenabled()
        gc.disable()
        try:
            for room in _ROOMS:
                home = import_module(f"{__name__}.{room}")
                if name in home.__all__:
                    found = globals()[name] = getattr(home, name)
                    return found
        finally:
            if was_enabled:
                gc.enable()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
