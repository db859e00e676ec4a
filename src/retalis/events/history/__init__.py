"""What events came from and why they happened, kept while a flag asks for it."""

from .justification import Justifier
from .owners import Fired
from .store import Store, solutions
from .tracking import Occurrence, Tracker, known_in

__all__ = [
    "Fired",
    "Justifier",
    "known_in",
    "Occurrence",
    "solutions",
    "Store",
    "Tracker",
]
