"""Prolog files: loading clause by clause; an error affects its clause only."""

from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest
from asserting_accessors import place_of
from events.program_runner import ProgramRunner

from retalis import Definitions, Engine, Limits, Omission, ProgramErrors, PrologError, Settings
from retalis.engine.program_check import check_program
from retalis.events.program.event_file_loader import _EVENT_PREDICATES


def answers(program: Any, goal: str) -> List[Dict[Any, Any]]:
    return [
        {name: program.engine.show(value) for name, value in answer.items()}
        for answer in program.engine.query(goal)
    ]


def warnings_of(program: Any) -> List[Tuple[Any, ...]]:
    return [(warning.place.line, warning.place.column, warning.message) for warning in program.warnings]


def test_invalid_term_is_omitted(program: ProgramRunner) -> None:
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
    assert [answer["X"] for answer in answers(program, "p(X)")] == ["1", "3", "4"]
    assert [(line, column) for line, column, _ in warnings_of(program)] == [(2, 4), (3, 4), (5, 1), (7, 4)]
    assert all(
        isinstance(warning, Omission) and "this is left out" in warning.message
        for warning in program.warnings
    )


@pytest.mark.parametrize(
    "rest", ["c <- a.", "l : c <- a.", "a do true.", ":- set_etalis_flag(out_of_order, on)."]
)
def test_invalid_event_file_is_refused_as_a_whole(program: ProgramRunner, rest: str) -> None:
    with pytest.raises(ProgramErrors):
        program.engine.load(rules=f"p(1).\np(2.\n{rest}\n")
    assert not program.engine.call("catch(p(_), _, fail)")
    assert program.engine.rules.rules == []


def test_event_predicates_are_defined(program: ProgramRunner) -> None:
    names = {key.name for key in program.engine.logic.names()}
    assert sorted(_EVENT_PREDICATES - names) == []


def test_rule_words_in_clauses_make_no_event_file(program: ProgramRunner) -> None:
    program.engine.load(rules="% do <- iff\np('<-', do, \"a <- b\").\np(.\n")
    assert program.engine.call("p(_, do, _)")


def test_included_rules_make_an_event_file(program: ProgramRunner, tmp_path: Path) -> None:
    (tmp_path / "rules.pl").write_text("c <- a.")
    with pytest.raises(ProgramErrors):
        program.engine.load(rules=":- include(rules). p(1). p(2.")
    program.engine.load(rules=":- include(rules). p(1).")
    assert program.feed("a@1") == "c@1-1"


def test_errors_of_used_prolog_file_keep_rules(program: ProgramRunner, tmp_path: Path) -> None:
    (tmp_path / "kb.pl").write_text("p(1).\np(.\n:- op(700, xfx, ===>).\nq(a ===> b).\n")
    program.engine.load(rules=":- use_module(kb). c(X) <- a where p(X).")
    assert program.feed("a@1") == "c(1)@1-1"
    assert [warning.place.source for warning in program.warnings] == ["kb.pl"]
    assert program.engine.call("X = (a ===> b), q(X)")


def test_file_without_valid_terms_is_refused(program: ProgramRunner) -> None:
    with pytest.raises(ProgramErrors) as caught:
        program.engine.load(rules="p(.\n:- no_such_goal.\n")
    assert [place_of(error).line for error in caught.value.errors] == [1, 2]
    assert program.warnings == []


def test_first_omissions_are_shown_and_others_counted(program: ProgramRunner) -> None:
    program.engine.load(rules="p(1).\n" + "q(.\n" * 150)
    assert len(program.warnings) == 101
    assert program.warnings[-1].message == "there are 50 more"


def test_exceeded_limit_rolls_back_file() -> None:
    engine = Engine(settings=Settings(limits=Limits(inferences=100_000)))
    with pytest.raises(ProgramErrors) as caught:
        engine.load(rules="p(1). :- repeat, fail. p(2).")
    assert "inferences" in str(caught.value)
    with pytest.raises(PrologError):
        engine.call("p(_)")


def test_directive_runs_before_next_term(program: ProgramRunner) -> None:
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


def test_flag_of_quotes_is_local_to_file(program: ProgramRunner) -> None:
    program.engine.load(rules=':- set_prolog_flag(double_quotes, codes). p("a").')
    program.engine.load(rules='q("a").')
    assert program.engine.call("p([97]), q(S), string(S), current_prolog_flag(double_quotes, string)")


def test_initialization_goals_are_called_after_load(program: ProgramRunner) -> None:
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
    assert [answer["X"] for answer in answers(program, "noted(X)")] == ["now", "end", "too"]
    ((line, _, message),) = warnings_of(program)
    assert line == 4
    assert "is not called" in message


def test_initialization_follows_rules(program: ProgramRunner) -> None:
    program.engine.load(rules=":- initialization(event(a)). c do assertz(done) <- a.")
    assert program.engine.call("done")


