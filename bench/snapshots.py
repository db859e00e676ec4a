#!/usr/bin/env python3
"""CPU time and size of snapshots of an engine, and CPU time of restoring them.

    bench/snapshots.py [BEFORE] [--case NAME ...] [--sizes N ...] [--runs N] [--repeats N] [--instructions]
        [--most RATIO]

Cases are an engine with N records in a memory (``memory``), with N events that wait for the end of a sequence
(``seq``), and with N joined pairs that wait for it (``join``). Each case runs in a process of its own; the best of
all repetitions counts, because other load can only add to it.

With BEFORE, a revision of this repository or the folder of another checkout, both run alternately, and the table
shows the ratio. ``--instructions`` counts instructions with valgrind instead of measuring time: this takes a minute
per case, but depends little on other load. The exit status is 1 if a snapshot or its restoration takes more than
``--most`` times as much as before (1.2), or a snapshot is larger by more than that factor.
"""

import argparse
import gc
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Callable, ContextManager, Dict, List, NamedTuple, Optional, Sequence

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path.insert(0, str(HERE))

if TYPE_CHECKING:
    from retalis import Engine

WARM_UP_ROUNDS = 3


class Costs(NamedTuple):
    """Costs of a case: seconds of CPU time, or instructions; and bytes."""

    snapshot: float
    restore: float
    size: float


def memory_of(count: int) -> "Engine":
    """Return an engine with a memory of poses."""
    from retalis import Engine, StreamClock, atom, functor

    chance = random.Random(1)
    engine = Engine(StreamClock())
    engine.load(goals=f"memorize(tf(_, _, _, _), [], _, m, {count})")
    pose, position, rotation = functor("tf", 4), functor("v", 3), functor("q", 4)
    draw = chance.random
    for number in range(count):
        term = pose(
            atom(f"a{number % 20}"),
            atom("b"),
            position(draw(), draw(), draw()),
            rotation(draw(), draw(), draw(), draw()),
        )
        engine.event_at(term, 10**18 + number * 10**7, 10**18 + number * 10**7)
    return engine


def waiting_events(count: int) -> "Engine":
    """Return an engine in which events wait for the end of a sequence."""
    from retalis import Engine, StreamClock, functor

    engine = Engine(StreamClock())
    engine.load(rules="p(X, Y) <- a(X) seq b(X, Y).")
    for number in range(count):
        engine.event_at(functor("a", 1)(number), number, number)
    return engine


def waiting_pairs(count: int) -> "Engine":
    """Return an engine in which joined pairs of events wait for the end of a sequence."""
    from retalis import Engine, StreamClock, functor

    engine = Engine(StreamClock())
    engine.load(rules="p(X, Y) <- (a(X) and b(X)) seq c(X, Y).")
    for number in range(count):
        engine.event_at(functor("a", 1)(number), 2 * number, 2 * number)
        engine.event_at(functor("b", 1)(number), 2 * number + 1, 2 * number + 1)
    return engine


CASES: Dict[str, Callable[[int], "Engine"]] = {
    "memory": memory_of,
    "seq": waiting_events,
    "join": waiting_pairs,
}


def measure_here(case: str, count: int, repeats: int) -> None:
    """Measure a case in this process; print its costs as JSON."""
    from retalis import Engine

    engine = CASES[case](count)
    snapshot_seconds, restore_seconds = [], []
    for _ in range(WARM_UP_ROUNDS):
        data = engine.snapshot()
        Engine.restore(data)
    for _ in range(repeats):
        # The garbage of the previous round would otherwise be collected at random moments.
        gc.collect()
        mark()
        begin = time.process_time()
        data = engine.snapshot()
        snapshot_seconds.append(time.process_time() - begin)
        mark()
        begin = time.process_time()
        restored = Engine.restore(data)
        restore_seconds.append(time.process_time() - begin)
        mark()
        del restored
    print(json.dumps([min(snapshot_seconds), min(restore_seconds), len(data)]))


def mark() -> None:
    """Separate the counts of instructions: valgrind writes them before it enters this function of the C library."""
    os.getpriority(os.PRIO_PROCESS, 0)


def measure(folder: Path, case: str, count: int, repeats: int) -> Costs:
    """Return the CPU time of a case, in seconds, with the package in a folder."""
    return Costs(*json.loads(run_case(folder, [], case, count, repeats)))


