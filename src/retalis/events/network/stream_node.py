"""Stream node: runs an operator on streams within the network.

`StreamNode` passes the matches of its patterns to an operator of `streams` (a window, a rate operator, a timeout),
and emits a match for each of its outputs. Operators that produce output when time passes have an alarm of the clock
(`StreamNode.on_alarm`). Three mechanisms surround the operator:

* *Reentrancy*: an operator may call goals of the program (conditions of steps, user-defined aggregates). Such a goal
  may make events that reach the same node, or change flags. `ReentrancyQueue` defers these until the operator has
  returned.
* *Revision*: if events may be retracted, `Replay` records the elements that the operator has received and its
  outputs. After a retraction it runs a new operator over the remaining elements; outputs that are missing then are
  retracted, and new ones are emitted. Elements beyond a limit become part of an initial state and are final.
* *Fusion*: for a plain event, the node and the operator are compiled to one function (`compile_fused_window`).
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
    TypeVar,
)

from ...foundation.errors import RetalisError, RuleError, TermTooLarge
from ...prolog.machine.resource_limits import Meter
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.timestamps import FloatSeconds, lazy_term
from ...prolog.terms.types import EventAction, Frame, Term, Values, Var
from ...serialization.state_fields import (
    StateFields,
    StateOwner,
    constraint,
    field,
    part,
    part_state,
    rows_of,
)
from ...serialization.stored_field_types import (
    COUNT,
    INSTANT,
    TERM,
    State,
    invalid_value,
    optional,
    reference,
    sequence_of,
)
from ..dispatch.dispatcher import Dispatcher
from ..fused.fused_single_event import Continuation
from ..fused.fused_window import FusedWindow, compile_fused_window
from ..language.pattern_tree import Pattern
from ..matches.consumption_policy import Emit, emit_each, metered
from ..matches.expiration import smaller_bound
from ..matches.match_policies import NetworkOptions
from ..matches.match_types import (
    NO_REPETITIONS,
    ComputedValues,
    EventMatch,
    PartialMatch,
    RepetitionChain,
    arrival_number_of,
    is_retracted,
)
from ..matches.watermarks import PatternWatermark, functors_of
from ..streams.row_pattern import MAX_STATES_PER_START
from ..streams.stream_operators import ELEMENT, KeyBounds, StreamElement, StreamOperator, StreamOutput
from ..streams.windows import KeyedWindow
from .lineage_graph import lineage_nodes_of
from .pattern_nodes import MatchCheck, NetworkNode, OperandBuffer, checks_of_negations

_Matched = TypeVar("_Matched")
_Returned = TypeVar("_Returned")

if TYPE_CHECKING:
    from ..matches.negation import DeferredNegations
    from .event_rule import EventRule


DeferredWork = Callable[[Frame], Frame]
"""Does deferred work, and returns the next frame; takes the frame to continue with."""


class ReentrancyQueue:
    """Deferred work of one node. It is also the code of a frame that executes the work in order.

    Each piece of work runs as part of the event that was being dispatched when it was deferred, so the limit on
    chains of events applies to it.

    Attributes:
        is_running: whether the operator is running.
    """

    def __init__(self, dispatcher: Dispatcher):
        self._dispatcher = dispatcher
        self._deferred_work: Deque[Tuple[Any, DeferredWork]] = deque()
        self.is_running = False

    def defer(self, work: DeferredWork) -> None:
        """Defer work."""
        self._deferred_work.append((self._dispatcher.current, work))

    def run_operator(self, work: Callable[[], Any]) -> Any:
        """Run the operator and return its result."""
        self.is_running = True
        try:
            return work()
        finally:
            self.is_running = False

    def prepend_deferred_work(self, frame: Frame) -> Frame:
        """Return the frame that executes the deferred work, and continues with ``frame``."""
        return (self, self._dispatcher.current, frame) if self._deferred_work else frame

    def run(self, frame: Frame) -> Frame:
        """Execute the next piece of work."""
        dispatcher = self._dispatcher
        _, current, next_frame = frame
        # All work is done: the event that was dispatched before becomes current again.
        if not self._deferred_work:
            dispatcher.restore_context(current, dispatcher.cause)
            return next_frame  # type: ignore[no-any-return]
        event, work = self._deferred_work.popleft()
        dispatcher.restore_context(event, dispatcher.cause)
        return work(frame)


MAX_REPLAYED_ELEMENTS = 10_000
"""Elements that are remembered in one node; older ones are final, except those in the operator's state."""


