"""``examples/localization_faults``: each fault has an alarm in its recording, and no other recording has one.

The recordings are written by the script of the example, as bags of ROS 2 and of ROS 1.
"""

import logging
import re
import shutil
import struct
from pathlib import Path
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Tuple

import pytest

pytest.importorskip("rosbags")
pytest.importorskip("numpy")
from rosbags import rosbag2  # noqa: E402
from script_modules import load_script  # noqa: E402

from retalis import Playback, to_python  # noqa: E402
from retalis.cli.command_line import main  # noqa: E402
from retalis.playback.bag_locations import MergedBag  # noqa: E402

PROGRAM = Path(__file__).resolve().parents[2] / "examples" / "localization_faults"
PAGE = (PROGRAM / "README.md").read_text(encoding="utf-8")
RULES = (PROGRAM / "eventRules.txt").read_text(encoding="utf-8")
ROS2 = "mcap" if hasattr(rosbag2, "StoragePlugin") else "db3"
"""Format of the bags of ROS 2: old versions of rosbags write databases only."""

SECOND = 10**9
ERROR = 2


class Fault(NamedTuple):
    """The expected alarm of a recording, in seconds since its start.

    Attributes:
        status: name of the status on ``/diagnostics``, without its prefix.
        first: time from which on the check has enough measurements with the fault.
        last: time of the latest message in which the alarm must be.
        end: time of the latest message in which it must be OK again, if the fault ends.
    """

    status: str
    first: float
    last: float
    end: Optional[float] = None


FAULTS = {
    "gps_rejected": Fault("gps gate", first=30, last=42, end=78),
    "backwards": Fault("position", first=8, last=12),
    "small_innovations": Fault("wheel innovations", first=8, last=15),
    "gyro_sign": Fault("gyroscope", first=28, last=33),
    "idle_gate": Fault("gps gate margin", first=8, last=50),
    "transforms_stopped": Fault("transforms", first=45, last=48, end=77),
    "filter_died": Fault("filter", first=45, last=49, end=77),
    "filter_late": Fault("delay", first=40, last=46, end=76),
}
EACH_PUSH = ("gps_rejected", "small_innovations", "filter_died")
"""Cases whose harmless recordings are played with each push: a condition of the rules keeps each of them silent."""

CHECKS = 11
"""Number of checks of the program; each gate counts."""


@pytest.fixture(scope="module")
def script() -> Any:
    """Return the script that writes the recordings."""
    return load_script(PROGRAM / "make_recordings.py", "localization_recordings")


class Run(NamedTuple):
    """Outputs of a program for a recording.

    Attributes:
        messages: time in seconds, and the statuses by name, of each message on ``/diagnostics``.
        changes: the events of alarms, as text.
    """

    messages: List[Tuple[float, Dict[str, Any]]]
    changes: List[str]

    def alarms(self) -> Dict[str, List[float]]:
        """Return the times of the messages with each alarm."""
        times: Dict[str, List[float]] = {}
        for time, statuses in self.messages:
            for name, status in statuses.items():
                if status.args[0] == ERROR:
                    times.setdefault(name, []).append(time)
        return times

    def raised_event(self) -> str:
        """Return the only event of an alarm that begins, as text."""
        (raised,) = [change for change in self.changes if change.startswith("raised")]
        return raised


def play(script: Any, path: Any, caplog: pytest.LogCaptureFixture, program: Any = PROGRAM) -> Run:
    """Play a recording. Nothing may be reported."""
    problems: List[Any] = []
    changes: List[str] = []
    messages: List[Tuple[float, Dict[str, Any]]] = []
    with MergedBag([path]) as bag, caplog.at_level(logging.WARNING):
        playback = Playback(program, problems.append, bag=bag)

        def collect_change(term: Any, start: int, end: int) -> None:
            if term.__class__ is tuple and term[0].name in ("raised", "cleared"):
                changes.append(playback.engine.show(term))

        playback.engine.on_event(collect_change)
        for output in playback.run(bag):
            assert output.topic == "/diagnostics"
            assert output.data
            _, statuses = to_python(output.term).args
            names = {status.args[1].strip('"').partition(": ")[2]: status for status in statuses}
            messages.append((output.time / SECOND - script.START, names))
    assert (problems, caplog.messages) == ([], [])
    return Run(messages, changes)


