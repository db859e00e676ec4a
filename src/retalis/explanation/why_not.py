"""Why-not provenance: how far the pattern of a rule got with the events that happened.

Each part of a pattern is evaluated over the recorded events as if no event were ever used up. The result is a tree of
parts with one of three states: the part matched, it did not match, or it was never tested because a part below it did
not match. The lowest parts that did not match are what was missing. Windows and other operators on streams are run
again with a new operator over the newest matches, at most `MAX_CANDIDATES`. A result that a window computed of older
ones, too, differs from that of the rule; the text of the part says so.
"""

from contextlib import closing
from functools import lru_cache
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ..events.language.aggregate_functions import Collector
from ..events.language.pattern_operators import OPERATORS, names_of_kind
from ..events.language.pattern_tree import (
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
    StepForm,
    Windowed,
    Within,
    occurrences,
)
from ..events.language.row_pattern_parser import step_term
from ..events.language.window_parser import shape_term, window_term
from ..events.matches.partial_matches import NetworkOptions
from ..events.network.event_rule import EventRule
from ..events.network.goal_evaluation import Evaluators
from ..events.network.stream_compiler import stream_of_shape
from ..events.network.stream_node import StreamNode
from ..events.provenance.event_log import Occurrence
from ..events.streams.stream_elements import StreamElement, StreamOutput
from ..foundation import codegen
from ..foundation.cancellation import look
from ..foundation.errors import RetalisError, RuleError
from ..prolog.syntax.event_operators import EventOperator, OperatorKind
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_writer import by_name, write_term
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms import timestamps
from ..prolog.terms.term_traversal import copy, variables
from ..prolog.terms.types import NIL, Term, Trail, Var, deref, functor
from ..prolog.terms.unification import undo, unify

MAX_CANDIDATES = 200
"""Matches of a part that are examined; the newest ones."""
MAX_REPETITIONS = 50
"""Repetitions of ``ntimes`` that are examined."""
MAX_SHOWN_CANDIDATES = 3
MAX_SHOWN_VALUE = 60
"""Characters of a variable's value that are shown."""

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


_NO_TERM: Term = (_VALUES,)
_NOWHERE = Candidate(_NO_TERM, 0, 0)


class Part(NamedTuple):
    """A part of a pattern and how far it got.

    Attributes:
        text: the part and its result.
        found: the matches of the part.
        parts: the parts below it.
        event: the event of a part that is a single event.
        tested: False if the part was never tested, because a part below it did not match.
    """

    text: str
    found: List[Candidate]
    parts: List["Part"]
    event: Optional[Term] = None
    tested: bool = True

    @property
    def mark(self) -> str:
        """``+`` for a part that matched, ``-`` for one that did not, ``?`` for one that was not tested."""
        if not self.tested:
            return "?"
        return "+" if self.found else "-"


class TimeFormat:
    """Text of intervals: ``at T`` for an instant, ``[T1,T2]`` for others.

    Args:
        show: returns the text of a term.
        origin: the instant in ns since the epoch that times are relative to; None for absolute times. Relative times
            are in seconds.
    """

    def __init__(self, show: Callable[[Term], str], origin: Optional[int] = None):
        self._show = show
        self._origin = origin

    def interval(self, start: int, end: int) -> str:
        """Return the text of an interval."""
        if start == end:
            return f"at {self._instant(start)}{self._unit}"
        return f"[{self._instant(start)},{self._instant(end)}]{self._unit}"

    @property
    def _unit(self) -> str:
        return "" if self._origin is None else " s"

    def _instant(self, instant: int) -> str:
        if self._origin is None:
            return self._show(timestamps.shown(instant))
        nanoseconds = int(instant) - self._origin
        whole, rest = divmod(abs(nanoseconds), 10**9)
        fraction = f".{rest:09d}".rstrip("0") if rest else ""
        return f"{'-' if nanoseconds < 0 else ''}{whole}{fraction}"


