"""Reload of a program in a running engine."""

import threading
from pathlib import Path
from typing import Any, List, Optional, Tuple

import pytest
from checked_threads import CheckedThread, wait_until

from retalis import (
    Engine,
    Limits,
    ProgramErrors,
    RetalisError,
    Settings,
    UsageError,
    Var,
    atom,
    foreign,
    functor,
)
from retalis.engine.client_requests import add_rule, delete_rule

FIRE = functor("fire", 1)

GOALS = """
compile_event_file('rules.txt')
memorize(fire(_), [], _, fires, 5)
subscribe(alarm(_), [], _, alarms, a)
"""
RULES = """
:- dynamic count/1.
count(0).
room(hall).
room(attic).
alarm(X) <- fire(X) where room(X).
both(X,Y) <- smoke(X) seq heat(Y).
"""


class Program:
    """A folder with a program, and an engine that has loaded it."""

    def __init__(self, folder: Any, settings: Any = None) -> None:
        self.folder = folder
        self.write(GOALS, RULES)
        self.engine = Engine(settings=settings)
        self.seen: List[Any] = []
        self.sent: List[Any] = []
        self.now = 0
        self.engine.on_event(lambda term, start, end: self.seen.append(self.engine.show(term)))
        self.engine.on_output(lambda term, topic, name: self.sent.append((topic, self.engine.show(term))))
        self.engine.load_program(folder)

    def write(self, goals: Any = None, rules: Any = None) -> None:
        for name, text in (("goalPredicates.txt", goals), ("rules.txt", rules)):
            if text is not None:
                (self.folder / name).write_text(text)

    def reload(self, goals: Any = None, rules: Any = None) -> List[str]:
        self.write(goals, rules)
        return self.engine.reload(self.folder)

    def events(self, *texts: Any) -> List[Any]:
        """Process events; return them and the events that they trigger."""
        self.seen.clear()
        for text in texts:
            self.now += 1
            self.engine.event(text, self.now)
        return [text for text in self.seen if not text.startswith("memory_updated")]

    def records(self, name: str = "fires") -> List[Any]:
        return [
            self.engine.show(solution["R"]) for solution in self.engine.query(f"access_mem({name}, R, _)")
        ]

    def all(self, goal: str) -> List[Any]:
        return [self.engine.show(solution["X"]) for solution in self.engine.query(goal)]

    def state(self) -> Tuple[Any, ...]:
        """Return the state that a refused reload must not change."""
        engine = self.engine
        predicates = [
            predicate for predicate in engine.logic.database.predicates.values() if predicate.kind == "user"
        ]
        return (
            [(rule.name, rule.stored_match_count, rule.active) for rule in engine.rules.rules],
            {
                str(predicate): [engine.show(clause.head) for clause in predicate.active_clauses()]
                for predicate in predicates
                if not predicate.is_library_predicate
            },
            {
                key: list(instance.memory.records)
                for key, instance in engine.knowledge.memories.instances.items()
            },
            [
                (key, subscription.sent_counter.count)
                for key, subscription in engine.knowledge.subscriptions.items()
            ],
            engine.rules.all_properties(),
        )


@pytest.fixture
def program(tmp_path: Path) -> Program:
    return Program(tmp_path)


def test_reload_of_unchanged_program_changes_nothing(program: Program) -> None:
    program.events("fire(hall)", "smoke(1)")
    before = program.state()
    assert program.reload() == [
        "rules: 0 new, 0 gone, 2 kept, with 1 partial match",
        "memories: 0 new, 0 gone, 1 kept, with 1 record",
        "subscriptions: 0 new, 0 gone, 1 kept",
        "predicates: 0 new, 0 gone, 2 kept",
    ]
    assert program.state() == before
    assert program.events("fire(attic)", "heat(2)") == ["fire(attic)", "alarm(attic)", "heat(2)", "both(1,2)"]
    assert program.sent == [("alarms", "alarm(hall)"), ("alarms", "alarm(attic)")]
    assert program.records() == ["fire(attic)", "fire(hall)"]


