"""A program's folder that is read again while the program runs."""

import threading

import pytest

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

    def __init__(self, folder, settings=None):
        self.folder = folder
        self.write(GOALS, RULES)
        self.engine = Engine(settings=settings)
        self.seen = []
        self.sent = []
        self.now = 0
        self.engine.on_event(lambda term, start, end: self.seen.append(self.engine.show(term)))
        self.engine.on_output(lambda term, topic, name: self.sent.append((topic, self.engine.show(term))))
        self.engine.load_program(folder)

    def write(self, goals=None, rules=None):
        for name, text in (("goalPredicates.txt", goals), ("rules.txt", rules)):
            if text is not None:
                (self.folder / name).write_text(text)

    def reload(self, goals=None, rules=None):
        self.write(goals, rules)
        return self.engine.reload(self.folder)

    def events(self, *texts):
        """Have events happen; return all that did."""
        self.seen.clear()
        for text in texts:
            self.now += 1
            self.engine.event(text, self.now)
        return [text for text in self.seen if not text.startswith("memory_updated")]

    def records(self, name="fires"):
        return [self.engine.show(found["R"]) for found in self.engine.query(f"access_mem({name}, R, _)")]

    def all(self, goal):
        return [self.engine.show(found["X"]) for found in self.engine.query(goal)]

    def state(self):
        """Return all that a refused reload has to leave as it is."""
        engine = self.engine
        predicates = [one for one in engine.logic.database.predicates.values() if one.kind == "user"]
        return (
            [(rule.name, rule.stored_match_count, rule.active) for rule in engine.rules.rules],
            {
                str(one): [engine.show(clause.head) for clause in one.active_clauses()]
                for one in predicates
                if not one.is_library_predicate
            },
            {key: list(one.memory.records) for key, one in engine.knowledge.memories.instances.items()},
            [(key, one.sent_counter.count) for key, one in engine.knowledge.subscriptions.items()],
            engine.rules.all_properties(),
        )


@pytest.fixture
def program(tmp_path):
    return Program(tmp_path)


def test_nothing_changed(program):
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
def test_again_and_again(program):
    program.events("smoke(0)")
    for number in range(1, 30):
        program.reload(rules=RULES + f"extra({number}) <- tick.\nnumbered({number}).\n")
        assert program.events("tick") == ["tick", f"extra({number})"]
        assert program.all("numbered(X)") == [str(number)]
    assert program.events("heat(9)") == ["heat(9)", "both(0,9)"]
    assert len(program.engine.rules.rules) == 3
    assert len(program.engine.deployments) == 1


def test_a_rule_changes_and_one_is_kept_with_what_waits_in_it(program):
    program.events("smoke(1)")
    told = program.reload(
        rules=RULES.replace("fire(X) where room(X)", "fire(X)")
        .replace("both(X,Y)", "both(A,B)")
        .replace("smoke(X) seq heat(Y)", "smoke(A)  seq\n heat(B)")
    )
    assert told[0] == "rules: 1 new, 1 gone, 1 kept, with 1 partial match"
    assert told[1].startswith("  new: rule alarm(X) (") and told[1].endswith("rules.txt:6)")
    assert told[2] == "  gone: rule alarm(X)"
    assert program.events("fire(cellar)", "heat(2)") == [
        "fire(cellar)",
        "alarm(cellar)",
        "heat(2)",
        "both(1,2)",
    ]


def test_what_waits_in_a_rule_that_goes_is_gone_and_said(program):
    program.events("smoke(1)", "smoke(2)")
    told = program.reload(rules=RULES.replace("both(X,Y)", "pair(X,Y)"))
    assert (
        "  gone: rule both(X,Y), with 1 partial match" in told
        or "  gone: rule both(X,Y), with 2 partial matches" in told
    )
    assert program.events("heat(2)") == ["heat(2)"]
    assert program.events("smoke(3)", "heat(4)") == ["smoke(3)", "heat(4)", "pair(3,4)"]


def test_kept_rules_take_the_order_of_the_file(program):
    rules = "one <- a.\ntwo <- a.\nthree <- a.\n"
    program.reload(rules=rules)
    assert program.events("a") == ["a", "one", "two", "three"]
    program.reload(rules="three <- a.\ntwo <- a.\none <- a.\n")
    assert program.events("a") == ["a", "three", "two", "one"]