def test_pushback_and_single_sided_rules_are_read(program: ProgramRunner) -> None:
    program.engine.load(rules="a, [b] --> [c]. p(a, X) => X = 1. p(_, X) => X = 2.")
    assert program.engine.call("a([c, d], [b, d]), p(a, 1), p(Z, 2), var(Z)")


def test_unknown_flags_are_ignored(program: ProgramRunner) -> None:
    program.engine.load(
        rules=":- set_prolog_flag(generate_debug_info, false). :- style_check(-singleton). :- mode(p). p."
    )
    assert program.warnings == []
    assert program.engine.call("p")


def test_reading_stops_at_end_of_file_term(program: ProgramRunner) -> None:
    program.engine.load(rules="p(1). end_of_file. p(2). p(")
    assert program.warnings == []
    assert [answer["X"] for answer in answers(program, "p(X)")] == ["1"]


def test_nested_files_are_relative_to_their_file(program: ProgramRunner, tmp_path: Path) -> None:
    (tmp_path / "sub" / "deep").mkdir(parents=True)
    (tmp_path / "sub" / "one.pl").write_text(":- ensure_loaded('deep/two'). one.")
    (tmp_path / "sub" / "deep" / "two.pl").write_text(":- [three]. two. :- op(700, xfx, ===>).")
    (tmp_path / "sub" / "deep" / "three.pl").write_text("three(.\nthree.")
    program.engine.load(rules=":- [sub/one]. p(a ===> b).")
    assert program.engine.call("one, two, three, p(_)")
    assert [warning.place.source for warning in program.warnings] == ["sub/deep/three.pl"]


def test_clause_may_replace_library_predicate(program: ProgramRunner) -> None:
    program.engine.load(rules="last([X], X). last([_|T], X) :- last(T, X). subtract(a, b, c).")
    assert program.warnings == []
    assert program.engine.call("subtract(a, b, c), last([1, 2], 2)")


def test_fact_of_event_predicate_is_omitted(program: ProgramRunner) -> None:
    program.engine.load(rules="p(1). memorize(a, [], a, m, 5).")
    (warning,) = program.warnings
    assert "would replace the built-in predicate" in warning.message


def test_check_reports_omissions_as_errors(tmp_path: Path) -> None:
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('kb.pl')")
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "kb.pl").write_text("p(1).\np(.\n")
    findings = check_program(tmp_path, Definitions())
    assert [
        (finding.severity, place_of(finding.problem).line) for finding in findings if finding.check == "load"
    ] == [("error", 2)]


def test_reload_keeps_known_omissions(tmp_path: Path) -> None:
    path = tmp_path / "kb.pl"
    program = ProgramRunner(folder=tmp_path)
    path.write_text("p(1).\np(.\n")
    program.engine.load_program(path)
    path.write_text("p(2).\np(.\n")
    program.engine.reload(path)
    assert [answer["X"] for answer in answers(program, "p(X)")] == ["2"]
    path.write_text("p(3).\np(.\nq(.\n")
    with pytest.raises(ProgramErrors):
        program.engine.reload(path)
    assert [answer["X"] for answer in answers(program, "p(X)")] == ["2"]


def test_refused_file_defines_no_operators(program: ProgramRunner) -> None:
    with pytest.raises(ProgramErrors):
        program.engine.load(rules=":- op(700, xfx, ===>). c <- a. :- throw(x).")
    assert "===>" not in program.engine.operators


def test_interpreter_line_is_ignored(program: ProgramRunner) -> None:
    program.engine.load(rules="#!/usr/bin/env swipl\np(1).\nq(.\n")
    assert [(line, column) for line, column, _ in warnings_of(program)] == [(3, 3)]
    assert program.engine.call("p(1)")


def test_quoted_text_may_span_lines(program: ProgramRunner) -> None:
    program.engine.load(rules="p(\"a\nb.\nc\"). q('d\n''e').\n")
    assert program.warnings == []
    assert program.engine.call("p(\"a\\nb.\\nc\"), q('d\\n\\'e')")


def test_unclosed_quote_omits_clause(program: ProgramRunner) -> None:
    program.engine.load(rules="p(1).\np('2).\np(3).\nq('it''s', 'here').\np(4).\np(\"5).\nq(\"a\", b).\n")
    assert [(line, column) for line, column, _ in warnings_of(program)] == [(2, 3), (6, 3)]
    assert all("not closed on its line" in message for _, _, message in warnings_of(program))
    assert [answer["X"] for answer in answers(program, "p(X)")] == ["1", "3", "4"]
    assert program.engine.call("q(_, here), q(_, b)")


def test_unknown_library_is_one_warning(program: ProgramRunner) -> None:
    program.engine.load(rules=":- use_module(library(clpfd)).\np(X) :- X #> 3, X in 0..9.\nq(1).\n")
    assert [line for line, _, _ in warnings_of(program)] == [1]
    assert program.engine.call("q(1), clause(p(_), _)")


