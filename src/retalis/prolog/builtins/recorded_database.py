"""The recorded database: terms stored under keys, in order, without being clauses (``recorda/3``, ``recorded/3``).

The records of a key form a doubly linked list. Enumeration follows the logical update view: it returns the records
that existed when it began. To decide that without a copy, records and erasures share one sequence of numbers: a
record is visible if it was added at or before, and erased after, the number at which the enumeration began. Erased
records stay linked while an enumeration of their key is active, so that it can continue from them, and are unlinked
after it.
"""

from typing import Any, Dict, Hashable, Iterator, List, Optional, Set, Tuple

from ..compiler.predicate_code import key_of
from ..machine.errors import existence_error, instantiation_error, type_error, uninstantiation_error
from ..machine.machine import LAST, Machine
from ..terms.term_traversal import copy
from ..terms.types import Functor, Term, Var, deref, functor
from ..terms.unification import unify
from .builtin_registry import Solutions, deterministic, nondeterministic

_REFERENCE = functor("$record", 1)
_NEVER = 1 << 62


class RecordedTerm:
    """A record: a term stored under a key, linked with the preceding and the following one of that key."""

    __slots__ = ("key", "value", "number", "erased", "preceding", "following")

    def __init__(self, key: Hashable, value: Term, number: int):
        self.key = key
        self.value = value
        self.number = number
        self.erased = _NEVER
        """Number of the newest record at the time of the erasure."""
        self.preceding: Optional[RecordedTerm] = None
        self.following: Optional[RecordedTerm] = None

    @property
    def reference(self) -> Term:
        """The reference term of the record."""
        return (_REFERENCE, self.number)


class _RecordChain:
    """The linked records of one key; erased ones stay linked while an enumeration is active.

    Attributes:
        readers: number of active enumerations.
        erased_records: erased records that are still linked.
    """

    __slots__ = ("first", "last", "readers", "erased_records")

    def __init__(self) -> None:
        self.first: Optional[RecordedTerm] = None
        self.last: Optional[RecordedTerm] = None
        self.readers = 0
        self.erased_records: List[RecordedTerm] = []

    def add(self, record: RecordedTerm, first: bool) -> None:
        if self.first is None or self.last is None:
            self.last = self.first = record
        elif first:
            record.following, self.first.preceding = self.first, record
            self.first = record
        else:
            record.preceding, self.last.following = self.last, record
            self.last = record

    def mend(self) -> None:
        """Restore the links after an interrupt, when no enumeration is active.

        Only the forward links are trusted: each update changes them in one step.
        """
        self.readers = 0
        self.erased_records = []
        preceding, record = None, self.first
        while record is not None:
            record.preceding = preceding
            if record.erased != _NEVER:
                self.erased_records.append(record)
            preceding, record = record, record.following
        self.last = preceding
        self.unlink_erased()

    def all(self) -> Iterator[RecordedTerm]:
        """Yield all linked records, including erased ones."""
        record = self.first
        while record is not None:
            yield record
            record = record.following

    def unlink_erased(self) -> None:
        """Unlink the erased records, unless an enumeration is active."""
        if self.readers:
            return
        # An erased record keeps its own links, but no enumeration needs them any more.
        for record in self.erased_records:
            preceding, following = record.preceding, record.following
            if preceding is None:
                self.first = following
            else:
                preceding.following = following
            if following is None:
                self.last = preceding
            else:
                following.preceding = preceding
        self.erased_records.clear()


