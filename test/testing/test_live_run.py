"""Runs of cases on a node whose outputs and clock are scripted."""

from contextlib import contextmanager
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

import pytest
from testing.case_texts import parse_case

from retalis import Definitions, UsageError
from retalis.messages.type_definition import Definition, SerializationFormat
from retalis.testing.case_run import CaseResult
from retalis.testing.live_run import LiveNode, ProblemCounts, ReceivedText, run_live_case

SECOND = 10**9


class ScriptedNode:
    """A node that publishes texts at given times; see `LiveNode`.

    Args:
        texts: pairs of a time in seconds and a text.
        answers: solutions by goal.
        counts: results of `count_problems`, one after the other.

    Attributes:
        sent: times in seconds, and what was sent or asked.
        patterns: requested events.
        topics: names of the types of published topics.
        is_closed: whether the run has ended.
    """

    start = 1000 * SECOND
    watch_topic = "retalis_watch_7"
    format = SerializationFormat.ROS1

    def __init__(
        self,
        *texts: Tuple[float, str],
        answers: Optional[Mapping[str, Any]] = None,
        counts: Sequence[Any] = ((0, 0, {}), (0, 0, {})),
    ):
        self._texts = [ReceivedText(round(time * SECOND), text) for time, text in texts]
        self._answers = answers or {}
        self._counts = list(counts)
        self._time = 0
        self.sent: List[Tuple[float, Any]] = []
        self.patterns: Sequence[str] = ()
        self.topics: Dict[str, str] = {}
        self.is_closed = False

    @contextmanager
    def open(self, patterns: Sequence[str], topics: Mapping[str, Definition]) -> Iterator[LiveNode]:
        self.patterns = patterns
        self.topics = {topic: definition.name for topic, definition in topics.items()}
        yield self
        self.is_closed = True

    @property
    def seconds(self) -> float:
        return self._time / SECOND

    def now(self) -> int:
        return self._time

    def receive(self, until: int) -> Optional[ReceivedText]:
        if self._texts and self._texts[0].time <= until:
            text = self._texts.pop(0)
            self._time = max(self._time, text.time)
            return text
        self._time = max(self._time, until)
        return None

    def send_event(self, text: str) -> None:
        self.sent.append((self.seconds, text))

    def send_message(self, topic: str, message: bytes) -> None:
        self.sent.append((self.seconds, (topic, message)))

    def query(self, goal: str, max_solutions: int) -> Sequence[Mapping[str, str]]:
        self.sent.append((self.seconds, goal))
        if goal not in self._answers:
            raise UsageError("syntax error")
        solutions: Sequence[Mapping[str, str]] = self._answers[goal]
        return solutions[:max_solutions]

    def count_problems(self) -> ProblemCounts:
        return ProblemCounts(*self._counts.pop(0))


def run(node: ScriptedNode, definitions: Definitions, text: str, seconds: float = 30) -> CaseResult:
    """Run a case with keys in a line."""
    case = parse_case(f"rules: a <- b.\ncases: [{{name: x, {text}}}]")
    return run_live_case(case, node.open, definitions, {"scale": "std_msgs/Int8"}, seconds)


def output(term: str, topic: str = "alarm") -> str:
    return f"event({term},{topic},s1)"


def test_input_is_sent_at_its_time(definitions: Definitions) -> None:
    node = ScriptedNode()
    inputs = (
        "{at: 2, event: 'f(a, \"b c\")'}, {at: 2, topic: scale, message: {data: 3}}, "
        "{at: 0.5, event: g, interval: [-1, 0.25]}"
    )
    result = run(node, definitions, f"input: [{inputs}], expect: {{}}")
    assert result.failures == ()
    stamps = "[datime(1970,1,1,0,16,39,0),datime(1970,1,1,0,16,40,250000000)]"
    assert node.sent == [
        (0.5, f"event(g,{stamps})"),
        (2, ("scale", b"\x03")),
        (2, 'event(f(a,"b c"))'),
    ]
    assert node.topics == {"scale": "std_msgs/Int8"}
    assert node.seconds == 2
    assert node.is_closed


@pytest.mark.parametrize(
    ("expect", "seconds"),
    [
        ("outputs: {contains: [a]}", 1),
        ("outputs: {contains: [a, b]}", 3),
        ("outputs: {in_order: [a, b], count: {min: 2}}", 3),
        ("outputs: {contains: [{term: a, count: {min: 1}}]}", 1),
        ("outputs: {contains: [{term: a, count: 1}]}", 30),
        ("outputs: {contains: [a], none: [c]}", 30),
        ("outputs: [a, b]", 30),
        ("outputs: {count: 2}", 30),
        ("outputs: {contains: [{term: b, at: 3.4}]}", 3),
        ("state: [{at: 7, query: q, expect: true}]", 7),
        ("state: [{query: q, expect: true}]", 30),
    ],
)
def test_run_ends_when_nothing_is_open(definitions: Definitions, expect: str, seconds: float) -> None:
    node = ScriptedNode((1, output("a")), (3, output("b")), answers={"q": [{}]})
    assert run(node, definitions, f"expect: {{{expect}}}").failures == ()
    assert node.seconds == seconds


