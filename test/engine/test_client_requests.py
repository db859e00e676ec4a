"""Requests of clients: limits, added rules, permission to set flags, and synchronization with memories."""

from pathlib import Path
from typing import Any, List, Tuple

import pytest
from checked_threads import CheckedThread, wait_until
from recording_engine import RecordingEngine

from retalis import (
    Engine,
    Limits,
    ProgramErrors,
    PrologError,
    RetalisError,
    Settings,
    SyntaxFault,
    UsageError,
    atom,
)
from retalis.engine.client_requests import add_rule, ask, delete_rule, run_restricted, wait_for_memories
from retalis.prolog.syntax.term_reader import read_term


def values(answer: Any) -> List[List[Tuple[Any, ...]]]:
    return [
        [(binding.name, binding.text, binding.json) for binding in solution] for solution in answer.solutions
    ]


def test_solutions_have_text_and_json() -> None:
    answer = ask(Engine(), "member(X, [a, 'B c', f(Y, Y)])")
    assert values(answer) == [
        [("X", "a", '"a"'), ("Y", "_1", '{"variable": "_1"}')],
        [("X", "'B c'", '"B c"'), ("Y", "_1", '{"variable": "_1"}')],
        [
            ("X", "f(_1,_1)", '{"functor": "f", "args": [{"variable": "_1"}, {"variable": "_1"}]}'),
            ("Y", "_1", '{"variable": "_1"}'),
        ],
    ]
    assert answer.complete


def test_variables_with_underscore_are_omitted() -> None:
    assert values(ask(Engine(), "_X = 1")) == [[]]


def test_failing_goal_has_no_solutions() -> None:
    assert ask(Engine(), "fail") == ([], True)


def test_number_of_solutions_is_limited() -> None:
    answer = ask(Engine(), "repeat", 3)
    assert len(answer.solutions) == 3
    assert not answer.complete
    assert ask(Engine(), "member(X, [1, 2])", 2).complete


def test_length_of_answer_is_limited() -> None:
    answer = ask(Engine(), "between(1, 1000, X)", 1000, max_characters=10)
    assert [text for ((_, text, _),) in answer.solutions] == ["1", "2", "3", "4", "5", "6", "7", "8", "9"]
    assert not answer.complete


def test_first_solution_over_length_limit_is_an_error() -> None:
    with pytest.raises(UsageError, match="more than 10 characters"):
        ask(Engine(), "numlist(1, 1000, L)", max_characters=10)


def test_limits_of_request_apply_to_request_only() -> None:
    engine = Engine()
    with pytest.raises(PrologError, match="inferences"):
        ask(engine, "repeat, fail", limits=Limits(inferences=10_000))
    assert ask(engine, "between(1, 100000, X), X =:= 100000").complete


def test_limits_of_engine_apply_to_requests() -> None:
    engine = Engine(settings=Settings(limits=Limits(inferences=10_000)))
    with pytest.raises(PrologError, match="inferences"):
        ask(engine, "repeat, fail", limits=Limits(inferences=10_000_000))
    with pytest.raises(PrologError, match="inferences"):
        ask(engine, "repeat, fail")


def test_syntax_error_has_position() -> None:
    with pytest.raises(SyntaxFault, match="column"):
        ask(Engine(), "f(X")


@pytest.fixture
def engine_with_memories() -> Engine:
    engine = Engine()
    engine.load(goals="memorize(v(_), [], _, m, 10)\nmemorize(w(_), [], _, n, 10)")
    return engine


def test_available_records_need_no_wait(engine_with_memories: Engine) -> None:
    engine_with_memories.event("v(1)", 5)
    wait_for_memories(engine_with_memories, [atom("m")], 5_000_000_000, 0)
    assert waiting(engine_with_memories) == 0


