"""Test files with one case each, for tests."""

from pathlib import Path
from typing import Any, Optional

from retalis import Definitions
from retalis.testing.case_definition import Case
from retalis.testing.case_file import parse_case_file
from retalis.testing.case_run import CaseResult, run_case

FEVER_RULES = "fever(Who) <- (temperature(Who, A) seq temperature(Who, B)) within 60 where (A > 38, B > 38)."

FEVER_GOALS = """\
subscribe(fever(W), [], ill(W), alarms, a)
memorize(temperature(_, _), [], _, temperatures, 5)
"""

FEVER_INPUT = """\
[{at: 1, event: "temperature(ann, 38.5)"}, {at: 2, event: "temperature(bob, 39)"},
 {at: 3, event: "temperature(ann, 39.5)"}, {at: 4, event: "temperature(bob, 40)"}]"""


def indent(text: str, spaces: int) -> str:
    return "".join(f"{' ' * spaces}{line}\n" for line in text.splitlines())


def fever_file(expect: str, more: str = "", inputs: str = FEVER_INPUT) -> str:
    """Return a file with a case whose program reports two high temperatures of a person.

    Args:
        expect: value of the key ``expect``.
        more: further keys of the case, one a line.
        inputs: value of the key ``input``.
    """
    return (
        f"rules: |\n{indent(FEVER_RULES, 2)}goals: |\n{indent(FEVER_GOALS, 2)}"
        f"cases:\n  - name: fever\n    input:\n{indent(inputs, 6)}{indent(more, 4)}"
        f"    expect:\n{indent(expect, 6)}"
    )


def parse_case(text: str, path: Optional[Path] = None) -> Case:
    """Return the only case of a file."""
    (case,) = parse_case_file(text, path or Path("mine_test.yaml"))
    return case


def run_text(text: str, definitions: Definitions, path: Optional[Path] = None) -> CaseResult:
    """Run the only case of a file."""
    return run_case(parse_case(text, path), definitions)


def run_fever(definitions: Definitions, expect: str, **options: Any) -> CaseResult:
    """Run a case of `fever_file`."""
    return run_text(fever_file(expect, **options), definitions)