@pytest.mark.slow
def test_repeated_reloads_keep_partial_matches(program: Program) -> None:
    program.events("smoke(0)")
    for number in range(1, 30):
        program.reload(rules=RULES + f"extra({number}) <- tick.\nnumbered({number}).\n")
        assert program.events("tick") == ["tick", f"extra({number})"]
        assert program.all("numbered(X)") == [str(number)]
    assert program.events("heat(9)") == ["heat(9)", "both(0,9)"]
    assert len(program.engine.rules.rules) == 3
    assert len(program.engine.deployments) == 1


def test_unchanged_rule_keeps_partial_matches(program: Program) -> None:
    program.events("smoke(1)")
    changes = program.reload(
        rules=RULES.replace("fire(X) where room(X)", "fire(X)")
        .replace("both(X,Y)", "both(A,B)")
        .replace("smoke(X) seq heat(Y)", "smoke(A)  seq\n heat(B)")
    )
    assert changes[0] == "rules: 1 new, 1 gone, 1 kept, with 1 partial match"
    assert changes[1].startswith("  new: rule alarm(X) (")
    assert changes[1].endswith("rules.txt:6)")
    assert changes[2].startswith("  gone: rule alarm(X) (")
    assert changes[2].endswith("rules.txt:6)")
    assert program.events("fire(cellar)", "heat(2)") == [
        "fire(cellar)",
        "alarm(cellar)",
        "heat(2)",
        "both(1,2)",
    ]


def test_removed_rule_loses_partial_matches(program: Program) -> None:
    program.events("smoke(1)", "smoke(2)")
    changes = program.reload(rules=RULES.replace("both(X,Y)", "pair(X,Y)"))
    assert changes[2].startswith("  gone: rule both(X,Y) (")
    assert changes[2].endswith("rules.txt:7), with 2 partial matches")
    assert program.events("heat(2)") == ["heat(2)"]
    assert program.events("smoke(3)", "heat(4)") == ["smoke(3)", "heat(4)", "pair(3,4)"]


def test_kept_rules_have_order_of_file(program: Program) -> None:
    rules = "one <- a.\ntwo <- a.\nthree <- a.\n"
    program.reload(rules=rules)
    assert program.events("a") == ["a", "one", "two", "three"]
    program.reload(rules="three <- a.\ntwo <- a.\none <- a.\n")
    assert program.events("a") == ["a", "three", "two", "one"]


def test_equal_rules_are_paired_individually(program: Program) -> None:
    changes = program.reload(rules="b <- a.\nb <- a.\n")
    assert program.events("a") == ["a", "b", "b"]
    changes = program.reload(rules="b <- a.\n")
    assert changes[0] == "rules: 0 new, 1 gone, 1 kept"
    assert changes[1].endswith("rules.txt:2)")
    assert program.events("a") == ["a", "b"]


def test_rules_are_identified_by_label(program: Program) -> None:
    program.reload(rules="w([property(window, 1)]) : c <- a seq b.\n")
    assert program.events("a", "x", "b") == ["a", "x", "b"]
    changes = program.reload(rules="w([property(window, 5)]) : c <- a seq b.\n")
    assert changes[0].startswith("rules: 0 new, 0 gone, 1 kept")
    assert program.events("a", "x", "b") == ["a", "x", "b", "c"]
    assert program.reload(rules="v : c <- a seq b.\n")[0] == "rules: 1 new, 1 gone, 0 kept"
    assert program.events("a", "x", "x", "x", "x", "x", "x", "b")[-1] == "c"


def test_kept_rules_call_changed_clauses(program: Program) -> None:
    for _ in range(50):  # until the rules are compiled
        program.events("fire(hall)")
    changes = program.reload(rules=RULES.replace("room(attic)", "room(X) :- cellar(X)") + "cellar(cellar).\n")
    assert "  changed: predicate room/1" in changes
    assert "  new: predicate cellar/1" in changes
    assert program.events("fire(attic)", "fire(cellar)") == ["fire(attic)", "fire(cellar)", "alarm(cellar)"]
    program.reload(rules=RULES)
    assert program.events("fire(attic)", "fire(cellar)") == ["fire(attic)", "alarm(attic)", "fire(cellar)"]
    assert not program.engine.query("catch(cellar(_), error(existence_error(_, _), _), fail)")
    with pytest.raises(RetalisError, match="cellar/1"):
        program.engine.call("cellar(_)")


