"""Page of performance: tables of the figures of benchmarks, written between its marks."""

import json
from pathlib import Path
from typing import Any


def test_page_is_written_between_marks(bench: Any, tmp_path: Path) -> None:
    performance = bench("performance")
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- engine -->\nold\n<!-- end of engine -->\nafter\n")
    figures = {
        "machine": {"cpu": "A CPU", "cores": "2", "python": "CPython 3"},
        "runs": 3,
        "cases": {"nao": {"terms": 2.0, "reference": 10.0}, "more": {"terms": 1.0}},
    }
    (tmp_path / "engine.json").write_text(json.dumps(figures))
    performance.write_page(tmp_path, page)
    text = page.read_text()
    assert "old" not in text
    assert "| `nao` | 2.00 | 10.00 | 1/5.0 |" in text
    assert "A CPU, 2 cores, CPython 3." in text
    assert text.startswith("before")
    assert text.endswith("after\n")


def test_sections_of_page_have_marks(bench: Any) -> None:
    performance = bench("performance")
    text = performance.PAGE.read_text(encoding="utf-8")
    for name in performance.SECTIONS:
        assert text.count(f"<!-- {name} -->\n") == text.count(f"<!-- end of {name} -->") == 1


def test_figures_are_shown_in_tables(bench: Any) -> None:
    performance = bench("performance")
    machine = {"cpu": "A CPU", "cores": "2", "python": "CPython 3"}
    row = {"start": 0.2, "run": 0.9, "messages": 100_000.0, "outputs": 5.0}
    assert "| 3.11 | 0.20 | 0.90 | 100000 | 9.00 |" in performance.offline(
        {"machine": machine, "seconds": 60, "rows": {"3.11": row}}
    )
    curve = {"title": "rules", "grows": False, "points": [[1, 2.0], [10, 2.0]], "exponent": 0.0}
    assert "| rules | 1: 2.00, 10: 2.00 | 0.00 |" in performance.curves(
        {"machine": machine, "rows": {"rules": curve}}
    )
