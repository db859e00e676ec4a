"""Execution of a case on a running node: its input is sent at its times, and what the node publishes is compared.

A `LiveNode` is the node with its topics and services; the command implements it for each middleware. The run ends at
its time limit, or earlier if all input has been sent and all expectations hold and cannot be broken by further
outputs: an expectation with an upper bound (``exactly``, ``none``, a largest ``count``) is open until the end.
"""

from typing import (
    Any,
    Callable,
    ContextManager,
    Dict,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Tuple,
)

from ..engine.engine import EVENT_FLAGS
from ..foundation.displayed_text import format_count, printable
from ..foundation.errors import MessageError, RetalisError, SyntaxFault
from ..messages.type_definition import Definition, SerializationFormat, type_name
from ..messages.type_registry import Definitions
from ..node.text_exchange import OUTPUT_EVENT, WATCH
from ..prolog.syntax.event_text import EventReader, to_text
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import read_term
from ..prolog.terms.list_terms import make_list
from ..prolog.terms.timestamps import SECOND, datime
from ..prolog.terms.types import Atom, Functor, Term, deref, functor
from .case_definition import DEFAULT_WITHIN, Case, CaseEvent, ExpectedAnswer, ExpectedItem, ExpectedSequence
from .case_input import find_input_type
from .case_run import CaseResult, compare_solutions, format_failure, list_input_types
from .expectation_checks import Failure, RunItem, SequenceCheck, functor_of
from .message_values import make_input_message
from .term_comparison import read_term_text
from .yaml_documents import CaseFileError

LIVE_WITHIN = SECOND // 2
"""Allowed difference in nanoseconds of times, unless the case states another one."""

MAX_RECEIVED = 100_000
"""Maximum number of outputs and events of a run that are compared."""

_CHECK_INTERVAL = SECOND // 10
"""Least time in nanoseconds between two checks of the expectations."""

_EVENT = functor("event", 1)
_EVENT_WITH_INTERVAL = functor("event", 2)


class ReceivedText(NamedTuple):
    """A text of the node's outputs.

    Attributes:
        time: time of its receipt in nanoseconds since the start of the run.
        text: the text, as ``event(TERM,TOPIC,ID)``.
    """

    time: int
    text: str


class ProblemCounts(NamedTuple):
    """Numbers of errors and warnings that a node has reported, and of errors by the title of a rule."""

    errors: int
    warnings: int
    rule_errors: Mapping[str, int]


class LiveNode(Protocol):
    """A running node during the run of a case.

    Attributes:
        start: start of the run in nanoseconds since the epoch, by the clock of the node.
        watch_topic: topic of the events that the run has requested.
        format: serialization of messages.
    """

    start: int
    watch_topic: str
    format: SerializationFormat

    def now(self) -> int:
        """Return the time since the start of the run in nanoseconds."""

    def receive(self, until: int) -> Optional[ReceivedText]:
        """Return the next text, or None if there is none until a time since the start of the run."""

    def send_event(self, text: str) -> None:
        """Send the text of an event, ``event(TERM)`` or ``event(TERM,[T1,T2])``."""

    def send_message(self, topic: str, message: bytes) -> None:
        """Publish a serialized message on one of the topics of the run."""

    def query(self, goal: str, max_solutions: int) -> Sequence[Mapping[str, str]]:
        """Return the texts of the variables' values for each solution of a goal.

        Raises:
            UsageError: if the goal has an error.
        """

    def count_problems(self) -> ProblemCounts:
        """Return the numbers of errors and warnings since the start of the node."""


OpenNode = Callable[[Sequence[str], Mapping[str, Definition]], ContextManager[LiveNode]]
"""Returns the node for the run of a case, given patterns of requested events, and the types of the topics to publish.

The run starts when the context is entered, after all connections have been made.
"""


def check_live_case(case: Case) -> None:
    """Check that a case can run on a node.

    Raises:
        CaseFileError: with all keys that have no meaning for a running node.
    """
    keys = list(_list_unsupported_keys(case))
    if keys:
        raise CaseFileError(f"a case for a running node cannot have {', '.join(keys)}", case.place)


