"""How far the pattern of a rule got with the events that happened: for `explain`.

Patterns are looked at as if no event were ever used up, over the events that were kept: a part with nothing found
is what was missing.
"""

from contextlib import closing
from functools import lru_cache
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ...events.history import Occurrence
from ...events.language import (
    AGGREGATES,
    OPERATORS,
    Absent,
    Action,
    Aggregate,
    Awaited,
    Condition,
    Either,
    Occurs,
    Pair,
    Repeated,
    Shaped,
    Star,
    Windowed,
    Within,
    names_of_kind,
    shape_term,
    window_term,
)
from ...events.network import Rule, stream_of_shape
from ...events.streams import StreamItem
from ...foundation import RetalisError, codegen, look
from ...prolog.logic import Logic
from ...prolog.syntax import EventOperator, OperatorKind, by_name, write_term
from ...prolog.terms import Term, Trail, Var, copy, functor, timestamps, undo, unify, variables

_MOST = 200
"""How many occurrences of a part are looked at, the newest of them."""
_WRITTEN_OUT = 50
"""How many repetitions of a part are looked at."""

_VALUES = functor("values", 0)
_EQUAL = functor("=", 2)
_OR, *_ = names_of_kind(OperatorKind.ALTERNATIVES)
_STAR, *_ = names_of_kind(OperatorKind.RUN)
_WITHIN, *_ = names_of_kind(OperatorKind.LIMIT)
_ABSENCE = " or ".join(names_of_kind(OperatorKind.ABSENCE))
_BETWEEN = " or ".join(names_of_kind(OperatorKind.ABSENCE, between=True))
_CONDITION = [names_of_kind(OperatorKind.CONDITION, timed=timed)[0] for timed in (False, True)]
_ACTION = [names_of_kind(OperatorKind.ACTION, every=every)[0] for every in (False, True)]
_SHAPE, *_ = names_of_kind(OperatorKind.SHAPE)
_DEADLINE, *_ = names_of_kind(OperatorKind.DEADLINE)
_NOT_LET_THROUGH = {
    "throttle": "the last one was let through less than {0:g} seconds before",
    "burst": "there was another one less than {0:g} seconds before",
    "debounce": "the {0:g} seconds after the last one are not over",
    "change": "nothing changed",
}
_T1, _T2 = functor("t1", 1), functor("t2", 1)


class Candidate(NamedTuple):
    """One way in which a part of a pattern was met.

    Attributes:
        values: the rule's variables, as a compound term.
        start: where it starts.
        end: where it ends.
        event: the occurrence, where it is one single event.
        gap: end of the first and start of the second side of a sequence.
    """

    values: Term
    start: int
    end: int
    event: Optional[Occurrence] = None
    gap: Optional[Tuple[int, int]] = None


_NOWHERE = Candidate((_VALUES,), 0, 0)


class Part(NamedTuple):
    """A part of a pattern and how far it got.

    Attributes:
        text: what the part is and what became of it.
        found: where it was met.
        parts: the parts of it.
        event: the event that it waits for, where it is one.
    """

    text: str
    found: List[Candidate]
    parts: List["Part"]
    event: Optional[Term] = None