class _RecordedDatabase:
    """All records of a program."""

    def __init__(self) -> None:
        self.by_key: Dict[Hashable, _RecordChain] = {}
        self.by_number: Dict[int, RecordedTerm] = {}
        self._last = 0

    def add(self, key: Term, value: Term, first: bool) -> Term:
        """Store a copy of a term under a key; return its reference."""
        self._last += 1
        record = RecordedTerm(_record_key(key), copy(value), self._last)
        self.by_number[self._last] = record
        self.by_key.setdefault(record.key, _RecordChain()).add(record, first)
        return record.reference

    def erase(self, number: int) -> bool:
        """Erase a record; return whether it existed."""
        # Removed from the index first: an interrupt after this leaves a record that `mend` recognises as erased.
        record = self.by_number.pop(number, None)
        if record is None:
            return False
        # The erasure gets a number of its own, so that an enumeration that begins later does not see the record.
        self._last += 1
        record.erased = self._last - 1
        self.by_key[record.key].erased_records.append(record)
        self._unlink_erased(record.key)
        return True

    def kept(self) -> Tuple[int, List[Tuple[Hashable, List[Tuple[int, Term]]]]]:
        """Return the newest number, and for each key the numbers and terms of its records in order; see `restore`."""
        chains = [
            (key, [(record.number, record.value) for record in chain.all() if record.erased == _NEVER])
            for key, chain in self.by_key.items()
        ]
        return self._last, chains

    def restore(self, kept: Tuple[int, List[Tuple[Hashable, List[Tuple[int, Term]]]]]) -> None:
        """Replace the records by those that `kept` has returned."""
        self._last, chains = kept
        for key, records in chains:
            chain = self.by_key[key] = _RecordChain()
            for number, value in records:
                record = self.by_number[number] = RecordedTerm(key, value, number)
                chain.add(record, False)

    def of_keys(self, keys: List[Hashable]) -> Iterator[RecordedTerm]:
        """Yield the current records of keys, without those that are added during the enumeration."""
        newest = self._last
        # All chains are protected at once, not each when it is reached, since a later one may be erased before.
        chains = [(key, self.by_key[key]) for key in keys if key in self.by_key]
        for _, chain in chains:
            chain.readers += 1
        try:
            for _, chain in chains:
                record = chain.first
                while record is not None:
                    if record.number <= newest <= record.erased:
                        yield record
                    record = record.following
        finally:
            for key, chain in chains:
                chain.readers -= 1
                self._unlink_erased(key)

    def mend(self) -> None:
        """Restore consistency after an interrupt: each record is in both indexes or in neither."""
        linked: Set[int] = set()
        for key, chain in list(self.by_key.items()):
            for record in chain.all():
                # The erasure was interrupted after its first step, and is completed here.
                if record.number not in self.by_number:
                    record.erased = min(record.erased, self._last)
            chain.mend()
            self._unlink_erased(key)
            linked.update(record.number for record in chain.all())
        self.by_number = {number: record for number, record in self.by_number.items() if number in linked}

    def _unlink_erased(self, key: Hashable) -> None:
        chain = self.by_key[key]
        chain.unlink_erased()
        # Keys without records are not enumerated by `current_key/1`.
        if chain.first is None:
            del self.by_key[key]


def _record_key(term: Term) -> Hashable:
    """Return the hashable form of a key: a constant, or the functor of a compound term."""
    record_key: Optional[Hashable] = key_of(term)
    if record_key is None:
        raise instantiation_error()
    return record_key


def _key_term(key: Any) -> Term:
    """Return the most general term of a key."""
    if key.__class__ is Functor:
        return (key, *[Var() for _ in range(key.arity)])
    return float.fromhex(key[1]) if key.__class__ is tuple else key


def records_of(machine: Machine) -> _RecordedDatabase:
    """Return the recorded database of a machine's program."""
    database: Optional[_RecordedDatabase] = machine.logic.state.get("records")
    if database is None:
        database = machine.logic.state["records"] = _RecordedDatabase()
    return database


def _define(name: str, first: bool) -> None:
    @deterministic(f"{name}/2")
    def without_reference(machine: Machine, key: Term, value: Term) -> bool:
        records_of(machine).add(key, value, first)
        return True

    @deterministic(f"{name}/3")
    def with_reference(machine: Machine, key: Term, value: Term, reference: Term) -> bool:
        if deref(reference).__class__ is not Var:
            raise uninstantiation_error(deref(reference))
        return unify(reference, records_of(machine).add(key, value, first), machine.trail)


_define("recorda", True)
_define("recordz", False)


@nondeterministic("recorded/2", "recorded/3")
def recorded(machine: Machine, key: Term, value: Term, reference: Optional[Term] = None) -> Solutions:
    """Enumerate the records of a key, or of all keys, in order."""
    database = records_of(machine)
    reference = Var() if reference is None else deref(reference)
    if reference.__class__ is not Var:
        record = database.by_number.get(_number(reference))
        records = iter([] if record is None else [record])
    else:
        records = database.of_keys(
            list(database.by_key) if deref(key).__class__ is Var else [_record_key(key)]
        )
    record = next(records, None)
    # Fetches one record ahead, so that the last solution leaves no choice point.
    while record is not None:
        following = next(records, None)
        pairs = (key, _key_term(record.key)), (value, copy(record.value)), (reference, record.reference)
        if machine.unify_all(*(pairs if deref(key).__class__ is Var else pairs[1:])):
            yield LAST if following is None else None
        record = following


@nondeterministic("current_key/1")
def current_key(machine: Machine, key: Term) -> Solutions:
    """Enumerate the keys with records."""
    for known in list(records_of(machine).by_key):
        if machine.unify(key, _key_term(known)):
            yield None


@deterministic("erase/1")
def erase(machine: Machine, reference: Term) -> bool:
    """Erase a record."""
    if not records_of(machine).erase(_number(reference)):
        raise existence_error("db_reference", deref(reference))
    return True


@deterministic("instance/2")
def instance(machine: Machine, reference: Term, value: Term) -> bool:
    """Unify with the term of a record."""
    record = records_of(machine).by_number.get(_number(reference))
    return record is not None and unify(value, copy(record.value), machine.trail)


def _number(reference: Term) -> int:
    reference = deref(reference)
    if reference.__class__ is Var:
        raise instantiation_error()
    if reference.__class__ is not tuple or reference[0] is not _REFERENCE:
        raise type_error("db_reference", reference)
    number = deref(reference[1])
    return number if number.__class__ is int else 0  # no record has the number 0
