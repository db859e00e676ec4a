"""What reaches a node while its operator calls goals of the program: it is put off until the operator is done.

Such a goal may make events that come to the same node, have partial matches dropped, or set flags.

What operators on streams would have given on without an event that is taken back: they are run again.

The node of an operator on streams: hands matches over, gives on what comes of them, is woken by the clock.
"""

from collections import Counter, deque
from functools import partial
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Deque,
    Dict,
    Hashable,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ...foundation.errors import RuleError
from ...prolog.machine.resource_limits import Meter
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.timestamps import WholeSeconds
from ...prolog.terms.types import EventAction, Frame, Term, Values, Var
from ..dispatch.dispatcher import Dispatcher
from ..fused.fused_actions import Continuation
from ..fused.fused_window import FusedWindow, fused_window
from ..language.pattern_tree import Pattern
from ..matches.consumption_policy import Emit, counted, emit_each
from ..matches.negation import NegationBuffer
from ..matches.partial_matches import (
    NOTHING_HELD,
    Found,
    NetworkOptions,
    PartialMatch,
    TrackedMatch,
    arrival,
    taken_back,
)
from ..provenance.event_log import known_in
from ..streams.row_pattern import MAX_WAYS_PER_START
from ..streams.stream_elements import KeyBounds, KnownState, StreamElement, StreamOperator, StreamOutput
from ..streams.windows import KeyedWindow
from .goal_evaluation import Buffer
from .pattern_nodes import NetworkNode
from .retention import least

if TYPE_CHECKING:
    from .event_rule import EventRule


PutOff = Callable[[Frame], Frame]
"""Does what was put off, and returns the frame that goes on with another."""


class ReentrancyQueue:
    """What one node has put off; as code of a frame it does that, one after the other.

    Each is done with the event being served that was when it came, so that no chain of events goes on without end.

    Attributes:
        at_work: whether the operator is.
    """

    def __init__(self, dispatcher: Dispatcher):
        self._dispatcher = dispatcher
        self._steps: Deque[Tuple[Any, PutOff]] = deque()
        self.at_work = False

    def clear(self) -> None:
        """Forget what was put off, after an interrupt."""
        self.at_work = False
        self._steps.clear()

    def put_off(self, step: PutOff) -> None:
        """Do something later."""
        self._steps.append((self._dispatcher.current, step))

    def while_at_work(self, work: Callable[[], Any]) -> Any:
        """Return what work returns, which is that of the operator."""
        self.at_work = True
        try:
            return work()
        finally:
            self.at_work = False

    def before(self, after: Frame) -> Frame:
        """Return the frame that does what was put off, and goes on with ``after``."""
        return (self, self._dispatcher.current, after) if self._steps else after

    def run(self, frame: Frame) -> Frame:
        """Do the next of it."""
        dispatcher = self._dispatcher
        _, current, after = frame
        if not self._steps:
            dispatcher.restore(current, dispatcher.cause)
            return after  # type: ignore[no-any-return]
        event, step = self._steps.popleft()
        dispatcher.restore(event, dispatcher.cause)
        return step(frame)


KEPT = 10_000
"""How many items are remembered in one node; what is older is settled but for those that are held."""