class ReceivedElement(NamedTuple):
    """An element that an operator has received.

    Attributes:
        element: the element as it was received.
        instant: the present instant then, in ns.
    """

    channel: int
    element: StreamElement
    instant: int


class StoredOutput(NamedTuple):
    """Stored form of a `StreamOutput` without an error.

    Attributes:
        elements, start, end, results: as in `StreamOutput`.
        repetition_chain: the object that represents it in the lineage.
    """

    elements: Sequence[StreamElement]
    start: int
    end: int
    results: Values
    repetition_chain: RepetitionChain


class Replay(StateOwner):
    """Log of the elements that an operator has received and of its outputs, to run it again after a retraction.

    Args:
        operator_state: its state so far, which is final; None if it is new.
    """

    STATE = StateFields(
        field("_initial_state", lambda replay: optional(part_state(replay.create_operator()))),
        field(
            "_elements",
            rows_of(
                ReceivedElement,
                channel=COUNT,
                element=reference("element"),
                instant=INSTANT,
            ),
        ),
        field(
            "stored_outputs",
            rows_of(
                StoredOutput,
                # A replay identifies outputs by their last element.
                elements=sequence_of(ELEMENT, min_count=1),
                start=INSTANT,
                end=INSTANT,
                results=sequence_of(TERM, tuple),
                repetition_chain=reference("repetition chain"),
            ),
        ),
    )

    def __init__(self, create_operator: Callable[[], StreamOperator], operator_state: Optional[State] = None):
        self.create_operator = create_operator
        self._initial_state: Optional[State] = _copy_state(operator_state)
        self._elements: List[ReceivedElement] = []
        self._outputs: List[Tuple[StreamOutput, RepetitionChain]] = []
        self._new_outputs: List[StreamOutput] = []
        self._excluded_matches: Dict[int, PartialMatch] = {}

    def __len__(self) -> int:
        return len(self._elements)

    def begin_step(self, stream: StreamOperator) -> None:
        """Make the log part of the final state if it is long.

        Called before the operator processes an element or an alarm.
        """
        if len(self._elements) >= MAX_REPLAYED_ELEMENTS or len(self._outputs) >= MAX_REPLAYED_ELEMENTS:
            self._initial_state = _copy_state(stream.snapshot())
            self._elements, self._outputs = [], []

    def record_element(self, channel: int, element: StreamElement, now: int) -> None:
        """Record an element."""
        self._elements.append(ReceivedElement(channel, _fresh_element(element), now))

    def record_output(self, output: StreamOutput, repetition_chain: RepetitionChain) -> None:
        """Record an output, and the object that represents it in the lineage."""
        self._outputs.append((output, repetition_chain))

    def remove_retracted(self, match: PartialMatch) -> bool:
        """Exclude a match when the operator is run again; return True, because that may change its outputs."""
        self._excluded_matches[id(match)] = match
        return True

    def run_again(
        self, now: int, meter: Optional[Meter]
    ) -> Optional[Tuple[StreamOperator, List[RepetitionChain]]]:
        """Run the operator again over the remaining elements.

        Args:
            now: the present instant.
            meter: counts the elements as pattern work; None if nothing is counted.

        Returns:
            The new operator, and the lineage objects of outputs that are missing now; `pop_new_outputs` returns the
            new outputs. None if pattern work was stopped: the outputs would be incomplete, and valid ones would be
            retracted.
        """
        excluded_matches = self._excluded_matches
        self._elements = [
            entry for entry in self._elements if id(entry.element.match) not in excluded_matches
        ]
        self._excluded_matches = {}
        stream = self.create_operator()
        if self._initial_state is not None:
            stream.restore(_without_retracted(_copy_state(self._initial_state)))
        outputs: List[StreamOutput] = []
        for channel, element, instant in metered(self._elements, meter):
            outputs += stream.advance_to(instant)
            try:
                outputs += stream.process(_fresh_element(element), instant, channel)
            except RuleError:
                # Without the excluded matches, another element is in the window, and this value does not fit to it.
                continue
        outputs += stream.advance_to(now)
        if meter is not None and meter(0):
            return None
        # Errors were reported the first time.
        outputs = [output for output in outputs if output.error is None]
        # Outputs are compared as multisets: equal outputs may occur several times, and each old one needs its own
        # counterpart.
        counts = Counter(_output_key(output) for output in outputs)
        remaining: List[Tuple[StreamOutput, RepetitionChain]] = []
        missing: List[RepetitionChain] = []
        for output, repetition_chain in self._outputs:
            if repetition_chain.retracted:
                continue
            key = _output_key(output)
            if counts[key]:
                counts[key] -= 1
                remaining.append((output, repetition_chain))
            else:
                missing.append(repetition_chain)
        self._outputs = remaining
        self._new_outputs = []
        # Of equal outputs, the last ones are new.
        for output in reversed(outputs):
            if counts[_output_key(output)]:
                counts[_output_key(output)] -= 1
                self._new_outputs.append(output)
        self._new_outputs.reverse()
        return stream, missing

    def pop_new_outputs(self) -> List[StreamOutput]:
        """Return the outputs that are new after `run_again`, once."""
        outputs, self._new_outputs = self._new_outputs, []
        return outputs

    @property
    def stored_outputs(self) -> List[StoredOutput]:
        """The outputs."""
        return [
            StoredOutput(output.elements, output.start, output.end, output.results, repetition_chain)
            for output, repetition_chain in self._outputs
        ]

    @stored_outputs.setter
    def stored_outputs(self, outputs: Sequence[StoredOutput]) -> None:
        self._outputs = [
            (StreamOutput(tuple(elements), start, end, results), repetition_chain)
            for elements, start, end, results, repetition_chain in outputs
        ]

    def restore(self, saved: State) -> None:
        """Set the log that another one returned."""
        super().restore(saved)
        # A state that cannot be restored must fail now, not at a retraction.
        if self._initial_state is not None:
            self.create_operator().restore(_copy_state(self._initial_state))


