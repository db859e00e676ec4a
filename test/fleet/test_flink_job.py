"""Functions of the job with states and timers of this module in place of those of Flink."""

import json
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

import pytest

pytest.importorskip("pyflink", reason="Apache Flink is not installed: it takes 0.9 GB")

from pyflink.datastream import TimeDomain

from retalis.fleet import flink_job
from retalis.fleet.flink_job import FAILED, LATE, MAX_WATERMARK, CheckLines, Options, Robots
from retalis.fleet.robot_engine import RobotEngine

GOALS = "compile_event_file('rules.txt')\nsubscribe(late(_), [], _, alarms, a)\n"
RULES = "late(X) <- smoke(X) seq absent(heat(X), 10).\n"
DAY = 86_400_000


class Store:
    """State of one robot, and the context of its function."""

    def __init__(self) -> None:
        self.values: Dict[str, Any] = {}
        self.timers: List[Tuple[TimeDomain, int]] = []
        self.counts: Dict[str, int] = {}
        self.watermark: Optional[int] = None
        self.now = 0
        self.domain = TimeDomain.EVENT_TIME

    # The interface of a runtime context.

    def get_state(self, descriptor: Any) -> Any:
        return Value(self.values, descriptor.name)

    get_list_state = get_state

    def get_metrics_group(self) -> Any:
        return self

    def counter(self, name: str) -> Any:
        return Counter(self.counts, name)

    # The interface of the context of an element or timer, and of the timers.

    def timer_service(self) -> Any:
        return self

    def get_current_key(self) -> str:
        return "r"

    def time_domain(self) -> TimeDomain:
        return self.domain

    def current_watermark(self) -> Optional[int]:
        return self.watermark

    def current_processing_time(self) -> int:
        return self.now

    def register_event_time_timer(self, time: int) -> None:
        self.timers.append((TimeDomain.EVENT_TIME, time))

    def register_processing_time_timer(self, time: int) -> None:
        self.timers.append((TimeDomain.PROCESSING_TIME, time))


class Value:
    def __init__(self, values: Dict[str, Any], name: str):
        self._values, self._name = values, name

    def value(self) -> Any:
        return self._values.get(self._name)

    def update(self, value: Any) -> None:
        self._values[self._name] = value

    def get(self) -> Any:
        return self._values.get(self._name, [])

    def add(self, value: Any) -> None:
        self._values.setdefault(self._name, []).append(value)

    def clear(self) -> None:
        self._values.pop(self._name, None)


class Counter:
    def __init__(self, counts: Dict[str, int], name: str):
        self._counts, self._name = counts, name

    def inc(self, number: int = 1) -> None:
        self._counts[self._name] = self._counts.get(self._name, 0) + number


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "goalPredicates.txt").write_text(GOALS, encoding="utf-8")
    (tmp_path / "rules.txt").write_text(RULES, encoding="utf-8")
    return tmp_path


def open_robots(folder: Path, store: Store, **options: Any) -> Robots:
    """Return the function in a new process, with a stored state."""
    robots = Robots(str(folder), Options(**options))
    robots.open(store)
    return robots


def process(robots: Robots, store: Store, time: float, event: str) -> List[Any]:
    line = json.dumps({"robot": "r", "time": time, "event": event})
    return list(robots.process_element(("r", round(time * 1000), line), store))


def fire(robots: Robots, store: Store, time: int) -> List[Any]:
    return list(robots.on_timer(time, store))


def alarms(store: Store) -> List[int]:
    return [time for domain, time in store.timers if domain is TimeDomain.EVENT_TIME]


def test_alarm_of_engine_is_timer(folder: Path) -> None:
    store = Store()
    robots = open_robots(folder, store)
    assert process(robots, store, 1.0005, "smoke(hall)") == []
    (timer,) = alarms(store)
    assert timer == 11_001
    (output,) = fire(robots, store, timer)
    assert json.loads(output)["output"] == "late(hall)"


def test_new_process_sets_timer_of_silent_robot(folder: Path) -> None:
    store = Store()
    process(open_robots(folder, store), store, 1, "smoke(hall)")
    expected = list(store.timers)
    store.timers.clear()
    robots = open_robots(folder, store)
    assert list(robots.process_element(("r", 0, ""), store)) == []
    assert sorted(store.timers, key=str) == sorted(expected, key=str)
    # Without its engine, as a restored fleet may have thousands of robots.
    assert "restored" not in store.counts
    assert len(fire(robots, store, 11_000)) == 1
    store.timers.clear()
    assert list(robots.process_element(("r", 0, ""), store)) == []
    assert alarms(store) == []


