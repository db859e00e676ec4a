"""Incremental tables over memories and states, and over facts that events change."""

import random
from pathlib import Path
from typing import Any, List, Set

import pytest
from asserting_accessors import stream_clock

from retalis import Engine, RetalisError

POSITIONS = "memorize(pos(P), [], pos(P), pos, 5)"
RULES = """
:- table m/1 as incremental.
m(P) :- prev(pos, pos(P), _, _, [1000,0]).
"""


class TableEngine(Engine):
    """An engine with goals and rules."""

    def __init__(self, goals: Any = POSITIONS, rules: Any = RULES) -> None:
        super().__init__()
        self.load(rules=rules, goals=goals)
        self.clock_time = 0

    def feed(self, *texts: Any) -> None:
        """Process events, one per second."""
        for text in texts:
            self.clock_time += 1
            self.event(text, self.clock_time)

    def values_of_x(self, goal: str) -> List[Any]:
        """Return the values of X for which a goal is true."""
        return [self.show(answer["X"]) for answer in self.query(goal)]


def test_table_depends_on_memory() -> None:
    program = TableEngine()
    assert program.values_of_x("m(X)") == []
    program.feed("pos(a)")
    assert program.values_of_x("m(X)") == ["a"]
    program.feed("pos(b)")
    assert program.values_of_x("m(X)") == ["b"]
    assert program.values_of_x("m(X)") == ["b"]


READING_GOALS = [
    "prev(pos, pos(X), _, _, [1000,0])",
    "prev_binary(pos, pos(X), _, _, [1000,0])",
    "next(pos, pos(X), _, _, [2,0], [1000,0])",
    "next_binary(pos, pos(X), _, _, [2,0], [1000,0])",
    "next_inf(pos, pos(X), _, _, [2,0])",
    "access_mem(pos, pos(X), _)",
    "memory_size(pos, X)",
    "memory_counter(pos, X)",
    "memory_counter(_, X)",
    "memory_gap(pos, [1,500000000], X)",
    "newest_matching(pos, pos(X), _, _)",
    "prev_matching(pos, pos(X), _, _, [1000,0])",
    "next_inf_matching(pos, pos(X), _, _, [2,0])",
    "next_matching(pos, pos(X), _, _, [2,0], [1000,0])",
    "findall(P, access_mem(pos, P, _), X)",
    "member(Id, [pos]), prev(Id, pos(X), _, _, [1000,0])",
    "call(prev, pos, pos(X), _, _, [1000,0])",
    "memory(pos, X)",
]


@pytest.mark.parametrize("goal", READING_GOALS)
def test_each_reading_goal_is_a_dependency(goal: str) -> None:
    own_memory = "memory(Id, X) :- access_mem(Id, pos(X), _), X \\== none.\n"
    program = TableEngine(
        rules=f"{own_memory}:- table t/1 as incremental.\nt(X) :- {goal}.\nplain(X) :- {goal}.\n"
    )
    texts = [f"pos({name})" for name in "abcdefgh"]
    generator = random.Random(goal)
    for _ in range(3):
        for text in texts:
            program.feed(text)
            assert set(program.values_of_x("t(X)")) == set(program.values_of_x("plain(X)"))
        program.query("delete_memory(pos)")
        assert set(program.values_of_x("t(X)")) == set(program.values_of_x("plain(X)"))
        program.query("memorize(pos(P), [], pos(P), pos, 5)")
        program.feed(generator.choice(texts))
        assert set(program.values_of_x("t(X)")) == set(program.values_of_x("plain(X)"))


