"""What events came from: kept for revision and justification, bounded, and only while a flag asks for it."""

from collections import deque
from functools import partial
from itertools import count
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Deque,
    Dict,
    Hashable,
    Iterator,
    List,
    Optional,
    Protocol,
    Sequence,
    Tuple,
)

from ...prolog.machine.resource_limits import Meter
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.types import Frame, Term, Values, Var, functor
from ..dispatch.listeners import CAUSE, END, PARENT, START, TERM, TOKEN, Context, Listener, ListenerPhase
from ..matches.consumption_policy import counted
from ..matches.partial_matches import PartialMatch, TrackedMatch, sources
from ..matches.run_groups import Run
from .event_log import Occurrence, Suppressed, Tracked, Tried, TriesAgain, following, known_in

if TYPE_CHECKING:
    from ..network.event_rule import EventRule
    from ..rules.rule_base import RuleBase


KEPT = 100_000
"""How many events are remembered."""

REV = functor("rev", 1)
_SYNCHRONIZED = frozenset(
    functor(name, arity) for name in ("syncronized", "synchronized") for arity in (3, 4)
)


class _Extends(TriesAgain, Protocol):
    """A node whose runs are extended."""

    def results_again(self, run: Run) -> List[PartialMatch]:
        """Return the later results of a run from which a repetition was taken."""

    def unmade(self) -> List[TrackedMatch]:
        """Return what stands for results that do not hold any more without being made of what was taken."""


Again = Callable[[Frame], Frame]
"""Dispatches something anew; takes the frame to go on with."""