def test_engine_processes_events_while_request_waits(engine_with_memories: Engine) -> None:
    results: List[Any] = []

    def wait() -> None:
        wait_for_memories(engine_with_memories, [atom("m"), atom("n")], 5_000_000_000, 60)
        results.append(
            [solution[0].text for solution in ask(engine_with_memories, "access_mem(m, v(X), _)").solutions]
        )

    thread = CheckedThread(wait)
    thread.start()
    wait_until(lambda: waiting(engine_with_memories), "the request waits")
    assert engine_with_memories.query("true")
    engine_with_memories.event("v(1)", 6)
    assert waiting(engine_with_memories) == 1
    engine_with_memories.event("w(1)", 7)
    thread.end()
    assert results == [["1"]]
    assert waiting(engine_with_memories) == 0


def waiting(engine: Any) -> int:
    return len(engine.knowledge.pending_queries)


def test_wait_ends_with_error_after_timeout(engine_with_memories: Engine) -> None:
    engine_with_memories.event("v(1)", 3)
    with pytest.raises(UsageError, match=r"in memory m \(2 s too early\), n \(nothing yet\) after 0.01 s"):
        wait_for_memories(engine_with_memories, [atom("m"), atom("n")], 5_000_000_000, 0.01)
    assert waiting(engine_with_memories) == 0


class LateEngine(Engine):
    """An engine that receives an event at the second call of `do`."""

    calls = 0

    def do(self, *arguments: Any, **options: Any) -> Any:
        self.calls += 1
        if self.calls == 2:
            self.event("v(1)", 6)
        return super().do(*arguments, **options)


def test_data_at_end_of_waiting_time_ends_wait() -> None:
    engine = LateEngine()
    engine.load(goals="memorize(v(_), [], _, m, 10)")
    # The second call asks which data are missing.
    wait_for_memories(engine, [atom("m")], 5_000_000_000, 0)
    assert engine.calls > 1
    assert waiting(engine) == 0


def test_wait_for_unknown_memory_is_an_error(engine_with_memories: Engine) -> None:
    with pytest.raises(UsageError, match="there is no memory x"):
        wait_for_memories(engine_with_memories, [atom("x")], 0, 1)


def test_deleted_memory_ends_wait(engine_with_memories: Engine) -> None:
    def wait() -> None:
        with pytest.raises(UsageError, match="deleted"):
            wait_for_memories(engine_with_memories, [atom("m")], 5_000_000_000, 60)

    thread = CheckedThread(wait)
    thread.start()
    wait_until(lambda: waiting(engine_with_memories), "the request waits")
    engine_with_memories.delete_memory(atom("m"))
    thread.end()
    assert waiting(engine_with_memories) == 0
    assert engine_with_memories.query("true")


# ---- added rules


@pytest.fixture
def recording_engine() -> RecordingEngine:
    return RecordingEngine()


def test_added_rule_fires_until_deleted(recording_engine: RecordingEngine) -> None:
    assert add_rule(recording_engine, "b(X) <- a(X).", "mine") == "mine"
    recording_engine.event("a(1)", 1)
    delete_rule(recording_engine, "mine")
    recording_engine.event("a(2)", 2)
    assert recording_engine.event_texts == ["a(1)", "b(1)", "a(2)"]


@pytest.mark.parametrize(
    ("rule", "requested", "label"),
    [
        ("own : b <- a", "", "own"),
        ("own : b <- a", "own", "own"),
        ("own([property(window, 3)]) : b <- a", "", "own"),
        ("b <- a % why", "", "added_1"),
        ("b do true <- a", "it", "it"),
        ("b <- a", "'two words'", "'two words'"),
    ],
)
def test_rule_is_added_under_its_label(
    recording_engine: RecordingEngine, rule: str, requested: str, label: str
) -> None:
    assert add_rule(recording_engine, rule, requested) == label
    recording_engine.event("a", 1)
    assert recording_engine.event_texts == ["a", "b"]
    delete_rule(recording_engine, label)
    recording_engine.event("a", 2)
    assert recording_engine.event_texts == ["a", "b", "a"]


def test_new_labels_are_unique(recording_engine: RecordingEngine) -> None:
    assert [add_rule(recording_engine, "b <- a") for _ in range(3)] == ["added_1", "added_2", "added_3"]
    delete_rule(recording_engine, "added_2")
    assert add_rule(recording_engine, "b <- a") == "added_2"