class WhyNot:
    """Evaluates the parts of one rule's pattern.

    Args:
        logic: calls conditions.
        kept: the events that happened.
        rule: the rule; its head is bound to the event that is explained.
        origin: the instant that times are relative to; None for absolute times.
    """

    def __init__(
        self, logic: PrologSystem, kept: Sequence[Occurrence], rule: EventRule, origin: Optional[int] = None
    ):
        self._logic = logic
        self._kept = kept
        own = [
            var
            for part in (rule.definition.term, rule.definition.head)
            if part is not None
            for var in variables(part)
        ]
        self._rule = rule
        self._now = rule.network.time()
        self._vars = (_VALUES, *dict.fromkeys(own))
        self._names = own_names(rule.definition.names)
        self._named = rule.definition.names
        self._times = TimeFormat(self._show, origin)
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
        text = f"{self._show(pattern.term)}: {self._seen(found, 'did not happen', pattern.term)}"
        return Part(text, found[-MAX_CANDIDATES:], [], copy(pattern.term))

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
        return Part(
            f"{pattern.operator}: {self._seen(found, reason)}", found[-MAX_CANDIDATES:], [left, right]
        )

    def _repeated(self, pattern: Repeated) -> Part:
        return self.of(pattern._replace(times=min(pattern.times, MAX_REPETITIONS)).written_out())

    def _either(self, pattern: Either) -> Part:
        parts = [self.of(branch) for branch in pattern.branches]
        found = [one for part in parts for one in part.found]
        return Part(f"{_OR}: {self._seen(found, 'no branch matched')}", found, parts)

    def _absent(self, pattern: Absent) -> Part:
        part, negated = self.of(pattern.pattern), self.of(pattern.negated)
        found = [one for one in part.found if not any(self._blocks(no, one) for no in negated.found)]
        name = _BETWEEN if pattern.inside else _ABSENCE
        reason = "ruled out by what must not happen" if part.found else "not tested"
        text = f"{name}: {self._seen(found, reason)}"
        return Part(text, found, [part, _unwanted(negated)], None, bool(part.found))

    def _blocks(self, negated: Candidate, one: Candidate) -> bool:
        if self._joined(one, negated) is None:
            return False
        if one.gap is None:
            return negated.end < one.start
        return one.gap[0] < negated.start and negated.end < one.gap[1]

    def _star(self, pattern: Star) -> Part:
        first, repeated = self.of(pattern.first), self.of(pattern.repeated)
        extended = [
            Candidate(values, one.start, two.end) for one, two, values in self._later(first, repeated)
        ]
        found = first.found + extended[-MAX_CANDIDATES:]
        return Part(f"{_STAR}: {self._seen(found, 'it did not start')}", found, [first, repeated])

    def _aggregate(self, pattern: Aggregate) -> Part:
        first, collected = self.of(pattern.first), self.of(pattern.collected)
        value = NIL if pattern.value is None else pattern.value
        names = variables(value)
        evaluate = Evaluators(self._rule).evaluating(pattern.kind, value, names)
        collector = Collector(pattern.kind, lambda values: values[-1], evaluate)
        found: List[Candidate] = []
        results: List[str] = []

        def add(start: Candidate, end: int, result: Term) -> None:
            # A result that differs from the one that was asked for is no match, but it is what explains that.
            values = self._with(start.values, [(pattern.result, result)])
            if values is not None:
                found.append(Candidate(values, start.start, end))
            results.append(f"{self._short(result)} {self._times.interval(start.start, end)}")

        problem = ""
        for one in first.found:
            state = collector.start
            if collector.initial is not None:
                add(one, one.end, collector.initial)
            for _, two, values in self._later(first._replace(found=[one]), collected):
                measured = tuple([self._under(values, term) for term in (*names, value)])
                try:
                    state = collector.add(state, measured)
                except RuleError as error:
                    problem = f", {error.message}"
                    continue
                add(one, two.end, collector.result(state))
        reason = self._other_results(results) or "nothing was collected"
        reason = f"{reason}{problem}" if first.found else "it did not begin"
        found = found[-MAX_CANDIDATES:]
        text = f"{pattern.kind}: {self._seen(found, reason, pattern.result)}"
        return Part(text, found, [first, collected])

    def _later(self, first: Part, second: Part) -> Iterator[Tuple[Candidate, Candidate, Term]]:
        """Yield the matches of a part with those of another that start after their end, and their common values."""
        for one in first.found:
            for two in second.found:
                if one.end < two.start:
                    values = self._joined(one, two)
                    if values is not None:
                        yield one, two, values

    def _condition(self, pattern: Condition) -> Part:
        part = self.of(pattern.pattern)
        found = []
        problems: Dict[str, None] = {}
        for one in part.found:
            goal = _timed(pattern.goal, one) if pattern.timed else pattern.goal
            try:
                values = self._solved(goal, one)
            except RetalisError as error:
                problems.setdefault(error.message)
                continue
            if values is not None:
                found.append(one._replace(values=values))
        name = _CONDITION[pattern.timed]
        if not part.found:
            return Part(f"{name} {self._show(pattern.goal)}: not tested", [], [part], None, False)
        rejected = self._candidates(part.found, pattern.goal)
        rejected = f"false for {rejected}" if " = " in rejected else f"false {rejected}"
        if problems:
            rejected = f"{rejected}, with the error: {next(reversed(list(problems)))}"
        text = f"{name} {self._show(pattern.goal)}: {self._seen(found, rejected, pattern.goal)}"
        return Part(text, found, [part])

    def _within(self, pattern: Within) -> Part:
        part = self.of(pattern.pattern)
        found = [one for one in part.found if one.end - one.start <= pattern.span]
        seconds = timestamps.to_seconds(pattern.span + 1)
        reason = "all took longer" if part.found else "not tested"
        return Part(
            f"{_WITHIN} {seconds:g}: {self._seen(found, reason)}", found, [part], None, bool(part.found)
        )

    def _action(self, pattern: Action) -> Part:
        part = self.of(pattern.pattern)
        text = f"{_ACTION[pattern.every]} {self._show(pattern.goal)}"
        if not part.found:
            return Part(f"{text}: not called", [], [part], None, False)
        return Part(text, part.found, [part])

    def _windowed(self, pattern: Windowed) -> Part:
        part = self.of(pattern.collected)
        text = f"aggregate over {self._show(window_term(pattern.window))}"
        if len(part.found) >= MAX_CANDIDATES:
            text += f" (run again over the newest {MAX_CANDIDATES} events only)"
        node = self._rule.stream_node(pattern)
        if not part.found or node is None:
            return Part(f"{text}: nothing was measured", [], [part], None, bool(part.found))
        run = _WindowRun(node, len(pattern.window.steps), self._under)
        for one in part.found:
            run.take(one)
        outputs = run.finish(self._now)
        found = []
        results = []
        for output in outputs:
            values = None
            if node.making.result is not None:
                values = node.making.result(output.items[-1].by, output.found)
            bound = None if values is None else self._with(self._vars, list(zip(node.vars, values)))
            if bound is not None:
                found.append(Candidate(bound, output.start, output.end))
            shown = ", ".join(self._short(result) for result in output.found)
            results.append(f"{shown} {self._times.interval(output.start, output.end)}")
        parts = [part]
        reason = self._other_results(results) or "no window has ended"
        if pattern.window.kind == "steps" and not results:
            reason = "no events took all steps"
            parts += self._steps(pattern.window.steps, run.progress)
        found = found[-MAX_CANDIDATES:]
        shown = self._seen(found, f"{reason}{run.problem}", (_VALUES, *pattern.results))
        return Part(f"{text}: {shown}", found, parts)

    def _steps(self, steps: Sequence[StepForm], progress: Sequence[int]) -> List[Part]:
        """Return a part for each step of a window, for the sequence of events that got farthest."""
        parts = []
        reached = True
        for step, count in zip(steps, progress or [0] * len(steps)):
            enough = count >= step.least
            text = f"step {self._show(step_term(step))}"
            if not reached:
                parts.append(Part(f"{text}: not reached", [], [], None, False))
            else:
                events = "1 event" if count == 1 else f"{count} events"
                needed = "" if enough else f" of {step.least}"
                parts.append(Part(f"{text}: took {events}{needed}", [_NOWHERE] if enough else [], []))
            reached = reached and enough
        return parts

    def _shaped(self, pattern: Shaped) -> Part:
        part = self.of(pattern.pattern)
        stream = stream_of_shape(pattern)
        node = self._rule.stream_node(pattern)
        if node is not None:
            stream.set_bounds(node.stream.bounds)
        outputs = []
        for one in part.found:
            by = tuple([self._under(one.values, term) for term in pattern.by])
            value = () if pattern.value is None else (self._under(one.values, pattern.value),)
            outputs += stream.ring(one.end)
            outputs += stream.take(StreamElement(one, one.start, one.end, by, value), one.end, 0)
        outputs += stream.ring(self._now)
        found = [output.items[-1].match._replace(end=output.end, event=None) for output in outputs]
        reason = _NOT_LET_THROUGH[pattern.shape].format(timestamps.to_seconds(pattern.span))
        reason = reason if part.found else "not tested"
        text = f"{_SHAPE} {self._show(shape_term(pattern))}: {self._seen(found, reason)}"
        return Part(text, found, [part], None, bool(part.found))

    def _awaited(self, pattern: Awaited) -> Part:
        part, negated = self.of(pattern.pattern), self.of(pattern.negated)
        over = [one for one in part.found if one.end + pattern.span <= self._now]
        found = [
            one._replace(end=one.end + pattern.span, event=None)
            for one in over
            if not any(self._follows(no, one, pattern.span) for no in negated.found)
        ]
        reason = "ruled out by what must not happen" if over else "the time after it is not over"
        reason = reason if part.found else "not tested"
        seconds = timestamps.to_seconds(pattern.span)
        text = f"{_DEADLINE} {seconds:g}: {self._seen(found, reason)}"
        return Part(text, found, [part, _unwanted(negated)], None, bool(part.found))

    def _follows(self, negated: Candidate, one: Candidate, span: int) -> bool:
        """Test whether a match of the negated part lies wholly within the time after a match."""
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

    def _under(self, values: Term, term: Term) -> Term:
        """Return a term with the values of a candidate."""
        trail: Trail = []
        unify(self._vars, copy(values), trail)
        found = copy(term)
        undo(trail, 0)
        return found

    def _with(self, values: Term, bindings: Sequence[Tuple[Term, Term]]) -> Optional[Term]:
        """Return values together with further ones, or None if these do not unify."""
        trail: Trail = []
        unifies = unify(self._vars, copy(values), trail) and all(
            unify(term, copy(value), trail) for term, value in bindings
        )
        found = copy(self._vars) if unifies else None
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

    def _seen(self, found: List[Candidate], reason: str, term: Term = _NO_TERM) -> str:
        """Return the matches of a part, with the values of a term's variables, or the reason why there are none."""
        return self._candidates(found, term) if found else reason

    def _candidates(self, found: List[Candidate], term: Term) -> str:
        names = [var for var in dict.fromkeys(variables(term)) if var in self._names]
        shown = []
        for one in found[-MAX_SHOWN_CANDIDATES:]:
            values = [(self._names[var], self._under(one.values, var)) for var in names]
            known = ", ".join(
                f"{name} = {self._short(value)}" for name, value in values if value.__class__ is not Var
            )
            time = self._times.interval(one.start, one.end)
            shown.append(f"{known} {time}" if known else time)
        text = ("; " if names else ", ").join(shown)
        return text if len(found) <= MAX_SHOWN_CANDIDATES else f"{len(found)} times, the last ones {text}"

    def _other_results(self, results: List[str]) -> str:
        """Return what an aggregate measured where that differs from the event that is explained."""
        if not results:
            return ""
        shown = "; ".join(results[-MAX_SHOWN_CANDIDATES:])
        return f"other results: {'... ' if len(results) > MAX_SHOWN_CANDIDATES else ''}{shown}"

    def _short(self, term: Term) -> str:
        text = self._show(term)
        return text if len(text) <= MAX_SHOWN_VALUE else f"{text[: MAX_SHOWN_VALUE - 4]} ..."

    def _show(self, term: Term) -> str:
        return show_term(term, self._logic.operators, self._names, self._named)


