"""Bodies that are interpreted, and in which so much time is spent that they are compiled while they run.

What is called seldom is not compiled; but a body that is run once may go over its goals a million times by
backtracking. The machine shows what it is about to interpret once in a slice of steps, see `Machine.meet`: what is
met again is compiled, with its variables as arguments, and from then on run that way when it is gone on with.
"""

from typing import Any, Dict, List, Optional, Set, Tuple

from ..compiler import ARROW, BAR, NOT, SEMICOLON, SOFT_ARROW, ClauseParts, Generator
from ..machine import Code, Frame, PrologError, Step
from ..terms import COMMA, Lazy, Term, Var, functor
from .database import Database

_MOST_PARTS = 400
"""Larger bodies are not compiled; what they have are most likely terms that were passed to them."""

_MOST_BODIES = 16
STRUCTURES = {COMMA, SEMICOLON, BAR, ARROW, SOFT_ARROW, NOT}


class HotBodies:
    """The bodies that were met and those that are compiled, by the identity of their terms.

    Attributes:
        compiled: what runs a body, its variables, and the body, whose identity it keeps from being used again.
    """

    def __init__(self, database: Database):
        self._database = database
        self.compiled: Dict[int, Tuple[Step, Tuple[Var, ...], Term]] = {}
        self._met: Dict[int, Term] = {}
        self._refused: Set[int] = set()

    def __len__(self) -> int:
        """Return how many bodies are held."""
        return len(self._met) + len(self.compiled)

    def clear(self) -> None:
        """Forget all: the bodies are over, or what they call has been redefined."""
        self.compiled.clear()
        self._met.clear()
        self._refused.clear()

    def meet(self, body: Term) -> None:
        """Note that a body is about to be interpreted; compile it where that has been noted before."""
        if body.__class__ is not tuple or self._database.interprets:
            return
        if body[0] not in STRUCTURES and not self._database.is_inline(body[0]):
            return
        if self._met.get(id(body)) is not body:
            if len(self._met) >= _MOST_BODIES:
                self._forget(next(iter(self._met)))
            self._met[id(body)] = body
        elif id(body) not in self.compiled and id(body) not in self._refused:
            made = None if _calls_what_is_bound(body) else self._compile(body)
            if made is None:
                self._refused.add(id(body))
            else:
                self.compiled[id(body)] = made

    def _forget(self, oldest: int) -> None:
        del self._met[oldest]
        self.compiled.pop(oldest, None)
        self._refused.discard(oldest)

    def _compile(self, body: Term) -> Optional[Tuple[Step, Tuple[Var, ...], Term]]:
        names: Dict[Var, Term] = {}
        try:
            source = _Copied(names).term(body)
            if source is None:
                return None
            key = functor("$body", len(names))
            rule = ClauseParts(tuple(names.values()), source)
            step = Generator(self._database, key, [rule], Code("body", _unused)).single(0)
        except (PrologError, RecursionError):  # where the goal with the error is reached it is thrown
            return None
        return step, tuple(names), body


def _unused(frame: Frame) -> Optional[Frame]:
    raise AssertionError("a body does not call itself")


def _calls_what_is_bound(body: Term) -> bool:
    """Tell whether a variable that is bound is one of the goals: a cut that it stands for is that of the body."""
    left = [body]
    while left:
        goal = left.pop()
        if goal.__class__ is Var and goal.ref is not None:
            return True
        if goal.__class__ is tuple and goal[0] in STRUCTURES:
            left += goal[1:]
    return False


class _Copied:
    """Copies a body as it was written: variables that are bound now may be bound to something else next time."""

    def __init__(self, names: Dict[Var, Term]):
        self._names = names
        self._left = _MOST_PARTS

    def term(self, term: Any) -> Optional[Term]:
        """Return the copy; None where the body is too large, or has a term that is not made yet."""
        if term.__class__ is Var:
            return self._names.setdefault(term, Var())
        if term.__class__ is Lazy:
            return None
        if term.__class__ is not tuple:
            return term  # type: ignore[no-any-return]
        parts: List[Any] = [term[0]]
        self._left -= len(term)
        if self._left < 0:
            return None
        for part in term[1:]:
            copied = self.term(part)
            if copied is None:
                return None
            parts.append(copied)
        return tuple(parts)
