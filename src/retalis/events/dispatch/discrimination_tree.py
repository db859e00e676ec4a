"""Decision trees of the dispatcher: which listeners an event can concern, by the constants in their patterns.

Gates: whether an event can match any listener, tested before it is made.

A message that is taken apart gives many events of which few are wanted. A gate tells from the arguments that
are at hand already, by the same tests that the dispatcher makes, which events nobody listens to.
"""

from collections import Counter
from itertools import chain
from typing import Any, Callable, Dict, Hashable, List, Optional, Tuple, Union

from ...foundation.codegen import Block, Statement, shared_function, source_of
from ...prolog.terms.term_traversal import freeze
from ...prolog.terms.timestamps import LAST, SECOND
from ...prolog.terms.types import Atom, Lazy, String, Term, Var, deref
from .listeners import Listener, ListenerStep

Path = Tuple[int, ...]
Steps = Tuple[ListenerStep, ...]
"""What is left of a plan when all tests are made: pairs of matcher and action, in order."""

NOBODY: Steps = ()


_OTHER = object()
_MAX_TESTS = 6
"""How many tests a plan makes at most; the matchers make the rest."""


def make_plan(listeners: List[Listener]) -> "Plan":
    """Return the steps, or a `SwitchNode` between them, for listeners that are in order."""
    return _plan(listeners, (), _MAX_TESTS)


def takes_all(pattern: Term) -> bool:
    """Tell whether a pattern's arguments are variables, all different."""
    if pattern.__class__ is not tuple:
        return False
    arguments = pattern[1:]
    # Only variables are hashed: the hash of a term goes down as deep as the term does.
    return all(item.__class__ is Var for item in arguments) and len(set(arguments)) == len(arguments)


class SwitchNode:
    """A test of one argument: by its constant or functor it gives the rest of the plan.

    The branches are planned when an event first goes there.
    """

    __slots__ = ("path", "at", "table", "default", "all", "groups", "any", "tested", "depth")

    def __init__(self, path: Path, listeners: List[Listener], tested: Tuple[Path, ...], depth: int):
        self.path = path
        self.at = path[0] if len(path) == 1 else 0
        self.tested = (*tested, path)
        self.depth = depth
        self.groups: Dict[Hashable, List[Listener]] = {}
        for listener in listeners:
            self.groups.setdefault(_key_at(listener.pattern, path), []).append(listener)
        self.any = self.groups.pop(None, [])
        self.table: Dict[Hashable, Optional[Plan]] = dict.fromkeys(self.groups)
        self.default: Optional[Plan] = None
        self.all: Optional[Plan] = None

    def branch(self, term: Any) -> "Plan":
        """Return the rest of the plan for an event."""
        value: Any = term[self.at] if self.at else _walk(term, self.path)
        kind = value.__class__
        if kind is Lazy:
            key: Hashable = value.functor
        elif kind is tuple:
            key = value[0]
        elif kind is Atom or kind is int or kind is String:
            key = value
        elif kind is Var:
            value = deref(value)
            if value.__class__ is Var:
                if self.all is None:
                    self.all = self._among(*self.groups.values())
                return self.all
            key = _key(value)
        else:
            key = _key(value)
        plan: Any = self.table.get(key, _OTHER)
        if plan is _OTHER:
            plan = self.default
            if plan is None:
                plan = self.default = self._among()
        elif plan is None:
            plan = self.table[key] = self._among(self.groups[key])
        return plan  # type: ignore[no-any-return]

    def _among(self, *groups: List[Listener]) -> "Plan":
        """Return the plan of those in some groups and of those who take any value here."""
        listeners = sorted(chain(self.any, *groups), key=_order)
        return _plan(listeners, self.tested, self.depth - 1)


Plan = Union[SwitchNode, Steps]


def _order(listener: Listener) -> Tuple[int, ...]:
    return listener.order


def _plan(listeners: List[Listener], tested: Tuple[Path, ...], depth: int) -> "Plan":
    if not listeners:
        return NOBODY
    path = _best_path(listeners, tested) if depth > 0 else None
    if path is None:
        return tuple([(listener.matcher, listener.action) for listener in listeners])
    return SwitchNode(path, listeners, tested, depth)


