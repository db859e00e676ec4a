#!/usr/bin/env python3
"""Cost of snapshots and checkpoints, and loss of events when the process is killed.

    bench/checkpoint.py [--kills N] [--seconds N]

Prints the cost of checkpoints while the NAO's program processes 1,900 messages per second with full memories. Then a
process that writes checkpoints under full load is killed N times at random moments. The loss is the time between the
restored checkpoint and the kill; the restored state has to be consistent each time. ``bench/snapshots.py`` measures
the time and size of snapshots.
"""

import argparse
import itertools
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import List

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src"), str(ROOT / "test" / "engine")]

from killed_checkpoint_process import GOALS, RULES  # noqa: E402

from retalis import Clock, Engine, Reports  # noqa: E402
from retalis.engine.checkpoints import Checkpointer, CheckpointStorage  # noqa: E402

JOINTS = (
    ("/odom", "/base_link"),
    ("base_link", "torso"),
    ("torso", "Neck"),
    ("Neck", "Head"),
    ("Head", "CameraTop_frame"),
)
VICTIM = ROOT / "test" / "engine" / "killed_checkpoint_process.py"


def keep_while_running(seconds: float) -> None:
    """Print the cost of two checkpoints per second of the NAO's program, and how long they block the engine."""
    program = ROOT / "application_source"
    engine = Engine(Clock())
    engine.load_program(program)
    with tempfile.TemporaryDirectory() as folder:
        checkpointer = Checkpointer(
            engine, CheckpointStorage(Path(folder) / "state.db"), program, Reports(), 0.5
        )
        instants = itertools.count()

        def take(messages: int) -> None:
            for _, (parent, child) in zip(range(messages), itertools.cycle(JOINTS)):
                engine.post_text(f"event({message(parent, child, next(instants))})")

        take(5 * 2500)
        checkpointer.write()
        costs, pauses = [], []
        for _ in range(max(1, round(2 * seconds))):
            take(950)
            checkpointer.longest_pause_seconds = 0.0
            begin = time.process_time()
            checkpointer.write()
            costs.append(time.process_time() - begin)
            pauses.append(checkpointer.longest_pause_seconds)
    print(
        f"1,900 messages a second: {200 * statistics.mean(costs):.1f} % of a core, "
        f"blocked for {1e3 * statistics.median(pauses):.1f} ms (median), {1e3 * max(pauses):.1f} ms at most"
    )


def message(parent: str, child: str, number: int) -> str:
    """Return the text of a message with one transform."""
    stamp = f"[{1000 + number // 1000},{number % 1000 * 1_000_000}]"
    place, turn = "geometry_msgs__0__Vector3(0.1,0.2,0.3)", "geometry_msgs__0__Quaternion(0.0,0.0,0.0,1.0)"
    head = f"std_msgs__0__Header(0,{stamp},'\"{parent}\"')"
    move = f"geometry_msgs__0__Transform({place},{turn})"
    return f"tf__0__tfMessage([geometry_msgs__0__TransformStamped({head},'\"{child}\"',{move})])"


def kill_and_go_on(kills: int) -> None:
    """Kill a process repeatedly; print the loss of each time."""
    chance = random.Random()
    lost: List[float] = []
    killed = 0.0
    started: List[float] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "goalPredicates.txt").write_text(GOALS)
        (folder / "r.txt").write_text(RULES)
        done: List[List[float]] = []
        for at in range(kills + 1):
            begin = time.time()
            command = [sys.executable, str(VICTIM), str(folder), "0.5"]
            process = subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                text=True,
                env={
                    **os.environ,
                    "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]),
                },
            )
            assert process.stdout is not None
            if at:
                counter, kept, added, last = map(int, process.stdout.readline().split())
                assert counter == added == last and kept == min(500, last), "a torn state"
                assert process.stdout.readline() == "True True\n", "a torn state"
                started.append(time.time() - begin)
                missed = [when for number, when in done if number > last]
                lost.append(max(0.0, killed - min(missed)) if missed else 0.0)
            assert process.stdout.readline() == "ready\n"
            end = time.time() + chance.uniform(0.3, 3.0)
            done = []
            for line in process.stdout:
                number, when = line.split()
                done.append([int(number), float(when)])
                if float(when) > end:
                    break
            process.kill()
            killed = time.time()
            process.wait()
            process.stdout.close()
    print(
        f"{kills} kills: lost {statistics.median(lost):.2f} s in the middle, {max(lost):.2f} s at most; "
        f"what was taken up was of one moment each time; a start took {statistics.median(started):.2f} s"
    )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    if options.seconds:
        keep_while_running(options.seconds)
    if options.kills:
        kill_and_go_on(options.kills)


if __name__ == "__main__":
    main()
