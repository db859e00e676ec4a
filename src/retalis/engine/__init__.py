"""The engine: a program, the events that it takes, and what its subscribers get."""

from .engine import Engine, Instant, OnEvent, OnOutput, Parts, parts_of
from .settings import Settings

__all__ = [
    "Engine",
    "Instant",
    "OnEvent",
    "OnOutput",
    "Parts",
    "parts_of",
    "Settings",
]
