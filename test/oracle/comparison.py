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
from typing import Any, Callable, Collection, Iterable, Iterator, List, Optional, Sequence, Tuple

from retalis import Engine, RetalisError, StreamClock, Term, atom, functor
from retalis.events.matches import interval_index, match_buffer
from retalis.prolog.terms.timestamps import SECOND

from . import revision
from .goals import show
from .patterns import NO_PROPERTIES, Pattern, Rule
from .strategies import Case, random_case

REFUSED = (
    "uses a pattern to the left of it",
    "the pattern of absent uses a variable",
    "rate needs a window of at least two events",
    "a measured value has a variable",
)
"""What the language refuses and what is drawn all the same."""
Fired = List[Tuple[str, Any, Any]]


def new_engine() -> Engine:
    """Return an engine whose clock is past all stamps of generated streams."""
    return Engine(clock=StreamClock(100_000 * SECOND))


class Reset:
    """An engine for many cases: after each everything of it is reset, which costs less than a new one."""

    def __init__(self, engine: Optional[Engine] = None) -> None:
        self.engine = engine or new_engine()
        self.steps: List[Fired] = []
        self.engine.on_event(lambda *event: self.steps[-1].append(as_text(*event)))

    def ready(self) -> Engine:
        """Return the engine with nothing in it."""
        self.steps = []
        self.engine.rules.reset()
        return self.engine


def as_text(term: Term, start: Any, end: Any) -> Tuple[str, int, int]:
    """Return an event as it is compared."""
    return show(term), int(start), int(end)


def engine_steps(
    texts: Sequence[str],
    goals: str,
    stream: Iterable[Tuple[Term, Any, Any]],
    used: Optional[Reset] = None,
    cuts: Collection[int] = (),
    clocked: bool = False,
) -> List[Fired]:
    """Run rules, one file after the other, over a stream; return what the engine dispatches for each event.

    Before the events whose places are in ``cuts`` its state is taken, and taken up by another engine that goes on.
    """
    if used is None:
        used = Reset(Engine() if clocked else None)
    engine = used.ready()
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
    """Return what the oracle says, in nanoseconds."""
    return [(term, start * SECOND, end * SECOND) for term, start, end in case.expected()]


def in_steps(steps: Iterable[Any]) -> List[Fired]:
    """Return steps with the events of each in one order: which comes first is not defined under revision."""
    return [sorted(step.elements() if isinstance(step, Counter) else step) for step in steps]


def revised_answer(case: Case) -> List[Fired]:
    """Return what the oracle says for each event where events are taken back."""
    steps = revision.run_with_revision(case.rules, case.stream, case.policy, case.out_of_order)
    return in_steps(
        [(term, start * SECOND, end * SECOND) for term, start, end in step.elements()] for step in steps
    )


def is_defined(case: Case) -> bool:
    """Tell whether the oracle says what a case does."""
    return not case.revises() or revision.defined_for(case.rules, case.policy, case.out_of_order)


def difference(case: Case, used: Optional[Reset] = None) -> Optional[Tuple[Any, Any]]:
    """Return what was expected and what the engine did instead, or None where they agree."""
    if not is_defined(case):
        return None
    revises = case.revises()
    clocked = case.has_streams()  # such a case has a clock that follows its stream
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
    """Yield patterns that are a bit simpler: one operator or argument less."""
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
    """Return a name for what a shrunk case is about, so that a difference is shown only once."""
    words = [word for word in case.text().replace("(", " ").replace(")", " ").split() if word.islower()]
    return " ".join(word for word in words if len(word) > 1 and not word.startswith(("out", "v")))


def add_options(parser: argparse.ArgumentParser, cases: int, show: int) -> None:
    """Add the options that say which cases are drawn, and how many differences are shown."""
    parser.add_argument("--cases", type=int, default=cases)
    parser.add_argument("--seed", type=int, default=0, help="number of the first case")
    parser.add_argument("--depth", type=int, default=4)
    parser.add_argument("--show", type=int, default=show, help="how many differences to shrink and print")
    parser.add_argument("--streams", action="store_true", help="windows, shapes and absences with a deadline")
    parser.add_argument("--revision", action="store_true", help="streams that take events back")
    parser.add_argument(
        "--unsure", action="store_true", help="conditions also over variables that may be left open"
    )


def main() -> int:
    """Compare many cases; print those that differ, shrunk."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    add_options(parser, cases=50_000, show=20)
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
    used: Optional[Reset] = None
    for seed in count(options.seed):
        if compared == options.cases:
            break
        case = random_case(seed, options.depth, options.revision, options.unsure, options.streams)
        compared += is_defined(case)
        if used is None or compared % 500 == 0:
            used = None if options.new else Reset()
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
