"""Findings whose repair is planned: a campaign counts them, goes on, and does not fail because of them."""

import re
from typing import NamedTuple


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


STATES = "values of a state are not all checked before they are used"

TOO_MUCH = "time|growth|hang|died.*"

KNOWN = (
    Known("states", "exception|logged", "", STATES),
    Known("states", "time|growth", "keeping/coding.py", STATES),
)


def reason(kind, what, place):
    """Return why a finding is known, or an empty text."""
    for one in KNOWN:
        if one.kind == kind and re.fullmatch(one.what, what) and re.search(one.place, place):
            return one.why
    return ""
