"""Registration of predicates that are written in Python.

Modules of this package register theirs when they are imported; `Logic` defines all of them.
"""

from typing import Any, Callable, Dict, List, NamedTuple, Tuple


class Entry(NamedTuple):
    """A predicate in Python.

    Attributes:
        kind: "deterministic", "function", "nondeterministic" or "control".
        function: see `Logic.define` and its sisters.
        locked: programs may not define it themselves.
    """

    kind: str
    function: Callable[..., Any]
    locked: bool


ENTRIES: Dict[Tuple[str, int], Entry] = {}


def _register(kind: str, names: Tuple[str, ...], locked: bool) -> Callable[[Any], Any]:
    keys: List[Tuple[str, int]] = []
    for text in names:
        name, _, arity = text.rpartition("/")
        keys.append((name, int(arity)))

    def register(function: Any) -> Any:
        for key in keys:
            ENTRIES[key] = Entry(kind, function, locked)
        return function

    return register


def deterministic(*names: str, locked: bool = True) -> Callable[[Any], Any]:
    """Register ``function(machine, *args) -> bool`` under indicators such as ``"atom_length/2"``."""
    return _register("deterministic", names, locked)


def function(*names: str, locked: bool = True) -> Callable[[Any], Any]:
    """Register ``function(*inputs)``, which returns what the last argument is, or None where it fails."""
    return _register("function", names, locked)


def nondeterministic(*names: str, locked: bool = True) -> Callable[[Any], Any]:
    """Register a generator ``function(machine, *args)``; see `Logic.define_nondeterministic`."""
    return _register("nondeterministic", names, locked)


def control(*names: str, locked: bool = True) -> Callable[[Any], Any]:
    """Register ``function(machine, args, next) -> frame or None``."""
    return _register("control", names, locked)
