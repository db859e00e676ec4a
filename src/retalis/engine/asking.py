"""Questions to a running program by others than itself: bounded in time, number and length, with answers as text."""

from contextlib import closing
from threading import Event
from time import monotonic
from typing import Callable, Dict, List, NamedTuple, Optional, Sequence, TypeVar

from ..foundation import UsageError
from ..prolog.foreign import to_json
from ..prolog.machine import NO_LIMITS, Limits
from ..prolog.syntax import read_term
from ..prolog.terms import Term, Var, functor, make_list
from .core import EngineCore, parts_of
from .engine import Engine
from .ownfiles import REQUEST

LARGEST = 1_000_000
"""Characters that all solutions of an answer may have together, as JSON."""

WAITING = functor("wait_for", 1)
_LOOK_AGAIN = 0.2
"""Seconds after which one who waits for memories looks whether he still does."""

T = TypeVar("T")
_Number = TypeVar("_Number", int, float)


class Binding(NamedTuple):
    """What a variable is bound to, as a term's text and as JSON."""

    name: str
    text: str
    json: str


class Answer(NamedTuple):
    """Solutions of a goal; ``complete`` where these are all of them."""

    solutions: List[List[Binding]]
    complete: bool


def ask(
    engine: Engine, goal: str, most: int = 100, limits: Optional[Limits] = None, largest: int = LARGEST
) -> Answer:
    """Return the first solutions of a goal, as texts.

    Args:
        engine: is asked.
        goal: the goal's text.
        most: solutions that are wanted.
        limits: of this goal; those of the engine hold besides.
        largest: characters that the solutions may have together.

    Raises:
        SyntaxFault: for a text that is not a term.
        PrologError: what the goal raised.
        UsageError: where the first solution alone is too long.
    """
    read = read_term(goal, engine.operators, "goal")
    names = {name: var for name, var in read.names.items() if not name.startswith("_")}
    logic = parts_of(engine).logic

    def work() -> Answer:
        found: List[List[Binding]] = []
        left = largest
        before = logic.limits
        logic.limits = _tighter(before, limits or NO_LIMITS)
        try:
            with closing(logic.solutions(read.term)) as solutions:
                for _ in solutions:
                    if len(found) >= most:
                        return Answer(found, False)
                    try:
                        with logic.machine.budget.watching():
                            values = _values(engine, names, left)
                    except UsageError:
                        if not found:
                            raise
                        return Answer(found, False)
                    left -= sum(len(value.json) for value in values)
                    found.append(values)
        finally:
            logic.limits = before
        return Answer(found, True)

    return do_for_others(engine, work, read.term)


def do_for_others(engine: Engine, work: Callable[[], T], what: Term = REQUEST) -> T:
    """Do a piece of work, see `Engine.do`; its goals, and those that it gives the program, may not change flags."""

    def locked() -> T:
        with parts_of(engine).logic.for_others():
            return work()

    return engine.do(locked, what)


def _values(engine: EngineCore, names: Dict[str, Var], most: int) -> List[Binding]:
    """Return the values of variables in the solution at hand."""
    logic = parts_of(engine).logic
    unbound: Dict[Var, str] = {}
    values = []
    for name, var in names.items():
        as_json = to_json(var, unbound, most)
        most -= len(as_json)
        values.append(Binding(name, logic.show(var, names=unbound), as_json))
    return values


def _tighter(one: Limits, other: Limits) -> Limits:
    return Limits(
        _least(one.seconds, other.seconds),
        _least(one.inferences, other.inferences),
        _least(one.megabytes, other.megabytes),
        _least(one.output_megabytes, other.output_megabytes),
    )


def _least(one: Optional[_Number], other: Optional[_Number]) -> Optional[_Number]:
    return one if other is None else other if one is None else min(one, other)


def await_memories(engine: Engine, names: Sequence[Term], instant: int, seconds: float) -> None:
    """Return when each of some memories has taken an event that ends at an instant or later; others work meanwhile.

    Args:
        engine: whose memories they are.
        names: their ids.
        instant: in nanoseconds.
        seconds: to wait at most, by the clock on the wall: that of the program may stand still.

    Raises:
        UsageError: for an unknown memory, one that is deleted meanwhile, and where the time is up.
    """
    knowledge = parts_of(engine).knowledge
    arrived = Event()

    def begin() -> Optional[int]:
        missing = knowledge.behind(names, instant)
        named = WAITING(make_list(names))
        now = engine.clock.now()
        return knowledge.waiting.await_all(missing, named, now, arrived.set) if missing else None

    order = engine.do(begin)
    if order is None:
        return
    end = monotonic() + seconds
    try:
        while not arrived.wait(min(_LOOK_AGAIN, max(0.0, end - monotonic()))):
            if not knowledge.waiting.waits(order) and not arrived.is_set():
                raise UsageError("a memory was deleted, or time went back, while the query waited for it")
            if monotonic() >= end:
                raise UsageError(f"{_late(engine, names, instant)} after {seconds:g} s")
    finally:
        engine.do(lambda: knowledge.waiting.withdraw(order))


def _late(engine: Engine, names: Sequence[Term], instant: int) -> str:
    """Return which memories have not got to an instant, and how far behind they are."""
    late = engine.do(lambda: parts_of(engine).knowledge.behind(names, instant))
    said = []
    for one, wanted in late:
        latest = one.memory.latest
        how = "nothing yet" if latest is None else f"{(wanted - latest) / 1e9:g} s too early"
        said.append(f"{engine.brief(one.id)} ({how})")
    return f"no record at the stamp or later in memory {', '.join(said)}"
