"""Creation, recording, reading and deletion of memories by goals."""

import logging
import re

import pytest
from recording_engine import RecordingEngine

from retalis import Engine, PrologError, UsageError, atom, deref, list_items
from retalis.prolog.terms.timestamps import SECOND


def records(engine, name="m"):
    answers = engine.query(f"access_mem({name}, R, _)")
    return [engine.show(deref(answer["R"])) for answer in answers]


def names(engine):
    return [event for event, _, _ in engine.events]


def test_records_matching_events_in_their_own_form():
    engine = RecordingEngine(goals="memorize(tf(a, B, X), [X > 0], kept(B, X), m, 10)")
    for text in ("tf(a, b, 1)", "tf(c, b, 2)", "tf(a, d, -1)", "tf(a, e, 3)"):
        engine.event(text, 1)
    assert records(engine) == ["kept(e,3)", "kept(b,1)"]


def test_a_variable_as_record_keeps_the_event():
    engine = RecordingEngine(goals="memorize(v(X), [X > 1], _, m, 10)")
    engine.event("v(1)", 1)
    engine.event("v(2)", 2)
    assert records(engine) == ["v(2)"]


def test_pattern_conditions_and_record_share_their_variables_and_one_solution_counts():
    engine = RecordingEngine(goals="memorize(v(X), [member(Y, [10, 20]), Z is X + Y], w(X, Z), m, 10)")
    engine.event("v(1)", 1)
    assert records(engine) == ["w(1,11)"]


def test_records_with_variables_are_fresh_for_each_reader():
    engine = RecordingEngine(goals="memorize(v(X), [], pair(X, _), m, 10)")
    engine.event("v(1)", 1)
    assert engine.query("access_mem(m, pair(1, a), _), access_mem(m, pair(1, b), _)") != []
    assert engine.query("prev(m, P, _, _, 5), P = pair(_, a), prev(m, Q, _, _, 5), Q = pair(_, b)") != []


def test_an_event_with_variables_is_recorded_with_fresh_ones():
    engine = RecordingEngine("null do (new_event(v(_, 2), 1, 0)) <- go.", "memorize(v(X, Y), [], _, m, 10)")
    engine.event("go", 1)
    assert engine.query("access_mem(m, v(a, 2), _), access_mem(m, v(b, 2), _)") != []


@pytest.fixture
def three():
    engine = RecordingEngine(goals="memorize(v(X), [], _, m, 3)")
    for value, time in ((1, 10), (2, 20), (3, 30), (4, 25), (5, 5)):
        engine.event(f"v({value})", time)
    return engine


def test_records_lie_in_the_order_of_their_ends_and_the_newest_are_kept(three):
    assert records(three) == ["v(3)", "v(4)", "v(2)"]


