"""Warnings about terms in rules that are valid events but were probably intended as something else.

Every term that is not an operator is an event pattern. A comma between two patterns, a comparison without ``where``
or a misspelt operator therefore makes a rule that compiles and never fires. This module recognises such terms by
functor (`_EVENT_WARNINGS`), by number of arguments and by similarity of names.

`uncovered_gap_warning` warns about ``cnot`` after a sequence of three or more parts, which covers only its last gap,
and constructs the rule that covers all gaps.
"""

from difflib import SequenceMatcher
from typing import Any, Callable, Dict, List, Mapping, Optional

from ...foundation.displayed_text import shorten
from ...prolog.syntax.term_writer import write_term
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import CONS, Atom, CompoundTerm, Term, Var, deref, functor
from .event_operators import (
    ARROWS,
    EVENT_OPERATORS_BY_NAME,
    FUNCTIONAL_FORMS,
    NOTATIONS,
    OPERATOR_NAMES,
    RESERVED_EVENT_ARITIES,
    RUN_OPERATORS,
    OperatorKind,
    names_of_kind,
)
from .pattern_tree import NegationScope

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
_CONDITION_ADVICE = "a condition is written after where"
_CONDITION_WARNING = f"this is an event; {_CONDITION_ADVICE}"
_ALARM_WARNING = "an alarm is a head; the event that follows it is its first argument"
_ABSENCE_OPERATORS = " or ".join(names_of_kind(OperatorKind.ABSENCE))
_ABSENCE_WARNING = f"the absence of an event is written with {_ABSENCE_OPERATORS}; this is an event"

_EVENT_WARNINGS: Dict[Any, str] = {
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
    functor("\\+", 1): _ABSENCE_WARNING,
    functor("not", 1): _ABSENCE_WARNING,
    functor("exceptionAlarm", 2): _ALARM_WARNING,
    functor("exceptionAlarmAbsoluteDatime", 2): _ALARM_WARNING,
    **{functor(name, 2): _CONDITION_WARNING for name in _COMPARISONS},
    **{
        functor(name, 0): f"{name} is an event here; {_CONDITION_ADVICE}"
        for name in ("true", "fail", "false", "!")
    },
}
_RESERVED_ARITIES = {
    **RESERVED_EVENT_ARITIES,
    "prolog": 1,
    "exceptionAlarm": 2,
    "exceptionAlarmAbsoluteDatime": 2,
}
"""Numbers of arguments of reserved names that denote no event; with another number they are ordinary events."""

_SPECIAL_HEADS = {
    "synchronized": (3, "synchronized(Event, Query, Memories)"),
    "syncronized": (3, "synchronized(Event, Query, Memories)"),
    "exceptionalarm": (2, "exceptionAlarm(Event, Seconds)"),
    "exceptionalarmabsolutedatime": (2, "exceptionAlarmAbsoluteDatime(Event, Datime)"),
}
_SPECIAL_HEAD_NAMES = frozenset(
    ("synchronized", "syncronized", "exceptionAlarm", "exceptionAlarmAbsoluteDatime")
)
_HEADS_WITH_OPTIONS = frozenset(("synchronized", "syncronized"))
"""Heads that can have options after their other arguments."""

_MIN_SIMILARITY = 0.9
_ORDINARY_EVENT = "this is an ordinary event"

_SINGLE_HEAD = "the head of a rule is one event"
_HEAD_ERRORS = {
    functor(",", 2): f"{_SINGLE_HEAD}; write one rule for each",
    functor(";", 2): f"{_SINGLE_HEAD}, not one of two",
    **dict.fromkeys(ARROWS, f"{_SINGLE_HEAD}, not a rule; rules are separated by full stops"),
}


def event_warning(term: Term) -> Optional[str]:
    """Return the warning for an event pattern that was probably intended as something else, or None."""
    if term.__class__ is Atom:
        return _EVENT_WARNINGS.get(term.functor)
    if term.__class__ is not tuple:
        return None
    warning = _EVENT_WARNINGS.get(term[0])
    if warning is not None:
        return warning
    # ``[a(X), b(X)]`` is a list of events, not a disjunction or conjunction of them.
    if term[0] is CONS:
        items = list_items(term)
        if items is not None and all(deref(item).__class__ in (Atom, tuple) for item in items):
            return "a list of patterns is a single event; join them with and, or, or seq"
    return arity_warning(term) or _misspelling_warning(term)


