"""Timeouts of synchronized queries."""

import pytest

from retalis import Engine, ProgramErrors, StreamClock

ASK = "synchronized(answer(X), access_mem(m, v(X), _), [[m, T], [n, T]], [timeout(2)]) <- ask(T).\n"
MEMORIES = "memorize(v(_), [], _, m, 10)\nmemorize(w(_), [], _, n, 10)"


class Watched(Engine):
    def __init__(self, rules=ASK, goals=MEMORIES):
        super().__init__()
        self.seen = []
        self.on_event(self._note)
        self.load(rules=rules, goals=goals)
        self.seen.clear()

    def _note(self, term, start, end):
        text = self.show(term)
        if not text.startswith(("synchronized", "syncronized", "memory")):
            self.seen.append((text, int(start), int(end)))

    def texts(self):
        return [text for text, _, _ in self.seen]


SECOND = 1_000_000_000


def test_an_event_says_that_it_was_given_up():
    engine = Watched()
    engine.event("ask(5)", 1)
    engine.event("v(1)", 5)
    name, start, end = engine.seen[1]
    assert (start, end) == (3 * SECOND, 3 * SECOND)
    assert name.startswith("query_given_up(answer(_") and "[m," in name and "[n," in name
    assert len(engine.knowledge.pending_queries) == 0
    engine.event("w(1)", 6)
    assert "answer(1)" not in engine.texts()


def test_only_what_is_missing_is_named():
    engine = Watched()
    engine.event("ask(2)", 1)
    engine.event("v(1)", 2)
    engine.event("tick", 4)
    (given_up,) = [text for text in engine.texts() if text.startswith("query_given_up")]
    assert "[n," in given_up and "[m," not in given_up


def test_one_that_is_asked_in_time_is_not_given_up():
    engine = Watched()
    engine.event("ask(2)", 1)
    engine.event("v(7)", 2)
    engine.event("w(7)", 2)
    engine.event("tick", 10)
    assert engine.texts() == ["ask(2)", "v(7)", "w(7)", "answer(7)", "tick"]


def test_one_whose_data_are_there_is_asked_at_once():
    engine = Watched()
    engine.event("v(7)", 2)
    engine.event("w(7)", 2)
    engine.event("ask(2)", 3)
    assert engine.texts()[-1] == "answer(7)"


def test_a_rule_may_take_it():
    rules = ASK + "alone(X, M) <- query_given_up(answer(_), _, [[M, _] | _]) where X = 1.\n"
    engine = Watched(rules)
    engine.event("ask(5)", 1)
    engine.event("tick", 3)
    assert "alone(1,m)" in engine.texts()


def test_the_time_of_the_stream_counts_that_went_on():
    engine = Watched()
    engine.event("tick", 10)
    engine.event("ask(50)", 1)
    engine.event("tick", 11)
    assert not any(text.startswith("query_given_up") for text in engine.texts())
    engine.event("tick", 12)
    assert any(text.startswith("query_given_up") for text in engine.texts())


def test_different_times_are_kept_in_order():
    engine = Watched(ASK.replace("timeout(2)", "timeout(S)").replace("ask(T)", "ask(T, S)"))
    for seconds in (5, 1, 3, 4, 2):
        engine.event(f"ask(100, {seconds})", 1)
    engine.event("tick", 20)
    assert [end // SECOND for text, _, end in engine.seen if text.startswith("query_given")] == [
        2,
        3,
        4,
        5,
        6,
    ]


def test_what_was_asked_is_not_kept_for_its_time():
    engine = Watched(ASK.replace("timeout(2)", "timeout(3600)"))
    for second in range(1, 1000):
        engine.event(f"ask({second})", second)
        engine.event("v(1)", second)
        engine.event("w(1)", second)
    assert len(engine.knowledge.pending_queries.timeouts) < 50
    assert len(engine.clock.alarms) < 5


def test_time_that_goes_back_ends_them():
    clock = StreamClock()
    engine = Engine(clock)
    engine.load(rules=ASK, goals=MEMORIES)
    seen = []
    engine.on_event(lambda term, start, end: seen.append(engine.show(term)))
    clock.move_to(10 * SECOND)
    engine.event("ask(50)", 10)
    clock.move_to(1 * SECOND, back=True)
    engine.advance()
    clock.move_to(100 * SECOND)
    engine.advance()
    engine.event("ask(150)", 100)
    clock.move_to(103 * SECOND)
    engine.advance()
    assert len([text for text in seen if text.startswith("query_given_up")]) == 1


@pytest.mark.parametrize(
    "options", ["[]", "timeout(1)", "[timeout(-1)]", "[timeout(a)]", "[other(1)]", "[timeout(1), a]"]
)
def test_wrong_options_are_errors_with_their_place(options):
    with pytest.raises(ProgramErrors, match=r"takes \[timeout\(Seconds\)\] as its options"):
        Engine().load(rules=f"synchronized(e, true, [], {options}) <- a.")


def test_options_that_turn_out_wrong_are_reported(caplog):
    engine = Watched("synchronized(e, true, [[m, 5]], [timeout(X)]) <- a(X).")
    engine.event("a(b)", 1)
    assert "e is dropped: expected [timeout(Seconds)], found [timeout(b)]" in caplog.text


def test_a_deleted_memory_drops_it_as_before(caplog):
    engine = Watched()
    engine.event("ask(5)", 1)
    engine.call("delete_memory(m)")
    engine.event("tick", 10)
    assert "the memory m was deleted" in caplog.text
    assert not any(text.startswith("query_given_up") for text in engine.texts())