class Shortfall:
    """Looks how far one rule got.

    Args:
        logic: calls conditions.
        kept: the events that happened.
        rule: the rule; its head is bound to what was asked for.
    """

    def __init__(self, logic: Logic, kept: Sequence[Occurrence], rule: Rule):
        self._logic = logic
        self._kept = kept
        own = [
            var
            for part in (rule.definition.term, rule.definition.head)
            if part is not None
            for var in variables(part)
        ]
        self._now = rule.network.time()
        self._vars = (_VALUES, *dict.fromkeys(own))
        self._names = names_of(self._vars)
        self._named = rule.definition.names
        self._look: Dict[type, Callable[[Any], Part]] = {
            Occurs: self._occurs,
            Pair: self._pair,
            Repeated: self._repeated,
            Either: self._either,
            Absent: self._absent,
            Star: self._star,
            Aggregate: self._aggregate,
            Condition: self._condition,
            Within: self._within,
            Action: self._action,
            Windowed: self._windowed,
            Shaped: self._shaped,
            Awaited: self._awaited,
        }

    def of(self, pattern: Any) -> Part:
        """Return how far a pattern got."""
        return self._look[type(pattern)](pattern)

    # ---- one method for each kind of pattern -----------------------------------------------------------

    def _occurs(self, pattern: Occurs) -> Part:
        found = []
        for one in self._kept:
            look(1)
            trail: Trail = []
            if unify(pattern.term, copy(one.term), trail):
                found.append(Candidate(copy(self._vars), one.start, one.end, one))
            undo(trail, 0)
        text = f"{self._show(pattern.term)}: {self._seen(found, 'did not happen')}"
        return Part(text, found[-_MOST:], [], copy(pattern.term))

    def _pair(self, pattern: Pair) -> Part:
        left, right = self.of(pattern.left), self.of(pattern.right)
        spans = _spans(OPERATORS[pattern.operator])
        agree = False
        found = []
        for one in left.found:
            for two in right.found:
                values = self._joined(one, two)
                if values is None or (one.event is not None and one.event is two.event):
                    continue
                agree = True
                span = spans(one.start, one.end, two.start, two.end)
                if span is not None:
                    found.append(Candidate(values, *span, None, (one.end, two.start)))
        reason = "one side is missing"
        if left.found and right.found:
            reason = OPERATORS[pattern.operator].wrong if agree else "no pair with the same values"
        return Part(f"{pattern.operator}: {self._seen(found, reason)}", found[-_MOST:], [left, right])

    def _repeated(self, pattern: Repeated) -> Part:
        return self.of(pattern._replace(times=min(pattern.times, _WRITTEN_OUT)).written_out())

    def _either(self, pattern: Either) -> Part:
        parts = [self.of(branch) for branch in pattern.branches]
        found = [one for part in parts for one in part.found]
        return Part(f"{_OR}: {self._seen(found, 'none of them')}", found, parts)

    def _absent(self, pattern: Absent) -> Part:
        part, negated = self.of(pattern.pattern), self.of(pattern.negated)
        found = [one for one in part.found if not any(self._blocks(no, one) for no in negated.found)]
        name = _BETWEEN if pattern.inside else _ABSENCE
        reason = "ruled out by what must not happen" if part.found else "nothing to rule out"
        held = found if negated.found else [_NOWHERE]
        noted = Part(f"must not happen: {negated.text}", held, [])
        return Part(f"{name}: {self._seen(found, reason)}", found, [part, noted])

    def _blocks(self, negated: Candidate, one: Candidate) -> bool:
        if self._joined(one, negated) is None:
            return False
        if one.gap is None:
            return negated.end < one.start
        return one.gap[0] < negated.start and negated.end < one.gap[1]

    def _star(self, pattern: Star) -> Part:
        first, repeated = self.of(pattern.first), self.of(pattern.repeated)
        found = first.found + self._later(first, repeated)
        return Part(f"{_STAR}: {self._seen(found, 'it did not start')}", found, [first, repeated])

    def _aggregate(self, pattern: Aggregate) -> Part:
        first, collected = self.of(pattern.first), self.of(pattern.collected)
        found = self._later(first, collected)
        if AGGREGATES[pattern.kind].initial is not None:
            found = first.found + found
        reason = "nothing was collected" if first.found else "it did not begin"
        return Part(f"{pattern.kind}: {self._seen(found, reason)}", found, [first, collected])

    def _later(self, first: Part, second: Part) -> List[Candidate]:
        return [
            Candidate(one.values, one.start, two.end)
            for one in first.found
            for two in second.found
            if one.end < two.start and self._joined(one, two) is not None
        ][-_MOST:]

    def _condition(self, pattern: Condition) -> Part:
        part = self.of(pattern.pattern)
        found = []
        problem = ""
        for one in part.found:
            goal = _timed(pattern.goal, one) if pattern.timed else pattern.goal
            try:
                values = self._solved(goal, one)
            except RetalisError as error:
                problem = f", {error.message}"
                continue
            if values is not None:
                found.append(one._replace(values=values))
        reason = f"false for all{problem}" if part.found else "not asked"
        name = _CONDITION[pattern.timed]
        return Part(f"{name} {self._show(pattern.goal)}: {self._seen(found, reason)}", found, [part])

    def _within(self, pattern: Within) -> Part:
        part = self.of(pattern.pattern)
        found = [one for one in part.found if one.end - one.start <= pattern.span]
        seconds = timestamps.to_seconds(pattern.span + 1)
        reason = "all took longer" if part.found else "not asked"
        return Part(f"{_WITHIN} {seconds:g}: {self._seen(found, reason)}", found, [part])

    def _action(self, pattern: Action) -> Part:
        part = self.of(pattern.pattern)
        return Part(f"{_ACTION[pattern.every]} {self._show(pattern.goal)}", part.found, [part])

    def _windowed(self, pattern: Windowed) -> Part:
        part = self.of(pattern.collected)
        reason = "nothing was measured"
        window = self._show(window_term(pattern.window))
        return Part(f"aggregate over {window}: {self._seen(part.found, reason)}", part.found, [part])

    def _shaped(self, pattern: Shaped) -> Part:
        part = self.of(pattern.pattern)
        stream = stream_of_shape(pattern)
        outputs = []
        for one in part.found:
            by = tuple([self._under(one, term) for term in pattern.by])
            value = () if pattern.value is None else (self._under(one, pattern.value),)
            outputs += stream.ring(one.end)
            outputs += stream.take(StreamItem(one, one.start, one.end, by, value), one.end, 0)
        outputs += stream.ring(self._now)
        found = [output.items[-1].match._replace(end=output.end, event=None) for output in outputs]
        reason = _NOT_LET_THROUGH[pattern.shape].format(timestamps.to_seconds(pattern.span))
        reason = reason if part.found else "nothing to let through"
        text = f"{_SHAPE} {self._show(shape_term(pattern))}: {self._seen(found, reason)}"
        return Part(text, found, [part])

    def _awaited(self, pattern: Awaited) -> Part:
        part, negated = self.of(pattern.pattern), self.of(pattern.negated)
        over = [one for one in part.found if one.end + pattern.span <= self._now]
        found = [
            one._replace(end=one.end + pattern.span, event=None)
            for one in over
            if not any(self._follows(no, one, pattern.span) for no in negated.found)
        ]
        reason = "ruled out by what must not happen" if over else "the time after it is not over"
        reason = reason if part.found else "nothing to rule out"
        seconds = timestamps.to_seconds(pattern.span)
        held = found if negated.found else [_NOWHERE]
        noted = Part(f"must not happen: {negated.text}", held, [])
        return Part(f"{_DEADLINE} {seconds:g}: {self._seen(found, reason)}", found, [part, noted])

    def _follows(self, negated: Candidate, one: Candidate, span: int) -> bool:
        """Tell whether what must not happen lies wholly in a time after a part."""
        between = one.end < negated.start and negated.end < one.end + span
        return between and self._joined(one, negated) is not None

    # ---- values ----------------------------------------------------------------------------------------

    def _joined(self, one: Candidate, two: Candidate) -> Optional[Term]:
        look(1)
        trail: Trail = []
        values = copy(one.values)
        result = copy(values) if unify(values, copy(two.values), trail) else None
        undo(trail, 0)
        return result

    def _under(self, one: Candidate, term: Term) -> Term:
        """Return a term with the values of a candidate."""
        trail: Trail = []
        unify(self._vars, copy(one.values), trail)
        found = copy(term)
        undo(trail, 0)
        return found

    def _solved(self, goal: Term, one: Candidate) -> Optional[Term]:
        """Return the values with those of the first solution of a goal, or None."""
        trail: Trail = []
        try:
            if unify(self._vars, copy(one.values), trail):
                with closing(self._logic.solutions(goal)) as solutions:
                    for _ in solutions:
                        return copy(self._vars)
            return None
        finally:
            undo(trail, 0)

    # ---- text ------------------------------------------------------------------------------------------

    def _seen(self, found: List[Candidate], reason: str) -> str:
        if not found:
            return reason
        shown = ", ".join(self._time(one) for one in found[-3:])
        return shown if len(found) <= 3 else f"{len(found)} times, the last ones {shown}"

    def _time(self, one: Candidate) -> str:
        return self._show(timestamps.interval_term(one.start, one.end))

    def _show(self, term: Term) -> str:
        names = {**names_of(term), **self._names}
        portray = by_name(term, self._logic.operators, self._named, quoted=True, variable_names=names)
        return write_term(
            term, self._logic.operators, quoted=True, wide=True, variable_names=names, portray=portray
        )


