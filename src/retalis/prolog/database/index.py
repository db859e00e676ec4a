"""Indexes of clauses: by the key of one argument, those that a call may match, in their order."""

from typing import Dict, Iterable, List, Optional, Tuple

from ..compiler import key_of
from ..terms import Atom, Frame
from .clause import NEVER, Clause

_FROM = 8
"""Clauses from which on an index is made."""

_ARGUMENTS = 4
"""How many arguments, the first ones, may be indexed by."""

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


class Indexes:
    """The indexes of a predicate, made as calls come with arguments that tell its clauses apart.

    How many clauses there were when an argument did not is kept, so that it is not tried for each call.
    """

    __slots__ = ("_positions", "_made", "_poor")

    def __init__(self, arity: int) -> None:
        self._positions = range(min(arity, _ARGUMENTS))
        self._made: Dict[int, Index] = {}
        self._poor: Dict[int, int] = {}

    def select(self, clauses: List[Clause], frame: Frame) -> Tuple[List[Clause], Optional[int]]:
        """Return a list that holds all clauses that a call may match, and the argument that it is indexed by.

        Args:
            clauses: all of the predicate, those included that were removed.
            frame: the call.
        """
        size = len(clauses)
        if size < _FROM:
            return clauses, None
        best, by = clauses, None
        for position in self._positions:
            arg = frame[position + 1]
            key = arg if arg.__class__ is Atom else key_of(arg)
            if key is None:
                continue
            found = self._made.get(position)
            if found is None:
                if self._poor.get(position, 0) * 2 > size:
                    continue
                found = self._make(position, clauses)
                if found is None:
                    continue
            others = found.others
            candidates = found.joined(key) if others else found.own.get(key, others)
            if len(candidates) < len(best):
                best, by = candidates, position
                if len(best) <= 2:
                    break
        return best, by

    def _make(self, position: int, clauses: Iterable[Clause]) -> Optional[Index]:
        index = Index()
        clauses = [clause for clause in clauses if clause.died == NEVER]
        keys = [clause.keys[position] for clause in clauses]
        variables = keys.count(None)
        if variables * 2 <= len(clauses):
            for clause in clauses:
                index.add(clause.keys[position], clause)
        if len(index.own) < 2:
            self._poor[position] = len(clauses)
            return None
        self._made[position] = index
        return index

    def add(self, clause: Clause) -> None:
        """Add the last clause."""
        for position, index in self._made.items():
            index.add(clause.keys[position], clause)

    def clear(self) -> None:
        """Forget all: clauses have gone, or not come as the last."""
        self._made.clear()

    def make_anew(self, clauses: Iterable[Clause]) -> None:
        """Make those that there are anew, of nothing but these clauses."""
        positions = list(self._made)
        self._made.clear()
        for position in positions:
            self._make(position, clauses)

    def complete(self) -> List[Tuple[int, Index]]:
        """Return the positions and indexes of arguments that no clause has a variable for, in order."""
        return [(position, index) for position, index in sorted(self._made.items()) if not index.others]

    def __len__(self) -> int:
        """Return how many entries of clauses are held."""
        return sum(map(len, self._made.values()))
