"""Prolog files: loading clause by clause; an error affects its clause only."""

import pytest
from events.stream_programs import ProgramRunner

from retalis import Definitions, Engine, Limits, Omission, ProgramErrors, PrologError, Settings
from retalis.engine.program_check import check_program
from retalis.events.program.event_file_loader import _EVENT_PREDICATES


def answers(program, goal):
    return [
        {name: program.engine.show(value) for name, value in one.items()}
        for one in program.engine.query(goal)
    ]


def told(program):
    return [(one.place.line, one.place.column, one.message) for one in program.warnings]


def test_what_is_wrong_costs_itself(program):
    program.engine.load(
        rules="""p(1).
p(2.
:- no_such_goal.
p(3) :- true.
atom(x).
:- set_prolog_flag(no_flag_of_ours, on).
:- use_module(library(no_such_library)).
p(4).
"""
    )
    assert [one["X"] for one in answers(program, "p(X)")] == ["1", "3", "4"]
    assert [(line, column) for line, column, _ in told(program)] == [(2, 4), (3, 4), (5, 1), (7, 4)]
    assert all(isinstance(one, Omission) and "this is left out" in one.message for one in program.warnings)


@pytest.mark.parametrize(
    "rest", ["c <- a.", "l : c <- a.", "a do true.", ":- set_etalis_flag(out_of_order, on)."]
)
def test_a_file_of_event_rules_is_accepted_as_a_whole_or_not_at_all(program, rest):
    with pytest.raises(ProgramErrors):
        program.engine.load(rules=f"p(1).\np(2.\n{rest}\n")
    assert not program.engine.call("catch(p(_), _, fail)")
    assert program.engine.rules.rules == []


def test_goals_of_the_event_language_are_known(program):
    names = {key.name for key in program.engine.logic.names()}
    assert sorted(_EVENT_PREDICATES - names) == []


def test_words_of_rules_in_clauses_and_comments_make_no_event_file(program):
    program.engine.load(rules="% do <- iff\np('<-', do, \"a <- b\").\np(.\n")
    assert program.engine.call("p(_, do, _)")


def test_an_included_file_with_rules_makes_an_event_file(program, tmp_path):
    (tmp_path / "rules.pl").write_text("c <- a.")
    with pytest.raises(ProgramErrors):
        program.engine.load(rules=":- include(rules). p(1). p(2.")
    program.engine.load(rules=":- include(rules). p(1).")
    assert program.feed("a@1") == "c@1-1"


def test_a_prolog_file_that_rules_use_costs_them_nothing(program, tmp_path):
    (tmp_path / "kb.pl").write_text("p(1).\np(.\n:- op(700, xfx, ===>).\nq(a ===> b).\n")
    program.engine.load(rules=":- use_module(kb). c(X) <- a where p(X).")
    assert program.feed("a@1") == "c(1)@1-1"
    assert [one.place.source for one in program.warnings] == ["kb.pl"]
    assert program.engine.call("X = (a ===> b), q(X)")


def test_a_file_of_which_nothing_is_left_is_refused(program):
    with pytest.raises(ProgramErrors) as caught:
        program.engine.load(rules="p(.\n:- no_such_goal.\n")
    assert [error.place.line for error in caught.value.errors] == [1, 2]
    assert program.warnings == []


def test_of_many_things_left_out_the_first_are_told_and_the_others_counted(program):
    program.engine.load(rules="p(1).\n" + "q(.\n" * 150)
    assert len(program.warnings) == 101
    assert program.warnings[-1].message == "there are 50 more"


def test_a_limit_that_runs_out_ends_the_load_and_leaves_nothing():
    engine = Engine(settings=Settings(limits=Limits(inferences=100_000)))
    with pytest.raises(ProgramErrors) as caught:
        engine.load(rules="p(1). :- repeat, fail. p(2).")
    assert "inferences" in str(caught.value)
    with pytest.raises(PrologError):
        engine.call("p(_)")


