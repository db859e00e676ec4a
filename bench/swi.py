"""Cost of goals in SWI-Prolog that a program calls, and reachability over 2,000 edges beside SWI-Prolog alone.

Usage: bench/swi.py [--runs N] [--limits] [--beside]

The figures are the thread's CPU time of the fastest run, because other load only makes runs slower; that of an empty
loop is subtracted. ``--limits`` gives the engine the default limits of nodes; ``--beside`` measures the wall time of
another process for a goal of the same size, through a pipe and back.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Callable

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

from arguments import positive  # noqa: E402

from retalis import Engine, Limits, Settings, StreamClock, limit_gc_pauses  # noqa: E402

CALLS, SOLUTIONS = 2_000, 20_000

KB = """\
:- module(swi_bench, [inc/2, upto/2, same/2, reach/2, reached/2, reachable/2]).
inc(X, Y) :- Y is X + 1.
upto(N, X) :- between(1, N, X).
same(X, X).
:- dynamic edge/2.
:- forall(between(0, 1999, K), (X is K mod 1000, Y is (X + 1 + 30 * (K // 1000)) mod 1000, assertz(edge(X, Y)))).
% The tables are given up before each question: what is known already would cost nothing.
:- table path/2.
path(X, Y) :- edge(X, Y).
path(X, Y) :- path(X, Z), edge(Z, Y).
reach(X, Y) :- abolish_all_tables, path(X, Y).
reached(X, Y) :- once(reach(X, Y)).
reachable(X, Found) :- findall(Y, reach(X, Y), Found).
"""

RULES = """\
:- use_swi('swi_bench.pl').
none(_, _).
calls(0).
calls(N) :- N > 0, inc(N, _), M is N - 1, calls(M).
empty(0).
empty(N) :- N > 0, none(N, _), M is N - 1, empty(M).
terms(0).
terms(N) :- N > 0, same(pose([N, 1.5], frame(map, "text")), _), M is N - 1, terms(M).
found(L) <- asked_once(X) where reachable(X, L).
found <- asked_whether(X, Y) where reached(X, Y).
count(N) <- asked_count(X) where (findall(Y, reach(X, Y), L), length(L, N)).
"""

BESIDE = """\
serve :- fast_read(user_input, Goal), ignore(call(Goal)), fast_write(user_output, Goal), flush_output, serve.
:- set_stream(user_input, encoding(octet)), set_stream(user_output, encoding(octet)).
"""


def fastest(work: Callable[[], object], runs: int, clock: Callable[[], float] = time.thread_time) -> float:
    """Return the seconds of the fastest run."""
    found = []
    for _ in range(runs):
        start = clock()
        work()
        found.append(clock() - start)
    return min(found)


def goals(engine: Engine, runs: int) -> None:
    """Print the cost of a call and of a further solution."""

    def took(goal: str) -> float:
        return fastest(lambda: engine.query(goal), runs)

    empty = took(f"empty({CALLS})")
    for text, goal in (("a call, inc(3, X)", "calls"), ("a call with terms of 6 parts both ways", "terms")):
        print(f"{text}: {(took(f'{goal}({CALLS})') - empty) / CALLS * 1e6:.1f} us")
    each = took(f"forall(upto({SOLUTIONS}, _), true)") - took(f"forall(between(1, {SOLUTIONS}, _), true)")
    print(f"a further solution: {each / SOLUTIONS * 1e6:.1f} us")


def reachability(engine: Engine, folder: Path, runs: int) -> None:
    """Print the cost of an event that computes reachability, and the cost in SWI-Prolog alone."""
    goal = (
        "forall(between(1, 20, _), (statistics(cputime, A), reachable(0, L), statistics(cputime, B), "
        "length(L, N), C is (B - A) * 1000, format('~w ~w~n', [C, N])))"
    )
    command = ["swipl", "-q", "-f", "none", "-g", goal, "-t", "halt", str(folder / "swi_bench.pl")]
    lines = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout.split("\n")[:-1]
    alone = min(float(line.split()[0]) for line in lines)
    print(f"reachability alone: {alone:.2f} ms for {lines[0].split()[1]} answers")
    for text, event in (
        ("whether it is so", "asked_whether(0, 999)"),
        ("as one list", "asked_once(0)"),
        ("one by one, as a list here", "asked_count(0)"),
    ):
        took = 1e3 * fastest(lambda event=event: engine.event(event), runs)  # type: ignore[misc]
        print(f"reachability by an event, {text}: {took:.2f} ms, {took / alone:.2f} times that")


def beside(folder: Path, runs: int) -> None:
    """Print the cost of a goal in another process, without parsing its answer."""
    (folder / "beside.pl").write_text(BESIDE + KB.split("\n", 1)[1])
    write = "set_stream(user_output, encoding(octet)), fast_write(user_output, inc(3, _)), flush_output"
    said = subprocess.run(["swipl", "-q", "-g", write, "-t", "halt"], stdout=subprocess.PIPE, check=True)
    command = ["swipl", "-q", "-f", "none", "-g", "serve", str(folder / "beside.pl")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0) as served:
        assert served.stdin is not None
        assert served.stdout is not None
        into, out = served.stdin.fileno(), served.stdout.fileno()

        def ask() -> None:
            os.write(into, said.stdout)
            os.read(out, 4096)

        times = sorted(fastest(ask, 1, time.perf_counter) for _ in range(runs * 500))
        served.kill()
    for text, part in (("fastest", 0.0), ("median", 0.5), ("1 of 100", 0.99)):
        print(f"a goal in a process beside, {text}: {times[int(part * len(times))] * 1e6:.1f} us")


def main() -> None:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=positive, default=15)
    parser.add_argument("--limits", action="store_true")
    parser.add_argument("--beside", action="store_true")
    options = parser.parse_args()
    limit_gc_pauses()
    limits = Limits(seconds=10.0, megabytes=500) if options.limits else Limits()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "swi_bench.pl").write_text(KB)
        engine = Engine(StreamClock(0), Settings(allow_swi=True, limits=limits))
        engine.load_rules(RULES, "rules.txt", folder)
        goals(engine, options.runs)
        reachability(engine, folder, options.runs)
        if options.beside:
            beside(folder, options.runs)


if __name__ == "__main__":
    main()