def _fresh_element(element: StreamElement) -> StreamElement:
    """Return a copy of an element as it was received."""
    return StreamElement(element.match, element.start, element.end, element.key_values, element.values)


def _copy_state(data: Any) -> Any:
    """Return the state of an operator with copies of its elements, which the operator changes."""
    if isinstance(data, StreamElement):
        copy = _fresh_element(data)
        copy.order = data.order
        return copy
    if data.__class__ is list:
        return [_copy_state(element) for element in data]
    if data.__class__ is dict:
        return {name: _copy_state(value) for name, value in data.items()}
    if hasattr(data, "_fields"):
        return data._replace(**{name: _copy_state(value) for name, value in data._asdict().items()})
    return data


def _without_retracted(data: Any) -> Any:
    """Return the state of an operator without the elements whose events were retracted."""
    if data.__class__ is list:
        return [
            _without_retracted(element)
            for element in data
            if not (
                isinstance(element, StreamElement)
                and element.match is not None
                and is_retracted(element.match)
            )
        ]
    if data.__class__ is dict:
        return {name: _without_retracted(value) for name, value in data.items()}
    if hasattr(data, "_fields"):
        return data._replace(**{name: _without_retracted(value) for name, value in data._asdict().items()})
    return data


def _output_key(output: StreamOutput) -> Hashable:
    """Return the identity of an output: its last element, its interval, and its results."""
    last = output.elements[-1]
    key_values = last.key_values if output.results else ()
    results = tuple([term_key(term) for term in (*key_values, *output.results)])
    return (id(last.match) if not output.results else None, output.start, output.end, results)


MatchValuesBuilder = Callable[[Values, Values], Optional[Values]]
"""Returns the values of a match from the key and the results; None if they do not unify with the rule's terms."""
OperatorInput = Callable[[Optional[PartialMatch], Values, int, int], List[StreamOutput]]
"""Passes a match, or None, with its values, start and end to the operator; returns the outputs."""


