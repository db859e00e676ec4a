"""Creation, recording, reading and deletion of memories by goals."""

import logging
import re
from typing import Any, List, Optional

import pytest
from asserting_accessors import compound, name_of
from recording_engine import RecordingEngine

from retalis import Engine, PrologError, UsageError, atom, deref, list_items
from retalis.prolog.terms.timestamps import SECOND


def records(engine: Engine, name: str = "m") -> List[Any]:
    answers = engine.query(f"access_mem({name}, R, _)")
    return [engine.show(deref(answer["R"])) for answer in answers]


def names(engine: Any) -> List[Any]:
    return [event for event, _, _ in engine.events]


def test_matching_events_are_recorded_by_template() -> None:
    engine = RecordingEngine(goals="memorize(tf(a, B, X), [X > 0], kept(B, X), m, 10)")
    for text in ("tf(a, b, 1)", "tf(c, b, 2)", "tf(a, d, -1)", "tf(a, e, 3)"):
        engine.event(text, 1)
    assert records(engine) == ["kept(e,3)", "kept(b,1)"]


def test_variable_template_records_event() -> None:
    engine = RecordingEngine(goals="memorize(v(X), [X > 1], _, m, 10)")
    engine.event("v(1)", 1)
    engine.event("v(2)", 2)
    assert records(engine) == ["v(2)"]


def test_template_uses_first_solution_of_conditions() -> None:
    engine = RecordingEngine(goals="memorize(v(X), [member(Y, [10, 20]), Z is X + Y], w(X, Z), m, 10)")
    engine.event("v(1)", 1)
    assert records(engine) == ["w(1,11)"]


def test_variables_of_records_are_renamed_for_readers() -> None:
    engine = RecordingEngine(goals="memorize(v(X), [], pair(X, _), m, 10)")
    engine.event("v(1)", 1)
    assert engine.query("access_mem(m, pair(1, a), _), access_mem(m, pair(1, b), _)") != []
    assert engine.query("prev(m, P, _, _, 5), P = pair(_, a), prev(m, Q, _, _, 5), Q = pair(_, b)") != []


def test_variables_of_recorded_event_are_renamed() -> None:
    engine = RecordingEngine("null do (new_event(v(_, 2), 1, 0)) <- go.", "memorize(v(X, Y), [], _, m, 10)")
    engine.event("go", 1)
    assert engine.query("access_mem(m, v(a, 2), _), access_mem(m, v(b, 2), _)") != []


@pytest.fixture
def engine_with_three_records() -> RecordingEngine:
    engine = RecordingEngine(goals="memorize(v(X), [], _, m, 3)")
    for value, time in ((1, 10), (2, 20), (3, 30), (4, 25), (5, 5)):
        engine.event(f"v({value})", time)
    return engine


def test_newest_records_are_kept_in_order(engine_with_three_records: RecordingEngine) -> None:
    assert records(engine_with_three_records) == ["v(3)", "v(4)", "v(2)"]


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("prev(m, R, _, _, 26)", "v(4)"),
        ("prev(m, R, _, _, 25)", "v(4)"),
        ("prev(m, R, _, _, 24.9)", "v(2)"),
        ("prev_binary(m, R, _, _, 99)", "v(3)"),
        ("prev(m, R, _, _, 19)", None),
        ("prev(m, v(2), _, _, 26)", None),
        ("next_inf(m, R, _, _, 21)", "v(4)"),
        ("next_inf(m, R, _, _, 20)", "v(2)"),
        ("next_inf(m, R, _, _, 0)", "v(2)"),
        ("next_inf(m, R, _, _, 31)", None),
        ("next(m, R, _, _, 21, 25)", "v(4)"),
        ("next(m, R, _, _, 21, 24)", None),
        ("next_binary(m, R, _, _, 26, 99)", "v(3)"),
        ("prev(unknown, R, _, _, 26)", None),
        ("next_inf(unknown, R, _, _, 26)", None),
        ("access_mem(unknown, R, _)", None),
    ],
)
def test_lookups_return_nearest_record(
    engine_with_three_records: RecordingEngine, goal: str, expected: Optional[str]
) -> None:
    answers = engine_with_three_records.query(goal)
    if expected is None:
        assert answers == []
    else:
        (answer,) = answers
        assert engine_with_three_records.show(deref(answer["R"])) == expected


def test_lookups_keep_form_of_interval() -> None:
    engine = RecordingEngine(goals="memorize(v(_), [], _, m, 3)")
    engine.event("v(1)", 5, 7.5)
    (answer,) = engine.query("prev(m, _, T1, T2, 8)")
    assert (deref(answer["T1"]), deref(answer["T2"])) == (5, 7.5)
    engine.post_text("new_event(v(2), 1413748205, 981209993)")
    (answer,) = engine.query("access_mem(m, v(2), [T, T])")
    assert engine.show(deref(answer["T"])) == "datime(2014,10,19,19,50,5.0,981209993)"
    assert engine.query("prev(m, v(2), _, _, datime(2014,10,19,19,50,5,981209993))") != []


