"""The events that a program has declared: kept as clauses, so that they come and go with the program's others."""

from typing import Any, Callable, Dict, Iterable, List

from ...foundation.errors import RuleError, UsageError
from ...messages.type_definition import type_name
from ...prolog.database.clause_index import Clause
from ...prolog.machine.errors import domain_error
from ...prolog.machine.machine import Machine
from ...prolog.syntax.operators import DECLARE_EVENT
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.types import Functor, Term, deref, functor
from ..language.event_declarations import STRICTLY, UNDECLARED, Declaration, Declarations, declared_in
from ..program.event_file_checker import nowhere

_DECLARED = functor("$declared_event", 1)
_NEED_NONE = frozenset(functor(name, arity) for name, arity in (("null", 0), ("null_event", 0)))
_NONE: List[Clause] = []


class EventTypes:
    """The declarations of a program.

    Args:
        rules: of the program, whose flag says whether every event is to be declared.

    Attributes:
        in_use: whether anything has ever been declared: where not, no event is looked at.
        others: tells of the functor of an event whether it needs no declaration, as those that the package makes
            by itself and messages.
    """

    def __init__(self, rules: Any, is_external_event: Callable[[Functor], bool]):
        logic: PrologSystem = rules.logic
        self._logic = logic
        self._flags = rules.flags
        self._clauses: List[Clause] = _NONE
        self._number = self._dead = 0
        self._read: Dict[Clause, List[Declaration]] = {}
        self._strict = False
        self._known = Declarations(logic.brief)
        self.in_use = False
        self._is_external_event = is_external_event
        logic.define(DECLARE_EVENT.name, 1, self._declare)

    def now(self) -> Declarations:
        """Return the declarations that hold, to which others may be added without anybody seeing it."""
        return Declarations(
            self._logic.brief,
            self._found(),
            self._flags.get(UNDECLARED.name) is STRICTLY,
            self._needs_none,
        )

    def _found(self) -> Iterable[Declaration]:
        predicate = self._logic.database.predicates.get(_DECLARED)
        before, self._read = self._read, {}  # what has gone since is not kept
        for clause in () if predicate is None else predicate.live():
            known = before.get(clause)
            if known is None:
                known = _read(clause)
            self._read[clause] = known
            yield from known

    def _needs_none(self, key: Functor) -> bool:
        return key in _NEED_NONE or type_name(key.name) is not None or self._is_external_event(key)

    def _declare(self, machine: Machine, declared: Term) -> bool:
        known = self.now()
        goal = (DECLARE_EVENT, deref(declared))
        try:
            for one, _ in declared_in(goal, nowhere):
                self.in_use = True
                if known.add(one):
                    self._logic.add_clause((_DECLARED, one.term))
        except (RuleError, UsageError) as error:
            raise domain_error("event_declaration", declared, error.message) from None
        return True

    def clear(self) -> None:
        """Forget all declarations."""
        predicate = self._logic.database.predicates.get(_DECLARED)
        if predicate is not None:
            predicate.clear()

    def refusal(self, term: Term) -> str:
        """Return why an event that has come does not fit its declaration, "" where it does."""
        predicate = self._logic.database.predicates.get(_DECLARED)
        clauses, dead = (_NONE, 0) if predicate is None else (predicate.clauses, predicate.dead)
        strict = self._flags.get(UNDECLARED.name) is STRICTLY
        number = len(
            clauses
        )  # a list of clauses is only ever added to; else there is another one in its place
        if (
            clauses is not self._clauses
            or number != self._number
            or dead != self._dead
            or strict != self._strict
        ):
            self._clauses, self._number, self._dead, self._strict = clauses, number, dead, strict
            self._known = self.now()
        return self._known.refusal(term)

    def require(self, pattern: Term) -> None:
        """Look at a pattern or event of a goal.

        Raises:
            PrologError: where it does not fit its declaration.
        """
        wrong = self.refusal(pattern) if self.in_use else ""
        if wrong:
            raise domain_error("declared_event", pattern, wrong)


def _read(clause: Clause) -> List[Declaration]:
    assert isinstance(clause.head, tuple)
    try:
        return [one for one, _ in declared_in(clause.head, nowhere)]
    except RuleError:  # asserted by the program, and no declaration
        return []
