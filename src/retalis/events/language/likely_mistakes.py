"""What stands in rules that was hardly meant: terms that are events like others, and were to be something else."""

from difflib import SequenceMatcher, get_close_matches
from typing import Any, Callable, Dict, Iterable, List, Mapping, Optional, Tuple

from ...foundation.errors import beginning
from ...prolog.syntax.event_operators import EVENT_OPERATOR, OperatorKind
from ...prolog.syntax.term_writer import write_term
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import CONS, Atom, CompoundTerm, Term, Var, deref, functor
from .pattern_operators import ARROWS, FORMS, NO_EVENTS, RUNS, SPELLINGS, WRITTEN, names_of_kind

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


# ---- gaps of sequences ---------------------------------------------------------------------------------

_MAX_SHOWN_PARTS = 6
"""Parts of a sequence up to which the pattern that covers all of its gaps is written out."""
_MAX_SHOWN_CHARACTERS = 60
"""Characters of a part, and of an absent pattern, up to which that pattern is written out."""


def gap_doubt(term: CompoundTerm, spot: Callable[..., Any], names: Mapping[Var, str]) -> Optional[str]:
    """Return a warning for an absence between the last two parts of a longer sequence, or None.

    A sequence of three parts is a pair whose left side is a pair: ``cnot`` covers only the gap between the sides of
    the outer pair. Parentheses around the inner pair, or a ``cnot`` in it, show that this is known.

    Args:
        term: ``(P seq Q) cnot R``, with conditions around the sequence or without.
        spot: returns the place of a part of the rule, or None where it has none.
        names: of variables.
    """
    operator = SPELLINGS[term[0]]
    wrapped: List[Tuple[str, Term]] = []
    core: Any = deref(term[1])
    while core.__class__ is tuple and _is_condition(core):
        wrapped.append((SPELLINGS[core[0]], core[2]))
        core = deref(core[1])
    if core.__class__ is not tuple or spot(core) is None:
        return None  # a rule without a text has no parentheses either
    parts = _repetitions(core) or _parts_without_parentheses(core, spot)
    if len(parts) < 3:
        return None
    texts = [_text(part, names) for part in parts[:_MAX_SHOWN_PARTS]]
    absent = _text(term[2], names)
    last = _text(parts[-1], names)
    gap = f"the gap before the last part of the sequence, {beginning(last)}"
    message = f"{operator} covers only {gap}: {beginning(absent)} in an earlier gap does not prevent a match"
    is_long = any(len(text) > _MAX_SHOWN_CHARACTERS for text in (*texts, last, absent))
    if is_long or _depends_on_later_parts(deref(term[2]), parts):
        return f"{message}; write a {operator} for each gap that it must not lie in"
    covered = f"({texts[0]} seq {texts[1]}) {operator} {absent}"
    for text in texts[2:]:
        covered = f"(({covered}) seq {text}) {operator} {absent}"
    if wrapped and len(parts) <= _MAX_SHOWN_PARTS:
        cut = covered[: -len(f" {operator} {absent}")]
        for name, argument in reversed(wrapped):
            cut = f"({cut} {name} {_text(argument, names)})"
        covered = f"{cut} {operator} {absent}"
    if len(parts) > _MAX_SHOWN_PARTS:
        covered += f" and so on up to the last of {len(parts)} parts"
    shown = f"{message}; for none in any gap write {covered}"
    return (
        f"{shown}; if only the last gap is meant, write {_last_gap(core, parts, names)} {operator} {absent}"
    )


def _is_condition(term: CompoundTerm) -> bool:
    kind = EVENT_OPERATOR[SPELLINGS[term[0]]].kind if term[0] in SPELLINGS else None
    return kind in (OperatorKind.CONDITION, OperatorKind.LIMIT)


def _operator_of(term: Any) -> Optional[str]:
    return SPELLINGS.get(term[0]) if term.__class__ is tuple else None


def _repetitions(core: CompoundTerm) -> List[Term]:
    """Return the parts of ``Q ntimes N``; none for another pattern."""
    times = deref(core[2]) if _operator_of(core) == "ntimes" else None
    return [deref(core[1])] * times if times.__class__ is int else []


def _parts_without_parentheses(core: CompoundTerm, spot: Callable[..., Any]) -> List[Term]:
    """Return the parts of a sequence that is written without parentheses: a place is that of the first one."""
    parts: List[Term] = []
    node: Any = core
    while _operator_of(node) == "seq" and not _is_goal_or_run(deref(node[2])):
        parts.append(deref(node[2]))
        left: Any = deref(node[1])
        if _operator_of(left) != "seq" or spot(left, 1) != spot(node, 1) or _is_goal_or_run(deref(left[2])):
            parts.append(left)
            break
        node = left
    return parts[::-1]


def _is_goal_or_run(term: Any) -> bool:
    """Return whether the right side of a sequence is not a part with a gap before it: a goal, or repetitions."""
    return term.__class__ is tuple and (term[0] in RUNS or term[0].name in ("prolog", "query", "db"))


def _depends_on_later_parts(absent: Term, parts: List[Term]) -> bool:
    """Return whether variables of an absent pattern get their values after the first gap."""
    early = {*variables(parts[0]), *variables(parts[1])}
    late = {var for part in parts[2:] for var in variables(part)} - early
    return not late.isdisjoint(variables(absent))


def _last_gap(core: CompoundTerm, parts: List[Term], names: Mapping[Var, str]) -> str:
    """Return the sequence with its last gap set apart."""
    last = _text(parts[-1], names)
    if _operator_of(core) == "ntimes":
        return f"(({last} ntimes {len(parts) - 1}) seq {last})"
    if len(parts) > _MAX_SHOWN_PARTS:
        return f"((...) seq {last})"
    return f"(({' seq '.join(_text(part, names) for part in parts[:-1])}) seq {last})"


def _text(term: Term, names: Mapping[Var, str]) -> str:
    """Return a pattern as a part of another one."""
    once = {var: "_" for var in variables(term) if var not in names}
    text = write_term(term, None, quoted=True, numbervars=True, variable_names={**once, **names})
    return f"({text})" if _operator_of(deref(term)) is not None else text