def test_rules_that_are_the_same_are_paired_one_by_one(program):
    told = program.reload(rules="b <- a.\nb <- a.\n")
    assert program.events("a") == ["a", "b", "b"]
    told = program.reload(rules="b <- a.\n")
    assert told[:2] == ["rules: 0 new, 1 gone, 1 kept", "  gone: rule b"]
    assert program.events("a") == ["a", "b"]


def test_labels_tell_rules_apart_and_their_properties_change(program):
    program.reload(rules="w([property(window, 1)]) : c <- a seq b.\n")
    assert program.events("a", "x", "b") == ["a", "x", "b"]
    told = program.reload(rules="w([property(window, 5)]) : c <- a seq b.\n")
    assert told[0].startswith("rules: 0 new, 0 gone, 1 kept")
    assert program.events("a", "x", "b") == ["a", "x", "b", "c"]
    assert program.reload(rules="v : c <- a seq b.\n")[0] == "rules: 1 new, 1 gone, 0 kept"
    assert program.events("a", "x", "x", "x", "x", "x", "x", "b")[-1] == "c"


def test_kept_rules_see_clauses_that_changed(program):
    for _ in range(50):  # compiled by now
        program.events("fire(hall)")
    told = program.reload(rules=RULES.replace("room(attic)", "room(X) :- cellar(X)") + "cellar(cellar).\n")
    assert "  changed: predicate room/1" in told
    assert "  new: predicate cellar/1" in told
    assert program.events("fire(attic)", "fire(cellar)") == ["fire(attic)", "fire(cellar)", "alarm(cellar)"]
    program.reload(rules=RULES)
    assert program.events("fire(attic)", "fire(cellar)") == ["fire(attic)", "alarm(attic)", "fire(cellar)"]
    assert not program.engine.query("catch(cellar(_), error(existence_error(_, _), _), fail)")
    with pytest.raises(RetalisError, match="cellar/1"):
        program.engine.call("cellar(_)")


def test_a_predicate_of_the_library_is_replaced_and_given_back(program):
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


def test_tables_are_made_anew(program):
    rules = (
        ":- table path/2.\nedge(1, 2).\npath(X, Y) :- edge(X, Y).\npath(X, Z) :- path(X, Y), edge(Y, Z).\n"
    )
    program.reload(rules=rules)
    assert program.all("path(1, X)") == ["2"]
    told = program.reload(rules=rules + "edge(2, 3).\n")
    assert "predicates: 0 new, 1 changed, 0 gone, 1 kept" in told
    assert sorted(program.all("path(1, X)")) == ["2", "3"]
    program.engine.call("assertz(here)")
    with pytest.raises(ProgramErrors, match="this goal fails"):
        program.reload(goals=GOALS + "catch(here, _, fail) -> fail ; true\n", rules=rules)
    assert sorted(program.all("path(1, X)")) == ["2", "3"]


def test_a_memory_whose_definition_changes_begins_empty(program):
    program.events("fire(hall)")
    told = program.reload(goals=GOALS.replace("fires, 5", "fires, 6"))
    assert "  changed: memory fires: it is defined otherwise, and begins empty" in told
    assert program.records() == []
    program.events("fire(1)")
    assert program.records() == ["fire(1)"]


def test_a_memory_is_defined_in_other_words(program):
    program.events("fire(hall)")
    program.reload(goals=GOALS.replace("fire(_), [], _, fires", "fire(Where), [], _What, fires"))
    assert program.records() == ["fire(hall)"]


def test_memories_that_are_new_and_gone(program):
    told_of = []
    program.engine.on_event(lambda term, start, end: told_of.append(program.engine.show(term).split("(")[0]))
    told = program.reload(goals=GOALS.replace("fires, 5", "blazes, 5"))
    assert told[3:6] == [
        "memories: 1 new, 1 gone, 0 kept, with 0 records",
        "  new: memory blazes",
        "  gone: memory fires",
    ] or told[1:4] == [
        "memories: 1 new, 1 gone, 0 kept, with 0 records",
        "  new: memory blazes",
        "  gone: memory fires",
    ]
    assert told_of == ["memory_created", "memory_deleted"]
    assert not program.engine.has_memory(atom("fires"))
    program.events("fire(1)")
    assert program.records("blazes") == ["fire(1)"]


