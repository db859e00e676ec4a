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
    from .engine.engine import Engine, OnEvent, OnOutput
    from .engine.engine_settings import Settings
    from .engine.engine_status import (
        AwaitedMemory,
        LeftOut,
        MemoryStatus,
        RuleStatus,
        Status,
        SubscriptionStatus,
        WaitingStatus,
        Work,
    )
    from .engine.runtime.problem_reports import Reports
    from .events.clock.clock import Clock, StreamClock
    from .events.program.topic_configuration import TopicType
    from .explanation.event_and_output_explanations import explain, record_origins
    from .explanation.explanation_lines import Explanation, ExplanationLine
    from .foundation.errors import (
        MessageError,
        Omission,
        ProgramErrors,
        RetalisError,
        RuleError,
        SyntaxFault,
        UsageError,
    )
    from .foundation.garbage_collection import collect_when_idle, limit_gc_pauses, restore_gc
    from .foundation.interrupts import deferred_interrupts
    from .foundation.source_places import Place
    from .messages.decoder import Decoder
    from .messages.encoder import Encoder
    from .messages.type_definition import Definition
    from .messages.type_registry import Definitions
    from .playback.playback import Output, Playback
    from .playback.rosbag1 import BagError, BagReader, BagWriter, Record, Topic
    from .prolog.machine.errors import PrologError
    from .prolog.machine.resource_limits import Limits
    from .prolog.syntax.operators import Operators
    from .prolog.system.foreign_functions import foreign
    from .prolog.system.value_conversion import Compound, to_python, to_term
    from .prolog.terms.list_terms import list_items, make_list
    from .prolog.terms.types import Atom, Functor, String, Term, Var, atom, deref, functor

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
    "deferred_interrupts",
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

_MODULES = {
    "Atom": "prolog.terms.types",
    "atom": "prolog.terms.types",
    "AwaitedMemory": "engine.engine_status",
    "BagError": "playback.rosbag1",
    "BagReader": "playback.rosbag1",
    "BagWriter": "playback.rosbag1",
    "Clock": "events.clock.clock",
    "collect_when_idle": "foundation.garbage_collection",
    "Compound": "prolog.system.value_conversion",
    "Decoder": "messages.decoder",
    "deferred_interrupts": "foundation.interrupts",
    "Definition": "messages.type_definition",
    "Definitions": "messages.type_registry",
    "deref": "prolog.terms.types",
    "Encoder": "messages.encoder",
    "Engine": "engine.engine",
    "explain": "explanation.event_and_output_explanations",
    "Explanation": "explanation.explanation_lines",
    "ExplanationLine": "explanation.explanation_lines",
    "foreign": "prolog.system.foreign_functions",
    "Functor": "prolog.terms.types",
    "functor": "prolog.terms.types",
    "LeftOut": "engine.engine_status",
    "limit_gc_pauses": "foundation.garbage_collection",
    "Limits": "prolog.machine.resource_limits",
    "list_items": "prolog.terms.list_terms",
    "make_list": "prolog.terms.list_terms",
    "MemoryStatus": "engine.engine_status",
    "MessageError": "foundation.errors",
    "Omission": "foundation.errors",
    "OnEvent": "engine.engine",
    "OnOutput": "engine.engine",
    "Operators": "prolog.syntax.operators",
    "Output": "playback.playback",
    "Place": "foundation.source_places",
    "Playback": "playback.playback",
    "ProgramErrors": "foundation.errors",
    "PrologError": "prolog.machine.errors",
    "Record": "playback.rosbag1",
    "record_origins": "explanation.event_and_output_explanations",
    "Reports": "engine.runtime.problem_reports",
    "restore_gc": "foundation.garbage_collection",
    "RetalisError": "foundation.errors",
    "RuleError": "foundation.errors",
    "RuleStatus": "engine.engine_status",
    "Settings": "engine.engine_settings",
    "Status": "engine.engine_status",
    "StreamClock": "events.clock.clock",
    "String": "prolog.terms.types",
    "SubscriptionStatus": "engine.engine_status",
    "SyntaxFault": "foundation.errors",
    "Term": "prolog.terms.types",
    "to_python": "prolog.system.value_conversion",
    "to_term": "prolog.system.value_conversion",
    "Topic": "playback.rosbag1",
    "TopicType": "events.program.topic_configuration",
    "UsageError": "foundation.errors",
    "Var": "prolog.terms.types",
    "WaitingStatus": "engine.engine_status",
    "Work": "engine.engine_status",
}
"""The module that defines each public name.

A name is imported at its first use, so that ``retalis.srv`` costs no engine, and an error no bag.
"""


def __dir__() -> List[str]:
    """Return what a user needs."""
    return [*__all__, *(name for name in globals() if name.startswith("__"))]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use."""
    module = _MODULES.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # The imports make 100,000 objects and no garbage: looking for some would take a tenth of their time.
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        if name == "Operators":
            # `Operators.prolog()` includes the operators of the event language, which registers them when imported.
            import_module(f"{__name__}.events.language.event_operators")
        value = globals()[name] = getattr(import_module(f"{__name__}.{module}"), name)
        return value
    finally:
        if was_enabled:
            gc.enable()
