"""The recorded database: terms under keys, in order, outside of clauses."""

from typing import Any, Dict, Hashable, Iterator, List, Optional, Set, Tuple

from ..compiler.predicate_code import key_of
from ..machine.errors import existence_error, instantiation_error, type_error, uninstantiation_error
from ..machine.machine import LAST
from ..terms.term_traversal import copy
from ..terms.types import Functor, Term, Var, deref, functor
from ..terms.unification import unify
from .builtin_registry import Machine, Solutions, deterministic, nondeterministic

_REFERENCE = functor("$record", 1)
_NEVER = 1 << 62


class RecordedTerm:
    """A record: a term under a key, linked with the next ones of that key."""

    __slots__ = ("key", "value", "number", "erased", "before", "behind")

    def __init__(self, key: Hashable, value: Term, number: int):
        self.key = key
        self.value = value
        self.number = number
        self.erased = _NEVER
        """The number of the newest record when it was erased."""
        self.before: Optional[RecordedTerm] = None
        self.behind: Optional[RecordedTerm] = None

    @property
    def reference(self) -> Term:
        """The term by which programs name it."""
        return (_REFERENCE, self.number)


class _RecordChain:
    """The records of one key, linked in their order; what is erased stays linked while somebody walks along them."""

    __slots__ = ("first", "last", "readers", "leaving")

    def __init__(self) -> None:
        self.first: Optional[RecordedTerm] = None
        self.last: Optional[RecordedTerm] = None
        self.readers = 0
        self.leaving: List[RecordedTerm] = []

    def add(self, record: RecordedTerm, first: bool) -> None:
        if self.first is None or self.last is None:
            self.last = self.first = record
        elif first:
            record.behind, self.first.before = self.first, record
            self.first = record
        else:
            record.before, self.last.behind = self.last, record
            self.last = record

    def mend(self) -> None:
        """Link the records back as they are linked forth; nobody reads."""
        self.readers = 0
        self.leaving = []
        before, record = None, self.first
        while record is not None:
            record.before = before
            if record.erased != _NEVER:
                self.leaving.append(record)
            before, record = record, record.behind
        self.last = before
        self.let_go()

    def all(self) -> Iterator[RecordedTerm]:
        """Yield the records, also those that were erased and are still linked."""
        record = self.first
        while record is not None:
            yield record
            record = record.behind

    def let_go(self) -> None:
        """Take out what was erased, if nobody reads."""
        if self.readers:
            return
        for record in self.leaving:
            before, behind = record.before, record.behind
            if before is None:
                self.first = behind
            else:
                before.behind = behind
            if behind is None:
                self.last = before
            else:
                behind.before = before
        self.leaving.clear()


