"""Terms built from values by compiled code: heads of rules, and what aggregates collect."""

from typing import Any, Callable, List, Mapping, Sequence, Tuple

from ...foundation import LARGEST, codegen, shared_function
from ...prolog.terms import Term, Values, Var, copy, is_ground, is_larger, resolve


def compile_builder(term: Term, order: Sequence[Var], title: str) -> Callable[[Values], Term]:
    """Return a function that makes ``term`` from the values of ``order``; other variables are new each time."""
    term = resolve(term)
    if is_ground(term):
        return lambda values: term
    if is_larger(term, LARGEST):
        return lambda values: copy(term, dict(zip(order, values)))
    names = codegen.Names({})
    lines, result = builder_source(term, {var: f"v[{at}]" for at, var in enumerate(order)}, names)
    source = "\n    ".join(["def made(v):", *lines, f"return {result}"]) + "\n"
    made: Callable[[Values], Term] = shared_function(source, names.values, title)
    return made


def builder_source(term: Term, known: Mapping[Var, str], names: codegen.Names) -> Tuple[List[str], str]:
    """Return the lines that make a term, and the expression that it is after them.

    Args:
        term: the term, not `LARGEST`; variables that are not known are new each time.
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