def _misspelling_warning(term: Any) -> Optional[str]:
    """Return a warning if the name of an event resembles an operator with the same number of arguments, or None."""
    event_name = term[0].name
    for name, count, notation in FUNCTIONAL_FORMS:
        is_similar = (
            not event_name.startswith(name)
            and SequenceMatcher(None, event_name, name).ratio() >= _MIN_SIMILARITY
        )
        if is_similar and len(term) - 1 == count:
            return f"{_ORDINARY_EVENT}; did you mean {notation}?"
    return None


def arity_warning(term: Any) -> Optional[str]:
    """Return the warning for a term with a special name but another number of arguments, or None."""
    name, count = term[0].name, len(term) - 1
    expected = _RESERVED_ARITIES.get(name)
    if expected is None and name in _SPECIAL_HEAD_NAMES:
        expected = _SPECIAL_HEADS[name][0]
    if expected is None or expected == count or (count == expected + 1 and name in _HEADS_WITH_OPTIONS):
        return None
    notation = NOTATIONS.get(name, f"takes {expected} argument{'s' * (expected != 1)}")
    return f"{_ORDINARY_EVENT}; {name} {notation}"


def bracket_advice(name: str, number: Any) -> str:
    """Return advice on brackets if the number of an operator was parsed with the next operator, else ""."""
    if number.__class__ is not tuple or len(number) != 3 or number[0] not in OPERATOR_NAMES:
        return ""
    inner_number = deref(number[1])
    if inner_number.__class__ not in (int, float):
        return ""
    operator = number[0].name
    return f": {inner_number} {operator} ... is read as one; write (PATTERN {name} {inner_number}) {operator} ..."


def head_error(head: Any, operator: Optional[str]) -> Optional[str]:
    """Return the reason why a compound term, which may be a pattern operator, cannot be a rule head, or None."""
    if operator == "do":
        return "a head has one do: Head do (Goal, Goal)"
    if operator in RESERVED_EVENT_ARITIES and head[0].name.isidentifier():
        return f"{_SINGLE_HEAD}; {operator} is a pattern operator: write a rule for each event"
    return _HEAD_ERRORS.get(head[0])


def head_warning(head: Any, operator: Optional[str]) -> Optional[str]:
    """Return the warning for a compound rule head that was probably intended as something else, or None."""
    if operator is not None:
        return (
            f"no pattern can match this event: in patterns {head[0].name} is an operator, "
            "and is written after the arrow: Head <- Pattern where Goal"
        )
    if len(head) == 3 and head[0].name in _COMPARISONS:
        return _CONDITION_WARNING
    return arity_warning(head) if head[0].name in _SPECIAL_HEAD_NAMES else _special_head_warning(head)


def _special_head_warning(head: Any) -> Optional[str]:
    """Return a warning if the name of a head resembles that of a special head, or None."""
    folded_name = head[0].name.lower().replace("_", "")
    for special_name, (arity, notation) in _SPECIAL_HEADS.items():
        if arity != len(head) - 1 or folded_name[:1] != special_name[0]:
            continue
        if SequenceMatcher(None, folded_name, special_name).ratio() >= _MIN_SIMILARITY:
            return f"{_ORDINARY_EVENT}; did you mean {notation}?"
    return None


_MAX_SHOWN_PARTS = 6
"""Maximum number of parts for which the pattern that covers all gaps is shown."""
_MAX_SHOWN_CHARACTERS = 60
"""Maximum length of a part, and of an absent pattern, for which that pattern is shown."""


