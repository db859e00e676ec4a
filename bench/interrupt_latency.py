#!/usr/bin/env python3
"""Response to Ctrl-C: seconds from SIGINT to the end of a command that is busy, or waits.

    bench/interrupt_latency.py [--case NAME ...] [--runs N]

Each case starts a command, waits until it has printed ``started``, sends SIGINT and waits for the end of the process.
Prints the shortest and the longest time, and the exit status, which is 130.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Dict, List, NamedTuple, Tuple

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "src")]

from arguments import positive  # noqa: E402

from retalis import BagWriter, Definitions  # noqa: E402

STARTED = "started"
MESSAGES = 300_000
"""Number of messages in the bag: more than a second of work."""

RULES = 15_000
"""Number of rules in the file that is loaded."""

STREAMS = {
    "goal": "event(go, [1,1]).\n",
    "join": "".join(f"event({'ab'[n > 600]}({n}), [{n},{n}]).\n" for n in range(1, 1200))
    + "event(go, [1200,1200]).\n",
    "many": "event(begin, [1,1]).\n" + "".join(f"event(tick, [{n},{n}]).\n" for n in range(2, 300_000)),
}


class Case(NamedTuple):
    """A command, and a part of a goal that it calls after it has printed ``started``."""

    command: str
    goal: str = "true"
    stream: str = ""


LOOPS = {
    "goal": "repeat, fail",
    "findall": "findall(X, between(1, inf, X), _)",
    "aggregation": "aggregate_all(count, between(1, inf, _), _)",
    "sort": "numlist(1, 400000, L), repeat, sort(0, @>=, L, _), fail",
    "output": "repeat, writeln(text), fail",
}

CASES: Dict[str, Case] = {
    **{
        f"console_{name}": Case("console --goal", f"writeln({STARTED}), {goal}")
        for name, goal in LOOPS.items()
    },
    "console_input": Case("console", f"writeln({STARTED})."),
    **{f"events_{name}": Case("events", goal, "goal") for name, goal in LOOPS.items()},
    "events_input": Case("events --stream -", "true", "goal"),
    "events_join": Case("events", "true", "join"),
    "events_many": Case("events", "true", "many"),
    "events_loading": Case("events --loading", "true", "goal"),
    **{f"bag_{name}": Case("bag", goal) for name, goal in LOOPS.items()},
    "bag_without_match": Case("bag", "true"),
    "plot_goal": Case("plot -o run.html", "repeat, fail"),
    "plot_bag": Case("plot -o run.html", "true"),
}


def make_files(folder: Path) -> None:
    """Write the bag and the file with many rules."""
    definition = Definitions().find("std_msgs/Int32")
    with BagWriter(folder / "some.bag") as bag:
        connection = bag.add("/in", definition)
        for number in range(MESSAGES):
            bag.write(connection, 10**9 + 1000 * number, number.to_bytes(4, "little"))
    (folder / "many.txt").write_text("".join(f"out{n}(X) <- in{n}(X) where X > {n}.\n" for n in range(RULES)))


def prepare(case: Case, folder: Path) -> Tuple[List[str], str]:
    """Write the program of a case; return the arguments of its command and its standard input."""
    command, *options = case.command.split()
    say = f"writeln({STARTED}), flush_output"
    if command == "console":
        return [command, *options, *([case.goal] if options else [])], "" if options else f"{case.goal}\n"
    if command == "events":
        rules = f"done <- go where ({say}, {case.goal}).\n:- {say}.\n"
        if case.stream == "join":
            # The matching of the last event takes longer than everything before.
            rules = (
                ":- set_etalis_flag(event_consumption_policy, unrestricted).\n"
                f"null do ({say}) <- go.\n"
                "pair(X, Y) <- (a(X) seq b(Y)) seq go where X > Y.\n"
            )
        if case.stream == "many":
            rules = f"done <- begin where ({say}).\n"
        (folder / "rules.txt").write_text(rules)
        (folder / "stream.txt").write_text(STREAMS[case.stream])
        if "--stream" in options:
            return [command, "--rules", "rules.txt", *options], STREAMS[case.stream]
        if "--loading" in options:
            (folder / "goals.txt").write_text(f"{say}.\n")
            return [command, "--goals", "goals.txt", "--rules", "many.txt"], ""
        return [command, "--rules", "rules.txt", "--stream", "stream.txt"], ""
    program = folder / "program"
    program.mkdir(exist_ok=True)
    (program / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="in" msg_type="std_msgs/Int32"/></publish_subscribe>'
    )
    # In a bag without matches, the program prints while it is loaded, and is interrupted soon afterwards.
    (program / "goalPredicates.txt").write_text(
        f"{say}.\n" if case.goal == "true" else "compile_event_file('rules.txt').\n"
    )
    (program / "rules.txt").write_text(f"null do ({say}, {case.goal}) <- std_msgs__0__Int32(0).\n")
    return [command, "some.bag", "--program", "program", *options], ""


def measure(case: Case, folder: Path) -> Tuple[float, int, str]:
    """Return seconds from the signal to the end, the exit status, and what was written to standard error."""
    arguments, text = prepare(case, folder)
    # Users do not set PYTHONUNBUFFERED. Packages such as rosbags may be in a folder that only PYTHONPATH names.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT / "src"), environment.get("PYTHONPATH", "")])
    command = subprocess.Popen(
        [sys.executable, "-m", "retalis", *arguments],
        cwd=folder,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell that has started this script in the background lets it ignore the signal.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert command.stdin is not None
    assert command.stdout is not None
    assert command.stderr is not None
    with command:
        try:
            command.stdin.write(text)
            command.stdin.flush()
            for line in command.stdout:
                if STARTED in line:
                    break
            # The output is not read any more: a command that writes much waits for it.
            time.sleep(0.3)
            sent = time.monotonic()
            command.send_signal(signal.SIGINT)
            command.wait(60)
            return time.monotonic() - sent, command.returncode, command.stderr.read()
        finally:
            command.kill()


def main() -> int:
    """Measure the cases of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--runs", type=positive, default=3)
    options = parser.parse_args()
    statuses = set()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_files(folder)
        for name in options.case:
            runs = [measure(CASES[name], folder) for _ in range(options.runs)]
            times = [seconds for seconds, _, _ in runs]
            statuses |= {status for _, status, _ in runs}
            print(
                f"{name:22} {min(times):6.3f} to {max(times):6.3f} s, status {runs[-1][1]}"
                f"{' ' + runs[-1][2].strip()[-300:] if runs[-1][2] else ''}",
                flush=True,
            )
    return 0 if statuses == {130} else 1


if __name__ == "__main__":
    sys.exit(main())
