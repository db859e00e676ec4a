"""The work that others do, too: all sides give the same; what they take is not tested."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parents[2] / "bench"
MODULES = ("outside", "outside_sides")
EVENTS = 1500


@pytest.fixture
def outside(monkeypatch):
    """The module; of its sequences only a hundred are open at a time."""
    monkeypatch.setattr(sys, "path", [str(BENCH), *sys.path])
    found = importlib.import_module("outside")
    monkeypatch.setattr(importlib.import_module("outside_sides"), "WAITING", 100)
    yield found
    for name in MODULES:
        sys.modules.pop(name, None)


def results(outside, side, work, number=EVENTS):
    found = []
    outside.SIDES[side](work, outside.STREAMS[work](number), lambda *values: found.append(values))()
    return found


@pytest.mark.parametrize("work", ["keyed", "absence", "sliding", "pairs"])
def test_the_engine_gives_what_the_loop_gives(outside, work):
    by_hand = results(outside, "loop", work)
    assert len(by_hand) > 200
    assert results(outside, "retalis", work) == by_hand


def test_events_leave_the_window_of_the_engine(outside):
    found = results(outside, "retalis", "sliding", 10_500)
    assert found == results(outside, "loop", "sliding", 10_500)
    assert max(number for _, number, _ in found) < 150


@pytest.mark.parametrize("work", ["keyed", "absence", "sliding"])
def test_bytewax_gives_what_the_loop_gives(outside, work):
    pytest.importorskip("bytewax")
    found, by_hand = results(outside, "bytewax", work), results(outside, "loop", work)
    assert sorted(found) == sorted(by_hand)  # it has an order for each key, and none among keys


def test_what_undoes_makes_fewer(outside):
    assert len(results(outside, "loop", "absence")) < len(results(outside, "loop", "keyed"))


@pytest.mark.parametrize("work", ["keyed", "absence", "sliding", "pairs"])
def test_streams_are_the_same_each_time_and_in_order(outside, work):
    stream = outside.STREAMS[work](EVENTS)
    assert len(stream) == EVENTS and stream == outside.STREAMS[work](EVENTS)
    times = [event[2] for event in stream]
    assert times == sorted(times)


@pytest.mark.slow
def test_the_table(outside, tmp_path, capsys):
    file = tmp_path / "found.json"
    small = ["--events", "300", "--runs", "1", "--json", str(file)]
    assert outside.main(["--work", "pairs", *small, "--markdown"]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0] == "| work | retalis | loop | bytewax | message_filters | results |"
    assert table[2].startswith("| `pairs` | ") and " (1.0) | – | " in table[2]
    assert "pairs: without bytewax: bytewax has nothing for pairs" in table or "No module" in table[3]
    found = json.loads(file.read_text())["work"]["pairs"]
    assert found["retalis"]["results"] == found["loop"]["results"] > 100
    assert found["loop"]["us"] > 0


@pytest.mark.parametrize(
    "outputs, message",
    [
        ({"loop": [5], "retalis": [4]}, "^pairs: retalis gives 4 results, the loop 5$"),
        ({"loop": [5, 6], "retalis": [5, 5]}, "^pairs: loop gives another number of results in each run: "),
    ],
)
def test_results_that_differ_end_it(outside, monkeypatch, outputs, message):
    left = {side: list(numbers) for side, numbers in outputs.items()}

    def run(command, **_):
        number = left[command[command.index("--side") + 1]].pop(0)
        return subprocess.CompletedProcess(command, 0, json.dumps({"us": 1.0, "results": number}), "")

    monkeypatch.setattr(outside.subprocess, "run", run)
    with pytest.raises(SystemExit, match=message):
        outside.compare("pairs", {"loop": "python", "retalis": "python"}, 10, len(outputs["loop"]))


def test_a_run_that_fails_says_why(outside, monkeypatch):
    failed = subprocess.CompletedProcess([], 1, "", "it was broken")
    monkeypatch.setattr(outside.subprocess, "run", lambda command, **_: failed)
    with pytest.raises(SystemExit, match="--side loop .*failed:\nit was broken"):
        outside.compare("pairs", {"loop": "python"}, 10, 1)


def test_a_side_that_cannot_is_left_out(outside, capsys):
    assert outside.main(["--side", "bytewax", "--work", "pairs", "--events", "10"]) == outside.MISSING
    assert "bytewax" in capsys.readouterr().out