@pytest.mark.parametrize(
    ("goal", "found"),
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
def test_look_ups(three, goal, found):
    answers = three.query(goal)
    if found is None:
        assert answers == []
    else:
        (answer,) = answers
        assert three.show(deref(answer["R"])) == found


def test_look_ups_give_the_interval_in_the_form_it_came_in():
    engine = RecordingEngine(goals="memorize(v(_), [], _, m, 3)")
    engine.event("v(1)", 5, 7.5)
    (answer,) = engine.query("prev(m, _, T1, T2, 8)")
    assert (deref(answer["T1"]), deref(answer["T2"])) == (5, 7.5)
    engine.post_text("new_event(v(2), 1413748205, 981209993)")
    (answer,) = engine.query("access_mem(m, v(2), [T, T])")
    assert engine.show(deref(answer["T"])) == "datime(2014,10,19,19,50,5.0,981209993)"
    assert engine.query("prev(m, v(2), _, _, datime(2014,10,19,19,50,5,981209993))") != []


def test_sizes_and_counts(three):
    assert three.query("memory_size(m, N), memory_counter(m, C)") == [{"N": 3, "C": 4}]
    assert [deref(answer["Id"]).name for answer in three.query("memory_size(Id, _)")] == ["m"]


def test_an_active_memory_tells_and_another_does_not():
    engine = RecordingEngine(goals="memorize(v(_), [], _, m, 3)\nmemorize_diactive(v(_), [], _, quiet, 3)")
    engine.event("v(1)", 5)
    engine.call("delete_memory(m), delete_memory(quiet)")
    kinds = [name.split("(")[0] for name in names(engine)]
    assert kinds == ["memory_created", "v", "memory_updated", "memory_deleted"]
    assert names(engine)[2:] == ["memory_updated(m,5)", "memory_deleted(m)"]


@pytest.mark.parametrize(
    ("definition", "told"),
    [
        ("v(X), [], _, m, 3", "v(X), [], v(X)"),
        ("v(X), [], R, m, 3", "v(X), [], v(X)"),
        ("v(X), [], X, m, 3", "v(X), [], X"),
        ("v(X), [Y = X], Y, m, 3", "v(X), [Y = X], Y"),
    ],
)
def test_the_event_of_a_new_memory_tells_what_is_kept(definition, told):
    engine = RecordingEngine(goals=f"memorize({definition})")
    assert engine.call(f"{names(engine)[0]} =@= memory_created({told}, m, 3)")


def test_a_rule_may_wait_for_an_update():
    engine = RecordingEngine("seen(Id) <- memory_updated(Id, _).", "memorize(v(_), [], _, m, 3)")
    engine.event("v(1)", 5)
    assert "seen(m)" in names(engine)


def test_an_update_that_is_too_deep_to_be_told_cuts_nothing_off(caplog):
    rules = "a(Y) <- a(X) where (X < 20, Y is X + 1). told(I) <- memory_updated(I, _). done <- a(1)."
    engine = RecordingEngine(rules, "memorize(a(20), [], _, m, 5)", max_depth=19)
    engine.event("a(1)", 1)
    assert "update of memory m is not reported" in caplog.text
    assert records(engine) == ["a(20)"]
    assert engine.events[-1][0] == "done"


@pytest.mark.parametrize("memory", ["m", "n"])
def test_memories_of_all_events_do_not_record_updates_of_each_other(memory):
    goals = "memorize(v(_), [], _, v, 9), memorize(_, [], _, m, 100), memorize(_, [], _, n, 100)"
    engine = RecordingEngine(goals=goals)
    engine.event("v(1)", 1)
    # Updates of a memory of some events are recorded.
    assert records(engine, memory)[:2] == ["v(1)", "memory_updated(v,1)"]
    assert [record for record in records(engine, memory) if record.startswith("memory_updated")] == [
        "memory_updated(v,1)"
    ]


def test_an_active_memory_of_everything_leaves_out_its_own_updates():
    engine = RecordingEngine(goals="memorize(E, [], _, m, 100)")
    engine.event("a", 1)
    assert [record.split("(")[0] for record in records(engine)].count("memory_updated") == 0
    assert "a" in records(engine)


def test_deleting_an_unknown_memory_warns_and_succeeds(caplog):
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
def test_what_is_no_memory_is_an_error_and_nothing_is_half_made(goal, error):
    engine = RecordingEngine(goals="memorize(v(X), [], _, m, 3)")
    with pytest.raises(PrologError) as caught:
        engine.call(goal)
    assert engine.show(caught.value.term[1]) == error
    assert [deref(answer["Id"]).name for answer in engine.query("memory_size(Id, _)")] == ["m"]


def test_a_condition_that_raises_is_reported_and_the_event_goes_on(caplog):
    engine = RecordingEngine("ok <- v(_).", "memorize(v(X), [Y is X + 1], w(Y), m, 3)")
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("v(a)", 1)
    assert names(engine)[-1] == "ok"
    assert records(engine) == []
    assert "memory m" in caplog.text


def test_ids_may_be_any_ground_term():
    engine = RecordingEngine(goals="memorize(v(_), [], _, room(1), 3)\nmemorize(v(_), [], _, 1, 3)")
    engine.event("v(x)", 1)
    assert records(engine, "room(1)") == records(engine, "1") == ["v(x)"]
    assert records(engine, "1.0") == []


def test_a_reader_sees_the_records_there_were_when_it_began(three):
    (answer,) = three.query("findall(X, (access_mem(m, v(X), _), new_event(v(9), 99, 0)), L)")
    assert list_items(answer["L"]) == [3, 4, 2]


def test_a_condition_that_fails_in_an_event_of_its_own_leaves_the_event_as_it_was():
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
    ("definition", "kept"),
    [
        ("v(X), [X = 1], v(X)", ["v(1)"]),
        ("v(X), [X = 1], _", ["v(A)"]),
        ("v(X), [Y = X], pair(X, Y)", ["pair(A,A)"]),
        ("v(X), [nonvar(X)], v(X)", []),
        ("E, [E = v(1)], seen(E)", ["seen(v(1))"]),
    ],
)
def test_conditions_see_the_variables_of_an_event(definition, kept):
    engine = RecordingEngine(goals=f"memorize({definition}, m, 10)")
    engine.event("v(_)", 1)
    assert [re.sub(r"_\w+", "A", record) for record in records(engine)] == kept


