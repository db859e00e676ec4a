"""Events that a program creates: their kinds, and values that do not fit the slots that they are put into."""

from typing import Any, List, NamedTuple

from ...messages.type_definition import Definition
from ...prolog.terms.types import CompoundTerm, deref
from .abstract_environment import Environment
from .abstract_store import AbstractStore, EventSignatures
from .program_model import subterms, wrap_term
from .value_conflict_reports import ConflictReporter, place_in
from .value_kinds import (
    ATOM,
    BOOL,
    COMPOUND,
    LIST,
    PLAIN_TEXT,
    STAMP,
    STRING,
    TEXT,
    WORD,
    Kinds,
    ValueOrigin,
    are_disjoint,
    find_quoted_text,
    kinds_of_slot,
    kinds_of_type,
)

_ALSO_ACCEPTED = {TEXT: (ATOM, STRING, BOOL), PLAIN_TEXT: (STRING,), STAMP: (LIST, COMPOUND)}


class _ExpectedKinds(NamedTuple):
    """Kinds of the values that a slot or declared argument accepts, at a position of a term."""

    position: int
    name: str
    kinds: Kinds


class CreatedEvents:
    """Events that rules, states, subscriptions and goals create.

    Args:
        store: receives the kinds of their arguments.
        signatures: types of their slots and declared arguments.
        conflicts: receives values that do not fit.
    """

    def __init__(self, store: AbstractStore, signatures: EventSignatures, conflicts: ConflictReporter):
        self._store = store
        self._signatures = signatures
        self._conflicts = conflicts

    def add(self, event: Any, environment: Environment) -> None:
        """Add the values of an event that the program emits, and check those of its slots."""
        if event.__class__ is tuple:
            if self._store.has_event(event[0]):
                self._store.add_event(event, environment)
            self.check_slots(event, environment)

    def check_slots(self, term: Any, environment: Environment) -> None:
        """Report the values that do not fit the slots or declared arguments that they are put into."""
        if not self._conflicts.is_enabled or term.__class__ is not tuple:
            return
        for subterm in subterms(wrap_term(term), 1, environment.part.place_of):
            definition = self._signatures.message_of(subterm.term)
            if definition is not None:
                expected = _expected_by_slots(definition)
            else:
                expected = self._expected_by_declaration(term) if subterm.term is term else []
            for argument in expected:
                self._check_argument(subterm.term, argument, environment)

    def _expected_by_declaration(self, event: CompoundTerm) -> List[_ExpectedKinds]:
        declaration = self._signatures.declaration_of(event)
        if declaration is None:
            return []
        expected: List[_ExpectedKinds] = []
        for position, argument in enumerate(declaration.arguments, 1):
            name = f"{argument.name} of {event[0]}"
            expected.append(_ExpectedKinds(position, name, kinds_of_type(argument.value_type, name)))
        return expected

    def _check_argument(self, term: CompoundTerm, expected: _ExpectedKinds, environment: Environment) -> None:
        var: Any = deref(term[expected.position])
        known = environment.value_of(var)
        # Slots of one rule are compared by `find_type_conflicts`.
        if known is None or known.is_direct or not known.kinds or not expected.kinds:
            return
        accepted = dict(expected.kinds)
        # Texts are also written for names and strings, and stamps for ``datime`` terms.
        for kind in next((others for kind, others in _ALSO_ACCEPTED.items() if kind in accepted), ()):
            accepted.setdefault(kind, ValueOrigin(expected.name))
        # A name such as ``pi`` is written as text, too, although it overlaps with numbers.
        is_accepted_word = TEXT in expected.kinds and WORD in known.kinds
        part = environment.part
        place = place_in(part, term, expected.position)
        quoted = find_quoted_text(known.kinds, expected.kinds)
        if are_disjoint(known.kinds, accepted) and not is_accepted_word:
            self._conflicts.report_slot(part, var, known.kinds, expected.name, expected.kinds, place)
        elif quoted is not None:
            name = self._conflicts.name_of(part, var)
            self._conflicts.report_quoted_text(part, name, quoted, expected.kinds, place)


def _expected_by_slots(definition: Definition) -> List[_ExpectedKinds]:
    expected: List[_ExpectedKinds] = []
    for position, slot in enumerate(definition.fields, 1):
        # Truth values can be written as 0 and 1, and bytes as lists.
        accepts_others = slot.is_bytes or (slot.type == "bool" and slot.length is None)
        if not accepts_others:
            name = f"{slot.name} of {definition.name}"
            expected.append(_ExpectedKinds(position, name, kinds_of_slot(slot, name)))
    return expected
