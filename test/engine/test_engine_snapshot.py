"""A restored engine continues like the one whose snapshot it has."""

import random
from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest

from retalis import (
    Engine,
    PrologError,
    Settings,
    StreamClock,
    UsageError,
    foreign,
    functor,
    make_list,
    record_origins,
)
from retalis.prolog.terms.timestamps import SECOND

from .emissions import record_emissions, show

ALARM = "exceptionAlarm(late(X), 5) <- start(X).\nwarned(X) <- late(X)."

PROGRAMS: Dict[str, Tuple[str, str, List[Any], List[Any]]] = {
    "sequence": ("pair(X, Y) <- a(X) seq b(Y).", "", ["a(1)", "a(2)"], ["b(1)", "b(2)", "b(3)"]),
    "shared values": (
        "pair(X) <- a(X) and b(X).",
        "",
        ["a(1)", "b(2)", "a(f(Z, Z))"],
        ["b(f(1, 1))", "b(1)", "a(2)"],
    ),
    "window": ("pair(X, Y) <- (a(X) seq b(Y)) within 3.", "", ["a(1)", "x", "a(2)"], ["b(1)", "b(2)"]),
    "instants": (
        "p(X) <- at_end(a(X) seq b(X)) seq at_start(c(X)).",
        "",
        ["a(1)", "a(2)", "b(1)"],
        ["b(2)", "c(1)", "c(2)"],
    ),
    "absence": ("p(X) <- (a(X) seq b(Y)) cnot c(_).", "", ["a(1)", "c(1)", "a(2)"], ["b(1)", "b(2)"]),
    "negation": ("p(X) <- a(X) fnot b(X).", "", ["b(1)"], ["a(1)", "a(2)"]),
    "overlap": ("p(X) <- (a(X) seq b(_)) without c(X).", "", ["a(1)", "a(2)", "c(1)"], ["b(1)", "b(2)"]),
    "overlap of any": (
        "p(X) <- (a(X) and b(X)) without (c(Y) where Y > X).",
        "",
        ["a(1)", "a(2)", "a(3)", "c(2)"],
        ["b(1)", "b(2)", "b(3)"],
    ),
    "repetitions": ("p(X, Y) <- a(X) seq (b(Y) star_times).", "", ["a(1)", "b(1)"], ["b(2)", "a(2)", "b(3)"]),
    "repeated pattern": (
        "p <- a(_) ntimes 4.",
        "",
        ["a(1)", "a(2)", "a(3)"],
        ["a(4)", "a(5)", "a(6)", "a(7)", "a(8)"],
    ),
    "run group that has ended": (
        "p <- d fnot (a(_) ntimes 4).",
        "set_etalis_flag(revision_flag, on)",
        ["a(1)", ("a(2)", 1)],
        ["d", "a(3)", "a(4)", "a(5)", "d"],
    ),
    "aggregates": (
        "n(X, N) <- a(X) seq aggregate(avg(Y), b(X, Y), N).\nl(L) <- a(_) seq aggregate(list(Y), b(_, Y), L).",
        "",
        ["a(1)", "b(1, 2)", "b(1, 4.5)"],
        ["b(1, 1)", "b(2, 7)"],
    ),
    "alarm": (ALARM, "", ["start(1)", "start(2)"], ["x", "x", "x", "x", "x", "x"]),
    "policies": (
        "p(X, Y) <- a(X) seq b(Y).",
        "set_etalis_flag(event_consumption_policy, chronological)",
        ["a(1)", "a(2)"],
        ["b(1)", "b(2)"],
    ),
    "late events": (
        "p(X, Y) <- a(X) seq b(Y).",
        "set_etalis_flag(out_of_order, on)",
        ["b(1)", "a(1)"],
        ["b(2)", ("a(2)", 0.5), "b(3)"],
    ),
    "revision": (
        "p(X, Y) <- a(X) seq b(Y).\nq(X) <- p(X, _) seq c.\nr(X) <- (a(X) seq c) cnot b(_).",
        "set_etalis_flag(revision_flag, on)",
        ["a(1)", "b(1)", "c"],
        ["rev(b(1))", "c", "b(2)"],
    ),
    "justified": (
        "p(X, Y) <- a(X) seq b(Y).",
        "set_etalis_flag(etalis_justification, on)\nset_etalis_flag(store_fired_events, on)",
        ["a(1)", "b(1)"],
        ["a(2)", "b(2)"],
    ),
    "memory and query": (
        "synchronized(at(X, P), prev(m, pose(P), [T, T], _, _), [[m, T]]) <- seen(X) where (T = 3).",
        "memorize(pose(_), [], _, m, 3)\nsubscribe(at(_, _), [], _, out, i)\n"
        "subscribe(memory_updated(_, _), [], _, out, u)",
        ["pose(1)", "seen(1)"],
        ["pose(2)", "pose(3)", "seen(2)"],
    ),
    "query with a timeout": (
        "synchronized(at(X), true, [[m, 1000]], [timeout(3)]) <- seen(X).",
        "memorize(pose(_), [], _, m, 3)\nsubscribe(query_given_up(_, _, _), [], _, out, g)",
        ["pose(1)", "seen(1)"],
        ["x", "x", "x", "x", "x"],
    ),
    "rules with labels": (
        "r([property(event_rule_window, 2)]) : p(X, Y) <- a(X) seq b(Y).",
        "",
        ["a(1)"],
        ["b(1)", "a(2)", "x", "x", "b(2)"],
    ),
}

