"""Discrimination tree over the patterns of listeners, and filters that drop events before they are created.

This is the alpha side of a Rete network. The plan for the events of one functor is a tree of `SwitchNode`, each of
which tests one argument by its constant or functor, as ``switch_on_constant`` and ``switch_on_structure`` of the WAM
do. A leaf is the sequence of matchers and actions that remain (`Steps`). A node tests the argument where most
patterns have a constant; patterns with a variable there appear in every branch. Branches are built when an event
first reaches them, so a tree has the size of the data, not of all combinations.

A `PushdownFilter` follows the same tree with the arguments that are known before an event term exists (predicate
pushdown). If a message is split into many events and few are needed, it is filtered without creating terms.
"""

from collections import Counter
from itertools import chain
from operator import attrgetter
from typing import Any, Callable, Dict, Hashable, List, Optional, Tuple, Union

from ...foundation.codegen import Block, Statement, shared_function, source_of
from ...prolog.terms.term_traversal import freeze
from ...prolog.terms.timestamps import END_INSTANT, SECOND
from ...prolog.terms.types import Atom, Lazy, String, Term, Var, deref
from .listeners import Listener, ListenerStep

Path = Tuple[int, ...]
Steps = Tuple[ListenerStep, ...]
"""Leaf of a plan: pairs of matcher and action, in order."""

NO_LISTENERS: Steps = ()


_UNKNOWN_KEY = object()
"""Default of look-ups in `SwitchNode.table`, in which None is a branch that is not built yet."""
_MAX_TESTS = 6
"""Maximum depth of a plan; the matchers test the remaining arguments."""
_MAX_ANALYSED_PATHS, _MAX_PATH_LENGTH = 32, 3
"""Limits of the analysis of a pattern: number of paths, and length of a path."""


def make_plan(listeners: List[Listener]) -> "Plan":
    """Return the plan for listeners that are in order: a `SwitchNode` or the steps."""
    return _build_plan(listeners, (), _MAX_TESTS)


def matches_all_events(pattern: Term) -> bool:
    """Return whether all arguments of a pattern are distinct variables."""
    if pattern.__class__ is not tuple:
        return False
    arguments = pattern[1:]
    # Only variables are hashed: the hash of a term goes down as deep as the term does.
    return all(argument.__class__ is Var for argument in arguments) and len(set(arguments)) == len(arguments)


class SwitchNode:
    """Test of one argument, whose constant or functor selects the rest of the plan.

    Branches are built when an event first reaches them.

    Attributes:
        path: argument positions from the root of the event to the tested term.
        argument_position: position of the argument for a path of length 1, else 0.
        table: built branches by key; None for a branch that is not built yet.
        default: branch for keys that no pattern has; None until it is built.
        variable_branch: branch for events with a variable at the path; None until it is built.
        listeners_by_key: listeners whose pattern has a constant or functor at the path, by key.
        variable_listeners: listeners whose pattern has a variable there.
        tested_paths: paths of this node and all nodes above it.
        remaining_tests: number of tests that may follow, including this one.
    """

    __slots__ = (
        "path",
        "argument_position",
        "table",
        "default",
        "variable_branch",
        "listeners_by_key",
        "variable_listeners",
        "tested_paths",
        "remaining_tests",
    )

    def __init__(
        self, path: Path, listeners: List[Listener], tested_paths: Tuple[Path, ...], remaining_tests: int
    ):
        self.path = path
        self.argument_position = path[0] if len(path) == 1 else 0
        self.tested_paths = (*tested_paths, path)
        self.remaining_tests = remaining_tests
        self.listeners_by_key: Dict[Hashable, List[Listener]] = {}
        for listener in listeners:
            self.listeners_by_key.setdefault(_key_at(listener.pattern, path), []).append(listener)
        self.variable_listeners = self.listeners_by_key.pop(None, [])
        self.table: Dict[Hashable, Optional[Plan]] = dict.fromkeys(self.listeners_by_key)
        self.default: Optional[Plan] = None
        self.variable_branch: Optional[Plan] = None

    def branch(self, term: Any) -> "Plan":
        """Return the rest of the plan for an event."""
        value: Any = term[self.argument_position] if self.argument_position else _subterm_at(term, self.path)
        argument_class = value.__class__
        if argument_class is Lazy:
            key: Hashable = value.functor
        elif argument_class is tuple:
            key = value[0]
        elif argument_class is Atom or argument_class is int or argument_class is String:
            key = value
        # Bound variables are rare here, because most events are built without them, so they are tested last.
        elif argument_class is Var:
            value = deref(value)
            if value.__class__ is Var:
                # An unbound variable in an event can unify with every constant: all patterns remain candidates.
                if self.variable_branch is None:
                    self.variable_branch = self._build_plan_of_groups(*self.listeners_by_key.values())
                return self.variable_branch
            key = _discrimination_key(value)
        else:
            key = _discrimination_key(value)
        plan: Any = self.table.get(key, _UNKNOWN_KEY)
        if plan is _UNKNOWN_KEY:
            plan = self.default
            if plan is None:
                plan = self.default = self._build_plan_of_groups()
        elif plan is None:
            plan = self.table[key] = self._build_plan_of_groups(self.listeners_by_key[key])
        return plan  # type: ignore[no-any-return]

    def _build_plan_of_groups(self, *groups: List[Listener]) -> "Plan":
        """Return the plan for the listeners of some groups and those with a variable at the path."""
        listeners = sorted(chain(self.variable_listeners, *groups), key=attrgetter("order"))
        return _build_plan(listeners, self.tested_paths, self.remaining_tests - 1)


