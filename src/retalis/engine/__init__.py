"""The engine: a program, the events that it takes, and what its subscribers get."""

from .callbacks import OnEvent, OnOutput
from .engine import Engine, parts_of
from .settings import Settings

__all__ = [
    "Engine",
    "OnEvent",
    "OnOutput",
    "parts_of",
    "Settings",
]