def show_term(term: Term, operators: Operators, names: Mapping[Var, str], named: Collection[Var] = ()) -> str:
    """Return the text of a term.

    Args:
        term: the term.
        operators: how its operators are written.
        names: names of variables. Another variable is written as ``_`` if it occurs once, else as A, B, and so on.
        named: variables of a rule that was read with named message slots.
    """
    counts = occurrences([term], None)
    taken = set(names.values())
    letters = (name for name in map(chr, range(ord("A"), ord("Z") + 1)) if name not in taken)
    shown = {}
    for var in variables(term):
        shown[var] = names.get(var) or ("_" if counts[var] == 1 else next(letters, "_"))
    portray = by_name(term, operators, named, quoted=True, variable_names=shown)
    return write_term(term, operators, quoted=True, wide=True, variable_names=shown, portray=portray)


def own_names(names: Mapping[Var, str]) -> Dict[Var, str]:
    """Return the names of a rule's variables for the variables that they stand for now.

    A variable of the head stands for a variable of the event that is explained, if that is not known.
    """
    found: Dict[Var, str] = {}
    for var, name in names.items():
        target = deref(var)
        if isinstance(target, Var):
            found.setdefault(target, name)
    return found


def _unwanted(negated: Part) -> Part:
    """Return the part of a pattern that must not match."""
    reason = negated
    # A condition that was not tested explains nothing: the event below it is missing.
    while not reason.tested and reason.parts:
        reason = reason.parts[0]
    return Part(f"must not happen: {reason.text}", negated.found or [_NOWHERE], [])