def write(script: Any, folder: Any, case: str, faulty: bool, bag_format: str = ROS2) -> Any:
    """Write a recording of a case; return its path."""
    path = folder / ("recording.bag" if bag_format == "bag" else "recording")
    script.write_recording(path, list(script.Robot(case, faulty, 1).messages()), bag_format)
    return path


@pytest.fixture(scope="module")
def fault_runs() -> Dict[Tuple[str, str], Run]:
    """Return the runs of recordings with a fault by case and format; each is played once."""
    return {}


@pytest.fixture
def play_fault(
    fault_runs: Dict[Tuple[str, str], Run], script: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> Callable[..., Run]:
    """Return a function that plays the recording of a fault."""

    def play_fault(case: str, bag_format: str = ROS2) -> Run:
        if (case, bag_format) not in fault_runs:
            path = write(script, tmp_path, case, True, bag_format)
            fault_runs[case, bag_format] = play(script, path, caplog)
        return fault_runs[case, bag_format]

    return play_fault


def test_faults_are_those_of_script(script: Any) -> None:
    assert tuple(FAULTS) == script.CASES


def test_program_has_no_findings() -> None:
    assert main(["check", "--strict", str(PROGRAM)]) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "bag_format"),
    [
        *((case, ROS2) for case in FAULTS),
        # Bags of ROS 1 have the same messages; one of them shows it with each push.
        ("gyro_sign", "bag"),
        *(pytest.param(case, "bag", marks=pytest.mark.nightly) for case in FAULTS if case != "gyro_sign"),
    ],
)
def test_fault_has_its_alarm_only(case: str, bag_format: str, play_fault: Any, script: Any) -> None:
    run = play_fault(case, bag_format)
    fault = FAULTS[case]
    alarms = run.alarms()
    assert list(alarms) == [fault.status]
    times = alarms[fault.status]
    assert fault.first < times[0] <= fault.last
    # The alarm is in each message from the first one on, until the fault ends.
    assert [round(late - early) for early, late in zip(times, times[1:])] == [1] * (len(times) - 1)
    assert times[-1] < fault.end if fault.end else times[-1] == run.messages[-1][0]
    raised = run.raised_event()
    check = raised[len("raised(") : raised.rindex(",")]
    later = run.changes[run.changes.index(raised) :]
    assert later.count(f"cleared({check})") == bool(fault.end)
    check_messages(run, script.DURATION)


@pytest.mark.slow
@pytest.mark.parametrize("case", FAULTS)
def test_page_has_row_of_fault(case: str, play_fault: Any) -> None:
    run = play_fault(case)
    fault = FAULTS[case]
    times = run.alarms()[fault.status]
    status = dict(run.messages)[times[0]][fault.status]
    measure, value = (text.strip('"') for text in status.args[4][0].args)
    begin, first, last = (f"{time:.0f} s" for time in (fault.first, times[0], times[-1]))
    row = f"| `{case}` | {begin} | `localization: {fault.status}` | {measure}: {value} | {first} | {last} |"
    assert row in PAGE.splitlines()


@pytest.mark.slow
def test_page_has_event_of_alarm(play_fault: Any) -> None:
    assert f"event({play_fault('gyro_sign').raised_event()},[" in PAGE