def test_a_form_under_conditions_has_what_they_found_and_variables_of_its_own():
    engine = RecordingEngine(goals="memorize(v(X), [member(Y-Z, [X-_, 3-4])], w(Y, Z, _), m, 10)")
    engine.event("v(1)", 1)
    assert engine.query("prev(m, w(1, a, b), _, _, 5), prev(m, w(1, c, d), _, _, 5)") == [{}]


SIZES = """
full(N) :- memory_counter(m, C), C >= N.
full(Id, N) :- memory_counter(Id, C), C >= N.
"""


def test_how_many_records_there_were_is_known_of_one_memory_or_of_each():
    engine = RecordingEngine(SIZES, "memorize(v(_), [], _, m, 2)\nmemorize(w(_), [], _, n(1), 5)")
    for number in range(4):
        engine.event(f"v({number})", number)
    for _ in range(20):  # until it is compiled
        assert engine.call("full(4)")
        assert not engine.call("full(5)")
        assert [engine.show(found["Id"]) for found in engine.query("full(Id, 0)")] == ["m", "n(1)"]
    assert not engine.call("memory_counter(nothing, _)")
    assert not engine.call("memory_counter(m, 5)")
    assert not engine.call("memory_counter(n(_), _)")
    assert engine.query("Id = n(1), memory_size(Id, 5)") != []
    assert [found["N"] for found in engine.query("memory_size(_, N)")] == [2, 5]


def test_a_memory_may_look_at_itself_to_stop_when_it_is_full():
    engine = RecordingEngine(goals="memorize(v(X), [memory_counter(m, N), N < 2], _, m, 5)")
    for number in range(4):
        engine.event(f"v({number})", number)
    assert records(engine) == ["v(1)", "v(0)"]


def test_which_memories_are_behind():
    engine = RecordingEngine(goals="memorize(a, [], _, m, 5)\nmemorize(b, [], _, n, 5)")
    knowledge = engine.knowledge
    engine.event("a", 2)
    engine.event("b", 1)
    names = [atom("m"), atom("n")]
    for second, behind in ((0, ""), (1, ""), (2, "n"), (3, "mn")):
        found = knowledge.find_missing_memories(names, second * SECOND)
        assert [(engine.show(memory.id), instant) for memory, instant in found] == [
            (name, second * SECOND) for name in behind
        ]
    with pytest.raises(UsageError, match="there is no memory o"):
        knowledge.find_missing_memories([atom("o")], 0)


@pytest.mark.parametrize(
    "goal, advice",
    [
        ("memorize(n, v(X), [], X, 3)", "the conditions are a list of goals, as in [V < 11] or []"),
        ("memorize(v(X), X > 1, X, n, 3)", "the conditions are a list of goals, as in [V < 11] or []"),
        ("memorize(v(X), [], n, X, 3)", "the id is not a variable"),
        ("memorize(v(X), [], X, 3, n)", "the size is a number of records"),
    ],
)
def test_error_of_misplaced_argument_shows_the_notation(goal, advice):
    with pytest.raises(PrologError) as caught:
        RecordingEngine().call(goal)
    assert f"{advice}: write memorize(Pattern, Conditions, Template, Id, Size)" in str(caught.value)
