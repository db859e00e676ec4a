"""Event files: syntax, errors with positions, directives, and rejection as a whole."""

import linecache
from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import place_of
from events.load_problems import assert_refused, errors_of
from events.program_runner import ProgramRunner, outputs_of
from recorded_calls import recording

from retalis import Engine, ProgramErrors, atom, functor
from retalis.prolog.database.predicate import Predicate


@pytest.mark.parametrize(
    ("rule", "column", "part"),
    [
        ("c <- a not b.", 8, "no operator not"),
        ("c <- a ntimes 0.", 15, "positive integer"),
        ("c <- a ntimes X.", 15, "positive integer"),
        ("c <- a ntimes 10001.", 15, "at most 10000 repetitions"),
        ("c <- (a seq b) ntimes 1001.", 23, "at most 1000 repetitions of a pattern of several events"),
        ("c <- a star_times.", 8, "right side of a seq"),
        ("c <- a and aggregate(count,b,_).", 12, "right side of a seq"),
        ("c <- a seq aggregate(mean(X),b(X),_).", 22, "no such aggregate"),
        ("c <- a seq aggregate(median,b(X),_).", 22, "no such aggregate"),
        ("c <- a seq aggregate(quantile(2,X),b(X),_).", 22, "quantile needs a number from 0 to 1"),
        ("c <- a seq aggregate(fold(X,a,b,X),b(X),_).", 22, "needs the names of three predicates"),
        ("c <- a seq aggregate([count,sum(X)],b(X),_).", 22, "a list of kinds needs a window"),
        ("c <- a seq aggregate(of(low,count),b(X),_).", 22, "no such aggregate"),
        ("c <- a and prolog(true).", 12, "operand of seq"),
        ("c <- prolog(true) seq prolog(true).", 19, "does not wait for any event"),
        ("c <- 5 seq a.", 6, "not a number"),
        ('c <- a seq "b".', 12, "not a string"),
        ("c <- a or b or 7.", 16, "not a number"),
        ("c <- a within 0.", 15, "positive number"),
        ("c <- a where 5.", 14, "where needs a goal"),
        ("c <- a where (f, \\+ 5).", 21, "where needs a goal"),
        ("c <- a event_multiply (f ; 5).", 28, "event_multiply needs a goal"),
        ("c do 5 <- a.", 6, "do needs a goal"),
        ("c <- a seq prolog(5).", 19, "prolog needs a goal"),
        ("c <- a where X.", 14, "X never gets a goal"),
        ("c <- a(X) where (X, Y).", 21, "Y never gets a goal"),
        ("c do X <- a.", 6, "X never gets a goal"),
        ("5 <- a.", 1, "head of a rule"),
        ("X <- a.", 1, "head a value"),
        ("l : 5 <- a.", 5, "head of a rule"),
        ("exceptionAlarm(e,-1) <- a.", 18, "positive number"),
        ("c < - a.", 1, "without a space"),
        ("r([property(window,x)]) : c <- a.", 20, "number of seconds"),
        ("atom(x).", 1, "permission"),
        ("c -> a.", 1, "the arrow of an event rule is <-"),
        (":- set_etalis_flag(garbage_control, all).", 4, "garbage_control takes off, general, pattern"),
        (":- set_etalis_flag(garbage_contrl, general).", 4, "did you mean garbage_control?"),
    ],
)
def test_invalid_rule_is_refused_at_position(rule: str, column: int, part: str) -> None:
    assert_refused(rule, column, part)


@pytest.mark.parametrize("pattern", ["a seq (" * 1500 + "a" + ")" * 1500, " and ".join(["a"] * 3000)])
def test_too_deep_pattern_is_refused_at_position(pattern: str) -> None:
    program = ProgramRunner("d <- a.")
    with pytest.raises(ProgramErrors) as caught:
        program.engine.load(rules=f"b <- a.\nc <- {pattern}.")
    (error,) = caught.value.errors
    assert (place_of(error).line, "too deeply" in error.message) == (2, True)
    assert program.feed("a@1") == "d@1-1"