def count_instructions(folder: Path, case: str, count: int) -> Costs:
    """Return the instructions of a case, in millions, with the package in a folder."""
    with tempfile.TemporaryDirectory() as name:
        profile = Path(name) / "profile"
        valgrind = ["valgrind", "--tool=callgrind", "--dump-before=getpriority"]
        valgrind += [f"--callgrind-out-file={profile}"]
        size = json.loads(run_case(folder, valgrind, case, count, 1))[2]
        # The first file covers everything before the first mark.
        texts = [Path(f"{profile}.{number}").read_text() for number in (2, 3)]
    counts = [re.search(r"^totals: (\d+)", text, re.MULTILINE) for text in texts]
    return Costs(*[int(found.group(1)) / 1e6 for found in counts if found], size)


def run_case(folder: Path, command: Sequence[str], case: str, count: int, repeats: int) -> str:
    """Run `measure_here` in a process of its own and return its output."""
    search_path = os.pathsep.join(filter(None, (str(folder / "src"), os.environ.get("PYTHONPATH"))))
    # Without randomized hashes, the order of sets and thus the work is the same each time.
    environment = {**os.environ, "PYTHONPATH": search_path, "PYTHONHASHSEED": "0"}
    script = [sys.executable, __file__, "--measure", case, str(count), str(repeats)]
    process = subprocess.run([*command, *script], capture_output=True, text=True, env=environment)
    if process.returncode:
        raise SystemExit(process.stderr)
    return process.stdout


def best(costs: Sequence[Costs]) -> Costs:
    """Return the least of each cost."""
    return Costs(*map(min, zip(*costs)))


def compare(folders: Sequence[Path], case: str, count: int, options: argparse.Namespace) -> List[Costs]:
    """Return the costs of a case in each checkout, which run alternately."""
    if options.instructions:
        return [count_instructions(folder, case, count) for folder in folders]
    costs: List[List[Costs]] = [[] for _ in folders]
    for _ in range(options.runs):
        for costs_of_folder, folder in zip(costs, folders):
            costs_of_folder.append(measure(folder, case, count, options.repeats))
    return list(map(best, costs))


def line(label: str, costs: Sequence[Costs], unit: str, factor: float) -> str:
    """Return a row of the table."""
    cells = []
    for name, values in zip(Costs._fields, zip(*costs)):
        shown = [f"{value / 1e3:.1f}" if name == "size" else f"{factor * value:.2f}" for value in values]
        ratio = f" ({values[-1] / values[0]:.2f})" if len(values) > 1 else ""
        cells.append(f"{name} {' -> '.join(shown)} {'kB' if name == 'size' else unit}{ratio}")
    return f"{label:<14} {'   '.join(cells)}"


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, print a table, and return the exit status."""
    from alternating import checkout
    from arguments import above_zero, positive

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("before", metavar="BEFORE", nargs="?")
    parser.add_argument("--case", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--sizes", nargs="+", type=positive, default=[100, 1_000, 10_000])
    parser.add_argument("--runs", type=positive, default=5, help="processes per case and checkout")
    parser.add_argument("--repeats", type=positive, default=30, help="measurements per process")
    parser.add_argument("--instructions", action="store_true", help="count instructions with valgrind")
    parser.add_argument("--most", type=above_zero, default=1.2, help="ratio up to which the status is 0")
    options = parser.parse_args(arguments)
    unit, factor = ("M", 1.0) if options.instructions else ("ms", 1e3)
    before: ContextManager[Optional[Path]] = (
        nullcontext() if options.before is None else checkout(options.before, ROOT)
    )
    exceeded = []
    with before as folder:
        folders = [ROOT] if folder is None else [folder, ROOT]
        for case in options.case:
            for count in options.sizes:
                costs = compare(folders, case, count, options)
                print(line(f"{case} {count}", costs, unit, factor), flush=True)
                if any(now > options.most * earlier for earlier, now in zip(costs[0], costs[-1])):
                    exceeded.append(f"{case} {count}")
    if exceeded:
        print(f"more than {options.most:g} times as much: {', '.join(exceeded)}")
    return 1 if exceeded else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        measure_here(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
    else:
        raise SystemExit(main())
