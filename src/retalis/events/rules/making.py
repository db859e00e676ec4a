"""The goals with which a program makes events at times of its own: ``new_event/2,3,5``."""

from typing import Sequence

from ...prolog.logic import Logic
from ...prolog.machine import Frame, Machine
from ...prolog.terms import FIRST, LAST, SECOND, Term, functor
from ..dispatch import Dispatcher
from .inputs import READERS


def define_new_event(logic: Logic, dispatcher: Dispatcher) -> None:
    """Define ``new_event``: with a list of two stamps, with seconds and nanoseconds, with those of start and end."""
    dispatch = dispatcher.dispatch

    def at_instant(machine: Machine, arguments: Sequence[Term], after: Frame, plain: bool = False) -> Frame:
        event, seconds, nanoseconds = arguments
        if seconds.__class__ is int and nanoseconds.__class__ is int:
            instant = seconds * SECOND + nanoseconds
            if FIRST <= instant < LAST:
                return dispatch(event, instant, instant, after, None, plain or None, plain)
        return general(machine, arguments, after)

    def general(machine: Machine, arguments: Sequence[Term], after: Frame) -> Frame:
        made = READERS[functor("new_event", len(arguments))](arguments)
        return dispatch(made.term, made.start, made.end, after, own=False)

    logic.define_control("new_event", 2, general, at_once=True)
    logic.define_control("new_event", 3, at_instant, at_once=True, gate=dispatcher.gate)
    logic.define_control("new_event", 5, general, at_once=True)
