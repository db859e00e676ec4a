"""The engine of a robot: restored from any state it continues, and a changed program is refused or loaded."""

import json
from pathlib import Path
from random import Random
from typing import Any, List

import pytest

from retalis.fleet.robot_engine import RELOAD, FleetProgram, Processed, RobotEngine, RobotOutput
from retalis.fleet.robot_events import read_robot_event
from retalis.foundation.errors import ProgramErrors, UsageError

SECOND = 1_000_000_000

GOALS = """\
compile_event_file('rules.txt')
subscribe(alarm(_), [], _, alarms, a)
subscribe(late(_), [], _, alarms, b)
"""
RULES = """\
alarm(X) <- (smoke(X) seq heat(X)) within 60.
late(X) <- smoke(X) seq absent(heat(X), 10).
"""
TOPICS = """\
<publish_subscribe>
  <subscribe_to name="level" msg_type="std_msgs/Int32" event="level"/>
</publish_subscribe>
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "goalPredicates.txt").write_text(GOALS, encoding="utf-8")
    (tmp_path / "rules.txt").write_text(RULES, encoding="utf-8")
    return tmp_path


def line_of(time: float, event: str, **fields: Any) -> str:
    return json.dumps({"robot": "r", "time": time, "event": event, **fields})


def process(robot: RobotEngine, time: float, event: str, watermark: float = -1, **fields: Any) -> Processed:
    return robot.process(read_robot_event(line_of(time, event, **fields)), round(watermark * SECOND))


def texts(outputs: List[RobotOutput]) -> List[str]:
    return [f"{output.number} {output.text}" for output in outputs]


def test_event_has_numbered_outputs(folder: Path) -> None:
    robot = RobotEngine(FleetProgram(folder))
    assert process(robot, 1, "smoke(hall)").outputs == []
    assert process(robot, 2, "heat(hall)").outputs == [RobotOutput(1, "alarms", "alarm(hall)")]


def test_alarm_runs_without_event(folder: Path) -> None:
    robot = RobotEngine(FleetProgram(folder))
    process(robot, 1, "smoke(hall)")
    alarm = robot.next_alarm
    assert alarm is not None
    assert robot.fire_alarms(alarm - 1) == []
    assert texts(robot.fire_alarms(alarm)) == ["1 late(hall)"]
    assert robot.reached == alarm


def test_robot_continues_from_snapshot_and_inputs(folder: Path) -> None:
    program, chance = FleetProgram(folder), Random(3)
    names, times = ["smoke(hall)", "heat(hall)", "smoke(lab)", "heat(lab)"], [t * 0.7 for t in range(200)]
    lines = [line_of(time, chance.choice(names)) for time in times]
    undisturbed = RobotEngine(program)
    expected = [undisturbed.process(read_robot_event(line)).outputs for line in lines]
    robot, inputs = RobotEngine(program), []
    snapshot, outputs = robot.snapshot(), []
    for line in lines:
        outputs.append(robot.process(read_robot_event(line)).outputs)
        inputs.append(line)
        if chance.random() < 0.2:
            snapshot, inputs = robot.snapshot(), []
        if chance.random() < 0.2:
            robot = RobotEngine(program, snapshot, inputs)
    assert outputs == expected


def test_inputs_contain_times_of_alarms(folder: Path) -> None:
    program = FleetProgram(folder)
    robot = RobotEngine(program, RobotEngine(program).snapshot(), [line_of(1, "smoke(hall)"), "20000000000"])
    assert robot.fire_alarms(30 * SECOND) == []
    # The number of the output that was emitted before is not used again.
    process(robot, 31, "smoke(lab)")
    assert texts(process(robot, 32, "heat(lab)").outputs) == ["2 alarm(lab)"]


def test_repeated_events_are_dropped_by_number(folder: Path) -> None:
    robot = RobotEngine(FleetProgram(folder))
    process(robot, 1, "smoke(hall)", id=1, session="a")
    assert process(robot, 2, "heat(hall)", id=2, session="a").outputs
    assert process(robot, 2, "heat(hall)", id=2, session="a").is_repeated
    assert not process(robot, 3, "heat(hall)", id=1, session="b").is_repeated
    assert process(robot, 4, "heat(hall)", id=5, session="b").missing == 3


def test_number_of_sessions_is_limited(folder: Path) -> None:
    robot = RobotEngine(FleetProgram(folder))
    for session in range(9):
        process(robot, 1, "smoke(hall)", id=1, session=str(session))
        process(robot, 1, "smoke(hall)", id=session, session="in use")
    assert process(robot, 1, "smoke(hall)", id=8, session="in use").is_repeated
    assert process(robot, 1, "smoke(hall)", id=1, session="2").is_repeated
    assert not process(robot, 1, "smoke(hall)", id=1, session="1").is_repeated


def test_event_behind_watermark_and_robot_is_late(folder: Path) -> None:
    robot = RobotEngine(FleetProgram(folder))
    process(robot, 10, "smoke(hall)")
    assert process(robot, 9, "heat(hall)", watermark=9).is_late
    # The robot is slow, but none of its alarms has run too early.
    assert process(robot, 11, "heat(hall)", watermark=50).outputs
    # The engine decides about events that are out of order within the lag.
    assert not process(robot, 10.5, "heat(hall)", watermark=10).is_late


def test_failed_event_is_an_error_and_time_passes(folder: Path) -> None:
    robot = RobotEngine(FleetProgram(folder))
    assert process(robot, 5, "smoke(").error.startswith("event:1:7: expected a term")
    assert robot.reached == 5 * SECOND


def test_message_of_subscribed_topic_is_event(folder: Path) -> None:
    (folder / "pub_sub.xml").write_text(TOPICS, encoding="utf-8")
    with open(folder / "rules.txt", "a", encoding="utf-8") as rules:
        rules.write("alarm(high) <- level(Level) where Level > 5.\n")
    robot = RobotEngine(FleetProgram(folder))

    def process_message(**fields: Any) -> Processed:
        return robot.process(read_robot_event(json.dumps({"robot": "r", "time": 1, **fields})))

    assert texts(process_message(topic="/level", message={"data": 7}).outputs) == ["1 alarm(high)"]
    for fields, error in (
        ({"topic": "odom", "message": {}}, "topic 'odom': the program does not subscribe to it"),
        ({"topic": "level", "message": {"level": 7}}, "std_msgs/Int32 has no slot level"),
        ({"topic": "level", "message": {"data": "many"}}, "topic 'level'"),
    ):
        assert error in process_message(**fields).error


def change(folder: Path) -> None:
    (folder / "rules.txt").write_text(RULES.replace("within 60", "within 30"), encoding="utf-8")


def test_changed_program_is_refused(folder: Path) -> None:
    state = RobotEngine(FleetProgram(folder)).snapshot()
    change(folder)
    with pytest.raises(UsageError, match="the program has changed since the state of this robot was stored"):
        RobotEngine(FleetProgram(folder), state)


def test_changed_program_keeps_state_of_unchanged_rules(folder: Path) -> None:
    state = RobotEngine(FleetProgram(folder)).snapshot()
    change(folder)
    program = FleetProgram(folder, on_change=RELOAD)
    robot = RobotEngine(program, state, [line_of(1, "smoke(hall)")])
    assert robot.is_reloaded
    # The stored program has processed the input; rule `late` is unchanged, and `alarm` begins anew.
    assert texts(robot.fire_alarms(20 * SECOND)) == ["1 late(hall)"]
    assert process(robot, 25, "heat(hall)").outputs == []
    assert not RobotEngine(program, robot.snapshot()).is_reloaded


def test_changed_program_with_error_is_refused(folder: Path) -> None:
    (folder / "rules.txt").write_text("alarm(X) <- smoke(X) seq.\n", encoding="utf-8")
    with pytest.raises(ProgramErrors):
        FleetProgram(folder, on_change=RELOAD)


def test_program_of_another_folder_is_not_reloaded(folder: Path, tmp_path: Path) -> None:
    state = RobotEngine(FleetProgram(folder)).snapshot()
    copied = tmp_path / "copy"
    copied.mkdir()
    (copied / "goalPredicates.txt").write_text(GOALS, encoding="utf-8")
    (copied / "rules.txt").write_text(RULES, encoding="utf-8")
    # The same program may be anywhere.
    assert not RobotEngine(FleetProgram(copied), state).is_reloaded
    change(copied)
    with pytest.raises(UsageError, match="the stored program was loaded from .*: expected the same folder"):
        RobotEngine(FleetProgram(copied, on_change=RELOAD), state)


def test_unknown_choice_is_refused(folder: Path) -> None:
    with pytest.raises(UsageError, match="on_change: expected refuse or reload, found 'ignore'"):
        FleetProgram(folder, on_change="ignore")


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        (b"", "state of a robot: it is damaged"),
        (b'{"format": 9}\n', "state of a robot: format 9 is unknown: expected 1"),
        (b"[]\n", "state of a robot: it is damaged"),
    ],
)
def test_invalid_state_is_refused(folder: Path, state: bytes, reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        RobotEngine(FleetProgram(folder), state)
