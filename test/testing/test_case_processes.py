"""Execution of cases in processes."""

import os
import signal
from multiprocessing import active_children
from pathlib import Path
from typing import List

import pytest
from testing.case_texts import parse_case

from retalis import Definitions
from retalis.testing import case_processes
from retalis.testing.case_definition import Case
from retalis.testing.case_file import parse_case_file
from retalis.testing.case_processes import run_cases
from retalis.testing.case_run import CaseResult

FILE = """\
rules: double(Y) <- number(X) where Y is 2 * X.
cases:
  - {name: right, input: [{at: 1, event: number(1)}], expect: {events: [double(2)]}}
  - {name: wrong, input: [{at: 1, event: number(2)}], expect: {events: [double(3)]}}
  - {name: other rules, rules: a <- b., input: [{at: 1, event: b}], expect: {events: [a]}}
"""


def parse(text: str) -> List[Case]:
    return parse_case_file(text, Path("mine_test.yaml"))


@pytest.mark.parametrize("jobs", [1, 2, 8])
def test_results_belong_to_their_cases(jobs: int, definitions: Definitions) -> None:
    results = dict(run_cases(parse(FILE), definitions, jobs))
    assert [bool(results[number].failures) for number in range(3)] == [False, True, False]


def test_cases_do_not_share_state(definitions: Definitions) -> None:
    cases = "".join(
        f"  - {{name: '{number}', input: [{{at: 1, event: e}}], "
        'expect: {state: [{query: "memory_counter(m, N)", expect: {N: 1}}]}}\n'
        for number in range(4)
    )
    text = f"rules: a <- b.\ngoals: memorize(e, [], _, m, 9)\ncases:\n{cases}"
    results = dict(run_cases(parse(text), definitions, 1))
    assert [result.failures for _, result in sorted(results.items())] == [()] * 4


def test_endless_case_is_ended(definitions: Definitions) -> None:
    text = (
        "rules: |\n  loop :- repeat, fail.\n  a <- b where loop.\n"
        "cases:\n  - {name: endless, timeout: 0.5, input: [{at: 1, event: b}], expect: {}}\n"
        "  - {name: short, expect: {}}"
    )
    results = dict(run_cases(parse(text), definitions, 1))
    assert results[0].failures == ("not finished after 0.5 s (key 'timeout')",)
    assert results[1].failures == ()


def test_death_of_a_process_is_the_result_of_its_case(
    definitions: Definitions, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(case: Case, *arguments: object) -> CaseResult:
        if case.name == "right":
            os.kill(os.getpid(), signal.SIGKILL)
        return CaseResult((), (), 0.0)

    monkeypatch.setattr(case_processes, "run_case", die)
    results = dict(run_cases(parse(FILE), definitions, 2))
    assert [results[number].failures for number in range(3)] == [
        ("its process has ended with status -9",),
        (),
        (),
    ]


def test_death_of_the_loading_process_is_reported(
    definitions: Definitions, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(*arguments: object, **options: object) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(case_processes, "load_program", die)
    results = dict(run_cases(parse(FILE), definitions, 1))
    assert results[0].failures == ("the process that loads the program has ended with status -9",)
    assert results[2].failures == ()


def test_abandoned_run_ends_its_processes(definitions: Definitions) -> None:
    endless = parse_case(
        "rules: a <- b where (repeat, fail).\ncases: [{name: x, input: [{at: 1, event: b}], expect: {}}]"
    )
    quick = parse_case("rules: a <- b.\ncases: [{name: y, expect: {}}]")
    results = run_cases([quick, endless], definitions, 2)
    assert next(results)[0] == 0
    results.close()
    assert active_children() == []
