"""What events came from and why they happened, kept while a flag asks for it."""

from .justification import Justifier
from .occurrences import Occurrence, Suppressed, known_in
from .owners import Fired, Remembered
from .store import Store, solutions
from .tracking import Tracker

__all__ = [
    "Fired",
    "Justifier",
    "known_in",
    "Occurrence",
    "Remembered",
    "solutions",
    "Store",
    "Suppressed",
    "Tracker",
]
