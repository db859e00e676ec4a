#!/usr/bin/env python3
"""Experiments of the original on this engine: one case, or all cases beside the reference engine.

    bench/engine.py CASE [--messages]     one line: case NAME events N cpu SECONDS us_per_event U outputs N
    bench/engine.py --all [--against FOLDER] [--python PATH ...] [--runs N] [--json FILE] [--plot FILE]

``--messages`` feeds serialized ROS messages and includes decoding. ``--against`` runs the same cases of the
reference (``bench.pl`` in FOLDER; the environment variable ``RETALIS_REF`` names its checkout), alternating with
ours, and prints medians and ratios.
"""

import argparse
import json
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src"), str(HERE.parent / "examples" / "nao")]

import workload as work  # noqa: E402
from arguments import existing, interpreter, positive, target  # noqa: E402
from processes import machine  # noqa: E402

from retalis import Engine, StreamClock, functor, limit_gc_pauses  # noqa: E402


class Result(NamedTuple):
    """Figures of a case."""

    name: str
    events: int
    seconds: float
    outputs: int

    def line(self) -> str:
        """Return the output line of a case."""
        each = self.seconds * 1e6 / self.events
        return (
            f"case {self.name} events {self.events} cpu {self.seconds:.3f} "
            f"us_per_event {each:.3f} outputs {self.outputs}"
        )


class Outputs:
    """Counter of outputs."""

    def __init__(self, engine: Engine):
        self.number = 0
        engine.on_output(self.take)

    def take(self, term: Any, topic: str, name: Any) -> None:
        """Count an output."""
        self.number += 1


def feed(engine: Engine, items: List[work.Item], messages: bool) -> Tuple[float, int]:
    """Feed a stream; return the CPU seconds and the number of outputs."""
    outputs = Outputs(engine)
    if messages:
        definitions = nao_definitions()
        data = [(definitions.decoder(kind), raw) for raw, kind in work.as_bytes(items, definitions)]
        limit_gc_pauses()
        began = time.process_time()
        engine.post_each((decoder.decode(raw), decoder.stamp(raw)) for decoder, raw in data)
    else:
        limit_gc_pauses()
        began = time.process_time()
        engine.post_each((term, instant) for term, instant, _ in items)
    return time.process_time() - began, outputs.number


def nao_definitions() -> Any:
    """Return the message types of the NAO's streams."""
    import nao_messages

    from retalis import Definitions

    definitions = Definitions()
    for name, definition in nao_messages.definitions().items():
        definitions.add(name, definition.full_text)
    return definitions


def nao(name: str, messages: bool, extra: str = "", seconds: int = 10) -> Result:
    """Run S1 and its variants: the NAO's stream and program, after further goals."""
    engine = work.nao_engine()
    if extra:
        engine.load(goals=extra)
    items = work.nao_stream(seconds)
    cpu, outputs = feed(engine, items, messages)
    return Result(name, len(items), cpu, outputs)


def nao_renamed(name: str, messages: bool) -> Result:
    """Run S1 with other message types, functors and slot orders; terms only."""
    engine = work.nao_engine(other_names=True)
    items = work.nao_stream(10, other_names=True)
    cpu, outputs = feed(engine, items, False)
    return Result(name, len(items), cpu, outputs)


def with_memories(number: int, pattern: str, record: str, size: int) -> Callable[[str, bool], Result]:
    """Return the case of the NAO with further memories."""
    return lambda name, messages: nao(name, messages, work.extra_memories(number, pattern, record, size))


def stop_when_full(name: str, messages: bool) -> Result:
    """Run S4: memories that stop recording when they are full."""
    goals = "\n".join(
        f"memorize(tf(X,Y,V,Q), [memory_counter(extra{i}, N), N < 2500], tf(X,Y,V,Q), extra{i}, 2500)"
        for i in range(20)
    )
    return nao(name, messages, goals)


def mixed(name: str, messages: bool) -> Result:
    """Run S7: 10 memories of everything, and 320 of one pair."""
    pair = work.extra_memories(320, PAIR, "tf(V,Q)", 2500).replace("extra", "pair")
    return nao(name, messages, work.extra_memories(10, "tf(X,Y,V,Q)", "tf(X,Y,V,Q)", 2500) + "\n" + pair)


PAIR = """tf('"Head"', '"CameraTop_frame"', V, Q)"""
BASE = work.BASE


def filled(size: int) -> Engine:
    """Return an engine with one full memory of the camera's joint."""
    engine = Engine()
    engine.load(goals=f"memorize({PAIR}, [], tf(V,Q), q, {size})")
    for k in range(1, size + 1):
        t = k / 50
        instant = (BASE + int(t)) * 10**9 + int((t - int(t)) * 1e9)
        term = work.term(f"""tf('"Head"', '"CameraTop_frame"', [{t}, {t}, {t}], [0.0, 0.0, 0.0, 1.0])""")
        engine.post(term, instant)
    return engine