@pytest.mark.parametrize(
    ("rule", "label", "message"),
    [
        ("b :- a", "", "expected one event rule"),
        (":- halt", "", "expected one event rule"),
        ("b <- c", "there", "a rule there already exists"),
        ("there : b <- c", "", "a rule there already exists"),
        ("own : b <- c", "other", "the rule has the label own already"),
        ("b <- c", "f(x)", "label: expected an atom"),
    ],
)
def test_invalid_rule_or_label_is_refused(
    recording_engine: RecordingEngine, rule: str, label: str, message: str
) -> None:
    recording_engine.load(rules="there : b <- a.")
    with pytest.raises(UsageError, match=message):
        add_rule(recording_engine, rule, label)


def test_errors_of_added_rule_have_line_and_caret(recording_engine: RecordingEngine) -> None:
    with pytest.raises(SyntaxFault) as fault:
        add_rule(recording_engine, "b <- a seq\n  (c where X > )")
    assert str(fault.value).splitlines()[0].startswith("rule:2:16: ")
    assert "^" in str(fault.value)
    with pytest.raises(ProgramErrors) as errors:
        add_rule(recording_engine, "b <-\n   a ntimes x")
    assert str(errors.value).startswith(
        "rule:2:13: ntimes needs a positive integer\n   a ntimes x\n            ^"
    )
    recording_engine.event("a", 1)
    assert recording_engine.event_texts == ["a"]


def test_deleting_unknown_label_is_an_error(recording_engine: RecordingEngine) -> None:
    for label in ("none", "", "f(x)", "a b"):
        with pytest.raises(RetalisError):
            delete_rule(recording_engine, label)


def test_added_rule_cannot_load_files(recording_engine: RecordingEngine, tmp_path: Path) -> None:
    (tmp_path / "secret.txt").write_text("secret.")
    add_rule(
        recording_engine,
        f"b do (catch(compile_event_file('{tmp_path}/secret.txt'), E, assertz(kept(E)))) <- a",
    )
    recording_engine.event("a", 1)
    assert recording_engine.query("kept(error(permission_error(_, _, _), _))")


# ---- flags

SET_FLAG = "set_etalis_flag(event_consumption_policy, unrestricted)"
PROGRAM = "null do set_etalis_flag(event_consumption_policy, chronological) <- own(_).\n"
REFUSED = "~allow_flags"


def make_engine(rules: str = "", **settings: Any) -> Engine:
    engine = Engine(settings=Settings(**settings))
    engine.load(rules=PROGRAM + ":- dynamic helper/0.\n" + rules)
    return engine


def policy(engine: Any) -> Any:
    (answer,) = engine.query("get_etalis_flag(event_consumption_policy, X)")
    return answer["X"].name


def terms(engine: Any, *texts: Any) -> List[Any]:
    return [read_term(text, engine.operators, "text").term for text in texts]