class LineageTracker:
    """Remembers events and what they came from; takes back what ``rev`` asks for.

    Attributes:
        blocker: the negated match that made the last test fail.
    """

    def __init__(self, rules: "RuleBase"):
        self._rules = rules
        self._recent: Deque[Occurrence] = deque()
        self._by_term: Dict[Hashable, List[Occurrence]] = {}
        self.listeners: List[Listener] = []
        self._plain_mark = rules.dispatcher.mark
        self.blocker: Optional[PartialMatch] = None
        self._numbers = count()
        self._arrivals = count(1)
        self._woken = 0

    def configure(self) -> None:
        """Follow the flags."""
        dispatcher = self._rules.dispatcher
        for listener in self.listeners:
            dispatcher.remove(listener)
        self.listeners = []
        dispatcher.tracked = self._rules.mode.tracked
        if not self._rules.mode.tracked:
            dispatcher.mark = self._plain_mark
            self.clear()
            return
        dispatcher.mark = self._mark
        self.listeners.append(dispatcher.listen(ListenerPhase.TRACE, Var(), self._note))
        if self._rules.flags.is_on("revision_flag"):
            self.listeners.append(
                dispatcher.listen(ListenerPhase.RULES, (REV, Var()), self._take_back, (-1,))
            )

    def mend(self) -> None:
        """Put right what an interrupt may have left half done."""
        self._by_term.clear()
        for one in self._recent:
            self._by_term.setdefault(term_key(one.term), []).append(one)
            if one.gone:
                for match in one.held:
                    if isinstance(match, PartialMatch):
                        match.leave()

    def kept(self) -> Tuple[List[Occurrence], int, int]:
        """Return the events that it remembers, and how many things were suppressed and events came; see `restore`."""
        numbers, arrivals = next(self._numbers), next(self._arrivals)
        self._numbers, self._arrivals = count(numbers), count(arrivals)
        return list(self._recent), numbers, arrivals

    def restore(self, kept: Tuple[List[Occurrence], int, int]) -> None:
        """Remember what another one did."""
        recent, numbers, arrivals = kept
        self._recent = deque(recent if self._rules.mode.tracked else ())
        self._numbers, self._arrivals = count(numbers), count(arrivals)
        self.mend()

    def clear(self) -> None:
        """Forget all."""
        self._recent.clear()
        self._by_term.clear()

    def present(self) -> int:
        """Return the number of the event that is being served; where the clock has woken a node, that of this."""
        dispatcher = self._rules.dispatcher
        number: int = self._woken if dispatcher.current is None else dispatcher.token().number
        return number

    def wakes(self) -> int:
        """Return a number for what the clock wakes: after all events so far, before those that follow."""
        self._woken = next(self._arrivals)
        return self._woken

    # ---- remembering ---------------------------------------------------------------------------------

    def _mark(self, context: Context) -> Occurrence:
        """Return the token of an event that has none: one from outside, or made by a goal."""
        term, start, end, cause = context[TERM], context[START], context[END], context[CAUSE]
        if cause.__class__ is Occurrence:  # the event of a query that has waited
            released = Occurrence(term, start, end, None, None)
            released.follows([cause])
            return released
        rule, match = cause or (None, None)
        occurrence = Occurrence(term, start, end, rule, match)
        known = [] if match is None else known_in(match)
        parent = context[PARENT]
        if not known and parent is not None and _is_synchronized(parent[TERM]) and parent[TOKEN] is not None:
            known = [parent[TOKEN]]
        occurrence.follows(known)
        return occurrence

    def _note(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        occurrence: Occurrence = self._rules.dispatcher.token()
        occurrence.number = next(self._arrivals)
        self._recent.append(occurrence)
        self._by_term.setdefault(term_key(term), []).append(occurrence)
        if len(self._recent) > KEPT:
            oldest = self._recent.popleft()
            oldest.derived = []
            oldest.forgotten = True
            _unlink(oldest)
            key = term_key(oldest.term)
            found = self._by_term[key]
            found.remove(oldest)
            if not found:
                del self._by_term[key]
        return after

    def fire(self, rule: "EventRule", match: PartialMatch, head: Term, after: Frame) -> Frame:
        """Fire a rule and keep what its event came from."""
        occurrence = Occurrence(head, match.start, match.end, rule, match)
        occurrence.follows(known_in(match))
        return rule.fire(head, match.start, match.end, after, occurrence)

    def hold(self, match: PartialMatch) -> None:
        """Remember that a partial match holds its events."""
        for occurrence in known_in(match):
            if occurrence.gone:
                match.leave()
                return
            held = occurrence.held
            held.append(match)
            if len(held) > 64 and len(held) & (len(held) - 1) == 0:
                occurrence.held = [
                    one for one in held if not isinstance(one, PartialMatch) or one.buffer is not None
                ]

    def hold_repetition(self, run: Run, match: PartialMatch, node: TriesAgain) -> None:
        """Remember that a run was extended by a match."""
        for occurrence in known_in(match):
            occurrence.held.append((node, run, match))

    def suppressed(self, node: TriesAgain, what: Tried) -> None:
        """Remember what the last negated match has kept from firing."""
        if self.blocker is not None:
            kept = Suppressed(node, what, next(self._numbers))
            for occurrence in known_in(self.blocker):
                occurrence.suppressed.append(kept)

    # ---- taking back ---------------------------------------------------------------------------------

    def _take_back(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        """Take back what an event ``rev(E)`` names: all occurrences of E, or the one it was derived for."""
        token = self._rules.dispatcher.token()
        found = token.takes_back
        again: List[Tuple[TriesAgain, Tried]] = []
        unmade: List[Tracked] = []
        if found is None:
            found = [one for one in self._by_term.get(term_key(values[0]), ()) if not one.gone]
            if not found:
                self._rules.took_nothing_back(values[0], token.rule)
                return after
            meter = self._meter(token.rule or _rule_after(found))
            lost = self._forget(found, meter)
            if lost is None:
                return after
            unmade, again = lost
        else:
            meter = self._meter(token.rule)
        work = _TakingBack(counted(self._steps([*found, *unmade], again, start, end), meter))
        return work.run((work, after))

    def _meter(self, rule: object) -> Optional[Meter]:
        return self._rules.logic.machine.budget.meter(rule)

    def _forget(
        self, found: List[Occurrence], meter: Optional[Meter]
    ) -> Optional[Tuple[List[Tracked], List[Tuple[TriesAgain, Tried]]]]:
        """Take events and all that came from them out of what is kept, before anything follows from that.

        Returns what does not hold without them though it was not made of them, and what fires without them, each with
        its node: what they kept from firing, and the later results of runs that they were part of. If there is too
        much of it, nothing is taken out, and it returns None.
        """
        gone = _mark_gone(found, meter)
        if gone is None:
            return None
        self._rules.dispatcher.retractions += 1
        for named in found:
            named.reported = True
        runs: Dict[Any, _Extends] = {}
        kept: List[Suppressed] = []
        unmade: List[Tracked] = []
        while gone:
            touched = self._forget_all(gone, kept)
            runs.update(touched)
            lost = [one for node in dict.fromkeys(touched.values()) for one in node.unmade() if not one.gone]
            gone = _mark_gone(lost, meter)  # if that is too much, outputs that are lost stand
            unmade += lost if gone else ()
        kept.sort(key=_number)  # as they were tried, which the policy says
        again: List[Tuple[TriesAgain, Tried]] = [
            (node, result) for run, node in runs.items() for result in node.results_again(run)
        ]
        return unmade, again + [(each.node, each.what) for each in kept if each.free()]

    @staticmethod
    def _forget_all(gone: Sequence[Tracked], kept: List[Suppressed]) -> Dict[Any, _Extends]:
        """Take events that are marked as gone out of what holds them.

        Returns:
            The runs and nodes that are to look again, each with its node; what was suppressed goes to ``kept``.
        """
        runs: Dict[Any, _Extends] = {}
        for one in gone:
            held, one.held = one.held, []
            for match in held:
                if isinstance(match, PartialMatch):
                    match.leave()
                elif match[0].forget(*match[1:]):
                    runs[match[1]] = match[0]
            kept += one.suppressed
            one.suppressed = []
        return runs

    def _steps(
        self, found: Sequence[Tracked], again: List[Tuple[TriesAgain, Tried]], start: int, end: int
    ) -> Iterator[Again]:
        """Yield functions from a frame to a frame: what is to be done one after the other."""
        for occurrence in found:
            for one in following(occurrence):
                yield self._dispatch_rev(one, start, end)
        for node, what in again:
            yield partial(self._retry, node, what)

    def _retry(self, node: TriesAgain, what: Tried, after: Frame) -> Frame:
        node.rule.add_those_of_other_events(self._rules.dispatcher.token())
        return node.retry(what, after)

    def _dispatch_rev(self, occurrence: Occurrence, start: int, end: int) -> Again:
        term = (REV, occurrence.term)
        token = Occurrence(term, start, end, None, None)
        token.takes_back = [occurrence]
        return lambda after: self._rules.dispatcher.dispatch(term, start, end, after, token)

    # ---- looking -------------------------------------------------------------------------------------

    def all(self) -> List[Occurrence]:
        """Return the remembered events that were not taken back, oldest first."""
        return [one for one in self._recent if not one.gone]


def _number(one: Suppressed) -> int:
    return one.number


def _mark_gone(found: Sequence[Tracked], meter: Optional[Meter]) -> Optional[List[Tracked]]:
    """Mark events, and all that came from them, as gone.

    Taking them out of what holds them is not stopped half way: a rule would go on with what is gone. So what it takes
    is counted before.

    Returns:
        All that were marked; None after a limit was passed: none is marked then.
    """
    stack: List[Tracked] = [*reversed(found)]
    gone: List[Tracked] = []
    while stack:
        one = stack.pop()
        if one.gone:
            continue
        if meter is not None and meter(1 + len(one.held) + len(one.suppressed)):
            for marked in gone:
                marked.gone = False
            return None
        one.gone = True
        gone.append(one)
        stack += reversed(one.derived)
    return gone


def _rule_after(found: Sequence[Occurrence]) -> Optional["EventRule"]:
    """Return a rule that derived an event from one of some events, or None."""
    stack: List[Tracked] = [*found]
    while stack:
        for one in stack.pop().derived:
            if isinstance(one, Occurrence):
                return one.rule
            stack.append(one)
    return None


def _unlink(oldest: Occurrence) -> None:
    """Have repetitions that an occurrence came from forget it: they may stay as long as their run does."""
    one: Any
    if oldest.match is not None:
        for one in sources(oldest.match):
            if one.__class__ is TrackedMatch:
                one.derived = [derived for derived in one.derived if derived is not oldest]


def _is_synchronized(term: Term) -> bool:
    return term.__class__ is tuple and term[0] in _SYNCHRONIZED


class _TakingBack:
    """Code of a frame that does what is left of taking events back."""

    __slots__ = ("steps",)

    def __init__(self, steps: Iterator[Again]):
        self.steps = steps

    def run(self, frame: Frame) -> Frame:
        for step in self.steps:
            after = step(frame)
            if after is not frame:
                return after
        return frame[1]  # type: ignore[no-any-return]
