"""Exact texts of the findings for typical mistakes."""

from collections import defaultdict
from pathlib import Path
from typing import Any, Iterator

import pytest
from events.checks.inserted_mistakes import write_program
from parsed_sources import ROOT

from retalis import Definitions
from retalis.engine.program_check import check_program

TABLE = ROOT / "test" / "data" / "mistakes.txt"


def mistakes() -> Iterator[Any]:
    """Yield the mistakes of the table: the lines that they add to each file, and the findings."""
    for entry in TABLE.read_text(encoding="utf-8").split("\n## ")[1:]:
        name, *lines = entry.rstrip().split("\n")
        lines_by_part = defaultdict(list)
        for line in lines:
            if line.startswith("|"):
                lines_by_part["findings"].append(line[2:])
            else:
                lines_by_part[line[:6].strip()].append(line[6:])
        yield pytest.param({part: "\n".join(lines) for part, lines in lines_by_part.items()}, id=name)


def findings_text(folder: Path, definitions: Any) -> str:
    findings = check_program(folder, definitions)
    text = "\n".join(f"{finding.severity}: {finding.problem}" for finding in findings)
    return text.replace(f"{folder}/", "")


@pytest.mark.parametrize("mistake", list(mistakes()))
def test_mistake_has_one_finding_with_position(
    tmp_path: Path, definitions: Definitions, mistake: Any
) -> None:
    write_program(tmp_path, **mistake)
    assert findings_text(tmp_path, definitions) == mistake["findings"]


def test_table_has_thirty_mistakes() -> None:
    assert len(list(mistakes())) >= 30


def test_program_without_mistakes_has_no_findings(tmp_path: Path, definitions: Definitions) -> None:
    write_program(tmp_path)
    assert findings_text(tmp_path, definitions) == ""


def test_timestamp_is_number_of_arithmetic(tmp_path: Path, definitions: Definitions) -> None:
    header = "sensor_msgs__0__Temperature(std_msgs__0__Header(_, T, _), _, _)"
    write_program(tmp_path, rule=f"hit <- {header} check (t2(E), E - T > 0.5).")
    assert findings_text(tmp_path, definitions) == ""


@pytest.mark.parametrize(
    "rule",
    [
        "std_msgs__0__Bool(X) <- std_msgs__0__String(_) where member(X, [0, 1]), X > 0.",
        "std_msgs__0__Bool(X) <- sensor_msgs__0__Temperature(_, X, _).",
        "std_msgs__0__String(X) <- sensor_msgs__0__Temperature(_, T, _) where T > 3, X = go, X == go.",
        "std_msgs__0__Float64(X) <- reading(X) where X \\== unknown.",
    ],
)
def test_converted_values_are_not_reported(tmp_path: Path, definitions: Definitions, rule: str) -> None:
    write_program(tmp_path, rule=rule)
    assert [
        finding.problem for finding in check_program(tmp_path, definitions) if finding.check == "kinds"
    ] == []


@pytest.mark.slow
def test_example_has_no_findings(definitions: Definitions) -> None:
    assert findings_text(ROOT / "application_source", definitions) == ""
