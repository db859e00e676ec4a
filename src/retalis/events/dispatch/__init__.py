"""From an event to those who listen to its kind, in order, depth first."""

from ...prolog.terms import EventAction
from .building import builder_source, compile_builder
from .dispatch import Dispatcher
from .gates import Gate
from .plans import NOBODY, takes_all
from .serving import (
    AT_ONCE,
    CAUSE,
    DEPTH,
    END,
    GROUND,
    PARENT,
    RESTORE_CONTEXT,
    START,
    TERM,
    TOKEN,
    Context,
    Listener,
    Stage,
)
from .unread import NOT_READ

__all__ = [
    "AT_ONCE",
    "CAUSE",
    "compile_builder",
    "builder_source",
    "Context",
    "DEPTH",
    "Dispatcher",
    "END",
    "EventAction",
    "Gate",
    "GROUND",
    "Listener",
    "NOBODY",
    "NOT_READ",
    "PARENT",
    "RESTORE_CONTEXT",
    "Stage",
    "START",
    "takes_all",
    "TERM",
    "TOKEN",
]