def test_size_and_count_are_queried(engine_with_three_records: RecordingEngine) -> None:
    assert engine_with_three_records.query("memory_size(m, N), memory_counter(m, C)") == [{"N": 3, "C": 4}]
    assert [name_of(answer["Id"]) for answer in engine_with_three_records.query("memory_size(Id, _)")] == [
        "m"
    ]


def test_active_memory_emits_events() -> None:
    engine = RecordingEngine(goals="memorize(v(_), [], _, m, 3)\nmemorize_diactive(v(_), [], _, quiet, 3)")
    engine.event("v(1)", 5)
    engine.call("delete_memory(m), delete_memory(quiet)")
    functors = [name.split("(")[0] for name in names(engine)]
    assert functors == ["memory_created", "v", "memory_updated", "memory_deleted"]
    assert names(engine)[2:] == ["memory_updated(m,5)", "memory_deleted(m)"]


@pytest.mark.parametrize(
    ("definition", "expected"),
    [
        ("v(X), [], _, m, 3", "v(X), [], v(X)"),
        ("v(X), [], R, m, 3", "v(X), [], v(X)"),
        ("v(X), [], X, m, 3", "v(X), [], X"),
        ("v(X), [Y = X], Y, m, 3", "v(X), [Y = X], Y"),
    ],
)
def test_creation_event_shows_definition(definition: str, expected: str) -> None:
    engine = RecordingEngine(goals=f"memorize({definition})")
    assert engine.call(f"{names(engine)[0]} =@= memory_created({expected}, m, 3)")


def test_rule_matches_memory_update() -> None:
    engine = RecordingEngine("seen(Id) <- memory_updated(Id, _).", "memorize(v(_), [], _, m, 3)")
    engine.event("v(1)", 5)
    assert "seen(m)" in names(engine)


def test_update_beyond_depth_limit_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    rules = "a(Y) <- a(X) where (X < 20, Y is X + 1). updated(I) <- memory_updated(I, _). done <- a(1)."
    engine = RecordingEngine(rules, "memorize(a(20), [], _, m, 5)", max_depth=19)
    engine.event("a(1)", 1)
    assert "update of memory m is not reported" in caplog.text
    assert records(engine) == ["a(20)"]
    assert engine.events[-1][0] == "done"


@pytest.mark.parametrize("memory", ["m", "n"])
def test_memories_of_all_events_ignore_updates(memory: str) -> None:
    goals = "memorize(v(_), [], _, v, 9), memorize(_, [], _, m, 100), memorize(_, [], _, n, 100)"
    engine = RecordingEngine(goals=goals)
    engine.event("v(1)", 1)
    # Updates of a memory of some events are recorded.
    assert records(engine, memory)[:2] == ["v(1)", "memory_updated(v,1)"]
    assert [record for record in records(engine, memory) if record.startswith("memory_updated")] == [
        "memory_updated(v,1)"
    ]


def test_memory_of_all_events_ignores_own_updates() -> None:
    engine = RecordingEngine(goals="memorize(E, [], _, m, 100)")
    engine.event("a", 1)
    assert [record.split("(")[0] for record in records(engine)].count("memory_updated") == 0
    assert "a" in records(engine)


def test_deleting_unknown_memory_gives_warning(caplog: pytest.LogCaptureFixture) -> None:
    engine = RecordingEngine()
    with caplog.at_level(logging.WARNING, "retalis"):
        assert engine.call("delete_memory(nothing)")
    assert "nothing" in caplog.text


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("memorize(v(X), [], _, m, 3)", "permission_error(create,memory,m)"),
        ("memorize(v(X), nothing, _, n, 3)", "type_error(list,nothing)"),
        ("memorize(v(X), [1], _, n, 3)", "type_error(callable,1)"),
        ("memorize(3, [], _, n, 3)", "type_error(callable,3)"),
        ("memorize(v(X), [], 3, n, 3)", "type_error(callable,3)"),
        ("memorize(v(X), [], _, n, many)", "type_error(integer,many)"),
        ("memorize(v(X), [], _, n, -1)", "domain_error(not_less_than_zero,-1)"),
        ("memorize(v(X), [], _, N, 3)", "instantiation_error"),
        ("memorize(v(X), [Y], _, n, 3)", "instantiation_error"),
    ],
)
def test_invalid_memory_is_refused(goal: str, error: str) -> None:
    engine = RecordingEngine(goals="memorize(v(X), [], _, m, 3)")
    with pytest.raises(PrologError) as caught:
        engine.call(goal)
    assert engine.show(compound(caught.value.term)[1]) == error
    assert [name_of(answer["Id"]) for answer in engine.query("memory_size(Id, _)")] == ["m"]


def test_error_of_condition_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    engine = RecordingEngine("ok <- v(_).", "memorize(v(X), [Y is X + 1], w(Y), m, 3)")
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("v(a)", 1)
    assert names(engine)[-1] == "ok"
    assert records(engine) == []
    assert "memory m" in caplog.text


