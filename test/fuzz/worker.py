"""Worker process that processes inputs one after the other; an input may end it.

It writes a line of JSON for each finding, and finally one with counts. It stores the number of the current input in a
small file, so that its parent knows the input that has killed it.
"""

import faulthandler
import gc
import json
import os
import random
import resource
import signal
import struct
import sys
import time
from pathlib import Path
from typing import Any, Dict

from .kinds import kind_of
from .side_effects import FindingError, Watch, raised_at

MAX_ADDRESS_SPACE_BYTES = 3 << 30
"""Maximum address space in bytes: an input that needs more raises `MemoryError`."""

MAX_REPORTED_INPUTS = 3
"""Maximum number of inputs that are reported for one finding; further ones are counted."""

WARM_UP_INPUTS = 2000
"""Number of inputs after which the memory of a process should be constant."""

MAX_LEAK_BYTES = 50 << 20
"""Maximum growth of the memory after `WARM_UP_INPUTS` in bytes."""

MAX_CPU_SECONDS = 8
"""Maximum CPU time of a process for one input, in seconds."""

BLOCKS_PER_COLLECTION = 16
"""Number of blocks between two garbage collections."""

MAX_WARM_UP_INPUTS = 50
"""Maximum number of inputs that are processed before side effects are checked, because they import and cache."""


class Worker:
    """Worker for the inputs of a kind.

    Args:
        name: the kind.
        seed: determines the inputs, together with their numbers.
        scratch: folder in which inputs may write.
        report: receives each finding, as a dictionary.
        progress: file descriptor for the number of the current input and of the first one of its block.
    """

    def __init__(self, name: Any, seed: Any, scratch: Any, report: Any, progress: Any = None) -> None:
        self.name = name
        self.seed = seed
        self.kind = kind_of(name)(Path(scratch))
        self.watch = Watch(scratch, self.kind.may_read_files, self.kind.seconds, self.kind.max_growth)
        self.report = report
        self.progress = progress
        self.rng = random.Random()
        self.block_start = 0
        self.processed_count = 0
        self.report_counts: Dict[Any, Any] = {}

    def warm_up(self) -> None:
        """Process some inputs of the corpus without a check of side effects."""
        self.kind.reset()
        for data in self.kind.corpus[:MAX_WARM_UP_INPUTS] if self.kind.may_warm_up else ():
            self.kind.prepare(data)
            try:
                self.kind.run(data)
            except Exception:  # the input is processed again, with checks
                self.kind.reset()
        self.kind.accepted_count = self.kind.refused_count = 0
        gc.collect()
        gc.freeze()

    def get_input(self, number: Any) -> Any:
        """Return the input with a number; the first ones are those of the corpus."""
        if number < len(self.kind.corpus):
            return self.kind.corpus[number]
        self.rng.seed(f"{self.name} {self.seed} {number}")
        return self.kind.generate(self.rng)

    def run(self, numbers: Any, until: Any = None) -> None:
        """Process the inputs with some numbers."""
        resident, initial = self.watch.resident, None
        parent = os.getppid()
        for number in numbers:
            # The campaign has been ended by a signal.
            if os.getppid() != parent:
                break
            if number % self.kind.block_size == 0 or number == numbers[0]:
                if until is not None and time.monotonic() > until:
                    break
                self.begin_block(number)
            self.process(number, self.get_input(number))
            self.processed_count += 1
            if self.processed_count == WARM_UP_INPUTS:
                gc.collect()
                initial = resident()
        if initial is not None:
            self.kind.reset()
            gc.collect()
            growth = resident() - initial
            if growth > MAX_LEAK_BYTES:
                text = f"{growth >> 20} MB in {self.processed_count - WARM_UP_INPUTS} inputs"
                self.report_finding(numbers[-1], b"", FindingError("leak", text, self.name))

    def begin_block(self, number: int) -> None:
        """Begin a block with new objects, so that earlier inputs have no influence."""
        if number // self.kind.block_size % BLOCKS_PER_COLLECTION == 0:
            gc.collect()
        self.block_start = number
        self.kind.reset()

    def process(self, number: int, data: bytes) -> None:
        """Process an input and report its problem."""
        if self.progress is not None:
            subject = self.kind.subject(data).encode()
            os.pwrite(self.progress, struct.pack("<qq80s", number, self.block_start, subject), 0)
        problem = self.find_problem(data)
        if problem is not None:
            self.report_finding(number, data, problem)
            self.begin_block(number + 1)

    def find_problem(self, data: Any) -> Any:
        """Process an input; return its problem, or None."""
        return self._process_isolated(data) if self.kind.is_isolated else self._process(data)

    def _process_isolated(self, data: Any) -> Any:
        """Process an input in a separate process; return its problem, or None."""
        read, write = os.pipe()
        child = os.fork()
        if not child:
            resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_SECONDS, MAX_CPU_SECONDS))
            self.watch.start_timer()
            before = self.kind.accepted_count, self.kind.refused_count
            # Whatever the input raises, the child must not go on with the work of its parent.
            try:
                problem = self._process(data)
                steps = self.kind.accepted_count - before[0], self.kind.refused_count - before[1]
                finding = None if problem is None else problem.args
                os.write(write, json.dumps((finding, steps, self.watch.slowest)).encode())
            finally:
                os._exit(0)
        os.close(write)
        with os.fdopen(read, "rb") as answer:
            text = answer.read()
        status = os.waitpid(child, 0)[1]
        if not text:
            category = "time" if os.WTERMSIG(status) == signal.SIGXCPU else "died"
            return FindingError(category, f"status {status}", self.kind.subject(data))
        finding, (accepted, refused), slowest = json.loads(text)
        self.kind.accepted_count += accepted
        self.kind.refused_count += refused
        self.watch.slowest = max(self.watch.slowest, slowest)
        return None if finding is None else FindingError(*finding)

    def _process(self, data: Any) -> Any:
        kind = self.kind
        kind.prepare(data)
        self.watch.mark = kind.marker_of(data)
        try:
            with self.watch.input():
                kind.run(data)
        except FindingError as finding:
            return finding
        except Exception as error:
            return FindingError(
                "exception", f"{type(error).__name__}: {error}"[:500], raised_at(error.__traceback__)
            )
        return None

    def report_finding(self, number: Any, data: bytes, problem: Any) -> None:
        """Report a finding, with a shortened input if possible."""
        place, detail = problem.place, problem.detail
        subject = self.kind.subject(data) if problem.category in ("time", "growth") else ""
        if subject:  # one finding for each subject, wherever the watch interrupted the work
            place, detail = subject, f"{detail} at {place}"
        key = f"{problem.category} {place} {'' if subject else detail.split(':')[0][:40]}"
        times = self.report_counts[key] = self.report_counts.get(key, 0) + 1
        line = {
            "key": key,
            "category": problem.category,
            "detail": detail,
            "place": place,
            "kind": self.name,
            "seed": self.seed,
            "number": number,
            "since": self.block_start,
            "again": times > MAX_REPORTED_INPUTS,
        }
        if times <= MAX_REPORTED_INPUTS:
            small = self.shorten(data, problem) if times == 1 else data
            line["input"] = small.hex()
        self.report(line)

    def shorten(self, data: Any, problem: Any, max_attempts: int = 300) -> Any:
        """Return a shorter input with the same problem, found by removing pieces."""
        if problem.category in ("time", "growth", "leak") or not self.has_same_problem(data, problem):
            return data
        size = len(data) // 2
        while size and max_attempts:
            position = 0
            while position < len(data) and max_attempts:
                max_attempts -= 1
                shorter = data[:position] + data[position + size :]
                if self.has_same_problem(shorter, problem):
                    data = shorter
                else:
                    position += size
            size //= 2
        return data

    def has_same_problem(self, data: Any, problem: Any) -> bool:
        """Return whether an input alone causes the same problem."""
        self.kind.reset()
        other = self.find_problem(data)
        return other is not None and (other.category, other.place) == (problem.category, problem.place)