@pytest.mark.parametrize(
    "goal",
    [
        SET_FLAG,
        "set_prolog_flag(double_quotes, atom)",
        "set_prolog_flag(mine, 1)",
        "create_prolog_flag(mine, 1, [])",
        "unknown(_, fail)",
        f"G = {SET_FLAG}, call(G)",
        "G =.. [set_etalis_flag, event_consumption_policy, unrestricted], once((true, G))",
        f"findall(x, {SET_FLAG}, _)",
        f"assertz((helper :- {SET_FLAG})), helper",
        f"compile_event_rules([(:- {SET_FLAG})])",
        f"event(synchronized(x, {SET_FLAG}, []))",
    ],
)
def test_query_that_sets_flag_is_refused(goal: str, caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine()
    engine.event("first", 1)
    before = engine.query("current_prolog_flag(double_quotes, X), current_prolog_flag(unknown, Y)")
    try:
        ask(engine, goal)
        text = caplog.text
    except PrologError as error:
        text = error.message
    assert REFUSED in text
    assert policy(engine) == "recent"
    assert engine.query("current_prolog_flag(double_quotes, X), current_prolog_flag(unknown, Y)") == before
    assert not engine.query("current_prolog_flag(mine, X)")


def test_reset_of_changed_program_is_refused() -> None:
    engine = make_engine()
    engine.call(SET_FLAG)
    with pytest.raises(PrologError, match=REFUSED):
        ask(engine, "reset_etalis")


def test_reset_of_unchanged_program_is_allowed() -> None:
    engine = make_engine()
    engine.event("own(1)", 1)
    assert policy(engine) == "chronological"
    engine = make_engine()
    add_rule(engine, "b <- a")
    ask(engine, "reset_etalis")
    assert [rule.name for rule in engine.rules.rules] == []
    assert policy(engine) == "recent"


def test_setting_allows_flags_in_queries() -> None:
    engine = make_engine(allow_flags=True)
    ask(engine, SET_FLAG)
    assert policy(engine) == "unrestricted"


def test_program_and_owner_set_flags() -> None:
    engine = make_engine(":- set_etalis_flag(event_consumption_policy, recent_2).")
    assert policy(engine) == "recent_2"
    engine.event("own(1)", 1)
    assert policy(engine) == "chronological"
    engine.query(SET_FLAG)
    assert policy(engine) == "unrestricted"
    ask(engine, "event(own(2))")
    assert policy(engine) == "chronological"


@pytest.mark.parametrize(
    "rule",
    [
        f"null do {SET_FLAG} <- b8(_).",
        f"x <- a(_) where {SET_FLAG}.",
        f"x <- a(X) where (X > 0, {SET_FLAG}, X > 0).",
        f"x <- a(_) event_multiply {SET_FLAG}.",
        f"synchronized(x, {SET_FLAG}, []) <- a(_).",
        f"null do (G = {SET_FLAG}, call(G)) <- b8(_).",
    ],
)
def test_added_rule_that_sets_flag_is_refused(rule: str, caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine_with_chain()
    add_rule(engine, rule)
    feed_chain(engine)
    assert policy(engine) == "recent"
    assert REFUSED in caplog.text


def test_added_rules_without_flags_are_not_refused(caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine_with_chain()
    events: List[str] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    add_rule(engine, "a2(X) <- a(X)")
    add_rule(engine, "a3(X) <- a2(X)")
    feed_chain(engine)
    assert "a3(1)" in events
    assert "b8(1)" in events
    assert REFUSED not in caplog.text


def make_engine_with_chain() -> Engine:
    """Return an engine whose rules derive ``b8(X)`` from ``b0(X)`` in eight steps."""
    return make_engine("".join(f"b{number + 1}(X) <- b{number}(X).\n" for number in range(8)))


def feed_chain(engine: Engine) -> None:
    for instant, event in enumerate(("a(1)", "b0(1)", "a(_)"), 1):
        engine.event(event, instant)


def test_added_rule_is_refused_after_change_of_flags(caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine()
    add_rule(engine, f"synchronized(x, {SET_FLAG}, []) <- a(_).")
    engine.event("own(1)", 1)  # compiles all rules again
    engine.event("a(1)", 2)
    assert policy(engine) == "chronological"
    assert REFUSED in caplog.text


def test_service_condition_that_sets_flag_is_refused(caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine()
    event, condition, free = terms(engine, "a(_)", SET_FLAG, "_")
    run_restricted(engine, lambda: engine.add_memory(event, [condition], free, atom("m"), 5))
    run_restricted(engine, lambda: engine.add_subscription(event, [condition], free, atom("out"), atom("s")))
    engine.event("a(1)", 1)
    assert policy(engine) == "recent"
    assert "subscription s" in caplog.text
    assert "memory m" in caplog.text
    assert REFUSED in caplog.text
    engine.load(goals=f"memorize(c(_), [{SET_FLAG}], _, own, 5)")
    engine.event("c(1)", 2)
    assert policy(engine) == "unrestricted"


def test_allowed_goal_text_sets_flag() -> None:
    engine = make_engine(allow_goals=True)
    engine.post_text(SET_FLAG)
    assert policy(engine) == "unrestricted"