def look_ups(predicate: str, size: int) -> Callable[[str, bool], Result]:
    """Run S8: 70,000 look-ups, called from a clause."""

    def case(name: str, messages: bool) -> Result:
        engine = filled(size)
        call = "next_inf(q, _, _, _, D)" if predicate == "next" else "prev(q, _, _, _, D)"
        engine.load(
            rules=f"look([]).\nlook([D|Ds]) :- ( {call} -> true ; true ), look(Ds).\n"
            "times(0, _) :- !.\ntimes(N, Ds) :- look(Ds), N1 is N - 1, times(N1, Ds).\n"
        )
        stamps = []
        for i in range(1, 1001):
            t = (i * 7919) % size / 50 + 0.005
            stamps.append(f"[{BASE + int(t)},{int((t - int(t)) * 1e9)}]")
        engine.load(
            rules="stamps(Ds) :- findall(D, (member(T, ["
            + ",".join(stamps)
            + "]), convert_to_datime(T, D)), Ds)."
        )
        goal = work.term("stamps(Ds)")
        stamp_list = engine.query(goal)[0]["_0"]
        limit_gc_pauses()
        began = time.process_time()
        engine.call(functor("times", 2)(70, stamp_list))
        return Result(name, 70_000, time.process_time() - began, 0)

    return case


def look_ups_beside(rate: int, memories: int) -> Callable[[str, bool], Result]:
    """Run S8: ``rate`` look-ups per second in the NAO's stream, with further memories."""

    def case(name: str, messages: bool) -> Result:
        each = rate // 7
        engine = work.nao_engine()
        engine.load(
            rules=f"null do look({each}, S, NS) <- ar_marker(_, _, _, S, NS).\n"
            "look(N, S, NS) :- convert_to_datime([S,NS], D), looks(N, D).\n"
            "looks(0, _) :- !.\n"
            "looks(N, D) :- ( prev(head_cam, _, _, _, D) -> true ; true ), N1 is N-1, looks(N1, D).",
            goals=work.extra_memories(memories, PAIR, "tf(V,Q)", 2500),
        )
        items = work.nao_stream(10)
        cpu, outputs = feed(engine, items, messages)
        return Result(name, len(items), cpu, outputs)

    return case


def synchronized(delay: Optional[int]) -> Callable[[str, bool], Result]:
    """Run S9: 1,000 queries per second: not synchronized (None), due immediately (0), or after ``delay`` seconds."""

    def case(name: str, messages: bool) -> Result:
        engine = Engine(StreamClock(BASE * 10**9))
        engine.load(goals="set_etalis_flag(event_consumption_policy, unrestricted)")
        engine.load_rules((work.APPLICATION / "eventRules.txt").read_text(encoding="utf-8"))
        rule = (
            "done(K) <- tick(K,Z)."
            if delay is None
            else "syncronized(done(K), true, [[head_cam,Z]]) <- tick(K,Z)."
        )
        engine.load(rules=rule, goals=work.MEMORIES + "\nsubscribe(done(_), [], _, t, i)")
        outputs = Outputs(engine)
        tick = functor("tick", 2)
        stream: List[Tuple[Any, Optional[int]]] = []
        items = work.nao_stream(10)
        for item in items:
            stream.append((item.term, item.instant))
            stamp = head_stamp(item.term)
            if stamp is not None:
                z = stamp[0] + stamp[1] * 1e-9 + (delay or -1)
                instant = stamp[0] * 10**9 + stamp[1]
                stream += [(tick(k, z), instant) for k in range(1, 21)]
        limit_gc_pauses()
        began = time.process_time()
        engine.post_each(stream)
        return Result(name, len(items), time.process_time() - began, outputs.number)

    return case


def head_stamp(term: Any) -> Optional[Tuple[int, int]]:
    """Return the stamp of a transform of the camera's joint."""
    if term[0].name != "tf__0__tfMessage":
        return None
    head = term[1][1][1]
    return (head[2][1], head[2][2][1]) if head[3].name == '"Head"' else None


def join(number: int) -> Callable[[str, bool], Result]:
    """Run ``a seq b`` with a shared variable: N events ``a``, then N events ``b``."""

    def case(name: str, messages: bool) -> Result:
        engine = Engine()
        engine.load(
            goals="set_etalis_flag(event_consumption_policy, unrestricted)\nsubscribe(c(_), [], _, t, i)",
            rules="c(X) <- a(X) seq b(X).",
        )
        outputs = Outputs(engine)
        a, b = functor("a", 1), functor("b", 1)
        stream = [(a(i), BASE * 10**9 + i) for i in range(number)]
        stream += [(b(i), (BASE + 1) * 10**9 + i) for i in range(number)]
        limit_gc_pauses()
        began = time.process_time()
        engine.post_each(stream)
        return Result(name, len(stream), time.process_time() - began, outputs.number)

    return case


