"""What a rule knows beside what it says.

Event rules at run time: their clock, what waits for them, and what they fire.
"""

from collections import deque
from typing import TYPE_CHECKING, Any, Callable, Deque, Dict, Hashable, List, NamedTuple, Optional, Tuple

from ...foundation.codegen import MAX_TERM_ARGUMENTS
from ...foundation.errors import RuleError, UsageError
from ...prolog.terms.term_traversal import is_larger
from ...prolog.terms.types import Atom, EventAction, Frame, Functor, Term, Values, Var, deref
from ..dispatch.listeners import Listener, ListenerPhase
from ..dispatch.matcher_compiler import compile_builder
from ..fused.fused_actions import Continuation, firing_action
from ..fused.fused_join import SPARE
from ..language.pattern_tree import Pattern, RuleDefinition
from ..language.rule_parser import alarm_of
from ..matches.consumption_policy import Emit
from ..matches.expiration import VISITED_SLICE, ByStart, ExpirationQueue, drop_gone
from ..matches.match_buffer import MatchBuffer
from ..matches.negation import RuledOutSweep
from ..matches.partial_matches import NetworkOptions, PartialMatch
from .after_match_skip import AfterMatchSkip, skipping_by
from .pattern_nodes import EventNode
from .retention import least
from .rule_compiler import RuleCompiler
from .stream_node import StreamNode

if TYPE_CHECKING:
    from ..rules.rule_base import RuleBase


class RuleMetrics:
    """What a rule counts; apart from it, as most events that come in fire one.

    Attributes:
        number: how many whole matches it had, whether or not anybody wanted the event.
        last: the end of the last one, None before the first.
        errors: how many errors it had.
    """

    __slots__ = ("errors", "last", "number")

    def __init__(self) -> None:
        self.number = self.errors = 0
        self.last: Optional[int] = None


class RuleState(NamedTuple):
    """What a rule knows beside what it says.

    Attributes:
        counts: how often it has fired, when last, how many errors it had, how many matches and alarms were dropped,
            and how many alarms were set for the past.
        times: its clock, how many matches have begun to wait, and when it last collected what is too old.
        nodes: what each of its nodes is, and what it knows.
        arrivals: what waits, as it came: the match, its place among the buffers (-1: in a train), its order.
        later: what is to wait when another event comes: the place of its buffer and the match.
        later_event: the event that is meant by that.
        skipped: what its matches have skipped; None where they skip nothing.
    """

    counts: Tuple[Any, ...]
    times: Tuple[Any, ...]
    nodes: List[Any]
    arrivals: List[Tuple[PartialMatch, int, int]]
    later: List[Tuple[int, PartialMatch]]
    later_event: object
    skipped: Any


_NEVER = -(1 << 63)
_UNLIMITED = 1 << 62

MATCH_BYTES = 930
"""Memory of a partial match with two small arguments; measured with tracemalloc on CPython 3.11."""

_SWEEP_STEP = 250
"""Further matches that have to wait until it visits the next ones."""


