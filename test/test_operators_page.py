"""Pages about the event language: rows of patterns, priorities and aggregates agree with the tables of the source."""

import re
from pathlib import Path
from typing import Any, Dict, List

import pytest

from retalis.events.language.event_operators import EVENT_OPERATORS, OperatorKind
from retalis.events.streams.aggregates import AGGREGATES

pytestmark = pytest.mark.docs

PAGES = Path(__file__).resolve().parents[1] / "docs" / "reference" / "language"
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
