#!/usr/bin/env python3
"""Cost of a fleet: the engines in a loop, their states, and the same events in Apache Flink on this machine.

    bench/fleet.py [--robots N] [--seconds N] [--snapshot-every N ...]

The figures of Flink are for one worker of the robots; its processor time includes that of Java. The start of the job
is measured with a file of one event and subtracted.
"""

import argparse
import importlib.util
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, List, Tuple

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = ROOT / "examples" / "fleet"

EVENTS_PER_SECOND = 10
"""Rate of a robot for the number of robots that one core carries."""

JOB = """
import sys
from retalis.fleet.flink_job import Options, create_environment, read_file, run_robots, write_files

events, folder, program, every = sys.argv[1:]
options = Options(snapshot_every=int(every))
environment = create_environment(folder + "/checkpoints", interval=5)
environment.set_parallelism(1)
streams = run_robots(read_file(environment, events, options), program, options)
write_files(streams.outputs, folder + "/outputs", "outputs")
environment.execute("bench")
"""


def make_lines(robots: int, seconds: int) -> List[str]:
    spec = importlib.util.spec_from_file_location("make_events", PROGRAM / "make_events.py")
    module: Any = importlib.util.module_from_spec(spec)  # type: ignore[arg-type]
    spec.loader.exec_module(module)  # type: ignore[union-attr]
    return [json.dumps(event) for event in module.events(robots, seconds)]


def measure_loop(lines: List[str]) -> None:
    """Print the time of an event in a loop, and the costs of states."""
    from retalis.fleet.robot_engine import FleetProgram, RobotEngine
    from retalis.fleet.robot_events import read_robot_event

    program, robots = FleetProgram(PROGRAM), {}
    names = {read_robot_event(line).robot for line in lines}
    start = time.process_time()
    for name in names:
        robots[name] = RobotEngine(program)
    print(f"loop: {1e3 * (time.process_time() - start) / len(names):.1f} ms to create a robot")
    start = time.process_time()
    for line in lines:
        event = read_robot_event(line)
        robots[event.robot].process(event)
    microseconds = 1e6 * (time.process_time() - start) / len(lines)
    print(
        f"loop: {microseconds:.0f} us per event, {1e6 / microseconds / EVENTS_PER_SECOND:.0f} robots per core"
    )
    start = time.process_time()
    states = [robot.snapshot() for robot in robots.values()]
    milliseconds = 1e3 * (time.process_time() - start) / len(states)
    size = sum(map(len, states)) / len(states)
    print(f"state: {size:,.0f} bytes, {milliseconds:.1f} ms to store")
    start = time.process_time()
    for state in states:
        RobotEngine(program, state)
    print(f"state: {1e3 * (time.process_time() - start) / len(states):.1f} ms to restore")


def run_job(lines: List[str], every: int) -> Tuple[float, float]:
    """Return the wall time and the processor time of a job in seconds."""
    with tempfile.TemporaryDirectory() as folder:
        events = Path(folder) / "events.jsonl"
        events.write_text("".join(line + "\n" for line in lines), encoding="utf-8")
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        command = [sys.executable, "-c", JOB, str(events), folder, str(PROGRAM), str(every)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        wall = time.monotonic() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--snapshot-every", type=int, nargs="+", default=[100])
    options = parser.parse_args()
    lines = make_lines(options.robots, options.seconds)
    print(f"{len(lines):,} events of {options.robots} robots")
    measure_loop(lines)
    # With all robots, as creating them is not a cost of events.
    first = {json.loads(line)["robot"]: line for line in reversed(lines)}
    for every in options.snapshot_every:
        idle_wall, idle_cpu = run_job(list(first.values()), every)
        wall, cpu = run_job(lines, every)
        count = len(lines) - len(first)
        wall_us, cpu_us = 1e6 * (wall - idle_wall) / count, 1e6 * (cpu - idle_cpu) / count
        print(
            f"Flink, a snapshot every {every} events: {wall_us:.0f} us per event, {cpu_us:.0f} us of processor time, "
            f"{1e6 / cpu_us / EVENTS_PER_SECOND:.0f} robots per core; start of the job {idle_wall:.0f} s"
        )


if __name__ == "__main__":
    main()
