"""Works on inputs one after the other, in a process of its own that may die of them.

It writes a line of JSON for each finding, and a last one with figures. Where it is goes into a small file, so
that who started it knows the input of which it has died.
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

from .kinds import kind_of
from .side_effects import Finding, Watch, raised_at

ADDRESSES = 3 << 30
"""Bytes of address space: an input that wants all memory gets a `MemoryError`, not the machine."""

SAME = 3
"""Inputs that are told of one finding; of the others only the number."""

WARM = 2000
"""Inputs after which the memory of a process should not grow any more."""

LEAK = 50 << 20
"""Bytes by which it may all the same."""

LONGEST = 8
"""Seconds of CPU time after which a process for one input is ended."""

COLLECT = 16
"""Blocks from one collection of garbage to the next."""

FRESH = 50
"""Inputs of the corpus that are worked on before the watch begins, so that what they import and cache is there."""


class Worker:
    """Works on the inputs of a kind.

    Args:
        name: the kind.
        seed: with the number of an input it makes what that is.
        tell: takes each finding, as a dictionary.
        progress: a file that takes the number of the input that is worked on, and when its block began.
    """

    def __init__(self, name, seed, scratch, tell, progress=None):
        self.name = name
        self.seed = seed
        self.kind = kind_of(name)(Path(scratch))
        self.watch = Watch(scratch, self.kind.reads, self.kind.seconds, self.kind.growth)
        self.tell = tell
        self.progress = progress
        self.chance = random.Random()
        self.since = 0
        self.done = 0
        self.told = {}

    def warm_up(self):
        """Import and compile what is needed, and begin to watch."""
        self.kind.begin()
        for data in self.kind.corpus[:FRESH] if self.kind.warm else ():
            self.kind.prepare(data)
            try:
                self.kind.run(data)
            except Exception:  # it is worked on again, watched
                self.kind.begin()
        self.kind.taken = self.kind.refused = 0
        gc.collect()
        gc.freeze()
        self.watch.install()

    def input(self, number):
        """Return the input of a number: first those of the corpus."""
        if number < len(self.kind.corpus):
            return self.kind.corpus[number]
        self.chance.seed(f"{self.name} {self.seed} {number}")
        return self.kind.make(self.chance)

    def run(self, numbers, until=None):
        """Work on the inputs of some numbers."""
        resident, base = self.watch.resident, None
        for number in numbers:
            if number % self.kind.block == 0 or number == numbers[0]:
                if until is not None and time.monotonic() > until:
                    break
                self.begin(number)
            self.work(number, self.input(number))
            self.done += 1
            if self.done == WARM:
                gc.collect()
                base = resident()
        if base is not None:
            self.kind.begin()
            gc.collect()
            grown = resident() - base
            if grown > LEAK:
                text = f"{grown >> 20} MB in {self.done - WARM} inputs"
                self.found(numbers[-1], b"", Finding("leak", text, self.name))

    def begin(self, number):
        """Begin a block: nothing that inputs before have left counts."""
        if number // self.kind.block % COLLECT == 0:
            gc.collect()
        self.since = number
        self.kind.begin()

    def work(self, number, data):
        """Work on an input, and tell what it did that it must not."""
        if self.progress is not None:
            subject = self.kind.subject(data).encode()
            os.pwrite(self.progress, struct.pack("<qq80s", number, self.since, subject), 0)
        problem = self.problem(data)
        if problem is not None:
            self.found(number, data, problem)
            self.begin(number + 1)

    def problem(self, data):
        """Work on an input; return what it did that it must not, or None."""
        return self._apart(data) if self.kind.apart else self._problem(data)

    def _apart(self, data):
        """Do the same in a process of its own."""
        read, write = os.pipe()
        child = os.fork()
        if not child:
            resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST))
            self.watch.start_timer()
            before = self.kind.taken, self.kind.refused
            problem = self._problem(data)
            steps = self.kind.taken - before[0], self.kind.refused - before[1]
            told = None if problem is None else problem.args
            os.write(write, json.dumps((told, steps, self.watch.slowest)).encode())
            os._exit(0)
        os.close(write)
        with os.fdopen(read, "rb") as answer:
            text = answer.read()
        status = os.waitpid(child, 0)[1]
        if not text:
            what = "time" if os.WTERMSIG(status) == signal.SIGXCPU else "died"
            return Finding(what, f"status {status}", self.kind.subject(data))
        told, (taken, refused), slowest = json.loads(text)
        self.kind.taken += taken
        self.kind.refused += refused
        self.watch.slowest = max(self.watch.slowest, slowest)
        return None if told is None else Finding(*told)

    def _problem(self, data):
        kind = self.kind
        kind.prepare(data)
        self.watch.mark = kind.marked(data)
        try:
            with self.watch.input():
                kind.run(data)
        except Finding as finding:
            return finding
        except Exception as error:
            return Finding(
                "exception", f"{type(error).__name__}: {error}"[:500], raised_at(error.__traceback__)
            )
        return None

    def found(self, number, data, problem):
        """Tell a finding, shortened where that is simple."""
        where, detail = problem.where, problem.detail
        subject = self.kind.subject(data) if problem.what in ("time", "growth") else ""
        if subject:  # one finding for each subject, wherever the watch interrupted the work
            where, detail = subject, f"{detail} at {where}"
        key = f"{problem.what} {where} {'' if subject else detail.split(':')[0][:40]}"
        times = self.told[key] = self.told.get(key, 0) + 1
        line = {
            "key": key,
            "what": problem.what,
            "detail": detail,
            "where": where,
            "kind": self.name,
            "seed": self.seed,
            "number": number,
            "since": self.since,
            "again": times > SAME,
        }
        if times <= SAME:
            small = self.shortened(data, problem) if times == 1 else data
            line["input"] = small.hex()
        self.tell(line)

    def shortened(self, data, problem, most=300):
        """Return a shorter input that does the same by itself, where one is found by leaving out pieces."""
        if problem.what in ("time", "growth", "leak") or not self.same(data, problem):
            return data
        size = len(data) // 2
        while size and most:
            at = 0
            while at < len(data) and most:
                most -= 1
                shorter = data[:at] + data[at + size :]
                if self.same(shorter, problem):
                    data = shorter
                else:
                    at += size
            size //= 2
        return data

    def same(self, data, problem):
        """Tell whether an input by itself leads to the same problem."""
        self.kind.begin()
        found = self.problem(data)
        return found is not None and (found.what, found.where) == (problem.what, problem.where)


def main(argv):
    """Work on what the command line says: kind, seed, scratch folder, first number, count, seconds; or a file."""
    name, seed, scratch = argv[0], int(argv[1]), argv[2]
    faulthandler.enable()
    lines = os.fdopen(os.dup(1), "w", encoding="ascii")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    os.chdir(scratch)
    progress = os.open(os.path.join(scratch, "progress"), os.O_RDWR | os.O_CREAT)

    def tell(line):
        print(json.dumps(line), file=lines, flush=True)

    worker = Worker(name, seed, scratch, tell, progress)
    worker.warm_up()
    if argv[3] == "file":
        worker.begin(0)
        worker.work(0, Path(argv[4]).read_bytes())
    else:
        first, count, seconds = int(argv[3]), int(argv[4]), float(argv[5])
        until = time.monotonic() + seconds if seconds else None
        worker.run(range(first, first + count), until)
    watch, kind = worker.watch, worker.kind
    tell(
        {
            "done": worker.done,
            "taken": kind.taken,
            "refused": kind.refused,
            "slowest": watch.slowest,
            "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10,
        }
    )


if __name__ == "__main__":
    main(sys.argv[1:])
