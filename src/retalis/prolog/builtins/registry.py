"""Registration of predicates that are written in Python.

Modules of this package register theirs when they are imported; `Logic` defines all of them.
"""

from typing import Callable, Dict, List, NamedTuple, Optional, Tuple, TypeVar

from ..machine import Frame
from .program import Outcome

Function = TypeVar("Function", bound=Callable[..., object])
Test = TypeVar("Test", bound=Callable[..., bool])
Search = TypeVar("Search", bound=Callable[..., Outcome])
Jump = TypeVar("Jump", bound=Callable[..., Optional[Frame]])


class Entry(NamedTuple):
    """A predicate in Python.

    Attributes:
        kind: "deterministic", "function", "nondeterministic" or "control".
        function: see `Logic.define` and its sisters.
        locked: goals that look its clauses up, or assert some, get an error; see `Predicate.system`.
    """

    kind: str
    function: Callable[..., object]
    locked: bool


ENTRIES: Dict[Tuple[str, int], Entry] = {}


def _register(kind: str, names: Tuple[str, ...], locked: bool) -> Callable[[Function], Function]:
    keys: List[Tuple[str, int]] = []
    for text in names:
        name, _, arity = text.rpartition("/")
        keys.append((name, int(arity)))

    def register(function: Function) -> Function:
        for key in keys:
            ENTRIES[key] = Entry(kind, function, locked)
        return function

    return register


def deterministic(*names: str, locked: bool = True) -> Callable[[Test], Test]:
    """Register ``function(machine, *args) -> bool`` under indicators such as ``"atom_length/2"``."""
    return _register("deterministic", names, locked)


def function(*names: str, locked: bool = True) -> Callable[[Function], Function]:
    """Register ``function(*inputs)``, which returns what the last argument is, or None where it fails."""
    return _register("function", names, locked)


def nondeterministic(*names: str, locked: bool = True) -> Callable[[Search], Search]:
    """Register a generator ``function(machine, *args)``; see `Logic.define_nondeterministic`."""
    return _register("nondeterministic", names, locked)


def control(*names: str, locked: bool = True) -> Callable[[Jump], Jump]:
    """Register ``function(machine, args, next) -> frame or None``."""
    return _register("control", names, locked)
