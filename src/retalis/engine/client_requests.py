"""Requests of services and of the dashboard: queries with limits, and rules that are added and deleted at run time.

Such a request is not part of the program. It is limited in time, number and length of solutions, and it may not
change flags unless the settings allow it. Answers are converted to text before the engine continues, because bindings
of a solution are undone by the next one.
"""

import json
from contextlib import closing
from itertools import count
from threading import Event
from time import monotonic
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Sequence, TypeVar

from ..events.language.rule_labels import RULE, is_rule, split_label
from ..foundation.displayed_text import format_number
from ..foundation.errors import UsageError
from ..prolog.machine.resource_limits import NO_LIMITS, Limits
from ..prolog.syntax.term_reader import ReadTerm, read_term
from ..prolog.system.value_conversion import to_json
from ..prolog.terms.list_terms import make_list
from ..prolog.terms.term_traversal import term_key
from ..prolog.terms.types import Atom, Term, Var, atom, deref, functor
from .engine import Engine
from .runtime.serial_executor import UNNAMED_REQUEST

MAX_ANSWER_CHARACTERS = 1_000_000
"""Maximum length of all solutions of an answer together, in characters of JSON."""

_WAIT_FUNCTOR = functor("wait_for", 1)
_POLL_SECONDS = 0.2
"""Interval in seconds for checking whether a waiting request can still be completed."""

Result = TypeVar("Result")
_Number = TypeVar("_Number", int, float)


class Binding(NamedTuple):
    """The value of a variable, as text of a term and as JSON."""

    name: str
    text: str
    json: str


class Answer(NamedTuple):
    """Solutions of a goal, each as the values of its variables; ``complete`` is true if there are no others."""

    solutions: List[List[Binding]]
    complete: bool


def ask(
    engine: Engine,
    goal: str,
    max_solutions: int = 100,
    limits: Optional[Limits] = None,
    max_characters: int = MAX_ANSWER_CHARACTERS,
) -> Answer:
    """Return the first solutions of a goal as text.

    Args:
        engine: the engine.
        goal: text of the goal.
        max_solutions: maximum number of solutions.
        limits: limits of this goal, in addition to those of the engine.
        max_characters: maximum length of all solutions together, in characters of JSON.

    Raises:
        SyntaxFault: if the text is not a term.
        PrologError: the error that the goal raised.
        UsageError: if the first solution alone is too long.
    """
    parsed_goal = read_term(goal, engine.operators, "goal")
    names = {name: var for name, var in parsed_goal.names.items() if not name.startswith("_")}
    logic = engine.program.logic

    def collect_solutions() -> Answer:
        solution_bindings: List[List[Binding]] = []
        characters_left = max_characters
        budget = logic.machine.budget
        engine_limits = budget.limits
        budget.set_limits(_combine_limits(engine_limits, limits or NO_LIMITS))
        try:
            with closing(logic.solutions(parsed_goal.term)) as solutions:
                for _ in solutions:
                    # The loop asks for one solution more than is wanted, only to know whether the answer is complete.
                    if len(solution_bindings) >= max_solutions:
                        return Answer(solution_bindings, False)
                    try:
                        # Conversion to text counts against the limits of the goal: a small term can have a huge text.
                        with logic.machine.budget.checking_long_steps():
                            bindings = read_bindings(engine, names, characters_left)
                    except UsageError:
                        if not solution_bindings:
                            raise
                        return Answer(solution_bindings, False)
                    characters_left -= sum(len(value.json) for value in bindings)
                    solution_bindings.append(bindings)
        finally:
            budget.set_limits(engine_limits)
        return Answer(solution_bindings, True)

    # Executed exclusively, so the changed limits of the logic apply to this goal only.
    return run_restricted(engine, collect_solutions, parsed_goal.term)


def run_restricted(engine: Engine, work: Callable[[], Result], work_name: Term = UNNAMED_REQUEST) -> Result:
    """Return the result of a function that is executed exclusively, as by `Engine.do`.

    Its goals, and those of rules that it adds, may not change flags unless the settings allow it.
    """

    def restricted_work() -> Result:
        with engine.program.logic.serving_client():
            return work()

    return engine.do(restricted_work, work_name)


def read_bindings(
    engine: Engine, names: Dict[str, Var], characters_left: int = MAX_ANSWER_CHARACTERS
) -> List[Binding]:
    """Return the values of variables in the current solution.

    Args:
        engine: the engine.
        names: the variables by their names.
        characters_left: maximum length of the values together, in characters of JSON.

    Raises:
        UsageError: if they are longer.
    """
    logic = engine.program.logic
    # One dictionary for all variables, so that a variable in two values gets the same name.
    variable_names: Dict[Var, str] = {}
    bindings = []
    for name, var in names.items():
        as_json = to_json(var, variable_names, characters_left)
        characters_left -= len(as_json)
        bindings.append(Binding(name, logic.show(var, names=variable_names), as_json))
    return bindings


def decode_bindings(bindings: Iterable[Binding]) -> Dict[str, Any]:
    """Return a solution as a dictionary from variable names to plain values."""
    return {binding.name: json.loads(binding.json) for binding in bindings}


def _combine_limits(first: Limits, second: Limits) -> Limits:
    """Return the stricter one of each limit; None is no limit."""
    return Limits(
        _minimum(first.seconds, second.seconds),
        _minimum(first.inferences, second.inferences),
        _minimum(first.megabytes, second.megabytes),
        _minimum(first.output_megabytes, second.output_megabytes),
    )


