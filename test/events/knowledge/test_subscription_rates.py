"""Subscriptions ``P with S``: they send what a rule with the same rate operator would emit."""

import pytest
from recording_engine import RecordingEngine

from retalis import Clock, Engine, PrologError
from retalis.prolog.terms.timestamps import SECOND

STREAM = "1:1:a 2:2:a 2:2.5:b 2:3:a 3:4:a 3:6:a 4:6.5:b 4:7:a 4:7.2:a 5:12:a"


def feed(engine, text=STREAM):
    """Give events, each as ``value:stamp:key``; return what has come out, as texts with the instant of that."""
    seen = []
    engine.on_output(lambda term, topic, name: seen.append((engine.show(term), engine.clock.reached())))
    for one in text.split():
        value, at, key = one.split(":")
        engine.event(f"in({key},{value})", float(at))
    engine.clock.move_to(30 * SECOND)
    engine.advance()
    return seen


@pytest.mark.parametrize(
    "shape",
    ["throttle(2)", "throttle(2,K)", "burst(1)", "burst(1,K)", "debounce(1)", "debounce(1,K)", "change(X,K)"],
)
def test_they_send_what_a_rule_lets_through(shape):
    through_rule = Engine()
    through_rule.load(rules=f"out(K,X) <- in(K,X) with {shape}.", goals="subscribe(out(K,X), [], _, t, i)")
    alone = Engine()
    alone.load(goals=f"subscribe(in(K,X) with {shape}, [], out(K,X), t, i)")
    expected = feed(through_rule)
    assert len(expected) > 1
    assert feed(alone) == expected


def test_conditions_are_asked_first_so_that_what_is_not_sent_holds_nothing_up():
    engine = RecordingEngine(
        goals="subscribe(t(X) with throttle(5), [X > 80, Y is X - 80], hot(Y), alarms, 1)"
    )
    for at, value in enumerate((70, 90, 85, 60, 95, 99, 82)):
        engine.event(f"t({value})", at)
    assert [term for term, _, _ in engine.outputs] == ["hot(10)", "hot(2)"]


def test_the_clock_sends_without_an_event_and_before_rules_of_the_same_instant():
    now = [100 * SECOND]
    engine = Engine(Clock(lambda: now[0]))
    engine.load(
        rules="late(X) <- a(X) with debounce(2).", goals="subscribe(a(X) with debounce(2), [], _, t, 1)"
    )
    seen = []
    engine.on_output(lambda term, topic, name: seen.append(engine.show(term)))
    engine.on_event(lambda term, start, end: seen.append(engine.show(term)))
    engine.event("a(1)", 100)
    now[0] += 2 * SECOND
    engine.advance()
    assert seen == ["a(1)", "a(1)", "late(1)"]


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("a(X) with sometimes(1)", "with needs one of throttle(Seconds)"),
        ("a(X) with trottle(1)", "throttle"),
        ("a(X) with throttle(0)", "throttle needs a positive number of seconds"),
        ("a(X) with throttle(1, Y)", "a variable that no event of its pattern binds"),
        ("a(X) with change(Y)", "a variable that no event of its pattern binds"),
        ("a(X) with T", "with needs one of"),
        ("(a(X) seq b) with throttle(1)", "takes single events"),
        ("(a(X) with throttle(1)) with change(X)", "takes single events"),
        ("a(X) with throttle(1) where X > 1", "without further operators"),
        ("a(X) with throttle(1) within 2", "without further operators"),
        ("3 with throttle(1)", "takes single events"),
    ],
)
def test_what_is_no_shape_is_one_error_and_nothing_is_made(pattern, said):
    engine = RecordingEngine()
    with pytest.raises(PrologError, match=r"subscription") as raised:
        engine.call(f"subscribe(({pattern}), [], _, t, 1)")
    assert said in str(raised.value)
    assert not engine.status().subscriptions


def test_what_is_deleted_rings_no_more_and_one_that_is_made_again_knows_nothing():
    engine = RecordingEngine(
        goals="subscribe(a(X) with debounce(2), [], _, t, 1)\nsubscribe(a(X) with throttle(9), [], _, t, 2)"
    )
    engine.event("a(1)", 1)
    assert engine.call("delete_subscription(t, 1), delete_subscription(t, 2)")
    engine.event("b", 9)
    assert [name for _, _, name in engine.outputs] == ["2"]
    engine.call("subscribe(a(X) with throttle(9), [], _, t, 2)")
    engine.event("a(2)", 9.5)
    assert [term for term, _, _ in engine.outputs] == ["a(1)", "a(2)"]


def test_one_that_is_deleted_by_the_event_that_it_takes_is_not_woken_for_it():
    engine = RecordingEngine(goals="subscribe(a(X) with debounce(2), [], _, t, 1)")
    engine.knowledge.subscriptions.items()[0][1].rate_limiter.stop()
    engine.event("a(1)", 1)
    engine.event("b", 9)
    assert engine.outputs == []


