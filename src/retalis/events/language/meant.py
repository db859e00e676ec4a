"""What stands in rules that was hardly meant: terms that are events like others, and were to be something else."""

from difflib import SequenceMatcher, get_close_matches
from typing import Any, Dict, Iterable, Optional

from ...prolog.syntax import OperatorKind
from ...prolog.terms import CONS, Atom, Term, deref, functor, list_items
from .operators import ARROWS, FORMS, NO_EVENTS, SPELLINGS, WRITTEN, names_of_kind

_COMPARISONS = [
    "=",
    "\\=",
    "==",
    "\\==",
    "is",
    "=..",
    "<",
    ">",
    "=<",
    ">=",
    "=:=",
    "=\\=",
    "@<",
    "@>",
    "@=<",
    "@>=",
]
_BEHIND = "a condition is written after where"
_CONDITION = f"this is an event; {_BEHIND}"
_ALARM = "an alarm is a head; the event that follows it is its first argument"
_ABSENCES = " or ".join(names_of_kind(OperatorKind.ABSENCE))
_ABSENCE = f"the absence of an event is written with {_ABSENCES}; this is an event"

_MEANT: Dict[Any, str] = {
    functor(
        ",", 2
    ): "a comma between patterns makes them a single event; use and or seq (for a condition, where)",
    functor(";", 2): "a semicolon between patterns makes them a single event; use or",
    functor("=>", 2): "=> is no comparison, and makes all of this a single event; at least is >=",
    functor("|", 2): "a bar between patterns makes them a single event; use or",
    **{
        functor(name, 2): f"{name} between patterns makes them a single event; use and or seq"
        for name in "+-*/"
    },
    functor("->", 2): "an arrow between patterns makes them a single event; use seq",
    functor("\\+", 1): _ABSENCE,
    functor("not", 1): _ABSENCE,
    functor("exceptionAlarm", 2): _ALARM,
    functor("exceptionAlarmAbsoluteDatime", 2): _ALARM,
    **{functor(name, 2): _CONDITION for name in _COMPARISONS},
    **{functor(name, 0): f"{name} is an event here; {_BEHIND}" for name in ("true", "fail", "false", "!")},
}
_ARITIES = {
    **NO_EVENTS,
    "prolog": 1,
    "exceptionAlarm": 2,
    "exceptionAlarmAbsoluteDatime": 2,
}
"""How many arguments what is not an event takes; with others it is one. Names that events may have are not here."""

_SPECIAL = {
    "synchronized": (3, "synchronized(Event, Query, Memories)"),
    "syncronized": (3, "synchronized(Event, Query, Memories)"),
    "exceptionalarm": (2, "exceptionAlarm(Event, Seconds)"),
    "exceptionalarmabsolutedatime": (2, "exceptionAlarmAbsoluteDatime(Event, Datime)"),
}
_SPECIAL_NAMES = frozenset(("synchronized", "syncronized", "exceptionAlarm", "exceptionAlarmAbsoluteDatime"))
_WITH_OPTIONS = frozenset(("synchronized", "syncronized"))
"""What takes options after its other arguments."""

_ALIKE = 0.9
_ORDINARY = "this is an ordinary event"

_ONE = "the head of a rule is one event"
_NO_HEADS = {
    functor(",", 2): f"{_ONE}; write one rule for each",
    functor(";", 2): f"{_ONE}, not one of two",
    **dict.fromkeys(ARROWS, f"{_ONE}, not a rule; rules are separated by full stops"),
}


def doubt(term: Term) -> Optional[str]:
    """Return why an event of a pattern was probably meant as something else, or None."""
    if term.__class__ is Atom:
        return _MEANT.get(term.functor)
    if term.__class__ is not tuple:
        return None
    known = _MEANT.get(term[0])
    if known is not None:
        return known
    if term[0] is CONS:
        items = list_items(term)
        if items is not None and all(deref(item).__class__ in (Atom, tuple) for item in items):
            return "a list of patterns is a single event; join them with and, or, or seq"
    return wrong_arity(term) or _misspelt(term)


def _misspelt(term: Any) -> Optional[str]:
    """Return what was probably meant by an event of nearly the name of what is written with arguments, or None."""
    said = term[0].name
    for name, count, form in WRITTEN:
        alike = not said.startswith(name) and SequenceMatcher(None, said, name).ratio() >= _ALIKE
        if alike and len(term) - 1 == count:
            return f"{_ORDINARY}; did you mean {form}?"
    return None


def wrong_arity(term: Any) -> Optional[str]:
    """Return that a term, by its number of arguments, is not what its name is that of, or None."""
    name, count = term[0].name, len(term) - 1
    takes = _ARITIES.get(name)
    if takes is None and name in _SPECIAL_NAMES:
        takes = _SPECIAL[name][0]
    if takes is None or takes == count or (count == takes + 1 and name in _WITH_OPTIONS):
        return None
    form = FORMS.get(name, f"takes {takes} argument{'s' * (takes != 1)}")
    return f"{_ORDINARY}; {name} {form}"


def near(said: str, words: Iterable[str]) -> str:
    """Return the question whether another word was meant; "" where none is like it."""
    found = get_close_matches(said, list(words), 1)
    return f"; did you mean {found[0]}?" if found else ""


def bracketed(name: str, number: Any) -> str:
    """Return how an operator is written whose number has taken what follows it, "" where it has not."""
    if number.__class__ is not tuple or len(number) != 3 or number[0] not in SPELLINGS:
        return ""
    first = deref(number[1])
    if first.__class__ not in (int, float):
        return ""
    other = number[0].name
    return f": {first} {other} ... is read as one; write (PATTERN {name} {first}) {other} ..."


def head_error(head: Any, operator: Optional[str]) -> Optional[str]:
    """Return why a compound term, or what is that operator of patterns, is the head of no rule; else None."""
    if operator == "do":
        return "a head has one do: Head do (Goal, Goal)"
    if operator in NO_EVENTS and head[0].name.isidentifier():
        return f"{_ONE}; {operator} is a pattern operator"
    return _NO_HEADS.get(head[0])


def head_doubt(head: Any, operator: Optional[str]) -> Optional[str]:
    """Return why a compound head, or what is that operator of patterns, was probably meant otherwise, or None."""
    if operator is not None:
        return f"no pattern can match this event: in patterns {head[0].name} is an operator"
    if len(head) == 3 and head[0].name in _COMPARISONS:
        return _CONDITION
    return wrong_arity(head) if head[0].name in _SPECIAL_NAMES else _alike(head)


def _alike(head: Any) -> Optional[str]:
    """Return what a head of nearly the same name does, or None."""
    plain = head[0].name.lower().replace("_", "")
    for other, (arity, form) in _SPECIAL.items():
        if arity != len(head) - 1 or plain[:1] != other[0]:
            continue
        if SequenceMatcher(None, plain, other).ratio() >= _ALIKE:
            return f"{_ORDINARY}; did you mean {form}?"
    return None
