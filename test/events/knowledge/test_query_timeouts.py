"""Timeouts of synchronized queries."""

from typing import Any, List

import pytest

from retalis import Engine, ProgramErrors, StreamClock

QUERY_RULE = "synchronized(answer(X), access_mem(m, v(X), _), [[m, T], [n, T]], [timeout(2)]) <- ask(T).\n"
MEMORIES = "memorize(v(_), [], _, m, 10)\nmemorize(w(_), [], _, n, 10)"


class TimeoutEngine(Engine):
    def __init__(self, rules: Any = QUERY_RULE, goals: Any = MEMORIES) -> None:
        super().__init__()
        self.events: List[Any] = []
        self.on_event(self._record)
        self.load(rules=rules, goals=goals)
        self.events.clear()

    def _record(self, term: Any, start: Any, end: Any) -> None:
        text = self.show(term)
        if not text.startswith(("synchronized", "syncronized", "memory")):
            self.events.append((text, int(start), int(end)))

    def texts(self) -> List[Any]:
        return [text for text, _, _ in self.events]


SECOND = 1_000_000_000


def test_timeout_emits_event() -> None:
    engine = TimeoutEngine()
    engine.event("ask(5)", 1)
    engine.event("v(1)", 5)
    name, start, end = engine.events[1]
    assert (start, end) == (3 * SECOND, 3 * SECOND)
    assert name.startswith("query_given_up(answer(_")
    assert "[m," in name
    assert "[n," in name
    assert len(engine.knowledge.pending_queries) == 0
    engine.event("w(1)", 6)
    assert "answer(1)" not in engine.texts()


def test_timeout_event_names_missing_memories() -> None:
    engine = TimeoutEngine()
    engine.event("ask(2)", 1)
    engine.event("v(1)", 2)
    engine.event("tick", 4)
    (given_up,) = [text for text in engine.texts() if text.startswith("query_given_up")]
    assert "[n," in given_up
    assert "[m," not in given_up


def test_query_with_data_in_time_has_no_timeout() -> None:
    engine = TimeoutEngine()
    engine.event("ask(2)", 1)
    engine.event("v(7)", 2)
    engine.event("w(7)", 2)
    engine.event("tick", 10)
    assert engine.texts() == ["ask(2)", "v(7)", "w(7)", "answer(7)", "tick"]


def test_rule_matches_timeout_event() -> None:
    rules = QUERY_RULE + "alone(X, M) <- query_given_up(answer(_), _, [[M, _] | _]) where X = 1.\n"
    engine = TimeoutEngine(rules)
    engine.event("ask(5)", 1)
    engine.event("tick", 3)
    assert "alone(1,m)" in engine.texts()


def test_timeout_counts_from_time_of_stream() -> None:
    engine = TimeoutEngine()
    engine.event("tick", 10)
    engine.event("ask(50)", 1)
    engine.event("tick", 11)
    assert not any(text.startswith("query_given_up") for text in engine.texts())
    engine.event("tick", 12)
    assert any(text.startswith("query_given_up") for text in engine.texts())


def test_timeouts_are_emitted_in_order() -> None:
    engine = TimeoutEngine(QUERY_RULE.replace("timeout(2)", "timeout(S)").replace("ask(T)", "ask(T, S)"))
    for seconds in (5, 1, 3, 4, 2):
        engine.event(f"ask(100, {seconds})", 1)
    engine.event("tick", 20)
    assert [end // SECOND for text, _, end in engine.events if text.startswith("query_given")] == [
        2,
        3,
        4,
        5,
        6,
    ]


def test_answered_queries_leave_timeouts() -> None:
    engine = TimeoutEngine(QUERY_RULE.replace("timeout(2)", "timeout(3600)"))
    for second in range(1, 1000):
        engine.event(f"ask({second})", second)
        engine.event("v(1)", second)
        engine.event("w(1)", second)
    assert len(engine.knowledge.pending_queries.timeouts) < 50
    assert len(engine.clock.alarms) < 5


def test_clock_moved_back_clears_timeouts() -> None:
    clock = StreamClock()
    engine = Engine(clock)
    engine.load(rules=QUERY_RULE, goals=MEMORIES)
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    clock.move_to(10 * SECOND)
    engine.event("ask(50)", 10)
    clock.move_to(1 * SECOND, back=True)
    engine.advance()
    clock.move_to(100 * SECOND)
    engine.advance()
    engine.event("ask(150)", 100)
    clock.move_to(103 * SECOND)
    engine.advance()
    assert len([text for text in events if text.startswith("query_given_up")]) == 1


@pytest.mark.parametrize(
    "options", ["[]", "timeout(1)", "[timeout(-1)]", "[timeout(a)]", "[other(1)]", "[timeout(1), a]"]
)
def test_invalid_options_are_refused(options: str) -> None:
    with pytest.raises(ProgramErrors, match=r"takes \[timeout\(Seconds\)\] as its options"):
        Engine().load(rules=f"synchronized(e, true, [], {options}) <- a.")


def test_invalid_options_of_event_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    engine = TimeoutEngine("synchronized(e, true, [[m, 5]], [timeout(X)]) <- a(X).")
    engine.event("a(b)", 1)
    assert "e is dropped: expected [timeout(Seconds)], found [timeout(b)]" in caplog.text


def test_deleted_memory_drops_query_without_timeout(caplog: pytest.LogCaptureFixture) -> None:
    engine = TimeoutEngine()
    engine.event("ask(5)", 1)
    engine.call("delete_memory(m)")
    engine.event("tick", 10)
    assert "the memory m was deleted" in caplog.text
    assert not any(text.startswith("query_given_up") for text in engine.texts())
