"""Event patterns compiled to Python: from an event term to the values of the pattern's variables.

Terms built from values by compiled code: heads of rules, and what aggregates collect.
"""

from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from ...foundation import codegen
from ...foundation.codegen import MAX_TERM_ARGUMENTS, shared_function
from ...prolog.terms.term_traversal import copy, freeze, is_ground, is_larger, resolve, variables
from ...prolog.terms.types import Atom, CompoundTerm, Lazy, String, Term, Trail, Values, Var, deref
from ...prolog.terms.unification import same_constant, undo, unify

Matcher = Callable[[Term], Optional[Values]]
"""Takes an event term (no bound variables in it); gives the values of the pattern's variables, or None."""


def compile_matcher(pattern: Term) -> Matcher:
    """Return the matcher of a pattern; values come in the order of ``terms.variables(pattern)``.

    The event's functor is not looked at: the dispatcher has chosen by it. Events without variables are taken
    apart in straight code; where a variable of the event stands in the way, or the pattern is large, terms are
    unified in general.
    """
    pattern = resolve(pattern)
    if pattern.__class__ is Var:
        return _whole
    if pattern.__class__ is not tuple:
        return _nothing
    if is_larger(pattern, MAX_TERM_ARGUMENTS):
        order = variables(pattern)
        return lambda term: unify_pattern(pattern, order, term)
    return _MatcherWriter(pattern).matcher()


def _whole(term: Term) -> Optional[Values]:
    return (term,)


def _nothing(term: Term) -> Optional[Values]:
    return ()


class _MatcherWriter:
    """Writes the source of one matcher."""

    def __init__(self, pattern: CompoundTerm):
        self.pattern = pattern
        self.lines: List[str] = []
        self.given = codegen.BoundNames({"deref": deref, "Lazy": Lazy, "Var": Var, "same": _same})
        self.names = self.given.values
        self.places: Dict[Var, str] = {}

    def matcher(self) -> Matcher:
        order = variables(self.pattern)
        self.names["general"] = _general(self.pattern, order)
        pending: List[Tuple[str, CompoundTerm]] = [("term", self.pattern)]
        while pending:
            pending.extend(reversed(self._take_apart(*pending.pop())))
        values = ", ".join(self.places[var] for var in order)
        self.lines.append(f"    return ({values}{',' if len(order) == 1 else ''})")
        source = "def made(term):\n" + "\n".join(self.lines) + "\n"
        made: Matcher = shared_function(source, self.names, "matcher")
        return made

    def _take_apart(self, name: str, pattern: CompoundTerm) -> List[Tuple[str, CompoundTerm]]:
        """Unpack a compound; test its constants; return its compound arguments with their names."""
        inner: List[Tuple[str, CompoundTerm]] = []
        tests: List[str] = []
        targets = []
        for argument in pattern[1:]:
            if argument.__class__ is Var and argument not in self.places:
                place = self._fresh()
                self.places[argument] = place
                targets.append(place)
                continue
            place = self._fresh()
            targets.append(place)
            if argument.__class__ is Var:
                tests.append(
                    f"    if {place} is not {self.places[argument]} and not same({place}, "
                    f"{self.places[argument]}):\n        return general(term, None)"
                )
            elif argument.__class__ is tuple:
                functor = self._constant(argument[0])
                tests.append(
                    f"    if {place}.__class__ is not tuple:\n        {place} = deref({place})\n"
                    f"        if {place}.__class__ is not tuple:\n            return general(term, {place})\n"
                    f"    if {place}[0] is not {functor}:\n        return None"
                )
                inner.append((place, argument))
            else:
                tests.append(
                    f"    if {self._differs(place, argument)}:\n        return general(term, {place})"
                )
        if targets:
            self.lines.append(f"    _, {', '.join(targets)} = {name}")
        self.lines.extend(tests)
        return inner

    def _differs(self, place: str, constant: Term) -> str:
        name = self._constant(constant)
        if constant.__class__ is Atom:
            return f"{place} is not {name}"
        kind = {int: "int", float: "float", String: "String"}[constant.__class__]
        self.names["String"] = String
        if constant.__class__ is float:
            self.names["equal"] = same_constant
            return f"{place}.__class__ is not float or not equal({place}, {name})"
        return f"{place}.__class__ is not {kind} or {place} != {name}"

    def _fresh(self) -> str:
        return self.given.name("a")

    def _constant(self, value: object) -> str:
        return self.given.name("k", value)