def test_library_predicate_is_replaced_and_restored(program: Program) -> None:
    rules = "c <- a where last([1, 2], 2).\n"
    program.reload(rules=rules)
    assert program.events("a") == ["a", "c"]
    assert program.reload(rules=rules + "last(_, 3) :- true.\n")[0] == "rules: 1 new, 1 gone, 0 kept"
    assert program.events("a") == ["a"]
    with pytest.raises(ProgramErrors):
        program.reload(goals=GOALS + "fail\n", rules=rules)
    assert program.events("a") == ["a"]
    program.reload(goals=GOALS)
    assert program.events("a") == ["a", "c"]


def test_tables_are_evaluated_again(program: Program) -> None:
    rules = (
        ":- table path/2.\nedge(1, 2).\npath(X, Y) :- edge(X, Y).\npath(X, Z) :- path(X, Y), edge(Y, Z).\n"
    )
    program.reload(rules=rules)
    assert program.all("path(1, X)") == ["2"]
    changes = program.reload(rules=rules + "edge(2, 3).\n")
    assert "predicates: 0 new, 1 changed, 0 gone, 1 kept" in changes
    assert sorted(program.all("path(1, X)")) == ["2", "3"]
    program.engine.call("assertz(here)")
    with pytest.raises(ProgramErrors, match="this goal fails"):
        program.reload(goals=GOALS + "catch(here, _, fail) -> fail ; true\n", rules=rules)
    assert sorted(program.all("path(1, X)")) == ["2", "3"]


def test_memory_with_changed_definition_starts_empty(program: Program) -> None:
    program.events("fire(hall)")
    changes = program.reload(goals=GOALS.replace("fires, 5", "fires, 6"))
    assert "  changed: memory fires: it is defined otherwise, and begins empty" in changes
    assert program.records() == []
    program.events("fire(1)")
    assert program.records() == ["fire(1)"]


def test_renamed_variables_keep_memory(program: Program) -> None:
    program.events("fire(hall)")
    program.reload(goals=GOALS.replace("fire(_), [], _, fires", "fire(Where), [], _What, fires"))
    assert program.records() == ["fire(hall)"]


def test_new_and_removed_memories_are_reported(program: Program) -> None:
    events: List[Any] = []
    program.engine.on_event(lambda term, start, end: events.append(program.engine.show(term).split("(")[0]))
    changes = program.reload(goals=GOALS.replace("fires, 5", "blazes, 5"))
    assert changes[1:4] == [
        "memories: 1 new, 1 gone, 0 kept, with 0 records",
        "  new: memory blazes",
        "  gone: memory fires",
    ]
    assert events == ["memory_created", "memory_deleted"]
    assert not program.engine.has_memory(atom("fires"))
    program.events("fire(1)")
    assert program.records("blazes") == ["fire(1)"]


def test_queries_of_kept_memory_stay_pending(program: Program) -> None:
    program.reload(rules=RULES + "synchronized(done, true, [[fires, 50]]) <- go.\n")
    program.events("go")
    program.reload(rules=RULES)
    program.engine.event("fire(hall)", 49)
    assert "done" not in program.seen
    program.engine.event("fire(hall)", 51)
    assert program.seen.count("done") == 1


def test_queries_of_changed_memory_are_cancelled(program: Program) -> None:
    program.reload(rules=RULES + "synchronized(done, true, [[fires, 50]]) <- go.\n")
    program.events("go")
    waiting = program.engine.knowledge.pending_queries
    assert len(waiting) == 1
    program.reload(goals=GOALS.replace("fires, 5", "fires, 6"))
    assert len(waiting) == 0