@pytest.mark.parametrize("with_goals", [True, False])
def test_table_of_poses_depends_on_memories(with_goals: bool) -> None:
    chain = "pose_chain([tf], T, X)"
    earlier, later = "prev(tf, tf(V1, Q1), T1, _, T)", "next_inf(tf, tf(V2, Q2), T2, _, T)"
    steps = f"{earlier}, {later}, datime_interpolate(T1, T2, T, F), interpolate_quaternion(V1, Q1, V2, Q2, [F], X)"
    rules = f":- table at/2 as incremental.\nat(T, X) :- {steps if with_goals else chain}.\n"
    program = TableEngine("memorize(tf(V, Q), [], tf(V, Q), tf, 5)", rules)
    program.event("tf([0.0,0.0,0.0],[0.0,0.0,0.0,1.0])", 1)
    program.event("tf([3.0,0.0,0.0],[0.0,0.0,0.0,1.0])", 4)
    for nanoseconds in range(15):  # until it is compiled
        assert program.values_of_x(f"at([3,{nanoseconds}], X)")
    assert "2.0" in program.values_of_x("at([3,0], X)")[0]
    program.event("tf([8.0,0.0,0.0],[0.0,0.0,0.0,1.0])", 2)
    assert "5.5" in program.values_of_x("at([3,0], X)")[0]


def test_late_event_changes_table() -> None:
    program = TableEngine(rules=":- table t/1 as incremental.\nt(X) :- prev(pos, pos(X), _, _, [5,0]).\n")
    program.event("pos(a)", 1)
    program.event("pos(b)", 9)
    assert program.values_of_x("t(X)") == ["a"]
    program.event("pos(c)", 4)
    assert program.values_of_x("t(X)") == ["c"]


def test_recreated_memory_is_new_dependency() -> None:
    program = TableEngine()
    program.feed("pos(a)")
    assert program.values_of_x("m(X)") == ["a"]
    program.query(f"delete_memory(pos), {POSITIONS}")
    assert program.values_of_x("m(X)") == []
    program.feed("pos(b)")  # as many as before
    assert program.values_of_x("m(X)") == ["b"]


def test_clock_moved_back_clears_tables() -> None:
    program = TableEngine()
    program.feed("pos(a)")
    assert program.values_of_x("m(X)") == ["a"]
    stream_clock(program).move_to(-1, back=True)
    program.feed("other")
    assert program.values_of_x("m(X)") == []


COUNTING_RULES = """
:- dynamic runs/1.
runs(0).
:- table (near/1, far/1, both/1) as incremental.
near(P) :- counted, prev(pos, pos(P), _, _, [1000,0]).
far(P) :- prev(goal, goal(P), _, _, [1000,0]).
both(P-Q) :- near(P), far(Q).
counted :- retract(runs(N)), M is N + 1, assertz(runs(M)).
"""


def test_only_affected_tables_are_evaluated_again() -> None:
    program = TableEngine(f"{POSITIONS}\nmemorize(goal(P), [], goal(P), goal, 5)", COUNTING_RULES)
    program.feed("pos(a)", "goal(z)")
    assert program.values_of_x("both(X)") == ["a-z"]
    program.feed("goal(y)")
    assert program.values_of_x("both(X)") == ["a-y"]
    program.feed("other")
    assert program.values_of_x("near(X)") == ["a"]
    assert program.values_of_x("runs(X)") == ["1"]
    program.feed("pos(b)")
    assert program.values_of_x("both(X)") == ["b-y"]
    assert program.values_of_x("runs(X)") == ["2"]


DOCKED = ":- state(docked(R), from(dock(R)), until(undock(R)), [open(2), past(3)]).\n"
STATE_GOALS = [
    "holds(docked(X))",
    "holds(docked(X), _)",
    "holds_at(docked(X), 3)",
    "holds(docked(a)), X = yes",
    "holds(X)",
]