def test_queries_that_wait_for_a_kept_memory_go_on(program):
    program.reload(rules=RULES + "synchronized(done, true, [[fires, 50]]) <- go.\n")
    program.events("go")
    program.reload(rules=RULES)
    program.engine.event("fire(hall)", 49)
    assert "done" not in program.seen
    program.engine.event("fire(hall)", 51)
    assert program.seen.count("done") == 1


def test_queries_that_wait_for_a_memory_that_goes_are_given_up(program):
    program.reload(rules=RULES + "synchronized(done, true, [[fires, 50]]) <- go.\n")
    program.events("go")
    waiting = program.engine.knowledge.pending_queries
    assert len(waiting) == 1
    program.reload(goals=GOALS.replace("fires, 5", "fires, 6"))
    assert len(waiting) == 0


def test_subscriptions_change(program):
    told = program.reload(
        goals=GOALS.replace("alarm(_), [], _, alarms, a", "alarm(X), [], X, alarms, a")
        + "subscribe(both(_,_), [], _, pairs, b)\n"
    )
    assert "subscriptions: 1 new, 1 changed, 0 gone, 0 kept" in told
    program.events("fire(hall)")
    assert program.sent == [("alarms", "hall")]


def test_flags_that_the_program_no_longer_sets_are_what_they_were(program):
    flags = program.engine.rules.flags
    program.reload(goals=GOALS + "set_etalis_flag(event_consumption_policy, unrestricted)\n")
    assert flags.get("event_consumption_policy") is atom("unrestricted")
    program.reload(goals=GOALS)
    assert flags.get("event_consumption_policy") is atom("recent")


# ---- what others have added ----------------------------------------------------------------------------


def test_what_services_have_added_stays(program):
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


def test_what_services_have_deleted_comes_back_as_the_program_says(program):
    program.engine.delete_memory(atom("fires"))
    program.engine.delete_subscription(atom("alarms"), atom("a"))
    told = program.reload()
    assert "memories: 1 new, 0 gone, 0 kept, with 0 records" in told
    program.events("fire(hall)")
    assert program.records() == ["fire(hall)"]
    assert program.sent == [("alarms", "alarm(hall)")]


@pytest.mark.parametrize(
    "goal, part",
    [
        ("memorize(glow, [], _, glows, 3)", "memory glows of the program exists already"),
        ("subscribe(glow, [], _, lights, x)", "subscription x of topic lights of the program exists already"),
    ],
)
def test_a_name_that_services_have_taken_is_refused(program, goal, part):
    program.engine.call(goal)
    before = program.state()
    with pytest.raises(ProgramErrors, match=part):
        program.reload(goals=GOALS + goal + "\n")
    assert program.state() == before


def test_facts_asserted_at_run_time_stay(program):
    program.engine.call("assertz(seen(hall))")
    program.reload(rules=RULES + "note(1).\n")
    assert program.all("seen(X)") == ["hall"]


def test_what_the_run_has_retracted_stays_so(program):
    program.engine.call("retract(count(0)), assertz(count(7))")
    for _ in range(3):
        program.reload()
        assert program.all("count(X)") == ["7"]
    program.reload(rules=RULES.replace("count(0)", "count(1)"))
    assert program.all("count(X)") == ["7", "1"]


@pytest.mark.slow
def test_a_program_that_begins_anew_by_itself_does(program):
    goals = GOALS + "retractall(count(_)), assertz(count(0))\n"
    program.reload(goals=goals, rules=RULES.replace("count(0).\n", ""))
    program.engine.call("retract(count(0)), assertz(count(7))")
    program.reload()
    assert program.all("count(X)") == ["0"]


# ---- what is wrong -------------------------------------------------------------------------------------

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


@pytest.mark.parametrize("goals, rules, part", WRONG)
def test_a_wrong_program_leaves_the_old_one_at_work(tmp_path, goals, rules, part):
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


def test_errors_show_line_and_caret(program):
    with pytest.raises(ProgramErrors) as caught:
        program.reload(rules="a <- b.\nc <- d e.\n")
    text = str(caught.value)
    assert "rules.txt:2:" in text
    assert "c <- d e." in text
    assert "^" in text


