"""Table of event operators: syntax, semantics, explanations and documentation."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List

from events import operator_table
from fuzz.kinds import rules as fuzzed
from subprocess_python_path import python_path

from retalis.events.language.event_operators import EVENT_OPERATORS, PAIR_OPERATORS, OperatorKind
from retalis.events.streams.aggregates import AGGREGATES

PAGES = Path(__file__).resolve().parents[3] / "docs" / "reference" / "language"
PAGE = (PAGES / "index.md").read_text(encoding="utf-8")
NO_OPERATORS = {"`E`", "`P seq prolog(G)`, `prolog(G) seq P`"}
"""Rows of the table of patterns that belong to no operator."""
LINK = re.compile(r"\[(.*)\]\([\w-]+\.md\)")


def table_rows(title: str) -> List[List[Any]]:
    """Return the rows of the table of this title, each a list of its cells."""
    lines = PAGE[PAGE.index(f"\n{title}\n") :].split("\n\n")[0].strip().split("\n")[2:]
    return [[LINK.sub(r"\1", cell) for cell in row[2:-2].split(" | ")] for row in lines]


def test_page_has_rows_of_all_patterns() -> None:
    assert sorted(map(tuple, table_rows("| pattern | is matched when | interval |"))) == sorted(
        [
            *(row for operator in EVENT_OPERATORS for row in operator.table_rows),
            *(
                tuple(row)
                for row in table_rows("| pattern | is matched when | interval |")
                if row[0] in NO_OPERATORS
            ),
        ]
    )


def test_each_operator_has_a_table_row() -> None:
    forms = " ".join(row.notation for operator in EVENT_OPERATORS for row in operator.table_rows)
    for operator in EVENT_OPERATORS:
        if operator.kind not in (OperatorKind.RULE, OperatorKind.UNSUPPORTED):
            assert re.search(rf"\b{operator.spellings[0]}\b", forms), operator.name


def test_page_has_priorities() -> None:
    expected: Dict[Any, Any] = {}
    for operator in EVENT_OPERATORS:
        if operator.priority and operator.kind is not OperatorKind.UNSUPPORTED:
            expected.setdefault(str(operator.priority), set()).update((operator.name, *operator.signs))
    priorities = {
        priority: re.findall(r"`([^`]+)`", names)
        for priority, names in table_rows("| priority | operators |")
    }
    priorities["1200"].remove(":")
    assert {
        priority: {name.strip("'") for name in names} for priority, names in priorities.items()
    } == expected


def test_page_names_aggregates() -> None:
    page = (PAGES / "repetition.md").read_text(encoding="utf-8")
    (aggregates,) = re.findall(r"The kinds of aggregate are (.*)\. \[", page)
    assert re.findall(r"`([^`]+)`", aggregates) == [aggregate.notation for aggregate in AGGREGATES.values()]


def test_tests_cover_all_operators() -> None:
    """The tests have their own table of operators, as an independent definition."""
    names = {
        operator.spellings[0]
        for operator in EVENT_OPERATORS
        if operator.kind not in (OperatorKind.RULE, OperatorKind.UNSUPPORTED)
    }
    assert set(PAIR_OPERATORS) == set(operator_table.PAIRS)
    assert set(AGGREGATES) == set(operator_table.AGGREGATES)
    assert names <= {re.sub(r"\W.*", "", row) for row in operator_table.ROWS} | {
        "do",
        "aggregate",
        "with",
        "absent",
        "not_preceded",
    }
    written = " ".join((*fuzzed.SIDES, *fuzzed.GOALS, *fuzzed.STREAMS, "do"))
    assert all(re.search(rf"\b{name}\b", written) for name in names)


def test_prolog_reader_has_no_event_operators() -> None:
    program = (
        "from retalis.prolog.syntax.operators import Operators\n"
        "print('seq' in Operators.prolog(), 'mod' in Operators.prolog())\n"
        "import retalis\n"
        "print('seq' in retalis.Operators.prolog())\n"
    )
    env = {"PYTHONPATH": python_path(), "PATH": "/usr/bin:/bin"}
    result = subprocess.run(
        [sys.executable, "-c", program], env=env, capture_output=True, text=True, timeout=60, check=False
    )
    assert result.stderr == ""
    assert result.stdout == "False True\nTrue\n"
