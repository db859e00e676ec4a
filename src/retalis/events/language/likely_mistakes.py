"""Warnings about terms in rules that are valid events but were probably intended as something else.

Every term that is not an operator is an event pattern. A comma between two patterns, a comparison without ``where``
or a misspelt operator therefore makes a rule that compiles and never fires. This module recognises such terms by
functor (`_WARNINGS`), by number of arguments and by similarity of names.

`gap_doubt` warns about ``cnot`` after a sequence of three or more parts, which covers only its last gap, and
constructs the rule that covers all gaps.
"""

from difflib import SequenceMatcher, get_close_matches
from typing import Any, Callable, Dict, Iterable, List, Mapping, Optional, Tuple

from ...foundation.errors import beginning
from ...prolog.syntax.term_writer import write_term
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import CONS, Atom, CompoundTerm, Term, Var, deref, functor
from .event_operators import (
    ARROWS,
    EVENT_OPERATOR,
    FORMS,
    FUNCTIONAL_FORMS,
    NO_EVENTS,
    RUNS,
    SPELLINGS,
    OperatorKind,
    names_of_kind,
)

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
_AFTER_WHERE = "a condition is written after where"
_CONDITION = f"this is an event; {_AFTER_WHERE}"
_ALARM = "an alarm is a head; the event that follows it is its first argument"
_ABSENCES = " or ".join(names_of_kind(OperatorKind.ABSENCE))
_ABSENCE = f"the absence of an event is written with {_ABSENCES}; this is an event"

_WARNINGS: Dict[Any, str] = {
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
    **{
        functor(name, 0): f"{name} is an event here; {_AFTER_WHERE}"
        for name in ("true", "fail", "false", "!")
    },
}
_ARITIES = {
    **NO_EVENTS,
    "prolog": 1,
    "exceptionAlarm": 2,
    "exceptionAlarmAbsoluteDatime": 2,
}
"""Numbers of arguments of reserved names that denote no event; with another number they are ordinary events."""

_SPECIAL = {
    "synchronized": (3, "synchronized(Event, Query, Memories)"),
    "syncronized": (3, "synchronized(Event, Query, Memories)"),
    "exceptionalarm": (2, "exceptionAlarm(Event, Seconds)"),
    "exceptionalarmabsolutedatime": (2, "exceptionAlarmAbsoluteDatime(Event, Datime)"),
}
_SPECIAL_NAMES = frozenset(("synchronized", "syncronized", "exceptionAlarm", "exceptionAlarmAbsoluteDatime"))
_WITH_OPTIONS = frozenset(("synchronized", "syncronized"))
"""Heads that can have options after their other arguments."""

_MIN_SIMILARITY = 0.9
_ORDINARY = "this is an ordinary event"

_SINGLE_HEAD = "the head of a rule is one event"
_HEAD_ERRORS = {
    functor(",", 2): f"{_SINGLE_HEAD}; write one rule for each",
    functor(";", 2): f"{_SINGLE_HEAD}, not one of two",
    **dict.fromkeys(ARROWS, f"{_SINGLE_HEAD}, not a rule; rules are separated by full stops"),
}


def event_warning(term: Term) -> Optional[str]:
    """Return the warning for an event pattern that was probably intended as something else, or None."""
    if term.__class__ is Atom:
        return _WARNINGS.get(term.functor)
    if term.__class__ is not tuple:
        return None
    warning = _WARNINGS.get(term[0])
    if warning is not None:
        return warning
    # ``[a(X), b(X)]`` is a list of events, not a disjunction or conjunction of them.
    if term[0] is CONS:
        items = list_items(term)
        if items is not None and all(deref(item).__class__ in (Atom, tuple) for item in items):
            return "a list of patterns is a single event; join them with and, or, or seq"
    return wrong_arity(term) or _misspelt(term)


def _misspelt(term: Any) -> Optional[str]:
    """Return a warning if the name of an event resembles an operator with the same number of arguments, or None."""
    event_name = term[0].name
    for name, count, form in FUNCTIONAL_FORMS:
        is_similar = (
            not event_name.startswith(name)
            and SequenceMatcher(None, event_name, name).ratio() >= _MIN_SIMILARITY
        )
        if is_similar and len(term) - 1 == count:
            return f"{_ORDINARY}; did you mean {form}?"
    return None


def wrong_arity(term: Any) -> Optional[str]:
    """Return the warning for a term with a special name but another number of arguments, or None."""
    name, count = term[0].name, len(term) - 1
    takes = _ARITIES.get(name)
    if takes is None and name in _SPECIAL_NAMES:
        takes = _SPECIAL[name][0]
    if takes is None or takes == count or (count == takes + 1 and name in _WITH_OPTIONS):
        return None
    form = FORMS.get(name, f"takes {takes} argument{'s' * (takes != 1)}")
    return f"{_ORDINARY}; {name} {form}"


def near(word: str, words: Iterable[str]) -> str:
    """Return "; did you mean ...?" with the most similar word, or ""."""
    matches = get_close_matches(word, list(words), 1)
    return f"; did you mean {matches[0]}?" if matches else ""


def bracket_advice(name: str, number: Any) -> str:
    """Return advice on brackets if the number of an operator was parsed with the next operator, else ""."""
    if number.__class__ is not tuple or len(number) != 3 or number[0] not in SPELLINGS:
        return ""
    first = deref(number[1])
    if first.__class__ not in (int, float):
        return ""
    operator = number[0].name
    return f": {first} {operator} ... is read as one; write (PATTERN {name} {first}) {operator} ..."