def test_changed_subscription_uses_new_format(program: Program) -> None:
    changes = program.reload(
        goals=GOALS.replace("alarm(_), [], _, alarms, a", "alarm(X), [], X, alarms, a")
        + "subscribe(both(_,_), [], _, pairs, b)\n"
    )
    assert "subscriptions: 1 new, 1 changed, 0 gone, 0 kept" in changes
    program.events("fire(hall)")
    assert program.sent == [("alarms", "hall")]


def test_flags_without_goal_get_default(program: Program) -> None:
    flags = program.engine.rules.flags
    program.reload(goals=GOALS + "set_etalis_flag(event_consumption_policy, unrestricted)\n")
    assert flags.get("event_consumption_policy") is atom("unrestricted")
    program.reload(goals=GOALS)
    assert flags.get("event_consumption_policy") is atom("recent")


# ---- additions by others -------------------------------------------------------------------------------


def test_additions_of_services_stay(program: Program) -> None:
    engine = program.engine
    engine.add_memory(atom("glow"), [], Var(), atom("glows"), 3)
    engine.add_subscription(atom("glow"), [], Var(), atom("lights"), atom("x"))
    add_rule(engine, "bright <- glow seq shine", "mine")
    program.events("glow")
    for rules in (RULES, RULES + "new <- glow.\n"):
        program.reload(rules=rules)
    assert program.records("glows") == ["glow"]
    assert program.events("shine", "glow") == ["shine", "bright", "glow", "new"]
    assert program.sent == [("lights", "glow")] * 2
    delete_rule(engine, "mine")
    assert program.events("glow", "shine") == ["glow", "new", "shine"]


def test_deletions_of_services_are_reverted(program: Program) -> None:
    program.engine.delete_memory(atom("fires"))
    program.engine.delete_subscription(atom("alarms"), atom("a"))
    changes = program.reload()
    assert "memories: 1 new, 0 gone, 0 kept, with 0 records" in changes
    program.events("fire(hall)")
    assert program.records() == ["fire(hall)"]
    assert program.sent == [("alarms", "alarm(hall)")]


@pytest.mark.parametrize(
    ("goal", "part"),
    [
        ("memorize(glow, [], _, glows, 3)", "memory glows of the program exists already"),
        ("subscribe(glow, [], _, lights, x)", "subscription x of topic lights of the program exists already"),
    ],
)
def test_id_used_by_service_is_refused(program: Program, goal: str, part: str) -> None:
    program.engine.call(goal)
    before = program.state()
    with pytest.raises(ProgramErrors, match=part):
        program.reload(goals=GOALS + goal + "\n")
    assert program.state() == before


def test_facts_asserted_at_run_time_are_kept(program: Program) -> None:
    program.engine.call("assertz(seen(hall))")
    program.reload(rules=RULES + "note(1).\n")
    assert program.all("seen(X)") == ["hall"]


def test_facts_retracted_at_run_time_stay_retracted(program: Program) -> None:
    program.engine.call("retract(count(0)), assertz(count(7))")
    for _ in range(3):
        program.reload()
        assert program.all("count(X)") == ["7"]
    program.reload(rules=RULES.replace("count(0)", "count(1)"))
    assert program.all("count(X)") == ["7", "1"]


@pytest.mark.slow
def test_loading_goals_reset_dynamic_facts(program: Program) -> None:
    goals = GOALS + "retractall(count(_)), assertz(count(0))\n"
    program.reload(goals=goals, rules=RULES.replace("count(0).\n", ""))
    program.engine.call("retract(count(0)), assertz(count(7))")
    program.reload()
    assert program.all("count(X)") == ["0"]


# ---- wrong programs ------------------------------------------------------------------------------------

WRONG = [
    (None, RULES + "b <- a seq.\n", "rules.txt:8:"),
    (None, RULES + "f(X :- g.\n", "rules.txt:8:"),
    (None, RULES + ":- no_such_goal.\n", "no_such_goal/0"),
    (GOALS + "fail\n", None, "this goal fails"),
    (GOALS + "memorize(fire, [], _, fires, 5)\n", None, "one already exists"),
    (GOALS + "memorize(fire\n", None, "goalPredicates.txt:5"),
    (GOALS.replace("rules.txt", "others.txt"), None, "others.txt"),
    (GOALS + "repeat, fail\n", None, "inferences"),
    (GOALS.replace("memorize", "compile_event_file('more.txt')\nmemorize"), None, "more.txt"),
]


