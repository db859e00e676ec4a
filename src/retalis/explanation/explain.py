"""Why a subscription did not take an event: another pattern, or a condition that was false.

Why an event happened, or what was missing for it: trees of rules and events, to be read by people.
"""

from contextlib import closing
from time import monotonic
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

from ..engine.engine import Engine
from ..events.knowledge.subscriptions import Subscription, SubscriptionKey
from ..events.language.pattern_tree import Aggregate, Shaped, Windowed, walk
from ..events.language.window_parser import subscribed_event
from ..events.matches.partial_matches import AfterMatchSkipStrategy
from ..events.network.event_rule import EventRule
from ..events.provenance.event_log import Occurrence
from ..foundation.cancellation import look, watched_by
from ..foundation.errors import RetalisError, UsageError, counted
from ..prolog.syntax.term_reader import read_term
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms import timestamps
from ..prolog.terms.list_terms import list_items
from ..prolog.terms.term_traversal import copy
from ..prolog.terms.types import Atom, Term, Trail, Var, atom, deref, functor
from ..prolog.terms.unification import undo, unify
from .why_not import Part, TimeFormat, WhyNot, own_names, show_term

_AND = functor(",", 2)
_MAX_SUBSCRIPTIONS = 20
"""Subscriptions that are told of."""


class WhyNotSent:
    """Looks why subscriptions did not take events that happened.

    Args:
        logic: calls conditions.
        subscriptions: of the program, with topic and id.
        show: returns a term as text.
    """

    def __init__(
        self,
        logic: PrologSystem,
        subscriptions: Sequence[Tuple[SubscriptionKey, Subscription]],
        show: Callable[[Term], str],
    ):
        self._logic = logic
        self._all = subscriptions
        self._show = show

    def of(self, event: Term) -> Iterator[str]:
        """Yield for each subscription of an event's functor that does not take it why that is so."""
        told = 0
        for name, definition in self._definitions():
            if _key(definition[1]) != _key(event):
                continue
            why = self._why_not(definition, event)
            if why:
                told += 1
                yield f"{name} does not take it: {why}"
            if told == _MAX_SUBSCRIPTIONS:
                return

    def sending(self, asked: Term) -> Iterator[Tuple[str, Any]]:
        """Yield the subscriptions that send such a message, in a form of their own: name and definition."""
        told = 0
        for name, definition in self._definitions():
            form = deref(definition[3])
            if _key(form) is None or _key(form) != _key(asked):
                continue
            trail: Trail = []
            fits = unify(form, copy(asked), trail)
            undo(trail, 0)
            if fits and told < _MAX_SUBSCRIPTIONS:
                told += 1
                yield f"{name} sends it of {self._show(definition[1])}", definition

    def reasons(self, definition: Any, kept: Sequence[Occurrence]) -> Iterator[Tuple[Occurrence, str]]:
        """Yield the events of a subscription's functor, with why it does not take them; "" where it does."""
        for one in kept:
            if _key(one.term) == _key(definition[1]):
                yield one, self._why_not(definition, one.term)

    def _definitions(self) -> Iterator[Tuple[str, Any]]:
        for (topic, _), one in self._all:
            made: Any = copy(one.definition)
            event = subscribed_event(made[1])
            yield f"subscription {self._show(one.id)} of topic {topic}", (made[0], event, *made[2:])

    def _why_not(self, definition: Any, event: Term) -> str:
        """Return why a subscription does not take an event, "" where it does."""
        look(1)
        made: Any = copy(definition)
        trail: Trail = []
        try:
            if not unify(made[1], copy(event), trail):
                return f"it takes {self._show(made[1])}"
            goals = list_items(made[2]) or []
            shown = [self._show(goal) for goal in goals]
            for number in range(1, len(goals) + 1):
                problem = self._fails(goals[:number], goals[number:], shown)
                if problem is not None:
                    return f"its condition {shown[number - 1]} {problem}"
            return ""
        finally:
            undo(trail, 0)

    def _fails(self, goals: Sequence[Term], others: Sequence[Term], shown: List[str]) -> Optional[str]:
        """Return None where goals have a solution, and show the others with its values; else what became of them."""
        together = goals[-1]
        for goal in reversed(goals[:-1]):
            together = (_AND, goal, together)
        try:
            with closing(self._logic.solutions(together)) as solutions:
                for _ in solutions:
                    shown[len(goals) :] = [self._show(goal) for goal in others]
                    return None
        except RetalisError as error:
            return f"ends with an error: {error.message}"
        return "is false"