def test_all_errors_are_reported() -> None:
    errors = errors_of("ok <- a.\nx <- a not b.\ny <- (.\nz <- b ntimes 0.\n")
    assert [line for line, _, _ in sorted(errors)] == [2, 3, 4]


@pytest.mark.parametrize(
    ("rule", "part"),
    [
        ("c(X) <- a.", "bind X in the head"),
        ("c(X, Y, Z) <- a(Y).", "bind X and Z in the head"),
        ("aggregate(x) <- a seq aggregate(count, b).", "aggregate takes 3"),
        ("exceptionAlarm(x) <- a.", "exceptionAlarm takes 2"),
        ("syncronized(x, true) <- a.", "syncronized takes 3"),
        ("l : m : c <- a.", "one label"),
        ("c <- a where no_such(1).", "no predicate no_such/1"),
        ("c <- a where memberchck(1, [1]).", "no predicate memberchck/2 yet; did you mean memberchk/2?"),
        ("c <- a where (b(1) -> true ; findall(X, (d(X), \\+ e), _)).", "no predicate d/1"),
        ("c do no_such <- a.", "no predicate no_such/0"),
        ("c <- a seq (b check no_such(1)).", "no predicate no_such/1"),
        ("c <- (a, b).", "comma"),
        ("c <- a ; b.", "semicolon"),
        ("c <- (a -> b).", "arrow"),
        ("c <- a and not(b).", "cnot or fnot"),
        ("c <- \\+ b.", "cnot or fnot"),
        ("r([property(color,red)]) : c <- a.", "no property color"),
        ("r1 'rule:' r2 'rule:' c <- a.", "kept as a fact"),
        (":- fail.", "directive fails"),
    ],
)
def test_suspicious_rule_is_reported(rule: str, part: str) -> None:
    program = ProgramRunner(rule)
    assert any(part in str(warning) for warning in program.warnings)


@pytest.mark.parametrize(
    "rules",
    [
        "c <- a(X) where X. d <- E where E. e <- a(G) do (f(Y), Y). f(true).",
        "c <- a where (f(1), member(_, [1]), x is 1 ; \\+ t1(_)). f(1).",
        "c <- a where (member(X, [1, 2]), X > 1, ! ; lists:append(_, _, _), user:(true, fail)).",
        "c <- a where seen(1). null do assertz(seen(1)) <- b.",
        "c <- a where seen(1). d <- b where note(1). note(X) :- assertz((seen(X) :- true)).",
        "c <- a where seen(1). d <- b do note(seen(2)). note(X) :- assertz(X).",
        ":- dynamic(seen/1). c <- a where seen(1).",
        'c <- a where (sum_list([1], _), format("", []), prev(m, _, _, _, 1)).',
    ],
)
def test_available_predicates_are_not_reported(rules: str) -> None:
    assert ProgramRunner(rules).warnings == []


def test_long_list_of_dynamic_predicates_is_read() -> None:
    added = ",".join(f"seen{number}/1" for number in range(3000))
    assert ProgramRunner(f"c <- a where seen2999(1). null do dynamic([{added}]) <- b.").warnings == []


def test_missing_predicate_is_reported_once() -> None:
    program = ProgramRunner("c <- a.\nd <- a where\n   no_such(1) .\nd <- a where no_such(2).")
    ((warning),) = program.warnings
    assert (warning.place.line, warning.place.column) == (3, 4)


def test_all_forms_of_terms_are_loaded() -> None:
    rules = """
        c1 <- a. c2 iff a. c3 'IFF' a. c4 do true <- a. r1 : c5 <- a. r2 'rule:' c6 <- a.
        a do assertz(called). db(f(1)). prolog(f(2)). static(f(3)). g(X) :- f(X).
        event_rule_property(r1, window, 5).
        :- assertz(f(4)).
        ?- assertz(f(5)).
    """
    program = ProgramRunner(rules)
    assert program.feed("a@1") == "c1@1-1 c2@1-1 c3@1-1 c4@1-1 c5@1-1 c6@1-1"
    assert program.engine.call("called")
    assert [answer["X"] for answer in program.engine.query("g(X)")] == [1, 2, 3, 4, 5]
    assert program.engine.call("event_rule_property(r1, window, 5)")


