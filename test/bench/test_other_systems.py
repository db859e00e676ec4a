"""The comparison with other systems: all have equal results; their times are not tested."""

import json
import subprocess
from pathlib import Path
from typing import Any, Callable, Dict, List

import pytest

EVENTS = 1500


@pytest.fixture
def other_systems(import_benchmark: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the module with at most 100 open sequences at a time."""
    monkeypatch.setattr(import_benchmark("other_systems_sides"), "WAITING", 100)
    return import_benchmark("other_systems")


def results(other_systems: Any, side: str, work: str, number: Any = EVENTS) -> Any:
    outputs: List[Any] = []
    other_systems.SIDES[side](
        work, other_systems.STREAMS[work](number), lambda *values: outputs.append(values)
    )()
    return outputs


@pytest.mark.parametrize("work", ["keyed", "absence", "sliding", "pairs"])
def test_engine_has_results_of_loop(other_systems: Any, work: str) -> None:
    expected = results(other_systems, "loop", work)
    assert len(expected) > 200
    assert results(other_systems, "retalis", work) == expected


def test_events_leave_window_of_engine(other_systems: Any) -> None:
    outputs = results(other_systems, "retalis", "sliding", 10_500)
    assert outputs == results(other_systems, "loop", "sliding", 10_500)
    assert max(number for _, number, _ in outputs) < 150


def test_absence_has_fewer_results(other_systems: Any) -> None:
    assert len(results(other_systems, "loop", "absence")) < len(results(other_systems, "loop", "keyed"))


@pytest.mark.parametrize("work", ["keyed", "absence", "sliding", "pairs"])
def test_streams_are_reproducible_and_ordered(other_systems: Any, work: str) -> None:
    stream = other_systems.STREAMS[work](EVENTS)
    assert len(stream) == EVENTS
    assert stream == other_systems.STREAMS[work](EVENTS)
    times = [event[2] for event in stream]
    assert times == sorted(times)


@pytest.mark.slow
def test_table_has_row_per_work(
    other_systems: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "results.json"
    small = ["--events", "300", "--runs", "1", "--json", str(file)]
    assert other_systems.main(["--work", "sliding", *small, "--markdown"]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0] == "| work | retalis | loop | message_filters | results |"
    assert table[2].startswith("| `sliding` | ")
    assert " (1.0) | – | " in table[2]
    assert "sliding: without message_filters: message_filters has nothing for sliding" in table
    figures = json.loads(file.read_text())["work"]["sliding"]
    assert figures["retalis"]["results"] == figures["loop"]["results"] > 0
    assert figures["loop"]["us"] > 0


@pytest.mark.parametrize(
    ("outputs", "message"),
    [
        ({"loop": [5], "retalis": [4]}, "^pairs: retalis gives 4 results, the loop 5$"),
        ({"loop": [5, 6], "retalis": [5, 5]}, "^pairs: loop gives another number of results in each run: "),
    ],
)
def test_different_results_end_comparison(
    other_systems: Any, monkeypatch: pytest.MonkeyPatch, outputs: Dict[str, Any], message: str
) -> None:
    remaining = {side: list(numbers) for side, numbers in outputs.items()}

    def run(command: Any, **_: Any) -> Any:
        number = remaining[command[command.index("--side") + 1]].pop(0)
        return subprocess.CompletedProcess(command, 0, json.dumps({"us": 1.0, "results": number}), "")

    monkeypatch.setattr(other_systems.subprocess, "run", run)
    with pytest.raises(SystemExit, match=message):
        other_systems.compare("pairs", {"loop": "python", "retalis": "python"}, 10, len(outputs["loop"]))


def test_failed_run_reports_its_output(other_systems: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = subprocess.CompletedProcess([], 1, "", "it was broken")
    monkeypatch.setattr(other_systems.subprocess, "run", lambda command, **_: failed)
    with pytest.raises(SystemExit, match="--side loop .*failed:\nit was broken"):
        other_systems.compare("pairs", {"loop": "python"}, 10, 1)


def test_unsupported_side_is_omitted(other_systems: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        other_systems.main(["--side", "message_filters", "--work", "keyed", "--events", "10"])
        == other_systems.MISSING
    )
    assert capsys.readouterr().out == "message_filters has nothing for keyed\n"
