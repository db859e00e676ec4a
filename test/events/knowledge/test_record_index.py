"""Look-up of matching records."""

import random

import pytest
from recording_engine import RecordingEngine

from retalis import Limits, PrologError, atom, deref, functor


def memory_of(engine):
    return engine.knowledge.memories.find(atom("m")).memory


@pytest.fixture
def objects():
    engine = RecordingEngine(goals="memorize(seen(Name, Place), [], o(Name, Place), objects, 5)")
    for time, name in ((1, "cup"), (2, "cup"), (3, "cup"), (4, "pen"), (5, "pen"), (6, "box"), (7, "pen")):
        engine.event(f"seen({name}, p({time}))", time)
    return engine  # that at 1 and 2 are over the size


@pytest.mark.parametrize(
    ("goal", "found"),
    [
        ("prev(objects, o(cup, _), _, T, 9)", None),
        ("prev_matching(objects, o(cup, _), _, T, 9)", 3),
        ("prev_matching(objects, o(cup, _), _, T, 3)", 3),
        ("prev_matching(objects, o(cup, _), _, T, 2.9)", None),
        ("prev_matching(objects, o(cup, _), _, T, [3,0])", 3),
        ("prev_matching(objects, o(pen, _), _, T, datime(1970,1,1,0,0,6,0))", 5),
        ("prev_matching(objects, o(pen, p(4)), _, T, 9)", 4),
        ("prev_matching(objects, o(pen, p(1)), _, T, 9)", None),
        ("prev_matching(objects, o(pen, _), 4, T, 9)", 4),
        ("prev_matching(objects, _, _, T, 6)", 6),
        ("prev_matching(objects, o(_), _, T, 9)", None),
        ("prev_matching(objects, o, _, T, 9)", None),
        ("newest_matching(objects, o(cup, _), _, T)", 3),
        ("newest_matching(objects, o(_, p(4)), _, T)", 4),
        ("newest_matching(objects, o(book, _), _, T)", None),
        ("next_inf_matching(objects, o(pen, _), _, T, 0)", 4),
        ("next_inf_matching(objects, o(pen, _), _, T, 5.5)", 7),
        ("next_inf_matching(objects, o(cup, _), _, T, 4)", None),
        ("next_matching(objects, o(box, _), _, T, 4, 6)", 6),
        ("next_matching(objects, o(box, _), _, T, 4, 5)", None),
        ("next_matching(objects, o(box, _), _, T, 7, 4)", None),
        ("newest_matching(nothing, o(cup, _), _, T)", None),
        ("prev_matching(nothing, o(cup, _), _, T, 1)", None),
        ("next_inf_matching(nothing, o(cup, _), _, T, 1)", None),
        ("next_matching(nothing, o(cup, _), _, T, 1, 2)", None),
    ],
)
def test_the_record_that_is_found(objects, goal, found):
    assert [deref(answer["T"]) for answer in objects.query(goal)] == ([] if found is None else [found])


@pytest.mark.parametrize("at", ["_", "foo", "[a,0]"])
def test_what_is_no_stamp_is_an_error(objects, at):
    for goal in (f"prev_matching(objects, _, _, _, {at})", f"next_matching(nothing, _, _, _, 1, {at})"):
        with pytest.raises(PrologError):
            objects.query(goal)


def test_there_is_one_solution_and_nothing_stays_bound_by_records_that_do_not_match():
    engine = RecordingEngine(goals="memorize(v(_, _), [], _, m, 9)")
    engine.event("v(X, X)", 1)
    engine.event("v(1, 2)", 2)
    engine.event("v(3, _)", 3)
    assert [engine.show(one["A"]) for one in engine.query("newest_matching(m, v(A, A), _, _)")] == ["3"]
    assert engine.query("newest_matching(m, v(B, B), _, 1), B = x, newest_matching(m, v(y, y), _, 1)") != []
    assert engine.query("newest_matching(m, v(1, A), _, _), A == 2") != []