def _minimum(first: Optional[_Number], second: Optional[_Number]) -> Optional[_Number]:
    return first if second is None else second if first is None else min(first, second)


def wait_for_memories(engine: Engine, memory_ids: Sequence[Term], instant: int, seconds: float) -> None:
    """Wait until each of several memories or transforms has received data that ends at or after a time.

    The engine continues with other work meanwhile.

    Args:
        engine: the engine with the memories.
        memory_ids: ids of the memories, or ``tf(Target, Source)`` for transforms.
        instant: the time to reach, in nanoseconds of the engine's clock.
        seconds: maximum waiting time in real time; the engine's clock may stand still.

    Raises:
        UsageError: for an unknown memory, a memory that is deleted meanwhile, and at the end of the waiting time.
    """
    knowledge = engine.program.knowledge
    all_reached = Event()

    def register() -> Optional[int]:
        missing = knowledge.find_missing_memories(memory_ids, instant)
        waiting_goal = _WAIT_FUNCTOR(make_list(memory_ids))
        now = engine.clock.now()
        return (
            knowledge.pending_queries.notify_when_reached(missing, waiting_goal, now, all_reached.set)
            if missing
            else None
        )

    request_number = engine.do(register)
    if request_number is None:
        return
    deadline = monotonic() + seconds
    try:
        # A deleted memory never sets the event, so the loop checks regularly whether the request still exists.
        while not all_reached.wait(min(_POLL_SECONDS, max(0.0, deadline - monotonic()))):
            if not knowledge.pending_queries.is_waiting(request_number) and not all_reached.is_set():
                raise UsageError("a memory was deleted, or time went back, while the query waited for it")
            if monotonic() >= deadline:
                missing = _describe_missing(engine, memory_ids, instant)
                if not missing:
                    # The last data arrived after the end of the waiting time.
                    return
                raise UsageError(
                    f"no record at the stamp or later in memory {missing} after {format_number(seconds)} s"
                )
    finally:
        # Also after an interrupt: otherwise requests would accumulate in the index of the memory.
        engine.do(lambda: knowledge.pending_queries.withdraw(request_number))


def _describe_missing(engine: Engine, memory_ids: Sequence[Term], instant: int) -> str:
    """Return the memories that have not reached a time, with the missing time; "" if all have reached it."""
    missing_memories = engine.do(lambda: engine.program.knowledge.find_missing_memories(memory_ids, instant))
    descriptions = []
    for instance, required_time in missing_memories:
        latest = instance.latest_end
        delay = (
            "nothing yet"
            if latest is None
            else f"{format_number((required_time - latest) / 1e9)} s too early"
        )
        descriptions.append(f"{engine.brief(instance.id)} ({delay})")
    return ", ".join(descriptions)


_LABEL_PREFIX = "added_"
"""Prefix of the labels of rules that are added without a label."""


def add_rule(engine: Engine, text: str, label: str = "") -> str:
    """Add one event rule with the checks of an event file; return its label, by default its own or a new one.

    Raises:
        SyntaxFault: if the text is not a term.
        ProgramErrors: all other errors in the rule, with their places.
        UsageError: if the text is not an event rule, or the label is in use.
    """
    parsed_rule = read_term(text, engine.operators, "rule")
    rule_term: Any = deref(parsed_rule.term)
    if not is_rule(rule_term):
        raise UsageError("expected one event rule, as in Head <- Pattern")

    # The label is chosen within the exclusive call: another request could use it in between.
    def add() -> str:
        rule_label = _choose_label(engine, parsed_rule, label)
        engine.program.loader.load_read_term(parsed_rule)
        return engine.show(rule_label)

    return run_restricted(engine, add)


def _choose_label(engine: Engine, parsed_rule: ReadTerm, requested: str) -> Term:
    """Return the label of a parsed rule; add one to the rule if it has none."""
    term: Any = deref(parsed_rule.term)
    existing_label, _ = split_label(term)
    label = _parse_label(engine, requested) if requested.strip() else existing_label
    if existing_label is not None and requested.strip() and _strip_properties(existing_label) is not label:
        raise UsageError(
            f"label: the rule has the label {engine.brief(_strip_properties(existing_label))} already"
        )
    used_keys = {
        term_key(_strip_properties(rule.label))
        for rule in engine.program.rules.rules
        if rule.label is not None
    }
    if label is None:
        label = next(
            candidate for candidate in map(_make_label, count(1)) if term_key(candidate) not in used_keys
        )
    if term_key(_strip_properties(label)) in used_keys:
        raise UsageError(f"a rule {engine.brief(_strip_properties(label))} already exists")
    if existing_label is None:
        parsed_rule.term = RULE(label, term)
    return _strip_properties(label)


def delete_rule(engine: Engine, label: str) -> None:
    """Delete all event rules with a label, and their partial matches.

    Raises:
        UsageError: if there are none.
    """
    label_term = _parse_label(engine, label)
    if not engine.do(lambda: engine.program.rules.delete(label_term), UNNAMED_REQUEST):
        raise UsageError(f"there is no rule {engine.brief(label_term)}")


def _parse_label(engine: Engine, text: str) -> Term:
    if not text.strip():
        raise UsageError("label: expected an atom, found an empty text")
    label_term = deref(read_term(text, engine.operators, "label").term)
    if not isinstance(label_term, Atom):
        raise UsageError(f"label: expected an atom, found {engine.brief(label_term)}")
    return label_term


def _make_label(number: int) -> Term:
    return atom(f"{_LABEL_PREFIX}{number}")


def _strip_properties(label: Any) -> Term:
    return label if isinstance(label, Atom) else atom(label[0].name)
