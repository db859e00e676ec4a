"""Requests of clients: limits, and synchronization with memories."""

import threading

import pytest

from retalis import Engine, Limits, PrologError, Settings, SyntaxFault, UsageError, atom
from retalis.engine.client_requests import ask, wait_for_memories


def values(answer):
    return [
        [(binding.name, binding.text, binding.json) for binding in solution] for solution in answer.solutions
    ]


def test_solutions_have_text_and_json():
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


def test_variables_with_underscore_are_omitted():
    assert values(ask(Engine(), "_X = 1")) == [[]]


def test_failing_goal_has_no_solutions():
    assert ask(Engine(), "fail") == ([], True)


def test_number_of_solutions_is_limited():
    answer = ask(Engine(), "repeat", 3)
    assert len(answer.solutions) == 3 and not answer.complete
    assert ask(Engine(), "member(X, [1, 2])", 2).complete


def test_length_of_answer_is_limited():
    answer = ask(Engine(), "between(1, 1000, X)", 1000, max_characters=10)
    assert [text for ((_, text, _),) in answer.solutions] == ["1", "2", "3", "4", "5", "6", "7", "8", "9"]
    assert not answer.complete


def test_first_solution_over_length_limit_is_an_error():
    with pytest.raises(UsageError, match="more than 10 characters"):
        ask(Engine(), "numlist(1, 1000, L)", max_characters=10)


def test_limits_of_request_apply_to_request_only():
    engine = Engine()
    with pytest.raises(PrologError, match="inferences"):
        ask(engine, "repeat, fail", limits=Limits(inferences=10_000))
    assert ask(engine, "between(1, 100000, X), X =:= 100000").complete


def test_limits_of_engine_apply_to_requests():
    engine = Engine(settings=Settings(limits=Limits(inferences=10_000)))
    with pytest.raises(PrologError, match="inferences"):
        ask(engine, "repeat, fail", limits=Limits(inferences=10_000_000))
    with pytest.raises(PrologError, match="inferences"):
        ask(engine, "repeat, fail")


def test_syntax_error_has_position():
    with pytest.raises(SyntaxFault, match="column"):
        ask(Engine(), "f(X")


@pytest.fixture
def engine():
    engine = Engine()
    engine.load(goals="memorize(v(_), [], _, m, 10)\nmemorize(w(_), [], _, n, 10)")
    return engine


def test_available_records_need_no_wait(engine):
    engine.event("v(1)", 5)
    wait_for_memories(engine, [atom("m")], 5_000_000_000, 0)


def test_engine_processes_events_while_request_waits(engine):
    done = []

    def wait():
        wait_for_memories(engine, [atom("m"), atom("n")], 5_000_000_000, 60)
        done.append([solution[0].text for solution in ask(engine, "access_mem(m, v(X), _)").solutions])

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


def test_wait_ends_with_error_after_timeout(engine):
    engine.event("v(1)", 3)
    with pytest.raises(UsageError, match=r"in memory m \(2 s too early\), n \(nothing yet\) after 0.01 s"):
        wait_for_memories(engine, [atom("m"), atom("n")], 5_000_000_000, 0.01)
    assert waiting(engine) == 0


def test_wait_for_unknown_memory_is_an_error(engine):
    with pytest.raises(UsageError, match="there is no memory x"):
        wait_for_memories(engine, [atom("x")], 0, 1)


def test_deleted_memory_ends_wait(engine):
    ended = []

    def wait():
        with pytest.raises(UsageError, match="deleted"):
            wait_for_memories(engine, [atom("m")], 5_000_000_000, 60)
        ended.append(True)

    thread = threading.Thread(target=wait)
    thread.start()
    while not waiting(engine):
        pass
    engine.delete_memory(atom("m"))
    thread.join(60)
    assert ended and engine.query("true")