@pytest.mark.parametrize("goal", STATE_GOALS)
@pytest.mark.parametrize("flag", ["", ":- set_etalis_flag(revision_flag, on).\n"])
def test_table_depends_on_states(goal: str, flag: str) -> None:
    rules = f"{flag}{DOCKED}:- table t/1 as incremental.\nt(X) :- {goal}.\nplain(X) :- {goal}.\n"
    program = TableEngine("true", rules)
    generator = random.Random(goal + flag)
    event_forms = ["dock({})", "dock({})", "undock({})", *(["rev(dock({}))"] if flag else [])]
    distinct_answers: Set[Any] = set()
    for _ in range(60):
        program.feed(generator.choice(event_forms).format(generator.choice("abc")))
        answers = frozenset(program.values_of_x("t(X)"))
        assert answers == set(program.values_of_x("plain(X)"))
        distinct_answers.add(answers)
    assert len(distinct_answers) > 1
    program.query("reset_db")
    assert set(program.values_of_x("t(X)")) == set(program.values_of_x("plain(X)"))


def test_table_follows_timeouts_and_deletion_of_states() -> None:
    state = ":- state(hot(R), from(heat(R)), until(cool(R)), [within(5)]).\n"
    program = TableEngine("true", f"{state}:- table t/1 as incremental.\nt(R) :- holds(hot(R)).\n")
    program.event("heat(a)", 1)
    assert program.values_of_x("t(X)") == ["a"]
    program.event("other", 20)
    assert program.values_of_x("t(X)") == []
    program.event("heat(b)", 21)
    assert program.values_of_x("t(X)") == ["b"]
    program.query("delete_state(hot(_))")
    with pytest.raises(RetalisError, match="state"):
        program.values_of_x("t(X)")


def test_rules_query_tables_over_changing_facts() -> None:
    rules = """
    :- dynamic closed/1 as incremental.
    :- table way/2 as incremental.
    way(X, Y) :- link(X, Y), \\+ closed(X-Y).
    way(X, Z) :- way(X, Y), link(Y, Z), \\+ closed(Y-Z).
    link(a, b). link(b, c). link(a, c).
    close <- blocked(X) do assertz(closed(X)).
    open <- free(X) do retract(closed(X)).
    go(Y) <- goto(Y) where way(a, Y).
    stay(Y) <- goto(Y) where \\+ way(a, Y).
    """
    program = TableEngine("true", rules)
    events: List[Any] = []
    program.on_event(lambda term, start, end: events.append(program.show(term)))
    program.feed("goto(c)", "blocked(a-c)", "goto(c)", "blocked(b-c)", "goto(c)", "free(a-c)", "goto(c)")
    assert [text for text in events if text.startswith(("go(", "stay("))] == [
        "go(c)",
        "go(c)",
        "stay(c)",
        "go(c)",
    ]


def test_snapshot_excludes_answers_of_tables(tmp_path: Path) -> None:
    rules = RULES + ":- dynamic q/1 as incremental.\n:- table t/1 as incremental.\nt(X) :- q(X).\nq(1).\n"
    program = TableEngine(rules=rules)
    program.feed("pos(a)")
    assert program.values_of_x("m(X)") == ["a"]
    assert program.values_of_x("t(X)") == ["1"]
    restored = Engine.restore(program.snapshot())

    def all_of(goal: str) -> List[Any]:
        return [restored.show(answer["X"]) for answer in restored.query(goal)]

    assert all_of("m(X)") == ["a"]
    assert all_of("t(X)") == ["1"]
    restored.event("pos(b)", 5)
    restored.query("assertz(q(2))")
    assert all_of("m(X)") == ["b"]
    assert all_of("t(X)") == ["1", "2"]


def write(folder: Path, rules: Any, goals: str) -> None:
    (folder / "goalPredicates.txt").write_text(f"compile_event_file('rules.txt')\n{goals}\n")
    (folder / "rules.txt").write_text(rules)


