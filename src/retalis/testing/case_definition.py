"""Definition of a test case: a program, its input by time, and the expectations.

Times are nanoseconds since the start of the case. `case_file` reads definitions, `case_run` executes them.
"""

from enum import Enum
from pathlib import Path
from typing import Any, Mapping, NamedTuple, Optional, Tuple

from ..foundation.displayed_text import format_number
from ..foundation.source_places import Place
from ..prolog.terms.timestamps import SECOND
from .yaml_documents import YamlValue

DEFAULT_START = 1_000_000_000 * 10**9
"""Start of a case without bags in nanoseconds since the epoch."""

DEFAULT_WITHIN = 10**6
"""Allowed difference in nanoseconds between an expected and an actual time: times are written with few digits."""


ROUNDING = 1e-15
"""Relative difference that is always allowed: a few units in the last place of a float."""


class Tolerance(NamedTuple):
    """Allowed difference between numbers: the larger of an absolute one, and one relative to the expected number."""

    absolute: float = 0.0
    relative: float = 0.0

    def accepts(self, expected: float, actual: float) -> bool:
        """Return whether two numbers differ by no more than the tolerance, or by the rounding of a few operations."""
        # Also true for infinities, whose difference is not a number; "not a number" is expected as such.
        if expected == actual or (expected != expected and actual != actual):
            return True
        if isinstance(expected, int) and isinstance(actual, int) and not (self.absolute or self.relative):
            return False
        try:
            return abs(expected - actual) <= max(self.absolute, (self.relative + ROUNDING) * abs(expected))
        except OverflowError:
            # An integer beyond the range of floats differs from all others by more than any tolerance.
            return False


class SourceText(NamedTuple):
    """A text of the program within a test file."""

    text: str
    first_line: int


class TermText(NamedTuple):
    """The text of a term, and its place."""

    text: str
    place: Place


class CaseEvent(NamedTuple):
    """An input event.

    Attributes:
        time: time at which it is received, which is its end by default.
        start: start of the event; None for an event without duration.
        end: end of the event; None for ``time``.
    """

    time: int
    start: Optional[int]
    end: Optional[int]
    event: TermText


class CaseMessage(NamedTuple):
    """An input message.

    Attributes:
        time: time of its receipt.
        topic: name of the topic.
        type: message type; None for that of ``pub_sub.xml``.
        value: the slots; None for a message of zeros.
        place: its place in the file.
    """

    time: int
    topic: str
    type: Optional[str]
    value: Optional[YamlValue]
    place: Place


class ServiceAnswer(NamedTuple):
    """A prepared answer of a ROS service.

    Attributes:
        request: slots of the requests that it answers; None for all requests.
        reply: slots of the reply, while others are zero; None if ``error`` is the answer.
        error: reason of a failure.
        delay: nanoseconds until the answer.
        max_calls: number of calls that it answers; None for all.
        place: its place in the file.
    """

    name: str
    request: Optional[YamlValue]
    reply: Optional[YamlValue]
    error: str
    delay: int
    max_calls: Optional[int]
    place: Place


class InputBag(NamedTuple):
    """Messages of a bag, which keep their times: the case starts with the first one.

    Attributes:
        start: seconds to skip.
        duration: seconds to play; None for all.
        topics: topics to play; empty for all.
        place: its place in the file.
    """

    path: Path
    start: float
    duration: Optional[float]
    topics: Tuple[str, ...]
    place: Place


class InputId(NamedTuple):
    """Identity of an event or message of the input.

    Attributes:
        topic: topic of a message; "" for an event.
        time: time of its receipt.
        number: its number, from 0 on, among the events, or the messages of the topic, of this time.
    """

    topic: str
    time: int
    number: int


class MutationType(Enum):
    """Types of changes of an input."""

    LOST = "lost"
    DELAYED = "delayed"
    OVERTAKEN = "overtaken"
    REPEATED = "repeated"
    RESTAMPED = "restamped"


class Mutation(NamedTuple):
    """A change of one event or message of the input.

    Attributes:
        amount: nanoseconds by which the receipt is later, or by which the stamp differs; 0 if neither changes.
        next_input: input after which it is received, if it is overtaken.
    """

    type: MutationType
    input: InputId
    amount: int = 0
    next_input: Optional[InputId] = None


class CountRange(NamedTuple):
    """Allowed numbers of occurrences."""

    minimum: int
    maximum: Optional[int]

    def accepts(self, count: int) -> bool:
        """Return whether a number is allowed."""
        return count >= self.minimum and (self.maximum is None or count <= self.maximum)

    def __str__(self) -> str:
        if self.maximum == self.minimum:
            return str(self.minimum)
        return f"at least {self.minimum}" if self.maximum is None else f"{self.minimum} to {self.maximum}"