def head_error(head: Any, operator: Optional[str]) -> Optional[str]:
    """Return the reason why a compound term, which may be a pattern operator, cannot be a rule head, or None."""
    if operator == "do":
        return "a head has one do: Head do (Goal, Goal)"
    if operator in NO_EVENTS and head[0].name.isidentifier():
        return f"{_SINGLE_HEAD}; {operator} is a pattern operator"
    return _HEAD_ERRORS.get(head[0])


def head_warning(head: Any, operator: Optional[str]) -> Optional[str]:
    """Return the warning for a compound rule head that was probably intended as something else, or None."""
    if operator is not None:
        return f"no pattern can match this event: in patterns {head[0].name} is an operator"
    if len(head) == 3 and head[0].name in _COMPARISONS:
        return _CONDITION
    return wrong_arity(head) if head[0].name in _SPECIAL_NAMES else _similar_special_head(head)


def _similar_special_head(head: Any) -> Optional[str]:
    """Return a warning if the name of a head resembles that of a special head, or None."""
    folded_name = head[0].name.lower().replace("_", "")
    for special_name, (arity, form) in _SPECIAL.items():
        if arity != len(head) - 1 or folded_name[:1] != special_name[0]:
            continue
        if SequenceMatcher(None, folded_name, special_name).ratio() >= _MIN_SIMILARITY:
            return f"{_ORDINARY}; did you mean {form}?"
    return None


_MAX_SHOWN_PARTS = 6
"""Maximum number of parts for which the pattern that covers all gaps is shown."""
_MAX_SHOWN_CHARACTERS = 60
"""Maximum length of a part, and of an absent pattern, for which that pattern is shown."""


def gap_doubt(term: CompoundTerm, spot: Callable[..., Any], names: Mapping[Var, str]) -> Optional[str]:
    """Return a warning for an absence that covers only the last gap of a longer sequence, or None.

    A sequence of three parts is a pair whose left operand is a pair: ``cnot`` covers only the gap between the
    operands of the outer pair. Parentheses around the inner pair, or a ``cnot`` in it, state that this is intended.

    Args:
        term: ``(P seq Q) cnot R``, possibly with conditions around the sequence.
        spot: returns the place of a part of the rule, or None.
        names: names of variables.
    """
    operator = SPELLINGS[term[0]]
    wrapped: List[Tuple[str, Term]] = []
    core: Any = deref(term[1])
    while core.__class__ is tuple and _is_condition(core):
        wrapped.append((SPELLINGS[core[0]], core[2]))
        core = deref(core[1])
    # Parentheses leave no trace in the term, only in the places of its parts; a rule that was built by a goal has
    # none, so it gets no warning.
    if core.__class__ is not tuple or spot(core) is None:
        # A rule that was built as a term has no places at all.
        return None
    parts = _repetitions(core) or _parts_without_parentheses(core, spot)
    if len(parts) < 3:
        return None
    texts = [_text(part, names) for part in parts[:_MAX_SHOWN_PARTS]]
    absent = _text(term[2], names)
    last = _text(parts[-1], names)
    gap = f"the gap before the last part of the sequence, {beginning(last)}"
    message = f"{operator} covers only {gap}: {beginning(absent)} in an earlier gap does not prevent a match"
    is_long = any(len(text) > _MAX_SHOWN_CHARACTERS for text in (*texts, last, absent))
    # If the absent pattern uses variables of later parts, it cannot be checked in the first gap: no rule covers all
    # gaps.
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
    """Return the parts of ``Q ntimes N``, or an empty list for another pattern."""
    times = deref(core[2]) if _operator_of(core) == "ntimes" else None
    return [deref(core[1])] * times if times.__class__ is int else []


def _parts_without_parentheses(core: CompoundTerm, spot: Callable[..., Any]) -> List[Term]:
    """Return the parts of a sequence without parentheses."""
    parts: List[Term] = []
    node: Any = core
    while _operator_of(node) == "seq" and not _is_goal_or_run(deref(node[2])):
        parts.append(deref(node[2]))
        # The place of a term is that of its first token. An inner sequence in parentheses begins one character after
        # its outer one.
        operand: Any = deref(node[1])
        if (
            _operator_of(operand) != "seq"
            or spot(operand, 1) != spot(node, 1)
            or _is_goal_or_run(deref(operand[2]))
        ):
            parts.append(operand)
            break
        node = operand
    return parts[::-1]


def _is_goal_or_run(term: Any) -> bool:
    """Return whether the right operand of a sequence has no gap before it: a goal, or repetitions."""
    return term.__class__ is tuple and (term[0] in RUNS or term[0].name in ("prolog", "query", "db"))


def _depends_on_later_parts(absent: Term, parts: List[Term]) -> bool:
    """Return whether an absent pattern has variables that are bound after the first gap."""
    early = {*variables(parts[0]), *variables(parts[1])}
    late = {var for part in parts[2:] for var in variables(part)} - early
    return not late.isdisjoint(variables(absent))


def _last_gap(core: CompoundTerm, parts: List[Term], names: Mapping[Var, str]) -> str:
    """Return the text of the sequence with parentheses before its last gap."""
    last = _text(parts[-1], names)
    if _operator_of(core) == "ntimes":
        return f"(({last} ntimes {len(parts) - 1}) seq {last})"
    if len(parts) > _MAX_SHOWN_PARTS:
        return f"((...) seq {last})"
    return f"(({' seq '.join(_text(part, names) for part in parts[:-1])}) seq {last})"


def _text(term: Term, names: Mapping[Var, str]) -> str:
    """Return the text of a pattern as a part of another one."""
    # Variables that occur once have no name; they are shown as ``_``.
    once = {var: "_" for var in variables(term) if var not in names}
    text = write_term(term, None, quoted=True, numbervars=True, variable_names={**once, **names})
    return f"({text})" if _operator_of(deref(term)) is not None else text
