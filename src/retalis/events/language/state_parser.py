"""States that are declared: ``state(S, from(F), until(U), Options)``."""

from typing import Any, Dict, Hashable, List, NamedTuple, Optional, Tuple

from ...foundation.errors import UsageError
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.term_traversal import term_key, variables
from ...prolog.terms.timestamps import from_seconds
from ...prolog.terms.types import COMMA, Atom, Functor, Term, Var, deref, functor
from .pattern_operators import SPELLINGS

STATE = frozenset((functor("state", 3), functor("state", 4)))
"""The goals that declare a state."""

HOLDS = frozenset((functor("holds", 1), functor("holds", 2), functor("holds_at", 2)))
"""The goals that ask whether a state holds, their first argument."""

FORM = "state(S, from(Event), until(Event)) or state(S, from(Event), until(Event), Options)"
PAST = 1000
"""Intervals that are over and can be asked for, where a declaration does not say how many."""

OPEN = 10_000
"""States that may be open at once, where a declaration does not say how many."""

_FROM, _UNTIL = functor("from", 1), functor("until", 1)
_LIMITS = {"past": (0, 1_000_000), "open": (1, 1_000_000)}
_OPTIONS = "the options are within(Seconds), past(Number) and open(Number)"


class StateForm(NamedTuple):
    """What a declaration of a state says.

    Attributes:
        term: all of it.
        state: the state; also the event that happens when it is over.
        begins: the event with whose end it begins.
        ends: the event with whose start it ends.
        within: after how many nanoseconds it ends by itself, or None.
        past: how many intervals are kept that are over.
        open: how many may be open at once.
    """

    term: Term
    state: Term
    begins: Term
    ends: Term
    within: Optional[int] = None
    past: int = PAST
    open: int = OPEN

    @property
    def events(self) -> Tuple[Term, Term, Term]:
        """The events that it names."""
        return self.state, self.begins, self.ends

    @property
    def functor(self) -> Functor:
        """The functor of the state."""
        return _key(self.state)

    @property
    def key(self) -> Hashable:
        """Equal for states that are the same but for the names of variables."""
        return term_key(self.state)


def declares_state(term: Term) -> bool:
    """Tell whether a term is a goal that declares a state, and not a program's own ``state(X, Y, Z)``."""
    goal: Any = deref(term)
    if goal.__class__ is not tuple or goal[0] not in STATE:
        return False
    begins = deref(goal[2])
    return begins.__class__ is tuple and begins[0] is _FROM


def state_form(term: Term) -> StateForm:
    """Return what a declaration says.

    Raises:
        UsageError: what was expected.
    """
    goal: Any = deref(term)
    state = _event(goal[1], "a state")
    begins, ends = _of(goal[2], _FROM), _of(goal[3], _UNTIL)
    if _key(state) in (_key(begins), _key(ends)):
        raise UsageError("a state cannot begin or end with events of its own name")
    if not set(variables(state)) <= set(variables(begins)):
        raise UsageError("each variable of the state has to stand in from(...), which gives it its value")
    return StateForm(goal, state, begins, ends, **(_options(goal[4]) if len(goal) == 5 else {}))


def _of(term: Term, kind: Functor) -> Term:
    part: Any = deref(term)
    if part.__class__ is not tuple or part[0] is not kind:
        raise UsageError(f"expected {FORM}")
    return _event(part[1], f"what stands in {kind.name}(...)")


def _event(term: Term, what: str) -> Term:
    event: Term = deref(term)
    if event.__class__ is not tuple and not isinstance(event, Atom):
        raise UsageError(f"{what} is an event: an atom or a compound term")
    key = _key(event)
    if key in SPELLINGS or key is COMMA:
        raise UsageError(f"{what} is a single event, no pattern: a rule may make one of that pattern")
    return event


def _key(event: Term) -> Functor:
    found: Functor = event[0] if event.__class__ is tuple else event.functor  # type: ignore[union-attr]
    return found


def _options(term: Term) -> Dict[str, Any]:
    items: Optional[List[Term]] = list_items(term)
    if items is None:
        raise UsageError(f"expected a list of options; {_OPTIONS}")
    found: Dict[str, Any] = {}
    for item in items:
        option: Any = deref(item)
        name = option[0].name if option.__class__ is tuple and option[0].arity == 1 else ""
        value: Any = deref(option[1]) if name else None
        if name == "within":
            if value.__class__ not in (int, float) or not 0 < value <= 1e9:
                raise UsageError("within(Seconds) needs a number of seconds above 0")
            found[name] = from_seconds(value)
        elif name in _LIMITS:
            low, high = _LIMITS[name]
            if value.__class__ is not int or not low <= value <= high:
                raise UsageError(f"{name}(Number) needs an integer from {low} to {high}")
            found[name] = value
        else:
            raise UsageError(_OPTIONS)
    return found


def asked_state(term: Term) -> Optional[Functor]:
    """Return the functor of the state that a goal asks for, where it says which."""
    goal: Any = deref(term)
    if goal.__class__ is not tuple or goal[0] not in HOLDS:
        return None
    state: Any = deref(goal[1])
    if state.__class__ is Var or (state.__class__ is not tuple and not isinstance(state, Atom)):
        return None
    return _key(state)