def _list_unsupported_keys(case: Case) -> Iterator[str]:
    program, expectations = case.program, case.expectations
    values: Dict[str, object] = {
        "rules": program.rules,
        "goals": program.goals,
        "facts": program.facts,
        "parameters": (*program.parameters, *program.ros_parameters),
        "services": program.services,
        "start": case.start is not None,
        "bag": case.bags,
        "golden": expectations.golden,
        "errors": expectations.errors,
        "warnings (except none)": expectations.warnings,
    }
    yield from (key for key, value in values.items() if value)
    sequences = [sequence for sequence in expectations.sequences if sequence.subject == "events"]
    if any(item.start is not None for sequence in sequences for item in sequence.items):
        yield "start of an event"
    if any(sequence.relation == "count" for sequence in sequences):
        yield "count of all events"
    if any(_is_variable(item) for sequence in sequences for item in sequence.items):
        yield "a variable as event"


def _is_variable(item: ExpectedItem) -> bool:
    return item.term is not None and functor_of(read_term_text(item.term, Operators.prolog())) is None


def run_live_case(
    case: Case,
    open_node: OpenNode,
    definitions: Definitions,
    node_types: Mapping[str, str],
    max_seconds: float,
) -> CaseResult:
    """Run a case on a node.

    Args:
        case: a case that `check_live_case` accepts.
        open_node: opens the node.
        definitions: known message types of the middleware.
        node_types: types of the topics that the node subscribes to, by name without slashes at the ends.
        max_seconds: end of the run; a case with the key ``until`` ends then, and none ends before its last input.
    """
    try:
        run = _LiveRun(case, definitions, node_types, int(max_seconds * SECOND))
        with open_node(run.event_patterns, run.topics) as node:
            failures = run.execute(node)
            seconds = node.now() / SECOND
    except RetalisError as error:
        return CaseResult((printable(str(error)),), (), 0.0)
    return CaseResult(tuple(map(format_failure, failures)), (), seconds)


class _Action(NamedTuple):
    """Something to do at a time of the run."""

    time: int
    call: Callable[[LiveNode], object]


