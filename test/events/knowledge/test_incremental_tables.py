"""Incremental tables over memories and states, and over facts that events change."""

import random

import pytest

from retalis import Engine, RetalisError

POSITIONS = "memorize(pos(P), [], pos(P), pos, 5)"
RULES = """
:- table m/1 as incremental.
m(P) :- prev(pos, pos(P), _, _, [1000,0]).
"""


class Program(Engine):
    """An engine with goals and rules."""

    def __init__(self, goals=POSITIONS, rules=RULES):
        super().__init__()
        self.load(rules=rules, goals=goals)
        self.now = 0

    def events(self, *texts):
        """Have events happen, one a second."""
        for text in texts:
            self.now += 1
            self.event(text, self.now)

    def all(self, goal):
        """Return the values of X for which a goal is true."""
        return [self.show(found["X"]) for found in self.query(goal)]


def test_a_table_follows_the_memory_that_it_reads():
    program = Program()
    assert program.all("m(X)") == []
    program.events("pos(a)")
    assert program.all("m(X)") == ["a"]
    program.events("pos(b)")
    assert program.all("m(X)") == ["b"]
    assert program.all("m(X)") == ["b"]


READS = [
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


@pytest.mark.parametrize("reads", READS)
def test_each_way_to_read_a_memory_counts(reads):
    own = "memory(Id, X) :- access_mem(Id, pos(X), _), X \\== none.\n"
    program = Program(rules=f"{own}:- table t/1 as incremental.\nt(X) :- {reads}.\nplain(X) :- {reads}.\n")
    texts = [f"pos({name})" for name in "abcdefgh"]
    rng = random.Random(reads)
    for _ in range(3):
        for text in texts:
            program.events(text)
            assert set(program.all("t(X)")) == set(program.all("plain(X)"))
        program.query("delete_memory(pos)")
        assert set(program.all("t(X)")) == set(program.all("plain(X)"))
        program.query("memorize(pos(P), [], pos(P), pos, 5)")
        program.events(rng.choice(texts))
        assert set(program.all("t(X)")) == set(program.all("plain(X)"))


@pytest.mark.parametrize("joined", [True, False])
def test_poses_are_read_from_memories(joined):
    chain = "pose_chain([tf], T, X)"
    one, two = "prev(tf, tf(V1, Q1), T1, _, T)", "next_inf(tf, tf(V2, Q2), T2, _, T)"
    steps = f"{one}, {two}, datime_interpolate(T1, T2, T, F), interpolate_quaternion(V1, Q1, V2, Q2, [F], X)"
    rules = f":- table at/2 as incremental.\nat(T, X) :- {steps if joined else chain}.\n"
    program = Program("memorize(tf(V, Q), [], tf(V, Q), tf, 5)", rules)
    program.event("tf([0.0,0.0,0.0],[0.0,0.0,0.0,1.0])", 1)
    program.event("tf([3.0,0.0,0.0],[0.0,0.0,0.0,1.0])", 4)
    for nanoseconds in range(15):  # until it is compiled
        assert program.all(f"at([3,{nanoseconds}], X)")
    assert "2.0" in program.all("at([3,0], X)")[0]
    program.event("tf([8.0,0.0,0.0],[0.0,0.0,0.0,1.0])", 2)
    assert "5.5" in program.all("at([3,0], X)")[0]


def test_an_event_that_comes_late_changes_a_table():
    program = Program(rules=":- table t/1 as incremental.\nt(X) :- prev(pos, pos(X), _, _, [5,0]).\n")
    program.event("pos(a)", 1)
    program.event("pos(b)", 9)
    assert program.all("t(X)") == ["a"]
    program.event("pos(c)", 4)
    assert program.all("t(X)") == ["c"]


def test_a_memory_made_anew_is_another_one():
    program = Program()
    program.events("pos(a)")
    assert program.all("m(X)") == ["a"]
    program.query(f"delete_memory(pos), {POSITIONS}")
    assert program.all("m(X)") == []
    program.events("pos(b)")  # as many as before
    assert program.all("m(X)") == ["b"]


def test_time_that_goes_back_empties_memories_and_tables():
    program = Program()
    program.events("pos(a)")
    assert program.all("m(X)") == ["a"]
    program.clock.move_to(-1, back=True)
    program.events("other")
    assert program.all("m(X)") == []


COUNTED = """
:- dynamic runs/1.
runs(0).
:- table (near/1, far/1, both/1) as incremental.
near(P) :- counted, prev(pos, pos(P), _, _, [1000,0]).
far(P) :- prev(goal, goal(P), _, _, [1000,0]).
both(P-Q) :- near(P), far(Q).
counted :- retract(runs(N)), M is N + 1, assertz(runs(M)).
"""


def test_only_tables_that_have_read_what_changed_are_evaluated_again():
    program = Program(f"{POSITIONS}\nmemorize(goal(P), [], goal(P), goal, 5)", COUNTED)
    program.events("pos(a)", "goal(z)")
    assert program.all("both(X)") == ["a-z"]
    program.events("goal(y)")
    assert program.all("both(X)") == ["a-y"]
    program.events("other")
    assert program.all("near(X)") == ["a"]
    assert program.all("runs(X)") == ["1"]
    program.events("pos(b)")
    assert program.all("both(X)") == ["b-y"]
    assert program.all("runs(X)") == ["2"]


DOCKED = ":- state(docked(R), from(dock(R)), until(undock(R)), [open(2), past(3)]).\n"
ASKED = [
    "holds(docked(X))",
    "holds(docked(X), _)",
    "holds_at(docked(X), 3)",
    "holds(docked(a)), X = yes",
    "holds(X)",
]


@pytest.mark.parametrize("asks", ASKED)
@pytest.mark.parametrize("flag", ["", ":- set_etalis_flag(revision_flag, on).\n"])
def test_a_table_follows_the_states_that_it_asks_for(asks, flag):
    rules = f"{flag}{DOCKED}:- table t/1 as incremental.\nt(X) :- {asks}.\nplain(X) :- {asks}.\n"
    program = Program("true", rules)
    rng = random.Random(asks + flag)
    kinds = ["dock({})", "dock({})", "undock({})", *(["rev(dock({}))"] if flag else [])]
    changed = set()
    for _ in range(60):
        program.events(rng.choice(kinds).format(rng.choice("abc")))
        found = frozenset(program.all("t(X)"))
        assert found == set(program.all("plain(X)"))
        changed.add(found)
    assert len(changed) > 1
    program.query("reset_db")
    assert set(program.all("t(X)")) == set(program.all("plain(X)"))


def test_states_that_end_by_themselves_and_declarations_that_go():
    state = ":- state(hot(R), from(heat(R)), until(cool(R)), [within(5)]).\n"
    program = Program("true", f"{state}:- table t/1 as incremental.\nt(R) :- holds(hot(R)).\n")
    program.event("heat(a)", 1)
    assert program.all("t(X)") == ["a"]
    program.event("other", 20)
    assert program.all("t(X)") == []
    program.event("heat(b)", 21)
    assert program.all("t(X)") == ["b"]
    program.query("delete_state(hot(_))")
    with pytest.raises(RetalisError, match="state"):
        program.all("t(X)")


def test_rules_ask_tables_over_facts_that_events_change():
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
    program = Program("true", rules)
    seen = []
    program.on_event(lambda term, start, end: seen.append(program.show(term)))
    program.events("goto(c)", "blocked(a-c)", "goto(c)", "blocked(b-c)", "goto(c)", "free(a-c)", "goto(c)")
    assert [text for text in seen if text.startswith(("go(", "stay("))] == [
        "go(c)",
        "go(c)",
        "stay(c)",
        "go(c)",
    ]


def test_a_state_of_an_engine_holds_no_answers_that_may_change(tmp_path):
    rules = RULES + ":- dynamic q/1 as incremental.\n:- table t/1 as incremental.\nt(X) :- q(X).\nq(1).\n"
    program = Program(rules=rules)
    program.events("pos(a)")
    assert program.all("m(X)") == ["a"]
    assert program.all("t(X)") == ["1"]
    other = Engine.restore(program.snapshot())

    def all_of(goal):
        return [other.show(found["X"]) for found in other.query(goal)]

    assert all_of("m(X)") == ["a"]
    assert all_of("t(X)") == ["1"]
    other.event("pos(b)", 5)
    other.query("assertz(q(2))")
    assert all_of("m(X)") == ["b"]
    assert all_of("t(X)") == ["1", "2"]


def write(folder, rules, goals):
    (folder / "goalPredicates.txt").write_text(f"compile_event_file('rules.txt')\n{goals}\n")
    (folder / "rules.txt").write_text(rules)


def test_tables_after_a_reload_and_after_one_that_is_taken_back(tmp_path):
    facts = ":- dynamic q/1 as incremental.\n:- table t/1 as incremental.\nt(X) :- q(X).\nq(1).\n"
    write(tmp_path, RULES + facts, POSITIONS)
    engine = Engine()
    engine.load_program(tmp_path)

    def all_of(goal):
        return [engine.show(found["X"]) for found in engine.query(goal)]

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
def test_random_events_and_questions(seed):
    """The same clauses with tables and without give the same answers, whatever happens between."""
    rng = random.Random(seed)
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
    program = Program(rules="\n".join(rules))
    for _ in range(60):
        what, name = rng.random(), rng.choice("abc")
        if what < 0.4:
            program.events(rng.choice((f"pos({name})", f"dock({name})", f"undock({name})")))
        elif what < 0.6:
            program.query(rng.choice((f"assertz(lost({name}))", f"retractall(lost({name}))")))
        elif what < 0.65:
            program.query(f"delete_memory(pos), {POSITIONS}")
        else:
            asked = rng.choice(list(bodies))
            assert sorted(set(program.all(f"t_{asked}(X)"))) == sorted(set(program.all(f"{asked}(X)"))), asked


@pytest.mark.parametrize(
    "declaration",
    ["dynamic(between/3 as incremental)", "table(between/3 as incremental)", "dynamic([between/3], [])"],
)
def test_a_predicate_of_the_library_that_is_declared_with_options_may_have_facts(declaration):
    program = Program("true", f":- {declaration}.\nbetween(a, b, c).\nx <- y.\n")
    assert program.all("between(a, b, X)") == ["c"]


def test_a_rule_may_ask_for_facts_that_an_action_declares_with_options(caplog):
    Program("true", "begin <- go do dynamic(fact/1 as incremental).\nseen(X) <- ask where fact(X).\n")
    assert [record.message for record in caplog.records if "fact/1" in record.message] == []