def test_a_folder_that_is_gone_leaves_the_old_program_at_work(program):
    (program.folder / "goalPredicates.txt").unlink()
    with pytest.raises(UsageError, match="cannot read"):
        program.reload()
    assert program.events("fire(hall)") == ["fire(hall)", "alarm(hall)"]


HERE_ONLY = "\\+ here\n"
"""A goal that fails where `here` has been asserted at run time: the trial knows nothing of that."""


@pytest.mark.parametrize(
    "goals, rules",
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
def test_what_fails_only_in_the_running_engine_is_taken_back(program, goals, rules):
    engine = program.engine
    engine.call("dynamic(here/0)")
    goals = goals.replace(HERE_ONLY, "catch(here, _, fail) -> fail ; true\n")
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
    told = program.reload(GOALS, RULES)
    assert told[0] == "rules: 0 new, 0 gone, 2 kept, with 1 partial match"
    assert program.all("count(X)") == ["7"]
    assert program.events("fire(attic)", "heat(2)") == [
        "fire(attic)",
        "alarm(attic)",
        "mine",
        "heat(2)",
        "both(1,2)",
    ]
    assert program.records() == ["fire(attic)", "fire(hall)"]


# ---- around it -----------------------------------------------------------------------------------------


def test_a_program_that_was_not_loaded_is_new(tmp_path, program):
    other = tmp_path / "other"
    other.mkdir()
    (other / "goalPredicates.txt").write_text("memorize(a, [], _, as, 3)\n")
    assert "memories: 1 new, 0 gone, 0 kept, with 0 records" in program.engine.reload(other)
    assert program.events("fire(hall)") == ["fire(hall)", "alarm(hall)"]
    assert program.engine.has_memory(atom("fires"))


def test_a_program_that_was_wrong_at_first_is_mended(tmp_path):
    (tmp_path / "goalPredicates.txt").write_text("memorize(a, [], _, as, 3)\nfail\n")
    engine = Engine()
    with pytest.raises(ProgramErrors):
        engine.load_program(tmp_path)
    (tmp_path / "goalPredicates.txt").write_text("memorize(a, [], _, as, 3)\n")
    assert "memories: 0 new, 0 gone, 1 kept, with 0 records" in engine.reload(tmp_path)


def test_a_folder_by_another_name_is_the_same(tmp_path):
    (tmp_path / "real").mkdir()
    program = Program(tmp_path / "real")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert program.engine.reload(str(tmp_path / "link"))[0] == "rules: 0 new, 0 gone, 2 kept"


def test_goals_have_the_limits_of_a_request(tmp_path):
    program = Program(tmp_path, Settings(limits=Limits(inferences=10_000), limit_start=False))
    with pytest.raises(RetalisError, match="inferences"):
        program.reload(goals=GOALS + "numlist(1, 100000, L), member(X, L), X > 99999\n")
    assert program.events("fire(hall)") == ["fire(hall)", "alarm(hall)"]


def test_a_callback_cannot_reload(program):
    errors = []

    def callback(term, topic, name):
        try:
            program.engine.reload(program.folder)
        except UsageError as error:
            errors.append(error.message)

    program.engine.on_output(callback)
    program.events("fire(hall)")
    assert len(errors) == 1


def test_foreign_predicates_are_there_in_the_trial(program):
    @foreign
    def half(number: int) -> float:
        return number / 2

    program.engine.add_foreign(half)
    program.reload(goals=GOALS + "half(4, 2.0)\n")


def test_the_trial_says_nothing(program, capsys, caplog):
    program.reload(goals=GOALS + "write(hello)\n", rules=RULES + "x <- y where no_such.\n")
    assert capsys.readouterr().out == "hello"
    assert sum("no_such" in one.getMessage() for one in caplog.records) == 1


def test_events_come_in_meanwhile(program):
    numbers = range(300)
    sender = threading.Thread(target=lambda: [program.engine.post(FIRE(n), n * 10**9 + 1) for n in numbers])
    sender.start()
    for number in range(10):
        program.reload(rules=RULES + f"n({number}) <- never.\n")
    sender.join()
    program.engine.call("true")
    assert [text for text in program.seen if text.startswith("fire")] == [f"fire({n})" for n in numbers]
    assert program.records() == [f"fire({n})" for n in reversed(numbers)][:5]


class TestTimers:
    """What a program has timed, when it is read again."""

    @pytest.fixture
    def timed(self, tmp_path):
        program = Program(tmp_path)
        program.reload(goals=GOALS + "timer(a, every(4, from_now))\ntimer(b, after(100))\n")
        program.events("e")
        program.engine.call("timer(own, every(5))")
        return program

    def timers(self, program):
        return program.all("timers(L), member(timer(E, _, T), L), X = E-T")

    @pytest.mark.slow
    def test_those_that_are_the_same_go_on_and_others_come_and_go(self, timed):
        timed.events("e")
        told = timed.reload(goals=GOALS + "timer(a, every(4, from_now))\ntimer(c, at(0,0,9))\n")
        assert [line for line in told if "timer" in line] == [
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

    def test_a_program_with_an_error_leaves_them_as_they_were(self, timed):
        before = self.timers(timed)
        with pytest.raises(ProgramErrors):
            timed.reload(goals=GOALS + "timer(a, evry(4))\n")
        assert self.timers(timed) == before
        timed.engine.call("assertz(here)")
        with pytest.raises(RetalisError):  # in the engine that runs only
            timed.reload(goals=GOALS + "timer(d, every(1))\n(catch(here, _, fail) -> throw(bad) ; true)\n")
        assert self.timers(timed) == before
        timed.now = 11
        assert timed.events("e").count("a") == 2

    def test_what_was_made_by_a_state_is_known(self, timed):
        other = Engine.restore(timed.engine.snapshot())
        other.reload(timed.folder)
        (found,) = other.query("timers(L)")
        (before,) = timed.engine.query("timers(L)")
        assert other.show(found["L"]).count("timer(") == other.show(before["L"]).count("timer(") == 3
        timed.write(goals=GOALS)
        other.reload(timed.folder)
        (left,) = other.query("timers(L)")
        assert other.show(left["L"]).startswith("[timer(own,") and other.show(left["L"]).count("timer(") == 1


STATE = "state(docked(R), from(dock(R)), until(undock(R)))\n"


class TestStates:
    """What holds, when a program is read again."""

    @pytest.fixture
    def docked(self, tmp_path):
        program = Program(tmp_path)
        program.reload(goals=GOALS + STATE)
        program.events("dock(a)")
        return program

    def test_what_is_declared_as_before_goes_on(self, docked):
        told = docked.reload(goals=GOALS + STATE + "state(up, from(fly), until(land))\n")
        assert [line for line in told if "state" in line] == [
            "states: 1 new, 0 gone, 1 kept, 1 open",
            "  new: state up",
        ]
        assert docked.events("undock(a)") == ["undock(a)", "docked(a)"]

    def test_what_is_declared_otherwise_or_not_any_more_is_gone(self, docked):
        told = docked.reload(goals=GOALS + STATE.replace("undock", "out"))
        assert "  changed: state docked(_): it is declared otherwise, and nothing holds" in told
        assert docked.events("dock(b)", "undock(a)", "out(a)", "out(b)")[-1] == "docked(b)"
        assert "docked(a)" not in docked.seen
        assert "  gone: state docked(_)" in docked.reload(goals=GOALS)
        assert docked.events("dock(a)", "out(a)") == ["dock(a)", "out(a)"]

    def test_a_program_with_an_error_leaves_it_as_it_was(self, docked):
        docked.engine.call("assertz(here)")
        with pytest.raises(RetalisError):  # in the engine that runs only
            docked.reload(goals=GOALS + "(catch(here, _, fail) -> throw(bad) ; true)\n")
        assert docked.events("undock(a)") == ["undock(a)", "docked(a)"]

    def test_a_state_of_the_engine_knows_who_declared_it(self, docked):
        other = Engine.restore(docked.engine.snapshot())
        other.reload(docked.folder)
        assert other.call("holds(docked(a))")
        docked.write(goals=GOALS)
        other.reload(docked.folder)
        with pytest.raises(RetalisError):
            other.call("holds(docked(a))")