def _key(term: Any) -> Any:
    """Return the functor of a term, None for one that has none."""
    term = deref(term)
    return term[0] if term.__class__ is tuple else getattr(term, "functor", None)


EVENT = functor("event", 2)
_SHOWN = 10
_MAX_EXPLANATION_DEPTH = 50


class ExplanationLine(NamedTuple):
    """A line of an explanation, and the lines that belong below it.

    >>> ExplanationLine("the alarm", [ExplanationLine("the smoke", [])]).below[0].text
    'the smoke'
    """

    text: str
    below: List["ExplanationLine"]

    def indented(self, depth: int = 0) -> Iterator[str]:
        """Yield the line and all below it as text, two blanks more for each level.

        >>> for line in ExplanationLine("the alarm", [ExplanationLine("the smoke", [])]).indented():
        ...     print(line)
        the alarm
          the smoke
        """
        yield "  " * depth + self.text
        for line in self.below:
            yield from line.indented(depth + 1)


class Explanation(NamedTuple):
    """The answer to the question why.

    >>> engine = Engine()
    >>> record_origins(engine)
    >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", source="mine")
    >>> engine.event("smoke(kitchen)", 1)
    >>> isinstance(explain(engine, "alarm(kitchen)"), Explanation)
    True

    Attributes:
        happened: whether the event happened.
        lines: why it did, one tree for each time; or what was missing, one for each rule that could have fired.
    """

    happened: bool
    lines: List[ExplanationLine]


def record_origins(engine: Engine) -> None:
    """Have an engine record what events come from; to be called before anything is loaded.

    >>> engine = Engine()
    >>> record_origins(engine)
    >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", source="mine")
    >>> engine.event("smoke(kitchen)", 1)
    >>> print(explain(engine, "smoke(_)").lines[0].text)
    smoke(kitchen) at 1 came from outside
    """
    engine.rules.flags.set_default("etalis_justification", atom("on"))


def records_origins(engine: Engine) -> bool:
    """Tell whether an engine records what events come from (`record_origins`).

    >>> engine = Engine()
    >>> record_origins(engine)
    >>> records_origins(engine)
    True
    """
    return engine.rules.flags.is_on("etalis_justification")


def explain(
    engine: Engine, asked: Union[str, Term], seconds: Optional[float] = None, origin: Optional[int] = None
) -> Explanation:
    """Explain why an event happened, or what was missing for it.

    A line about a part of a pattern begins with ``+`` if the part matched, ``-`` if it did not, and ``?`` if it was
    never tested.

    >>> engine = Engine()
    >>> record_origins(engine)
    >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", source="mine")
    >>> engine.event("smoke(kitchen)", 1)
    >>> why = explain(engine, "alarm(kitchen)")
    >>> why.happened
    False
    >>> for line in why.lines[0].indented():
    ...     print(line)
    rule alarm(kitchen) <- smoke(kitchen) seq heat(kitchen) (mine:1)
      - seq: one side is missing
        + smoke(kitchen): at 1
        - heat(kitchen): did not happen

    Args:
        engine: has run with its flag ``etalis_justification`` on (`record_origins`).
        asked: the event, as far as it is known, as a term or its text; or ``event(TERM,[T1,T2])`` to ask for an
            interval too.
        seconds: time limit in s; the engine processes no events in that time. None for no limit.
        origin: show times in seconds relative to this instant, in ns since the epoch; None for absolute times.

    Raises:
        UsageError: where it is not an event, or the time is up.
        SyntaxFault: for a text that is not a term.
    """
    term = read_term(asked, engine.operators, "explain").term if isinstance(asked, str) else asked

    def work() -> Explanation:
        if seconds is None:
            return _Explainer(engine, origin).explain(term)
        before = watched_by(_until(monotonic() + seconds, seconds))
        try:
            return _Explainer(engine, origin).explain(term)
        finally:
            watched_by(before)

    return engine.do(work)


def _until(end: float, seconds: float) -> Callable[[int, int], None]:
    """Return what ends work, once in a while asked, when its time is up."""

    def ask(work: int, size: int) -> None:
        if monotonic() > end:
            raise UsageError(f"there is too much to look through: no explanation within {seconds:g} s")

    return ask