class EventRule:
    """One event rule in the network.

    Attributes:
        name: what reports call it.
        serial: the place among the rules: older ones are served first.
        meter: counts its pattern work; None if nothing is counted.
        from_outside: whether others than the program have added it.
        mode: how it runs, see `configure`.
        skipping: what its matches have skipped; None where they skip nothing.
        window: the longest interval that its label allows, in ns; None for no bound.
        idle: the time in ns for which the state of a key is kept without a new event; None for no bound.
        listeners: of its leaves.
        sound: whether it is connected for the mode it is to run in; not where that was interrupted.
        waiting: how many partial matches it has.
        arrivals: these, the oldest first, with some that have left; the same object always, which code has bound.
        firings: how often it has fired, and when last.
        order: how many have begun to wait so far.
        timed: whether its clock has to be kept.
        clock: the newest end among the events that its patterns matched.
        allowed: the newest stamp that was seen to be allowed to move its clock.
        completion: what takes the values of whole matches, where nothing is tracked.
        expiries: what waits, by when it goes.
        sweep_at: the number of waiting matches above which `look_through` goes on to drop those that are ruled out.
    """

    def __init__(self, network: "RuleBase", definition: RuleDefinition, serial: int, name: str):
        self.network = network
        self.meter = network.logic.machine.budget.meter(self)
        self.definition = definition
        self.from_outside = network.logic.from_outside
        self.place = definition.place
        self.label = definition.label
        self.serial = serial
        self.name = name
        self.mode = NetworkOptions()
        self.skipping: Optional[AfterMatchSkip] = None
        self.window: Optional[int] = None
        self.idle: Optional[int] = None
        self.sound = False
        self.waiting = 0
        self.dropped = 0
        self.firings = RuleMetrics()
        self.alarms_dropped = 0
        self.alarms_past = 0
        self.late = 0
        self.timed = False
        self._watched = False
        self.clock: int = _NEVER
        self.allowed: int = _NEVER
        self.completion: Optional[Continuation] = None
        self.order = 0
        self.arrivals: Deque[PartialMatch] = deque()
        self._visited = 0
        self.expiries = ByStart(None)
        self.sweep_at = _UNLIMITED
        self._sweeping = False
        self._sweeps: List[RuledOutSweep] = []
        self._to_visit = False
        self._span: Optional[int] = None
        self._collected_at: Optional[int] = None
        self._garbage: Optional[Tuple[int, int]] = None
        self._by_end = ExpirationQueue()
        self.listeners: List[Listener] = []
        self.later: List[Tuple[MatchBuffer, PartialMatch, Hashable]] = []
        self._later_event: object = None
        self._unused = definition.unused
        head = definition.head
        compiler = RuleCompiler(self, [] if head is None else [head], definition.pattern)
        self.root = compiler.build()
        self.nodes = compiler.nodes
        self.double = any(getattr(node, "double", False) for node, _, _ in self.nodes)
        self._builder: Optional[Callable[[Values], Term]] = None

    def configure(
        self, mode: NetworkOptions, window: Optional[int], garbage: Optional[Tuple[int, int]]
    ) -> None:
        """Connect the nodes for a mode, a window and a garbage control (window and step, in ns)."""
        root: Any = self.root
        self.sound = False
        self.settle()
        self.mode = mode
        self.skipping = skipping = skipping_by(self, mode)
        self.window = window
        self._garbage = garbage
        self.idle = None if garbage is None else garbage[0]
        self.timed = garbage is not None and not root.alone  # operators on streams have clocks of their own
        for node, span, limits in self.nodes:
            limit = limits.late if mode.out_of_order else limits.in_order
            node.set_span(least(span, window) if node.windowed else span, least(limit, window))
            self.timed = self.timed or any(buffer.span is not None for buffer in node.buffers())
        spans = [buffer.span for buffer in self._buffers() if buffer.span is not None]
        self._span = max(spans, key=spans.count) if spans else None
        self._watched = self.timed or mode.tracked or skipping is not None
        # Within a time, matches expire by themselves, and each one may still be needed until then.
        sweeps = [one for node, _, _ in self.nodes for one in node.sweeps(mode) if one.waiting.span is None]
        self._sweeps = [] if skipping is not None else sweeps
        self._end_sweep()
        self._resettle()
        self.unlisten()
        self.completion = completion = self._completing()
        complete = completion.action

        def take(match: PartialMatch, after: Frame) -> Frame:
            return complete(match.term, match.values, match.start, match.end, after)

        whole: Emit = self._complete_tracked if mode.tracked else take
        if skipping is not None:
            skipping.connect(root, whole, mode)
        elif root.alone and not self.timed and not mode.tracked:
            root.bind_alone(completion)  # 12 % more with matches; goals are fused only here
        else:
            root.bind(whole, mode)
        self.sound = True

    def stream_node(self, pattern: Pattern) -> Optional[StreamNode]:
        """Return the node that evaluates an operator on streams; None if there is none for this pattern."""
        nodes = [node for node, _, _ in self.nodes if isinstance(node, StreamNode)]
        return next((node for node in nodes if node.pattern is pattern), None)

    def _buffers(self) -> List[Any]:
        return [buffer for node, _, _ in self.nodes for buffer in node.buffers()]

    def state(self) -> RuleState:
        """Return what it knows, for `restore` of another rule that says the same."""
        places = {id(buffer): at for at, buffer in enumerate(self._buffers())}
        firings = self.firings
        return RuleState(
            (
                *(firings.number, firings.last, firings.errors),
                *(self.dropped, self.alarms_dropped, self.alarms_past, self.late),
            ),
            (self.clock, self.order, self._collected_at),
            [(type(node).__name__, node.kept()) for node, _, _ in self.nodes],
            [
                (one, places.get(id(one.buffer), -1), one.order)
                for one in self.arrivals
                if one.buffer is not None
            ],
            [(places[id(buffer)], match) for buffer, match, _ in self.later],
            self._later_event,
            None if self.skipping is None else self.skipping.kept(),
        )

    def restore(self, state: RuleState) -> None:
        """Know, newly connected, what another rule knew."""
        firings = self.firings
        firings.number, firings.last, firings.errors = state.counts[:3]
        self.dropped, self.alarms_dropped, self.alarms_past, self.late = state.counts[3:]
        self.clock, self.order, self._collected_at = state.times
        if self.skipping is not None and state.skipped is not None:
            self.skipping.restore(state.skipped)
        kinds = [type(node).__name__ for node, _, _ in self.nodes]
        if kinds != [kind for kind, _ in state.nodes]:
            raise UsageError(f"{self.name} is made of other parts than it was")
        for (node, _, _), (_, kept) in zip(self.nodes, state.nodes):
            if kept is not None:
                node.restore(kept)
        buffers = self._buffers()
        waiting: Dict[int, Dict[PartialMatch, None]] = {}
        for match, place, order in state.arrivals:
            match.order = order
            waiting.setdefault(place, {})[match] = None
        for place, found in waiting.items():
            if place >= 0:
                buffers[place].put_back(list(found))
        self._arrive_anew([match for match, _, _ in state.arrivals])
        self.waiting = len(set(self.arrivals))
        self.later = [(buffers[place], match, buffers[place].key_of(match)) for place, match in state.later]
        self._later_event = state.later_event
        self._resettle()

    def mend(self) -> None:
        """Put right what an interrupt may have left half done about what waits."""
        waiting = [match for node, _, _ in self.nodes for buffer in node.buffers() for match in buffer.mend()]
        waiting.sort(key=lambda match: match.order)
        for match in waiting:
            match.mend()
        self.waiting = len(waiting)
        self._arrive_anew(waiting)
        self._resettle()
        for node, _, _ in self.nodes:
            node.mend()

    def _arrive_anew(self, waiting: List[PartialMatch]) -> None:
        self.arrivals.clear()
        self.arrivals.extend(waiting)
        self._end_sweep()

    def _resettle(self) -> None:
        """File what waits already under the bounds that hold now."""
        self._expire_nothing()
        for match in self.arrivals:
            if match.buffer is not None:
                self._file(match, match.buffer.span)
        if self.skipping is not None:
            self.skipping.refile(self.arrivals)

    def _expire_nothing(self) -> None:
        self.expiries.reset(self._span)
        self._by_end = ExpirationQueue()

    def listen(self, leaf: EventNode, action: EventAction, fused: bool = False) -> None:
        """Have a leaf's action called for its events; see `Audience.listen`."""
        listen = self.network.dispatcher.listen
        rank = (self.serial, leaf.rank)
        self.listeners.append(
            listen(ListenerPhase.RULES, leaf.term, action, rank, fused, unused=self._unused)
        )

    @property
    def sweeps_ruled_out(self) -> bool:
        """True if matches that are ruled out are dropped; see `RuledOutSweep`."""
        return bool(self._sweeps)

    @property
    def collects(self) -> bool:
        """Whether garbage control removes what waits."""
        return self._garbage is not None

    @property
    def vars(self) -> List[Var]:
        """The variables whose values a match has, in their order."""
        return self.root.vars

    @property
    def ground_with_event(self) -> int:
        """How many of the values of a match, the first ones, have variables only where its event has some."""
        node: Any = self.root
        if not node.alone:
            return 0
        while not isinstance(node, EventNode):
            if isinstance(node, StreamNode):  # what it gives on was not made of the event that is served
                return 0
            node = node.child
        return len(node.vars)

    @property
    def held(self) -> int:
        """How many matches wait in it, and are held by what looks at streams."""
        return self.waiting + sum(node.held() for node, _, _ in self.nodes)

    @property
    def keys(self) -> int:
        """The number of keys under which matches wait, or that have a state in operators on streams."""
        buffers = [buffer for buffer in self._buffers() if isinstance(buffer, MatchBuffer)]
        return sum(len(buffer.newest) for buffer in buffers) + sum(node.keys() for node, _, _ in self.nodes)

    @property
    def bytes(self) -> int:
        """An estimate of the memory of what it holds: numbers of items and keys times measured constants."""
        return self.waiting * MATCH_BYTES + sum(node.bytes() for node, _, _ in self.nodes)

    @property
    def active(self) -> bool:
        """Whether it takes events."""
        return bool(self.listeners)

    def unlisten(self) -> None:
        """Stop taking events."""
        for listener in self.listeners:
            self.network.dispatcher.remove(listener)
        self.listeners = []

    def clear(self) -> None:
        """Remove all partial matches and begin anew."""
        self.clear_matches()
        if self.skipping is not None:
            self.skipping.clear()
        self.clock = self.allowed = _NEVER
        self._collected_at = None

    def clear_matches(self) -> None:
        """Remove all partial matches: what waits, runs, and what rules others out."""
        self.later = []
        for node, _, _ in self.nodes:
            node.clear()
        for match in list(self.arrivals):
            match.leave()
        self.arrivals.clear()
        self._expire_nothing()
        self._end_sweep()

    def add_later(self, buffer: MatchBuffer, match: PartialMatch, key: Hashable) -> None:
        """Let a match wait in a buffer when the next event comes; at once where the clock has brought it."""
        if self.network.dispatcher.current is None:
            buffer.add(match, key)
            return
        self._later_event = self.network.dispatcher.token()
        self.later.append((buffer, match, key))

    def add_those_of_other_events(self, event: object) -> None:
        """Let those matches wait that were to wait when another event comes."""
        if self._later_event != event:
            self.settle()
        if self.skipping is not None:
            self.skipping.begin(event)

    def settle(self, only: Optional[MatchBuffer] = None) -> None:
        """Let all matches wait that are to wait; with ``only``, those of one buffer."""
        for one in list(self.later):
            buffer, match, key = one
            if only is None or buffer is only:
                if match.buffer is None:  # else an interrupt came between this and the next step
                    buffer.add(match, key)
                self.later.remove(one)

    def tick(self, end: int) -> None:
        """Move the rule's clock and remove what is too old by it."""
        if end <= self.clock:
            return
        if end > self.allowed:  # asked again only then, as the clock is asked
            self.allowed = self.network.newest_allowed()
            if end > self.allowed:
                return
        self.clock = end
        self.expiries.expire(end)
        if self._garbage is not None:
            self._collect(*self._garbage)

    def _collect(self, window: int, step: int) -> None:
        """Remove what ended longer than the garbage window ago, at most once a step."""
        clock = self.clock
        if self._collected_at is None:
            self._collected_at = clock
        if clock - self._collected_at < step:
            return
        self._collected_at = clock
        for match in self._by_end.take(clock - window):
            if match.latest < clock - window:
                match.leave()
            else:  # a run that was extended since
                self._by_end.add(match.latest, match, self.waiting)

    def keep(self, match: PartialMatch, span: Optional[int]) -> None:
        """Count a match that begins to wait; with too many the oldest goes."""
        self.waiting += 1
        arrivals = self.arrivals
        arrivals.append(match)
        if self._watched:
            self._watch(match, span)
        number = self.waiting
        if number > self.sweep_at or number > self.network.cap or len(arrivals) > 2 * number + SPARE:
            self.look_through()

    def look_through(self) -> None:
        """Drop the oldest of too many that wait; if those that have left are the larger part, forget some of them."""
        many = 2 * self.waiting + SPARE
        if self.waiting > self.sweep_at or (self._sweeping and len(self.arrivals) > many):
            self._sweep()
        elif len(self.arrivals) > many:
            self._visited = drop_gone(self.arrivals, self._visited) or 0
            if self._sweeps:  # much has left, so that the next pass is to begin earlier
                self.sweep_at = min(self.sweep_at, 2 * (self.waiting + SPARE))
        if self.waiting > self.network.cap:
            self._drop_oldest()
        if len(self.expiries) > many:
            self.expiries.forget_gone(self.waiting)

    def _sweep(self) -> None:
        """Drop some of the matches that are ruled out; see `RuledOutSweep`.

        A pass visits what waits, a slice at a time, then drops what has ruled it out, in slices. The next pass begins
        when twice as many wait, so that a match is visited a few times at most.
        """
        if not self._sweeping:
            self._sweeping = self._to_visit = True
            self._visited = 0
            for sweep in self._sweeps:
                sweep.begin(self.order)
        if self._to_visit:
            following = drop_gone(self.arrivals, self._visited, self._visit)
            self._to_visit = following is not None
            self._visited = following or 0
        if not self._to_visit and all(sweep.drop_negated(VISITED_SLICE) for sweep in self._sweeps):
            self._end_sweep()
        else:
            self.sweep_at = self.waiting + _SWEEP_STEP

    def _visit(self, match: PartialMatch) -> None:
        for sweep in self._sweeps:
            sweep.visit(match)

    def _end_sweep(self) -> None:
        """End the pass that is under way, if any; set when the next one begins."""
        self._sweeping = self._to_visit = False
        for sweep in self._sweeps:
            sweep.begin(self.order)
        self.sweep_at = 2 * (self.waiting + SPARE) if self._sweeps else _UNLIMITED

    def _watch(self, match: PartialMatch, span: Optional[int]) -> None:
        """Note when a match is to go, and whether what it is made of is taken back."""
        if span is not None and match.start + span < self.clock:
            match.leave()  # it came too late to be a part of anything
            return
        network = self.network
        if network.mode.tracked:
            network.tracker.hold(match)
        if self.timed and match.buffer is not None:
            self._file(match, span)
        if self.skipping is not None:
            self.skipping.note(match)

    def _file(self, match: PartialMatch, span: Optional[int]) -> None:
        if span is not None:
            self.expiries.add(span, match, self.waiting)
        if self._garbage is not None:
            self._by_end.add(match.latest, match, self.waiting)

    def _drop_oldest(self) -> None:
        """Drop the oldest matches until there are no more than there may be, or so many entries were visited."""
        arrivals, cap = self.arrivals, self.network.cap
        most = min(VISITED_SLICE, len(arrivals))
        for _ in range(most):
            oldest = arrivals.popleft()
            if self._visited:
                self._visited -= 1
            if oldest.buffer is not None:
                oldest.leave()
                self.dropped += 1
                self.network.dropped(self)
                if self.waiting <= cap:
                    return

    def _complete_values(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        window = self.window
        if window is not None and end - start > window:
            return after
        firings = self.firings
        firings.number += 1
        firings.last = end
        return self.fire(self._head(values), start, end, after)

    def _head(self, values: Values) -> Term:
        """Return the head with the values of a match; what makes it is compiled when it is first asked for."""
        if self._builder is None:
            assert self.definition.head is not None
            self._builder = compile_builder(self.definition.head, self.root.vars, "head of a rule")
        return self._builder(values)

    def _complete_nothing(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        self.firings.number += 1
        self.firings.last = end
        return after

    def _completing(self) -> Continuation:
        """Return what takes the values of a whole match; with nothing to test it fires at once."""
        head = self.definition.head
        if head is None:
            return Continuation(self._complete_nothing)
        key: Optional[Functor] = None
        if head.__class__ is Atom:
            key = head.functor
        elif head.__class__ is tuple and head[0].name not in _ALARMS:
            key = head[0]
        if self.window is not None or key is None or is_larger(head, MAX_TERM_ARGUMENTS):
            return Continuation(self._complete_values)
        dispatcher = self.network.dispatcher
        gate = dispatcher.gate(key)

        def failed(error: UsageError, after: Frame) -> Frame:
            self.network.rule_failed(self, RuleError(error.message))
            return after

        complete = firing_action(head, self.root.vars, self, gate, failed)
        shortcut = dispatcher.shortcuts.get(head[0]) if head.__class__ is tuple else None
        instead = shortcut and shortcut(self, complete)
        return Continuation(instead, True, gate) if instead else Continuation(complete, False, gate)

    def _complete_tracked(self, match: PartialMatch, after: Frame) -> Frame:
        window = self.window
        if window is not None and match.end - match.start > window:
            return after
        self.firings.number += 1
        self.firings.last = match.end
        if self.definition.head is None:
            return after
        return self.network.tracker.fire(self, match, self._head(match.values), after)

    def fire(self, head: Term, start: int, end: int, after: Frame, token: Any = None) -> Frame:
        """Return the frame that dispatches the head, or sets its alarm, and goes on with ``after``."""
        if self.meter is not None and self.meter(1):
            return after
        network = self.network
        dispatcher = network.dispatcher
        if head.__class__ not in (tuple, Atom):
            head = deref(head)
        try:
            if head.__class__ is tuple and head[0].name in _ALARMS:
                alarm = alarm_of(head, start, end)
                network.look_at_alarm(self, head, alarm)
                if alarm is not None:
                    network.set_alarm(self, *alarm, token)
                    return after
            return dispatcher.dispatch(head, start, end, after, token)
        except UsageError as error:
            network.rule_failed(self, RuleError(error.message))
            return after


_ALARMS = frozenset(("exceptionAlarm", "exceptionAlarmAbsoluteDatime"))