def test_load_context_has_folder_of_file(program: ProgramRunner, tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "one.pl").write_text(":- prolog_load_context(directory, D), assertz(folder(D)). one.")
    assert program.engine.call(
        "load_files([sub/one], [if(not_loaded)]), load_files(sub/one, [if(not_loaded)])"
    )
    assert answers(program, "folder(D)") == [{"D": f"'{tmp_path}/sub'"}]
    assert program.engine.call("reconsult('sub/one'), \\+ prolog_load_context(directory, _)")


def test_file_extension_may_be_omitted(program: ProgramRunner, tmp_path: Path) -> None:
    (tmp_path / "kb-1.2.pl").write_text("p(1).")
    (tmp_path / "more.prolog").write_text("q(1).")
    program.engine.load(rules=":- ['kb-1.2', more]. r.")
    assert program.engine.call("p(1), q(1)")


def test_module_may_have_name_of_its_file(program: ProgramRunner, tmp_path: Path) -> None:
    (tmp_path / "named.pl").write_text(":- module(_, [p/1]).\np(1).\nhidden(1).\n")
    program.engine.load(rules=":- autoload(named). :- reexport(named, [p/1]). q(X) :- p(X). hidden(2).")
    assert program.warnings == []
    assert program.engine.call("q(1), current_module(named), findall(X, hidden(X), [2])")
    (tmp_path / "other.pl").write_text(":- module(_, [r/1], [assertions]).\nr(1).\n")
    program.engine.load(rules=":- use_module(other). s(X) :- r(X).")
    assert program.engine.call("s(1), current_module(other)")


def test_available_libraries_may_be_used(program: ProgramRunner) -> None:
    program.engine.load(
        rules=":- use_module(library(dcg/basics)). :- use_module(library(pairs)). :- autoload(library(apply)). p."
    )
    assert program.warnings == []


def test_imported_predicates_may_be_renamed(program: ProgramRunner, tmp_path: Path) -> None:
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
def test_shared_module_is_loaded_once(program: ProgramRunner, tmp_path: Path, directives: str) -> None:
    (tmp_path / "b.pl").write_text(":- module(b, [item/1]).\nitem(cup).\nitem(pan).\n")
    (tmp_path / "a.pl").write_text(":- module(a, [have/1]).\n:- use_module(b).\nhave(X) :- item(X).\n")
    (tmp_path / "d.pl").write_text(":- module(d, [other/1]).\n:- use_module(a).\nother(X) :- have(X).\n")
    program.engine.load(rules=f"{directives} h(L) <- tick where findall(X, item(X), L).")
    assert program.engine.call("findall(X, item(X), [cup, pan])")
    program.engine.load(rules=f"{directives} g(L) <- tick where findall(X, item(X), L).")
    assert program.engine.call("findall(X, item(X), [cup, pan])")


@pytest.mark.parametrize("directive_form", [":- {}.", "{}."])
def test_renamed_predicate_is_that_of_its_module(
    program: ProgramRunner, tmp_path: Path, directive_form: str
) -> None:
    (tmp_path / "b.pl").write_text(":- module(b, [size/1]).\nsize(1).\n")
    (tmp_path / "c.pl").write_text(":- module(c, [size/1]).\nsize(7).\n")
    named = directive_form.format("use_module('./c.pl', [size/1 as csize])")
    program.engine.load(rules=f":- use_module(b). {named} p(X) <- a where csize(X).")
    assert program.engine.call("findall(X, csize(X), [7]), findall(X, size(X), [1])")


def test_second_file_of_module_is_reported(program: ProgramRunner, tmp_path: Path) -> None:
    for name in ("x", "y"):
        (tmp_path / f"{name}.pl").write_text(f":- module(x, []).\np({name}).\n")
    warnings: List[Any] = []
    program.engine.load(rules=":- use_module(x). :- use_module(x).")
    program.engine.logic.print_to(print, warnings.append)
    program.engine.load(rules=":- use_module(y). :- use_module(y).")
    assert warnings == [
        f"Warning: {tmp_path}/x.pl is module x as well; what {tmp_path}/y.pl has of it is added to that\n"
    ]
    assert program.engine.call("findall(X, x:p(X), [x, y])")


def test_qualified_goal_is_checked_in_module(program: ProgramRunner, tmp_path: Path) -> None:
    (tmp_path / "b.pl").write_text(":- module(b, [size/2]).\nsize(cup, 1).\nbig(X) :- size(X, _).\nzzyx.\n")
    program.engine.load(
        rules=":- use_module(b).\nk(L) <- tick where findall(X, b:big(X), L).\n"
        "j <- tick where (b:zzyx, b:size(_, 1)).\nn(X) <- tick where b:nope(X).\nm <- tick where zzyx."
    )
    assert [str(warning).partition("\n")[0] for warning in program.warnings] == [
        "text:4:22: there is no predicate nope/1 yet; define it in the module",
        "text:5:17: there is no predicate zzyx/0 yet; did you mean b:zzyx/0?",
    ]
