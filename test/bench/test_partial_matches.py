"""The benchmark of partial matches: its figures and tables, without their values."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Callable, List

import pytest


@pytest.fixture
def events(import_benchmark: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch) -> Any:
    module: Any = import_benchmark("partial_matches")
    # These would collect the garbage of other tests for each figure.
    for name in ("limit_gc_pauses", "restore_gc"):
        monkeypatch.setattr(module.event_streams, name, lambda: None)
    return module


@pytest.mark.nightly
@pytest.mark.slow
def test_each_cell_has_figures(events: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "figures.json"
    assert events.main(["--most", "100", "--json", str(file)]) == 0
    rows = json.loads(file.read_text())["rows"]
    assert {row["operator"] for row in rows} == {*events.CASES, *events.MORE, *events.event_streams.STREAMS}
    assert {row["policy"] for row in rows} == {*events.POLICIES, ""}
    assert {row["waiting"] for row in rows} == {10, 100}
    assert rows
    assert all(row["us"] > 0 for row in rows)
    table = capsys.readouterr().out.splitlines()
    assert len(table) == 1 + len({events.keys(row) for row in rows})


@pytest.mark.slow
def test_figures_of_runs_are_merged_into_table(
    events: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files: List[Any] = []
    for name, policy in (("seq", "unrestricted"), ("seq", "recent"), ("and", "recent")):
        files.append(str(tmp_path / f"{name}_{policy}.json"))
        selection = ["--operator", name, "--policy", policy, "--setting", "alike", "--most", "10"]
        events.main([*selection, "--json", files[-1]])
    capsys.readouterr()
    assert events.main(["--from", *files, "--markdown"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "| operator | policy | 10 |"
    cells = [line.split(" | ")[:2] for line in lines[3:]]
    assert cells == [["| `seq`", "`recent`"], ["| `seq`", "`unrestricted`"], ["| `and`", "`recent`"]]


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["values", "alike", "times", "shuffled"])
def test_completing_events_complete_matches(events: Any, setting: str) -> None:
    for name, policy, _ in events.cells(SimpleNamespace(operator=None, policy=None, setting=[setting])):
        if name in events.CASES:
            (row,) = events.measure(name, policy, setting, 10, 1.0)
            completes_all = setting == "alike" and (policy == "unrestricted" or events.CASES[name].takes_all)
            # Without consumption, an event that completes a match of ntimes begins another one.
            minimum = 10 if completes_all else 1
            assert row["results"] >= minimum if name == "ntimes" else row["results"] == minimum, (
                name,
                policy,
            )


@pytest.mark.slow
def test_stream_rows_fire_as_declared(events: Any) -> None:
    streams = events.event_streams
    for name, row in streams.STREAMS.items():
        bench = streams.StreamBench(row, 10)
        with streams.quiet():
            bench.feed(10 * row.filled)
            before = bench.results
            bench.feed(40)
        assert bool(bench.results - before) == row.fires, name


@pytest.mark.slow
def test_table_of_streams_has_exponents(events: Any, capsys: pytest.CaptureFixture[str]) -> None:
    selection = [
        "--setting",
        "streams",
        "--operator",
        "last_avg",
        "--operator",
        "throttle",
        "--seconds",
        "300",
    ]
    assert events.main([*selection, "--most", "1000", "--markdown"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "| row | what | 10 | 100 | 1,000 | exponent |"
    assert [line.split(" | ")[0] for line in lines[3:]] == ["| `last_avg`", "| `throttle`"]
    for line in lines[3:]:
        assert -1 < float(line.split(" | ")[-1].strip(" |")) < 1


def test_partners_wait_again_after_batch(events: Any) -> None:
    bench = events.Bench("seq", "recent", "values")
    bench.grow(10)
    bench.batch(5)
    assert bench.engine.rules.match_count == 10


def test_exponent_is_fitted_to_points(events: Any) -> None:
    assert events.exponent([(100, 10.0), (1000, 100.0), (10000, 1000.0)]) == pytest.approx(1.0)
    assert events.exponent([(1, 5.0), (10, 5.0)]) == pytest.approx(0.0)
    assert math.isnan(events.exponent([(1, 5.0)]))
