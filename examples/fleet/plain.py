#!/usr/bin/env python3
"""The same fleet without a stream processor, for comparison: a dictionary of robots, and a loop over the input."""

import json
import sys
from pathlib import Path

from retalis.fleet.robot_engine import FleetProgram, RobotEngine
from retalis.fleet.robot_events import read_robot_event


def show(robot, outputs):
    for number, topic, text in outputs:
        print(json.dumps({"robot": robot, "number": number, "topic": topic, "output": text}))


def main(flush_seconds=600):
    program, robots = FleetProgram(Path(__file__).resolve().parent), {}
    for line in sys.stdin:
        event = read_robot_event(line)
        if event.robot not in robots:
            robots[event.robot] = RobotEngine(program)
        show(event.robot, robots[event.robot].process(event).outputs)
    for name, robot in robots.items():
        show(name, robot.fire_alarms(robot.reached + flush_seconds * 1_000_000_000))


if __name__ == "__main__":
    main()
