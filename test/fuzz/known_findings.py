"""Findings whose repair is planned: a campaign counts them and does not fail."""

import re
from typing import Any, NamedTuple, Tuple


class Known(NamedTuple):
    """A finding whose repair is planned.

    Attributes:
        kind: the kind of inputs.
        category: pattern of the category, as in the table of README.md.
        place: pattern of the place (a predicate in the kind `limits`) and the detail.
        cause: the cause, for the report.
    """

    kind: str
    category: str
    place: str
    cause: str


KNOWN: Tuple[Known, ...] = ()


def reason(kind: Any, category: Any, place: Any) -> str:
    """Return why a finding is known, or an empty text."""
    for finding in KNOWN:
        if (
            finding.kind == kind
            and re.fullmatch(finding.category, category)
            and re.search(finding.place, place)
        ):
            return finding.cause
    return ""