class Replay:
    """Remembers what an operator on streams has taken and given on.

    Args:
        begin: makes the operator anew.
        known: what it knows already; that is settled.
    """

    def __init__(self, begin: Callable[[], StreamOperator], known: KnownState = ()):
        self._begin = begin
        self._base: KnownState = _copied(known)
        self._taken: List[Tuple[int, StreamElement, int]] = []
        self._given: List[Tuple[StreamOutput, TrackedMatch]] = []
        self._new: List[StreamOutput] = []
        self._forgotten: Dict[int, PartialMatch] = {}

    def __len__(self) -> int:
        return len(self._taken)

    def begin_step(self, stream: StreamOperator) -> None:
        """Settle what has been, if it is much, before the operator takes an item or gives on what is due."""
        if len(self._taken) >= KEPT or len(self._given) >= KEPT:
            self._base = _copied(stream.kept())
            self._taken, self._given = [], []

    def took(self, channel: int, item: StreamElement, now: int) -> None:
        """Remember an item that was taken."""
        self._taken.append((channel, _again(item), now))

    def gave(self, output: StreamOutput, held: TrackedMatch) -> None:
        """Remember what was given on, and what stands for it."""
        self._given.append((output, held))

    def forget(self, match: PartialMatch) -> bool:
        """Forget a match when the operator is run again; return True, as that may give other outputs then."""
        self._forgotten[id(match)] = match
        return True

    def run_again(
        self, now: int, meter: Optional[Meter]
    ) -> Optional[Tuple[StreamOperator, List[TrackedMatch]]]:
        """Run the operator again over what is left.

        Args:
            now: the present instant.
            meter: counts the items as pattern work; None if nothing is counted.

        Returns:
            The operator as it stands then, and what stands for outputs that are no longer there. Those that are
            new are kept for `take_new`. None if pattern work had to stop: then nothing here is of use any more, as
            outputs that were left out would be taken back.
        """
        forgotten = self._forgotten
        self._taken = [one for one in self._taken if id(one[1].match) not in forgotten]
        self._forgotten = {}
        stream = self._begin()
        if self._base:
            stream.restore(_without_what_is_gone(_copied(self._base)))
        outputs: List[StreamOutput] = []
        for channel, item, instant in counted(self._taken, meter):
            outputs += stream.ring(instant)
            outputs += stream.take(_again(item), instant, channel)
        outputs += stream.ring(now)
        if meter is not None and meter(0):
            return None
        outputs = [output for output in outputs if output.error is None]  # such was reported already
        there = Counter(_key(output) for output in outputs)
        stand: List[Tuple[StreamOutput, TrackedMatch]] = []
        lost: List[TrackedMatch] = []
        for output, held in self._given:
            if held.gone:
                continue
            key = _key(output)
            if there[key]:
                there[key] -= 1
                stand.append((output, held))
            else:
                lost.append(held)
        self._given = stand
        self._new = []
        for output in reversed(outputs):  # of equal ones the last are those that are new
            if there[_key(output)]:
                there[_key(output)] -= 1
                self._new.append(output)
        self._new.reverse()
        return stream, lost

    def take_new(self) -> List[StreamOutput]:
        """Return the outputs that `run_again` has found to be there now and that were not before, once."""
        found, self._new = self._new, []
        return found

    def kept(self) -> Tuple[Any, ...]:
        """Return what is remembered; see `restore`."""
        given = [((list(output.items), *output[1:]), held) for output, held in self._given]
        return (self._base, self._taken, given)

    def restore(self, kept: Tuple[Any, ...]) -> None:
        """Remember what another one did."""
        self._base, self._taken, given = kept
        self._given = [(StreamOutput(tuple(items), *rest), held) for (items, *rest), held in given]
        if self._base:  # what cannot be run again is to fail now, not when an event is taken back
            self._begin().restore(_copied(self._base))


def _again(item: StreamElement) -> StreamElement:
    """Return the same item as it came."""
    return StreamElement(item.match, item.start, item.end, item.by, item.values)


def _copied(data: Any) -> Any:
    """Return what an operator knows with copies of the items, which change as it goes on."""
    if isinstance(data, StreamElement):
        made = _again(data)
        made.order = data.order
        return made
    if data.__class__ is list:
        return [_copied(one) for one in data]
    if data.__class__ is tuple and any(one.__class__ in (list, tuple, StreamElement) for one in data):
        return tuple([_copied(one) for one in data])
    return data


