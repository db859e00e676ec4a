"""Conditional compilation."""

from typing import Any

import pytest
from events.program_runner import ProgramRunner

CASES = [
    (":- if(true). a. :- else. b. :- endif.", "a"),
    (":- if(fail). a. :- else. b. :- endif.", "b"),
    (":- if(fail). a. :- elif(true). b. :- elif(true). c. :- else. d. :- endif.", "b"),
    (":- if(fail). a. :- elif(fail). b. :- else. c. :- endif.", "c"),
    (":- if(fail). :- if(true). a. :- else. b. :- endif. :- else. c. :- endif.", "c"),
    (":- if(true). :- if(fail). a. :- else. b. :- endif. :- else. c. :- endif.", "b"),
    (":- if(true). :- if(fail). a. :- endif. b. :- elif(no_such_goal). c. :- endif.", "b"),
    (":- if(\\+ catch(current_predicate(no_such/1), _, fail)). a. :- endif. b.", "ab"),
    (":- if(fail). a(. :- no_such_goal. :- endif. b.", "b"),
]


def defined_predicates(program: Any) -> str:
    return "".join(name for name in "abcd" if program.engine.call(f"current_predicate({name}/0)"))


@pytest.mark.parametrize("rule", ["", " out <- in."], ids=["prolog", "rules"])
@pytest.mark.parametrize(("text", "expected"), CASES)
def test_branch_of_true_condition_is_loaded(text: str, expected: str, rule: str) -> None:
    program = ProgramRunner(text + rule)
    assert defined_predicates(program) == expected
    assert program.warnings == []


def test_rules_in_skipped_branch_are_not_loaded() -> None:
    program = ProgramRunner(":- if(fail). c <- a. :- else. d <- a. :- endif.")
    assert program.feed("a@1") == "d@1-1"


@pytest.mark.parametrize(
    ("text", "line", "part"),
    [
        ("a.\n:- else.", 2, "no if before this else"),
        ("a.\n:- endif.", 2, "no if before this endif"),
        ("a.\n:- elif(true).", 2, "no if before this elif"),
        ("a.\n:- if(true).", 2, "this if has no endif"),
        ("a.\n:- if(true).\n:- else.\n:- else.\n:- endif.", 4, "an else before this else"),
        ("a.\n:- if(true).\n:- else.\n:- elif(true).\n:- endif.", 4, "an else before this elif"),
        ("a.\n:- if(no_such_goal).\nb.\n:- endif.", 2, "this condition raises an error"),
    ],
)
def test_unbalanced_directive_is_reported_at_position(text: str, line: int, part: str) -> None:
    program = ProgramRunner(text)
    (warning,) = program.warnings
    assert part in warning.message
    assert warning.place.line == line
    assert defined_predicates(program) == "a"
