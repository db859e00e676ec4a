"""Session windows, compared with their definition over plain lists."""

from typing import Any, List

import pytest
from asserting_accessors import place_of
from events.streams.operator_driver import (
    Arrival,
    OperatorDriver,
    arrival_lists,
    element_of,
    entry_count,
    expected_output,
    list_accumulators,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_reports import RecordingReports

from retalis import Engine, ProgramErrors
from retalis.events.streams.session_window import SessionWindow
from retalis.prolog.terms.timestamps import SECOND


def sessions_of(arrivals: List[Any], gap: int, max_length: Any) -> List[List[Any]]:
    """Return the sessions of arrivals of one key."""
    sessions: List[List[Any]] = []
    for arrival in sorted(arrivals, key=lambda arrival: (arrival.end, arrival.number)):
        if sessions and arrival.end < end_of(sessions[-1], gap, max_length):
            sessions[-1].append(arrival)
        else:
            sessions.append([arrival])
    return sessions


def end_of(session: List[Any], gap: int, max_length: Any) -> int:
    end: int = session[-1].end + gap
    return end if max_length is None else min(end, session[0].end + max_length)


@settings(max_examples=100)
@given(
    arrival_lists(st.just(1), max_delay=6),
    st.integers(0, 20),
    st.integers(1, 6),
    st.sampled_from([None, 1, 4]),
)
def test_elements_form_sessions_in_any_order(
    arrivals: Any, restore_before: Any, gap: int, longer_by: Any
) -> None:
    """An element is late if the session has ended that it would be in with those that are open at its arrival."""
    max_length = None if longer_by is None else gap + longer_by
    expected: List[Any] = []
    open_arrivals: List[Any] = []
    late_count = 0

    def close(now: int) -> None:
        for key in "ab":
            for session in sessions_of(
                [arrival for arrival in open_arrivals if arrival.key == key], gap, max_length
            ):
                if end_of(session, gap, max_length) <= now:
                    expected.append(expected_output(sorted(session)))
                    for arrival in session:
                        open_arrivals.remove(arrival)

    for arrival in arrivals:
        close(arrival.clock_time)
        of_key = [other for other in [*open_arrivals, arrival] if other.key == arrival.key]
        (session,) = [one for one in sessions_of(of_key, gap, max_length) if arrival in one]
        if end_of(session, gap, max_length) <= arrival.clock_time:
            late_count += 1
        else:
            open_arrivals.append(arrival)
    close(1 << 40)
    driver = OperatorDriver(lambda: SessionWindow(list_accumulators, gap, max_length), restore_before)
    assert sorted(driver.feed(arrivals)) == sorted(expected)
    assert (len(driver.operator), driver.operator.states) == (0, {})
    assert driver.operator.late_count == late_count or restore_before < len(arrivals)


def test_deadlines_of_long_session_are_not_stored() -> None:
    window = SessionWindow(list_accumulators, 11, None)
    for number in range(2000):
        end = 5 * number
        assert window.advance_to(end) == []
        window.process(element_of(Arrival(number, "ab"[number % 2], end, end, number, 0, end)), end, 0)
    assert len(window) == 2000
    assert entry_count(window) <= 80
    assert len(window.advance_to(20_000)) == 2


class RuleRunner:
    """An engine with one rule, whose clock follows the events."""

    def __init__(self, rule: str):
        self.reports = RecordingReports()
        self.engine = Engine(reports=self.reports)
        self.engine.load(rules=rule)
        self.outputs: List[str] = []
        self.engine.on_event(self._record)

    def _record(self, term: Any, start: int, end: int) -> None:
        text = self.engine.show(term)
        if not text.startswith(("seen", "tick")):
            self.outputs.append(f"{text}@{start / SECOND:g}-{end / SECOND:g}")

    def feed(self, events: str) -> str:
        """Process events, each as ``event@end`` or ``event@start-end``; return the outputs."""
        for item in events.split():
            event, _, interval = item.partition("@")
            start, _, end = interval.partition("-")
            self.engine.event(event, float(start), float(end or start))
        return " ".join(self.outputs)


VISIT = "visit(W, L) <- aggregate(list(X), seen(W, X), L, {0})."
SEEN = "seen(a,1)@1-2 seen(b,2)@3 seen(a,3)@4 seen(a,4)@8.9"


@pytest.mark.parametrize(
    ("window", "events", "outputs"),
    [
        ("session(5)", "tick@50", "visit(b,[2])@3-3 visit(a,[1,3,4])@1-8.9"),
        # An event at the end of the session begins the next one, after the result.
        (
            "session(5)",
            "seen(a,5)@13.9 tick@50",
            "visit(b,[2])@3-3 visit(a,[1,3,4])@1-8.9 visit(a,[5])@13.9-13.9",
        ),
        # A late event joins the open session, or begins an own one while that has not ended.
        ("session(5)", "seen(a,5)@6 tick@50", "visit(b,[2])@3-3 visit(a,[1,3,4,5])@1-8.9"),
        ("session(5)", "seen(b,5)@1 tick@50", "visit(b,[2])@3-3 visit(a,[1,3,4])@1-8.9"),
        ("session(4)", "seen(a,5)@5.5 tick@50", "visit(b,[2])@3-3 visit(a,[1,3])@1-4 visit(a,[4,5])@5.5-8.9"),
        ("session(5, max(6))", "tick@50", "visit(a,[1,3])@1-4 visit(b,[2])@3-3 visit(a,[4])@8.9-8.9"),
    ],
)
def test_session_has_interval_of_its_events(window: str, events: str, outputs: str) -> None:
    runner = RuleRunner(VISIT.format(window))
    assert runner.feed(f"{SEEN} {events}") == outputs


def test_late_start_takes_event_that_is_also_measured() -> None:
    """The session of 0 ends after the arrival of the event that follows it, which begins a session itself."""
    runner = RuleRunner(
        ":- set_etalis_flag(out_of_order, on).\n"
        "o(K) <- aggregate(count, seen(_, K), _, session(5)) seq aggregate(count, seen(_, 2), N) where N > 0."
    )
    assert runner.feed("seen(1,0)@22-26 seen(2,2)@29-30 tick@44") == "o(0)@22-30"


def test_late_event_is_counted_and_reported() -> None:
    runner = RuleRunner(VISIT.format("session(5)"))
    runner.feed("seen(a,1)@10 tick@14 seen(a,2)@9 tick@20 seen(a,3)@9 seen(a,4)@15.5 tick@30")
    assert runner.engine.rules.rules[0].late_count == 1
    assert "an event is too late and is not measured: its window has ended" in runner.reports.messages[0]


def test_rate_of_session_is_between_first_and_last_end() -> None:
    runner = RuleRunner("r(R) <- aggregate(rate, seen, R, session(5)).")
    assert runner.feed("seen@1 seen@2 seen@5 tick@20 seen@30 tick@40") == "r(0.5)@1-5"


def test_value_of_other_kind_is_reported_at_end() -> None:
    runner = RuleRunner("r(S) <- aggregate(sum(X), seen(X), S, session(5)).")
    assert runner.feed("seen([1,2,0])@1 seen(3)@2 seen([3,4,0])@3 tick@20") == "r([4,6,0])@1-3"
    assert len(runner.reports.messages) == 1


ERRORS = {
    "session(0)": ("0", "session needs a positive number of seconds"),
    "session(a)": ("a)", "session needs a positive number of seconds"),
    "session(5, 9)": ("9", "session takes seconds and max(Seconds)"),
    "session(5, max(9), 3)": ("max", "session takes seconds and max(Seconds)"),
    "session(5, max(x))": ("x)", "max needs a positive number of seconds"),
    "session(5, max(4.5))": ("4.5", "max needs more seconds than its session"),
    "running(session(5))": (
        "running",
        "running needs every(Seconds), every(Seconds, first) or every(N, events)",
    ),
    "sesion(5)": ("sesion", "a window is last(Seconds)"),
}


@pytest.mark.parametrize(("window", "expected"), ERRORS.items())
def test_malformed_session_is_reported_at_its_place(window: str, expected: Any) -> None:
    rule = f"w(N) <- aggregate(count, q, N, {window})."
    with pytest.raises(ProgramErrors) as errors:
        RuleRunner(rule)
    (error,) = errors.value.errors
    assert place_of(error).column == rule.index(window) + window.index(expected[0]) + 1
    assert expected[1] in error.message