@pytest.mark.parametrize(("goals", "rules", "part"), WRONG)
def test_wrong_program_leaves_previous_one_running(
    tmp_path: Path, goals: Optional[str], rules: Optional[str], part: str
) -> None:
    program = Program(tmp_path, Settings(limits=Limits(inferences=100_000)))
    program.events("fire(hall)", "smoke(1)")
    before = program.state()
    with pytest.raises(RetalisError) as caught:
        program.reload(goals, rules)
    assert part in str(caught.value)
    assert program.state() == before
    assert program.events("fire(attic)", "heat(2)") == ["fire(attic)", "alarm(attic)", "heat(2)", "both(1,2)"]
    assert program.sent == [("alarms", "alarm(hall)"), ("alarms", "alarm(attic)")]
    assert program.reload(GOALS, RULES)[0] == "rules: 0 new, 0 gone, 2 kept"


def test_errors_have_line_and_caret(program: Program) -> None:
    with pytest.raises(ProgramErrors) as caught:
        program.reload(rules="a <- b.\nc <- d e.\n")
    text = str(caught.value)
    assert "rules.txt:2:" in text
    assert "c <- d e." in text
    assert "^" in text


def test_missing_file_leaves_previous_program_running(program: Program) -> None:
    (program.folder / "goalPredicates.txt").unlink()
    with pytest.raises(UsageError, match="cannot read"):
        program.reload()
    assert program.events("fire(hall)") == ["fire(hall)", "alarm(hall)"]


HERE_ONLY = "catch(here, _, fail) -> fail ; true\n"
"""A goal that fails if `here` has been asserted at run time, which the trial does not know."""


@pytest.mark.parametrize(
    ("goals", "rules"),
    [
        (HERE_ONLY, "z <- fire(X).\n"),
        (GOALS + HERE_ONLY, RULES),
        (GOALS.replace("fires, 5", "fires, 9") + "memorize(a, [], _, more, 1)\n" + HERE_ONLY, None),
        (
            GOALS.replace("[], _, alarms", "[], x, alarms") + "subscribe(a, [], _, more, 1)\n" + HERE_ONLY,
            None,
        ),
        (
            GOALS + HERE_ONLY,
            "room(none).\nnews(1).\nlast(1, 2) :- true.\nl([property(window, 3)]) : b <- a seq c.\n",
        ),
        ("set_etalis_flag(event_consumption_policy, unrestricted)\n" + GOALS + HERE_ONLY, None),
        (GOALS + "catch(nothing, _, true)\nretractall(count(_))\nassertz(count(3))\n" + HERE_ONLY, None),
        (GOALS + HERE_ONLY, ""),
    ],
)
def test_failure_in_running_engine_is_rolled_back(program: Program, goals: str, rules: Optional[str]) -> None:
    engine = program.engine
    engine.call("dynamic(here/0)")
    add_rule(engine, "mine <- fire(_)", "mine")
    engine.call("assertz(here), retract(count(0)), assertz(count(7))")
    program.events("fire(hall)", "smoke(1)")
    before = program.state()
    flags = {name: engine.rules.flags.get(name) for name in engine.rules.flags.names()}
    for _ in range(2):
        with pytest.raises(ProgramErrors, match="this goal fails"):
            program.reload(goals, rules)
        assert program.state() == before
        assert {name: engine.rules.flags.get(name) for name in flags} == flags
    engine.call("retract(here)")
    changes = program.reload(GOALS, RULES)
    assert changes[0] == "rules: 0 new, 0 gone, 2 kept, with 1 partial match"
    assert program.all("count(X)") == ["7"]
    assert program.events("fire(attic)", "heat(2)") == [
        "fire(attic)",
        "alarm(attic)",
        "mine",
        "heat(2)",
        "both(1,2)",
    ]
    assert program.records() == ["fire(attic)", "fire(hall)"]


