"""Benchmarks of the engine and of nodes, with small numbers."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, List

import pytest

ROOT = Path(__file__).resolve().parents[2]


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


@pytest.mark.slow
def test_benchmark_of_versions_runs_each_command(bench: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench("version_diff").main(["--seconds", "0.5", "--runs", "1"]) == 0
    assert capsys.readouterr().out.count(" s\n") == 7


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
