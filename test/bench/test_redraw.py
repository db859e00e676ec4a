"""The pictures that are drawn anew have the figures of the tables."""

import importlib
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCALING = """\
## All alike

| operator | policy | 10 | 1,000 |
| --- | --- | ---: | ---: |
| `seq` | `recent` | 2.8 |  |
| `and` | `unrestricted` | 1.4 | 1.5 |

## Memory

| operator | policy | 10 |
| --- | --- | ---: |
| `or` | `recent` | 9.9 |
"""


@pytest.fixture
def redraw(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT / "bench"), *sys.path])
    yield importlib.import_module("redraw")
    sys.modules.pop("redraw")


def test_the_tables_of_the_page_on_performance(redraw):
    page = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
    cases = redraw.engine(page)["cases"]
    assert {"nao", "next_128"} <= set(cases)
    assert set(cases["next_128"]) < set(cases["nao"])  # an empty field is none
    assert all(cost > 0 for row in cases.values() for cost in row.values())
    offline = redraw.offline(page)
    assert offline["seconds"] == 60 and all(row["run"] > 0 for row in offline["rows"].values())
    assert all(len(row["points"]) >= 3 for row in redraw.curves(page)["rows"].values())
    rows = redraw.node(page)["rows"]
    assert {row["way"] for row in rows} == {"idle", "roscpp", "direct", "embedded", "converter"}
    assert all(("delay_ms_99" in row) == (row["way"] not in ("idle", "roscpp")) for row in rows)


def test_the_tables_of_the_page_on_scaling(redraw):
    rows = list(redraw.scaling(SCALING))
    assert [(row["setting"], row["operator"], row["waiting"], row["us"]) for row in rows] == [
        ("alike", "seq", 10, 2.8),
        ("alike", "and", 10, 1.4),
        ("alike", "and", 1000, 1.5),
    ]
    page = (ROOT / "docs" / "scaling.md").read_text(encoding="utf-8")
    assert {row["setting"] for row in redraw.scaling(page)} == {"values", "alike", "times"}