Plan = Union[SwitchNode, Steps]


def _build_plan(listeners: List[Listener], tested_paths: Tuple[Path, ...], remaining_tests: int) -> "Plan":
    if not listeners:
        return NO_LISTENERS
    path = _find_best_path(listeners, tested_paths) if remaining_tests > 0 else None
    if path is None:
        return tuple([(listener.matcher, listener.action) for listener in listeners])
    return SwitchNode(path, listeners, tested_paths, remaining_tests)


def _find_best_path(listeners: List[Listener], tested_paths: Tuple[Path, ...]) -> Optional[Path]:
    """Return the path where most patterns have a constant or functor, or None."""
    path_counts: Dict[Path, int] = Counter()
    for listener in listeners:
        for path in _constant_paths(listener.pattern):
            if path not in tested_paths:
                path_counts[path] += 1
    if not path_counts:
        return None
    path, _ = min(path_counts.items(), key=lambda item: (-item[1], len(item[0]), item[0]))
    return path


def _constant_paths(pattern: Term) -> List[Path]:
    """Return the paths of the constants and inner functors of a pattern, in breadth-first order."""
    paths: List[Path] = []
    level: List[Tuple[Path, Term]] = [((), pattern)]
    # A few paths near the root separate patterns well.
    while level and len(paths) < _MAX_ANALYSED_PATHS:
        next_level: List[Tuple[Path, Term]] = []
        for path, term in level:
            if term.__class__ is tuple and len(path) < _MAX_PATH_LENGTH:
                for position, argument in enumerate(term[1:], 1):
                    if argument.__class__ is not Var:
                        paths.append((*path, position))
                        next_level.append(((*path, position), argument))
        level = next_level
    return paths


def _key_at(pattern: Term, path: Path) -> Hashable:
    """Return the key of a pattern at a path, or None if there is a variable at the path or above it."""
    term = pattern
    for position in path:
        if term.__class__ is not tuple or len(term) <= position:
            return None
        term = term[position]
    return None if term.__class__ is Var else _discrimination_key(term)


def _discrimination_key(term: Term) -> Hashable:
    """Return the functor of a compound term, or the key of a constant."""
    if term.__class__ is tuple:
        return term[0]  # type: ignore[no-any-return]
    if term.__class__ is Lazy:
        return term.functor
    return freeze(term)


def _subterm_at(term: Term, path: Path) -> Term:
    """Return the subterm of an event at a path; a variable above the path represents everything below it.

    If the event has no such subterm, patterns that have one do not match it, and the result is an arbitrary number.
    """
    for position in path:
        term = deref(term)
        if term.__class__ is Var:
            return term
        if term.__class__ is not tuple or len(term) <= position:
            return 0
        term = term[position]
    return term


FilterFunction = Callable[..., bool]
"""Predicate on seconds, nanoseconds and the arguments at the positions of a filter."""


class PushdownFilter:
    """Filter for the events of one functor; created by `ListenerIndex.event_filter`.

    Attributes:
        plan: the plan of the dispatcher for these events; None while it is not known.
        passes: returns whether an event can match a listener, or its time is invalid, so that it must be reported.
    """

    __slots__ = ("plan", "passes", "__weakref__")

    plan: Optional[Plan]
    passes: FilterFunction

    def __init__(self, positions: Tuple[int, ...], plan: Optional[Plan]):
        self.plan = plan
        self.passes = _filter_factory(positions)(self)


_VALID_TIME_TEST = (
    "seconds.__class__ is nanoseconds.__class__ is int"
    " and 0 <= seconds < END_SECONDS and 0 <= nanoseconds < SECOND"
)
_FILTER_NAMES = {
    "SwitchNode": SwitchNode,
    "Atom": Atom,
    "NO_LISTENERS": NO_LISTENERS,
    "END_SECONDS": END_INSTANT // SECOND,
    "SECOND": SECOND,
}


def _filter_factory(positions: Tuple[int, ...]) -> Callable[[PushdownFilter], FilterFunction]:
    """Return a factory for `PushdownFilter.passes`, which follows a plan as far as it tests known arguments."""
    parameters = ", ".join(["seconds", "nanoseconds", *[f"a{position}" for position in positions]])
    # The path of a nested test is not among the known arguments: its node has ``argument_position == 0``, which no
    # position equals, so the filter passes the event.
    argument_selection = [
        Block(f"{'if' if index == 0 else 'elif'} argument_position == {position}:", [f"value = a{position}"])
        for index, position in enumerate(positions)
    ]
    walk: List[Statement] = [
        "argument_position = plan.argument_position",
        *argument_selection,
        Block("else:", ["return True"]),
        Block("if value.__class__ is not Atom:", ["return True"]),
        "plan = plan.table.get(value, plan.default)",
    ]
    body: List[Statement] = [
        # A plan of None is neither a node nor `NO_LISTENERS`, so the filter is open while the plan is not known. Only
        # atoms are looked up in the tables; other kinds of arguments pass.
        "plan = event_filter.plan",
        *([Block("while plan.__class__ is SwitchNode:", walk)] if positions else []),
        f"return plan is not NO_LISTENERS or not ({_VALID_TIME_TEST})",
    ]
    source = source_of(
        [Block("def generated(event_filter):", [Block(f"def passes({parameters}):", body), "return passes"])]
    )
    factory: Callable[[PushdownFilter], FilterFunction] = shared_function(
        source, _FILTER_NAMES, "event_filter"
    )
    return factory