def test_tables_follow_reload_and_rollback(tmp_path: Path) -> None:
    facts = ":- dynamic q/1 as incremental.\n:- table t/1 as incremental.\nt(X) :- q(X).\nq(1).\n"
    write(tmp_path, RULES + facts, POSITIONS)
    engine = Engine()
    engine.load_program(tmp_path)

    def all_of(goal: str) -> List[Any]:
        return [engine.show(answer["X"]) for answer in engine.query(goal)]

    engine.event("pos(a)", 1)
    engine.query("assertz(q(2))")
    assert (all_of("m(X)"), all_of("t(X)")) == (["a"], ["1", "2"])
    write(tmp_path, RULES + facts + "e <- f(.\n", POSITIONS)
    with pytest.raises(RetalisError):
        engine.reload(tmp_path)
    assert (all_of("m(X)"), all_of("t(X)")) == (["a"], ["1", "2"])
    engine.query("assertz(q(3))")
    engine.event("pos(b)", 2)
    assert (all_of("m(X)"), all_of("t(X)")) == (["b"], ["1", "2", "3"])
    write(tmp_path, RULES + facts.replace("q(1).", "q(7)."), POSITIONS.replace("5)", "6)"))
    engine.reload(tmp_path)
    assert all_of("m(X)") == []
    assert sorted(all_of("t(X)")) == sorted(all_of("q(X)"))
    engine.event("pos(c)", 3)
    engine.query("assertz(q(8))")
    assert all_of("m(X)") == ["c"]
    assert sorted(all_of("t(X)")) == sorted(all_of("q(X)"))


@pytest.mark.parametrize("seed", range(20))
def test_tables_equal_clauses_on_random_events(seed: int) -> None:
    """The same clauses with and without tables have equal answers after any changes."""
    generator = random.Random(seed)
    bodies = {
        "last": "prev(pos, pos(X), _, _, [1000,0])",
        "known": "access_mem(pos, pos(X), _), \\+ lost(X)",
        "at": "member(X, [a,b,c]), holds(docked(X)), {0}known(X)",
        "many": "aggregate_all(set(Y), {0}at(Y), L), length(L, X), memory_counter(pos, N), N > X",
        "any": "( {0}at(X) ; {0}last(X) ), \\+ lost(X)",
    }
    rules = [DOCKED, ":- dynamic lost/1 as incremental."]
    for name, body in bodies.items():
        for prefix in ("", "t_"):
            rules.append(f"{prefix}{name}(X) :- {body.format(prefix)}.")
        rules.append(f":- table t_{name}/1 as incremental.")
    program = TableEngine(rules="\n".join(rules))
    for _ in range(60):
        choice, name = generator.random(), generator.choice("abc")
        if choice < 0.4:
            program.feed(generator.choice((f"pos({name})", f"dock({name})", f"undock({name})")))
        elif choice < 0.6:
            program.query(generator.choice((f"assertz(lost({name}))", f"retractall(lost({name}))")))
        elif choice < 0.65:
            program.query(f"delete_memory(pos), {POSITIONS}")
        else:
            predicate = generator.choice(list(bodies))
            assert sorted(set(program.values_of_x(f"t_{predicate}(X)"))) == sorted(
                set(program.values_of_x(f"{predicate}(X)"))
            ), predicate


@pytest.mark.parametrize(
    "declaration",
    ["dynamic(between/3 as incremental)", "table(between/3 as incremental)", "dynamic([between/3], [])"],
)
def test_declared_library_predicate_may_have_facts(declaration: str) -> None:
    program = TableEngine("true", f":- {declaration}.\nbetween(a, b, c).\nx <- y.\n")
    assert program.values_of_x("between(a, b, X)") == ["c"]


@pytest.mark.parametrize(("declared", "warning_count"), [("fact", 0), ("other", 1)])
def test_rule_may_query_facts_declared_by_action(
    caplog: pytest.LogCaptureFixture, declared: str, warning_count: int
) -> None:
    rules = f"begin <- go do dynamic({declared}/1 as incremental).\nseen(X) <- ask where fact(X).\n"
    TableEngine("true", rules)
    assert len([record for record in caplog.records if "fact/1" in record.message]) == warning_count