class _WindowRun:
    """A new run of a window over the matches of its pattern.

    Args:
        node: the rule's node of the window.
        steps: number of steps of the window; 0 for windows without steps.
        under: returns a term with the values of a candidate.

    Attributes:
        progress: number of events that each step has taken, for the sequence of events that got farthest.
        problem: text about an error of a measure or a condition, if there was one.
    """

    def __init__(self, node: StreamNode, steps: int, under: Callable[[Term, Term], Term]):
        self._node = node
        self._stream = node.making.stream(NetworkOptions())
        self._stream.set_bounds(node.stream.bounds)
        self._under = under
        self._outputs: List[StreamOutput] = []
        self.progress = [0] * steps
        self.problem = ""

    def take(self, one: Candidate) -> None:
        """Pass a match to the window, after the results that are due before it."""
        look(1)
        self._outputs += self._stream.ring(one.end)
        values = tuple([self._under(one.values, var) for var in self._node.children[0].vars])
        try:
            item = StreamElement(one, one.start, one.end, *self._node.making.item(values))
            self._outputs += self._stream.take(item, one.end, 0)
        except RuleError as error:
            self.problem = f", {error.message}"
        if self.progress:
            self._note_progress()

    def finish(self, now: int) -> List[StreamOutput]:
        """Return the results until now."""
        self._outputs += self._stream.ring(now)
        for output in self._outputs:
            if output.error is not None:
                self.problem = f", {output.error.message}"
        return [output for output in self._outputs if output.error is None]

    def _note_progress(self) -> None:
        groups = self._stream.kept()[-1]
        for _, _, ways, _ in groups:
            for _, _, _, _, taken, *_ in ways:
                counts = [0] * len(self.progress)
                for _, step in taken:
                    counts[step] += 1
                self.progress = max(self.progress, counts, key=_distance)


def _distance(counts: Sequence[int]) -> Tuple[int, int]:
    """Return a key by which sequences of events are compared: the last step reached, then the number of events."""
    return max((step for step, count in enumerate(counts) if count), default=-1), sum(counts)


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


def _timed(goal: Term, one: Candidate) -> Term:
    """Return a goal with ``t1(S)`` and ``t2(E)`` replaced by what they are."""
    if goal.__class__ is not tuple:
        return goal
    if goal[0] is _T1:
        return (_EQUAL, goal[1], timestamps.to_term(one.start))
    if goal[0] is _T2:
        return (_EQUAL, goal[1], timestamps.to_term(one.end))
    return (goal[0], *[_timed(argument, one) for argument in goal[1:]])