class _LiveRun:
    """A run of a case.

    Attributes:
        event_patterns: patterns of the events that the expectations concern.
        topics: types of the topics of the input.
    """

    def __init__(
        self, case: Case, definitions: Definitions, node_types: Mapping[str, str], max_duration: int
    ):
        self._case = case
        self._definitions = definitions
        self._operators = Operators.prolog()
        self._reader = EventReader(self._operators)
        self._outputs: List[RunItem] = []
        self._events: List[RunItem] = []
        self._failures: List[Failure] = []
        self._type_by_functor: Dict[Functor, Optional[Definition]] = {}
        self._is_changed = True
        self._next_check = 0
        self._sequences = [_widen(sequence) for sequence in case.expectations.sequences]
        # An expectation has an upper bound, or a query is asked at the end.
        self._is_open_until_end = any(answer.time is None for answer in case.expectations.answers) or any(
            map(_has_upper_bound, self._sequences)
        )
        types = {**node_types, **list_input_types(case.program)}
        self._input_types = [find_input_type(message, types, definitions) for message in case.messages]
        self.topics = {
            message.topic: definition for message, definition in zip(case.messages, self._input_types)
        }
        self.event_patterns = self._list_event_patterns()
        # Sorting is stable: at the same time, messages precede events, and events precede queries.
        self._actions: List[_Action] = sorted(
            [
                *map(self._schedule_message, range(len(case.messages))),
                *map(self._schedule_event, case.events),
                *self._schedule_queries(),
            ],
            key=lambda action: action.time,
        )
        last_time = self._actions[-1].time if self._actions else 0
        self._end = max(max_duration, last_time) if case.end is None else case.end

    def _list_event_patterns(self) -> List[str]:
        """Return a pattern with variables only for each name of the expected events."""
        terms = [
            read_term_text(item.term, self._operators)
            for sequence in self._sequences
            if sequence.subject == "events"
            for item in sequence.items
            if item.term is not None
        ]
        functors = dict.fromkeys(map(functor_of, terms))
        return [_make_pattern(event_functor) for event_functor in functors if event_functor is not None]

    def _schedule_message(self, number: int) -> _Action:
        message, definition = self._case.messages[number], self._input_types[number]
        # Encoded without effect, so that an error is found before the run.
        make_input_message(message, definition, self._definitions, 0)

        def send(node: LiveNode) -> None:
            instant = node.start + message.time
            data = make_input_message(message, definition, self._definitions, instant, node.format)
            node.send_message(message.topic, data)

        return _Action(message.time, send)

    def _schedule_event(self, event: CaseEvent) -> _Action:
        term = read_term_text(event.event, self._operators, EVENT_FLAGS)

        def send(node: LiveNode) -> None:
            if event.start is None or event.end is None:
                # The node gives it the time of its receipt.
                node.send_event(to_text(_EVENT(term)))
                return
            stamps = [datime(node.start + time) for time in (event.start, event.end)]
            node.send_event(to_text(_EVENT_WITH_INTERVAL(term, make_list(stamps))))

        return _Action(event.time, send)

    def _schedule_queries(self) -> Iterator[_Action]:
        for number, answer in enumerate(self._case.expectations.answers):
            if answer.time is not None:
                yield _Action(answer.time, self._make_query(answer, number))

    def _make_query(self, answer: ExpectedAnswer, number: int) -> Callable[[LiveNode], object]:
        return lambda node: self._check_answer(node, answer, number)

    def execute(self, node: LiveNode) -> List[Failure]:
        """Execute the run, and return the expectations that do not hold."""
        checks = [SequenceCheck(sequence, self._operators, node.start) for sequence in self._sequences]
        before = node.count_problems()
        actions = iter(self._actions)
        action = next(actions, None)
        while True:
            now = node.now()
            if action is not None and action.time <= now:
                action.call(node)
                action = next(actions, None)
                continue
            if now >= self._end:
                break
            if action is None and self._is_settled(checks, node):
                break
            received = node.receive(self._next_wake_up(action))
            if received is not None:
                self._add_text(received, node.watch_topic)
                self._is_changed = True
        self._add_texts_until_end(node)
        for number, answer in enumerate(self._case.expectations.answers):
            if answer.time is None:
                self._check_answer(node, answer, number)
        self._failures[:0] = self._find_failures(checks)
        self._compare_problems(before, node.count_problems())
        return self._failures

    def _add_texts_until_end(self, node: LiveNode) -> None:
        """Add the texts that were received before the end; on a busy computer, an action may last beyond it."""
        received = node.receive(node.now())
        while received is not None and received.time <= self._end:
            self._add_text(received, node.watch_topic)
            received = node.receive(node.now())

    def _is_settled(self, checks: Sequence[SequenceCheck], node: LiveNode) -> bool:
        """Return whether all expectations hold, if there is something to check now."""
        now = node.now()
        if self._is_open_until_end or not self._is_changed or now < self._next_check:
            return False
        is_settled = not self._find_failures(checks)
        self._is_changed = False
        # A check takes longer the more outputs there are, so that there are fewer checks.
        self._next_check = node.now() + max(_CHECK_INTERVAL, 10 * (node.now() - now))
        return is_settled

    def _next_wake_up(self, action: Optional[_Action]) -> int:
        if action is not None:
            return min(self._end, action.time)
        has_check = self._is_changed and not self._is_open_until_end
        return min(self._end, self._next_check) if has_check else self._end

    def _find_failures(self, checks: Sequence[SequenceCheck]) -> List[Failure]:
        failures = [
            check.find_failure(self._outputs if sequence.subject == "outputs" else self._events)
            for sequence, check in zip(self._sequences, checks)
        ]
        return [failure for failure in failures if failure is not None]

    def _add_text(self, received: ReceivedText, watch_topic: str) -> None:
        if len(self._outputs) + len(self._events) >= MAX_RECEIVED:
            return
        output = parse_output(received.text, self._reader)
        if output is None:
            return
        term, topic, name = output
        if topic == watch_topic:
            self._events.append(RunItem(term, received.time, received.time))
        elif not topic.startswith(WATCH):
            definition = self._find_definition(term)
            self._outputs.append(RunItem(term, received.time, received.time, topic, name, definition))

    def _find_definition(self, term: Term) -> Optional[Definition]:
        """Return the type of the message that a term is; None if it is not one."""
        message_functor = functor_of(term)
        if not isinstance(message_functor, Functor):
            return None
        if message_functor not in self._type_by_functor:
            name = type_name(message_functor.name)
            try:
                definition = None if name is None else self._definitions.find(name)
            except MessageError:
                definition = None
            self._type_by_functor[message_functor] = definition
        return self._type_by_functor[message_functor]

    def _check_answer(self, node: LiveNode, answer: ExpectedAnswer, number: int) -> None:
        text, place = answer.query
        try:
            most = 1 if answer.solutions is None else len(answer.solutions) + 1
            solutions = [self._read_solution(values) for values in node.query(text, most)]
        except CaseFileError:
            raise
        except RetalisError as error:
            problem = error.message
        else:
            problem = compare_solutions(answer, solutions, self._operators, node.start)
        if problem:
            self._failures.append(Failure(f"{answer.title}: {problem}", place))

    def _read_solution(self, values: Mapping[str, str]) -> Dict[str, Term]:
        return {name: read_term(value, self._operators).term for name, value in values.items()}

    def _compare_problems(self, before: ProblemCounts, after: ProblemCounts) -> None:
        error_count = after.errors - before.errors
        if error_count > 0:
            rules = [
                rule for rule, count in after.rule_errors.items() if count > before.rule_errors.get(rule, 0)
            ]
            source = f" in {'; '.join(rules)}" if rules else ""
            text = f"the node reported {format_count(error_count, 'error')}{source}: see its log"
            self._failures.append(Failure(text, None))
        warning_count = after.warnings - before.warnings
        if self._case.expectations.warnings is not None and warning_count > 0:
            text = f"the node reported {format_count(warning_count, 'warning')}: see its log"
            self._failures.append(Failure(text, self._case.expectations.place))