def test_directives_run_before_the_next_term_is_read(program):
    program.engine.load(
        rules="""
declare :- op(700, xfx, ===>).
:- declare.
p(a ===> b).
:- p(A ===> B), assertz(seen(A, B)).
"""
    )
    assert program.warnings == []
    assert program.engine.call("seen(a, b), X = (c ===> d), X =.. [===>, c, d]")


def test_flags_of_quotes_hold_to_the_end_of_the_file(program):
    program.engine.load(rules=':- set_prolog_flag(double_quotes, codes). p("a").')
    program.engine.load(rules='q("a").')
    assert program.engine.call("p([97]), q(S), string(S), current_prolog_flag(double_quotes, string)")


def test_goals_of_initialization_are_called_when_the_file_is_loaded(program):
    program.engine.load(
        rules="""
:- initialization(note(end)).
:- initialization(note(now), now).
:- initialization(note(main), main).
:- initialization note(too).
:- note(between).
note(X) :- assertz(noted(X)).
""".replace(":- note(between).\n", "").replace(
            ":- initialization(note(now), now).", ":- initialization(assertz(noted(now)), now)."
        )
    )
    assert [one["X"] for one in answers(program, "noted(X)")] == ["now", "end", "too"]
    ((line, _, message),) = told(program)
    assert line == 4 and "is not called" in message


def test_initialization_in_a_file_of_rules_comes_after_the_rules(program):
    program.engine.load(rules=":- initialization(event(a)). c do assertz(done) <- a.")
    assert program.engine.call("done")


def test_pushback_heads_and_single_sided_rules_are_read(program):
    program.engine.load(rules="a, [b] --> [c]. p(a, X) => X = 1. p(_, X) => X = 2.")
    assert program.engine.call("a([c, d], [b, d]), p(a, 1), p(Z, 2), var(Z)")


def test_flags_that_nobody_knows_are_taken(program):
    program.engine.load(
        rules=":- set_prolog_flag(generate_debug_info, false). :- style_check(-singleton). :- mode(p). p."
    )
    assert program.warnings == [] and program.engine.call("p")


def test_reading_ends_at_end_of_file(program):
    program.engine.load(rules="p(1). end_of_file. p(2). p(")
    assert program.warnings == [] and [one["X"] for one in answers(program, "p(X)")] == ["1"]


def test_nested_files_are_found_beside_the_one_that_names_them(program, tmp_path):
    (tmp_path / "sub" / "deep").mkdir(parents=True)
    (tmp_path / "sub" / "one.pl").write_text(":- ensure_loaded('deep/two'). one.")
    (tmp_path / "sub" / "deep" / "two.pl").write_text(":- [three]. two. :- op(700, xfx, ===>).")
    (tmp_path / "sub" / "deep" / "three.pl").write_text("three(.\nthree.")
    program.engine.load(rules=":- [sub/one]. p(a ===> b).")
    assert program.engine.call("one, two, three, p(_)")
    assert [one.place.source for one in program.warnings] == ["sub/deep/three.pl"]


def test_a_clause_may_take_the_place_of_a_predicate_of_the_library(program):
    program.engine.load(rules="last([X], X). last([_|T], X) :- last(T, X). subtract(a, b, c).")
    assert program.warnings == []
    assert program.engine.call("subtract(a, b, c), last([1, 2], 2)")


def test_a_fact_for_a_predicate_of_the_event_language_is_left_out(program):
    program.engine.load(rules="p(1). memorize(a, [], a, m, 5).")
    (warning,) = program.warnings
    assert "would replace the built-in predicate" in warning.message


def test_check_reports_what_is_left_out_as_errors(tmp_path):
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('kb.pl')")
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "kb.pl").write_text("p(1).\np(.\n")
    found = check_program(tmp_path, Definitions())
    assert [(one.severity, one.problem.place.line) for one in found if one.check == "load"] == [("error", 2)]


def test_a_file_that_is_loaded_again_may_lack_what_it_lacked(tmp_path):
    path = tmp_path / "kb.pl"
    program = ProgramRunner(folder=tmp_path)
    path.write_text("p(1).\np(.\n")
    program.engine.load_program(path)
    path.write_text("p(2).\np(.\n")
    program.engine.reload(path)
    assert [one["X"] for one in answers(program, "p(X)")] == ["2"]
    path.write_text("p(3).\np(.\nq(.\n")
    with pytest.raises(ProgramErrors):
        program.engine.reload(path)
    assert [one["X"] for one in answers(program, "p(X)")] == ["2"]