class _Explainer:
    def __init__(self, engine: Engine, origin: Optional[int]):
        self._parts = engine
        self._origin = origin
        self._times = TimeFormat(self._show, origin)
        self._kept = self._parts.rules.tracker.all()
        self._untaken = WhyNotSent(self._parts.logic, self._parts.knowledge.subscriptions.items(), self._show)
        self._shown: Set[int] = set()
        self._made_by: Dict[int, List[Occurrence]] = {}
        for one in self._kept:
            for derived in one.derived:
                self._made_by.setdefault(id(derived), []).append(one)

    def explain(self, asked: Term) -> Explanation:
        term, interval = _asked(asked)
        found = [one for one in self._kept if _is_instance(one.term, term)]
        if interval is not None:
            found = [one for one in found if _is_interval(one, interval)]
        if not found:
            return Explanation(False, self._missing(term, interval, ()))
        lines = [self._because(one, 0) for one in found[:_SHOWN]]
        for one, line in zip(found, lines):
            line.below.extend(ExplanationLine(text, []) for text in self._untaken.of(one.term))
        if len(found) > _SHOWN:
            lines.append(ExplanationLine(f"and {counted(len(found) - _SHOWN, 'more time')}", []))
        return Explanation(True, lines)

    def _because(self, one: Occurrence, depth: int) -> ExplanationLine:
        """Return why an event happened; what was said before is not said again."""
        text = self._event(one)
        if one.takes_back is not None:
            return ExplanationLine(
                f"{text} retracts", [ExplanationLine(self._event(it), []) for it in one.takes_back]
            )
        made_by = self._made_by.get(id(one), [])
        if one.match is None and not made_by:
            return ExplanationLine(f"{text} came from outside", [])
        if id(one) in self._shown or depth > _MAX_EXPLANATION_DEPTH:
            return ExplanationLine(
                f"{text}, see above" if depth <= _MAX_EXPLANATION_DEPTH else f"{text} ...", []
            )
        self._shown.add(id(one))
        sources = [self._because(source, depth + 1) for source in one.sources() or made_by]
        if one.rule is None:
            how = "is over: it held from" if self._is_state(one) else "was released by"
            return ExplanationLine(f"{text} {how}", sources)
        return ExplanationLine(f"{text} by {self._rule(one.rule)}", sources)

    def _is_state(self, one: Occurrence) -> bool:
        return bool(self._parts.knowledge.states.like(one.term))

    def _missing(
        self, term: Term, interval: Optional[Tuple[int, int]], above: Tuple[EventRule, ...]
    ) -> List[ExplanationLine]:
        """Return what was missing for each rule that could have fired the event."""
        lines = []
        for rule in self._parts.rules.rules:
            head = rule.definition.head
            if head is None or rule in above:
                continue
            trail: Trail = []
            if unify(_fired(head), copy(term), trail):
                shortfall = WhyNot(self._parts.logic, self._kept, rule, self._origin)
                part = shortfall.of(rule.definition.pattern)
                lines.append(ExplanationLine(self._rule(rule), [self._part(part, (*above, rule))]))
                if part.found:
                    lines[-1].below.append(ExplanationLine(f"- but {_why_not(rule, part, interval)}", []))
            undo(trail, 0)
        if not above:
            lines += self._unsent(term)
        if not lines and not above:
            lines.append(ExplanationLine("no rule has such a head, and no such event came from outside", []))
        if not above:
            lines += self._taken_back(term) + self._alike(term)
        return lines

    def _unsent(self, term: Term) -> List[ExplanationLine]:
        """Return which subscriptions send such a message, and what became of the events that they are about."""
        lines = []
        for text, definition in self._untaken.sending(term):
            found = list(self._untaken.reasons(definition, self._kept))[-_SHOWN:]
            below = [ExplanationLine(f"{self._event(one)}: {why or 'sent'}", []) for one, why in found]
            lines.append(ExplanationLine(text, below or [ExplanationLine("no such event happened", [])]))
        return lines

    def _part(self, part: Part, above: Tuple[EventRule, ...]) -> ExplanationLine:
        below = [self._part(one, above) for one in part.parts]
        if part.event is not None and not part.found:
            below += self._missing(part.event, None, above)
        return ExplanationLine(f"{part.mark} {part.text}", below)

    def _taken_back(self, term: Term) -> List[ExplanationLine]:
        """Return such events that did happen and were taken back."""
        gone = [one for rev in self._kept for one in rev.takes_back or () if _is_instance(one.term, term)]
        return [ExplanationLine(f"{self._event(one)} was retracted", []) for one in gone[-_SHOWN:]]

    def _alike(self, term: Term) -> List[ExplanationLine]:
        """Return events of the same name that did happen."""
        name = _name(term)
        found: Dict[str, None] = {}
        for one in self._kept:
            if _name(one.term) == name:
                found.setdefault(self._event(one))
        if not found:
            return []
        shown = list(found)[-_SHOWN:]
        return [
            ExplanationLine(
                f"{len(found)} of this name happened", [ExplanationLine(text, []) for text in shown]
            )
        ]

    def _rule(self, rule: EventRule) -> str:
        place = "" if rule.place is None else f" ({rule.place.source}:{rule.place.line})"
        label = "" if rule.label is None else f"{self._show(rule.label)}: "
        names = rule.definition.names
        text = show_term(rule.definition.term, self._parts.logic.operators, own_names(names), names)
        return f"rule {label}{text}{place}"

    def _event(self, one: Occurrence) -> str:
        return f"{self._show(one.term)} {self._times.interval(one.start, one.end)}"

    def _show(self, term: Term) -> str:
        return show_term(term, self._parts.logic.operators, {})


