"""Heads of rules, checked: what cannot be an event, an alarm or a query that waits is refused."""

from typing import Any, Callable, Optional

from ...foundation import Place, RuleError, UsageError
from ...prolog.terms import NIL, Atom, Term, Var, deref, functor, list_parts
from .alarms import ALARMS, require_alarm
from .calls import calls
from .meant import head_doubt, head_error
from .operators import SPELLINGS
from .reading import Spot

SYNCHRONIZED = frozenset(functor(name, arity) for name in ("syncronized", "synchronized") for arity in (3, 4))
_TIMEOUT = functor("timeout", 1)
_COLON = functor(":", 2)


def check_head(head: Term, spot: Spot, place: Optional[Place], warn: Callable[[RuleError], None]) -> None:
    """Check the head of a rule.

    Args:
        head: the head, without what it does.
        spot: gives the places of its parts.
        place: its own.
        warn: takes what is not an error but probably a mistake.

    Raises:
        RuleError: for what never happens.
    """
    if head.__class__ not in (tuple, Atom, Var):
        raise RuleError("the head of a rule is an event: an atom or a compound term", place)
    if head.__class__ is not tuple:
        return
    operator = SPELLINGS.get(head[0])
    wrong = head_error(head, operator)
    if wrong is not None:
        raise RuleError(wrong, place)
    doubted = head_doubt(head, operator)
    if doubted is not None:
        warn(RuleError(doubted, place))
    if head[0] is _COLON:
        warn(RuleError("this is an event that contains a colon: a rule has one label", place))
    if head[0] in ALARMS:
        try:
            require_alarm(head)
        except UsageError as error:
            raise RuleError(error.message, spot(head, 2)) from None
    if head[0] in ALARMS or head[0] in SYNCHRONIZED:
        event = deref(head[1])
        check_head(event, spot, spot(event) if event.__class__ is tuple else spot(head, 1), warn)
    if head[0] in SYNCHRONIZED:
        _check_query(head, spot)


def _check_query(head: Any, spot: Spot) -> None:
    """Check the query of a synchronized event, and what it waits for."""
    for call in calls(head, 2):
        if call.term.__class__ not in (tuple, Atom, Var):
            raise RuleError(f"{head[0].name} needs a goal", spot(call.parent, call.number))
    items, rest = list_parts(head[3])
    if not (rest is NIL or rest.__class__ is Var) or not all(_may_be_pair(item) for item in items):
        raise RuleError(f"{head[0].name} takes a list of [Memory, Time]", spot(head, 3))
    if len(head) > 4 and not _may_be_options(deref(head[4])):
        raise RuleError(f"{head[0].name} takes [timeout(Seconds)] as its options", spot(head, 4))


def _may_be_pair(term: Term) -> bool:
    items, rest = list_parts(term)
    return len(items) <= 2 if rest.__class__ is Var else rest is NIL and len(items) == 2


def _may_be_options(term: Term) -> bool:
    items, rest = list_parts(term)
    if rest is not NIL or len(items) != 1:
        return rest.__class__ is Var and not items
    option: Any = deref(items[0])
    if option.__class__ is not tuple:
        return option.__class__ is Var
    seconds = deref(option[1])
    return option[0] is _TIMEOUT and (
        seconds.__class__ is Var or (seconds.__class__ in (int, float) and seconds >= 0)
    )
