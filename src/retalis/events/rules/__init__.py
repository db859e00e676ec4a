"""All rules of a program: their flags, and the goals by which programs reach them and make events."""

from .alarms import RuleAlarm
from .declared import DeclaredEvents
from .inputs import InputReader, event_of
from .making import define_new_event
from .rules import Rules
from .timers import BEGIN, ProgramTimer, Timers

__all__ = [
    "BEGIN",
    "DeclaredEvents",
    "define_new_event",
    "event_of",
    "InputReader",
    "ProgramTimer",
    "RuleAlarm",
    "Rules",
    "Timers",
]
