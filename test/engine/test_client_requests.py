"""Questions from outside: bounded, and synchronized with memories."""

import threading

import pytest

from retalis import Engine, Limits, PrologError, Settings, SyntaxFault, UsageError, atom
from retalis.engine.client_requests import ask, wait_for_memories


def values(answer):
    return [[(one.name, one.text, one.json) for one in solution] for solution in answer.solutions]


def test_solutions_come_as_text_and_json():
    found = ask(Engine(), "member(X, [a, 'B c', f(Y, Y)])")
    assert values(found) == [
        [("X", "a", '"a"'), ("Y", "_1", '{"variable": "_1"}')],
        [("X", "'B c'", '"B c"'), ("Y", "_1", '{"variable": "_1"}')],
        [
            ("X", "f(_1,_1)", '{"functor": "f", "args": [{"variable": "_1"}, {"variable": "_1"}]}'),
            ("Y", "_1", '{"variable": "_1"}'),
        ],
    ]
    assert found.complete


def test_names_with_an_underscore_are_left_out():
    assert values(ask(Engine(), "_X = 1")) == [[]]


def test_a_goal_that_fails_has_no_solutions():
    assert ask(Engine(), "fail") == ([], True)


def test_at_most_so_many():
    found = ask(Engine(), "repeat", 3)
    assert len(found.solutions) == 3 and not found.complete
    assert ask(Engine(), "member(X, [1, 2])", 2).complete


def test_at_most_so_long():
    found = ask(Engine(), "between(1, 1000, X)", 1000, max_characters=10)
    assert [text for ((_, text, _),) in found.solutions] == ["1", "2", "3", "4", "5", "6", "7", "8", "9"]
    assert not found.complete


def test_one_that_is_too_long_is_an_error():
    with pytest.raises(UsageError, match="more than 10 characters"):
        ask(Engine(), "numlist(1, 1000, L)", max_characters=10)


def test_limits_of_its_own_hold_and_only_for_it():
    engine = Engine()
    with pytest.raises(PrologError, match="inferences"):
        ask(engine, "repeat, fail", limits=Limits(inferences=10_000))
    assert ask(engine, "between(1, 100000, X), X =:= 100000").complete


def test_limits_of_the_engine_hold_besides():
    engine = Engine(settings=Settings(limits=Limits(inferences=10_000)))
    with pytest.raises(PrologError, match="inferences"):
        ask(engine, "repeat, fail", limits=Limits(inferences=10_000_000))
    with pytest.raises(PrologError, match="inferences"):
        ask(engine, "repeat, fail")


def test_what_is_no_goal_is_an_error_with_its_place():
    with pytest.raises(SyntaxFault, match="column"):
        ask(Engine(), "f(X")


@pytest.fixture
def engine():
    found = Engine()
    found.load(goals="memorize(v(_), [], _, m, 10)\nmemorize(w(_), [], _, n, 10)")
    return found


def test_data_that_are_there_are_not_waited_for(engine):
    engine.event("v(1)", 5)
    wait_for_memories(engine, [atom("m")], 5_000_000_000, 0)


def test_others_work_while_it_waits(engine):
    done = []

    def wait():
        wait_for_memories(engine, [atom("m"), atom("n")], 5_000_000_000, 60)
        done.append([one[0].text for one in ask(engine, "access_mem(m, v(X), _)").solutions])

    thread = threading.Thread(target=wait)
    thread.start()
    while not engine.query("true") or not waiting(engine):
        pass
    engine.event("v(1)", 6)
    assert waiting(engine) == 1
    engine.event("w(1)", 7)
    thread.join(60)
    assert done == [["1"]] and waiting(engine) == 0


def waiting(engine):
    return len(engine.knowledge.pending_queries)


def test_it_waits_no_longer_than_it_was_told(engine):
    engine.event("v(1)", 3)
    with pytest.raises(UsageError, match=r"in memory m \(2 s too early\), n \(nothing yet\) after 0.01 s"):
        wait_for_memories(engine, [atom("m"), atom("n")], 5_000_000_000, 0.01)
    assert waiting(engine) == 0


def test_an_unknown_memory_is_an_error(engine):
    with pytest.raises(UsageError, match="there is no memory x"):
        wait_for_memories(engine, [atom("x")], 0, 1)


def test_a_memory_that_is_deleted_ends_it(engine):
    found = []

    def wait():
        with pytest.raises(UsageError, match="deleted"):
            wait_for_memories(engine, [atom("m")], 5_000_000_000, 60)
        found.append(True)

    thread = threading.Thread(target=wait)
    thread.start()
    while not waiting(engine):
        pass
    engine.delete_memory(atom("m"))
    thread.join(60)
    assert found and engine.query("true")
