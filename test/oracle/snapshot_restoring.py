"""Comparison of engines with engines that are restored in the middle of a stream; as a command: see README.md."""

import argparse
import logging
import random
import sys
import time
from typing import Any, Collection, List, Optional, Tuple

from asserting_accessors import stream_clock

from retalis import Engine, Limits, RetalisError, Settings, StreamClock, UsageError
from retalis.prolog.terms.timestamps import SECOND

from .clock_programs import ClockProgram, random_clock_program
from .comparison import add_options, as_text, engine_steps, shrink
from .strategies import Case, random_case

MAX_EVENTS = 1000
"""Maximum number of events and outputs of a step of a program; rules that trigger each other may have any number."""

SETTINGS = Settings(limits=Limits(inferences=100 * MAX_EVENTS))


def cut_difference(case: Case, places: Collection[int]) -> Optional[Tuple[Any, Any]]:
    """Return the events of an engine and of engines that are restored at some places; None if they are equal.

    The order of events is compared, too.
    """
    try:
        clocked = case.has_streams()
        expected: Any = engine_steps([case.text()], case.goals(), case.stream, clocked=clocked)
    except RetalisError:
        return None
    try:
        actual: Any = engine_steps([case.text()], case.goals(), case.stream, cuts=places, clocked=clocked)
    except Exception as error:  # noqa: BLE001 - an internal error is a difference too
        actual = f"{type(error).__name__}: {error}"
    return None if actual == expected else (expected, actual)


def cut_case(
    seed: int,
    depth: int,
    revision: bool = False,
    unsure: bool = False,
    streams: bool = False,
    instants: bool = False,
    overlaps: bool = False,
) -> Tuple[Case, List[int]]:
    """Return a random case, and one or two places at which the engine is restored."""
    chance = random.Random(seed)
    case = random_case(seed, depth, revision, unsure, streams, instants, overlaps)
    return case, sorted(
        {chance.randrange(1, max(2, len(case.stream))) for _ in range(chance.choice((1, 1, 2)))}
    )


def clock_steps(program: ClockProgram, cuts: Collection[int] = ()) -> List[List[Any]]:
    """Run a program; return its events and outputs at each step, in order.

    Before the steps in ``cuts`` another engine is restored from the engine's state, and continues.

    Raises:
        RetalisError: if the program is refused, or a step has more events than `MAX_EVENTS`.
    """
    steps: List[List[Any]] = []

    def listen(engine: Engine) -> Engine:
        engine.on_event(lambda *event: steps[-1].append(as_text(*event)))
        engine.on_output(lambda term, topic, name: steps[-1].append((topic, engine.show(term))))
        return engine

    engine = listen(Engine(StreamClock(10 * SECOND), SETTINGS))
    steps.append([])  # a program may emit events while it is loaded
    engine.load(goals=program.goals, rules=program.rules)
    for position, (event, instant) in enumerate(program.steps):
        if position in cuts:
            engine = listen(Engine.restore(engine.snapshot(), clock=StreamClock(), settings=SETTINGS))
        steps.append([])
        stream_clock(engine).move_to(int(instant * SECOND))
        engine.advance()
        if event is not None:
            engine.event(event, instant)
        if len(steps[-1]) > MAX_EVENTS:
            raise UsageError(f"a step has {len(steps[-1])} events: expected at most {MAX_EVENTS}")
    return steps


def clock_difference(seed: int) -> Optional[Tuple[Any, Any]]:
    """Return the steps of a random program, and the steps of a run with restored engines; None if they are equal.

    Raises:
        RetalisError: if the program is refused.
    """
    program, choose = random_clock_program(seed), random.Random(seed)
    cuts = {choose.randrange(len(program.steps)) for _ in range(choose.choice((1, 1, 2, 4)))}
    expected = clock_steps(program)
    try:
        steps: Any = clock_steps(program, cuts)
    except Exception as error:  # noqa: BLE001 - an internal error is a difference too
        steps = f"{type(error).__name__}: {error}"
    return None if steps == expected else (expected, steps)


def compare(options: argparse.Namespace) -> int:
    """Compare cases; print those that differ, shrunk if they also differ when restored at every place."""
    begin, differing = time.time(), 0
    for seed in range(options.seed, options.seed + options.cases):
        case, cuts = cut_case(
            seed,
            options.depth,
            options.revision,
            options.unsure,
            options.streams,
            options.instants,
            options.overlaps,
        )
        difference = cut_difference(case, cuts)
        if difference is None:
            continue
        differing += 1
        if differing <= options.show:
            every = range(len(case.stream))
            if cut_difference(case, every) is not None:
                case = shrink(
                    case,
                    lambda candidate: cut_difference(candidate, range(len(candidate.stream))) is not None,
                )
                difference = cut_difference(case, range(len(case.stream)))
            print(f"seed {seed}: {case!r}\n{difference}", flush=True)
    seeds = f"seeds {options.seed} to {options.seed + options.cases - 1}"
    print(f"{options.cases} cases ({seeds}) cut, {differing} differ, {time.time() - begin:.0f} s")
    return 1 if differing else 0


def compare_clock_programs(options: argparse.Namespace) -> int:
    """Compare random programs of `clock_programs`; print those that differ."""
    begin, differing, refused = time.time(), 0, 0
    for seed in range(options.seed, options.seed + options.cases):
        try:
            difference = clock_difference(seed)
        except RetalisError:
            refused += 1
            continue
        if difference is None:
            continue
        differing += 1
        if differing <= options.show:
            program = random_clock_program(seed)
            print(f"seed {seed}:\n{program.goals}{program.rules}\n{program.steps}\n{difference}", flush=True)
    duration = time.time() - begin
    print(f"{options.cases} programs, {refused} refused, {differing} differ, {duration:.0f} s")
    return 1 if differing else 0


def main() -> int:
    """Compare many cases."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    add_options(parser, cases=10_000, show=5)
    parser.add_argument("--clock", action="store_true", help="programs of everything that the clock moves")
    logging.disable(logging.CRITICAL)
    options = parser.parse_args()
    return compare_clock_programs(options) if options.clock else compare(options)


if __name__ == "__main__":
    sys.exit(main())