def _same(left: Term, right: Term) -> bool:
    """Tell whether two values are surely the same term; general unification decides the rest."""
    try:
        return bool(freeze(left) == freeze(right))
    except ValueError:
        return False


def _general(pattern: Term, order: List[Var]) -> Callable[[Term, Optional[Term]], Optional[Values]]:
    """Return what matches when straight code cannot: ``met`` is what stood in the way, None for any."""

    def general(term: Term, met: Optional[Term]) -> Optional[Values]:
        if met is not None and deref(met).__class__ is not Var:
            return None
        return unify_pattern(pattern, order, term)

    return general


def unify_pattern(pattern: Term, order: List[Var], term: Term) -> Optional[Values]:
    """Unify a copy of the pattern with the event; nothing stays bound."""
    fresh: Dict[Var, Term] = {var: Var() for var in order}
    trail: Trail = []
    values: Optional[Values] = None
    if unify(copy(pattern, fresh), term, trail):
        values = tuple(resolve(fresh[var]) for var in order)
    undo(trail, 0)
    return values


def compile_builder(term: Term, order: Sequence[Var], title: str) -> Callable[[Values], Term]:
    """Return a function that makes ``term`` from the values of ``order``; other variables are new each time."""
    term = resolve(term)
    if is_ground(term):
        return lambda values: term
    if is_larger(term, MAX_TERM_ARGUMENTS):
        return lambda values: copy(term, dict(zip(order, values)))
    names = codegen.BoundNames({})
    lines, result = builder_source(term, {var: f"v[{at}]" for at, var in enumerate(order)}, names)
    source = "\n    ".join(["def made(v):", *lines, f"return {result}"]) + "\n"
    made: Callable[[Values], Term] = shared_function(source, names.values, title)
    return made


def builder_source(term: Term, known: Mapping[Var, str], names: codegen.BoundNames) -> Tuple[List[str], str]:
    """Return the lines that make a term, and the expression that it is after them.

    Args:
        term: the term, not `MAX_TERM_ARGUMENTS`; variables that are not known are new each time.
        known: the expressions of the values of variables.
        names: get what the lines name.
    """
    places = dict(known)
    lines: List[str] = []

    def constant(value: object) -> str:
        return names.name("k", value)

    def leaf(item: Term) -> str:
        if item.__class__ is not Var:
            return constant(item)
        if item not in places:
            places[item] = f"u{len(places)}"
            lines.append(f"{places[item]} = {names.constant(Var, Var)}()")
        return places[item]

    term = resolve(term)
    return lines, constant(term) if is_ground(term) else _build(term, leaf, constant, lines)


def _build(
    term: Term, leaf: Callable[[Term], str], constant: Callable[[object], str], lines: List[str]
) -> str:
    """Write one assignment for each compound with variables, inner ones first; return the name of the whole."""
    if term.__class__ is not tuple:
        return leaf(term)
    stack: List[List[Any]] = [[term, []]]
    while True:
        source, done = stack[-1]
        if len(done) == len(source) - 1:
            name = f"t{len(lines)}"
            lines.append(f"{name} = ({constant(source[0])}, {', '.join(done)})")
            stack.pop()
            if not stack:
                return name
            stack[-1][1].append(name)
            continue
        item = source[len(done) + 1]
        if item.__class__ is not tuple:
            done.append(leaf(item))
        elif is_ground(item):
            done.append(constant(item))
        else:
            stack.append([item, []])