def uncovered_gap_warning(
    term: CompoundTerm, place_of: Callable[..., Any], names: Mapping[Var, str]
) -> Optional[str]:
    """Return a warning for an absence that covers only the last gap of a longer sequence, or None.

    A sequence of three parts is a pair whose left operand is a pair: ``cnot`` covers only the gap between the
    operands of the outer pair. Parentheses around the inner pair, or a ``cnot`` in it, state that this is intended.

    Args:
        term: ``(P seq Q) cnot R``, possibly with conditions around the sequence.
        place_of: returns the place of a part of the rule, or None.
        names: names of variables.
    """
    operator = OPERATOR_NAMES[term[0]]
    sequence: Any = deref(term[1])
    while sequence.__class__ is tuple and _is_condition(sequence):
        sequence = deref(sequence[1])
    # Parentheses leave no trace in the term, only in the places of its parts; a rule that was built by a goal has
    # none, so it gets no warning.
    if sequence.__class__ is not tuple or place_of(sequence) is None:
        return None
    parts = _parts_of_repetition(sequence) or _parts_without_parentheses(sequence, place_of)
    if len(parts) < 3:
        return None
    texts = [_format_pattern(part, names) for part in parts[:_MAX_SHOWN_PARTS]]
    negated = _format_pattern(term[2], names)
    last_text = _format_pattern(parts[-1], names)
    gap = f"the gap before the last part of the sequence, {shorten(last_text)}"
    message = (
        f"{operator} covers only {gap}: {shorten(negated)} in an earlier gap does not prevent a match; "
        f"for none during the whole sequence write {NegationScope.OVERLAP.value} in place of {operator}"
    )
    if any(len(text) > _MAX_SHOWN_CHARACTERS for text in (*texts, last_text, negated)):
        return message
    grouped_text = _format_grouped_before_last(sequence, parts, names)
    return f"{message}; if only the last gap is meant, write {grouped_text} {operator} {negated}"


def _is_condition(term: CompoundTerm) -> bool:
    kind = EVENT_OPERATORS_BY_NAME[OPERATOR_NAMES[term[0]]].kind if term[0] in OPERATOR_NAMES else None
    return kind in (OperatorKind.CONDITION, OperatorKind.LIMIT)


def operator_name(term: Any) -> str:
    """Return the name of the event operator of a term; "" if it has none."""
    return OPERATOR_NAMES.get(term[0], "") if term.__class__ is tuple else ""


def _parts_of_repetition(sequence: CompoundTerm) -> List[Term]:
    """Return the parts of ``Q ntimes N``, or an empty list for another pattern."""
    times = deref(sequence[2]) if operator_name(sequence) == "ntimes" else None
    return [deref(sequence[1])] * times if times.__class__ is int else []


def _parts_without_parentheses(sequence: CompoundTerm, place_of: Callable[..., Any]) -> List[Term]:
    parts: List[Term] = []
    node: Any = sequence
    while operator_name(node) == "seq" and not _is_goal_or_run(deref(node[2])):
        parts.append(deref(node[2]))
        # The place of a term is that of its first token. An inner sequence in parentheses begins one character after
        # its outer one.
        operand: Any = deref(node[1])
        if (
            operator_name(operand) != "seq"
            or place_of(operand, 1) != place_of(node, 1)
            or _is_goal_or_run(deref(operand[2]))
        ):
            parts.append(operand)
            break
        node = operand
    return parts[::-1]


def _is_goal_or_run(term: Any) -> bool:
    """Return whether the right operand of a sequence has no gap before it: a goal, or repetitions."""
    return term.__class__ is tuple and (term[0] in RUN_OPERATORS or term[0].name in ("prolog", "query", "db"))


def _format_grouped_before_last(sequence: CompoundTerm, parts: List[Term], names: Mapping[Var, str]) -> str:
    """Return the text of the sequence with parentheses before its last gap."""
    last_text = _format_pattern(parts[-1], names)
    if operator_name(sequence) == "ntimes":
        return f"(({last_text} ntimes {len(parts) - 1}) seq {last_text})"
    if len(parts) > _MAX_SHOWN_PARTS:
        return f"((...) seq {last_text})"
    return f"(({' seq '.join(_format_pattern(part, names) for part in parts[:-1])}) seq {last_text})"


def _format_pattern(term: Term, names: Mapping[Var, str]) -> str:
    """Return the text of a pattern as a part of another one."""
    # Variables that occur once have no name; they are shown as ``_``.
    anonymous = {var: "_" for var in variables(term) if var not in names}
    text = write_term(term, None, quoted=True, numbervars=True, variable_names={**anonymous, **names})
    return f"({text})" if operator_name(deref(term)) else text