class _RecordedDatabase:
    """All records of a program."""

    def __init__(self) -> None:
        self.by_key: Dict[Hashable, _RecordChain] = {}
        self.by_number: Dict[int, RecordedTerm] = {}
        self._last = 0

    def add(self, key: Term, value: Term, first: bool) -> Term:
        """Record a copy of a term under a key; return the reference."""
        self._last += 1
        record = RecordedTerm(_key(key), copy(value), self._last)
        self.by_number[self._last] = record
        self.by_key.setdefault(record.key, _RecordChain()).add(record, first)
        return record.reference

    def erase(self, number: int) -> bool:
        """Forget a record; tell whether it was there."""
        record = self.by_number.pop(number, None)
        if record is None:
            return False
        self._last += 1  # a number that no record has: the record was there at all numbers before
        record.erased = self._last - 1
        self.by_key[record.key].leaving.append(record)
        self._tidy(record.key)
        return True

    def kept(self) -> Tuple[int, List[Tuple[Hashable, List[Tuple[int, Term]]]]]:
        """Return the newest number, and by key the records in order: number and term; see `restore`."""
        found = [
            (key, [(one.number, one.value) for one in chain.all() if one.erased == _NEVER])
            for key, chain in self.by_key.items()
        ]
        return self._last, found

    def restore(self, kept: Tuple[int, List[Tuple[Hashable, List[Tuple[int, Term]]]]]) -> None:
        """Have the records that another one had."""
        self._last, found = kept
        for key, records in found:
            chain = self.by_key[key] = _RecordChain()
            for number, value in records:
                one = self.by_number[number] = RecordedTerm(key, value, number)
                chain.add(one, False)

    def of_keys(self, keys: List[Hashable]) -> Iterator[RecordedTerm]:
        """Yield the records of keys as they are now, whatever comes and goes meanwhile."""
        newest = self._last
        chains = [(key, self.by_key[key]) for key in keys if key in self.by_key]
        for _, chain in chains:
            chain.readers += 1
        try:
            for _, chain in chains:
                record = chain.first
                while record is not None:
                    if record.number <= newest <= record.erased:
                        yield record
                    record = record.behind
        finally:
            for key, chain in chains:
                chain.readers -= 1
                self._tidy(key)

    def mend(self) -> None:
        """Have each record be there in all respects or in none."""
        there: Set[int] = set()
        for key, chain in list(self.by_key.items()):
            for record in chain.all():
                if record.number not in self.by_number:
                    record.erased = min(record.erased, self._last)
            chain.mend()
            self._tidy(key)
            there.update(record.number for record in chain.all())
        self.by_number = {number: one for number, one in self.by_number.items() if number in there}

    def _tidy(self, key: Hashable) -> None:
        chain = self.by_key[key]
        chain.let_go()
        if chain.first is None:
            del self.by_key[key]


def _key(term: Term) -> Hashable:
    """Return what a key is known by: itself, or name and number of arguments."""
    key: Optional[Hashable] = key_of(term)
    if key is None:
        raise instantiation_error()
    return key


def _term(key: Any) -> Term:
    """Return the term of a key."""
    if key.__class__ is Functor:
        return (key, *[Var() for _ in range(key.arity)])
    return float.fromhex(key[1]) if key.__class__ is tuple else key


def records_of(machine: Machine) -> _RecordedDatabase:
    """Return the records of a machine's program."""
    found: Optional[_RecordedDatabase] = machine.logic.state.get("records")
    if found is None:
        found = machine.logic.state["records"] = _RecordedDatabase()
    return found


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
    """Enumerate the records of a key, or all of them, in order."""
    records = records_of(machine)
    reference = Var() if reference is None else deref(reference)
    if reference.__class__ is not Var:
        record = records.by_number.get(_number(reference))
        found = iter([] if record is None else [record])
    else:
        found = records.of_keys(list(records.by_key) if deref(key).__class__ is Var else [_key(key)])
    record = next(found, None)
    while record is not None:
        following = next(found, None)
        pairs = (key, _term(record.key)), (value, copy(record.value)), (reference, record.reference)
        if machine.unify_all(*(pairs if deref(key).__class__ is Var else pairs[1:])):
            yield LAST if following is None else None
        record = following


@nondeterministic("current_key/1")
def current_key(machine: Machine, key: Term) -> Solutions:
    """Enumerate the keys that have records."""
    for known in list(records_of(machine).by_key):
        if machine.unify(key, _term(known)):
            yield None


@deterministic("erase/1")
def erase(machine: Machine, reference: Term) -> bool:
    """Forget a record."""
    if not records_of(machine).erase(_number(reference)):
        raise existence_error("db_reference", deref(reference))
    return True


@deterministic("instance/2")
def instance(machine: Machine, reference: Term, value: Term) -> bool:
    """Give the term of a record."""
    record = records_of(machine).by_number.get(_number(reference))
    return record is not None and unify(value, copy(record.value), machine.trail)


def _number(reference: Term) -> int:
    reference = deref(reference)
    if reference.__class__ is Var:
        raise instantiation_error()
    if reference.__class__ is not tuple or reference[0] is not _REFERENCE:
        raise type_error("db_reference", reference)
    number = deref(reference[1])
    return number if number.__class__ is int else 0  # a number that no record has