def main(argv: Any) -> None:
    """Process the inputs of the command line: kind, seed, scratch folder, first number, count, seconds; or a file."""
    name, seed, scratch = argv[0], int(argv[1]), argv[2]
    faulthandler.enable()
    lines = os.fdopen(os.dup(1), "w", encoding="ascii")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_ADDRESS_SPACE_BYTES, MAX_ADDRESS_SPACE_BYTES))
    os.chdir(scratch)
    progress = os.open(os.path.join(scratch, "progress"), os.O_RDWR | os.O_CREAT)

    def report(line: Dict[str, Any]) -> None:
        print(json.dumps(line), file=lines, flush=True)

    worker = Worker(name, seed, scratch, report, progress)
    worker.warm_up()
    with worker.watch.installed():
        if argv[3] == "file":
            worker.begin_block(0)
            worker.process(0, Path(argv[4]).read_bytes())
        else:
            first, count, seconds = int(argv[3]), int(argv[4]), float(argv[5])
            until = time.monotonic() + seconds if seconds else None
            worker.run(range(first, first + count), until)
    watch, kind = worker.watch, worker.kind
    report(
        {
            "done": worker.processed_count,
            "accepted": kind.accepted_count,
            "refused": kind.refused_count,
            "slowest": watch.slowest,
            "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10,
        }
    )


if __name__ == "__main__":
    main(sys.argv[1:])
