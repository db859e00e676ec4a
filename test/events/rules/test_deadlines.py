"""Deadlines of nodes: order, independence, and a single alarm of the clock."""

from types import SimpleNamespace

import pytest
from events.stream_programs import ProgramRunner, format_events
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import StreamClock
from retalis.events.matches.watermarks import PatternWatermark
from retalis.events.rules.timer_service import NodeTimers


class Node:
    """A node that notes when it rings, and asks for more."""

    def __init__(self, bench, name, serial, place=0):
        self.bench = bench
        self.name = name
        self.rule = SimpleNamespace(serial=serial, active=True)
        self.position = place
        self.watermark = PatternWatermark()
        self.alarm_instant = None
        self.more = []

    def ask(self, instant):
        """Be wakeup_time at an instant, if not earlier."""
        if self.alarm_instant is None or instant < self.alarm_instant:
            self.alarm_instant = instant
            self.bench.deadlines.add(self, instant)

    def on_alarm(self, instant, frame):
        self.alarm_instant = None
        self.bench.rung.append((instant, self.name))
        for one in self.more[:1]:
            del self.more[:1]
            if isinstance(one, Exception):
                raise one
            self.ask(one)
        return frame


class Bench:
    """Deadlines with a clock and a machine that does nothing."""

    def __init__(self):
        machine = SimpleNamespace(done=None, run=lambda frame: frame)
        self.clock = StreamClock()
        rules = SimpleNamespace(
            clock=self.clock,
            logic=SimpleNamespace(machine=machine),
            dispatcher=SimpleNamespace(run_without_context=lambda work: work()),
        )
        self.deadlines = NodeTimers(rules)
        self.rung = []

    def node(self, name, serial, place=0):
        return Node(self, name, serial, place)

    def reach(self, instant):
        """Let the clock come to an instant; return what rang, and which errors were raised."""
        self.rung = []
        self.clock.move_to(instant)
        errors = []
        while True:
            due = self.clock.due()
            if due is None:
                return self.rung, errors
            try:
                due[1](due[0])
            except ValueError as error:
                errors.append(str(error))


def test_in_the_order_of_instants_then_of_rules_then_of_their_nodes():
    bench = Bench()
    nodes = {
        name: bench.node(name, *at) for name, *at in [("b0", 2, 0), ("a1", 1, 1), ("a0", 1, 0), ("c", 3)]
    }
    for name, instant in (("b0", 50), ("a1", 50), ("c", 40), ("a0", 50)):
        nodes[name].ask(instant)
    assert bench.reach(39) == ([], [])
    assert bench.reach(100) == ([(40, "c"), (50, "a0"), (50, "a1"), (50, "b0")], [])
    assert len(bench.deadlines) == 0


def test_what_is_asked_for_while_one_rings_rings_too():
    bench = Bench()
    one, two = bench.node("one", 1), bench.node("two", 2)
    one.more = [15, 30, 200]
    one.ask(10)
    two.ask(20)
    assert bench.reach(100) == ([(10, "one"), (15, "one"), (20, "two"), (30, "one")], [])
    assert bench.clock.next_alarm() == 200


def test_an_error_in_one_does_not_keep_the_others_from_ringing():
    bench = Bench()
    for serial in (1, 2, 3):
        node = bench.node(serial, serial)
        node.more = [ValueError(f"of {serial}")] if serial < 3 else []
        node.ask(10)
    assert bench.reach(10) == ([(10, 1), (10, 2), (10, 3)], ["of 1", "of 2"])


def test_an_earlier_wish_takes_the_place_of_a_later_one():
    bench = Bench()
    node = bench.node("a", 1)
    node.ask(50)
    node.ask(20)
    assert bench.reach(100) == ([(20, "a")], [])


@pytest.mark.parametrize("later", [10, 60])
def test_of_a_rule_that_takes_no_events_any_more_nothing_rings(later):
    bench = Bench()
    gone, here = bench.node("gone", 1), bench.node("here", 2)
    gone.ask(10)
    here.ask(later)
    gone.rule.active = False
    assert bench.reach(100) == ([(later, "here")], [])


def test_a_clock_that_goes_back_clears():
    bench = Bench()
    node = bench.node("a", 1)
    node.ask(50)
    bench.clock.reset()
    bench.deadlines.clear()
    node.alarm_instant = None
    assert (len(bench.deadlines), bench.reach(60)) == (0, ([], []))
    node.ask(70)
    assert bench.reach(80) == ([(70, "a")], [])


def test_its_alarm_rings_before_others_of_the_same_instant():
    """So an engine that was put back from a snapshot, where it is set anew, goes on in the same order."""
    bench = Bench()
    bench.clock.call_at(50, lambda instant: bench.rung.append((instant, "alarm")))
    bench.node("a", 1).ask(50)
    assert bench.reach(50) == ([(50, "a"), (50, "alarm")], [])


def test_neither_wishes_nor_alarms_pile_up():
    """One node that waits for what is far away, and is wakeup_time before again and again, waits for it once."""
    bench = Bench()
    nodes = [bench.node(number, number) for number in range(3)]
    for node in nodes:
        node.ask(1_000_000)
    for instant in range(1000):
        nodes[instant % 3].more = [1_000_000]
        nodes[instant % 3].ask(instant)
        assert bench.reach(instant)[0] == [(instant, instant % 3)]
        assert len(bench.deadlines) <= 2 * len(nodes) + 64
        assert len(bench.clock.alarms) <= 2
    assert bench.reach(1_000_000)[0] == [(1_000_000, number) for number in range(3)]


WISHES = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 30), st.booleans()), max_size=30)


@settings(max_examples=50)
@given(WISHES)
def test_each_rings_at_the_earliest_instant_that_it_asked_for(wishes):
    bench = Bench()
    nodes = [bench.node(number, number % 2, number) for number in range(5)]
    waiting = {}
    now = 0
    for number, ahead, reach in wishes:
        nodes[number].ask(now + ahead)
        waiting[number] = min(waiting.get(number, now + ahead), now + ahead)
        if reach:
            now += 10
            due = {(instant, one % 2, one) for one, instant in waiting.items() if instant <= now}
            waiting = {one: instant for one, instant in waiting.items() if instant > now}
            assert bench.reach(now)[0] == [(instant, one) for instant, _, one in sorted(due)]


def test_a_rule_that_was_taken_out_is_not_woken_any_more():
    program = ProgramRunner("l : o(N) <- aggregate(count, in(_), N, every(2)).", clock=StreamClock())
    rules = program.engine.rules
    (rule,) = rules.rules
    program.feed("in(1)@1")
    assert rule.active
    assert program.engine.call("del_event_rule(l)")
    assert not rule.active and not rules.rules
    program.feed("other@9")
    assert format_events(program.events) == "other@9-9"
