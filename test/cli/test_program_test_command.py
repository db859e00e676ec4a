"""Command ``test``: selection, output, reports, and exit status."""

import json
import os
from pathlib import Path
from typing import Any, List, Tuple
from xml.etree import ElementTree

import pytest
from testing.case_texts import fever_file

from retalis import BagWriter, Definitions
from retalis.cli.command_line import main

PASSING = fever_file("outputs: {count: 2}")
FAILING = fever_file("outputs: {count: 3}")


def run_test(capsys: pytest.CaptureFixture[str], *arguments: Any) -> Tuple[int, str]:
    """Return the exit status and the printed text."""
    status = main(["test", *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out + captured.err


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_passing_cases_have_status_0(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(PASSING)
    assert run_test(capsys) == (0, "1 passed\n")
    status, text = run_test(capsys, "a_test.yaml", "-v", "-j", "2")
    assert status == 0
    assert text.splitlines()[0] == "passed a_test.yaml:7: fever"


def test_failed_case_has_status_1_and_command(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "tests").mkdir()
    (folder / "tests" / "a b.yaml").write_text(FAILING)
    assert run_test(capsys) == (
        1,
        "FAILED tests/a b.yaml:7: fever\n"
        "  tests/a b.yaml:12: outputs: 3 expected, 2 found\n"
        "  alone: retalis test 'tests/a b.yaml:7'\n"
        "0 passed, 1 failed\n",
    )


def test_wrong_use_has_status_2(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    assert run_test(capsys) == (
        2,
        "retalis: no test cases in .: expected tests/*.yaml or *_test.yaml\n",
    )
    (folder / "a_test.yaml").write_text(PASSING)
    assert run_test(capsys, "-k", "cold") == (2, "retalis: no case matches -k 'cold'\n")
    (folder / "b_test.yaml").write_text("cases: 3")
    status, text = run_test(capsys)
    assert status == 2
    assert text.startswith("error: b_test.yaml:1:8: cases: expected a list, found '3'\n")
    assert text.endswith("1 passed, 1 file error\n")


def test_first_failure_ends_run(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(FAILING)
    (folder / "b_test.yaml").write_text(PASSING.replace("60", "61"))
    status, text = run_test(capsys, "-x", "-j", "1")
    assert status == 1
    assert text.endswith("0 passed, 1 failed, 1 not run\n")


def test_selection_includes_file_names(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(FAILING)
    (folder / "b_test.yaml").write_text(PASSING)
    assert run_test(capsys, "-k", "b_test and fever") == (0, "1 passed\n")


def test_update_writes_golden_file_after_difference(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(fever_file("golden: golden/a.jsonl"))
    status, text = run_test(capsys, "--update")
    assert status == 1
    assert "there is no golden file golden/a.jsonl" in text
    assert "updated golden/a.jsonl\n" in text
    lines = (folder / "golden" / "a.jsonl").read_text().splitlines()
    assert [json.loads(line)["output"] for line in lines] == ["ill(ann)", "ill(bob)"]
    assert run_test(capsys, "--update") == (0, "1 passed\n")


def test_junit_report_is_written(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(FAILING)
    (folder / "b_test.yaml").write_text("")
    assert run_test(capsys, "--junit", "junit.xml")[0] == 2
    root = ElementTree.parse(folder / "junit.xml").getroot()
    counts = [tuple(suite.get(name) for name in ("tests", "failures", "errors")) for suite in root]
    assert counts == [("1", "1", "0"), ("1", "0", "1")]


def test_coverage_below_threshold_has_status_1(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    low = '[{at: 0, event: "temperature(eve, 37)"}, {at: 1, event: "temperature(eve, 37)"}, '
    state = "state: [{query: 'memory_counter(temperatures, _)', expect: true}]"
    covering = fever_file("outputs: {count: 2}\n" + state)
    covering = covering.replace("[{at: 1,", low + "{at: 1,")
    (folder / "a_test.yaml").write_text(covering)
    status, text = run_test(capsys, "--coverage", "--threshold", "100")
    assert status == 0
    assert text.endswith("memory             2     2\n100 % covered\n")
    (folder / "a_test.yaml").write_text(covering.replace("rules: |\n", "rules: |\n  cold <- frost(_).\n"))
    status, text = run_test(capsys, "--threshold", "90", "--cobertura", "coverage.xml")
    assert status == 1
    assert text.endswith("coverage 80 % is below the threshold of 90 %\n")
    assert (folder / "coverage.xml").exists()


def test_coverage_without_cases_names_reason(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "b_test.yaml").write_text("cases: 3")
    status, text = run_test(capsys, "--coverage")
    assert status == 2
    assert text.endswith("0 passed, 1 file error\ncoverage: no case has run\n")


def test_html_has_coverage_on_request(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(FAILING)
    (folder / "b_test.yaml").write_text("cases: 3\n")
    assert run_test(capsys, "--html", "page.html")[0] == 2
    text = (folder / "page.html").read_text(encoding="utf-8")
    assert "a_test.yaml:7" in text
    assert "b_test.yaml:1:8: cases: expected a list" in text
    assert "Coverage" not in text
    run_test(capsys, "--html", "page.html", "--coverage")
    assert "Coverage" in (folder / "page.html").read_text(encoding="utf-8")


def test_line_selects_case(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    cases = "rules: a <- b.\ncases:\n  - {name: not x, expect: {}}\n  - {name: x, expect: {outputs: {count: 1}}}\n"
    (folder / "a_test.yaml").write_text(cases)
    assert run_test(capsys, "a_test.yaml:3") == (0, "1 passed\n")
    status, text = run_test(capsys, "a_test.yaml:4")
    assert status == 1
    assert "  alone: retalis test a_test.yaml:4\n" in text


def test_update_keeps_golden_file_of_broken_program(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    text = fever_file("golden: a.jsonl")
    (folder / "a_test.yaml").write_text(text)
    run_test(capsys, "--update")
    golden = (folder / "a.jsonl").read_text()
    (folder / "a_test.yaml").write_text(text.replace("fever(Who) <-", "fever(Who <-"))
    assert run_test(capsys, "--update")[0] == 1
    assert (folder / "a.jsonl").read_text() == golden


def test_invalid_characters_are_escaped(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(fever_file('errors: ["\\u0001"]'))
    status, text = run_test(capsys, "--junit", "junit.xml")
    assert status == 1
    assert "expected error missing: \\x01" in text
    (failure,) = ElementTree.parse("junit.xml").iter("failure")
    assert "expected error missing: \\x01" in str(failure.text)


def test_fuzz_reports_findings_with_status_0(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(PASSING)
    (folder / "b_test.yaml").write_text(FAILING.replace("60", "61"))
    status, text = run_test(capsys, "a_test.yaml", "--fuzz", "10", "--seed", "3")
    assert status == 0
    assert text.startswith("fuzz a_test.yaml:7: fever: 10 tries\n  robustness ")
    assert "  outputs.count fails if the event at " in text
    assert text.endswith("\n1 passed\n")
    assert run_test(capsys, "a_test.yaml", "--fuzz", "10", "--seed", "3") == (0, text)


def test_failed_case_is_not_fuzzed(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(FAILING)
    status, text = run_test(capsys, "--fuzz", "10")
    assert status == 1
    assert "fuzz" not in text


def test_several_lines_of_a_file_select_cases(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    case = "  - {name: %s, expect: {}}\n"
    (folder / "a_test.yaml").write_text(f"rules: a <- b.\ncases:\n{case % 'x'}{case % 'y'}{case % 'z'}")
    status, text = run_test(capsys, "a_test.yaml:3", "a_test.yaml:5", "-v")
    assert status == 0
    assert [line for line in text.splitlines() if line.startswith("passed")] == [
        "passed a_test.yaml:3: x",
        "passed a_test.yaml:5: z",
    ]


def test_foreign_file_in_tests_is_skipped_with_message(
    capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    (folder / "tests").mkdir()
    (folder / "tests" / "robot.yaml").write_text("wheels: 2\n")
    (folder / "tests" / "fever.yml").write_text(PASSING)
    assert run_test(capsys) == (0, "skipped tests/robot.yaml: it has no key 'cases'\n1 passed\n")
    # The end of the name says that this is a test file.
    (folder / "robot_test.yaml").write_text("wheels: 2\n")
    status, text = run_test(capsys)
    assert status == 2
    assert "robot_test.yaml:1:1: unknown key 'wheels'" in text


def test_warning_of_program_is_printed_once(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(
        "rules: a <- b.\ncases: [{name: x, expect: {}}, {name: y, expect: {}}]"
    )
    assert run_test(capsys, "-v")[1].count("no consumer of a/0") == 1


def test_invalid_golden_file_is_replaced_by_update(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "a_test.yaml").write_text(fever_file("golden: a.jsonl"))
    (folder / "a.jsonl").write_text("{")
    status, text = run_test(capsys)
    assert status == 1
    assert "a.jsonl:1:1: not a line of JSON" in text
    run_test(capsys, "--update")
    assert run_test(capsys) == (0, "1 passed\n")


def test_watch_runs_again_after_change_of_program_elsewhere(
    capsys: pytest.CaptureFixture[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = folder / "program"
    program.mkdir()
    (program / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\n")
    (program / "rules.txt").write_text("a <- b.\n")
    (program / "pub_sub.xml").write_text("<publish_subscribe/>\n")
    tests = folder / "elsewhere" / "tests"
    tests.mkdir(parents=True)
    case = "{name: x, input: [{at: 1, event: b}], expect: {events: [a]}}"
    (tests / "a.yaml").write_text(f"program: ../../program\ncases: [{case}]")
    runs: List[str] = []

    def wait(seconds: float) -> None:
        output = capsys.readouterr().out
        if "waiting for changes" not in output:
            return
        runs.append(output)
        if len(runs) == 2:
            raise KeyboardInterrupt
        # The time of change has to differ.
        (program / "rules.txt").write_text("a <- c.\n")
        os.utime(program / "rules.txt", (1, 1))

    monkeypatch.setattr("time.sleep", wait)
    run_test(capsys, tests, "--watch")
    assert [run.splitlines()[-2] for run in runs] == ["1 passed", "0 passed, 1 failed"]


def test_incomplete_bag_is_reported_with_passed_case(
    capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    definition = Definitions().find("std_msgs/Empty")
    with BagWriter("a.bag") as bag:
        bag.write(bag.add("/a", definition), 1, b"")
    Path("a.bag").write_bytes(Path("a.bag").read_bytes()[:-20])
    (folder / "a_test.yaml").write_text(
        "rules: |\n  b <- std_msgs__0__Empty.\ntopics: {a: std_msgs/Empty}\n"
        "cases: [{name: x, input: [{bag: a.bag}], expect: {events: [b]}}]\n"
    )
    status, text = run_test(capsys, "--junit", "results.xml")
    warning, summary = text.splitlines()
    assert (status, summary) == (0, "1 passed")
    assert warning.startswith("  warning: a.bag is incomplete: its index is cut or damaged at byte ")
    assert ElementTree.parse("results.xml").getroot().findtext(".//system-out") == warning.strip()
