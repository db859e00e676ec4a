"""What a program may call the events of a topic."""

from typing import Optional

from ...foundation import plain_fault
from .operators import NO_EVENTS, OPERATORS

_TAKEN = frozenset(
    (
        *OPERATORS,
        *NO_EVENTS,
        "event",
        "false",
        "new_event",
        "null_event",
        "query_given_up",
        "rev",
        "synchronized",
        "syncronized",
        "true",
    )
)
"""Names of which events mean something else, or which events do not have."""


def means_other(name: str) -> bool:
    """Tell whether a name means something else in rules."""
    return name in _TAKEN


def event_fault(name: str) -> Optional[str]:
    """Return why the events of a topic cannot have a name, or None."""
    fault = plain_fault(name)
    if fault is not None:
        return fault
    if not name[0].islower():
        return f"the name of an event begins with a small letter, found {name}"
    if "__0__" in name:
        return f"{name} is what the events of a message type are called: choose a name without __0__"
    if name in _TAKEN:
        return f"{name} means something else in rules: choose another name for the events"
    return None
