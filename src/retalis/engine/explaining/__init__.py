"""Why an event happened, or what was missing for it."""

from .explain import Explanation, Line, explain, prepare

__all__ = [
    "explain",
    "Explanation",
    "Line",
    "prepare",
]
