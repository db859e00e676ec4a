"""Why an event happened, or what was missing for it."""

from .explain import Explanation, ExplanationLine, explain, record_origins, records_origins

__all__ = [
    "explain",
    "Explanation",
    "ExplanationLine",
    "record_origins",
    "records_origins",
]
