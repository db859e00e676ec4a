"""Registration of test units: the clauses of ``test/1`` and ``test/2`` between ``begin_tests`` and ``end_tests``.

The test runner is in library/plunit.pl.
"""

from typing import Dict, Iterator, NamedTuple, Tuple

from ..database.clause_index import Clause
from ..machine.errors import error, existence_error, permission_error
from ..machine.machine import Machine
from ..terms.list_terms import make_list
from ..terms.term_traversal import copy
from ..terms.types import NIL, Term, Values, atom, functor
from .argument_checks import atom_of, items
from .builtin_registry import Solutions, deterministic, nondeterministic

_HEADS = functor("test", 1), functor("test", 2)
_TEST = functor("test", 3)
_AT = functor(":", 2)


class _TestUnit(NamedTuple):
    """A test unit.

    Attributes:
        options: list of the unit's options.
        before: test clauses that existed when it began.
        tests: test clauses of the unit; empty until it has ended.
    """

    options: Term
    before: Tuple[Clause, ...]
    tests: Tuple[Clause, ...]


class _TestUnits:
    """The test units of a program by name, in the order of their ends; at most one is open."""

    def __init__(self) -> None:
        self.ended: Dict[str, _TestUnit] = {}
        self.open: Dict[str, _TestUnit] = {}


def _units(machine: Machine) -> _TestUnits:
    units: _TestUnits = machine.logic.state.setdefault("units of tests", _TestUnits())
    return units


def _clauses(machine: Machine) -> Iterator[Clause]:
    for key in _HEADS:
        predicate = machine.logic.database.predicates.get(key)
        if predicate is not None and not predicate.library:
            yield from predicate.live()


@deterministic("begin_tests/1")
def begin_tests(machine: Machine, name: Term) -> bool:
    """Begin a test unit."""
    return begin_tests_with(machine, name, NIL)


@deterministic("begin_tests/2")
def begin_tests_with(machine: Machine, name: Term, options: Term) -> bool:
    """Begin a test unit with options that apply to all of its tests."""
    unit, units = atom_of(name), _units(machine)
    items(options)
    if units.open:
        raise permission_error("begin", "test_unit", unit)
    units.open[unit.name] = _TestUnit(copy(options), tuple(_clauses(machine)), ())
    machine.logic.database.modules.shared.update(_HEADS)
    # A unit mixes clauses of both predicates, which must not cause warnings.
    for key in _HEADS:
        machine.logic.database.writable(key, "modify").discontiguous = True
    return True


@deterministic("end_tests/1")
def end_tests(machine: Machine, name: Term) -> bool:
    """End a test unit: its tests are those that have been loaded since it began."""
    unit, units = atom_of(name), _units(machine)
    opened = units.open.pop(unit.name, None)
    if opened is None:
        raise error((functor("context_error", 2), atom("end_tests"), unit))
    machine.logic.database.modules.shared.difference_update(_HEADS)
    before = set(map(id, opened.before))
    tests = [clause for clause in _clauses(machine) if id(clause) not in before]
    # Clauses of the two predicates are stored separately; tests run in the order of the file.
    tests.sort(key=lambda clause: 0 if clause.place is None else clause.place.line)
    units.ended.pop(unit.name, None)
    units.ended[unit.name] = _TestUnit(opened.options, (), tuple(tests))
    return True


@nondeterministic("$unit/3")
def unit_of(machine: Machine, name: Term, options: Term, tests: Term) -> Solutions:
    """Enumerate the test units with their options, and their tests as ``test(Place, Head, Body)``."""
    for unit, entry in list(_units(machine).ended.items()):
        shown = make_list([_test_term(clause) for clause in entry.tests])
        if machine.unify_all((name, atom(unit)), (options, copy(entry.options)), (tests, shown)):
            yield None


def _test_term(clause: Clause) -> Values:
    place = clause.place
    where: Term = atom("-") if place is None else (_AT, atom(place.source), place.line)
    return copy((_TEST, where, clause.head, clause.body))


@nondeterministic("current_test_unit/2")
def current_test_unit(machine: Machine, name: Term, options: Term) -> Solutions:
    """Enumerate the test units with their options."""
    for unit, entry in list(_units(machine).ended.items()):
        if machine.unify_all((name, atom(unit)), (options, copy(entry.options))):
            yield None


@deterministic("$no_unit/1")
def no_unit(machine: Machine, name: Term) -> bool:
    """Raise the existence error for a test unit."""
    raise existence_error("unit_test", name)
