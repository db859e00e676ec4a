"""Libraries for measurement, random numbers and debug messages."""

import re
from typing import Any, List

from prolog.goal_answers import answers, first, prolog


def test_time_reports_and_keeps_solutions() -> None:
    logic = prolog()
    written: List[Any] = []
    logic.error_output = written.append
    assert answers(logic, "time(member(X, [1,2]))") == [{"X": "1"}, {"X": "2"}]
    line = r"% [\d,]+ inferences, \d+\.\d{3} CPU in \d+\.\d{3} seconds \(\d+% CPU, \d+ Lips\)\n"
    assert re.fullmatch(f"({line}){{2,3}}", "".join(written))


def test_time_reports_errors_and_failures() -> None:
    logic = prolog()
    written: List[Any] = []
    logic.error_output = written.append
    assert answers(logic, "time(throw(oops))") == ["oops"]
    assert answers(logic, "time(fail)") == []
    assert "".join(written).count(" inferences, ") == 2


def test_random_predicates_select_items() -> None:
    logic = prolog()
    assert first(logic, "set_random(seed(1)), randseq(3, 3, S), msort(S, M)")["M"] == "[1,2,3]"
    assert first(logic, "random_select(X, [a,b], [R]), X \\== R") is not None
    assert first(logic, "random_subseq([a,b,c], T, L), append(T, L, A), msort(A, M)")["M"] == "[a,b,c]"


def test_debug_prints_messages_of_topics() -> None:
    logic = prolog()
    written: List[Any] = []
    logic.error_output = written.append
    goal = "debug(plan), debug(plan, 'step ~w', [1]), debug(other, 'no', []), nodebug(plan), debug(plan, 'no', [])"
    assert answers(logic, goal) == [{}]
    assert "".join(written) == "% step 1\n"


def test_program_overrides_library_predicates() -> None:
    logic = prolog("union(G, mine(G)). option(a, b).")
    assert first(logic, "union(1, E)") == "mine(1)"
    assert first(logic, "option(a, X)") == "b"
    assert first(logic, "select_option(a(X), [a(1)], _)") == "1"


def test_environment_variables_require_permission() -> None:
    logic = prolog()
    assert answers(logic, "getenv('HOME', H)") == ["permission_error(access,environment_variable,'HOME')"]
    logic.environment = {"HOME": "/home/robot"}
    assert answers(logic, "getenv('HOME', H)") == [{"H": "'/home/robot'"}]
    assert answers(logic, 'getenv("OTHER", H)') == []
