"""What events came from and why they happened, kept while a flag asks for it."""

from .justification import Justifier
from .store import Store, solutions
from .tracking import Tracker, known_in

__all__ = [
    "Justifier",
    "known_in",
    "solutions",
    "Store",
    "Tracker",
]