def _without_what_is_gone(data: Any) -> Any:
    """Return what an operator knows without the items whose events were taken back."""
    if data.__class__ is list:
        return [
            _without_what_is_gone(one)
            for one in data
            if not (isinstance(one, StreamElement) and one.match is not None and taken_back(one.match))
        ]
    if data.__class__ is tuple and any(one.__class__ in (list, tuple) for one in data):
        return tuple([_without_what_is_gone(one) for one in data])
    return data


def _key(output: StreamOutput) -> Hashable:
    """Return what tells one output from another: what it is made of last, its interval, and what was found."""
    last = output.items[-1]
    named = last.by if output.found else ()
    found = tuple([term_key(one) for one in (*named, *output.found)])
    return (id(last.match) if not output.found else None, output.start, output.end, found)


Result = Callable[[Values, Values], Optional[Values]]
Take = Callable[[Optional[PartialMatch], Values, int, int], List[StreamOutput]]


class StreamNodeSpec(NamedTuple):
    """How a node makes items of matches, and matches of outputs.

    Attributes:
        stream: makes the operator, for a policy.
        item: gives the by and the values of an item from those of a match.
        result: gives the values of a match from those of a group and the results, None where these do not fit;
            None itself where matches are given on that came.
        clocked: whether items are taken by the present instant.
        past: what reports say of items that come too late to be taken.
        calls: whether the operator calls goals of the program.
        fused: the window, if it can be fused; None for others.
    """

    stream: Callable[[NetworkOptions], StreamOperator]
    item: Callable[[Values], Tuple[Values, Values]]
    result: "Optional[Result]"
    clocked: bool
    past: str
    calls: bool = False
    fused: Optional[FusedWindow] = None


