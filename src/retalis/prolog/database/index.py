"""Indexes of clauses: by the key of one argument, those that a call may match, in their order."""

from typing import Dict, List, Tuple

from .clause import Clause

_MOST_COPIES = 1_000_000
"""Entries of clauses with a variable, under all keys that were asked for, from which on they are made anew."""


class Index:
    """The clauses of a predicate by the key of one argument; those with a variable there match under any key.

    What has a variable is entered once, and joined with the clauses of a key only when that is asked for: the
    time to add clauses and ask for them grows with what is asked for, not with the number of keys.

    Attributes:
        own: by key, the clauses with that key.
        others: the clauses with a variable.
    """

    __slots__ = ("own", "others", "_before", "_joined", "_copies")

    def __init__(self) -> None:
        self.own: Dict[object, List[Clause]] = {}
        self.others: List[Clause] = []
        self._before: Dict[object, List[int]] = {}
        self._joined: Dict[object, Tuple[List[Clause], int, int]] = {}
        self._copies = 0

    def add(self, key: object, clause: Clause) -> None:
        """Add the last clause; the key is None where it has a variable."""
        if key is None:
            self.others.append(clause)
            return
        own = self.own.setdefault(key, [])
        if self.others:
            before = self._before.get(key)
            if before is None:
                before = self._before[key] = [0] * len(own)
            before.append(len(self.others))
        own.append(clause)

    def joined(self, key: object) -> List[Clause]:
        """Return all clauses that may match under a key, in their order; to be called where there are `others`.

        The list is only added to from then on.
        """
        own, others = self.own.get(key), self.others
        if own is None:
            return others
        found, of_own, of_others = self._joined.get(key) or ([], 0, 0)
        if of_own == len(own) and of_others == len(others):
            return found
        before = self._before.get(key, ())
        self._copies += len(others) - of_others
        for at in range(of_own, len(own)):
            least = before[at] if at < len(before) else 0
            if least > of_others:
                found += others[of_others:least]
                of_others = least
            found.append(own[at])
        found += others[of_others:]
        if self._copies > _MOST_COPIES:
            self._joined.clear()
            self._copies = len(others)
        self._joined[key] = found, len(own), len(others)
        return found

    def __len__(self) -> int:
        """Return how many entries of clauses are held, those of joined lists included."""
        joined = sum(len(found) for found, _, _ in self._joined.values())
        return sum(map(len, self.own.values())) + len(self.others) + joined
