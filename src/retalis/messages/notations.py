"""Names of messages in other notations: ``Temperature``, ``sensor_msgs/Temperature``, ``sensor_msgs_Temperature``."""

from difflib import get_close_matches
from typing import Dict, Iterable, List, Tuple

_LONGEST = 200
"""Characters of a name for which others that are like it are looked for."""


class Notations:
    """Finds the names of messages by how else they may be written.

    Args:
        names: what messages are called in programs, each with its type, or with itself.
    """

    def __init__(self, names: Iterable[Tuple[str, str]]):
        self._names: Dict[str, List[str]] = {}
        self._by_first: Dict[str, List[str]] = {}
        for name, kind in names:
            for written in dict.fromkeys(map(_letters, (kind, kind.rpartition("/")[2]))):
                self._names.setdefault(written, []).append(name)
        for written in self._names:
            self._by_first.setdefault(written[:1], []).append(written)

    def same(self, name: str) -> List[str]:
        """Return what the messages are called that a name is another notation of."""
        return self._names.get(_letters(name.replace("__0__", "/")), [])

    def near(self, name: str) -> List[str]:
        """Return what the messages are called whose names are like another one, from its first letter on."""
        if len(name) > _LONGEST:
            return []
        letters = _letters(name)
        close = get_close_matches(letters, self._by_first.get(letters[:1], ()), 1, 0.75)
        return self._names[close[0]] if close else []


def _letters(name: str) -> str:
    return "".join(filter(str.isalnum, name)).lower()
