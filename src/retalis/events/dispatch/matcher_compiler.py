"""Compilers from terms to Python functions: matchers for event patterns, and builders for rule heads.

A matcher takes an event and returns the values of the variables of a pattern, or None. It is generated as
straight-line code: it unpacks a compound, compares its constants, and then processes its compound arguments. Events
are almost always ground. If an event has a variable where the pattern has a constant or compound, or if two
occurrences of a pattern variable have values that are not identical by a cheap test (`_is_same_value`), the generated
code falls back to general unification of a copy of the pattern.

A builder is the inverse: it creates a term from values. Generated sources contain no data of the program, only
structure, so `shared_function` compiles equal structures once.
"""

from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from ...foundation import codegen
from ...foundation.codegen import MAX_TERM_ARGUMENTS, shared_function
from ...prolog.terms.term_traversal import copy, freeze, is_ground, is_larger, resolve, variables
from ...prolog.terms.types import Atom, CompoundTerm, Lazy, String, Term, Trail, Values, Var, deref
from ...prolog.terms.unification import same_constant, undo, unify

Matcher = Callable[[Term], Optional[Values]]
"""Function from an event without bound variables to the values of the variables of a pattern, or None."""


def compile_matcher(pattern: Term) -> Matcher:
    """Return the matcher of a pattern; values are in the order of ``terms.variables(pattern)``.

    The functor of the event is not tested, because the dispatcher has selected the matcher by it.
    """
    pattern = resolve(pattern)
    if pattern.__class__ is Var:
        return _match_anything
    if pattern.__class__ is not tuple:
        return _match_constant
    # Very large functions take CPython long to compile, and unpacking has a limit of arguments.
    if is_larger(pattern, MAX_TERM_ARGUMENTS):
        pattern_vars = variables(pattern)
        return lambda term: unify_pattern(pattern, pattern_vars, term)
    return _MatcherGenerator(pattern).compile()


def _match_anything(term: Term) -> Optional[Values]:
    return (term,)


def _match_constant(term: Term) -> Optional[Values]:
    return ()


class _MatcherGenerator:
    """Generator for the source of one matcher."""

    def __init__(self, pattern: CompoundTerm):
        self.pattern = pattern
        self.lines: List[str] = []
        self.bound_names = codegen.BoundNames(
            {"deref": deref, "Lazy": Lazy, "Var": Var, "same": _is_same_value}
        )
        self.names = self.bound_names.values
        self.names_by_var: Dict[Var, str] = {}

    def compile(self) -> Matcher:
        """Return the matcher."""
        pattern_vars = variables(self.pattern)
        self.names["fallback"] = _general_matcher(self.pattern, pattern_vars)
        stack: List[Tuple[str, CompoundTerm]] = [("term", self.pattern)]
        while stack:
            # Depth first, left to right, so that the order of tests follows the order of the pattern.
            stack.extend(reversed(self._emit_unpacking(*stack.pop())))
        values = ", ".join(self.names_by_var[var] for var in pattern_vars)
        self.lines.append(f"    return ({values}{',' if len(pattern_vars) == 1 else ''})")
        source = "def generated(term):\n" + "\n".join(self.lines) + "\n"
        matcher: Matcher = shared_function(source, self.names, "matcher")
        return matcher

    def _emit_unpacking(self, name: str, pattern: CompoundTerm) -> List[Tuple[str, CompoundTerm]]:
        """Emit the statements that unpack a compound and compare its constants.

        Returns:
            Its compound arguments, each with the name of the variable that has its value.
        """
        compound_arguments: List[Tuple[str, CompoundTerm]] = []
        tests: List[str] = []
        targets = []
        for argument in pattern[1:]:
            if argument.__class__ is Var and argument not in self.names_by_var:
                variable = self._new_name()
                self.names_by_var[argument] = variable
                targets.append(variable)
                continue
            variable = self._new_name()
            targets.append(variable)
            if argument.__class__ is Var:
                tests.append(
                    f"    if {variable} is not {self.names_by_var[argument]} and not same({variable}, "
                    f"{self.names_by_var[argument]}):\n        return fallback(term, None)"
                )
            elif argument.__class__ is tuple:
                functor = self._constant_name(argument[0])
                tests.append(
                    f"    if {variable}.__class__ is not tuple:\n        {variable} = deref({variable})\n"
                    f"        if {variable}.__class__ is not tuple:\n            return fallback(term, {variable})\n"
                    f"    if {variable}[0] is not {functor}:\n        return None"
                )
                compound_arguments.append((variable, argument))
            else:
                tests.append(
                    f"    if {self._mismatch_test(variable, argument)}:\n        return fallback(term, {variable})"
                )
        if targets:
            self.lines.append(f"    _, {', '.join(targets)} = {name}")
        self.lines.extend(tests)
        return compound_arguments

    def _mismatch_test(self, variable: str, constant: Term) -> str:
        name = self._constant_name(constant)
        if constant.__class__ is Atom:
            return f"{variable} is not {name}"
        class_name = {int: "int", float: "float", String: "String"}[constant.__class__]
        self.names["String"] = String
        if constant.__class__ is float:
            self.names["equal"] = same_constant
            return f"{variable}.__class__ is not float or not equal({variable}, {name})"
        return f"{variable}.__class__ is not {class_name} or {variable} != {name}"

    def _new_name(self) -> str:
        return self.bound_names.name("a")

    def _constant_name(self, value: object) -> str:
        return self.bound_names.name("k", value)


