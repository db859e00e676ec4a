"""The engine against the oracle: one case, many cases, and the smallest case that still differs.

As a command: see README.md.
"""

import argparse
import logging
import sys
import time
from collections import Counter
from dataclasses import fields, replace
from itertools import count
from random import Random
from typing import Any, Callable, Collection, Iterable, Iterator, List, Optional, Sequence, Tuple

from retalis import Engine, RetalisError, StreamClock, Term, atom, functor
from retalis.events.matches import interval_index, match_buffer
from retalis.prolog.terms.timestamps import SECOND

from . import retraction
from .goal_evaluator import show
from .nested_absence_cases import NestedAbsences
from .pattern_classes import NO_PROPERTIES, Pattern, Rule
from .strategies import Case, random_case

REFUSED = (
    "uses a pattern to the left of it",
    "the pattern of absent uses a variable",
    "the pattern of not_preceded uses a variable",
    "the time of absent depends on a condition",
    "absent needs a positive number of seconds, or a variable that",
    "rate needs a window of at least two events",
    "a measured value has a variable",
)
"""Errors of programs that the language refuses, which `strategies` generates nevertheless."""
Fired = List[Tuple[str, Any, Any]]


def new_engine() -> Engine:
    """Return an engine whose clock is past all stamps of generated streams."""
    return Engine(clock=StreamClock(100_000 * SECOND))


class ReusableEngine:
    """An engine for many cases, which is reset before each of them: faster than a new engine."""

    def __init__(self, engine: Optional[Engine] = None) -> None:
        self.engine = engine or new_engine()
        self.steps: List[Fired] = []
        self.engine.on_event(lambda *event: self.steps[-1].append(as_text(*event)))

    def reset(self) -> Engine:
        """Return the engine without rules and state."""
        self.steps = []
        self.engine.rules.reset()
        return self.engine


def as_text(term: Term, start: Any, end: Any) -> Tuple[str, int, int]:
    """Return an event in the form in which events are compared."""
    return show(term), int(start), int(end)


def engine_steps(
    texts: Sequence[str],
    goals: str,
    stream: Iterable[Tuple[Term, Any, Any]],
    used: Optional[ReusableEngine] = None,
    cuts: Collection[int] = (),
    clocked: bool = False,
) -> List[Fired]:
    """Run rules, one file after the other, over a stream; return the dispatched events for each event.

    Before the events at the positions in ``cuts``, another engine is restored from the engine's state, and continues.
    """
    if used is None:
        used = ReusableEngine(Engine() if clocked else None)
    engine = used.reset()
    steps = used.steps
    engine.load(goals=goals)
    for text in texts:
        engine.load(rules=text)
    for position, (term, start, end) in enumerate(stream):
        if position in cuts:
            engine = Engine.restore(engine.snapshot())
            engine.on_event(lambda *event: steps[-1].append(as_text(*event)))
        steps.append([])
        engine.event(term, start, end)
    return steps


def engine_events(texts: Sequence[str], goals: str, stream: Iterable[Tuple[Term, Any, Any]]) -> Fired:
    """Run rules over a stream and return all events that the engine dispatches."""
    return [event for step in engine_steps(texts, goals, stream) for event in step]


def answer(case: Case) -> Fired:
    """Return the events that the oracle derives, with times in ns."""
    return [(term, start * SECOND, end * SECOND) for term, start, end in case.expected()]


def in_steps(steps: Iterable[Any]) -> List[Fired]:
    """Return steps with sorted events, because revision defines no order within a step."""
    return [sorted(step.elements() if isinstance(step, Counter) else step) for step in steps]


def revised_answer(case: Case) -> List[Fired]:
    """Return the events that the oracle derives at each step of a stream with retractions."""
    steps = retraction.run_with_retraction(case.rules, case.stream, case.policy, case.out_of_order)
    return in_steps(
        [(term, start * SECOND, end * SECOND) for term, start, end in step.elements()] for step in steps
    )


def may_set_clock_back(case: Case) -> bool:
    """Return whether a clock that follows the events of a case may return from a step of more than ten seconds."""
    ends = [end for _, _, end in case.stream]
    for position, end in enumerate(ends):
        is_step = position > 0 and end > max(ends[:position]) + 10
        # No event precedes the first one, so only much earlier times after it show that it was a step.
        limit = end if is_step else end - 10
        if (is_step or not position) and sum(later_end < limit for later_end in ends[position + 1 :]) >= 3:
            return True
    return False


def is_defined(case: Case) -> bool:
    """Return whether the oracle defines the results of a case."""
    if case.has_streams() and may_set_clock_back(case):
        return False
    return not case.revises() or retraction.defined_for(case.rules, case.policy, case.out_of_order)


def difference(case: Case, used: Optional[ReusableEngine] = None) -> Optional[Tuple[Any, Any]]:
    """Return the expected and the actual events of a case, or None if they are equal."""
    if not is_defined(case):
        return None
    revises = case.revises()
    clocked = case.has_streams()  # these cases have a clock that follows the stream
    try:
        expected: Any = revised_answer(case) if revises else answer(case)
    except RecursionError:
        return None
    try:
        steps = engine_steps(
            [case.text()], case.goals(), case.stream, None if clocked else used, clocked=clocked
        )
        actual: Any = in_steps(steps) if revises else sum(steps, [])
    except RetalisError as error:
        if clocked and any(refusal in str(error) for refusal in REFUSED):
            return None
        actual = f"refused: {error}"
    except Exception as error:  # noqa: BLE001 - an internal error is a difference too
        actual = f"{type(error).__name__}: {error}"
    return None if actual == expected else (expected, actual)


# The smallest case.