def brute(records, name, low, high, newest_first):
    order = reversed(records) if newest_first else records
    return next((time for time, known in order if low <= time <= high and name in (known, "_")), None)


@pytest.mark.parametrize("seed", range(6))
def test_it_is_the_record_that_looking_at_all_of_them_finds(seed):
    pick = random.Random(seed)
    size = pick.choice([1, 3, 20, 60])
    engine = RecordingEngine(goals=f"memorize(v(_, _), [], _, m, {size})")
    names = ["a", "b", "1", "1.0", '"a"', "f(a)"]
    kept = []
    for step in range(150):
        name, time = pick.choice(names), step if pick.random() < 0.9 else pick.randint(0, step)
        engine.event(f"v(x, {name})", time)
        at = next((at for at, (end, _) in enumerate(kept) if end > time), len(kept))
        if at or len(kept) < size or not kept:
            kept.insert(at, (time, name))
            kept = kept[-size:]
        if step % 3:
            continue
        wanted, low, high = pick.choice([*names, "_"]), pick.randint(0, step), pick.randint(0, step + 1)
        pattern = f"v({pick.choice('x_')}, {wanted})"
        for goal, found in (
            (f"newest_matching(m, {pattern}, _, T)", brute(kept, wanted, 0, 999, True)),
            (f"prev_matching(m, {pattern}, _, T, {high})", brute(kept, wanted, 0, high, True)),
            (f"next_inf_matching(m, {pattern}, _, T, {low})", brute(kept, wanted, low, 999, False)),
            (f"next_matching(m, {pattern}, _, T, {low}, {high})", brute(kept, wanted, low, high, False)),
        ):
            assert [deref(one["T"]) for one in engine.query(goal)] == ([] if found is None else [found])


def test_a_known_argument_leads_to_its_records_without_looking_at_the_others():
    engine = RecordingEngine(goals="memorize(v(_, _), [], _, m, 900)")
    for time in range(400):
        engine.event(f"v({'rare' if time == 7 else 'often'}, {time})", time)
    memory = memory_of(engine)
    assert engine.query("newest_matching(m, v(rare, 7), _, _)") != []
    looked = []

    class Noted(list):
        def __getitem__(self, at):
            looked.append(at)
            return super().__getitem__(at)

    memory.records = Noted(memory.records)
    assert engine.query("newest_matching(m, v(rare, _), _, _)") != []
    assert engine.query("newest_matching(m, v(never, _), _, _)") == []
    assert looked == [7]


def test_a_long_search_is_work_of_the_goal_that_searches():
    engine = RecordingEngine(goals="memorize(v(_), [], _, m, 3000)")
    engine.logic.limits = Limits(inferences=2000)
    term = functor("v", 1)(functor("f", 1)(0))
    for time in range(3000):
        memory_of(engine).add((term, time, time))
    with pytest.raises(PrologError):
        engine.query("newest_matching(m, v(f(1)), _, _)")


def test_what_is_found_by_goes_with_the_lists_of_the_memory():
    engine = RecordingEngine(goals="memorize(v(_), [], _, m, 3)")
    memory = memory_of(engine)
    gone = 0
    for time in range(100):
        before = memory.records
        engine.event(f"v(a{time})", time)
        gone += memory.records is not before and not memory.indices
        assert engine.query(f"newest_matching(m, v(a{time}), _, _)") != []
        assert set(memory.indices) == {1}
    assert gone > 3
    memory.clear()
    assert memory.indices == {}


def test_finding_records_by_an_argument_costs_as_much_as_there_are_records():
    engine = RecordingEngine(goals="memorize(v(_), [], _, m, 5000)")
    for time in range(5000):
        memory_of(engine).add((functor("v", 1)(time), time, time))
    engine.logic.limits = Limits(inferences=10_000)
    assert engine.query("newest_matching(m, v(7), _, _)") != []
