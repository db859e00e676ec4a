"""An engine whose state is taken, and one that takes it up: both go on alike."""

import random

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
from retalis.engine.engine import Engine as Whole
from retalis.prolog.terms.term_traversal import variables
from retalis.prolog.terms.timestamps import SECOND

ALARM = "exceptionAlarm(late(X), 5) <- start(X).\nwarned(X) <- late(X)."

PROGRAMS = {
    "sequence": ("pair(X, Y) <- a(X) seq b(Y).", "", ["a(1)", "a(2)"], ["b(1)", "b(2)", "b(3)"]),
    "shared values": (
        "pair(X) <- a(X) and b(X).",
        "",
        ["a(1)", "b(2)", "a(f(Z, Z))"],
        ["b(f(1, 1))", "b(1)", "a(2)"],
    ),
    "window": ("pair(X, Y) <- (a(X) seq b(Y)) within 3.", "", ["a(1)", "x", "a(2)"], ["b(1)", "b(2)"]),
    "absence": ("p(X) <- (a(X) seq b(Y)) cnot c(_).", "", ["a(1)", "c(1)", "a(2)"], ["b(1)", "b(2)"]),
    "never": ("p(X) <- a(X) fnot b(X).", "", ["b(1)"], ["a(1)", "a(2)"]),
    "repetitions": ("p(X, Y) <- a(X) seq (b(Y) star_times).", "", ["a(1)", "b(1)"], ["b(2)", "a(2)", "b(3)"]),
    "many of one": (
        "p <- a(_) ntimes 4.",
        "",
        ["a(1)", "a(2)", "a(3)"],
        ["a(4)", "a(5)", "a(6)", "a(7)", "a(8)"],
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
    "query for a time": (
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

ASKED = {
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


def shown(engine, term):
    """Return a term as text in which variables have no numbers, which differ."""
    names = {var: f"V{at}" for at, var in enumerate(variables(term))}
    return engine.logic.show(term, names=names)


def listened(engine):
    said = engine.said = []
    engine.on_event(lambda term, start, end: said.append((shown(engine, term), int(start), int(end))))
    engine.on_output(
        lambda term, topic, name: said.append(("out", shown(engine, term), topic, shown(engine, name)))
    )
    return engine


def feed(engine, events, first):
    for at, event in enumerate(events, first):
        term, when = event if isinstance(event, tuple) else (event, at)
        engine.event(term, when)


@pytest.mark.parametrize("name", PROGRAMS)
def test_goes_on_as_if_nothing_had_been(name):
    rules, goals, before, after = PROGRAMS[name]
    one = Engine()
    one.load(rules=rules, goals=goals)
    feed(one, before, 1)
    first = Engine.restore(one.snapshot())
    second = Engine.restore(Engine.restore(first.snapshot()).snapshot())
    for engine in (one, first, second):
        feed(listened(engine), after, len(before) + 1)
    assert one.said
    assert first.said == one.said
    assert second.said == one.said


@pytest.mark.parametrize("name", ASKED)
def test_knows_what_the_other_knew(name):
    rules, goal, query = ASKED[name]
    one = Engine()
    one.load(rules=rules)
    assert one.call(goal)
    other = Engine.restore(one.snapshot())
    expected = [{key: shown(one, value) for key, value in found.items()} for found in one.query(query)]
    assert expected
    assert [
        {key: shown(other, value) for key, value in found.items()} for found in other.query(query)
    ] == expected


def test_status_counts_on():
    one = Engine()
    one.load(rules="b <- a.", goals="memorize(a, [], _, m, 2)\nsubscribe(b, [], _, t, i)")
    feed(one, ["a", "a", "a"], 1)
    other = Engine.restore(one.snapshot())
    assert (
        other.status()._replace(seconds=0) == one.status()._replace(seconds=0)
        if hasattr(one.status(), "seconds")
        else True
    )
    assert other.status().taken == 3
    assert other.status().rules == one.status().rules
    assert other.status().memories == one.status().memories
    assert other.status().subscriptions == one.status().subscriptions


def test_what_a_memory_holds_is_the_same():
    one = Engine()
    one.load(goals="memorize(a(_), [], _, m, 100)")
    values = [1, -2.5, "'A b'", '"text"', "[1,2,[3]]", "f(X,Y,X)", f"{1 << 80}", "1.0e300", "{a}", "[]"]
    for at, value in enumerate(values):
        one.event(f"a({value})", at / 3, at)
    one.post_text("event(a(text), [datime(2020,1,2,3,4,5,6), datime(2020,1,2,3,4,5,6)])")
    one.post(functor("a", 1)(2), 5)
    wanted = [shown(one, found["R"]) + shown(one, found["I"]) for found in one.query("access_mem(m, R, I)")]
    other = Engine.restore(one.snapshot())
    assert [
        shown(other, found["R"]) + shown(other, found["I"]) for found in other.query("access_mem(m, R, I)")
    ] == wanted


@pytest.mark.slow
def test_a_long_list_is_kept():
    one = Engine()
    one.load(goals="memorize(a(_), [], _, m, 10)", rules="p(X) <- a(X) seq b.")
    one.event(functor("a", 1)(make_list(list(range(10_000)))), 1)
    other = Engine.restore(one.snapshot())
    assert other.query("access_mem(m, a(L), _), length(L, N), last(L, X)")[0]["N"] == 10_000
    found = []
    other.on_event(lambda term, start, end: found.append(term))
    other.event("b", 2)
    assert len(found) == 2


def test_rules_of_services_and_what_was_deleted(tmp_path):
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('r.txt')\nmemorize(a(_), [], _, m, 5)\n")
    (tmp_path / "r.txt").write_text("one : p(X) <- a(X) seq b.\nfact(1).\n:- dynamic seen/1.\nseen(0).\n")
    one = Engine()
    one.load_program(tmp_path)
    one.load_rules("two : q(X) <- a(X) seq c.")
    one.event("a(1)", 1)
    other = Engine.restore(one.snapshot())
    (tmp_path / "r.txt").write_text("three : p(X) <- a(X) seq d.\nfact(2).\n")
    assert other.reload(tmp_path) == one.reload(tmp_path)
    for engine in (one, other):
        feed(listened(engine), ["b", "c", "d", "a(2)", "d"], 2)
        assert engine.query("fact(X)") == [{"X": 2}]
    assert other.said == one.said


def test_an_alarm_of_a_rule_that_was_deleted_rings():
    one = Engine()
    one.load_rules("l : exceptionAlarm(late(X), 5) <- start(X).")
    one.event("start(1)", 1)
    assert one.call("del_event_rule(l)")
    other = Engine.restore(one.snapshot())
    for engine in (one, other):
        feed(listened(engine), ["x"], 20)
    assert other.said == one.said
    assert len(one.said) == 2


DUE_AT_ONE_INSTANT = {
    "state after timer": ("timer(t, after(2)), state(s, from(a), until(b), [within(1)])", ("a", 2)),
    "timer after state": ("state(s, from(a), until(b), [within(3)])", ("a", 1), ("set", 2)),
    "query after alarm": ("memorize(m, [], _, m, 3)", ("alarm", 2), ("ask", 2)),
    "alarm after query": ("memorize(m, [], _, m, 3)", ("ask", 2), ("alarm", 2)),
    "alarm after state": ("state(s, from(a), until(b), [within(3)])", ("a", 1), ("alarm", 2)),
}


@pytest.mark.parametrize("name", DUE_AT_ONE_INSTANT)
def test_restore_keeps_order_of_alarms_at_one_instant(name):
    goals, *events = DUE_AT_ONE_INSTANT[name]
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
    for either in (engine, restored):
        feed(listened(either), ["tick"], 9)
    assert {end for _, _, end in engine.said[:2]} == {engine.said[0][-1]}
    assert restored.said == engine.said


def test_restore_omits_state_whose_beginning_was_retracted():
    engine = Engine()
    engine.load(
        goals="set_etalis_flag(revision_flag, on), state(s(X), from(a(X)), until(b), [within(9)])",
        rules="open(L) <- c where findall(X, holds(s(X)), L).",
    )
    feed(engine, ["a(1)", "a(2)", "rev(a(1))", "c"], 1)
    restored = Engine.restore(engine.snapshot())
    for either in (engine, restored):
        feed(listened(either), ["c", "a(1)", "c", "c", "c", "c", "c"], 5)
    assert ("open([2,1])", 7 * SECOND, 7 * SECOND) in engine.said
    assert restored.said == engine.said


def test_a_clock_of_ones_own_is_not_moved_by_events():
    one = Engine(clock=StreamClock(50))
    one.load(rules="p <- a.")
    other = Engine.restore(one.snapshot())
    for engine in (one, other):
        engine.event("a", 1_000_000)
    assert other.clock.now() == one.clock.now()


@foreign
def half(number: int) -> float:
    return number / 2


def test_foreign_predicates_are_given_again():
    one = Engine()
    one.add_foreign(half)
    one.load(rules="p(Y) <- a(X) where half(X, Y).")
    other = listened(Engine.restore(one.snapshot(), foreign=(half,)))
    other.event("a(3)", 1)
    assert other.said[-1][0] == "p(1.5)"


def test_python_of_a_program_is_loaded_from_its_folder_only(tmp_path):
    (tmp_path / "mine.py").write_text(
        "from retalis import foreign\n@foreign\ndef third(x: int) -> float:\n    return x / 3\n"
    )
    (tmp_path / "goalPredicates.txt").write_text("use_foreign(mine)\n")
    allowed = Settings(allow_foreign=True)
    one = Engine(settings=allowed)
    one.load_program(tmp_path)
    data = one.snapshot()
    assert Engine.restore(data, settings=allowed, folder=tmp_path).query("third(6, X)") == [{"X": 2.0}]
    with pytest.raises(UsageError, match="not in a folder of its own"):
        Engine.restore(data, settings=allowed)
    with pytest.raises(UsageError, match="not in a folder of its own"):
        Engine.restore(data, settings=allowed, folder=tmp_path / "other")
    with pytest.raises(UsageError, match="allow_foreign is off"):
        Engine.restore(data, folder=tmp_path)


def test_not_in_the_midst_of_an_event():
    one = Engine()
    found = []

    def ask(term, start, end):
        with pytest.raises(UsageError, match="a goal or callback"):
            one.snapshot()
        found.append(term)

    one.on_event(ask)
    one.event("a", 1)
    assert found


def test_what_is_damaged_is_refused_and_nothing_else_happens():
    one = Engine()
    one.load(rules=ALARM, goals="memorize(start(_), [], _, m, 9)")
    feed(one, ["start(1)", "start(2)"], 1)
    data = one.snapshot()
    chance = random.Random(1)
    for at in [*range(60), *(chance.randrange(len(data)) for _ in range(150))]:
        broken = bytearray(data)
        broken[at] ^= 1 << chance.randrange(8)
        with pytest.raises(UsageError):
            Engine.restore(bytes(broken))
    for end in range(0, len(data), 97):
        with pytest.raises(UsageError):
            Engine.restore(data[:end])
    with pytest.raises(UsageError, match="longer than its header states"):
        Engine.restore(data + b"x")
    assert isinstance(Engine.restore(data), Whole)


def test_a_memory_of_no_records_knows_how_far_it_is():
    one = Engine()
    one.load(rules="synchronized(got(X), true, [[m, 2]]) <- ask(X).", goals="memorize(a, [], _, m, 0)")
    one.event("a", 3)
    other = listened(Engine.restore(one.snapshot()))
    other.event("ask(1)", 4)
    assert "got(1)" in [said[0] for said in other.said]


def test_a_query_whose_other_memory_was_deleted():
    one = Engine()
    one.load(
        rules="synchronized(got(X), true, [[m, 5], [n, 5]]) <- ask(X).",
        goals="memorize(a, [], _, m, 9)\nmemorize(b, [], _, n, 9)",
    )
    feed(one, ["ask(1)"], 1)
    feed(one, ["b"], 6)
    assert one.call("delete_memory(n)")
    other = Engine.restore(one.snapshot())
    for engine in (one, other):
        feed(listened(engine), ["a"], 7)
    assert other.said == one.said
    assert other.said


@pytest.mark.parametrize(
    "rules",
    [":- dynamic p/1.", ":- discontiguous p/1.", ":- multifile p/1.", ":- dynamic p/1.\np(1).", "p(1)."],
)
def test_predicates_are_as_defined_as_they_were(rules):
    def outcome(engine):
        try:
            return engine.call("p(1)")
        except PrologError as error:
            return error.message

    one = Engine()
    one.load_rules(rules)
    assert outcome(Engine.restore(one.snapshot())) == outcome(one)


def test_flags_that_settings_give_are_those_of_the_new_engine():
    one = Engine(settings=Settings(max_gap=5.0))
    assert Engine.restore(one.snapshot()).query("get_etalis_flag(max_gap, X)") == [{"X": -1}]
    record_origins(one)
    one.event("a", 1)
    assert not Engine.restore(one.snapshot()).rules.options.tracks_events


def test_topics_are_subscribed_once():
    one = Engine()
    asked = []
    one.input_topics.set_subscriber(asked.append, resolve_name=lambda topic: "/" + topic.lstrip("/"))
    one.call("subscribe_to('/scan', 'std_msgs/String')")
    other = Engine.restore(one.snapshot())
    again = []
    other.input_topics.set_subscriber(again.append, resolve_name=lambda topic: "/" + topic.lstrip("/"))
    other.call("subscribe_to('/scan', 'std_msgs/String')")
    assert again == asked