def test_error_of_directive_rolls_back_file() -> None:
    program = ProgramRunner()
    with pytest.raises(ProgramErrors):
        program.engine.load(rules="f(1). :- assertz(g(2)). c <- a. :- no_such_goal.")
    assert program.feed("a@1") == ""
    assert not program.engine.query("catch(f(_),_,fail)")
    assert not program.engine.query("catch(g(_),_,fail)")


def test_refused_file_keeps_windows_of_other_rules() -> None:
    program = ProgramRunner("l : c <- a seq b. m([property(window,5)]) : d <- a seq b.")
    with pytest.raises(ProgramErrors):
        program.engine.load(
            rules="event_rule_property(l,window,1). event_rule_property(m,window,1). :- throw(x)."
        )
    assert program.feed("a@1 b@4 a@5 b@11") == "c@1-4 d@1-4 c@5-11"


def test_rules_are_inserted_and_deleted() -> None:
    program = ProgramRunner("c1(X) <- a(X). l : c2 <- a(_). c3 <- a(1) seq b.")
    call = program.engine.call
    assert call("ins_event_rule(c4 <- a(_))")
    assert not call("ins_event_rule(some_fact)")
    assert call("some_fact")
    assert program.feed("a(1)@1") == "c1(1)@1-1 c2@1-1 c4@1-1"
    assert call("del_event_rule(c1(Z) <- a(Z))")
    assert call("del_event_rule(l)")
    assert call("del_all_event_rules(c4)")
    assert program.feed("a(1)@2 b@3") == "c3@2-3"
    assert call("del_event_rule(unlabeled)")
    assert program.engine.rules.rules == []


def test_added_rule_matches_later_events_only() -> None:
    rules = "null do ins_event_rule(late(X) <- a(X)) <- a(1). c(X) <- a(X)."
    assert outputs_of(rules, "a(1)@1 a(2)@2") == "null@1-1 c(1)@1-1 c(2)@2-2 late(2)@2-2"


def test_terms_are_compiled_as_rules_and_clauses() -> None:
    program = ProgramRunner()
    assert program.engine.call("compile_event_rules([(c <- a), (f(X) :- X = 1), g(2)])")
    assert program.feed("a@1") == "c@1-1"
    assert program.engine.call("f(1), g(2)")


def test_reset_removes_matches_and_rules() -> None:
    program = ProgramRunner("c <- a seq b.", policy="chronological")
    program.feed("a@1")
    program.engine.call("reset_etalis_state")
    assert program.feed("b@2") == ""
    program.engine.call("reset_etalis")
    assert program.engine.rules.rules == []
    assert program.engine.call("get_etalis_flag(event_consumption_policy,recent)")


@pytest.mark.parametrize("goal", ["reset_db", "call_gc"])
@pytest.mark.parametrize(
    ("rule", "stream", "completing_event"),
    [
        ("c <- a seq b.", "a@1", "b@2"),
        ("l : c <- a and b.", "a@1", "b@2"),
        ("l([property(window, 9)]) : c <- a seq b.", "a@1", "b@2"),
        ("c(N) <- a seq aggregate(count, b, N) where N > 0.", "a@1", "b@2"),
        ("l : c <- (a seq (b star_times)) check (t1(S), t2(E), E > S).", "a@1", "b@2"),
        ("c <- (a and b) seq d.", "a@1 b@2", "d@3"),
        ("c <- a forall_seq b.", "a@1 a@2", "b@3"),
    ],
)
def test_reset_drops_all_partial_matches(goal: str, rule: str, stream: str, completing_event: str) -> None:
    program = ProgramRunner(rule)
    program.feed(stream)
    assert program.engine.rules.match_count > 0
    assert program.engine.call(goal)
    assert program.engine.rules.match_count == 0
    assert program.feed(completing_event) == ""
    assert program.feed(f"{stream} {completing_event}") != ""