@pytest.mark.parametrize(
    ("keys", "seconds"),
    [("until: 4", 4), ("until: 90", 90), ("", 30), ("input: [{at: 50, event: a}]", 50)],
)
def test_run_ends_at_limit(definitions: Definitions, keys: str, seconds: float) -> None:
    node = ScriptedNode()
    result = run(node, definitions, f"{keys + ', ' if keys else ''}expect: {{outputs: none}}")
    assert result == CaseResult((), (), seconds)


def test_output_after_end_is_missing(definitions: Definitions) -> None:
    node = ScriptedNode((5, output("a")))
    (failure,) = run(node, definitions, "until: 4, expect: {outputs: {contains: [a]}}").failures
    assert failure == "mine_test.yaml:2: outputs: 1 not found as expected\n  -             a"


def test_output_during_long_action_is_compared(definitions: Definitions) -> None:
    class BusyNode(ScriptedNode):
        def send_event(self, text: str) -> None:
            # Returns after the end of the case.
            super().send_event(text)
            self._time = 6 * SECOND

    node = BusyNode((1, output("a")), (5, output("b")))
    keys = "until: 4, input: [{at: 0, event: f}], expect: {outputs: [a]}"
    assert run(node, definitions, keys).failures == ()


def test_expectations_of_outputs_and_events_are_separate(definitions: Definitions) -> None:
    node = ScriptedNode(
        (1, output("high(4)", "retalis_watch_7")),
        (1, output("high(9)", "retalis_watch_8")),
        (2, "no text of an output"),
        (2, "event(alarm,1)"),
        (2, output("std_msgs__0__Int8(4)")),
    )
    expect = "events: [high(4)], outputs: [{topic: alarm, id: s1, at: 2.1, message: {data: 4}}]"
    assert run(node, definitions, f"expect: {{{expect}}}").failures == ()
    assert node.patterns == ["high(_)"]


def test_times_differ_by_half_a_second_unless_stated(definitions: Definitions) -> None:
    for within, is_allowed in (("", True), (", within: 0.3", False), (", within: 0.5", True)):
        node = ScriptedNode((1.4, output("a")))
        result = run(node, definitions, f"expect: {{outputs: [{{term: a, at: 1{within}}}]}}")
        assert (result.failures == ()) is is_allowed


def test_queries_are_asked_at_their_times(definitions: Definitions) -> None:
    node = ScriptedNode(answers={"p(X)": [{"X": "f(1)"}, {"X": "[a, 'B']"}], "q": []})
    state = (
        "{at: 2, query: p(X), expect: [{X: f(1)}, {X: \"[a, 'B']\"}]}, {query: q, expect: false}, "
        "{at: 3, query: p(X), expect: {X: f(_)}}, {at: 1, query: wrong(}"
    )
    result = run(node, definitions, f"until: 5, expect: {{state: [{state}]}}")
    assert node.sent == [(1, "wrong("), (2, "p(X)"), (3, "p(X)"), (5, "q")]
    assert result.failures == (
        "mine_test.yaml:2: query wrong( at 1 s: syntax error",
        "mine_test.yaml:2: query p(X) at 3 s: expected X=f(_), found X=f(1); X=[a,'B']",
    )


def test_new_problems_of_node_are_failures(definitions: Definitions) -> None:
    counts = [(3, 5, {"r1": 2, "r2": 1}), (5, 6, {"r1": 2, "r2": 2, "r3": 1})]
    result = run(ScriptedNode(counts=counts), definitions, "until: 1, expect: {}")
    assert result.failures == ("the node reported 2 errors in r2; r3: see its log",)
    result = run(ScriptedNode(counts=counts), definitions, "until: 1, expect: {warnings: none}")
    assert result.failures[1] == "mine_test.yaml:2: the node reported 1 warning: see its log"


@pytest.mark.parametrize(
    ("inputs", "error"),
    [
        ("{at: 0, event: 'f('}", "'f(': "),
        ("{at: 0, topic: other}", "topic 'other' is not in pub_sub.xml: expected the key 'type'"),
        ("{at: 0, topic: scale, message: {size: 3}}", "std_msgs/Int8 has no slot size"),
    ],
)
def test_wrong_input_is_found_before_run(definitions: Definitions, inputs: str, error: str) -> None:
    node = ScriptedNode()
    (failure,) = run(node, definitions, f"input: [{inputs}], expect: {{}}").failures
    assert error in failure
    assert not node.is_closed
