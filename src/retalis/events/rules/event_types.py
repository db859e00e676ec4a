"""Event schemas: the declarations ``declare_event/1`` of a program, and the check of events against them.

Declarations are stored as clauses of a hidden predicate. So they are removed, reloaded and saved together with the
other clauses of a program, without code of their own. The parsed form is cached per clause.
"""

from typing import TYPE_CHECKING, Callable, Dict, Iterable, List

from ...foundation.errors import RuleError, UsageError
from ...messages.type_definition import type_name
from ...prolog.database.clause_index import Clause
from ...prolog.machine.errors import domain_error
from ...prolog.machine.machine import Machine
from ...prolog.syntax.operators import DECLARE_EVENT
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.types import Functor, Term, deref, functor
from ..language.event_declarations import STRICTLY, UNDECLARED, Declaration, Declarations, parse_declarations
from ..program.event_file_checker import no_place

if TYPE_CHECKING:
    from .rule_base import RuleBase

_DECLARED = functor("$declared_event", 1)
_ALWAYS_DECLARED = frozenset(functor(name, arity) for name, arity in (("null", 0), ("null_event", 0)))
_NO_CLAUSES: List[Clause] = []


class EventTypes:
    """Declared events of a program.

    Args:
        rules: rules of the program; a flag tells whether each event must be declared.
        is_external_event: returns whether events of a functor need no declaration, because they are messages or
            events of the package itself.

    Attributes:
        in_use: whether anything has been declared. If not, events are not checked at all.
    """

    def __init__(self, rules: "RuleBase", is_external_event: Callable[[Functor], bool]):
        logic: PrologSystem = rules.logic
        self._logic = logic
        self._flags = rules.flags
        self._clauses: List[Clause] = _NO_CLAUSES
        self._clause_count = self._dead_count = 0
        self._read: Dict[Clause, List[Declaration]] = {}
        self._strict = False
        self._current = Declarations(logic.brief)
        self.in_use = False
        self._is_external_event = is_external_event
        logic.define(DECLARE_EVENT.name, 1, self._declare)

    def current(self) -> Declarations:
        """Return a copy of the present declarations; additions to it have no effect on others."""
        return Declarations(
            self._logic.brief,
            self._read_clauses(),
            self._flags.get(UNDECLARED.name) is STRICTLY,
            self._needs_no_declaration,
        )

    def _read_clauses(self) -> Iterable[Declaration]:
        predicate = self._logic.database.predicates.get(_DECLARED)
        # The new dictionary keeps only clauses that still exist.
        previous, self._read = self._read, {}
        for clause in () if predicate is None else predicate.active_clauses():
            declarations = previous.get(clause)
            if declarations is None:
                declarations = _read(clause)
            self._read[clause] = declarations
            yield from declarations

    def _needs_no_declaration(self, key: Functor) -> bool:
        return key in _ALWAYS_DECLARED or type_name(key.name) is not None or self._is_external_event(key)

    def _declare(self, machine: Machine, declared: Term) -> bool:
        declarations = self.current()
        goal = (DECLARE_EVENT, deref(declared))
        try:
            for declaration, _ in parse_declarations(goal, no_place):
                self.in_use = True
                if declarations.add(declaration):
                    self._logic.add_clause((_DECLARED, declaration.term))
        except (RuleError, UsageError) as error:
            raise domain_error("event_declaration", declared, error.message) from None
        return True

    def clear(self) -> None:
        """Remove all declarations."""
        predicate = self._logic.database.predicates.get(_DECLARED)
        if predicate is not None:
            predicate.clear()

    def refusal(self, term: Term) -> str:
        """Return the reason why an event does not match its declaration, or "" if it matches."""
        predicate = self._logic.database.predicates.get(_DECLARED)
        clauses, dead = (
            (_NO_CLAUSES, 0) if predicate is None else (predicate.clauses, predicate.retracted_count)
        )
        strict = self._flags.get(UNDECLARED.name) is STRICTLY
        # The declarations are parsed again if the clauses have changed. A list of clauses only grows, or is replaced
        # by another list, so its identity and length, the number of dead clauses and the flag identify its contents.
        clause_count = len(clauses)
        if (
            clauses is not self._clauses
            or clause_count != self._clause_count
            or dead != self._dead_count
            or strict != self._strict
        ):
            self._clauses, self._clause_count, self._dead_count, self._strict = (
                clauses,
                clause_count,
                dead,
                strict,
            )
            self._current = self.current()
        return self._current.refusal(term)

    def require(self, pattern: Term) -> None:
        """Check a pattern or event in a goal.

        Raises:
            PrologError: if it does not match its declaration.
        """
        reason = self.refusal(pattern) if self.in_use else ""
        if reason:
            raise domain_error("declared_event", pattern, reason)


def _read(clause: Clause) -> List[Declaration]:
    assert isinstance(clause.head, tuple)
    try:
        return [declaration for declaration, _ in parse_declarations(clause.head, no_place)]
    # Asserted by the program under the hidden name, and not a declaration.
    except RuleError:
        return []