QUERIES = {
    "clauses": (":- dynamic p/1.\np(1).\np(X) :- q(X).\nq(2).", "assertz(p(9)), retract(q(2))", "p(X)"),
    "operators": (":- op(700, xfx, near).\nx(a near b).", "true", "x(X)"),
    "global variables": ("", 'nb_setval(v, f(Y, Y, [1, 2.5, "s"]))', "nb_getval(v, X)"),
    "counters": (
        "",
        "incCounter(c), incCounter(c), set_flag(f, g(1)), flag(n, _, 7), gensym(s, _)",
        "counter(c, A), get_flag(f, B), flag(n, C, C), gensym(s, D)",
    ),
    "tables": (
        ":- table path(_, _).\npath(X, Y) :- path(X, Z), edge(Z, Y).\npath(X, Y) :- edge(X, Y).\n"
        "edge(1, 2).\nedge(2, 3).",
        "path(1, 3)",
        "path(1, X)",
    ),
    "best answers": (":- table d(_, min).\nd(a, 3).\nd(a, 2).", "d(a, _)", "d(a, X)"),
    "flags": (
        "",
        "set_prolog_flag(double_quotes, codes), create_prolog_flag(mine, 3, [])",
        "current_prolog_flag(mine, X), current_prolog_flag(double_quotes, Y)",
    ),
    "library": (":- dynamic last/2.\nlast(mine, _).", "true", "last(X, _)"),
    "flags of events": (
        "",
        "set_etalis_flag(garbage_control, general), set_etalis_flag(garbage_window, 5)",
        "get_etalis_flag(garbage_window, X)",
    ),
}


def feed(engine: Engine, events: Any, first: int) -> None:
    """Feed one event per second from a first second on; an event may be a pair with its own time."""
    for second, event in enumerate(events, first):
        text, seconds = event if isinstance(event, tuple) else (event, second)
        engine.event(text, seconds)


def emissions_of(engine: Engine, events: Any, first: int) -> List[Any]:
    """Feed events to an engine; return the events and outputs that it emits for them."""
    emissions = record_emissions(engine)
    feed(engine, events, first)
    return emissions


@pytest.mark.parametrize("name", PROGRAMS)
def test_restored_engine_emits_same_events(name: str) -> None:
    rules, goals, before, after = PROGRAMS[name]
    original = Engine()
    original.load(rules=rules, goals=goals)
    feed(original, before, 1)
    first = Engine.restore(original.snapshot())
    second = Engine.restore(Engine.restore(first.snapshot()).snapshot())
    expected = emissions_of(original, after, len(before) + 1)
    assert expected
    assert emissions_of(first, after, len(before) + 1) == expected
    assert emissions_of(second, after, len(before) + 1) == expected


@pytest.mark.parametrize("name", QUERIES)
def test_restored_engine_has_same_solutions(name: str) -> None:
    rules, goal, query = QUERIES[name]
    original = Engine()
    original.load(rules=rules)
    assert original.call(goal)
    restored = Engine.restore(original.snapshot())
    expected = [
        {key: show(original, value) for key, value in solution.items()} for solution in original.query(query)
    ]
    assert expected
    assert [
        {key: show(restored, value) for key, value in solution.items()} for solution in restored.query(query)
    ] == expected


