"""Just-in-time compilation of interpreted bodies.

Rarely called bodies are interpreted, but a body that is called once may run its goals a million times by
backtracking. `JustInTimeBodies` finds those by sampling: the machine reports the goal that it is about to interpret
once per slice of steps (`GoalCode.sample`). A body that is reported twice is compiled, with its variables as
arguments, and the compiled code runs from then on.

Bodies are found by the identity of their terms: backtracking runs the same term again, and comparing terms would take
as long as running them. An ``id`` is unique only while its term exists, so each entry holds its term.
"""

from typing import TYPE_CHECKING, Any, Dict, List, NamedTuple, Optional, Set, Tuple

from ..compiler.predicate_code import ClauseParts, PredicateGenerator
from ..machine.errors import PrologError
from ..machine.machine import Code
from ..terms.types import Frame, Lazy, Step, Term, Var, functor
from .goal_terms import BODY_CONSTRUCTS

if TYPE_CHECKING:
    from .predicate_database import Database

_MAX_BODY_PARTS = 400
"""Size limit of bodies that are compiled; larger ones most likely contain data that was passed to them."""

_MAX_BODIES = 16
"""Bodies that are observed at a time; the oldest one is dropped."""


class CompiledBody(NamedTuple):
    """A body that is compiled while it runs.

    Attributes:
        run: the compiled code, a step of a frame with the values of the variables.
        body: the body itself, which keeps its ``id`` in use.
    """

    run: Step
    variables: Tuple[Var, ...]
    body: Term


class JustInTimeBodies:
    """Just-in-time compiler of interpreted bodies, by the identity of their terms.

    Attributes:
        compiled: the compiled bodies by the ``id`` of the body.
    """

    def __init__(self, database: "Database"):
        self._database = database
        self.compiled: Dict[int, CompiledBody] = {}
        self._reported: Dict[int, Term] = {}
        self._refused: Set[int] = set()

    def __len__(self) -> int:
        """Return the number of stored bodies."""
        return len(self._reported) + len(self.compiled)

    def clear(self) -> None:
        """Drop all bodies, at the end of a goal or after a redefinition of a predicate."""
        self.compiled.clear()
        self._reported.clear()
        self._refused.clear()

    def record_interpreted(self, body: Term) -> None:
        """Record that a body is about to be interpreted, and compile it if that was recorded before."""
        if body.__class__ is not tuple or self._database.is_interpreter_only:
            return
        if body[0] not in BODY_CONSTRUCTS and not self._database.is_inline(body[0]):
            return
        # An id may be reused by another term, so the identity is compared as well.
        if self._reported.get(id(body)) is not body:
            if len(self._reported) >= _MAX_BODIES:
                self._drop(next(iter(self._reported)))
            self._reported[id(body)] = body
        elif id(body) not in self.compiled and id(body) not in self._refused:
            entry = None if _has_bound_goal(body) else self._compile(body)
            if entry is None:
                self._refused.add(id(body))
            else:
                self.compiled[id(body)] = entry

    def _drop(self, body_id: int) -> None:
        del self._reported[body_id]
        self.compiled.pop(body_id, None)
        self._refused.discard(body_id)

    def _compile(self, body: Term) -> Optional[CompiledBody]:
        """Return the compiled body; None if it is too large or its compilation raises an error."""
        copies: Dict[Var, Term] = {}
        try:
            source = _BodyCopier(copies).copy(body)
            if source is None:
                return None
            key = functor("$body", len(copies))
            clause = ClauseParts(tuple(copies.values()), source)
            step = PredicateGenerator(
                self._database, key, [clause], Code("body", _never_called)
            ).generate_clause()
        except (PrologError, RecursionError):
            # The interpreter raises the error when it reaches the goal, or never if it does not.
            return None
        return CompiledBody(step, tuple(copies), body)


def _never_called(frame: Frame) -> Optional[Frame]:
    raise AssertionError("a body does not call itself")


def _has_bound_goal(body: Term) -> bool:
    """Return whether a bound variable occurs as a goal of a body.

    A cut in its value cuts the body, which compiled code (``call/1`` of the variable) would not do.
    """
    stack = [body]
    while stack:
        goal = stack.pop()
        if goal.__class__ is Var and goal.ref is not None:
            return True
        if goal.__class__ is tuple and goal[0] in BODY_CONSTRUCTS:
            stack += goal[1:]
    return False


class _BodyCopier:
    """Copier of a body as it was written.

    Bound variables are copied as variables, because they may have other values the next time.
    """

    def __init__(self, names: Dict[Var, Term]):
        self._names = names
        self._parts_left = _MAX_BODY_PARTS

    def copy(self, term: Any) -> Optional[Term]:
        """Return the copy; None if the body is too large or contains a term that has not been decoded."""
        if term.__class__ is Var:
            return self._names.setdefault(term, Var())
        if term.__class__ is Lazy:
            return None
        if term.__class__ is not tuple:
            return term  # type: ignore[no-any-return]
        parts: List[Any] = [term[0]]
        self._parts_left -= len(term)
        if self._parts_left < 0:
            return None
        for part in term[1:]:
            copied = self.copy(part)
            if copied is None:
                return None
            parts.append(copied)
        return tuple(parts)