def test_what_comes_too_late_or_is_too_much_is_counted_and_said():
    engine = RecordingEngine(goals="subscribe(a(X) with debounce(2, X), [], _, t, 1)")
    reports = []
    engine.reports.warning = lambda text, *rest: reports.append(text)
    rate = engine.knowledge.subscriptions.items()[0][1].rate_limiter
    rate._warn = engine.reports.warning  # noqa: SLF001
    engine.event("b", 10)
    engine.event("a(1)", 1)
    engine.rules.max_stored = 2
    for number in (2, 3, 4):
        engine.event(f"a({number})", 10)
    one = engine.status().subscriptions[0]
    assert (one.late, one.dropped, one.sent) == (1, 1, 0)
    assert [text.split(";")[-1] for text in reports] == [
        " 1 so far",
        " 1 of the oldest have been dropped so far",
    ]
    assert "with debounce(2" in one.event


def test_a_clock_that_goes_back_and_a_program_that_resets_have_them_forget():
    goal = "subscribe(a(X) with throttle(100), [], _, t, 1)\nsubscribe(a(X) with debounce(2), [], _, t, 2)"
    for reset in ("reset_db", "reset_etalis_state"):
        engine = RecordingEngine(goals=goal)
        engine.event("a(1)", 1)
        engine.call(reset)
        engine.event("b", 9)
        engine.event("a(2)", 10)
        assert [(term, name) for term, _, name in engine.outputs] == [("a(1)", "1"), ("a(2)", "1")]
    now = [1000 * SECOND]
    engine = Engine(Clock(lambda: now[0]))
    engine.load(goals=goal)
    seen = []
    engine.on_output(lambda term, topic, name: seen.append(engine.show(term)))
    for instant in (1000, 10, 11, 20):
        now[0] = instant * SECOND
        engine.event(f"a({instant})")
    assert seen == ["a(1000)", "a(10)", "a(11)"]


def test_they_go_on_where_a_state_is_taken_up():
    goal = "subscribe(a(X) with throttle(100), [], _, t, 1)\nsubscribe(a(X) with debounce(2, X), [], said(X), t, 2)"
    engine = Engine()
    engine.load(goals=goal + "\nsubscribe(a(_), [], _, t, 3)\nsubscribe(a(X) with change(X), [], _, t, 4)")
    for at, value in ((1, 1), (2, 2), (3, 2)):
        engine.event(f"a({value})", at)
    other = Engine.restore(engine.snapshot())
    seen = []
    for one in (engine, other):
        found = []
        one.on_output(
            lambda term, topic, name, found=found, one=one: found.append((one.show(term), str(name)))
        )
        one.event("a(2)", 3.5)
        one.event("b", 20)
        one.event("a(3)", 102)
        seen.append(found)
    assert seen[0] == seen[1]
    assert len(seen[0]) == 5
    assert engine.status().subscriptions == other.status().subscriptions


def test_they_go_on_where_a_program_is_read_again(tmp_path):
    (tmp_path / "eventRules.txt").write_text("")
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>\n")
    goals = tmp_path / "goalPredicates.txt"
    goals.write_text(
        "subscribe(a(X) with debounce(3), [], _, t, 1).\nsubscribe(a(X) with throttle(9), [], _, t, 2).\n"
    )
    engine = Engine()
    engine.load_program(tmp_path)
    seen = []
    engine.on_output(lambda term, topic, name: seen.append((engine.show(term), engine.show(name))))
    engine.event("a(1)", 1)
    engine.reload(tmp_path)
    engine.event("a(2)", 2)
    goals.write_text(
        "subscribe(a(X) with debounce(3), [], _, t, 1).\nsubscribe(a(X) with throttle(8), [], _, t, 2).\n"
    )
    engine.reload(tmp_path)
    engine.event("a(3)", 3)
    engine.event("b", 20)
    assert seen == [("a(1)", "2"), ("a(3)", "2"), ("a(3)", "1")]


def test_an_interrupt_may_leave_it_half_done_and_it_is_put_right():
    engine = RecordingEngine(goals="subscribe(a(X) with debounce(2), [], _, t, 1)")
    engine.event("a(1)", 1)
    rate = engine.knowledge.subscriptions.items()[0][1].rate_limiter
    engine.rules.node_timers.clear()
    rate.alarm_instant = None
    engine.rules.repair()
    engine.knowledge.repair()
    engine.event("b", 9)
    assert [term for term, _, _ in engine.outputs] == ["a(1)"]


def test_its_event_is_as_it_is_declared():
    engine = RecordingEngine(rules=":- event in(x:integer).\nb(X) <- in(X).")
    with pytest.raises(PrologError, match="in/2 does not match its declaration"):
        engine.call("subscribe(in(a, b) with throttle(1), [], _, t, 1)")
