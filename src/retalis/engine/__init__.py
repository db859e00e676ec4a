"""The engine: a program, the events that it takes, and what its subscribers get."""

from .asking import ask, await_memories
from .callbacks import OnEvent, OnOutput
from .core import parts_of
from .engine import Engine
from .rulechanges import add_rule, delete_rule
from .settings import Settings

__all__ = [
    "add_rule",
    "ask",
    "await_memories",
    "delete_rule",
    "Engine",
    "OnEvent",
    "OnOutput",
    "parts_of",
    "Settings",
]
