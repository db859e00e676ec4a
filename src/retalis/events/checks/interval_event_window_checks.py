"""Check of windows whose elements last longer than an instant.

A window ``last(N)`` contains the elements that began less than N seconds ago (`SlidingTimeWindow`), all other windows
of time compare the ends. The two differ only for elements with a duration. These come from patterns of several
events, from declared states, and from rules with such patterns. Events of topics and of other programs are taken for
instants.
"""

from collections import deque
from typing import Any, Deque, Dict, Iterator, List, Mapping, NamedTuple, Optional, Set

from ...foundation.errors import RuleError
from ...prolog.terms.types import CompoundTerm, Functor, Var, deref, functor, functor_of
from ..language.event_operators import PAIR_OPERATORS
from ..language.pattern_tree import (
    AT_END,
    AbsencePattern,
    AggregatePattern,
    EventPattern,
    InstantPattern,
    KleenePattern,
    PairPattern,
    Pattern,
    WindowPattern,
    children,
    walk,
)
from ..language.rule_heads import ALARMS, event_raised_by
from ..language.stream_parser import is_event, window_term
from .program_model import ProgramModel, SourceRule, subterms, wrap_term

_AGGREGATE = functor("aggregate", 4)
_SAME_INTERVAL = {"s1 == s2", "e1 == e2"}
"""Comparisons of an operator whose matches have the interval of each operand."""


class _Duration(NamedTuple):
    """Possible causes of a duration of the matches of a pattern.

    Attributes:
        operator: name of an operator that combines several instants, or "".
        events: functors of the events that match the pattern alone.
    """

    operator: str
    events: Set[Functor]


def find_windows_of_long_events(program: ProgramModel) -> Iterator[RuleError]:
    """Yield windows ``last(N)`` whose elements have a duration, because these windows compare starts."""
    causes: Optional[Dict[Functor, str]] = None
    for rule in program.rules:
        for number, node in enumerate(_windows_of(rule.definition.pattern)):
            if node.window.kind != "last":
                continue
            # The rules of the program are searched only if it has such a window.
            causes = _find_long_events(program) if causes is None else causes
            duration = _find_duration(node.collected)
            long_events = [key for key in duration.events if key in causes]
            if duration.operator:
                cause = f"a match of {duration.operator}"
            elif long_events:
                key = min(long_events, key=str)
                cause = f"{key}, {causes[key]}"
            else:
                continue
            written = _window_as_written(rule, number)
            window = program.logic.brief(window_term(node.window) if written is None else written)
            names = program.names_in(rule)
            advice = _advise_end(program, node, names)
            yield RuleError(
                f"{window} selects its elements by their start, and these have a duration ({cause}): one that began "
                f"before the window and ended in it is not measured; to select by the end, {advice}; "
                "if the start is intended, write % retalis: ignore=RT1211 in this line",
                (None if written is None else rule.place_of(written)) or rule.definition.place,
            )


def _advise_end(program: ProgramModel, node: WindowPattern, names: Mapping[Var, str]) -> str:
    """Return the advice to measure the instants at which the elements end."""
    if not isinstance(node.collected, EventPattern):
        return f"write {AT_END}(...) around what is measured"
    return f"measure {program.brief(functor(AT_END, 1)(node.collected.term), names)}"


def _windows_of(pattern: Pattern) -> List[WindowPattern]:
    """Return the windows of a pattern from left to right."""
    return [node for node in walk(pattern, negated=True) if isinstance(node, WindowPattern)]


def _find_duration(pattern: Pattern) -> _Duration:
    """Return the causes for which matches of a pattern can have a duration."""
    events: Set[Functor] = set()
    stack: List[Pattern] = [pattern]
    while stack:
        node = stack.pop()
        if isinstance(node, EventPattern):
            key = functor_of(node.term)
            if key is not None:
                events.add(key)
        elif isinstance(node, PairPattern):
            if set(PAIR_OPERATORS[node.operator].comparisons) != _SAME_INTERVAL:
                return _Duration(PAIR_OPERATORS[node.operator].name, events)
            stack += children(node)
        elif isinstance(node, AbsencePattern):
            return _Duration("absent", events)
        elif isinstance(node, (AggregatePattern, WindowPattern)):
            return _Duration("aggregate", events)
        elif isinstance(node, KleenePattern):
            return _Duration("*", events)
        elif not isinstance(node, InstantPattern):
            # A match of a negation has the interval of the first operand.
            stack += children(node, negated=False)
    return _Duration("", events)


def _find_long_events(program: ProgramModel) -> Dict[Functor, str]:
    """Return the functors of events that can have a duration, each with the cause in words."""
    causes: Dict[Functor, str] = {state.form.functor: "a declared state" for state in program.states}
    heads_by_event: Dict[Functor, List[Functor]] = {}
    for rule in program.rules:
        head: Any = deref(rule.definition.head) if rule.definition.head is not None else None
        key = None if head is None else functor_of(event_raised_by(head))
        if key is None:
            continue
        duration = _find_duration(rule.definition.pattern)
        operator = duration.operator
        # The event of an alarm lasts from the match to the time of the alarm.
        if head.__class__ is tuple and head[0] in ALARMS:
            operator = head[0].name
        if operator:
            causes.setdefault(key, f"emitted by a rule with {operator}")
        for event in duration.events:
            heads_by_event.setdefault(event, []).append(key)
    # A worklist instead of recursion, because rules can form chains of any length.
    pending: Deque[Functor] = deque(causes)
    while pending:
        event = pending.popleft()
        for key in heads_by_event.get(event, ()):
            if key not in causes:
                causes[key] = f"emitted for {event}"
                pending.append(key)
    return causes


def _window_as_written(rule: SourceRule, number: int) -> Optional[CompoundTerm]:
    """Return the term of the window with a number, counted from left to right, in a rule, or None."""
    windows: List[Any] = [
        deref(subterm.term[4])
        for subterm in subterms(wrap_term(rule.definition.term), 1, rule.place_of)
        if subterm.term.__class__ is tuple and subterm.term[0] is _AGGREGATE and not is_event(subterm.term)
    ]
    # Parts that are repeated have more windows in the pattern than in the text.
    return windows[min(number, len(windows) - 1)] if windows else None
