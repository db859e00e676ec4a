"""Engines against engines that take up the state of one another half way; as a command: see README.md."""

import argparse
import logging
import random
import sys
import time
from typing import Any, Collection, List, Optional, Tuple

from retalis import RetalisError

from .comparison import add_options, engine_steps, shrink
from .strategies import Case, random_case


def cut_difference(case: Case, places: Collection[int]) -> Optional[Tuple[Any, Any]]:
    """Return what an engine does, and what engines do that take up its state at some places; None where they agree.

    Here the order of events counts too.
    """
    try:
        clocked = case.has_streams()
        expected: Any = engine_steps([case.text()], case.goals(), case.stream, clocked=clocked)
    except RetalisError:
        return None
    try:
        got: Any = engine_steps([case.text()], case.goals(), case.stream, cuts=places, clocked=clocked)
    except Exception as error:  # noqa: BLE001 - an internal error is a difference too
        got = f"{type(error).__name__}: {error}"
    return None if got == expected else (expected, got)


def cut_case(
    seed: int, depth: int, revision: bool = False, unsure: bool = False, streams: bool = False
) -> Tuple[Case, List[int]]:
    """Return a random case, and one or two places at which its state is taken."""
    chance = random.Random(seed)
    case = random_case(seed, depth, revision, unsure, streams)
    return case, sorted(
        {chance.randrange(1, max(2, len(case.stream))) for _ in range(chance.choice((1, 1, 2)))}
    )


def compare(options: argparse.Namespace) -> int:
    """Compare cases; print those that differ, shrunk where they do so cut everywhere."""
    begin, differing = time.time(), 0
    for seed in range(options.seed, options.seed + options.cases):
        case, cuts = cut_case(seed, options.depth, options.revision, options.unsure, options.streams)
        found = cut_difference(case, cuts)
        if found is None:
            continue
        differing += 1
        if differing <= options.show:
            every = range(len(case.stream))
            if cut_difference(case, every) is not None:
                case = shrink(case, lambda one: cut_difference(one, range(len(one.stream))) is not None)
                found = cut_difference(case, range(len(case.stream)))
            print(f"seed {seed}: {case!r}\n{found}", flush=True)
    seeds = f"seeds {options.seed} to {options.seed + options.cases - 1}"
    print(f"{options.cases} cases ({seeds}) cut, {differing} differ, {time.time() - begin:.0f} s")
    return 1 if differing else 0


def main() -> int:
    """Compare many cases."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    add_options(parser, cases=10_000, show=5)
    logging.disable(logging.CRITICAL)
    return compare(parser.parse_args())


if __name__ == "__main__":
    sys.exit(main())