def _is_same_value(left: Term, right: Term) -> bool:
    """Return whether two values are certainly the same term; if not, general unification decides."""
    try:
        return bool(freeze(left) == freeze(right))
    except ValueError:
        return False


def _general_matcher(
    pattern: Term, pattern_vars: List[Var]
) -> Callable[[Term, Optional[Term]], Optional[Values]]:
    """Return the general matcher; ``mismatch`` is the value that stopped the generated code, or None."""

    def fallback(term: Term, mismatch: Optional[Term]) -> Optional[Values]:
        # Generated code has compared a constant with ``mismatch``. If ``mismatch`` is not a variable, they cannot
        # unify.
        if mismatch is not None and deref(mismatch).__class__ is not Var:
            return None
        return unify_pattern(pattern, pattern_vars, term)

    return fallback


def unify_pattern(pattern: Term, pattern_vars: List[Var], term: Term) -> Optional[Values]:
    """Unify a copy of the pattern with the event, and undo all bindings."""
    # A copy, because the pattern is shared by all events and must stay unbound.
    new_vars: Dict[Var, Term] = {var: Var() for var in pattern_vars}
    trail: Trail = []
    try:
        if unify(copy(pattern, new_vars), term, trail):
            return tuple(resolve(new_vars[var]) for var in pattern_vars)
        return None
    finally:
        undo(trail, 0)


def compile_builder(term: Term, value_vars: Sequence[Var], title: str) -> Callable[[Values], Term]:
    """Return a function that creates ``term`` from the values of ``value_vars``; other variables are new."""
    term = resolve(term)
    if is_ground(term):
        return lambda values: term
    if is_larger(term, MAX_TERM_ARGUMENTS):
        return lambda values: copy(term, dict(zip(value_vars, values)))
    names = codegen.BoundNames({})
    lines, result = generate_builder(
        term, {var: f"v[{index}]" for index, var in enumerate(value_vars)}, names
    )
    source = "\n    ".join(["def generated(v):", *lines, f"return {result}"]) + "\n"
    builder: Callable[[Values], Term] = shared_function(source, names.values, title)
    return builder


def generate_builder(
    term: Term, expression_by_var: Mapping[Var, str], names: codegen.BoundNames
) -> Tuple[List[str], str]:
    """Generate statements that create a term, and an expression for the term after them.

    Generated names have the prefix ``k`` for constants, ``t`` for compounds, ``u`` for new variables, and ``v`` for
    the values.

    Args:
        term: the term, not larger than `MAX_TERM_ARGUMENTS`; unknown variables are fresh in each call.
        expression_by_var: expressions for the values of variables.
        names: collects the objects that the statements refer to.
    """
    source_by_var = dict(expression_by_var)
    lines: List[str] = []

    def constant_source(value: object) -> str:
        return names.name("k", value)

    def leaf_source(item: Term) -> str:
        if item.__class__ is not Var:
            return constant_source(item)
        if item not in source_by_var:
            source_by_var[item] = f"u{len(source_by_var)}"
            lines.append(f"{source_by_var[item]} = {names.constant(Var, Var)}()")
        return source_by_var[item]

    term = resolve(term)
    return lines, constant_source(term) if is_ground(term) else _emit_assignments(
        term, leaf_source, constant_source, lines
    )


def _emit_assignments(
    term: Term, leaf_source: Callable[[Term], str], constant_source: Callable[[object], str], lines: List[str]
) -> str:
    """Emit one assignment per compound with variables, inner ones first; return the name of the outermost one."""
    if term.__class__ is not tuple:
        return leaf_source(term)
    # An explicit stack, because terms may be nested deeper than the recursion limit.
    stack: List[List[Any]] = [[term, []]]
    while True:
        compound, arguments = stack[-1]
        if len(arguments) == len(compound) - 1:
            name = f"t{len(lines)}"
            lines.append(f"{name} = ({constant_source(compound[0])}, {', '.join(arguments)})")
            stack.pop()
            if not stack:
                return name
            stack[-1][1].append(name)
            continue
        item = compound[len(arguments) + 1]
        if item.__class__ is not tuple:
            arguments.append(leaf_source(item))
        elif is_ground(item):
            arguments.append(constant_source(item))
        else:
            stack.append([item, []])
