"""What synchronized queries wait for: a list of ``[MemoryId, Time]``."""

from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from ...foundation import UsageError, shared_function
from ...prolog.logic import Logic
from ...prolog.machine import PrologError
from ...prolog.terms import CONS, Term, Values, Var, deref, list_items, positions, timestamps, variables
from ..dispatch import compile_builder
from .memories import Memories
from .recorder import Instance
from .recording import key_of

Behind = List[Tuple[Instance, int]]
"""Memories that have not got there, and the instants they have to reach."""


def behind(logic: Logic, memories: Memories, conditions: Term) -> Behind:
    """Return what conditions given as a term wait for.

    Raises:
        UsageError: for an unknown memory or something that is no ``[Id, Time]``.
    """
    found: Dict[Instance, int] = {}
    time, instant = None, 0  # most often all wait for one time
    for name, its_time in _pairs(logic, conditions):
        instance = memories.find(name)
        if instance is None:
            raise UsageError(f"there is no memory {logic.brief(name)}")
        if its_time is not time:
            time, instant = its_time, reach(its_time)
        found[instance] = max(instant, found.get(instance, instant))
    return [(instance, instant) for instance, instant in found.items() if not instance.has(instant)]


def compile_conditions(
    logic: Logic, memories: Memories, conditions: Term, names: Sequence[Var]
) -> Optional[Callable[[Values], Behind]]:
    """Return a function of the values of ``names`` that returns what these conditions wait for.

    It raises a `UsageError` as `after` does. None is returned where a value may decide which memories they are.
    """
    try:
        pairs = _pairs(logic, conditions)
        keys = [key_of(name) for name, _ in pairs]
    except (UsageError, PrologError):
        return None
    if not set(variables(conditions)) <= set(names):
        return None
    given: Dict[str, Any] = {
        "get": memories.instances.get,
        "reach": reach,
        "first_reaching": timestamps.first_reaching,
        "no_memory": lambda name: UsageError(f"there is no memory {logic.brief(name)}"),
    }
    places = positions(names)
    lines = ["    missing = []"]
    previous = None
    for at, (key, (name, time)) in enumerate(zip(keys, pairs)):
        given[f"key{at}"], given[f"name{at}"] = key, name
        lines += [
            f"    memory = get(key{at})",
            "    if memory is None:",
            f"        raise no_memory(name{at})",
        ]
        if time is not previous:
            lines += _time(time, names, places, at, given)
        previous = time
        lines += [
            "    ends = memory.memory.ends",
            "    if not ends or ends[-1] < instant:",
            "        missing.append((memory, instant))",
        ]
    source = "\n".join(["def made(values):", *lines, "    return missing", ""])
    found: Callable[[Values], Behind] = shared_function(source, given, "conditions of a synchronized query")
    return found


def _time(
    time: Term, names: Sequence[Var], places: Dict[Var, int], at: int, given: Dict[str, Any]
) -> List[str]:
    """Return the lines that find the instant of a time."""
    if time.__class__ is Var:
        lines = [f"    time = values[{places[time]}]"]
    else:
        given[f"build{at}"] = compile_builder(time, names, "time of a synchronized query")
        lines = [f"    time = build{at}(values)"]
    return [*lines, "    instant = first_reaching(time) if time.__class__ is float else reach(time)"]


def _pairs(logic: Logic, conditions: Term) -> List[Tuple[Term, Term]]:
    """Return ids and times.

    Raises:
        UsageError: for something that is no ``[Id, Time]``.
    """
    items = list_items(conditions)
    if items is None:
        raise UsageError("expected a list of [MemoryId, Time]")
    pairs = []
    for item in items:
        parts = list_items(item)
        if parts is None or len(parts) != 2:
            raise UsageError(f"expected [MemoryId, Time], found {logic.brief(item)}")
        pairs.append((deref(parts[0]), deref(parts[1])))
    return pairs


def reach(time: Term) -> int:
    """Return the instant that a memory has to reach for a time condition.

    Raises:
        UsageError: for what is not a time.
    """
    time = deref(time)
    if time.__class__ is float:
        return timestamps.first_reaching(time)
    if time.__class__ is tuple and time[0] is CONS:
        return timestamps.from_any(time)
    return int(timestamps.from_term(time))