class StreamNodeSpec(NamedTuple):
    """Specification of a node: functions that make elements from matches, and matches from outputs.

    Attributes:
        build_match_values: builds the values of a match; None if the node emits the matches that it received.
        uses_clock: whether the operator needs the present time of the clock with each element.
        late_report: text of reports about elements that arrive too late.
        calls_goals: whether the operator calls goals of the program.
        fusible_window: the window, if it can be fused; else None.
        uses_stamps: whether the terms of the start and the end of a match follow its values in ``key_and_values``.
    """

    create_operator: Callable[[NetworkOptions], StreamOperator]
    key_and_values: Callable[[Values], Tuple[Values, Values]]
    build_match_values: Optional[MatchValuesBuilder]
    uses_clock: bool
    late_report: str
    calls_goals: bool = False
    fusible_window: Optional[FusedWindow] = None
    uses_stamps: bool = False

    def with_stamps(
        self, process: Callable[[_Matched, Values, int, int], _Returned]
    ) -> Callable[[_Matched, Values, int, int], _Returned]:
        """Return a function that takes a match with its values, start and end, and calls another one.

        If stamps are used, the other function receives them after the values.
        """
        if not self.uses_stamps:
            return process

        def process_with_stamps(match: _Matched, values: Values, start: int, end: int) -> _Returned:
            return process(match, (*values, lazy_term(start), lazy_term(end)), start, end)

        return process_with_stamps

    def create_element(self, match: Any, values: Values, start: int, end: int) -> StreamElement:
        """Return the element of a match."""

        def create(match: Any, values: Values, start: int, end: int) -> StreamElement:
            return StreamElement(match, start, end, *self.key_and_values(values))

        return self.with_stamps(create)(match, values, start, end)


def _drop_result(match: PartialMatch, frame: Frame) -> Frame:
    """Drop a result of a node that is not connected."""
    return frame


