"""A program with every kind of state, the state file of each release, and what an engine continues to output.

    PYTHONPATH=src:test python3 -m serialization.released_states 1.1.0

writes the files of a release to ``test/data/states``: once, with the commit that is released.
"""

import json
import sys
from pathlib import Path
from typing import Any, Dict, List

from retalis import Engine, StreamClock
from retalis.prolog.terms.timestamps import SECOND

FOLDER = Path(__file__).resolve().parents[1] / "data" / "states"

RULES = """
:- dynamic seen/1.
:- state(open(X), from(opened(X)), until(closed(X))).
sequence(X, Y) <- a(X) seq b(X, Y).
joined(X, Y) <- (a(X) and b(X, Y)) within 60.
negated(X) <- (a(X) seq c(_)) cnot b(X, _).
unless(X) <- (b(X, _) seq c(_)) fnot a(X).
chosen(X) <- a(X) or c(X).
repeated(X) <- (a(X) ntimes 3) within 60.
collected(L) <- c(_) seq aggregate(list(Y), b(_, Y), L).
starred(X) <- c(X) seq (b(_, _) star_times).
averaged(R) <- c(_) seq aggregate(avg(Y), b(_, Y), R).
smallest(R) <- c(_) seq aggregate(min(Y), b(_, Y), R).
sliding(N, S) <- aggregate([count, sum(Y)], b(_, Y), [N, S], last(30)).
last_two(M) <- aggregate(median(Y), b(_, Y), M, last(2, events)).
tumbling(X, N) <- aggregate(count, b(X, _), N, every(4)).
current(N) <- aggregate(count, b(_, _), N, running(every(4))).
anchored(M) <- aggregate(max(Y), b(_, Y), M, every(6, first)).
hopping(N) <- aggregate(count, b(_, _), N, last(6, every(2))).
paused(N) <- aggregate(count, b(_, _), N, session(3, max(9))).
counted(N) <- aggregate(distinct(X), b(X, _), N, every(3, events)).
risen(N) <- aggregate(count, b(_, Y), N, steps([up(2) where Y > 1, down where Y < 2])).
throttled(X) <- (a(X) with throttle(5, X)).
burst(X) <- (a(X) with burst(2)).
debounced(X) <- (a(X) with debounce(3, X)).
changed(X) <- (a(X) with change(X)).
missing(X) <- a(X) seq absent(b(X, _), 4).
skipping([property(after_match, skip_past_last)]) : pair(X, Y) <- a(X) seq b(X, Y).
exceptionAlarm(late(X), 15) <- c(X).
synchronized(found(X, Y), (prev(m, Y, _, _, T)), [[m, T]]) <- ask(X, T).
synchronized(lost(X), (prev(m, _, _, _, T)), [[m, T]], [timeout(20)]) <- ask(X, T).
"""
GOALS = """
assertz(seen(1))
nb_setval(count, f(7, "text", [1, 2.5]))
memorize(b(X, Y), [], pair(X, Y), m, 5)
subscribe((a(X) with throttle(5, X)), [], _, topic, first)
subscribe((a(X) with debounce(4, X)), [], _, topic, second)
timer(tick(1), every(7))
timer(once(1), after(20))
"""
CLOCK_OF_EVENTS = "clock_of_events"
"""Name of the state whose clock follows the timestamps of events."""

FLAGS = {
    "plain": "",
    "out_of_order": "set_etalis_flag(out_of_order, on)\n",
    "revised": "set_etalis_flag(revision_flag, on)\nset_etalis_flag(store_fired_events, on)\n",
    "unrestricted": "set_etalis_flag(event_consumption_policy, unrestricted)\n",
    CLOCK_OF_EVENTS: "",
}
BEFORE = (
    *("a(1)", "b(1, 3)", "c(5)", "a(2)", "b(2, 0.5)", "opened(x)"),
    *("a(2)", "ask(1, 17)", "b(1, 2)", "c(6)", "a(1)", "b(3, 4)"),
)
AFTER = ("b(2, 1)", "a(1)", "c(7)", "closed(x)", "a(2)", "b(1, 9)", "a(2)", "b(2, 0)", "c(8)", "b(2, 5)")
QUERIES = ("seen(X)", "nb_getval(count, X)", "memory_size(m, N)", "holds(open(X))", "access_mem(m, R, I)")


def engine_with_state(flags: Any) -> Engine:
    """Return an engine in the middle of matches of all kinds."""
    engine = Engine() if flags == CLOCK_OF_EVENTS else Engine(StreamClock())
    engine.load(RULES, FLAGS[flags] + GOALS)
    emit(engine, BEFORE, 1)
    return engine


def emit(engine: Any, events: Any, first_second: int) -> None:
    """Emit one event per second, with alarms that are due before."""
    for second, event in enumerate(events, first_second):
        if engine.event_input.stream_clock is None:
            engine.clock.move_to(second * SECOND)
            engine.advance()
        engine.event(event, second)


def continued_outputs(engine: Any) -> List[str]:
    """Return what an engine with the state outputs for further events, and its answers to queries."""
    outputs = [f"{query}: {engine.query(query)}" for query in QUERIES]
    engine.on_event(lambda term, start, end: outputs.append(f"{engine.show(term)} {int(start)} {int(end)}"))
    engine.on_output(lambda term, topic, name: outputs.append(f"{topic}: {engine.show(term)}"))
    emit(engine, AFTER, len(BEFORE) + 1)
    emit(engine, ["end", "end"], 60)
    return outputs


def write_files(release: Any) -> None:
    """Write the state files and outputs of a release."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    outputs: Dict[Any, Any] = {}
    for flags in FLAGS:
        (FOLDER / f"{release}-{flags}.state").write_bytes(engine_with_state(flags).snapshot())
        outputs[flags] = continued_outputs(engine_with_state(flags))
    text = json.dumps(outputs, indent=0)
    (FOLDER / f"{release}.json").write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    write_files(sys.argv[1])