def _best_path(listeners: List[Listener], tested: Tuple[Path, ...]) -> Optional[Path]:
    """Return the argument where most of the patterns have a constant; None where no test is worth its cost."""
    found: Dict[Path, int] = Counter()
    for listener in listeners:
        for path in _constant_paths(listener.pattern):
            if path not in tested:
                found[path] += 1
    if not found:
        return None
    path, _ = min(found.items(), key=lambda item: (-item[1], len(item[0]), item[0]))
    return path


def _constant_paths(pattern: Term) -> List[Path]:
    """Return the places of a pattern's constants and of its inner functors, outer ones first."""
    found: List[Path] = []
    level: List[Tuple[Path, Term]] = [((), pattern)]
    while level and len(found) < 32:
        deeper: List[Tuple[Path, Term]] = []
        for path, term in level:
            if term.__class__ is tuple and len(path) < 3:
                for at, argument in enumerate(term[1:], 1):
                    if argument.__class__ is not Var:
                        found.append((*path, at))
                        deeper.append(((*path, at), argument))
        level = deeper
    return found


def _key_at(pattern: Term, path: Path) -> Hashable:
    """Return the key of the constant at a path of a pattern; None where a variable stands there or above."""
    term = pattern
    for at in path:
        if term.__class__ is not tuple or len(term) <= at:
            return None
        term = term[at]
    return None if term.__class__ is Var else _key(term)


def _key(term: Term) -> Hashable:
    if term.__class__ is tuple:
        return term[0]  # type: ignore[no-any-return]
    if term.__class__ is Lazy:
        return term.functor
    return freeze(term)


def _walk(term: Term, path: Path) -> Term:
    """Return what stands at a path of an event; a variable on the way stands for anything below it.

    Where the event has no such place, NOBODY's pattern with a constant there can match; any number will do.
    """
    for at in path:
        term = deref(term)
        if term.__class__ is Var:
            return term
        if term.__class__ is not tuple or len(term) <= at:
            return 0
        term = term[at]
    return term


Passes = Callable[..., bool]
"""Takes seconds, nanoseconds and the arguments at a gate's positions."""


class PushdownFilter:
    """The gate for the events of one functor; made by `Audience.gate`.

    Attributes:
        plan: what the dispatcher does with such events; None while that is not known.
        passes: tells whether an event may concern anybody, or its time is unusual or none.
    """

    __slots__ = ("plan", "passes", "__weakref__")

    plan: Optional[Plan]
    passes: Passes

    def __init__(self, positions: Tuple[int, ...], plan: Optional[Plan]):
        self.plan = plan
        self.passes = _passing(positions)(self)


_TIME = (
    "seconds.__class__ is nanoseconds.__class__ is int and 0 <= seconds < LAST and 0 <= nanoseconds < SECOND"
)
_NAMES = {"Choice": SwitchNode, "Atom": Atom, "NOBODY": NOBODY, "LAST": LAST // SECOND, "SECOND": SECOND}


def _passing(positions: Tuple[int, ...]) -> Callable[[PushdownFilter], Passes]:
    """Return a factory of `PushdownFilter.passes`, which follows the plan as far as it tests known arguments."""
    parameters = ", ".join(["seconds", "nanoseconds", *[f"a{at}" for at in positions]])
    chosen = [
        Block(f"{'if' if number == 0 else 'elif'} at == {at}:", [f"value = a{at}"])
        for number, at in enumerate(positions)
    ]
    walk: List[Statement] = [
        "at = plan.at",
        *chosen,
        Block("else:", ["return True"]),
        Block("if value.__class__ is not Atom:", ["return True"]),
        "plan = plan.table.get(value, plan.default)",
    ]
    body: List[Statement] = [
        "plan = gate.plan",
        *([Block("while plan.__class__ is Choice:", walk)] if positions else []),
        f"return plan is not NOBODY or not ({_TIME})",
    ]
    source = source_of(
        [Block("def made(gate):", [Block(f"def passes({parameters}):", body), "return passes"])]
    )
    made: Callable[[PushdownFilter], Passes] = shared_function(source, _NAMES, "gate")
    return made
