"""A process with an engine under load and a checkpoint file, to be killed; it resumes from the file if there is one.

Each event ``in(N)`` stores N in a memory, a counter and a partial match. The process prints the restored values, then
``ready``, then the numbers of processed events with the time.
"""

import sys
import time
from pathlib import Path
from typing import Any, List

from retalis import Clock, Engine, Reports, Settings
from retalis.engine.checkpoints import Checkpointer, CheckpointStorage, resume

RULES = """
pair(X, Y) <- in(X) seq in(Y).
n(N) <- begin seq aggregate(count, in(_), N).
out(N) <- in(N) where (incCounter(c)).
"""
GOALS = "compile_event_file('r.txt')\nmemorize(in(_), [], _, m, 500)\n"


def main(program_folder: str, every: str = "0.02") -> None:
    folder = Path(program_folder)
    path = folder / "state.db"
    settings, reports = Settings(), Reports()
    resumed = resume(path, folder, Clock(), settings, reports)
    if resumed is None:
        engine = Engine(Clock(), settings, reports)
        engine.load_program(folder)
        engine.event("begin")
        first = 0
    else:
        engine = resumed[0]
        records = engine.query("access_mem(m, in(X), _)")
        last = records[0]["X"] if records else 0
        assert isinstance(last, int), last
        (counts,) = engine.query("counter(c, C), memory_counter(m, M)")
        first = last
        print(counts["C"], len(records), counts["M"], last, flush=True)
        events: List[Any] = []
        engine.on_event(lambda term, start, end: events.append(engine.show(term)))
        engine.event(f"in({first + 1})")
        print(f"pair({last},{last + 1})" in events or not last, f"n({last + 1})" in events, flush=True)
        first += 1
    files = None if resumed is None else resumed[1].files
    checkpointer = Checkpointer(engine, CheckpointStorage(path), folder, reports, float(every), files)
    checkpointer.start()
    print("ready", flush=True)
    for value in range(first + 1, 10_000_000):
        engine.event(f"in({value})")
        if value % 50 == 0:
            print(value, time.time(), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
