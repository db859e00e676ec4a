"""Benchmarks of the engine, and the page of performance that is written from their figures."""

import importlib
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Iterator, List

import pytest

from retalis.foundation.garbage_collection import stop_limiting_gc_pauses

ROOT = Path(__file__).resolve().parents[2]
MODULES = ("curves", "engine", "offline", "performance", "processes", "workload")


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return the function that imports the module of a benchmark."""
    monkeypatch.setattr(sys, "path", [str(ROOT / "bench"), str(ROOT / "examples" / "nao"), *sys.path])
    yield importlib.import_module
    for name in MODULES:
        sys.modules.pop(name, None)
    stop_limiting_gc_pauses()  # the benchmark limits them


def test_case_is_printed_in_one_line(
    bench: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = bench("engine")
    monkeypatch.setattr(sys, "argv", ["engine.py", "join_seq_1000"])
    assert engine.main() == 0
    words = capsys.readouterr().out.split()
    assert words[::2] == ["case", "events", "cpu", "us_per_event", "outputs"]
    assert (words[1], words[3], words[9]) == ("join_seq_1000", "2000", "1000")


def test_renamed_stream_has_same_outputs(bench: Any) -> None:
    engine, work = bench("engine"), bench("workload")
    streams = [work.nao_stream(3), work.nao_stream(3, other_names=True)]
    assert [work.renamed(item.term) for item in streams[0]] == [item.term for item in streams[1]]
    counts: List[Any] = []
    for other in (False, True):
        machine = work.nao_engine(other)
        outputs = engine.Outputs(machine)
        for item in streams[other]:
            machine.post(item.term, item.instant)
        counts.append(outputs.number)
    assert counts[0] == counts[1] == 21


def test_renamed_program_has_no_original_name(bench: Any) -> None:
    work = bench("workload")
    text = "\n".join(
        work.renamed_program((ROOT / "application_source" / "eventRules.txt").read_text(encoding="utf-8"))
    )
    assert "robot__0__Link(" in text
    for name, _ in work.NAMES:
        assert f" {name}(" not in f" {text}".replace("(", " (").replace(" (", "(")


@pytest.mark.slow
def test_each_curve_is_measured(bench: Any, tmp_path: Path) -> None:
    curves = bench("curves")
    file = tmp_path / "curves.json"
    assert curves.main(["--most", "10", "--runs", "1", "--json", str(file)]) == 0
    rows = json.loads(file.read_text())["rows"]
    assert set(rows) == set(curves.CURVES)
    assert sum(len(row["points"]) for row in rows.values()) > 0
    assert all(us > 0 for row in rows.values() for _, us in row["points"])


@pytest.mark.slow
def test_offline_benchmark_processes_bag(bench: Any, capsys: pytest.CaptureFixture[str]) -> None:
    offline = bench("offline")
    assert offline.main(["--seconds", "1", "--runs", "1"]) == 0
    assert "messages" in capsys.readouterr().out


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


def test_runs_of_nodes_are_summarized_by_median(bench: Any) -> None:
    live_node = bench("live_node")
    runs = [
        {
            "way": way,
            "speed": 1.0,
            "cpu_percent": cpu,
            "by_node": {name: cpu},
            "resident_mb": {name: 50.0},
            "lost": 1,
            "drops_reported": 0,
            "poses": 2,
            "expected": 2,
            "messages_a_second": 1881.0,
            "delay_ms_median": None,
            "delay_ms_99": None,
        }
        for way, name, cpu in (
            ("idle", "/idle", 2.0),
            ("idle", "/idle", 4.0),
            ("direct", "/retalis", 6.0),
            ("direct", "/retalis", 6.0),
        )
    ]
    rows = live_node.summary(runs, SimpleNamespace(speed=[1.0], way=["idle", "direct"]))
    assert [row["to_idle"] for row in rows] == [1.0, 2.0]
    assert [row["lost"] for row in rows] == [2, 2]
    assert "= 2.00 idle" in live_node.line(rows[1])
