"""From an event to those who listen to its kind, in order, depth first."""

from ...prolog.terms import EventAction
from .building import compile_builder
from .dispatch import Dispatcher
from .lanes import Completion, goal_lane, stand_in
from .plans import NOBODY, Onlookers, takes_all
from .serving import AT_ONCE, Dispatch, Lane, Listener, Stage
from .unread import NOT_READ

__all__ = [
    "EventAction",
    "AT_ONCE",
    "compile_builder",
    "Completion",
    "Dispatcher",
    "Dispatch",
    "goal_lane",
    "Lane",
    "Listener",
    "NOBODY",
    "NOT_READ",
    "Onlookers",
    "Stage",
    "stand_in",
    "takes_all",
]