def test_a_refused_file_leaves_no_operators(program):
    with pytest.raises(ProgramErrors):
        program.engine.load(rules=":- op(700, xfx, ===>). c <- a. :- throw(x).")
    assert "===>" not in program.engine.operators


def test_a_first_line_that_names_an_interpreter_is_none_of_the_program(program):
    program.engine.load(rules="#!/usr/bin/env swipl\np(1).\nq(.\n")
    assert [(line, column) for line, column, _ in told(program)] == [(3, 3)]
    assert program.engine.call("p(1)")


def test_quotes_may_go_on_in_the_next_line(program):
    program.engine.load(rules="p(\"a\nb.\nc\"). q('d\n''e').\n")
    assert program.warnings == []
    assert program.engine.call("p(\"a\\nb.\\nc\"), q('d\\n\\'e')")


def test_a_quote_that_is_not_closed_is_told_at_its_place_and_costs_its_clause(program):
    program.engine.load(rules="p(1).\np('2).\np(3).\nq('it''s', 'here').\np(4).\np(\"5).\nq(\"a\", b).\n")
    assert [(line, column) for line, column, _ in told(program)] == [(2, 3), (6, 3)]
    assert all("not closed on its line" in message for _, _, message in told(program))
    assert [one["X"] for one in answers(program, "p(X)")] == ["1", "3", "4"]
    assert program.engine.call("q(_, here), q(_, b)")


def test_a_library_that_is_not_there_is_one_warning_and_its_operators_hold(program):
    program.engine.load(rules=":- use_module(library(clpfd)).\np(X) :- X #> 3, X in 0..9.\nq(1).\n")
    assert [line for line, _, _ in told(program)] in ([1], [])
    assert program.engine.call("q(1), clause(p(_), _)")


def test_a_file_knows_where_it_is(program, tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "one.pl").write_text(":- prolog_load_context(directory, D), assertz(folder(D)). one.")
    assert program.engine.call(
        "load_files([sub/one], [if(not_loaded)]), load_files(sub/one, [if(not_loaded)])"
    )
    assert answers(program, "folder(D)") == [{"D": f"'{tmp_path}/sub'"}]
    assert program.engine.call("reconsult('sub/one'), \\+ prolog_load_context(directory, _)")


def test_a_name_with_a_point_may_lack_its_ending(program, tmp_path):
    (tmp_path / "kb-1.2.pl").write_text("p(1).")
    (tmp_path / "more.prolog").write_text("q(1).")
    program.engine.load(rules=":- ['kb-1.2', more]. r.")
    assert program.engine.call("p(1), q(1)")


def test_a_module_may_be_called_as_its_file(program, tmp_path):
    (tmp_path / "named.pl").write_text(":- module(_, [p/1]).\np(1).\nhidden(1).\n")
    program.engine.load(rules=":- autoload(named). :- reexport(named, [p/1]). q(X) :- p(X). hidden(2).")
    assert program.warnings == []
    assert program.engine.call("q(1), current_module(named), findall(X, hidden(X), [2])")
    (tmp_path / "other.pl").write_text(":- module(_, [r/1], [assertions]).\nr(1).\n")
    program.engine.load(rules=":- use_module(other). s(X) :- r(X).")
    assert program.engine.call("s(1), current_module(other)")


def test_libraries_whose_predicates_are_there_may_be_used(program):
    program.engine.load(
        rules=":- use_module(library(dcg/basics)). :- use_module(library(pairs)). :- autoload(library(apply)). p."
    )
    assert program.warnings == []