@lru_cache(maxsize=len(OPERATORS))
def _spans(operator: EventOperator) -> Callable[[int, int, int, int], Optional[Tuple[int, int]]]:
    """Return the function from the intervals of a pair to that of the result, None where they do not fit."""
    lines = [
        "def made(s1, e1, s2, e2):",
        f"    if not ({operator.fits}):",
        "        return None",
        f"    return ({operator.start}), ({operator.end})",
    ]
    made: Callable[[int, int, int, int], Optional[Tuple[int, int]]] = codegen.function(
        lines, {}, f"pairs of {operator.name}"
    )
    return made


def names_of(term: Term) -> Dict[Var, str]:
    """Return names A, B, ... for the variables of a term, in their order."""
    return {var: f"{chr(65 + at % 26)}{at // 26 or ''}" for at, var in enumerate(variables(term))}


def _timed(goal: Term, one: Candidate) -> Term:
    """Return a goal with ``t1(S)`` and ``t2(E)`` replaced by what they are."""
    if goal.__class__ is not tuple:
        return goal
    if goal[0] is _T1:
        return (_EQUAL, goal[1], timestamps.to_term(one.start))
    if goal[0] is _T2:
        return (_EQUAL, goal[1], timestamps.to_term(one.end))
    return (goal[0], *[_timed(argument, one) for argument in goal[1:]])
