"""The engine: a program, the events that it takes, and what its subscribers get."""

from .engine import Engine
from .settings import Settings

__all__ = [
    "Engine",
    "Settings",
]