class StreamNode(NetworkNode):
    """Passes the matches of patterns to an operator on streams.

    Args:
        rule: the rule that it belongs to.
        children: nodes of the patterns, by channel; see `StreamOperator.process`.
        value_vars: variables of its values.
        spec: its specification.
        pattern: the part of the rule's pattern that it evaluates.

    Attributes:
        alarm_instant: instant of its next alarm; None if no alarm is set.
        watermark: its watermark, the time that its operator takes as the present one.
        late_count: number of matches that arrived too late.
        evicted_count: number of keys that were dropped because there were too many.
        position: position among the nodes of the rule.
        deferred_negations: negation buffers in the conditions of a negated pattern, with their negated nodes.
    """

    STATE = StateFields(
        part("stream", "check_element"),
        field("late_count", COUNT),
        part("replay", "check_element"),
        constraint(
            "received elements that its patterns can have",
            lambda node, state: state["replay"] is None or node.can_receive(state["replay"]["elements"]),
        ),
    )

    def __init__(
        self,
        rule: "EventRule",
        children: Sequence[NetworkNode],
        value_vars: Sequence[Var],
        spec: StreamNodeSpec,
        pattern: Pattern,
    ):
        self.rule = rule
        self.pattern = pattern
        self.children = list(children)
        self.vars = list(value_vars)
        self.spec = spec
        self.deferred_negations: DeferredNegations = []
        self.is_single_event = (
            len(self.children) == 1 and self.children[0].is_single_event and not spec.calls_goals
        )
        self._reentrancy = ReentrancyQueue(rule.network.dispatcher) if spec.calls_goals else None
        self._input_actions: Dict[int, Emit] = {}
        self.position = 0
        self.span: Optional[int] = None
        self._bounds = KeyBounds()
        self.alarm_instant: Optional[int] = None
        watermarks = rule.network.watermarks
        # Operators that depend on time stamps only have no alarms, so no topic is observed for them.
        self.watermark = watermarks.watch(functors_of(pattern)) if spec.uses_clock else PatternWatermark()
        self.late_count = self.evicted_count = 0
        self._has_reported_skip = False
        self._options: Optional[NetworkOptions] = None
        self.stream = self._create_operator(NetworkOptions(), rule.meter)
        self.replay: Optional[Replay] = None
        self.emit: Emit = _drop_result

    def _create_operator(self, options: NetworkOptions, meter: Optional[Meter]) -> StreamOperator:
        stream = self.spec.create_operator(options)
        stream.meter = meter
        stream.tracks_elements = options.tracks_events
        stream.limit_time(self.rule.network.compute_max_timestamp)
        stream.set_bounds(self._bounds)
        return stream

    def set_span(self, span: Optional[int], retention: Optional[int]) -> None:
        """Set the interval bound and the retention time; see `NetworkNode.set_span`."""
        self.span = span
        rule = self.rule
        self._bounds = KeyBounds(
            retention, smaller_bound(retention, rule.idle), rule.network.key_bounds.max_keys
        )
        self.stream.set_bounds(self._bounds)

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        self._connect(emit, options)
        for channel, child in enumerate(self.children):
            child.bind(self._input_action(channel, options), options)
        for negation, node in self.deferred_negations:
            negation.bind(node, options)

    def bind_values(self, completion: Continuation) -> None:
        """Connect the node; see `NetworkNode.bind_values`."""
        complete = completion.action
        self._connect(
            lambda match, frame: complete(match.term, match.values, match.start, match.end, frame),
            self.rule.options,
        )
        build_match_values, process = self.spec.build_match_values, self._operator_input(0, self.rule.options)

        def on_match(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            match = PartialMatch(values, start, end, None, term, None) if build_match_values is None else None
            outputs = process(match, values, start, end)
            if not outputs:
                return frame
            if build_match_values is None or len(outputs) > 1 or outputs[0].error is not None:
                return self._emit_outputs(outputs, frame)
            output = outputs[0]
            result_values = build_match_values(output.elements[-1].key_values, output.results)
            if result_values is None or (self.span is not None and output.end - output.start > self.span):
                return frame
            return complete(None, result_values, output.start, output.end, frame)  # type: ignore[arg-type]

        def on_overflow(keyed_window: KeyedWindow, frame: Frame) -> Frame:
            output = keyed_window.output(False)
            return frame if output is None else self._emit_outputs([output], frame)

        fusible_window = self.spec.fusible_window
        action: EventAction = on_match
        # The general path takes twice the time per event.
        if fusible_window is not None and not self.rule.options.emits_revisions:
            values_are_arguments = self.children[0].values_are_arguments
            action = compile_fused_window(
                fusible_window, self.span, self, on_match, complete, on_overflow, values_are_arguments
            )
        self.children[0].bind_values(Continuation(action, is_fused=action is not on_match))

    def _connect(self, emit: Emit, options: NetworkOptions) -> None:
        """Set the action for results, and the options; the operator's state remains."""
        self.emit = emit
        if options != self._options:
            self._set_options(options)
        self.alarm_instant = None
        self._set_alarm()

    def _set_options(self, options: NetworkOptions) -> None:
        """Run the operator with other options."""
        if not self._defer_if_running(lambda: self._set_options(options)):
            self._options = options
            self._recreate_operator()
            self.replay = (
                Replay(partial(self._create_operator, options, self.rule.meter), self.stream.snapshot())
                if options.emits_revisions
                else None
            )

    def _defer_if_running(self, work: Callable[[], None]) -> bool:
        """Defer work if the operator is running; return whether it was deferred."""
        reentrancy = self._reentrancy
        if reentrancy is None or not reentrancy.is_running:
            return False

        def do_work(frame: Frame) -> Frame:
            work()
            return frame

        reentrancy.defer(do_work)
        return True

    def _recreate_operator(self) -> None:
        """Replace the operator by a new one with the same state, for other options."""
        saved = self.stream.snapshot()
        self.stream = self._create_operator(self._options or NetworkOptions(), self.rule.meter)
        self.stream.restore(saved)
        self.stream.late_count, self.stream.evicted_count = self.late_count, self.evicted_count

    def buffers(self) -> Sequence[OperandBuffer]:
        """Return the buffers of the node."""
        return [buffer for negation, _ in self.deferred_negations for buffer in negation.buffers()]

    def _input_action(self, channel: int, options: NetworkOptions) -> Emit:
        """Return the action for the matches of one pattern."""
        process = self._operator_input(channel, options)
        passes_match = options.tracks_events or self.spec.build_match_values is None
        reentrancy = self._reentrancy

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            element_match = match if passes_match else None
            if reentrancy is None:
                outputs = process(element_match, match.values, match.start, match.end)
            elif reentrancy.is_running:
                reentrancy.defer(lambda later_frame: self._input_actions[channel](match, later_frame))
                return frame
            else:
                outputs = reentrancy.run_operator(
                    lambda: process(element_match, match.values, match.start, match.end)
                )
                frame = reentrancy.prepend_deferred_work(frame)
            if not outputs:
                return frame
            return self._emit_outputs(
                outputs, frame, arrival_number_of(match) if options.tracks_events else 0
            )

        self._input_actions[channel] = on_match
        return on_match

    def _operator_input(self, channel: int, options: NetworkOptions) -> "OperatorInput":
        """Return a function that passes a match to the operator and returns its outputs.

        The match itself is optional; its values and interval are required.
        """
        key_and_values, uses_clock = self.spec.key_and_values, self.spec.uses_clock or options.emits_revisions
        network, watermark = self.rule.network, self.watermark
        meter = self.rule.meter

        def process(
            match: Optional[PartialMatch], values: Values, start: int, end: int
        ) -> List[StreamOutput]:
            if meter is not None and meter(1):
                return []
            # Reading the clock is avoided for operators that depend on time stamps only.
            now = network.alarm_time() - watermark.delay if uses_clock else 0
            stream = self.stream
            pruned_count, ahead_count = stream.pruned_count, stream.ahead_count
            if self.replay is not None:
                self.replay.begin_step(stream)
            try:
                element = StreamElement(match, start, end, *key_and_values(values))
                outputs = stream.process(element, now, channel)
            except (RuleError, TermTooLarge) as error:
                network.report_rule_error(self.rule, error)
                return []
            if self.replay is not None:
                self._record_element(channel, element, now)
            if stream.late_count != self.late_count or stream.ahead_count != ahead_count:
                self._report_wrong_time(stream.ahead_count != ahead_count, end)
            if stream.pruned_count != pruned_count or stream.evicted_count != self.evicted_count:
                self._report_dropped(stream.pruned_count - pruned_count)
            # One element can add several partial matches to a row pattern.
            while len(stream) > network.max_stored:
                outputs = [*outputs, *self._drop_oldest()]
            if stream.next_deadline is not None:
                self._set_alarm()
            return outputs

        return self.spec.with_stamps(process)

    def _report_wrong_time(self, is_ahead: bool, end: int) -> None:
        """Report an element that is too far ahead of the clock, or too late."""
        # An operator that refuses an element ahead of the clock has counted it as late, too.
        self.late_count = self.stream.late_count
        network = self.rule.network
        if is_ahead:
            network.report_ahead(self.rule, end)
        else:
            network.report_late(self.rule, self.spec.late_report)

    def watermark_time(self) -> int:
        """Return the instant that the watermark of the node has reached."""
        return self.rule.network.alarm_time() - self.watermark.delay

    def _drop_oldest(self) -> List[StreamOutput]:
        """Drop the oldest element with its partial matches; return the outputs that follow from that."""
        self.rule.dropped_count += 1
        self.rule.network.report_dropped(self.rule)
        return self.stream.drop_oldest()

    def _report_dropped(self, pruned_count: int = 0) -> None:
        """Count and report dropped partial matches of row patterns, and keys that the operator has dropped.

        Only drops caused by an event are reported: a replay or an explanation processes the same elements again.
        """
        for _ in range(pruned_count):
            self.rule.dropped_count += 1
            self.rule.network.report_dropped(self.rule, MAX_STATES_PER_START)
        for _ in range(self.stream.evicted_count - self.evicted_count):
            self.rule.dropped_count += 1
            self.rule.network.report_dropped_keys(self.rule)
        self.evicted_count = self.stream.evicted_count

    def _set_alarm(self) -> None:
        instant = self.stream.next_deadline
        # An alarm that is set for an earlier instant sets the next one when it runs.
        if instant is not None and (self.alarm_instant is None or instant < self.alarm_instant):
            self.alarm_instant = instant
            self.rule.network.set_node_alarm(self, instant)

    @property
    def serial(self) -> int:
        """See `TimedNode`."""
        return self.rule.serial

    @property
    def active(self) -> bool:
        """See `TimedNode`."""
        return self.rule.active

    def on_alarm(self, instant: int, frame: Frame) -> Frame:
        """Return the frame that emits the outputs that are due, and continues with ``frame``."""
        self.alarm_instant = None
        # The event before is complete. A session ends after events that it precedes, which it may need as partners.
        self.rule.store_deferred()
        # Results that are due belong to no event; skipped matches are discarded before they are emitted.
        if self.rule.skip_state is not None:
            self.rule.skip_state.begin_alarm()
        if self.replay is not None:
            self.replay.begin_step(self.stream)
        reentrancy = self._reentrancy
        if reentrancy is None:
            outputs = self.stream.advance_to(instant)
        else:
            outputs = reentrancy.run_operator(lambda: self.stream.advance_to(instant))
            frame = reentrancy.prepend_deferred_work(frame)
        if self.stream.evicted_count != self.evicted_count:
            self._report_dropped()
        self._set_alarm()
        arrival_number = self.rule.network.tracker.next_alarm_number() if self.stream.tracks_elements else 0
        return self._emit_outputs(outputs, frame, arrival_number)

    def report_alarm_error(self, error: RetalisError) -> None:
        """See `TimedNode.report_alarm_error`."""
        self.rule.network.report_rule_error(self.rule, error)

    def _emit_outputs(self, outputs: List[StreamOutput], frame: Frame, arrival_number: int = 0) -> Frame:
        if self.stream.endless_skip_count and not self._has_reported_skip:
            self._has_reported_skip = True
            self.rule.network.report_endless_skip(self.rule)
        return emit_each(
            metered(self._matches_of(outputs, arrival_number), self.rule.meter), self.emit, frame
        )

    def _matches_of(self, outputs: Iterable[StreamOutput], arrival_number: int = 0) -> Iterator[PartialMatch]:
        """Yield the matches of outputs, without those that are too long or do not unify.

        Args:
            outputs: the outputs.
            arrival_number: number of the event that caused them, if it is none of their own; else 0.
        """
        span = self.span
        for output in outputs:
            if span is None or output.end - output.start <= span:
                match = self._match_of(output, arrival_number)
                if match is not None:
                    yield match

    def _match_of(self, output: StreamOutput, arrival_number: int) -> Optional[PartialMatch]:
        """Return the match of an output; None if its results do not unify with the terms of the rule."""
        newest = output.elements[-1]
        if output.error is not None:
            self.rule.network.report_result_error(self.rule, newest.key_values, output.error)
            return None
        build_match_values = self.spec.build_match_values
        values = () if build_match_values is None else build_match_values(newest.key_values, output.results)
        if values is None:
            return None
        # Each output has its own lineage object, so it can be retracted without the others that contain the same
        # matches.
        repetition_chain = (
            self._create_lineage_chain(output, arrival_number) if self.stream.tracks_elements else ()
        )
        if build_match_values is not None:
            start, end = output.start, output.end
            # Instants that the operator has computed have integer seconds.
            if end is not newest.end or end.__class__ is FloatSeconds:
                start, end = int(start), int(end)
            return PartialMatch(values, start, end, None, None, (ComputedValues(values), *repetition_chain))
        match: PartialMatch = newest.match
        if output.end != match.end:
            return PartialMatch(
                match.values, match.start, int(output.end), None, None, (match, *repetition_chain)
            )
        if not repetition_chain:
            return match
        return PartialMatch(
            match.values, match.start, match.end, match.event, match.term, (match, *repetition_chain)
        )

    def _create_lineage_chain(self, output: StreamOutput, arrival_number: int) -> Tuple[RepetitionChain, ...]:
        """Return the lineage object of an output, which refers to the matches that it consists of."""
        # Elements that arrived while events were not tracked have no match.
        parts = tuple([element.match for element in output.elements if element.match is not None])
        repetition_chain = RepetitionChain(
            PartialMatch((), output.start, output.end, None, None, parts),
            NO_REPETITIONS,
            output.omitted_count,
        )
        repetition_chain.number = max(repetition_chain.number, arrival_number)
        if self.replay is not None:
            self.replay.record_output(output, repetition_chain)
        return (repetition_chain,)

    # ---- retracted events ----------------------------------------------------------------------------

    def _record_element(self, channel: int, element: StreamElement, now: int) -> None:
        """Record an element, and register it with the events that it contains."""
        assert self.replay is not None
        self.replay.record_element(channel, element, now)
        for occurrence in lineage_nodes_of(element.match):
            if not occurrence.forgotten:
                occurrence.dependents.append((self, self, element.match))

    def remove_retracted(self, node: "StreamNode", match: PartialMatch) -> bool:
        """Exclude a match whose events were retracted; return whether the outputs may change."""
        return self.replay is not None and self.replay.remove_retracted(match)

    def invalid_results(self) -> List[RepetitionChain]:
        """Return the lineage objects of outputs that are invalid without the excluded matches."""
        if self.replay is None:
            return []
        rerun = self.replay.run_again(self.watermark_time(), self.rule.meter)
        if rerun is None:
            # Its outputs so far remain valid.
            self._reset_operator()
            return []
        self.stream, missing = rerun
        self.late_count, self.evicted_count = self.stream.late_count, self.stream.evicted_count
        self._set_alarm()
        return missing

    def recompute_results(self, node: "StreamNode") -> List[PartialMatch]:
        """Return the matches that are valid without the excluded matches and were not before."""
        if self.replay is None or not self.rule.active:
            return []
        return list(self._matches_of(self.replay.pop_new_outputs()))

    def retry(self, match: PartialMatch, frame: Frame) -> Frame:
        """Emit a match that `recompute_results` has returned, unless its events were retracted meanwhile."""
        return frame if is_retracted(match) else self.emit(match, frame)

    # ---- state ---------------------------------------------------------------------------------------

    def return_to(self, instant: int) -> None:
        """Set the time of the operator back; see `StreamOperator.return_to`."""
        if self._defer_if_running(lambda: self.return_to(instant)):
            return
        self.stream.return_to(instant)
        # Elements that are recorded for a replay would move its time again, so earlier results become final.
        if self.replay is not None:
            self.replay = Replay(
                partial(self._create_operator, self._options or NetworkOptions(), self.rule.meter),
                self.stream.snapshot(),
            )
        self._set_alarm()

    def clear(self) -> None:
        """Reset the operator."""
        if not self._defer_if_running(self.clear):
            self._reset_operator()

    def _reset_operator(self) -> None:
        options = self._options or NetworkOptions()
        self.stream = self._create_operator(options, self.rule.meter)
        self.replay = (
            Replay(partial(self._create_operator, options, self.rule.meter))
            if options.emits_revisions
            else None
        )
        self.alarm_instant = None
        self.late_count = self.evicted_count = 0

    def stored_count(self) -> int:
        """Return the number of matches, or keys, in the operator's state."""
        return len(self.stream)

    def keys(self) -> int:
        """Return the number of keys that have a state."""
        return self.stream.keys

    def bytes(self) -> int:
        """Return an estimate of the memory of the state."""
        return self.stream.bytes

    def restore(self, saved: State) -> None:
        """Set the state of the node; see `NetworkNode.restore`."""
        super().restore(saved)
        # Not all operators have it in their states; a difference would be reported as a late element.
        self.stream.late_count = self.late_count
        self._set_alarm()

    def check_element(self, element: StreamElement, channel: int) -> None:
        """Check an element of a restored state.

        Raises:
            UsageError: if it is not one that the pattern of a channel makes.
        """
        example = self.spec.create_element(None, (1,) * len(self.children[0].vars), 1, 1)
        keys, values = example.key_values, example.values
        if (
            len(element.key_values) != len(keys)
            or len(element.values) != len(values)
            or any(measured is None for measured in element.values)
        ):
            expected = f"an element with {len(keys)} key values and {len(values)} measured values"
            raise invalid_value((element.key_values, element.values), expected)
        match = element.match
        needs_match = self.spec.build_match_values is None and self.stream.emits_stored_elements
        if needs_match if match is None else not self.children[channel].accepts(match):
            raise invalid_value(match, "an element with a match of its pattern")

    def can_receive(self, received_elements: Sequence[ReceivedElement]) -> bool:
        """Return whether elements belong to their channels.

        Raises:
            UsageError: if one does not match the pattern of its channel.
        """
        for received in received_elements:
            if received.channel >= len(self.children):
                return False
            self.check_element(received.element, received.channel)
        return True

    def buffer_checks(self, saved: State) -> List[MatchCheck]:
        """See `NetworkNode.buffer_checks`."""
        return checks_of_negations(self.deferred_negations)

    def has_entry(self, owner: object, entry: object) -> bool:
        """See `NetworkNode.has_entry`."""
        return owner is self and isinstance(entry, EventMatch)
