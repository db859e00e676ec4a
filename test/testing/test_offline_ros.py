"""Answers of services and values of parameters in test cases and files."""

from pathlib import Path
from typing import Any

import pytest
from testing.case_texts import run_text

from retalis import Definitions
from retalis.testing.case_file import parse_case_file, read_answers_file
from retalis.testing.yaml_documents import CaseFileError

CASE = """\
rules: |
  dock(X) do ros_service('/dock', 'std_srvs/SetBool', std_srvs__0__SetBool_Request(X), X, [timeout(2)]).
  docked(X, T) <- service_reply(_, X, std_srvs__0__SetBool_Response(true, T)).
services: {services}
cases:
  - name: docking
    input: [{{at: 1, event: dock(true)}}, {{at: 2, event: dock(false)}}]
    until: 10
    expect:
{expect}
"""


def run(services: str, *expect: str) -> Any:
    """Return the failures of a case with calls at 1 s and 2 s."""
    expectations = "".join(f"      {line}\n" for line in expect)
    return run_text(CASE.format(services=services, expect=expectations), Definitions()).failures


def test_answers_are_events_at_their_time() -> None:
    assert not run(
        "[{name: dock, request: {data: true}, reply: {success: true, message: ok}, delay: 1.5},"
        " {name: /dock, error: occupied}]",
        "events:",
        """  - {event: "service_call('/dock', true, std_srvs__0__SetBool_Request(true))", at: 1}""",
        """  - {event: "service_call('/dock', false, _)", at: 2}""",
        """  - {event: "service_failed('/dock', false, occupied)", at: 2}""",
        """  - {event: "service_reply('/dock', true, _)", at: 2.5}""",
        """  - {event: "docked(true, '\\"ok\\"')", at: 2.5}""",
    )


@pytest.mark.parametrize(
    ("services", "reason"),
    [
        ("[]", "services are called only in a node: use --answers FILE, or the key services of a test case"),
        ("[{name: other, error: no}]", "no answer is prepared for this call"),
        ("[{name: dock, reply: {success: true}, count: 1}]", "no answer is prepared for this call"),
    ],
)
def test_call_without_answer_fails(services: str, reason: str) -> None:
    assert not run(services, f"""events: {{contains: ["service_failed('/dock', false, '{reason}')"]}}""")


def test_late_answer_is_a_timeout() -> None:
    assert not run(
        "[{name: dock, reply: {}, delay: 3}]",
        "events:",
        """  contains: [{event: "service_failed(_, true, 'no reply within 2 s')", at: 3}]""",
        '  none: ["docked(_, _)"]',
    )


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        (
            "reply: {sucess: true}",
            "mine_test.yaml:4:41: std_srvs/SetBool_Response has no slot sucess; did you",
        ),
        (
            "reply: {sucess: true}, delay: 1",
            "mine_test.yaml:4:41: std_srvs/SetBool_Response has no slot sucess",
        ),
        (
            "request: {dta: true}, reply: {}",
            "mine_test.yaml:4:40: std_srvs/SetBool_Request has no slot dta; did",
        ),
        ("request: {data: 3}, reply: {}", "mine_test.yaml:4:41: data: expected true or false"),
    ],
)
def test_wrong_slot_of_answer_fails_case(answer: str, error: str) -> None:
    failures = run(f"[{{name: dock, {answer}}}]", """events: {contains: ["service_failed(_, true, _)"]}""")
    assert failures[0].startswith(f"unexpected error: {error}")


@pytest.mark.parametrize(
    ("services", "message"),
    [
        ("[{reply: {}}]", "expected the key 'name'"),
        ("[{name: dock}]", "expected either the key 'reply' or the key 'error'"),
        ("[{name: dock, reply: {}, error: no}]", "expected either the key 'reply' or the key 'error'"),
        ("[{name: dock, replay: {}}]", "replay"),
        ("[{name: 'no such  name!', reply: {}}]", r":4:19: name: expected a topic name .*'no such  name!'"),
        ("[{name: dock, reply: {}, count: 0}]", ":4:43: count: 0 is too small"),
    ],
)
def test_invalid_answer_is_an_error(services: str, message: str) -> None:
    with pytest.raises(CaseFileError, match=message):
        parse_case_file(CASE.format(services=services, expect="      {}"), Path("mine_test.yaml"))


def test_goals_read_parameters_of_case() -> None:
    text = (
        "rules: hot(T) <- heat(T) where (ros_param('/oven/limit', L), T > L).\n"
        "parameters: {/oven: {limit: 40.5}, ~number: 7, max_gap: 2}\n"
        "cases: [{name: x, input: [{at: 1, event: heat(41)}], expect: {events: [hot(41)], state:"
        " [{query: \"ros_param('~number', N)\", expect: {N: 7}},"
        " {query: \"ros_param('/limit', N)\", expect: false}]}}]"
    )
    assert run_text(text, Definitions()).failures == ()


def test_file_of_answers_is_read(tmp_path: Path) -> None:
    path = tmp_path / "answers.yaml"
    path.write_text("services: [{name: /dock, error: no}]\nparameters: {/limit: 3, rate: 5}\n")
    answers = read_answers_file(path)
    assert [answer.error for answer in answers.services or ()] == ["no"]
    assert answers.parameters == (("/limit", 3), ("rate", 5))
    path.write_text("services: []\n")
    assert read_answers_file(path) == ((), None)
    path.write_text("parameters: {}\n")
    assert read_answers_file(path) == (None, ())
    path.write_text("cases: []\n")
    with pytest.raises(CaseFileError):
        read_answers_file(path)