def test_restored_status_has_same_counts() -> None:
    original = Engine()
    original.load(rules="b <- a.", goals="memorize(a, [], _, m, 2)\nsubscribe(b, [], _, t, i)")
    feed(original, ["a", "a", "a"], 1)
    restored = Engine.restore(original.snapshot())
    assert restored.status()._replace(now=0) == original.status()._replace(now=0)
    assert restored.status().taken == 3
    assert restored.status().rules == original.status().rules
    assert restored.status().memories == original.status().memories
    assert restored.status().subscriptions == original.status().subscriptions


def test_restored_memory_has_same_records() -> None:
    original = Engine()
    original.load(goals="memorize(a(_), [], _, m, 100)")
    values = [1, -2.5, "'A b'", '"text"', "[1,2,[3]]", "f(X,Y,X)", f"{1 << 80}", "1.0e300", "{a}", "[]"]
    for number, value in enumerate(values):
        original.event(f"a({value})", number / 3, number)
    original.post_text("event(a(text), [datime(2020,1,2,3,4,5,6), datime(2020,1,2,3,4,5,6)])")
    original.post(functor("a", 1)(2), 5)
    expected = [
        show(original, solution["R"]) + show(original, solution["I"])
        for solution in original.query("access_mem(m, R, I)")
    ]
    assert len(expected) == 12
    restored = Engine.restore(original.snapshot())
    assert [
        show(restored, solution["R"]) + show(restored, solution["I"])
        for solution in restored.query("access_mem(m, R, I)")
    ] == expected


@pytest.mark.slow
def test_long_list_is_restored() -> None:
    original = Engine()
    original.load(goals="memorize(a(_), [], _, m, 10)", rules="p(X) <- a(X) seq b.")
    original.event(functor("a", 1)(make_list(list(range(10_000)))), 1)
    restored = Engine.restore(original.snapshot())
    assert restored.query("access_mem(m, a(L), _), length(L, N), last(L, X)")[0]["N"] == 10_000
    events: List[Any] = []
    restored.on_event(lambda term, start, end: events.append(term))
    restored.event("b", 2)
    assert len(events) == 2


def test_rules_of_services_are_restored_before_reload(tmp_path: Path) -> None:
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('r.txt')\nmemorize(a(_), [], _, m, 5)\n")
    (tmp_path / "r.txt").write_text("one : p(X) <- a(X) seq b.\nfact(1).\n:- dynamic seen/1.\nseen(0).\n")
    original = Engine()
    original.load_program(tmp_path)
    original.load_rules("two : q(X) <- a(X) seq c.")
    original.event("a(1)", 1)
    restored = Engine.restore(original.snapshot())
    (tmp_path / "r.txt").write_text("three : p(X) <- a(X) seq d.\nfact(2).\n")
    assert restored.reload(tmp_path) == original.reload(tmp_path)
    events = ["b", "c", "d", "a(2)", "d"]
    expected = emissions_of(original, events, 2)
    assert expected
    assert emissions_of(restored, events, 2) == expected
    assert original.query("fact(X)") == restored.query("fact(X)") == [{"X": 2}]


def test_alarm_of_deleted_rule_is_restored() -> None:
    original = Engine()
    original.load_rules("l : exceptionAlarm(late(X), 5) <- start(X).")
    original.event("start(1)", 1)
    assert original.call("del_event_rule(l)")
    restored = Engine.restore(original.snapshot())
    expected = emissions_of(original, ["x"], 20)
    assert len(expected) == 2
    assert emissions_of(restored, ["x"], 20) == expected


DUE_AT_ONE_INSTANT = {
    "state after timer": ("timer(t, after(2)), state(s, from(a), until(b), [within(1)])", [("a", 2)]),
    "timer after state": ("state(s, from(a), until(b), [within(3)])", [("a", 1), ("set", 2)]),
    "query after alarm": ("memorize(m, [], _, m, 3)", [("alarm", 2), ("ask", 2)]),
    "alarm after query": ("memorize(m, [], _, m, 3)", [("ask", 2), ("alarm", 2)]),
    "alarm after state": ("state(s, from(a), until(b), [within(3)])", [("a", 1), ("alarm", 2)]),
}