def check_messages(run: Run, duration: float) -> None:
    """Check that each second has at most one message, and that a check that has not counted has no status."""
    times = [time for time, _ in run.messages]
    assert len(times) <= duration
    assert all(late - early > 0.99 for early, late in zip(times, times[1:]))
    # The robot has not turned in the first 28 s.
    assert [time for time, statuses in run.messages if "gyroscope" in statuses][0] > 28


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "bag_format"),
    [
        *(
            pytest.param(case, ROS2, marks=() if case in EACH_PUSH else pytest.mark.nightly)
            for case in FAULTS
        ),
        pytest.param("gps_rejected", "bag", marks=pytest.mark.nightly),
        pytest.param("gyro_sign", "db3", marks=pytest.mark.nightly),
    ],
)
def test_healthy_recording_has_no_alarm(
    case: str, bag_format: str, script: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run = play(script, write(script, tmp_path, case, False, bag_format), caplog)
    assert run.alarms() == {}
    assert [change for change in run.changes if change.startswith("raised")] == []
    # Each check has counted, except that of a margin between both limits.
    expected = CHECKS - (case == "idle_gate")
    assert len(run.messages[-1][1]) == expected


CONDITIONS = [
    # case, whether it is faulty, text of the rules, text without the condition, alarm that is then wrong
    ("small_innovations", False, "nis(Gate, N) where holds(moving).", "nis(Gate, N).", "wheel innovations"),
    ("gps_rejected", False, "holds(has_fix, Since), Now - Since >= Seconds.", "Now > Seconds.", "gps gate"),
    ("filter_died", True, "recent(last_odometry, E, 0.5)", "recent(last_odometry, E, 10)", "transforms"),
    ("filter_died", False, "recent(last_imu, E, 0.5)", "recent(last_imu, E, 10)", "filter"),
]


@pytest.mark.nightly
@pytest.mark.parametrize(("case", "faulty", "condition", "replacement", "status"), CONDITIONS)
def test_check_without_its_condition_has_wrong_alarms(
    case: str,
    faulty: bool,
    condition: str,
    replacement: str,
    status: str,
    script: Any,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    program = tmp_path / "program"
    shutil.copytree(PROGRAM, program, ignore=shutil.ignore_patterns("__pycache__", "*.bag"))
    assert RULES.count(condition) == 1
    rules = RULES.replace(condition, replacement)
    if case == "gps_rejected":
        rules = rules.replace("gps_nis{data: N} where holds(has_fix).", "gps_nis{data: N}.")
    (program / "eventRules.txt").write_text(rules, encoding="utf-8")
    alarms = play(script, write(script, tmp_path, case, faulty), caplog, program).alarms()
    assert status in alarms


def test_failed_recording_leaves_no_file(
    script: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages = list(script.Robot("backwards", True, 1).messages())[:9]
    monkeypatch.setitem(script.TOPICS, "/tf", "std_msgs/msg/Float64")
    messages.append(script.Message(1.0, "/tf", {"data": "text"}))
    with pytest.raises(struct.error, match="required argument is not a float"):
        script.write_recording(tmp_path / "recording.bag", messages, "bag")
    assert list(tmp_path.iterdir()) == []


def test_existing_recording_is_not_replaced(
    script: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(script, "DURATION", 1.0)
    arguments = ["make_recordings.py", str(tmp_path / "new"), "--case", "gyro_sign", "--format", "bag"]
    monkeypatch.setattr("sys.argv", arguments)
    assert script.main() == 0
    paths = [tmp_path / "new" / f"gyro_sign_{kind}.bag" for kind in ("fault", "healthy")]
    assert capsys.readouterr().out.splitlines() == list(map(str, paths))
    assert sorted((tmp_path / "new").iterdir()) == paths
    content = paths[0].read_bytes()
    assert script.main() == 1
    assert re.search(r"gyro_sign_fault\.bag: it exists already", capsys.readouterr().err)
    assert paths[0].read_bytes() == content


def test_same_seed_gives_same_messages(script: Any) -> None:
    first, second = (list(script.Robot("backwards", True, 3).messages()) for _ in range(2))
    assert first == second
    assert {message.topic for message in first} == set(script.TOPICS)
    times = [message.time for message in first]
    assert times == sorted(times)
