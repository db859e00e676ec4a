"""The kinds of inputs by name."""

from importlib import import_module
from typing import Any

NAMES = (
    "program_texts",
    "event_texts",
    "messages",
    "message_definitions",
    "connection_headers",
    "rules",
    "goals",
    "topic_configuration",
    "bags",
    "hostile_names",
    "joins",
    "limits",
    "states",
    "checkpoints",
    "ros2",
    "incremental_tabling",
)


def kind_of(name: Any) -> Any:
    """Return the class of a kind; only its module is imported."""
    return import_module(f"{__name__}.{name}").Inputs
