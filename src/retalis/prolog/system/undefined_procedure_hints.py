"""Calls of undefined procedures: the existence error, with possible callers and similar names as hints.

The search for hints visits all clauses and names of a program, so it takes milliseconds. A rule may call an undefined
procedure at each event: hints are stored, and the number of searches is bounded by the number of calls.
"""

from difflib import get_close_matches
from typing import TYPE_CHECKING, Callable, Dict, List, Optional, Tuple

from ...foundation.bounded_caches import Cache
from ...foundation.callbacks import CallbackList
from ..database.clause_index import Clause
from ..database.predicate import Predicate
from ..machine.errors import CONTEXT, existence_error, indicator
from ..terms.term_traversal import copy
from ..terms.types import FALSE, Atom, CompoundTerm, Frame, Functor, Trail, atom, deref
from ..terms.unification import undo, unify

if TYPE_CHECKING:
    from .predicate_resolution import PredicateTable

_MAX_COMPARED_CHARACTERS = 200
"""Characters of a name that are compared with other names; the comparison is quadratic."""

_FREE_SEARCHES = 100
"""Number of searches for hints that are always made."""

_CALLS_PER_SEARCH = 1000
"""Number of calls of undefined procedures after which one more search is made."""


class UndefinedProcedures:
    """Handler of calls of undefined procedures.

    Args:
        logic: contains the predicates and the flag ``unknown``.
        warn: called with the text of a warning.

    Attributes:
        other_uses: functions that return what a name without a predicate stands for instead, and how to ask for
            that; an empty text if it stands for nothing.
    """

    def __init__(self, logic: "PredicateTable", warn: Callable[[str], None]):
        self._logic = logic
        self._warn = warn
        self.other_uses: CallbackList[Callable[[Functor], str]] = CallbackList()
        self._call_count = self._search_count = 0
        self._hints: Cache[Tuple[Functor, Optional[Functor], int], str] = Cache(1000, 1 << 20)

    def handle_call(self, predicate: Predicate, frame: Frame) -> Optional[Frame]:
        """Handle a call of an undefined procedure as the flag ``unknown`` says.

        Returns:
            None, which fails, if the flag is ``fail`` or ``warning``; the first such call logs a warning.

        Raises:
            PrologError: an existence error with hints, if the flag is ``error``.
        """
        logic, key = self._logic, predicate.functor
        flag = deref(logic.flags["unknown"])
        if flag is atom("fail") or flag is FALSE:
            return None
        if flag is atom("warning"):
            if not predicate.has_warned_undefined:
                predicate.has_warned_undefined = True
                self._warn(f"Unknown procedure: {key}")
            return None
        hints = self._hints_of(predicate, frame)
        shown_indicator = logic.database.modules.module_indicator(key) or indicator(key)
        context = (CONTEXT, shown_indicator, atom(hints)) if hints else shown_indicator
        raise existence_error("procedure", shown_indicator, context)

    def _hints_of(self, predicate: Predicate, frame: Frame) -> str:
        """Return the stored hints for a call, or search for them; an empty text if too many searches were made."""
        database = self._logic.database
        self._call_count += 1
        # With the size of the table, definitions that are added later are found.
        key = (predicate.functor, getattr(frame[-1][0], "functor", None), len(database.predicates))
        stored = self._hints.get(key)
        if stored is not None:
            return stored
        if self._search_count >= _FREE_SEARCHES + self._call_count // _CALLS_PER_SEARCH:
            return ""
        self._search_count += 1
        notes = []
        callers = _possible_callers(self._logic, predicate, frame)
        if callers:
            notes.append(f"called from {', '.join(callers)}")
        plain_functor = database.modules.plain_functor(predicate.functor)
        suggestion = self.suggest(plain_functor or predicate.functor)
        if suggestion:
            notes.append(suggestion)
        hints = "; ".join(notes)
        return self._hints.store(key, hints, 2 * len(hints))

    def suggest(self, key: Functor) -> str:
        """Return what to call instead of an undefined procedure; an empty text if that is unknown."""
        for describe_other_use in self.other_uses:
            other_use = describe_other_use(key)
            if other_use:
                return other_use
        similar = find_similar(self._logic, key)
        return f"did you mean {' or '.join(similar)}?" if similar else ""


def _possible_callers(logic: "PredicateTable", predicate: Predicate, frame: Frame) -> List[str]:
    """Return descriptions of the clauses that may have made a call, at most three.

    A last call leaves no frame of its clause. The candidates are therefore the clauses with a goal that the call is
    an instance of. If the frame that the call returns to belongs to the predicate of some of them, only those are
    returned.
    """
    key = predicate.functor
    call = (key, *frame[1:-1])
    return_functor = getattr(frame[-1][0], "functor", None)
    clauses = [
        clause
        for candidate in list(logic.database.predicates.values())
        if not candidate.is_library_predicate
        for clause in candidate.active_clauses()
        if not clause.is_fact
    ]
    matching = [clause for clause in clauses if _may_call(clause, call, len(call))]
    # A closure, to which maplist/3 and others add arguments, has fewer of them in the clause.
    if not matching:
        matching = [clause for clause in clauses if _may_call(clause, call, 1)]
    callers_returned_to = [clause for clause in matching if clause.predicate.functor is return_functor]
    return [_describe_clause(clause) for clause in (callers_returned_to or matching)[:3]]


def _describe_clause(clause: Clause) -> str:
    """Return the functor of a clause, and the first line of its place if that is known."""
    place_text = f" ({clause.place})" if clause.place is not None else ""
    return f"{clause.predicate.functor}{place_text}".split("\n")[0]


def _may_call(clause: Clause, call: CompoundTerm, min_items: int) -> bool:
    """Return whether a clause's body contains a goal that may have made a call.

    Args:
        clause: the clause.
        call: functor and arguments of the call.
        min_items: minimum number of items of a goal; arguments that it lacks may have been added when it was called.
    """
    stack = [clause.body]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is Atom:
            item = (item.functor,)
        if item.__class__ is tuple:
            if (
                item[0].name == call[0].name
                and min_items <= len(item) <= len(call)
                and _may_unify(item, call)
            ):
                return True
            stack.extend(item[1:])
    return False


def _may_unify(goal: CompoundTerm, call: CompoundTerm) -> bool:
    """Return whether a goal, which may lack the last arguments, unifies with a call."""
    trail: Trail = []
    pairs = zip(copy(goal)[1:], call[1:])
    try:
        return all(unify(left, right, trail) for left, right in pairs)
    finally:
        undo(trail, 0)


def find_similar(logic: "PredicateTable", key: Functor) -> List[str]:
    """Return indicators of defined procedures with the same name or a similar one, at most three.

    Indicators of other arities are returned only if none has the arity of the call.
    """
    arities: Dict[str, List[int]] = {}
    for candidate in logic.names():
        if candidate is not key and not candidate.name.startswith("$"):
            arities.setdefault(candidate.name, []).append(candidate.arity)
    compared = key.name[:_MAX_COMPARED_CHARACTERS]
    close_names = [key.name] if key.name in arities else get_close_matches(compared, arities, 3, 0.8)
    for name in close_names:
        if key.arity in arities[name]:
            return [f"{name}/{key.arity}"]
    for name in close_names:
        # A name that differs more, with other arguments, is another predicate: count/1 is not meant as counter/2.
        if name == key.name or get_close_matches(compared, [name], 1, 0.85):
            return [f"{name}/{arity}" for arity in sorted(set(arities[name]))[:3]]
    return []
