"""The benchmark of waiting matches runs and gives figures; what they are is not tested."""

import importlib
import json
import math
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parents[2] / "bench"


@pytest.fixture
def events(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCH))
    monkeypatch.delitem(sys.modules, "events", raising=False)
    made = importlib.import_module("events")
    for name in (
        "limit_gc_pauses",
        "restore_gc",
    ):  # they have all looked at that other tests have left, for each of the figures
        monkeypatch.setattr(made.event_streams, name, lambda: None)
    yield made
    sys.modules.pop("events", None)


@pytest.mark.slow
def test_every_cell_gives_figures(events, tmp_path, capsys):
    file = tmp_path / "figures.json"
    assert events.main(["--most", "100", "--json", str(file)]) == 0
    rows = json.loads(file.read_text())["rows"]
    assert {row["operator"] for row in rows} == {*events.CASES, *events.MORE, *events.event_streams.STREAMS}
    assert {row["policy"] for row in rows} == {*events.POLICIES, ""}
    assert {row["waiting"] for row in rows} == {10, 100}
    assert all(row["us"] > 0 for row in rows)
    table = capsys.readouterr().out.splitlines()
    assert len(table) == 1 + len({events.keys(row) for row in rows})


@pytest.mark.slow
def test_figures_of_several_runs_make_one_table(events, tmp_path, capsys):
    files = []
    for name, policy in (("seq", "unrestricted"), ("seq", "recent"), ("and", "recent")):
        files.append(str(tmp_path / f"{name}_{policy}.json"))
        which = ["--operator", name, "--policy", policy, "--setting", "alike", "--most", "10"]
        events.main([*which, "--json", files[-1]])
    capsys.readouterr()
    assert events.main(["--from", *files, "--markdown"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "| operator | policy | 10 |"
    cells = [line.split(" | ")[:2] for line in lines[3:]]
    assert cells == [["| `seq`", "`recent`"], ["| `seq`", "`unrestricted`"], ["| `and`", "`recent`"]]


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["values", "alike", "times", "shuffled"])
def test_completing_events_complete(events, setting):
    for name, policy, _ in events.cells(arguments(setting)):
        if name in events.CASES:
            (row,) = events.measure(name, policy, setting, 10, 1.0)
            every = setting == "alike" and (policy == "unrestricted" or events.CASES[name].takes_all)
            # Of ntimes, what completes one match is the beginning of the next where nothing is used up.
            least = 10 if every else 1
            assert row["results"] >= least if name == "ntimes" else row["results"] == least, (name, policy)


@pytest.mark.slow
def test_rows_of_streams_do_what_they_are_about(events):
    streams = events.event_streams
    for name, row in streams.STREAMS.items():
        bench = streams.StreamBench(row, 10)
        with streams.quiet():
            bench.feed(10 * row.filled)
            before = bench.results
            bench.feed(40)
        assert bool(bench.results - before) == row.fires, name


@pytest.mark.slow
def test_the_table_of_streams_has_exponents(events, capsys):
    which = ["--setting", "streams", "--operator", "last_avg", "--operator", "throttle", "--seconds", "300"]
    assert events.main([*which, "--most", "1000", "--markdown"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "| row | what | 10 | 100 | 1,000 | exponent |"
    assert [line.split(" | ")[0] for line in lines[3:]] == ["| `last_avg`", "| `throttle`"]
    for line in lines[3:]:
        assert -1 < float(line.split(" | ")[-1].strip(" |")) < 1


def arguments(setting):
    class Options:
        operator = policy = None

    Options.setting = [setting]
    return Options


def test_partners_wait_again_after_a_batch(events):
    bench = events.Bench("seq", "recent", "values")
    bench.grow(10)
    bench.batch(5)
    assert bench.engine.rules.match_count == 10


def test_fitted_exponents(events):
    assert events.exponent([(100, 10.0), (1000, 100.0), (10000, 1000.0)]) == pytest.approx(1.0)
    assert events.exponent([(1, 5.0), (10, 5.0)]) == pytest.approx(0.0)
    assert math.isnan(events.exponent([(1, 5.0)]))
