"""Plugin of pytest, in a process of its own."""

import runpy
import subprocess
import sys
from pathlib import Path
from typing import List, Optional, Tuple

import pytest
from subprocess_python_path import python_path
from testing.case_texts import fever_file

PROGRAM_RULES = (
    "cornered(Side) <- (bump(_) seq bump(Side)) within 10.\nbroken(Y) <- bad(X) where Y is X + 1.\n"
)

PYTHON_TEST = """\
def test_two_bumps(retalis_program):
    program = retalis_program()
    program.event("bump(left)", 1)
    program.event("bump(right)", 4)
    assert program.events == ["bump(left)", "bump(right)", "cornered(right)"]
    assert program.outputs == ["alarms: cornered(right)"]


def test_absence(retalis_engine):
    retalis_engine.load("silent <- hello seq absent(hello, 5).")
    retalis_engine.event("hello", 1)
    retalis_engine.advance(10)
    assert retalis_engine.events == ["hello", "silent"]


def test_wrong_expectation(retalis_program):
    program = retalis_program()
    program.event("bump(left)", 1)
    assert program.events == ["bump(right)"]


def test_error_of_rule(retalis_program):
    retalis_program().event("bad(x)", 1)
"""


def run_pytest(folder: Path, *arguments: str) -> Tuple[int, str]:
    process = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-p",
            "retalis.testing.pytest_entry_point",
            "-p",
            "no:cacheprovider",
            *arguments,
        ],
        cwd=str(folder),
        env={
            "PYTHONPATH": python_path(),
            "PATH": "/usr/bin:/bin",
            "COLUMNS": "200",
            "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        },
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120,
    )
    return process.returncode, process.stdout


@pytest.fixture
def program(tmp_path: Path) -> Path:
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "goalPredicates.txt").write_text(
        "compile_event_file('eventRules.txt')\nsubscribe(cornered(_), [], _, alarms, a)\n"
    )
    (tmp_path / "eventRules.txt").write_text(PROGRAM_RULES)
    (tmp_path / "tests").mkdir()
    return tmp_path


def test_cases_are_collected_with_their_failures(program: Path) -> None:
    (program / "tests" / "fever.yaml").write_text(fever_file("outputs: {count: 2}"))
    (program / "other_test.yaml").write_text(fever_file("outputs: {count: 3}"))
    (program / "tests" / "settings.yaml").write_text("# edge cases: loud\nvolume: 3\n")
    status, text = run_pytest(program, "-v")
    assert status == 1
    assert "tests/fever.yaml::fever PASSED" in text
    assert "other_test.yaml::fever FAILED" in text
    assert "other_test.yaml:12: outputs: 3 expected, 2 found" in text
    assert "1 failed, 1 passed" in text
    assert "Traceback" not in text


def test_error_of_file_is_reported_with_place(program: Path) -> None:
    (program / "tests" / "bad.yaml").write_text("cases: [{nam: x}]\n")
    status, text = run_pytest(program)
    assert status == 2
    assert "bad.yaml:1:10: unknown key 'nam'" in text
    assert "did you mean name?" in text


def test_fixtures_provide_engines(program: Path) -> None:
    (program / "tests" / "test_rules.py").write_text(PYTHON_TEST)
    status, text = run_pytest(program, "-v")
    assert status == 1
    assert "test_two_bumps PASSED" in text
    assert "test_absence PASSED" in text
    assert "test_wrong_expectation FAILED" in text
    assert "assert ['bump(left)'] == ['bump(right)']" in text
    assert "ERROR at teardown of test_error_of_rule" in text
    assert "eventRules.txt:2" in text


def test_case_ends_at_its_time_limit(program: Path) -> None:
    (program / "tests" / "endless.yaml").write_text(
        "rules: a <- b where (repeat, fail).\n"
        "cases:\n"
        "  - {name: endless, timeout: 0.5, input: [{at: 1, event: b}], expect: {}}\n"
        "  - {name: short, expect: {}}\n"
    )
    status, text = run_pytest(program, "-v")
    assert status == 1
    assert "not finished after 0.5 s (key 'timeout')" in text
    assert "endless.yaml::short PASSED" in text


@pytest.mark.parametrize(
    ("version", "plugins"), [("6.2.5", None), ("7.0.0", ["retalis.testing.pytest_plugin"])]
)
def test_entry_point_has_no_hooks_for_old_versions(
    version: str, plugins: Optional[List[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    entry_point = settings.partition("[project.entry-points.pytest11]")[2].partition('"')[2].partition('"')[0]
    monkeypatch.setattr(pytest, "__version__", version)
    names = runpy.run_module(entry_point)
    assert names.get("pytest_plugins") == plugins
    assert "pytest_collect_file" not in names
