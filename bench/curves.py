#!/usr/bin/env python3
"""Cost of an event as a function of the number of memories, records, queries, rules and subscriptions.

    bench/curves.py [--curve NAME ...] [--most N] [--runs N] [--json FILE] [--plot FILE]

Prints a line for each curve: name, microseconds at each size, and the exponent of the power law that fits the upper
half of the sizes best (0: constant cost; 1: linear cost). ``bench/partial_matches.py`` measures partial matches.
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

import workload as work  # noqa: E402
from arguments import positive, target  # noqa: E402
from processes import machine  # noqa: E402

from retalis import Engine, Var, functor, limit_gc_pauses, make_list  # noqa: E402

SECOND = 10**9
FEW = (1, 10, 40, 160, 640)
Stream = Sequence[Tuple[Any, Optional[int]]]


def exponent(points: Sequence[Tuple[float, float]]) -> float:
    """Return b of the power law y = a * x**b that fits best; nan with fewer than two points."""
    logs = [(math.log(x), math.log(y)) for x, y in points]
    if len(logs) < 2:
        return math.nan
    middle_x = sum(x for x, _ in logs) / len(logs)
    middle_y = sum(y for _, y in logs) / len(logs)
    over = sum((x - middle_x) ** 2 for x, _ in logs)
    return sum((x - middle_x) * (y - middle_y) for x, y in logs) / over


class Curve(NamedTuple):
    """A curve.

    Attributes:
        title: title of the curve.
        sizes: sizes to measure.
        measure: returns microseconds for a size and a number of runs.
        grows: whether each event concerns all items, so that the cost must grow.
    """

    title: str
    sizes: Tuple[int, ...]
    measure: Callable[[int, int], float]
    grows: bool = False


def best(engine: Engine, streams: Sequence[Stream]) -> float:
    """Return the microseconds per event of the fastest stream."""
    limit_gc_pauses()
    times = []
    for stream in streams:
        began = time.process_time()
        for term, instant in stream:
            engine.post(term, instant)
        times.append((time.process_time() - began) / len(stream) * 1e6)
    return min(times)


def memories(pattern: str, record: str, runs: int, size: int, kept: int = 2500) -> float:
    """Measure the NAO's stream with memories of one pattern, in which ``#`` is the memory's number."""
    engine = work.nao_engine()
    engine.load(
        goals="\n".join(
            f"memorize({pattern.replace('#', str(at))}, [], {record}, extra{at}, {kept})"
            for at in range(size)
        )
    )
    stream = [(item.term, item.instant) for item in work.nao_stream(1)]
    return best(engine, [stream] * runs)


def recording(size: int, runs: int) -> float:
    """Measure recording into a full memory."""
    engine = Engine()
    engine.load(goals=f"memorize(seen(X), [], seen(X), q, {size})")
    seen = functor("seen", 1)
    best(engine, [[(seen(at), at * 1000) for at in range(2 * size + 16)]])
    number = 20_000
    return best(
        engine,
        [
            [(seen(at), (3 * size + run * number + at) * 1000) for at in range(number)]
            for run in range(1, runs + 1)
        ],
    )


def looking(size: int, runs: int) -> float:
    """Measure look-ups in a memory, called from a clause."""
    engine = Engine()
    engine.load(
        goals=f"memorize(seen(X), [], seen(X), q, {size})",
        rules="look([]).\nlook([D|Ds]) :- ( prev(q, _, _, _, D) -> true ; true ), look(Ds).\n"
        "stamps(Ts, Ds) :- findall(D, (member(T, Ts), convert_to_datime(T, D)), Ds).",
    )
    seen = functor("seen", 1)
    best(engine, [[(seen(at), at * 1000) for at in range(size)]])
    number = 5000
    spread = [at * 7919 % size * 1000 for at in range(number)]
    times = make_list([make_list(divmod(instant, SECOND)) for instant in spread])
    stamps = engine.query(functor("stamps", 2)(times, Var()))[0]["_0"]
    call = functor("look", 1)(stamps)
    found = []
    for _ in range(runs):
        began = time.process_time()
        engine.call(call)
        found.append((time.process_time() - began) / number * 1e6)
    return min(found)


def waiting(size: int, runs: int, joining: bool) -> float:
    """Measure an event of a memory for which queries wait; with ``joining``, adding a further query."""
    engine = Engine()
    engine.load(
        goals="memorize(seen(X), [], seen(X), q, 100)",
        rules="syncronized(done(K), true, [[q, Z]]) <- tick(K, Z).",
    )
    tick, seen = functor("tick", 2), functor("seen", 1)
    far = 10**6
    best(engine, [[(tick(at, float(far + at)), SECOND) for at in range(size)]])
    if not joining:
        return best(engine, [[(seen(at), SECOND + at) for at in range(5000)]] * runs)
    number = max(10, size // 20)
    return best(
        engine,
        [[(tick(at, float(far + run * number + at)), SECOND) for at in range(number)] for run in range(runs)],
    )


def rules(size: int, runs: int, in_turn: bool) -> float:
    """Measure events that concern one of many rules: always the same, or all ``in_turn``.

    In turn, each event executes code and data of another rule, which are not in the processor's caches if there are
    many, and which the interpreter has not specialized yet.
    """
    engine = Engine()
    engine.load(rules="\n".join(f"found({at}, X) <- e({at}, X) where X > 1." for at in range(size)))
    event = functor("e", 2)
    met = [at * 7 % size if in_turn else size // 2 for at in range(max(2000, 10 * size))]
    return best(engine, [[(event(which, 5), at) for at, which in enumerate(met)]] * runs)


def subscriptions(size: int, runs: int) -> float:
    """Measure events that concern one of many subscriptions."""
    engine = Engine()
    engine.load(goals="\n".join(f"subscribe(e({at}, _), [], _, t, s{at})" for at in range(size)))
    engine.on_output(lambda term, topic, name: None)
    event = functor("e", 2)
    return best(engine, [[(event(at * 7 % size, 5), at) for at in range(2000)]] * runs)


THOUSAND = (1, 10, 100, 1000)
LARGE = tuple(10**power for power in range(2, 7))
QUERIES = tuple(10**power for power in range(1, 6))
CURVES: Dict[str, Curve] = {
    "memories_unrelated": Curve(
        "memories of events that never arrive",
        FEW,
        lambda size, runs: memories("a(X,Y,Z,W)", "a(X,Y,Z,W)", runs, size),
    ),
    "memories_other_constant": Curve(
        "memories, each of a transform that never arrives",
        FEW,
        lambda size, runs: memories("tf(parent#,Y,V,Q)", "tf(Y,V,Q)", runs, size),
    ),
    "memories_pair": Curve(
        "memories of one transform of forty",
        FEW,
        lambda size, runs: memories("""tf('"Head"','"CameraTop_frame"',V,Q)""", "tf(V,Q)", runs, size),
        True,
    ),
    "memories_all": Curve(
        "memories of all transforms",
        FEW,
        lambda size, runs: memories("tf(X,Y,V,Q)", "tf(X,Y,V,Q)", runs, size),
        True,
    ),
    "memory_recording": Curve("recording into a full memory of a size", LARGE, recording),
    "memory_looking": Curve("looking up in a memory of a size", LARGE, looking),
    "queries_waiting": Curve(
        "an event while queries wait", QUERIES, lambda size, runs: waiting(size, runs, False)
    ),
    "queries_joining": Curve(
        "a new query while others wait", QUERIES, lambda size, runs: waiting(size, runs, True)
    ),
    "rules": Curve(
        "rules; the same one always matches", THOUSAND, lambda size, runs: rules(size, runs, False)
    ),
    "rules_in_turn": Curve(
        "rules; each matches in sequence", THOUSAND, lambda size, runs: rules(size, runs, True)
    ),
    "subscriptions": Curve("subscriptions; one matches", THOUSAND, subscriptions),
}


def line(name: str, row: Dict[str, Any]) -> str:
    """Return a table row as text."""
    figures = "  ".join(f"{size}: {us:.2f}" for size, us in row["points"])
    return f"{name:<24} exponent {row['exponent']:5.2f}  {figures}"


def measure(options: argparse.Namespace) -> Dict[str, Any]:
    """Return the figures of the selected curves."""
    rows = {}
    for name in options.curve or CURVES:
        curve = CURVES[name]
        sizes = [size for size in curve.sizes if size <= options.most]
        points = [(size, curve.measure(size, options.runs)) for size in sizes]
        upper = points[len(points) // 2 :] if len(points) > 3 else points
        rows[name] = {
            "title": curve.title,
            "grows": curve.grows,
            "points": points,
            "exponent": exponent(upper),
        }
        print(line(name, rows[name]), flush=True)
    return {"machine": machine(), "rows": rows}


def main(given: Optional[List[str]] = None) -> int:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--curve", nargs="+", choices=list(CURVES))
    parser.add_argument("--most", type=positive, default=10**6, help="the largest size")
    parser.add_argument("--runs", type=positive, default=3, help="the least of so many runs counts")
    parser.add_argument("--json", type=target, help="write the figures there")
    parser.add_argument("--plot", type=target, help="draw them there")
    options = parser.parse_args(given)
    result = measure(options)
    if options.json:
        Path(options.json).write_text(json.dumps(result, indent=1) + "\n")
    if options.plot:
        from performance_plots import draw_curves

        draw_curves(result, options.plot)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
