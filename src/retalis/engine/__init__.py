"""The engine: a program, the events that it takes, and what its subscribers get."""

from .callbacks import OnEvent, OnOutput
from .core import parts_of
from .engine import Engine
from .settings import Settings

__all__ = [
    "Engine",
    "OnEvent",
    "OnOutput",
    "parts_of",
    "Settings",
]