@pytest.mark.parametrize("name", DUE_AT_ONE_INSTANT)
def test_restore_keeps_order_of_alarms_at_one_instant(name: str) -> None:
    goals, events = DUE_AT_ONE_INSTANT[name]
    rules = (
        "null do timer(t, after(2)) <- set.\n"
        "exceptionAlarm(late, 2) <- alarm.\n"
        "synchronized(never, true, [[m, 100]], [timeout(2)]) <- ask."
    )
    engine = Engine()
    engine.event("start", 1)
    engine.load(rules=rules, goals=goals)
    feed(engine, events, 1)
    restored = Engine.restore(Engine.restore(engine.snapshot()).snapshot())
    expected = emissions_of(engine, ["tick"], 9)
    (_, _, first_end), (_, _, second_end) = expected[:2]
    assert first_end == second_end
    assert emissions_of(restored, ["tick"], 9) == expected


def test_restore_omits_retracted_state() -> None:
    engine = Engine()
    engine.load(
        goals="set_etalis_flag(revision_flag, on), state(s(X), from(a(X)), until(b), [within(9)])",
        rules="open(L) <- c where findall(X, holds(s(X)), L).",
    )
    feed(engine, ["a(1)", "a(2)", "rev(a(1))", "c"], 1)
    restored = Engine.restore(engine.snapshot())
    events = ["c", "a(1)", "c", "c", "c", "c", "c"]
    expected = emissions_of(engine, events, 5)
    assert ("open([2,1])", 7 * SECOND, 7 * SECOND) in expected
    assert emissions_of(restored, events, 5) == expected


def test_own_clock_is_not_moved_by_events() -> None:
    original = Engine(clock=StreamClock(50))
    original.load(rules="p <- a.")
    restored = Engine.restore(original.snapshot())
    for engine in (original, restored):
        engine.event("a", 1_000_000)
    assert restored.clock.now() == original.clock.now() == 50


@foreign
def half(number: int) -> float:
    return number / 2


def test_restored_rules_call_given_foreign_predicates() -> None:
    original = Engine()
    original.add_foreign(half)
    original.load(rules="p(Y) <- a(X) where half(X, Y).")
    restored = Engine.restore(original.snapshot(), foreign=(half,))
    assert emissions_of(restored, ["a(3)"], 1)[-1][0] == "p(1.5)"


FOREIGN_MODULE = "from retalis import foreign\n@foreign\ndef third(x: int) -> float:\n    return x / 3\n"