def test_id_may_be_any_ground_term() -> None:
    engine = RecordingEngine(goals="memorize(v(_), [], _, room(1), 3)\nmemorize(v(_), [], _, 1, 3)")
    engine.event("v(x)", 1)
    assert records(engine, "room(1)") == records(engine, "1") == ["v(x)"]
    assert records(engine, "1.0") == []


def test_reader_ignores_records_added_meanwhile(engine_with_three_records: RecordingEngine) -> None:
    (answer,) = engine_with_three_records.query(
        "findall(X, (access_mem(m, v(X), _), new_event(v(9), 99, 0)), L)"
    )
    assert list_items(answer["L"]) == [3, 4, 2]


def test_failed_condition_restores_current_event() -> None:
    engine = Engine()
    engine.load(
        rules="null do wrong(X) <- b(X).\nwrong(X) :- X > foo.",
        goals="memorize(a(X), [(new_event(b(Y), 1, 1), Y > X)], a(X), first, 5)\nmemorize(a(_), [], _, second, 5)",
    )
    engine.event("a(1)", 1, 1)
    assert engine.dispatcher.current is None
    assert engine.query("access_mem(first, R, _)") == []
    assert len(engine.query("access_mem(second, R, _)")) == 1


@pytest.mark.parametrize(
    ("definition", "expected"),
    [
        ("v(X), [X = 1], v(X)", ["v(1)"]),
        ("v(X), [X = 1], _", ["v(A)"]),
        ("v(X), [Y = X], pair(X, Y)", ["pair(A,A)"]),
        ("v(X), [nonvar(X)], v(X)", []),
        ("E, [E = v(1)], seen(E)", ["seen(v(1))"]),
    ],
)
def test_conditions_bind_variables_of_event(definition: str, expected: List[str]) -> None:
    engine = RecordingEngine(goals=f"memorize({definition}, m, 10)")
    engine.event("v(_)", 1)
    assert [re.sub(r"_\w+", "A", record) for record in records(engine)] == expected


def test_template_has_bindings_and_fresh_variables() -> None:
    engine = RecordingEngine(goals="memorize(v(X), [member(Y-Z, [X-_, 3-4])], w(Y, Z, _), m, 10)")
    engine.event("v(1)", 1)
    assert engine.query("prev(m, w(1, a, b), _, _, 5), prev(m, w(1, c, d), _, _, 5)") == [{}]


SIZES = """
full(N) :- memory_counter(m, C), C >= N.
full(Id, N) :- memory_counter(Id, C), C >= N.
"""


def test_counter_is_queried_for_one_or_all_memories() -> None:
    engine = RecordingEngine(SIZES, "memorize(v(_), [], _, m, 2)\nmemorize(w(_), [], _, n(1), 5)")
    for number in range(4):
        engine.event(f"v({number})", number)
    for _ in range(20):  # until the predicate is compiled
        assert engine.call("full(4)")
        assert not engine.call("full(5)")
        assert [engine.show(answer["Id"]) for answer in engine.query("full(Id, 0)")] == ["m", "n(1)"]
    assert not engine.call("memory_counter(nothing, _)")
    assert not engine.call("memory_counter(m, 5)")
    assert not engine.call("memory_counter(n(_), _)")
    assert engine.query("Id = n(1), memory_size(Id, 5)") != []
    assert [answer["N"] for answer in engine.query("memory_size(_, N)")] == [2, 5]


def test_condition_may_read_own_memory() -> None:
    engine = RecordingEngine(goals="memorize(v(X), [memory_counter(m, N), N < 2], _, m, 5)")
    for number in range(4):
        engine.event(f"v({number})", number)
    assert records(engine) == ["v(1)", "v(0)"]


def test_memories_before_instant_are_missing() -> None:
    engine = RecordingEngine(goals="memorize(a, [], _, m, 5)\nmemorize(b, [], _, n, 5)")
    knowledge = engine.knowledge
    engine.event("a", 2)
    engine.event("b", 1)
    names = [atom("m"), atom("n")]
    for second, behind in ((0, ""), (1, ""), (2, "n"), (3, "mn")):
        missing = knowledge.find_missing_memories(names, second * SECOND)
        assert [(engine.show(memory.id), instant) for memory, instant in missing] == [
            (name, second * SECOND) for name in behind
        ]
    with pytest.raises(UsageError, match="there is no memory o"):
        knowledge.find_missing_memories([atom("o")], 0)


@pytest.mark.parametrize(
    ("goal", "advice"),
    [
        ("memorize(n, v(X), [], X, 3)", "the conditions are a list of goals, as in [V < 11] or []"),
        ("memorize(v(X), X > 1, X, n, 3)", "the conditions are a list of goals, as in [V < 11] or []"),
        ("memorize(v(X), [], n, X, 3)", "the id is not a variable"),
        ("memorize(v(X), [], X, 3, n)", "the size is a number of records"),
    ],
)
def test_error_of_misplaced_argument_shows_notation(goal: str, advice: str) -> None:
    with pytest.raises(PrologError) as caught:
        RecordingEngine().call(goal)
    assert f"{advice}: write memorize(Pattern, Conditions, Template, Id, Size)" in str(caught.value)