def test_reset_drops_negated_events() -> None:
    program = ProgramRunner("c <- a fnot b.")
    assert program.feed("b@1 a@2") == ""
    assert program.engine.call("reset_db")
    assert program.feed("a@3") == "c@3-3"


def test_event_stream_file_is_executed(tmp_path: Path) -> None:
    program = ProgramRunner()
    program.engine.load(rules="c <- a.", folder=tmp_path)
    (tmp_path / "s.txt").write_text("event(a,[1,1]). fail. no_such_goal. event(a,[2,2]).")
    assert program.engine.call("execute_event_stream_file('s.txt')")
    assert len(program.errors) == 2
    assert len(program.events) == 4
    assert program.engine.call("fire_event_list([event(a,[3,3]), event(a)])")
    assert program.engine.call("fire_event_list(event(a,[3,3]))")
    assert len(program.events) == 10


def test_stored_events_are_queried() -> None:
    program = ProgramRunner("c <- a.", ["store_fired_events"])
    program.feed("a@1")
    assert len(program.engine.query("fired_event(E,I)")) == 2
    assert program.engine.call("stored_event(event(c,[1,1]))")


def test_rule_changes_do_not_scan_program(monkeypatch: pytest.MonkeyPatch) -> None:
    program = ProgramRunner("\n".join(f"f({number}). c <- a({number}) and b." for number in range(50)))
    engine = program.engine
    reads: List[Any] = []
    active_clauses = Predicate.active_clauses
    monkeypatch.setattr(Predicate, "active_clauses", recording(reads, active_clauses))
    monkeypatch.setattr(type(engine.rules), "rules", property(recording(reads, lambda rules: [])))
    assert engine.call("ins_event_rule(r([property(window,5)]) : (d(X) <- e(X) and f(X)))")
    assert program.feed("e(1)@1 f(1)@2") == "d(1)@1-2"
    assert engine.call("del_event_rule(r)")
    assert engine.call("ins_event_rule((d(X) <- e(X)))")
    assert engine.call("del_event_rule((d(Y) <- e(Y)))")
    assert program.feed("e(1)@3") == ""
    assert reads == []


@pytest.mark.slow
def test_code_of_deleted_rules_is_not_kept() -> None:
    program = ProgramRunner("k(_).")
    cache_sizes: List[Any] = []
    for second in range(1, 6):
        assert program.engine.call("ins_event_rule(b(X) do k(X) <- a(X))")
        assert program.feed(f"a(1)@{second}") == f"b(1)@{second}-{second}"
        assert program.engine.call("del_event_rule(b(X) do k(X) <- a(X))")
        cache_sizes.append(len(linecache.cache))
    assert cache_sizes[1:] == [cache_sizes[1]] * 4


def test_first_errors_are_kept_and_others_counted() -> None:
    engine = Engine()
    with pytest.raises(ProgramErrors) as caught:
        engine.load(rules="".join(f"out_{number} <- ).\n" for number in range(1000)))
    errors = caught.value.errors
    assert [place_of(error).line for error in errors[:-1]] == list(range(1, 101))
    assert errors[-1].message == "there are 900 more"
    with pytest.raises(ProgramErrors) as caught:
        engine.load(goals="fail\n" * 1000)
    assert [error.message for error in caught.value.errors[-2:]] == ["this goal fails", "there are 900 more"]


def test_error_shows_beginning_of_long_event(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine()
    engine.load(rules="null do X is foo+1 <- a(X).")
    engine.event((functor("a", 1), atom("x" * 100_000)), 1)
    (record,) = caplog.records
    assert len(record.getMessage()) < 1000
    assert "foo" in record.getMessage()