class ExpectedItem(NamedTuple):
    """An expected output or event. Attributes that are None are not compared.

    Attributes:
        term: pattern of the term.
        message: slots of the message by name.
        id: id of the subscription of an output.
        time: time of an output, or the end of an event.
        within: allowed difference of the times.
        tolerance: allowed difference of numbers.
        slot_tolerances: tolerances of slots of the message, by path, as ``pose.position.x``.
        occurrences: allowed number of occurrences, with relation ``contains``.
        place: its place in the file.
    """

    term: Optional[TermText]
    message: Optional[YamlValue]
    topic: Optional[str]
    id: Optional[TermText]
    time: Optional[int]
    start: Optional[int]
    within: int
    tolerance: Tolerance
    slot_tolerances: Mapping[str, Tolerance]
    occurrences: Optional[CountRange]
    place: Place


class ExpectedSequence(NamedTuple):
    """An expectation of the outputs or the events of a case.

    Attributes:
        subject: ``outputs`` or ``events``.
        relation: ``exactly``, ``contains``, ``in_order``, ``none`` or ``count``.
        occurrences: allowed number of all, if the relation is ``count``.
        place: its place in the file.
    """

    subject: str
    relation: str
    items: Tuple[ExpectedItem, ...]
    occurrences: Optional[CountRange]
    place: Place


class ExpectedAnswer(NamedTuple):
    """The expected answer of a query.

    Attributes:
        time: time of the query; None for the end.
        query: the goal.
        solutions: values by variable name for each solution; None if only the existence of a solution matters.
        has_solution: whether there has to be a solution.
        tolerance: allowed difference of numbers.
        place: its place in the file.
    """

    time: Optional[int]
    query: TermText
    solutions: Optional[Tuple[Mapping[str, TermText], ...]]
    has_solution: bool
    tolerance: Tolerance
    place: Place

    @property
    def title(self) -> str:
        """The query with its time, for failures."""
        instant = "the end" if self.time is None else f"{format_number(self.time / SECOND)} s"
        return f"query {self.query.text} at {instant}"


class Expectations(NamedTuple):
    """All expectations of a case.

    Attributes:
        sequences: expectations of outputs and events.
        golden: file with the expected outputs.
        answers: expected answers of queries.
        errors: parts of the expected errors; each error has to contain an entry.
        warnings: parts of the expected warnings; None if warnings do not matter.
        place: their place in the file.
    """

    sequences: Tuple[ExpectedSequence, ...] = ()
    golden: Optional[Path] = None
    answers: Tuple[ExpectedAnswer, ...] = ()
    errors: Tuple[str, ...] = ()
    warnings: Optional[Tuple[str, ...]] = None
    place: Optional[Place] = None


class CaseProgram(NamedTuple):
    """Program of a case, with its topics, facts and parameters.

    Attributes:
        folder: its folder; None for a program in the file.
        rules: rules in the file.
        goals: goals in the file.
        topics: topics and types, in addition to those of ``pub_sub.xml``.
        facts: facts that are added when the program is loaded.
        parameters: parameters of the node, by name.
        path: the test file.
        services: answers of ROS services that the program calls.
        ros_parameters: ROS parameters that goals read, by name.
        has_parameters: whether the file gives parameters, also none: a goal that reads another one has no warning.
    """

    folder: Optional[Path]
    rules: Optional[SourceText]
    goals: Optional[SourceText]
    topics: Tuple[Tuple[str, str], ...]
    facts: Tuple[TermText, ...]
    parameters: Tuple[Tuple[str, Any], ...]
    path: Path
    services: Tuple[ServiceAnswer, ...] = ()
    ros_parameters: Tuple[Tuple[str, Any], ...] = ()
    has_parameters: bool = False


class Case(NamedTuple):
    """A test case.

    Attributes:
        name: its name, unique in the file.
        start: time of its start in nanoseconds since the epoch; None for that of its bags, or `DEFAULT_START`.
        events: input events by time.
        messages: input messages by time.
        end: time to which the clock advances after the input; None for the end of the input.
        timeout: limit in seconds for its execution.
        place: its place in the file.
        mutations: changes of the input, also none, if the case is a try of the fuzzer; None otherwise.
    """

    name: str
    program: CaseProgram
    start: Optional[int]
    events: Tuple[CaseEvent, ...]
    messages: Tuple[CaseMessage, ...]
    bags: Tuple[InputBag, ...]
    end: Optional[int]
    expectations: Expectations
    timeout: float
    place: Place
    mutations: Optional[Tuple[Mutation, ...]] = None

    @property
    def path(self) -> Path:
        """The file of the case."""
        return self.program.path