class StreamNode(NetworkNode):
    """Hands the matches of patterns to an operator on streams.

    Args:
        rule: the rule it belongs to.
        children: the nodes of the patterns, by their channels; see `StreamOperator.take`.
        names: the variables of its values.
        making: how items and matches are made.
        pattern: the part of the rule's pattern that the node evaluates.

    Attributes:
        woken: the instant at which the clock is to wake it; None where none is.
        late: how many matches came too late to be taken.
        evicted: number of keys that were dropped because there were too many.
        place: its place among the nodes of the rule.
        carried: absences among the conditions of what must not happen, with the nodes of what they negate.
    """

    def __init__(
        self,
        rule: "EventRule",
        children: Sequence[NetworkNode],
        names: Sequence[Var],
        making: StreamNodeSpec,
        pattern: Pattern,
    ):
        self.rule = rule
        self.pattern = pattern
        self.children = list(children)
        self.vars = list(names)
        self.making = making
        self.carried: List[Tuple[NegationBuffer, NetworkNode]] = []
        self.alone = len(self.children) == 1 and self.children[0].alone and not making.calls
        self._postponing = ReentrancyQueue(rule.network.dispatcher) if making.calls else None
        self._arrivals: Dict[int, Emit] = {}
        self.place = 0
        self.span: Optional[int] = None
        self._bounds = KeyBounds()
        self.woken: Optional[int] = None
        self.late = self.evicted = 0
        self._began: Optional[NetworkOptions] = None
        self.stream = self._begin(NetworkOptions(), rule.meter)
        self.replay: Optional[Replay] = None
        self.out: Emit = lambda match, after: after

    def _begin(self, mode: NetworkOptions, meter: Optional[Meter]) -> StreamOperator:
        stream = self.making.stream(mode)
        stream.meter = meter
        stream.tracked = mode.tracked
        stream.allowed = self.rule.network.newest_allowed
        stream.set_bounds(self._bounds)
        return stream

    def set_span(self, span: Optional[int], limit: Optional[int]) -> None:
        """Set the bounds; see `NetworkNode.set_span`."""
        self.span = span
        rule = self.rule
        self._bounds = KeyBounds(limit, least(limit, rule.idle), rule.network.key_bounds.keys)
        self.stream.set_bounds(self._bounds)

    def bind(self, out: Emit, mode: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        self._connect(out, mode)
        for channel, child in enumerate(self.children):
            child.bind(self._arriving(channel, mode), mode)
        for absence, node in self.carried:
            absence.bind(node, mode)

    def bind_alone(self, completion: Continuation) -> None:
        """Connect the node; see `NetworkNode.bind_alone`."""
        complete = completion.action
        self._connect(
            lambda match, after: complete(match.term, match.values, match.start, match.end, after),
            self.rule.mode,
        )
        result, take = self.making.result, self._taking(0, self.rule.mode)

        def arrive(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            match = PartialMatch(values, start, end, None, term, None) if result is None else None
            outputs = take(match, values, start, end)
            if not outputs:
                return after
            if result is None or len(outputs) > 1 or outputs[0].error is not None:
                return self._give(outputs, after)
            output = outputs[0]
            found = result(output.items[-1].by, output.found)
            if found is None or (self.span is not None and output.end - output.start > self.span):
                return after
            return complete(None, found, output.start, output.end, after)  # type: ignore[arg-type]

        def too_large(group: KeyedWindow, after: Frame) -> Frame:
            output = group.output(False)
            return after if output is None else self._give([output], after)

        fused = self.making.fused
        action: EventAction = arrive
        if fused is not None and not self.rule.mode.revised:  # twice the time of the whole event without it
            action = fused_window(fused, self.span, self, arrive, complete, too_large)
        self.children[0].bind_alone(Continuation(action))

    def _connect(self, out: Emit, mode: NetworkOptions) -> None:
        """Give matches on to ``out``, and run by a mode; what is held stays."""
        self.out = out
        if mode != self._began:
            self._change(mode)
        self.woken = None
        self._wake()

    def _change(self, mode: NetworkOptions) -> None:
        """Run by another mode."""
        if not self._is_put_off(lambda: self._change(mode)):
            self._began = mode
            self._rebuild()
            self.replay = (
                Replay(partial(self._begin, mode, self.rule.meter), self.stream.kept())
                if mode.revised
                else None
            )

    def _is_put_off(self, work: Callable[[], None]) -> bool:
        """Tell whether something has to wait for the operator, which is at work; it is done then."""
        postponing = self._postponing
        if postponing is None or not postponing.at_work:
            return False

        def step(after: Frame) -> Frame:
            work()
            return after

        postponing.put_off(step)
        return True

    def _rebuild(self) -> None:
        """Have a new operator know what the one knew: in another mode, or after an interrupt."""
        kept = self.stream.kept()
        self.stream = self._begin(self._began or NetworkOptions(), self.rule.meter)
        self.stream.restore(kept)
        self.stream.late, self.stream.evicted = self.late, self.evicted

    def mend(self) -> None:
        """Put right what an interrupt may have left half done: what is held is counted and filed anew."""
        if self._postponing is not None:
            self._postponing.clear()
            if self._began not in (None, self.rule.mode):
                self._change(self.rule.mode)
        self._rebuild()
        self.woken = None
        self._wake()

    def buffers(self) -> Sequence[Buffer]:
        """Return where matches wait."""
        return [buffer for absence, _ in self.carried for buffer in absence.buffers()]

    def _arriving(self, channel: int, mode: NetworkOptions) -> Emit:
        """Return what takes the matches of one of the patterns."""
        take = self._taking(channel, mode)
        with_match = mode.tracked or self.making.result is None
        postponing = self._postponing

        def arrive(match: PartialMatch, after: Frame) -> Frame:
            taken = match if with_match else None
            if postponing is None:
                outputs = take(taken, match.values, match.start, match.end)
            elif postponing.at_work:
                postponing.put_off(lambda frame: self._arrivals[channel](match, frame))
                return after
            else:
                outputs = postponing.while_at_work(lambda: take(taken, match.values, match.start, match.end))
                after = postponing.before(after)
            if not outputs:
                return after
            return self._give(outputs, after, arrival(match) if mode.tracked else 0)

        self._arrivals[channel] = arrive
        return arrive

    def _taking(self, channel: int, mode: NetworkOptions) -> "Take":
        """Return what takes a match, or only its values and interval, and gives what comes of it."""
        make, clocked = self.making.item, self.making.clocked or mode.revised
        network = self.rule.network
        meter = self.rule.meter

        def take(match: Optional[PartialMatch], values: Values, start: int, end: int) -> List[StreamOutput]:
            if meter is not None and meter(1):
                return []
            now = network.time() if clocked else 0
            stream = self.stream
            crowded = stream.crowded
            if self.replay is not None:
                self.replay.begin_step(stream)
            try:
                item = StreamElement(match, start, end, *make(values))
                outputs = stream.take(item, now, channel)
            except RuleError as error:
                network.rule_failed(self.rule, error)
                return []
            if self.replay is not None:
                self._note(channel, item, now)
            if stream.late != self.late:
                self.late = stream.late
                network.came_late(self.rule, self.making.past)
            if stream.crowded != crowded or stream.evicted != self.evicted:
                self._report_dropped(stream.crowded - crowded)
            while len(stream) > network.cap:  # an item can add several partial matches to a window of steps
                outputs = [*outputs, *self._drop()]
            if stream.next is not None:
                self._wake()
            return outputs

        return take

    def _drop(self) -> List[StreamOutput]:
        """Drop the oldest item with its partial matches; return the outputs that follow from it."""
        self.rule.dropped += 1
        self.rule.network.dropped(self.rule)
        return self.stream.drop_oldest()

    def _report_dropped(self, ways: int = 0) -> None:
        """Count and report dropped ways, and the keys that the operator has dropped because there were too many.

        Only what an event itself drops is reported: a replay or an explanation runs the same items again.
        """
        for _ in range(ways):
            self.rule.dropped += 1
            self.rule.network.dropped(self.rule, MAX_WAYS_PER_START)
        for _ in range(self.stream.evicted - self.evicted):
            self.rule.dropped += 1
            self.rule.network.dropped_key(self.rule)
        self.evicted = self.stream.evicted

    def _wake(self) -> None:
        instant = self.stream.next
        if instant is not None and (self.woken is None or instant < self.woken):
            self.woken = instant
            self.rule.network.wake(self, instant)

    def ring(self, instant: int, after: Frame) -> Frame:
        """Return the frame that gives on what is due, and goes on with ``after``."""
        self.woken = None
        if self.rule.skipping is not None:
            self.rule.skipping.wakes()
        if self.replay is not None:
            self.replay.begin_step(self.stream)
        postponing = self._postponing
        if postponing is None:
            outputs = self.stream.ring(instant)
        else:
            outputs = postponing.while_at_work(lambda: self.stream.ring(instant))
            after = postponing.before(after)
        if self.stream.evicted != self.evicted:
            self._report_dropped()
        self._wake()
        came = self.rule.network.tracker.wakes() if self.stream.tracked else 0
        return self._give(outputs, after, came)

    def _give(self, outputs: List[StreamOutput], after: Frame, came: int = 0) -> Frame:
        return emit_each(counted(self._matches(outputs, came), self.rule.meter), self.out, after)

    def _matches(self, outputs: Iterable[StreamOutput], came: int = 0) -> Iterator[PartialMatch]:
        """Yield the matches of outputs, but for those that are too long or do not fit.

        Args:
            outputs: the outputs.
            came: the number of the event at which they are there, where that is none of their own.
        """
        span = self.span
        for output in outputs:
            if span is None or output.end - output.start <= span:
                match = self._match(output, came)
                if match is not None:
                    yield match

    def _match(self, output: StreamOutput, came: int) -> Optional[PartialMatch]:
        """Return the match of an output; None where its results do not fit what is written for them."""
        if output.error is not None:
            self.rule.network.rule_failed(self.rule, output.error)
            return None
        last = output.items[-1]
        result = self.making.result
        values = () if result is None else result(last.by, output.found)
        if values is None:
            return None
        held = self._held(output, came) if self.stream.tracked else ()
        if result is not None:
            start, end = output.start, output.end
            if end.__class__ is int:
                start, end = WholeSeconds(start), WholeSeconds(end)
            return PartialMatch(values, start, end, None, None, (Found(values), *held))
        match: PartialMatch = last.match
        if output.end != match.end:
            return PartialMatch(
                match.values, match.start, WholeSeconds(output.end), None, None, (match, *held)
            )
        if not held:
            return match
        return PartialMatch(match.values, match.start, match.end, match.event, match.term, (match, *held))

    def _held(self, output: StreamOutput, came: int) -> Tuple[TrackedMatch, ...]:
        """Return what stands for an output where events are tracked, and knows what it is made of."""
        parts = tuple(
            [item.match for item in output.items if item.match is not None]
        )  # else it came untracked
        held = TrackedMatch(PartialMatch((), output.start, output.end, None, None, parts), NOTHING_HELD)
        held.number = max(held.number, came)
        if self.replay is not None:
            self.replay.gave(output, held)
        return (held,)

    # ---- what an event that is taken back changes ----------------------------------------------------

    def _note(self, channel: int, item: StreamElement, now: int) -> None:
        """Remember an item, and have its events know that it is one of them."""
        assert self.replay is not None
        self.replay.took(channel, item, now)
        for occurrence in known_in(item.match):
            occurrence.held.append((self, self, item.match))

    def forget(self, node: "StreamNode", match: PartialMatch) -> bool:
        """Forget a match whose events were taken back; tell whether what is given on may be another without it."""
        return self.replay is not None and self.replay.forget(match)

    def unmade(self) -> List[TrackedMatch]:
        """Return what stands for outputs that do not hold without what was forgotten."""
        if self.replay is None:
            return []
        found = self.replay.run_again(self.rule.network.time(), self.rule.meter)
        if found is None:
            self._begin_anew()  # its outputs so far stand
            return []
        self.stream, lost = found
        self.late, self.evicted = self.stream.late, self.stream.evicted
        self._wake()
        return lost

    def results_again(self, node: "StreamNode") -> List[PartialMatch]:
        """Return the matches that are there without what was forgotten, and were not before."""
        if self.replay is None or not self.rule.active:
            return []
        return list(self._matches(self.replay.take_new()))

    def retry(self, what: PartialMatch, after: Frame) -> Frame:
        """Give such a match on."""
        return after if taken_back(what) else self.out(what, after)

    # ---- what lasts ----------------------------------------------------------------------------------

    def clear(self) -> None:
        """Forget all."""
        if not self._is_put_off(self.clear):
            self._begin_anew()

    def _begin_anew(self) -> None:
        mode = self._began or NetworkOptions()
        self.stream = self._begin(mode, self.rule.meter)
        self.replay = Replay(partial(self._begin, mode, self.rule.meter)) if mode.revised else None
        self.woken = None
        self.late = self.evicted = 0

    def held(self) -> int:
        """Return how many matches, or keys, are held."""
        return len(self.stream)

    def keys(self) -> int:
        """Return the number of keys that have a state."""
        return self.stream.keys

    def bytes(self) -> int:
        """Return an estimate of the memory of what is held."""
        return self.stream.bytes

    def kept(self) -> Any:
        """Return what it knows; see `NetworkNode.kept`."""
        return (self.stream.kept(), self.late, None if self.replay is None else self.replay.kept())

    def restore(self, kept: Any) -> None:
        """Know that; see `NetworkNode.restore`."""
        known, self.late, replayed = kept
        self.stream.restore(known)
        if self.replay is not None and replayed is not None:
            self.replay.restore(replayed)
        self._wake()
