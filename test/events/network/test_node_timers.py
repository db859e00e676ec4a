"""Deadlines of nodes: order, independence, and a single alarm of the clock."""

from types import SimpleNamespace
from typing import Any, Dict, List, Optional, Tuple, Union

import pytest
from events.program_runner import ProgramRunner, format_events
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import StreamClock
from retalis.events.matches.watermarks import PatternWatermark
from retalis.events.network.node_timers import NodeTimers


class Node:
    """A node that records its alarms, and requests further ones."""

    def __init__(self, timer_bench: Any, name: Any, serial: Any, position: int = 0) -> None:
        self.timer_bench = timer_bench
        self.name = name
        self.serial = serial
        self.active = True
        self.position = position
        self.watermark = PatternWatermark()
        self.alarm_instant: Optional[int] = None
        self.next_instants: List[Any] = []

    def request(self, instant: int) -> None:
        """Request an alarm at an instant, unless an earlier one is requested."""
        if self.alarm_instant is None or instant < self.alarm_instant:
            self.alarm_instant = instant
            self.timer_bench.deadlines.add(self, instant)

    def on_alarm(self, instant: Any, frame: Any) -> Any:
        self.alarm_instant = None
        self.timer_bench.alarms.append((instant, self.name))
        for instant_or_error in self.next_instants[:1]:
            del self.next_instants[:1]
            if isinstance(instant_or_error, Exception):
                raise instant_or_error
            self.request(instant_or_error)
        return frame


class TimerBench:
    """Node timers with a clock, and a machine that does nothing."""

    def __init__(self) -> None:
        machine: Any = SimpleNamespace(done=None, run=lambda frame: frame)
        self.clock = StreamClock()
        dispatcher: Any = SimpleNamespace(run_without_context=lambda work: work())
        self.deadlines = NodeTimers(self.clock, dispatcher, machine)
        self.alarms: List[Any] = []

    def node(self, name: Union[str, int], serial: int, position: int = 0) -> Node:
        return Node(self, name, serial, position)

    def advance_to(self, instant: int) -> Tuple[Any, ...]:
        """Move the clock to an instant; return the alarms that ran, and the errors that they raised."""
        self.alarms = []
        self.clock.move_to(instant)
        errors: List[Any] = []
        while True:
            due = self.clock.due()
            if due is None:
                return self.alarms, errors
            try:
                due[1](due[0])
            except ValueError as error:
                errors.append(str(error))


def test_alarms_are_ordered_by_instant_rule_and_node() -> None:
    timer_bench = TimerBench()
    nodes = {
        name: timer_bench.node(name, serial, position)
        for name, serial, position in [("b0", 2, 0), ("a1", 1, 1), ("a0", 1, 0), ("c", 3, 0)]
    }
    for name, instant in (("b0", 50), ("a1", 50), ("c", 40), ("a0", 50)):
        nodes[name].request(instant)
    assert timer_bench.advance_to(39) == ([], [])
    assert timer_bench.advance_to(100) == ([(40, "c"), (50, "a0"), (50, "a1"), (50, "b0")], [])
    assert len(timer_bench.deadlines) == 0


def test_alarm_may_request_next_alarm() -> None:
    timer_bench = TimerBench()
    first, second = timer_bench.node("one", 1), timer_bench.node("two", 2)
    first.next_instants = [15, 30, 200]
    first.request(10)
    second.request(20)
    assert timer_bench.advance_to(100) == ([(10, "one"), (15, "one"), (20, "two"), (30, "one")], [])
    assert timer_bench.clock.next_alarm() == 200


def test_error_of_alarm_leaves_other_alarms() -> None:
    timer_bench = TimerBench()
    for serial in (1, 2, 3):
        node = timer_bench.node(serial, serial)
        node.next_instants = [ValueError(f"of {serial}")] if serial < 3 else []
        node.request(10)
    assert timer_bench.advance_to(10) == ([(10, 1), (10, 2), (10, 3)], ["of 1", "of 2"])


def test_earlier_request_replaces_later_one() -> None:
    timer_bench = TimerBench()
    node = timer_bench.node("a", 1)
    node.request(50)
    node.request(20)
    assert timer_bench.advance_to(100) == ([(20, "a")], [])


@pytest.mark.parametrize("later", [10, 60])
def test_inactive_rule_has_no_alarms(later: int) -> None:
    timer_bench = TimerBench()
    inactive, active = timer_bench.node("gone", 1), timer_bench.node("here", 2)
    inactive.request(10)
    active.request(later)
    inactive.active = False
    assert timer_bench.advance_to(100) == ([(later, "here")], [])


def test_reset_of_clock_clears_alarms() -> None:
    timer_bench = TimerBench()
    node = timer_bench.node("a", 1)
    node.request(50)
    timer_bench.clock.reset()
    timer_bench.deadlines.clear()
    node.alarm_instant = None
    assert (len(timer_bench.deadlines), timer_bench.advance_to(60)) == (0, ([], []))
    node.request(70)
    assert timer_bench.advance_to(80) == ([(70, "a")], [])


def test_node_alarm_precedes_others_of_same_instant() -> None:
    """A restored engine, which sets the alarm again, therefore continues in the same order."""
    timer_bench = TimerBench()
    timer_bench.clock.call_at(50, lambda instant: timer_bench.alarms.append((instant, "alarm")))
    timer_bench.node("a", 1).request(50)
    assert timer_bench.advance_to(50) == ([(50, "a"), (50, "alarm")], [])


def test_requests_do_not_accumulate() -> None:
    """A node that requests a distant alarm again and again has one entry for it."""
    timer_bench = TimerBench()
    nodes = [timer_bench.node(number, number) for number in range(3)]
    for node in nodes:
        node.request(1_000_000)
    for instant in range(1000):
        nodes[instant % 3].next_instants = [1_000_000]
        nodes[instant % 3].request(instant)
        assert timer_bench.advance_to(instant)[0] == [(instant, instant % 3)]
        assert len(timer_bench.deadlines) <= 2 * len(nodes) + 64
        assert len(timer_bench.clock.alarms) <= 2
    assert timer_bench.advance_to(1_000_000)[0] == [(1_000_000, number) for number in range(3)]


REQUESTS = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 30), st.booleans()), max_size=30)


@settings(max_examples=50)
@given(REQUESTS)
def test_node_alarm_runs_at_earliest_request(requests: Any) -> None:
    timer_bench = TimerBench()
    nodes = [timer_bench.node(number, number % 2, number) for number in range(5)]
    waiting: Dict[Any, Any] = {}
    now = 0
    for number, ahead, is_advanced in requests:
        nodes[number].request(now + ahead)
        waiting[number] = min(waiting.get(number, now + ahead), now + ahead)
        if is_advanced:
            now += 10
            due = {(instant, node % 2, node) for node, instant in waiting.items() if instant <= now}
            waiting = {node: instant for node, instant in waiting.items() if instant > now}
            assert timer_bench.advance_to(now)[0] == [(instant, node) for instant, _, node in sorted(due)]


def test_deleted_rule_has_no_alarms() -> None:
    program = ProgramRunner("l : o(N) <- aggregate(count, in(_), N, every(2)).", clock=StreamClock())
    rules = program.engine.rules
    (rule,) = rules.rules
    program.feed("in(1)@1")
    assert rule.active
    assert program.engine.call("del_event_rule(l)")
    assert not rule.active
    assert not rules.rules
    program.feed("other@9")
    assert format_events(program.events) == "other@9-9"
