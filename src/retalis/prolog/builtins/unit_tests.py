"""Units of tests: which clauses of ``test/1`` and ``test/2`` stand between ``begin_tests`` and ``end_tests``.

What runs them is in the library (library/plunit.pl).
"""

from typing import Dict, Iterator, NamedTuple, Tuple

from ..database.clause_index import Clause
from ..machine.errors import error, existence_error, permission_error
from ..terms.list_terms import make_list
from ..terms.term_traversal import copy
from ..terms.types import NIL, Term, Values, atom, functor
from .argument_checks import atom_of, items
from .builtin_registry import Machine, Solutions, deterministic, nondeterministic

_HEADS = functor("test", 1), functor("test", 2)
_TEST = functor("test", 3)
_AT = functor(":", 2)


class _TestUnit(NamedTuple):
    """A unit of tests.

    Attributes:
        options: of the unit, as a list.
        before: the clauses of tests that stood there when it began.
        tests: its own, once it has ended.
    """

    options: Term
    before: Tuple[Clause, ...]
    tests: Tuple[Clause, ...]


class _Units:
    """The units of a program, by name in their order; one of them may be open."""

    def __init__(self) -> None:
        self.ended: Dict[str, _TestUnit] = {}
        self.open: Dict[str, _TestUnit] = {}


def _units(machine: Machine) -> _Units:
    units: _Units = machine.logic.state.setdefault("units of tests", _Units())
    return units


def _clauses(machine: Machine) -> Iterator[Clause]:
    for key in _HEADS:
        predicate = machine.logic.database.predicates.get(key)
        if predicate is not None and not predicate.library:
            yield from predicate.live()


@deterministic("begin_tests/1")
def begin_tests(machine: Machine, name: Term) -> bool:
    """Begin a unit of tests."""
    return begin_tests_with(machine, name, NIL)


@deterministic("begin_tests/2")
def begin_tests_with(machine: Machine, name: Term, options: Term) -> bool:
    """Begin a unit of tests, with options that hold for all of it."""
    unit, units = atom_of(name), _units(machine)
    items(options)
    if units.open:
        raise permission_error("begin", "test_unit", unit)
    units.open[unit.name] = _TestUnit(copy(options), tuple(_clauses(machine)), ())
    machine.logic.database.modules.shared.update(_HEADS)
    for key in _HEADS:  # a unit mixes the two
        machine.logic.database.writable(key, "modify").discontiguous = True
    return True


@deterministic("end_tests/1")
def end_tests(machine: Machine, name: Term) -> bool:
    """End a unit of tests: its tests are those that have been read since it began."""
    unit, units = atom_of(name), _units(machine)
    opened = units.open.pop(unit.name, None)
    if opened is None:
        raise error((functor("context_error", 2), atom("end_tests"), unit))
    machine.logic.database.modules.shared.difference_update(_HEADS)
    before = set(map(id, opened.before))
    found = [clause for clause in _clauses(machine) if id(clause) not in before]
    found.sort(key=lambda clause: 0 if clause.place is None else clause.place.line)
    units.ended.pop(unit.name, None)
    units.ended[unit.name] = _TestUnit(opened.options, (), tuple(found))
    return True


@nondeterministic("$unit/3")
def unit_of(machine: Machine, name: Term, options: Term, tests: Term) -> Solutions:
    """Enumerate the units: name, options, and tests as ``test(Place, Head, Body)``."""
    for unit, entry in list(_units(machine).ended.items()):
        shown = make_list([_shown(clause) for clause in entry.tests])
        if machine.unify_all((name, atom(unit)), (options, copy(entry.options)), (tests, shown)):
            yield None


def _shown(clause: Clause) -> Values:
    place = clause.place
    where: Term = atom("-") if place is None else (_AT, atom(place.source), place.line)
    return copy((_TEST, where, clause.head, clause.body))


@nondeterministic("current_test_unit/2")
def current_test_unit(machine: Machine, name: Term, options: Term) -> Solutions:
    """Enumerate the units and their options."""
    for unit, entry in list(_units(machine).ended.items()):
        if machine.unify_all((name, atom(unit)), (options, copy(entry.options))):
            yield None


@deterministic("$no_unit/1")
def no_unit(machine: Machine, name: Term) -> bool:
    """Say that there is no such unit."""
    raise existence_error("unit_test", name)