# ---- other --------------------------------------------------------------------------------------------


def test_reload_of_other_folder_adds_program(tmp_path: Path, program: Program) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "goalPredicates.txt").write_text("memorize(a, [], _, as, 3)\n")
    assert "memories: 1 new, 0 gone, 0 kept, with 0 records" in program.engine.reload(other)
    assert program.events("fire(hall)") == ["fire(hall)", "alarm(hall)"]
    assert program.engine.has_memory(atom("fires"))


def test_reload_repairs_program_that_failed_to_load(tmp_path: Path) -> None:
    (tmp_path / "goalPredicates.txt").write_text("memorize(a, [], _, as, 3)\nfail\n")
    engine = Engine()
    with pytest.raises(ProgramErrors):
        engine.load_program(tmp_path)
    (tmp_path / "goalPredicates.txt").write_text("memorize(a, [], _, as, 3)\n")
    assert "memories: 0 new, 0 gone, 1 kept, with 0 records" in engine.reload(tmp_path)


def test_symbolic_link_is_same_folder(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    program = Program(tmp_path / "real")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert program.engine.reload(str(tmp_path / "link"))[0] == "rules: 0 new, 0 gone, 2 kept"


def test_loading_goals_have_limits_of_request(tmp_path: Path) -> None:
    program = Program(tmp_path, Settings(limits=Limits(inferences=10_000), limit_start=False))
    with pytest.raises(RetalisError, match="inferences"):
        program.reload(goals=GOALS + "numlist(1, 100000, L), member(X, L), X > 99999\n")
    assert program.events("fire(hall)") == ["fire(hall)", "alarm(hall)"]


def test_reload_in_callback_is_refused(program: Program) -> None:
    errors: List[Any] = []

    def callback(term: Any, topic: Any, name: Any) -> None:
        try:
            program.engine.reload(program.folder)
        except UsageError as error:
            errors.append(error.message)

    program.engine.on_output(callback)
    program.events("fire(hall)")
    assert len(errors) == 1


def test_trial_has_foreign_predicates(program: Program) -> None:
    @foreign
    def half(number: int) -> float:
        return number / 2

    program.engine.add_foreign(half)
    program.reload(goals=GOALS + "half(4, 2.0)\n")


def test_trial_writes_no_output_and_no_log(
    program: Program, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    program.reload(goals=GOALS + "write(hello)\n", rules=RULES + "x <- y where no_such.\n")
    assert capsys.readouterr().out == "hello"
    assert sum("no_such" in record.getMessage() for record in caplog.records) == 1


def test_events_during_reload_are_processed(program: Program) -> None:
    reloads_ended = threading.Event()
    numbers: List[int] = []

    def post_until_end() -> None:
        while not reloads_ended.is_set() or len(numbers) < 10:
            numbers.append(len(numbers))
            program.engine.post(FIRE(numbers[-1]), numbers[-1] * 10**9 + 1)

    sender = CheckedThread(post_until_end)
    sender.start()
    try:
        for number in range(5):
            count_before = len(numbers)
            program.reload(rules=RULES + f"n({number}) <- never.\n")
            wait_until(lambda: len(numbers) > count_before, "an event is posted")  # noqa: B023
    finally:
        reloads_ended.set()
        sender.end()
    program.engine.call("true")
    assert [text for text in program.seen if text.startswith("fire")] == [f"fire({n})" for n in numbers]
    assert program.records() == [f"fire({n})" for n in reversed(numbers)][:5]


class TestTimers:
    """Timers of a reloaded program."""

    @pytest.fixture
    def timed(self, tmp_path: Path) -> Program:
        program = Program(tmp_path)
        program.reload(goals=GOALS + "timer(a, every(4, from_now))\ntimer(b, after(100))\n")
        program.events("e")
        program.engine.call("timer(own, every(5))")
        return program

    def timers(self, program: Any) -> Any:
        return program.all("timers(L), member(timer(E, _, T), L), X = E-T")

    @pytest.mark.slow
    def test_equal_timers_continue(self, timed: Any) -> None:
        timed.events("e")
        changes = timed.reload(goals=GOALS + "timer(a, every(4, from_now))\ntimer(c, at(0,0,9))\n")
        assert [line for line in changes if "timer" in line] == [
            "timers: 1 new, 1 gone, 1 kept",
            "  new: timer c, at(0,0,9)",
            "  gone: timer b, after(100)",
        ]
        assert sorted(self.timers(timed)) == [
            "a-datime(1970,1,1,0,0,5,0)",
            "c-datime(1970,1,1,0,0,9,0)",
            "own-datime(1970,1,1,0,0,5,0)",
        ]
        timed.now = 11
        assert timed.events("e") == ["a", "own", "c", "a", "own", "e"]

    def test_failed_reload_keeps_timers(self, timed: Any) -> None:
        before = self.timers(timed)
        with pytest.raises(ProgramErrors):
            timed.reload(goals=GOALS + "timer(a, evry(4))\n")
        assert self.timers(timed) == before
        timed.engine.call("assertz(here)")
        with pytest.raises(RetalisError, match="bad"):  # in the running engine only
            timed.reload(goals=GOALS + "timer(d, every(1))\n(catch(here, _, fail) -> throw(bad) ; true)\n")
        assert self.timers(timed) == before
        timed.now = 11
        assert timed.events("e").count("a") == 2

    def test_restored_timers_belong_to_program(self, timed: Any) -> None:
        other = Engine.restore(timed.engine.snapshot())
        other.reload(timed.folder)
        (restored_timers,) = other.query("timers(L)")
        (before,) = timed.engine.query("timers(L)")
        assert (
            other.show(restored_timers["L"]).count("timer(") == other.show(before["L"]).count("timer(") == 3
        )
        timed.write(goals=GOALS)
        other.reload(timed.folder)
        (remaining_timers,) = other.query("timers(L)")
        assert other.show(remaining_timers["L"]).startswith("[timer(own,")
        assert other.show(remaining_timers["L"]).count("timer(") == 1


STATE = "state(docked(R), from(dock(R)), until(undock(R)))\n"


class TestStates:
    """Declared states of a reloaded program."""

    @pytest.fixture
    def docked(self, tmp_path: Path) -> Program:
        program = Program(tmp_path)
        program.reload(goals=GOALS + STATE)
        program.events("dock(a)")
        return program

    def test_equal_state_continues(self, docked: Any) -> None:
        changes = docked.reload(goals=GOALS + STATE + "state(up, from(fly), until(land))\n")
        assert [line for line in changes if "state" in line] == [
            "states: 1 new, 0 gone, 1 kept, 1 open",
            "  new: state up",
        ]
        assert docked.events("undock(a)") == ["undock(a)", "docked(a)"]

    def test_changed_and_removed_states_end(self, docked: Any) -> None:
        changes = docked.reload(goals=GOALS + STATE.replace("undock", "out"))
        assert "  changed: state docked(_): it is declared otherwise, and nothing holds" in changes
        assert docked.events("dock(b)", "undock(a)", "out(a)", "out(b)")[-1] == "docked(b)"
        assert "docked(a)" not in docked.seen
        assert "  gone: state docked(_)" in docked.reload(goals=GOALS)
        assert docked.events("dock(a)", "out(a)") == ["dock(a)", "out(a)"]

    def test_failed_reload_keeps_states(self, docked: Any) -> None:
        docked.engine.call("assertz(here)")
        with pytest.raises(RetalisError, match="bad"):  # in the running engine only
            docked.reload(goals=GOALS + "(catch(here, _, fail) -> throw(bad) ; true)\n")
        assert docked.events("undock(a)") == ["undock(a)", "docked(a)"]

    def test_restored_states_belong_to_program(self, docked: Any) -> None:
        other = Engine.restore(docked.engine.snapshot())
        other.reload(docked.folder)
        assert other.call("holds(docked(a))")
        docked.write(goals=GOALS)
        other.reload(docked.folder)
        with pytest.raises(RetalisError):
            other.call("holds(docked(a))")