def test_python_module_is_loaded_from_program_folder(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(FOREIGN_MODULE)
    (tmp_path / "goalPredicates.txt").write_text("use_foreign(mine)\n")
    allowed = Settings(allow_foreign=True)
    original = Engine(settings=allowed)
    original.load_program(tmp_path)
    data = original.snapshot()
    assert Engine.restore(data, settings=allowed, folder=tmp_path).query("third(6, X)") == [{"X": 2.0}]
    with pytest.raises(UsageError, match="outside of the program's folder"):
        Engine.restore(data, settings=allowed)
    with pytest.raises(UsageError, match="outside of the program's folder"):
        Engine.restore(data, settings=allowed, folder=tmp_path / "other")
    with pytest.raises(UsageError, match="allow_foreign is off"):
        Engine.restore(data, folder=tmp_path)


@pytest.mark.parametrize(
    "name", ["../evil.py", "linked/../../evil.py", "{folder}/../evil.py", "{folder}x/evil.py"]
)
def test_python_module_outside_of_folder_is_refused(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "program"
    for path in (folder / "sub", tmp_path / "programx"):
        path.mkdir(parents=True)
    (folder / "linked").symlink_to(folder / "sub")
    for path in (tmp_path, tmp_path / "programx"):
        (path / "evil.py").write_text(FOREIGN_MODULE)
    allowed = Settings(allow_foreign=True)
    original = Engine(settings=allowed)
    # As a state that another program has written.
    original.logic.foreign_modules[name.format(folder=folder)] = None
    with pytest.raises(UsageError, match=r"evil\.py, which is outside of the program's folder"):
        Engine.restore(original.snapshot(), settings=allowed, folder=folder)


@pytest.mark.parametrize("is_link", [False, True])
def test_program_of_relative_folder_is_restored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_link: bool
) -> None:
    source = tmp_path / "mine.py" if is_link else tmp_path / "program" / "mine.py"
    (tmp_path / "program").mkdir()
    source.write_text(FOREIGN_MODULE)
    if is_link:
        (tmp_path / "program" / "mine.py").symlink_to(source)
    (tmp_path / "program" / "goalPredicates.txt").write_text("use_foreign(mine)\n")
    monkeypatch.chdir(tmp_path)
    allowed = Settings(allow_foreign=True)
    original = Engine(settings=allowed)
    original.load_program("program")
    restored = Engine.restore(original.snapshot(), settings=allowed, folder=Path("program"))
    assert restored.query("third(6, X)") == [{"X": 2.0}]


def test_snapshot_in_callback_is_refused() -> None:
    engine = Engine()
    events: List[Any] = []

    def ask(term: Any, start: Any, end: Any) -> None:
        with pytest.raises(UsageError, match="a goal or callback"):
            engine.snapshot()
        events.append(term)

    engine.on_event(ask)
    engine.event("a", 1)
    assert events


def test_damaged_state_is_refused() -> None:
    engine = Engine()
    engine.load(rules=ALARM, goals="memorize(start(_), [], _, m, 9)")
    feed(engine, ["start(1)", "start(2)"], 1)
    data = engine.snapshot()
    generator = random.Random(1)
    for position in [*range(60), *(generator.randrange(len(data)) for _ in range(150))]:
        broken = bytearray(data)
        broken[position] ^= 1 << generator.randrange(8)
        with pytest.raises(UsageError):
            Engine.restore(bytes(broken))
    for end in range(0, len(data), 97):
        with pytest.raises(UsageError):
            Engine.restore(data[:end])
    with pytest.raises(UsageError, match="longer than its header states"):
        Engine.restore(data + b"x")
    assert Engine.restore(data).query("access_mem(m, _, _)") != []


def test_memory_of_size_zero_keeps_its_progress() -> None:
    original = Engine()
    original.load(rules="synchronized(got(X), true, [[m, 2]]) <- ask(X).", goals="memorize(a, [], _, m, 0)")
    original.event("a", 3)
    restored = Engine.restore(original.snapshot())
    assert "got(1)" in [emission[0] for emission in emissions_of(restored, ["ask(1)"], 4)]


def test_query_continues_without_deleted_memory() -> None:
    original = Engine()
    original.load(
        rules="synchronized(got(X), true, [[m, 5], [n, 5]]) <- ask(X).",
        goals="memorize(a, [], _, m, 9)\nmemorize(b, [], _, n, 9)",
    )
    feed(original, ["ask(1)"], 1)
    feed(original, ["b"], 6)
    assert original.call("delete_memory(n)")
    restored = Engine.restore(original.snapshot())
    expected = emissions_of(original, ["a"], 7)
    assert expected
    assert emissions_of(restored, ["a"], 7) == expected


@pytest.mark.parametrize(
    ("rules", "expected"),
    [
        (":- dynamic p/1.", False),
        (":- discontiguous p/1.", "Unknown procedure: p/1"),
        (":- multifile p/1.", "Unknown procedure: p/1"),
        (":- dynamic p/1.\np(1).", True),
        ("p(1).", True),
    ],
)
def test_restored_predicates_are_defined_as_before(rules: str, expected: Any) -> None:
    def outcome(engine: Any) -> Any:
        try:
            return engine.call("p(1)")
        except PrologError as error:
            return error.message

    original = Engine()
    original.load_rules(rules)
    assert outcome(Engine.restore(original.snapshot())) == outcome(original) == expected


def test_flags_of_settings_are_those_of_new_engine() -> None:
    original = Engine(settings=Settings(max_gap=5.0))
    assert Engine.restore(original.snapshot()).query("get_etalis_flag(max_gap, X)") == [{"X": -1}]
    record_origins(original)
    original.event("a", 1)
    assert not Engine.restore(original.snapshot()).rules.network.options.tracks_events


def test_restored_engine_subscribes_to_same_topics() -> None:
    original = Engine()
    topics: List[Any] = []
    original.input_topics.set_subscriber(topics.append, resolve_name=lambda topic: "/" + topic.lstrip("/"))
    original.call("subscribe_to('/scan', 'std_msgs/String')")
    restored = Engine.restore(original.snapshot())
    restored_topics: List[Any] = []
    restored.input_topics.set_subscriber(
        restored_topics.append, resolve_name=lambda topic: "/" + topic.lstrip("/")
    )
    restored.call("subscribe_to('/scan', 'std_msgs/String')")
    assert len(topics) == 1
    assert restored_topics == topics
