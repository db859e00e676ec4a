"""Results as JUnit XML."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from testing.case_texts import fever_file, parse_case

from retalis.foundation.errors import RetalisError, UsageError
from retalis.testing.case_run import CaseResult
from retalis.testing.junit_report import write_junit_report


def test_report_has_cases_failures_and_file_errors(tmp_path: Path) -> None:
    case = parse_case(fever_file("outputs: none"), Path("robot/tests/fever.yaml"))
    results = [
        (case, CaseResult((), (), 0.25)),
        (case._replace(name="second \x1b"), CaseResult(("one <difference>\n  - a", "two"), (), 0.5)),
    ]
    path = tmp_path / "reports" / "junit.xml"
    write_junit_report(path, results, [(Path("bad_test.yaml"), RetalisError("is empty"))])
    root = ElementTree.parse(path).getroot()
    assert root.attrib == {}
    suite, error_suite = root
    assert suite.attrib == {
        "name": "robot/tests/fever.yaml",
        "tests": "2",
        "failures": "1",
        "errors": "0",
        "skipped": "0",
        "time": "0.750",
    }
    first, second = suite
    assert first.attrib == {
        "classname": "robot.tests.fever",
        "name": "fever",
        "file": "robot/tests/fever.yaml",
        "line": "7",
        "time": "0.250",
    }
    assert second.get("name") == "second \\x1b"
    (failure,) = second
    assert failure.get("message") == "one <difference>"
    assert failure.text == "one <difference>\n  - a\ntwo"
    ((problem,),) = error_suite
    assert (problem.tag, problem.get("message")) == ("error", "is empty")


def test_unwritable_report_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot write"):
        write_junit_report(tmp_path / "file" / "junit.xml", [])
