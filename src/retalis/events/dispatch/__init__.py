"""From an event to those who listen to its kind, in order, depth first."""

from ...prolog.terms import EventAction
from .building import compile_builder
from .dispatch import Dispatcher
from .firing import Head, firing_action, firing_source
from .lanes import Completion, goal_lane, stand_in
from .plans import NOBODY, takes_all
from .serving import AT_ONCE, Dispatch, Lane, Listener, MakeLane, Stage
from .unread import NOT_READ

__all__ = [
    "EventAction",
    "AT_ONCE",
    "compile_builder",
    "Completion",
    "Dispatcher",
    "Dispatch",
    "firing_action",
    "firing_source",
    "goal_lane",
    "Head",
    "Lane",
    "Listener",
    "MakeLane",
    "NOBODY",
    "NOT_READ",
    "Stage",
    "stand_in",
    "takes_all",
]
