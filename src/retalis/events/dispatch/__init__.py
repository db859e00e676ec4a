"""From an event to those who listen to its kind, in order, depth first."""

from ...prolog.terms import EventAction
from .building import compile_builder
from .dispatch import Dispatcher
from .lanes import Completion, Head, firing_source, goal_lane, stand_in
from .plans import NOBODY, takes_all
from .serving import AT_ONCE, Dispatch, Lane, Listener, Stage
from .unread import NOT_READ

__all__ = [
    "EventAction",
    "AT_ONCE",
    "compile_builder",
    "Completion",
    "Dispatcher",
    "Dispatch",
    "firing_source",
    "goal_lane",
    "Head",
    "Lane",
    "Listener",
    "NOBODY",
    "NOT_READ",
    "Stage",
    "stand_in",
    "takes_all",
]
