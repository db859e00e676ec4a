"""An engine under load that keeps its state in a file, to be killed; goes on from the file where there is one.

Each event ``in(N)`` leaves N in a memory, a counter and a half-matched pattern. What it has after the file was
read is printed, then ``ready``, then numbers whose events are in the engine with the time.
"""

import sys
import time
from pathlib import Path

from retalis import Clock, Engine, Reports, Settings
from retalis.engine.checkpoints import Checkpointer, CheckpointStorage, resume

RULES = """
pair(X, Y) <- in(X) seq in(Y).
n(N) <- begin seq aggregate(count, in(_), N).
out(N) <- in(N) where (incCounter(c)).
"""
GOALS = "compile_event_file('r.txt')\nmemorize(in(_), [], _, m, 500)\n"


def main(folder, every="0.02"):
    folder = Path(folder)
    path = folder / "state.db"
    settings, reports = Settings(), Reports()
    found = resume(path, folder, Clock(), settings, reports)
    if found is None:
        engine = Engine(Clock(), settings, reports)
        engine.load_program(folder)
        engine.event("begin")
        first = 0
    else:
        engine = found[0]
        records = engine.query("access_mem(m, in(X), _)")
        last = records[0]["X"] if records else 0
        (counts,) = engine.query("counter(c, C), memory_counter(m, M)")
        first = last
        print(counts["C"], len(records), counts["M"], last, flush=True)
        seen = []
        engine.on_event(lambda term, start, end: seen.append(engine.show(term)))
        engine.event(f"in({first + 1})")
        print(f"pair({last},{last + 1})" in seen or not last, f"n({last + 1})" in seen, flush=True)
        first += 1
    files = None if found is None else found[1].files
    kept = Checkpointer(engine, CheckpointStorage(path), folder, reports, float(every), files)
    kept.start()
    print("ready", flush=True)
    for number in range(first + 1, 10_000_000):
        engine.event(f"in({number})")
        if number % 50 == 0:
            print(number, time.time(), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
