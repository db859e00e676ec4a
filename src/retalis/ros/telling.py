"""What one node tells the other as JSON, read by the one that is told: anybody may have sent it."""

import json
from typing import Any

from ..foundation import MessageError

LONGEST = 1_000_000
"""Characters of what is told at most."""


def read_told_json(text: str, wrong: MessageError) -> Any:
    """Return the data of a text.

    Raises:
        MessageError: ``wrong``, where it is no JSON or too long.
    """
    try:
        return json.loads(text) if len(text) <= LONGEST else None
    except (ValueError, RecursionError):
        raise wrong from None