def parse_output(text: str, reader: EventReader) -> Optional[Tuple[Term, str, Term]]:
    """Return term, topic and id of a text ``event(TERM,TOPIC,ID)``; None for another text.

    Any node may publish on the topic of these texts.
    """
    try:
        event: Any = deref(reader.read(text))
    except SyntaxFault:
        return None
    if event.__class__ is not tuple or event[0] is not OUTPUT_EVENT:
        return None
    topic = deref(event[2])
    return (event[1], topic.name, event[3]) if isinstance(topic, Atom) else None


def _widen(sequence: ExpectedSequence) -> ExpectedSequence:
    """Return an expectation with `LIVE_WITHIN` in place of the default of cases without a node."""
    items = tuple(
        item._replace(within=LIVE_WITHIN) if item.within == DEFAULT_WITHIN else item
        for item in sequence.items
    )
    return sequence._replace(items=items)


def _has_upper_bound(sequence: ExpectedSequence) -> bool:
    counts = [item.occurrences for item in sequence.items] + [sequence.occurrences]
    return sequence.relation in ("exactly", "none") or any(
        count is not None and count.maximum is not None for count in counts
    )


def _make_pattern(event_functor: object) -> str:
    """Return a pattern with variables only for a functor, or the text of an atom."""
    if isinstance(event_functor, Functor):
        name = to_text(event_functor.atom)
        return f"{name}({','.join('_' * event_functor.arity)})"
    return to_text(event_functor)  # type: ignore[arg-type]