CASES: Dict[str, Callable[[str, bool], Result]] = {
    "nao": nao,
    "memories_unrelated_160": with_memories(160, "a(X,Y,Z,W)", "a(X,Y,Z,W)", 2500),
    "memories_all_20": with_memories(20, "tf(X,Y,V,Q)", "tf(X,Y,V,Q)", 2500),
    "memories_all_20_large": with_memories(20, "tf(X,Y,V,Q)", "tf(X,Y,V,Q)", 150_000),
    "memories_all_40": with_memories(40, "tf(X,Y,V,Q)", "tf(X,Y,V,Q)", 2500),
    "memories_pair_640": with_memories(640, PAIR, "tf(V,Q)", 2500),
    "next_128": look_ups("next", 128),
    "prev_128": look_ups("prev", 128),
    "next_16384": look_ups("next", 16384),
    "prev_16384": look_ups("prev", 16384),
    "sync_now": synchronized(0),
    "sync_delayed": synchronized(5),
    "join_seq_1000": join(1000),
    "join_seq_10000": join(10_000),
}
"""Cases that the reference has, too."""

MORE: Dict[str, Callable[[str, bool], Result]] = {
    "nao_renamed": nao_renamed,
    "memories_stop_when_full": stop_when_full,
    "memories_mixed": mixed,
    "look_ups_7000": look_ups_beside(7000, 0),
    "look_ups_14000": look_ups_beside(14_000, 0),
    "look_ups_7000_beside_320": look_ups_beside(7000, 320),
    "look_ups_14000_beside_320": look_ups_beside(14_000, 320),
    "sync_base": synchronized(None),
    "join_seq_1000000": join(1_000_000),
}


FROM_BYTES = [
    name for name in [*CASES, *MORE] if name.startswith(("nao", "memories")) and name != "nao_renamed"
]
"""Cases that accept serialized messages."""


def compare(
    shared: Sequence[str], more: Sequence[str], from_bytes: Sequence[str], options: argparse.Namespace
) -> int:
    """Run all cases alternately and print a table of medians.

    Args:
        shared: cases that the reference has, too.
        more: the other cases.
        from_bytes: cases that accept serialized messages.
        options: options of the command line.
    """
    rows = {}
    for name in [*shared, *more]:
        commands = _commands(name, options, name in shared, name in from_bytes)
        found: Dict[str, List[float]] = {column: [] for column in commands}
        for _ in range(options.runs):
            for column, command in commands.items():
                found[column].append(measure(command))
        rows[name] = {column: statistics.median(values) for column, values in found.items()}
        print(line(name, rows[name]), flush=True)
    result = {"machine": machine(), "runs": options.runs, "cases": rows}
    if options.json:
        Path(options.json).write_text(json.dumps(result, indent=1) + "\n")
    if options.plot:
        from performance_plots import draw_engine

        draw_engine(result, options.plot)
    return 0


def _commands(name: str, options: argparse.Namespace, shared: bool, from_bytes: bool) -> Dict[str, List[str]]:
    """Return the commands of a case, by table column."""
    ours = [sys.executable, str(HERE / "engine.py"), name]
    commands = {"terms": ours}
    if options.against and shared:
        script = Path(options.against) / "bench.pl"
        commands["reference"] = ["swipl", "-g", f"case({name}),halt", str(script)]
    if from_bytes:
        commands["messages"] = [*ours, "--messages"]
    for python in options.python:
        commands[_version(python)] = [python, *ours[1:]]
    return commands


def _version(python: str) -> str:
    shown = subprocess.run([python, "--version"], capture_output=True, text=True, check=True)
    return shown.stdout.strip().lower()


def measure(command: List[str]) -> float:
    """Run one case in its own process; return microseconds per event."""
    result = subprocess.run(command, capture_output=True, text=True, cwd=HERE)
    found = re.search(r"us_per_event ([\d.]+)", result.stdout)
    if found is None:
        raise SystemExit(f"{' '.join(command)} gave no figure:\n{result.stdout}{result.stderr}")
    return float(found.group(1))


def line(name: str, row: Dict[str, Any]) -> str:
    """Return a table row as text."""
    figures = "  ".join(f"{column} {value:8.2f}" for column, value in row.items())
    ratio = f"  1/{row['reference'] / row['terms']:.1f} of the reference" if "reference" in row else ""
    return f"{name:<26} {figures} us{ratio}"


def main() -> int:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", nargs="?", choices=[*CASES, *MORE])
    parser.add_argument("--messages", action="store_true", help="feed message bytes, and count decoding in")
    parser.add_argument("--all", action="store_true", help="all cases, and what they take as a table")
    parser.add_argument("--against", type=existing, help="folder of the reference's bench.pl")
    parser.add_argument("--python", type=interpreter, nargs="+", default=[], help="further interpreters")
    parser.add_argument("--runs", type=positive, default=5)
    parser.add_argument("--json", type=target, help="write the figures there")
    parser.add_argument("--plot", type=target, help="draw them there")
    options = parser.parse_args()
    if options.all:
        return compare(list(CASES), list(MORE), FROM_BYTES, options)
    if options.case is None:
        parser.error("name a case, or --all")
    if options.messages and options.case not in FROM_BYTES:
        parser.error(f"{options.case} has no messages")
    print({**CASES, **MORE}[options.case](options.case, options.messages).line())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
