"""Problem reports: rates and texts of the log, counts, and late events."""

import logging
from functools import partial
from typing import Any

import pytest
from reachable_objects import reachable

from retalis import Engine, Place, Reports, RetalisError, RuleError
from retalis.foundation.errors import RecurringWarning
from retalis.foundation.source_places import place_at_offset


@pytest.fixture
def logged(caplog: pytest.LogCaptureFixture) -> Any:
    caplog.set_level(logging.WARNING, "retalis")
    return caplog


def test_repeated_errors_are_logged_at_powers_of_two(logged: Any) -> None:
    reports = Reports()
    place = place_at_offset("rules", "a\nb", 2)
    for number in range(100):
        reports.error(RuleError(f"event {number}", place))
    assert len(logged.records) == 7
    assert "64 times so far" in logged.records[-1].message
    assert reports.errors == 100


def test_warnings_of_places_are_logged_separately(logged: Any) -> None:
    reports = Reports()
    for offset in (0, 2):
        reports.warning(RuleError("wrong", place_at_offset("rules", "a\nb", offset)))
    reports.warning("text")
    assert len(logged.records) == 3
    assert reports.warnings == 3


def test_internal_error_is_logged_with_traceback(logged: Any) -> None:
    reports = Reports()
    for _ in range(10):
        try:
            raise KeyError("key")
        except KeyError as error:
            reports.error(error)
    assert len(logged.records) == 4
    assert "Traceback" in logged.records[0].message


def test_summary_logs_totals_of_repetitions(logged: Any) -> None:
    reports = Reports()
    for number in range(7):
        reports.warning(f"number {number}\nand its line", "refused")
    reports.warning("once")
    reports.sum_up()
    assert [record.message for record in logged.records][-2:] == ["once", "7 times in all: number 0"]
    reports.sum_up()
    assert len(logged.records) == 5


def test_summary_counts_kinds_beyond_limit(logged: Any) -> None:
    reports = Reports()
    for number in range(1001):
        for _ in range(3):
            reports.warning(f"kind {number}")
    reports.sum_up()
    assert [record.message for record in logged.records][-2:] == [
        "3 times in all: kind 1000",
        "1000 more problems were not shown",
    ]


def test_distinct_texts_of_kind_are_logged_up_to_limit(logged: Any) -> None:
    reports = Reports()
    for number in (1, 2, 3, 3, 3, 4, 5):
        reports.warning(f"number {number}", "refused", 4)
    reports.sum_up()
    assert [record.message for record in logged.records] == [
        "number 1",
        "number 2",
        "number 3",
        "number 3\n(4 times so far)",
        "number 4",
        "7 times in all: number 1",
    ]


def test_report_length_and_stored_kinds_are_bounded(logged: Any) -> None:
    reports = Reports()
    for number in range(100):
        text = f"{number} {'x' * 100_000}"
        reports.error(RuleError(text))
        reports.warning(text, ("kind", text))
        reports.warning(text, "texts", texts=20)
    assert max(len(record.getMessage()) for record in logged.records) < 5000
    stored_texts = reachable(reports, str)
    assert 201 <= len(stored_texts) < 250
    assert max(map(len, stored_texts)) <= 200


HOSTILE = "\x1b]0;title\x07\x1b[2J \u202e\ud800 \x9b31m ok é\n"


def test_control_characters_are_escaped_in_log(caplog: pytest.LogCaptureFixture) -> None:
    reports = Reports()
    reports.warning(f"event refused: {HOSTILE}")
    reports.error(RetalisError(HOSTILE, Place("x\x1b", 1, 1, HOSTILE)))
    for record in caplog.records:
        text = record.getMessage()
        assert all(character.isprintable() or character == "\n" for character in text)
        assert "\\x1b]0;title\\x07" in text
        assert "\\u202e\\ud800" in text
        assert "ok é" in text
        text.encode("utf-8")
    assert len(caplog.records) == 2


LATE = "w(N) <- aggregate(count, in(_), N, last(2))."


def feed_late_events(reports: Any, count: int) -> Engine:
    engine = Engine(reports=reports)
    engine.load(rules=LATE)
    # Several times that agree: a single one would be taken for an error, and its clock would return.
    for second in (85, 95, 100):
        engine.event("in(0)", second)
    for number in range(count):
        engine.event(f"in({number})", 50)
    return engine


def test_late_events_are_logged_at_powers_of_two(logged: Any) -> None:
    reports = Reports()
    engine = feed_late_events(reports, 300)
    counts = [int(record.message.split("; ")[1].split(" so far")[0]) for record in logged.records]
    assert counts == [1, 2, 4, 8, 16, 32, 64, 128, 256]
    assert engine.status().rules[0].late == 300


def test_sum_of_late_events_is_logged_at_the_end(logged: Any) -> None:
    reports = Reports()
    feed_late_events(reports, 300)
    reports.sum_up()
    assert logged.records[-1].message.startswith(
        "300 times in all: text:1:1: rule w(N): an event is too late"
    )
    assert reports.warnings == 300
    reports.sum_up()
    assert len(logged.records) == 10


def test_batch_run_logs_first_late_event_and_sum(logged: Any) -> None:
    reports = Reports(once=True)
    feed_late_events(reports, 5)
    assert len(logged.records) == 1
    reports.sum_up()
    assert logged.records[-1].message.startswith("5 times in all: ")


def test_late_and_dropped_events_have_own_counts(logged: Any) -> None:
    reports = Reports()
    engine = Engine(reports=reports)
    engine.rules.network.limit_stored(2)
    engine.load(rules=LATE)
    for instant in (85, 95, 100, 100.1, 100.2, 100.3, 50, 51, 52):
        engine.event("in(1)", instant)
    reports.sum_up()
    assert sum("have been dropped" in record.message for record in logged.records) == 2
    assert logged.records[-1].message.startswith("3 times in all: ")


def test_warning_with_once_is_logged_once_and_summed_up(logged: Any) -> None:
    reports = Reports()
    for number in range(5):
        reports.warning(f"number {number}", "refused", once=True)
    assert [record.message for record in logged.records] == ["number 0"]
    reports.sum_up()
    assert [record.message for record in logged.records][1:] == ["5 times in all: number 0"]
    assert reports.warnings == 5


def test_kinds_with_equal_hashes_are_separate(logged: Any) -> None:
    reports = Reports()
    assert hash(("line", -1)) == hash(("line", -2))
    reports.warning("first", ("line", -1))
    reports.warning("second", ("line", -2))
    reports.sum_up()
    assert [record.message for record in logged.records] == ["first", "second"]


def test_occurrences_of_source_are_counted_once_despite_eviction(logged: Any) -> None:
    reports = Reports()
    counts = {"late": 0}
    for source_count, expected_warnings in ((4, 4), (8, 1008), (11, 2011)):
        counts["late"] = source_count
        reports.warning(RecurringWarning("an event is late", None, "late", lambda: counts["late"]))
        assert reports.warnings == expected_warnings
        for number in range(1000):
            reports.warning(f"kind {source_count} {number}")
    reports.sum_up()
    assert reports.warnings == 3011


def test_summary_counts_evicted_occurrences_of_sources(logged: Any) -> None:
    reports = Reports()
    counts = [1] * 1001
    for source in range(1001):
        reports.warning(RecurringWarning("late", None, source, partial(counts.__getitem__, source)))
        counts[source] = 3
    reports.sum_up()
    # At the last source the table is full. 500 sources are removed, with two unlogged occurrences each.
    assert logged.records[-1].message == "1000 more problems were not shown"
    assert reports.warnings == 3 * 1001