def test_predicates_that_are_used_may_get_names_of_their_own(program, tmp_path):
    (tmp_path / "kb.pl").write_text(":- module(kb, [p/1, q//1, go/0]).\np(1).\np(2).\nq(X) --> [X].\ngo.\n")
    (tmp_path / "user.pl").write_text(
        ":- module(user_of, [r/1]).\n:- use_module(kb, except([q//1, p/1 as small])).\nr(X) :- small(X).\n"
    )
    program.engine.load(
        rules=":- use_module(kb, [p/1 as counted, q//1 as item, go/0 as started, zzz, p/x as y, X as z]).\n"
        ":- use_module(library(lists), [append/3 as joined]).\n:- use_module(user)."
    )
    assert program.warnings == []
    assert program.engine.call(
        "findall(X, counted(X), [1, 2]), phrase(item(a), [a]), started, joined([1], [2], [1,2])"
    )
    assert program.engine.call(
        "findall(X, r(X), [1, 2]), \\+ catch(small(_), error(existence_error(_, _), _), fail)"
    )


@pytest.mark.parametrize(
    "directives",
    [
        ":- use_module(a). :- use_module(b).",
        ":- use_module(b). :- use_module(a).",
        ":- use_module(d). :- use_module(a). :- use_module(b). :- use_module(a).",
        ":- ensure_loaded(a). :- ensure_loaded(b).",
        ":- ensure_loaded(b). :- use_module(d, [other/1]).",
        ":- use_module(a, [have/1 as has]). :- use_module(b, except([item/1])).",
    ],
)
def test_a_module_that_another_one_uses_is_loaded_once(program, tmp_path, directives):
    (tmp_path / "b.pl").write_text(":- module(b, [item/1]).\nitem(cup).\nitem(pan).\n")
    (tmp_path / "a.pl").write_text(":- module(a, [have/1]).\n:- use_module(b).\nhave(X) :- item(X).\n")
    (tmp_path / "d.pl").write_text(":- module(d, [other/1]).\n:- use_module(a).\nother(X) :- have(X).\n")
    program.engine.load(rules=f"{directives} h(L) <- tick where findall(X, item(X), L).")
    assert program.engine.call("findall(X, item(X), [cup, pan])")
    program.engine.load(rules=f"{directives} g(L) <- tick where findall(X, item(X), L).")
    assert program.engine.call("findall(X, item(X), [cup, pan])")


@pytest.mark.parametrize("written", [":- {}.", "{}."])
def test_a_name_for_a_predicate_means_that_of_the_module(program, tmp_path, written):
    (tmp_path / "b.pl").write_text(":- module(b, [size/1]).\nsize(1).\n")
    (tmp_path / "c.pl").write_text(":- module(c, [size/1]).\nsize(7).\n")
    named = written.format("use_module('./c.pl', [size/1 as csize])")
    program.engine.load(rules=f":- use_module(b). {named} p(X) <- a where csize(X).")
    assert program.engine.call("findall(X, csize(X), [7]), findall(X, size(X), [1])")


def test_two_files_that_are_one_module_are_told(program, tmp_path):
    for name in ("x", "y"):
        (tmp_path / f"{name}.pl").write_text(f":- module(x, []).\np({name}).\n")
    said = []
    program.engine.load(rules=":- use_module(x). :- use_module(x).")
    program.engine.logic.files.on_same_module = said.append
    program.engine.load(rules=":- use_module(y). :- use_module(y).")
    assert said == [
        f"Warning: {tmp_path}/x.pl is module x as well; what {tmp_path}/y.pl has of it is added to that\n"
    ]
    assert program.engine.call("findall(X, x:p(X), [x, y])")


def test_what_is_called_by_a_module_s_name_is_looked_for_there(program, tmp_path):
    (tmp_path / "b.pl").write_text(":- module(b, [size/2]).\nsize(cup, 1).\nbig(X) :- size(X, _).\nzzyx.\n")
    program.engine.load(
        rules=":- use_module(b).\nk(L) <- tick where findall(X, b:big(X), L).\n"
        "j <- tick where (b:zzyx, b:size(_, 1)).\nn(X) <- tick where b:nope(X).\nm <- tick where zzyx."
    )
    assert [str(one).partition("\n")[0] for one in program.warnings] == [
        "text:4:22: there is no predicate nope/1 yet; define it in the module",
        "text:5:17: there is no predicate zzyx/0 yet; did you mean b:zzyx/0?",
    ]
