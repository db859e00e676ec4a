"""Selection of cases by name: option ``-k`` with ``and``, ``or`` and ``not``."""

from typing import Callable, List

from ..foundation.errors import UsageError

NamePredicate = Callable[[str], bool]
"""Returns whether a name is selected."""


def parse_selection(expression: str) -> NamePredicate:
    """Return the selection of an expression.

    A name is selected if it contains a text, in any case of letters. Texts are combined with ``not``, ``and`` and
    ``or``, which bind in this order, as in Python.

    >>> is_selected = parse_selection("fever and not slow")
    >>> is_selected("Fever after an hour"), is_selected("slow fever")
    (True, False)

    Raises:
        UsageError: if a text is missing.
    """
    alternatives = [_parse_conjunction(part, expression) for part in _split(expression, "or")]
    return lambda name: any(is_selected(name.lower()) for is_selected in alternatives)


def _parse_conjunction(text: str, expression: str) -> NamePredicate:
    parts = [_parse_negation(part, expression) for part in _split(text, "and")]
    return lambda name: all(is_selected(name) for is_selected in parts)


def _parse_negation(text: str, expression: str) -> NamePredicate:
    words = text.split()
    is_negated = False
    while words and words[0] == "not":
        is_negated = not is_negated
        words = words[1:]
    if not words:
        raise UsageError(
            f"-k '{expression}': expected a text after 'not', 'and' and 'or', and before 'and' and 'or'"
        )
    searched = " ".join(words).lower()
    return lambda name: (searched in name) != is_negated


def _split(text: str, word: str) -> List[str]:
    parts = [""]
    for part in text.split():
        if part == word:
            parts.append("")
        else:
            parts[-1] = f"{parts[-1]} {part}"
    return parts