def _asked(asked: Term) -> Tuple[Term, Optional[Tuple[int, int]]]:
    asked = deref(asked)
    if asked.__class__ is tuple and asked[0] is EVENT:
        stamps = list_items(asked[2])
        if stamps is not None and len(stamps) == 2:
            return deref(asked[1]), (timestamps.from_term(stamps[0]), timestamps.from_term(stamps[1]))
        raise UsageError("expected event(TERM,[T1,T2])")
    if asked.__class__ not in (Atom, tuple):
        kind = "a variable" if asked.__class__ is Var else "a number or string"
        raise UsageError(f"expected an event to explain, not {kind}")
    return asked, None


def _why_not(rule: EventRule, part: Part, interval: Optional[Tuple[int, int]]) -> str:
    """Return why a rule did not fire though all of its pattern was met somewhere."""
    measured = any(isinstance(one, Windowed) for one in walk(rule.definition.pattern))
    meets = any((one.start, one.end) == interval for one in part.found)
    if interval is not None and not measured and not meets:
        return "nowhere with that interval"
    if rule.window is not None and all(one.end - one.start > rule.window for one in part.found):
        return f"all took longer than the window of the rule's label, {timestamps.to_seconds(rule.window):g} seconds"
    return _why_not_of(rule)


def _why_not_of(rule: EventRule) -> str:
    """Return what may have kept a rule from firing, by the kinds of parts that its pattern has."""
    results: List[Term] = []
    shapes: List[str] = []
    for one in walk(rule.definition.pattern):
        if isinstance(one, Aggregate):
            results.append(one.result)
        elif isinstance(one, Shaped):
            shapes.append(one.shape)
    if any(deref(result).__class__ is not Var for result in results):
        return "with other results, or other matches consumed all of it"
    if shapes:
        return f"{shapes[0]} did not let it through after others, or other matches consumed all of it"
    kind = rule.mode.after_match
    skipped = (
        "" if kind is AfterMatchSkipStrategy.KEEP else f"a match that had fired skipped it ({kind.value}), "
    )
    return (
        f"{skipped}other matches consumed all of it, it came in another order, its window had ended, or a goal after "
        "do failed"
    )


def _fired(head: Term) -> Term:
    """Return the event that a head fires: an alarm's is its first argument."""
    if head.__class__ is tuple and head[0] in _ALARMS:
        alarmed: Term = head[1]
        return alarmed
    return head


_ALARMS = frozenset((functor("exceptionAlarm", 2), functor("exceptionAlarmAbsoluteDatime", 2)))


def _is_instance(term: Term, pattern: Term) -> bool:
    trail: Trail = []
    fits = unify(copy(term), copy(pattern), trail)
    undo(trail, 0)
    return fits


def _is_interval(one: Occurrence, interval: Tuple[int, int]) -> bool:
    return bool((one.start, one.end) == interval)


def _name(term: Term) -> str:
    term = deref(term)
    if term.__class__ is tuple:
        return str(term[0].name)
    return term.name if isinstance(term, Atom) else ""
