"""Questions to a running program by others than itself: bounded in time, number and length, with answers as text.

Event rules that others add and delete while the program runs.
"""

from contextlib import closing
from itertools import count
from threading import Event
from time import monotonic
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, TypeVar

from ..events.language.rule_parser import RULE, is_rule, labelled
from ..foundation.errors import UsageError
from ..prolog.machine.resource_limits import NO_LIMITS, Limits
from ..prolog.syntax.term_reader import ReadTerm, read_term
from ..prolog.system.value_conversion import to_json
from ..prolog.terms.list_terms import make_list
from ..prolog.terms.term_traversal import term_key
from ..prolog.terms.types import Atom, Term, Var, atom, deref, functor
from .engine import Engine
from .program_loader import REQUEST

MAX_ANSWER_CHARACTERS = 1_000_000
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
    engine: Engine,
    goal: str,
    most: int = 100,
    limits: Optional[Limits] = None,
    largest: int = MAX_ANSWER_CHARACTERS,
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
    logic = engine.logic

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
        with engine.logic.for_others():
            return work()

    return engine.do(locked, what)


def _values(engine: Engine, names: Dict[str, Var], most: int) -> List[Binding]:
    """Return the values of variables in the solution at hand."""
    logic = engine.logic
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
    knowledge = engine.knowledge
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
    late = engine.do(lambda: engine.knowledge.behind(names, instant))
    said = []
    for one, wanted in late:
        latest = one.memory.latest
        how = "nothing yet" if latest is None else f"{(wanted - latest) / 1e9:g} s too early"
        said.append(f"{engine.brief(one.id)} ({how})")
    return f"no record at the stamp or later in memory {', '.join(said)}"


_NEW = "added_"
"""How the label of a rule begins that was given none."""


def add_rule(engine: Engine, text: str, label: str = "") -> str:
    """Add one event rule, with the checks of an event file; return the label by which `delete_rule` knows it.

    Args:
        engine: takes it.
        text: the rule.
        label: its label; by default its own, or a new one.

    Raises:
        SyntaxFault: for a text that is not a term.
        ProgramErrors: what else is wrong in it, each with its place.
        UsageError: for what is no rule, and for a label that is taken.
    """
    read = read_term(text, engine.operators, "rule")
    term: Any = deref(read.term)
    if not is_rule(term):
        raise UsageError("expected one event rule, as in Head <- Pattern")

    def work() -> str:
        name = _label(engine, read, label)
        engine.rules.loader.load_read(read)
        return engine.show(name)

    return do_for_others(engine, work)


def _label(engine: Engine, read: ReadTerm, wanted: str) -> Term:
    """Return the label of a rule that was read, which is given one where it has none."""
    term: Any = deref(read.term)
    own, _ = labelled(term)
    name = _named(engine, wanted) if wanted.strip() else own
    if own is not None and wanted.strip() and _name_of(own) is not name:
        raise UsageError(f"label: the rule has the label {engine.brief(_name_of(own))} already")
    taken = {term_key(_name_of(rule.label)) for rule in engine.rules.rules if rule.label is not None}
    if name is None:
        name = next(one for one in map(_numbered, count(1)) if term_key(one) not in taken)
    if term_key(_name_of(name)) in taken:
        raise UsageError(f"a rule {engine.brief(_name_of(name))} already exists")
    if own is None:
        read.term = RULE(name, term)
    return _name_of(name)


def delete_rule(engine: Engine, label: str) -> None:
    """Delete the event rules with a label, and what waits in them.

    Raises:
        UsageError: where there are none.
    """
    name = _named(engine, label)
    if not engine.do(lambda: engine.rules.delete(name), REQUEST):
        raise UsageError(f"there is no rule {engine.brief(name)}")


def _named(engine: Engine, text: str) -> Term:
    """Return the label that a text is."""
    if not text.strip():
        raise UsageError("label is empty")
    name = deref(read_term(text, engine.operators, "label").term)
    if not isinstance(name, Atom):
        raise UsageError(f"label: expected an atom, found {engine.brief(name)}")
    return name


def _numbered(number: int) -> Term:
    return atom(f"{_NEW}{number}")


def _name_of(label: Any) -> Term:
    """Return a label without its properties."""
    return label if isinstance(label, Atom) else atom(label[0].name)
