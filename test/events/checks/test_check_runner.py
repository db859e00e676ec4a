"""Codes of findings, and comments that suppress them."""

import re
from pathlib import Path
from typing import Any, List

import pytest

from retalis import Definitions
from retalis.engine.program_check import check_program
from retalis.events.checks.check_runner import CHECKS, LOAD_CODES


def codes_of(folder: Path, text: str) -> List[Any]:
    """Return the codes of the findings in a file of rules."""
    path = folder / "rules.txt"
    path.write_text(text)
    return [finding.problem.code for finding in check_program(path, Definitions())]


def test_codes_are_unique_and_well_formed() -> None:
    # Several functions can find problems of one code: these have one name and one severity.
    checks = {(check.code, check.name, check.severity) for check in CHECKS}
    codes = [code for code, _, _ in checks] + [code for _, code in LOAD_CODES]
    assert sorted(set(codes)) == sorted(codes)
    assert len({name for _, name, _ in checks}) == len(checks)
    assert all(re.fullmatch(r"RT1\d{3}", code) for code in codes)


def test_each_finding_has_a_code(tmp_path: Path) -> None:
    assert codes_of(
        tmp_path, "hot(T) <- warm(T).\nfire <- hot(_, _).\nice <- cold(X) where frozen(X).\n"
    ) == [
        "RT1201",
        "RT1003",
    ]
    assert codes_of(tmp_path, "a <- .\n") == ["RT1001"]


@pytest.mark.parametrize(
    ("comment", "codes"),
    [
        ("% retalis: ignore=RT1201", []),
        ("% on purpose; retalis: ignore=RT1201", ["RT1201"]),
        ("% retalis: ignore=RT1402, RT1201", []),
        ("% retalis: ignore=RT1402\t,\tRT1201", []),
        ("% retalis: ignore=RT1402", ["RT1201"]),
        ("% retalis: ignore-file=RT1201", []),
    ],
)
def test_comment_in_line_suppresses_finding(tmp_path: Path, comment: str, codes: List[str]) -> None:
    assert codes_of(tmp_path, f"hot(T) <- warm(T).\nfire <- hot(_, _). {comment}\n") == codes


def test_comment_for_file_suppresses_findings(tmp_path: Path) -> None:
    rules = "hot(T) <- warm(T).\nfire <- hot(_, _).\n"
    assert codes_of(tmp_path, f"% retalis: ignore=RT1201\n{rules}") == ["RT1201"]
    assert codes_of(tmp_path, f"% retalis: ignore-file=RT1201\n{rules}") == []


def test_errors_cannot_be_suppressed(tmp_path: Path) -> None:
    assert codes_of(tmp_path, "a <- . % retalis: ignore=RT1001\n") == ["RT1001"]
    assert codes_of(tmp_path, "% retalis: ignore-file=RT1001\na <- .\n") == ["RT1001"]