def smaller_patterns(node: Pattern) -> Iterator[Pattern]:
    """Yield patterns with one operator or argument less."""
    for field in fields(node):
        part = getattr(node, field.name)
        if isinstance(part, Pattern):
            yield part
            for simpler in smaller_patterns(part):
                yield replace(node, **{field.name: simpler})


def smaller_rules(rule: Rule) -> Iterator[Rule]:
    """Yield simpler rules."""
    for pattern in smaller_patterns(rule.pattern):
        yield replace(rule, pattern=pattern)
    if rule.has_properties() or rule.label is not None:
        yield replace(rule, window=None, label=None, **NO_PROPERTIES)
    for name, default in NO_PROPERTIES.items():
        if getattr(rule, name) != default:
            yield replace(rule, **{name: default})
    if rule.do is not None:
        yield replace(rule, do=None)
    if rule.head.__class__ is tuple:
        for position in range(1, len(rule.head)):
            arguments = rule.head[1:position] + rule.head[position + 1 :]
            name = rule.head[0].name
            yield replace(rule, head=functor(name, len(arguments))(*arguments) if arguments else atom(name))


def smaller(case: Case) -> Iterator[Case]:
    """Yield simpler cases."""
    for position in range(len(case.stream)):
        yield replace(case, stream=case.stream[:position] + case.stream[position + 1 :])
    for position in range(len(case.rules)):
        if len(case.rules) > 1:
            yield replace(case, rules=case.rules[:position] + case.rules[position + 1 :])
    if case.out_of_order:
        yield replace(case, out_of_order=False)
    if case.neutral:
        yield replace(case, neutral=())
    for position, rule in enumerate(case.rules):
        for simpler in smaller_rules(rule):
            yield replace(case, rules=(*case.rules[:position], simpler, *case.rules[position + 1 :]))


def shrink(case: Case, fails: Callable[[Case], bool]) -> Case:
    """Return a minimal case that still fails."""
    while True:
        for candidate in smaller(case):
            if fails(candidate):
                case = candidate
                break
        else:
            return case


def report(case: Case) -> str:
    """Describe a case that differs."""
    outcome = difference(case)
    assert outcome is not None
    expected, actual = outcome

    def line(events: Any) -> str:
        if isinstance(events, str):
            return events
        if events and isinstance(events[0], list):  # step by step
            return " | ".join(line(step) for step in events)
        return " ".join(f"{t}@{float(s / SECOND):g}-{float(e / SECOND):g}" for t, s, e in events)

    return f"{case!r}\nexpected {line(expected)}\n     got {line(actual)}\n"


def kind_of(case: Case) -> str:
    """Return the operators of a shrunk case as text, so that each kind of difference is shown only once."""
    words = [word for word in case.text().replace("(", " ").replace(")", " ").split() if word.islower()]
    return " ".join(word for word in words if len(word) > 1 and not word.startswith(("out", "v")))


def add_options(parser: argparse.ArgumentParser, cases: int, show: int) -> None:
    """Add the options for the generated cases and the number of printed differences."""
    parser.add_argument("--cases", type=int, default=cases)
    parser.add_argument("--seed", type=int, default=0, help="number of the first case")
    parser.add_argument("--depth", type=int, default=4)
    parser.add_argument("--show", type=int, default=show, help="how many differences to shrink and print")
    parser.add_argument("--streams", action="store_true", help="windows, shapes and absences with a deadline")
    parser.add_argument("--revision", action="store_true", help="streams that take events back")
    parser.add_argument("--instants", action="store_true", help="at_end and at_start, too")
    parser.add_argument("--overlaps", action="store_true", help="without, too")
    parser.add_argument(
        "--unsure", action="store_true", help="conditions also over variables that may be left open"
    )


def _draw_case(seed: int, options: argparse.Namespace) -> Case:
    if options.nested:
        return NestedAbsences(Random(seed).choice, revision=True, overlaps=options.overlaps).case(
            options.depth
        )
    return random_case(
        seed,
        options.depth,
        options.revision,
        options.unsure,
        options.streams,
        options.instants,
        options.overlaps,
    )


def main() -> int:
    """Compare many cases; print those that differ, shrunk."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    add_options(parser, cases=50_000, show=20)
    parser.add_argument("--nested", action="store_true", help="absences in absences, with retractions")
    parser.add_argument("--index", action="store_true", help="find partners by time however few wait")
    parser.add_argument("--new", action="store_true", help="a new engine for each case; else one is reset")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    if options.index:
        match_buffer.MAX_MISSES_BEFORE_INDEX = match_buffer.MAX_MISSES_WITH_INDEX = 0
        match_buffer.MAX_COMPARED_IDENTITIES = 0
        interval_index.MAX_NODE_KEYS = 4
    begin = time.time()
    kinds: Any = Counter()
    differing = 0
    compared = 0
    used: Optional[ReusableEngine] = None
    for seed in count(options.seed):
        if compared == options.cases:
            break
        case = _draw_case(seed, options)
        compared += is_defined(case)
        if used is None or compared % 500 == 0:
            used = None if options.new else ReusableEngine()
        if difference(case, used) is None:
            continue
        differing += 1
        if difference(case) is None:
            print(f"seed {seed}: only in an engine that was reset", flush=True)
            continue
        if sum(1 for number in kinds.values() if number) < options.show:
            small = shrink(case, lambda candidate: difference(candidate) is not None)
            kind = kind_of(small)
            kinds[kind] += 1
            if kinds[kind] == 1:
                print(f"seed {seed} {report(small)}", flush=True)
    seeds = f"seeds {options.seed} to {seed - 1}"
    print(f"{compared} cases ({seeds}), {differing} differ, {time.time() - begin:.0f} s")
    for kind, number in kinds.most_common():
        print(f"{number:6} {kind}")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
