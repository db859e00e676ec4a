#!/usr/bin/env python3
"""Playback of many bags: speed-up by workers, and equality of the results if workers are killed.

    bench/manybags.py [--bags N] [--seconds N] [--kill-every SECONDS] [--cases CASE ...] [--json FILE]

Plays bags of the simulated NAO over its program: by a command for each, then by one for all of them, and prints a
line for each case. The clusters need the Python package distributed. In the cases called killed, a
random worker is killed periodically with SIGKILL. The exit status is 1 if a bag failed, or if a result differs from
that of playing one by one.
"""

import argparse
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Optional

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src"), str(HERE.parent / "examples" / "nao")]

from arguments import above_zero, positive, target  # noqa: E402
from processes import machine  # noqa: E402

CASES = {
    "one-by-one": ("a command for each", 0, False, False),
    "jobs-1": ("--jobs 1", 1, False, False),
    "jobs-2": ("--jobs 2", 2, False, False),
    "jobs-2-killed": ("--jobs 2, killed", 2, False, True),
    "cluster-1": ("cluster of 1", 1, True, False),
    "cluster-2": ("cluster of 2", 2, True, False),
    "cluster-2-killed": ("cluster of 2, killed", 2, True, True),
}
"""Name, number of workers, whether a cluster is used, and whether workers are killed."""

BAG = [sys.executable, "-m", "retalis", "bag"]
HOW = ["--program", str(HERE.parent / "application_source"), "--json"]


class Kills:
    """Periodic killing of random processes.

    Attributes:
        number: number of killed processes.
    """

    def __init__(self, workers: Callable[[], List[int]], every: float):
        self._workers = workers
        self._every = every
        self._random = random.Random(1)
        self._next = time.monotonic() + every
        self.number = 0

    def look(self) -> None:
        """Kill a process if the period has passed."""
        if time.monotonic() < self._next:
            return
        there = self._workers()
        if there:
            self._next += self._every
            try:
                os.kill(self._random.choice(there), signal.SIGKILL)
                self.number += 1
            except ProcessLookupError:  # it has ended meanwhile
                pass


def workers_of(process: int) -> List[int]:
    """Return the processes that a command with ``--jobs`` has started to play bags."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


@contextmanager
def cluster(workers: int) -> Iterator[Any]:
    """Provide a cluster of processes on this machine."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as one:
        yield one


def watched(command: List[str], kills: Optional[Callable[[int], Kills]]) -> Dict[str, Any]:
    """Run a command while its workers are killed; return its result."""
    began = time.monotonic()
    running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    killing = kills(running.pid) if kills is not None else None
    while True:
        try:
            _, said = running.communicate(timeout=0.05)
            break
        except subprocess.TimeoutExpired:
            if killing is not None:
                killing.look()
    return {
        "seconds": time.monotonic() - began,
        "status": running.returncode,
        "kills": killing.number if killing is not None else 0,
        "said": said,
    }


def run(case: str, bags: Path, results: Path, every: float) -> Dict[str, Any]:
    """Play the bags as in a case; return its figures."""
    _, workers, run_on_cluster, killed = CASES[case]
    if not workers:
        return one_by_one(bags, results)
    command = [*BAG, str(bags), *HOW, "--output", str(results)]
    if not run_on_cluster:
        kills = (lambda process: Kills(lambda: workers_of(process), every)) if killed else None
        return watched([*command, "--jobs", str(workers)], kills)
    with cluster(workers) as one:
        processes = [lambda nanny=nanny: nanny.pid for nanny in one.workers.values()]
        kills = (
            (lambda process: Kills(lambda: [pid for ask in processes for pid in [ask()] if pid], every))
            if killed
            else None
        )
        return watched([*command, "--scheduler", one.scheduler_address], kills)


def one_by_one(bags: Path, results: Path) -> Dict[str, Any]:
    """Play each bag with its own command."""
    began, status = time.monotonic(), 0
    results.mkdir()
    for bag in sorted(bags.glob("*.bag")):
        with open(results / f"{bag.stem}.jsonl", "wb") as file:
            status |= subprocess.run([*BAG, str(bag), *HOW], stdout=file, check=False).returncode
    return {"seconds": time.monotonic() - began, "status": status, "kills": 0, "said": ""}


def processor() -> float:
    """Return the CPU seconds of all ended child processes."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def same(results: Path, expected: Path) -> int:
    """Return the number of results that are as expected; -1 if there are further files."""
    names = sorted(path.name for path in expected.iterdir())
    if set(os.listdir(results)) - set(names):
        return -1
    there = [name for name in names if (results / name).exists()]
    return sum((results / name).read_bytes() == (expected / name).read_bytes() for name in there)


def main(given: Optional[List[str]] = None) -> int:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bags", type=positive, default=200)
    parser.add_argument("--seconds", type=above_zero, default=5.0, help="length of each bag")
    parser.add_argument("--kill-every", type=above_zero, default=3.0, metavar="SECONDS")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), metavar="CASE")
    parser.add_argument("--json", type=target, help="write the figures there")
    options = parser.parse_args(given)
    from make_bag import make_bag

    os.environ["PYTHONPATH"] = str(HERE.parent / "src")
    rows: Dict[str, Dict[str, Any]] = {}
    good = True
    with tempfile.TemporaryDirectory() as folder:
        bags = Path(folder) / "bags"
        bags.mkdir()
        for number in range(options.bags):
            make_bag(bags / f"{number:04}.bag", options.seconds, number)
        for case in ("one-by-one", *(case for case in options.cases if case != "one-by-one")):
            results = Path(folder) / case
            before = processor()
            row = rows[case] = run(case, bags, results, options.kill_every)
            row["processor"] = processor() - before
            row["same"] = same(results, Path(folder) / "one-by-one")
            row["load"] = os.getloadavg()[0]
            row["again"] = row["said"].count("; it is played again")
            good = good and row["status"] == 0 and row["same"] == options.bags
            print(
                f"{CASES[case][0]:22} {row['seconds']:6.1f} s  {options.bags / row['seconds']:5.2f} bags/s  "
                f"{row['processor']:6.1f} s of processor time  "
                f"{row['same']} the same  {row['kills']} killed  {row['again']} told of as played again  "
                f"status {row['status']}  load {row['load']:.1f}",
                flush=True,
            )
    print(machine())
    if options.json:
        figures = {"machine": machine(), "bags": options.bags, "seconds": options.seconds, "rows": rows}
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