def test_late_event_is_in_own_stream(folder: Path) -> None:
    store = Store()
    robots = open_robots(folder, store)
    process(robots, store, 1, "smoke(hall)")
    store.watermark = 11_000
    fire(robots, store, 11_000)
    ((tag, line),) = process(robots, store, 5, "heat(hall)")
    assert tag is LATE
    assert json.loads(line)["robot"] == "r"
    assert store.counts["late"] == 1


def test_inputs_are_replaced_by_snapshots(folder: Path) -> None:
    store = Store()
    robots = open_robots(folder, store, snapshot_every=3)
    counts = []
    for second in range(1, 7):
        process(robots, store, second, "heat(hall)")
        counts.append(len(store.values.get("inputs", [])))
    assert counts == [1, 2, 0, 1, 2, 0]


def test_unexpected_error_restores_robot(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store()
    robots = open_robots(folder, store)
    process(robots, store, 1, "smoke(hall)")

    def fail(*arguments: Any) -> None:
        raise MemoryError("no space")

    with monkeypatch.context() as patched:
        patched.setattr(RobotEngine, "process", fail)
        ((tag, line),) = process(robots, store, 2, "heat(hall)")
    assert tag is FAILED
    assert json.loads(line)["reason"] == "MemoryError: no space"
    assert len(fire(robots, store, 11_000)) == 1


def test_end_of_input_runs_alarms_for_limited_time(folder: Path) -> None:
    store = Store()
    robots = open_robots(folder, store, flush=5)
    process(robots, store, 1, "smoke(hall)")
    store.watermark = MAX_WATERMARK
    assert fire(robots, store, 11_000) == []
    assert len(alarms(store)) == 1


def test_silent_robot_is_forgotten(folder: Path) -> None:
    store = Store()
    robots = open_robots(folder, store, forget_after=86_400)
    process(robots, store, 1, "smoke(hall)")
    store.domain = TimeDomain.PROCESSING_TIME
    store.now = DAY // 2
    process(robots, store, 2, "smoke(hall)")
    store.now = DAY
    fire(robots, store, DAY)
    assert "snapshot" in store.values
    store.now = DAY + DAY // 2
    fire(robots, store, store.now)
    assert store.values == {}
    assert store.counts["forgotten"] == 1
    # A timer of an alarm that is left does not create the robot again.
    store.domain = TimeDomain.EVENT_TIME
    assert fire(robots, store, 11_000) == []
    assert store.values == {}


def test_number_of_engines_is_limited(folder: Path) -> None:
    store = Store()
    robots = open_robots(folder, store, max_engines=1)
    process(robots, store, 1, "smoke(hall)")
    list(robots.process_element(("q", 2000, '{"robot": "q", "time": 2}'), store))
    process(robots, store, 3, "heat(hall)")
    # Both robots have the same store here.
    assert store.counts["restored"] == 2


def check(lines: CheckLines, store: Store, robot: str, time: int = 1) -> List[Any]:
    return list(lines.process_element(json.dumps({"robot": robot, "time": time}), store))


def open_lines(store: Store, **options: Any) -> CheckLines:
    """Return the function in a new process, with a stored state."""
    lines = CheckLines(Options(**options))
    lines.open(store)
    return lines


def test_time_far_ahead_is_refused() -> None:
    store = Store()
    lines = open_lines(store, latest=100)
    assert check(lines, store, "r", 100) == [("r", 100_000, '{"robot": "r", "time": 100}')]
    ((tag, _),) = check(lines, store, "r", 101)
    assert tag is FAILED


def test_first_line_after_restore_is_after_recent_robots() -> None:
    store = Store()
    lines = open_lines(store)
    for robot in ("a", "b", "a"):
        assert len(check(lines, store, robot)) == 1
    elements = check(open_lines(store), store, "c")
    assert elements[:2] == [("a", 0, ""), ("b", 0, "")]
    assert elements[2][0] == "c"


def test_end_of_input_after_restore_has_recent_robots() -> None:
    store = Store()
    lines = open_lines(store)
    check(lines, store, "a")
    assert alarms(store) == [MAX_WATERMARK]
    assert list(lines.on_timer(MAX_WATERMARK, store)) == []
    assert list(open_lines(store).on_timer(MAX_WATERMARK, store)) == [("a", 0, "")]


def test_number_of_recent_robots_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flink_job, "RECENT_LINES", 2)
    store = Store()
    lines = open_lines(store)
    for number in range(5):
        check(lines, store, f"r{number}")
    assert list(open_lines(store).on_timer(MAX_WATERMARK, store)) == [
        ("r2", 0, ""),
        ("r3", 0, ""),
        ("r4", 0, ""),
    ]


def test_robots_do_not_accumulate_in_restarts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flink_job, "RECENT_LINES", 2)
    store = Store()
    for number in range(7):
        check(open_lines(store), store, f"r{number}")
    robots = [element[0] for element in check(open_lines(store), store, "r7")]
    assert robots == ["r4", "r5", "r6", "r7"]
