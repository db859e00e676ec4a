"""Parser of declared states: ``state(S, from(F), until(U), Options)``.

A declared state is a fluent of the event calculus: the event F initiates it, the event U terminates it. When it ends,
S itself occurs as an event with the interval of the state.
"""

from typing import Any, Dict, Hashable, List, NamedTuple, Optional, Tuple

from ...foundation.errors import UsageError
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.term_traversal import term_key, variables
from ...prolog.terms.timestamps import from_seconds
from ...prolog.terms.types import COMMA, Atom, Functor, Term, Var, deref, functor
from .event_operators import OPERATOR_NAMES

STATE = frozenset((functor("state", 3), functor("state", 4)))
"""Goals that declare a state."""

HOLDS = frozenset((functor("holds", 1), functor("holds", 2), functor("holds_at", 2)))
"""Goals that query whether the state in their first argument holds."""

STATE_NOTATION = "state(S, from(Event), until(Event)) or state(S, from(Event), until(Event), Options)"
DEFAULT_MAX_PAST = 1000
"""Default maximum for ended intervals that can be queried."""

DEFAULT_MAX_OPEN = 10_000
"""Default maximum for states that hold at the same time."""

_FROM, _UNTIL = functor("from", 1), functor("until", 1)


class _NumberOption(NamedTuple):
    """Option with a number: the field of `StateForm`, and the limits of its value."""

    field: str
    minimum: int
    maximum: int


_NUMBER_OPTIONS = {
    "past": _NumberOption(field="max_past", minimum=0, maximum=1_000_000),
    "open": _NumberOption(field="max_open", minimum=1, maximum=1_000_000),
}

_OPTION_NOTATIONS = "the options are within(Seconds), past(Number) and open(Number)"


class StateForm(NamedTuple):
    """Declaration of a state.

    Attributes:
        term: the whole declaration.
        state: the state, and also the event that occurs when it ends.
        begin_event: the event whose end starts the state.
        end_event: the event whose start ends the state.
        max_duration: time in ns after which the state ends by itself, or None.
        max_past: maximum number of stored intervals that have ended.
        max_open: maximum number of instances that hold at the same time.
    """

    term: Term
    state: Term
    begin_event: Term
    end_event: Term
    max_duration: Optional[int] = None
    max_past: int = DEFAULT_MAX_PAST
    max_open: int = DEFAULT_MAX_OPEN

    @property
    def events(self) -> Tuple[Term, Term, Term]:
        """The events in the declaration."""
        return self.state, self.begin_event, self.end_event

    @property
    def functor(self) -> Functor:
        """The functor of the state."""
        return _event_functor(self.state)

    @property
    def key(self) -> Hashable:
        """Key that is equal for states that differ only in names of variables."""
        return term_key(self.state)


def declares_state(term: Term) -> bool:
    """Return whether a term is a goal that declares a state, and not a predicate ``state/3`` of the program."""
    goal: Any = deref(term)
    if goal.__class__ is not tuple or goal[0] not in STATE:
        return False
    begin_event = deref(goal[2])
    # ``state/3`` is a likely name in programs, so the form of its second argument decides.
    return begin_event.__class__ is tuple and begin_event[0] is _FROM


def parse_state_declaration(term: Term) -> StateForm:
    """Return the state that a term declares.

    Raises:
        UsageError: if the declaration is malformed.
    """
    goal: Any = deref(term)
    state = _require_event(goal[1], "a state")
    begin_event, end_event = _wrapped_event(goal[2], _FROM), _wrapped_event(goal[3], _UNTIL)
    # The end of a state raises an event of its name, which would start or end the state again without end.
    if _event_functor(state) in (_event_functor(begin_event), _event_functor(end_event)):
        raise UsageError("a state cannot begin or end with events of its own name")
    # Instances of a state are told apart by their bound arguments from the start on.
    if not set(variables(state)) <= set(variables(begin_event)):
        raise UsageError("each variable of the state must occur in from(...), which binds it")
    return StateForm(
        goal, state, begin_event, end_event, **(_parse_options(goal[4]) if len(goal) == 5 else {})
    )


def _wrapped_event(term: Term, wrapper: Functor) -> Term:
    part: Any = deref(term)
    if part.__class__ is not tuple or part[0] is not wrapper:
        raise UsageError(f"expected {STATE_NOTATION}")
    return _require_event(part[1], f"the argument of {wrapper.name}(...)")


def _require_event(term: Term, subject: str) -> Term:
    event: Term = deref(term)
    if event.__class__ is not tuple and not isinstance(event, Atom):
        raise UsageError(f"{subject} is an event: an atom or a compound term")
    key = _event_functor(event)
    # Patterns are compiled for rules only; a declared state listens to single events.
    if key in OPERATOR_NAMES or key is COMMA:
        raise UsageError(
            f"{subject} is a single event, not a pattern: write a rule that raises an event for the pattern"
        )
    return event


def _event_functor(event: Term) -> Functor:
    key: Functor = event[0] if event.__class__ is tuple else event.functor  # type: ignore[union-attr]
    return key


def _parse_options(term: Term) -> Dict[str, Any]:
    """Return the fields of `StateForm` that the options of a declaration set."""
    items: Optional[List[Term]] = list_items(term)
    if items is None:
        raise UsageError(f"expected a list of options; {_OPTION_NOTATIONS}")
    fields: Dict[str, Any] = {}
    for item in items:
        option: Any = deref(item)
        name = option[0].name if option.__class__ is tuple and option[0].arity == 1 else ""
        value: Any = deref(option[1]) if name else None
        if name == "within":
            if value.__class__ not in (int, float) or not 0 < value <= 1e9:
                raise UsageError("within(Seconds) needs a number of seconds above 0")
            fields["max_duration"] = from_seconds(value)
        elif name in _NUMBER_OPTIONS:
            option = _NUMBER_OPTIONS[name]
            if value.__class__ is not int or not option.minimum <= value <= option.maximum:
                raise UsageError(f"{name}(Number) needs an integer from {option.minimum} to {option.maximum}")
            fields[option.field] = value
        else:
            raise UsageError(_OPTION_NOTATIONS)
    return fields


def queried_state(term: Term) -> Optional[Functor]:
    """Return the functor of the state that a goal queries, or None if it is not fixed."""
    goal: Any = deref(term)
    if goal.__class__ is not tuple or goal[0] not in HOLDS:
        return None
    state: Any = deref(goal[1])
    if state.__class__ is Var or (state.__class__ is not tuple and not isinstance(state, Atom)):
        return None
    return _event_functor(state)
