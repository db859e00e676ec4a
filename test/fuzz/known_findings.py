"""Findings whose repair is planned: a campaign counts them, goes on, and does not fail because of them."""

import re
from typing import Any, NamedTuple, Tuple


class Known(NamedTuple):
    """A finding whose repair is planned.

    Attributes:
        kind: the kind of inputs.
        what: pattern of what the input did, as in the table of README.md.
        place: pattern of the place (a predicate in the kind `limits`) and the detail.
        why: the cause, for the report.
    """

    kind: str
    what: str
    place: str
    why: str


KNOWN: Tuple[Known, ...] = ()


def reason(kind: Any, what: Any, place: Any) -> Any:
    """Return why a finding is known, or an empty text."""
    for one in KNOWN:
        if one.kind == kind and re.fullmatch(one.what, what) and re.search(one.place, place):
            return one.why
    return ""
