"""The recorded database: terms under keys, in order, outside of clauses."""

from typing import Any, Dict, Iterator, List, Optional

from ...terms import Functor, Term, Var, copy, deref, functor, unify
from ..faults import existence_error, instantiation_error, type_error, uninstantiation_error
from ..keys import key_of
from ..machine import LAST
from .registry import deterministic, nondeterministic

_REFERENCE = functor("$record", 1)


class _Record:
    __slots__ = ("key", "value", "reference")

    def __init__(self, key: Any, value: Term, reference: Term):
        self.key = key
        self.value = value
        self.reference = reference


class _Records:
    """All records of a program."""

    def __init__(self) -> None:
        self.by_key: Dict[Any, List[_Record]] = {}
        self.by_number: Dict[int, _Record] = {}
        self._last = 0

    def add(self, key: Term, value: Term, first: bool) -> Term:
        """Record a copy of a term under a key; return the reference."""
        self._last += 1
        record = _Record(_key(key), copy(value), (_REFERENCE, self._last))
        self.by_number[self._last] = record
        same = self.by_key.setdefault(record.key, [])
        # A list of its own: who enumerates the records sees those that were there.
        self.by_key[record.key] = [record, *same] if first else [*same, record]
        return record.reference

    def erase(self, number: int) -> bool:
        """Forget a record; tell whether it was there."""
        record = self.by_number.pop(number, None)
        if record is None:
            return False
        left = [one for one in self.by_key[record.key] if one is not record]
        if left:
            self.by_key[record.key] = left
        else:
            del self.by_key[record.key]
        return True


def _key(term: Term) -> Any:
    """Return what a key is known by: itself, or name and number of arguments."""
    key = key_of(term)
    if key is None:
        raise instantiation_error()
    return key


def _term(key: Any) -> Term:
    """Return the term of a key."""
    if key.__class__ is Functor:
        return (key, *[Var() for _ in range(key.arity)])
    return float.fromhex(key[1]) if key.__class__ is tuple else key


def _records(machine: Any) -> _Records:
    found: Optional[_Records] = machine.logic.state.get("records")
    if found is None:
        found = machine.logic.state["records"] = _Records()
    return found


def _define(name: str, first: bool) -> None:
    @deterministic(f"{name}/2")
    def without_reference(machine: Any, key: Term, value: Term) -> bool:
        _records(machine).add(key, value, first)
        return True

    @deterministic(f"{name}/3")
    def with_reference(machine: Any, key: Term, value: Term, reference: Term) -> bool:
        if deref(reference).__class__ is not Var:
            raise uninstantiation_error(deref(reference))
        return unify(reference, _records(machine).add(key, value, first), machine.trail)


_define("recorda", True)
_define("recordz", False)


@nondeterministic("recorded/2", "recorded/3")
def recorded(machine: Any, key: Term, value: Term, reference: Any = None) -> Iterator[Any]:
    """Enumerate the records of a key, or all of them, in order."""
    records = _records(machine)
    reference = Var() if reference is None else deref(reference)
    if reference.__class__ is not Var:
        record = records.by_number.get(_number(reference))
        candidates = [] if record is None else [record]
    elif deref(key).__class__ is Var:
        candidates = [record for same in records.by_key.values() for record in same]
    else:
        candidates = records.by_key.get(_key(key), [])
    for record in candidates:
        pairs = (key, _term(record.key)), (value, copy(record.value)), (reference, record.reference)
        if machine.unify_all(*(pairs if deref(key).__class__ is Var else pairs[1:])):
            yield LAST if record is candidates[-1] else None


@nondeterministic("current_key/1")
def current_key(machine: Any, key: Term) -> Iterator[Any]:
    """Enumerate the keys that have records."""
    for known in list(_records(machine).by_key):
        if machine.unify(key, _term(known)):
            yield None


@deterministic("erase/1")
def erase(machine: Any, reference: Term) -> bool:
    """Forget a record."""
    if not _records(machine).erase(_number(reference)):
        raise existence_error("db_reference", deref(reference))
    return True


@deterministic("instance/2")
def instance(machine: Any, reference: Term, value: Term) -> bool:
    """Give the term of a record."""
    record = _records(machine).by_number.get(_number(reference))
    return record is not None and unify(value, copy(record.value), machine.trail)


def _number(reference: Term) -> int:
    reference = deref(reference)
    if reference.__class__ is Var:
        raise instantiation_error()
    if reference.__class__ is not tuple or reference[0] is not _REFERENCE:
        raise type_error("db_reference", reference)
    number: int = deref(reference[1])
    return number
