"""Extraction of failed test cases from the results of rostest. Needs no ROS."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent))
from rostest_results import failed_cases, failure_report  # noqa: E402

RESULTS = """\
<testsuite name="unittest.suite.TestSuite" tests="3" errors="1" failures="1" time="7.1">
  <testcase classname="services.ServicesTest" name="test_good" time="0.5"></testcase>
  <testcase classname="services.ServicesTest" name="test_rule" time="1.5">
    <failure type="AssertionError">Traceback (most recent call last):
  File "services.py", line 7, in test_rule
AssertionError: 1 != 2 &amp; 3
</failure>
  </testcase>
  <testcase classname="services.ServicesTest" name="test_node" time="5.1">
    <error type="OSError" message="no answer"/>
  </testcase>
  <system-out><![CDATA[AssertionError: of the output]]></system-out>
</testsuite>
"""


def test_failures_are_listed_with_exception_first(tmp_path: Path) -> None:
    (tmp_path / "retalis").mkdir()
    (tmp_path / "retalis" / "rosunit-services.xml").write_text(RESULTS)
    first, second = failed_cases(tmp_path)
    assert first.splitlines()[0] == "services.ServicesTest.test_rule: AssertionError: 1 != 2 & 3"
    assert '    File "services.py", line 7, in test_rule' in first.replace("      ", "    ")
    assert second == "services.ServicesTest.test_node: no answer"


def test_incomplete_file_is_reported_with_name(tmp_path: Path) -> None:
    (tmp_path / "rostest-x.xml").write_text("<testsuite><testcase")
    (text,) = failed_cases(tmp_path)
    assert text.startswith("rostest-x.xml: malformed XML: ")


def test_report_has_cases_and_log(tmp_path: Path) -> None:
    assert failure_report(tmp_path, "the log").splitlines() == [
        "no test case has failed: see the end of the log",
        "",
        "---- log of rostest ----",
        "the log",
    ]
    (tmp_path / "a.xml").write_text(RESULTS)
    report = failure_report(tmp_path, "the log")
    assert report.startswith("services.ServicesTest.test_rule: AssertionError")
    assert report.endswith("the log")
