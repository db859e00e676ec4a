"""Answers of a goal as a top level shows them: ``X = f(Y), Z = 1``."""

from typing import Callable, Dict, Iterator, List, NamedTuple

from ..prolog.syntax import Operators, write_term
from ..prolog.terms import Term, Var, compare, deref, functor, variables

_BINDING = 699
"""The highest priority that the right side of ``=`` may have."""

_MOST_NODES = 1_000_000


class _Group(NamedTuple):
    """Variables of the goal that have the same value."""

    names: List[str]
    value: Term


def bindings(names: Dict[str, Var], operators: Operators) -> str:
    """Return the values of a goal's variables as text; empty where there is nothing to say.

    Variables whose names begin with ``_`` are not shown. Variables with the same value share a line. Those
    that the goal has no name for are ``_`` where they stand once, else ``_A``, ``_B`` and so on.
    """
    groups = _grouped(names)
    if any(_is_endless(group.value) for group in groups):
        return "% the answer is a cyclic term, or too large to be shown"
    named = _variable_names(groups)
    lines = []
    for group in groups:
        chain = [f"{left} = {right}" for left, right in zip(group.names, group.names[1:])]
        if group.value.__class__ is not Var:
            text = write_term(
                group.value,
                operators,
                quoted=True,
                numbervars=True,
                spacing=True,
                variable_names=named,
                priority=_BINDING,
            )
            chain.append(f"{group.names[-1]} = {text}")
        if chain:
            lines.append(", ".join(chain))
    return ",\n".join(lines)


def _grouped(names: Dict[str, Var]) -> List[_Group]:
    groups: List[_Group] = []
    for name, var in names.items():
        if name.startswith("_"):
            continue
        value = deref(var)
        for group in groups:
            if group.value is value or (value.__class__ is not tuple and compare(group.value, value) == 0):
                group.names.append(name)
                break
        else:
            groups.append(_Group([name], value))
    return groups


def _variable_names(groups: List[_Group]) -> Dict[Var, str]:
    """Return how the variables inside the values are shown."""
    named = {group.value: group.names[-1] for group in groups if group.value.__class__ is Var}
    counts: Dict[Var, int] = {}
    _count((functor("", len(groups)), *[group.value for group in groups]), counts)
    taken = {name for group in groups for name in group.names}
    letters = (f"_{letter}" for letter in _letters() if f"_{letter}" not in taken)
    for var, count in counts.items():
        if var not in named:
            named[var] = "_" if count == 1 else next(letters)
    return named


def _letters() -> Iterator[str]:
    number = 0
    while True:
        yield f"{chr(65 + number % 26)}{number // 26 or ''}"
        number += 1


def _walk(term: Term, visit: Callable[[Term], None]) -> bool:
    """Visit the leaves of a term from left to right; False where it has too many parts."""
    stack = [term]
    nodes = 0
    while stack:
        item = deref(stack.pop())
        nodes += 1
        if nodes > _MOST_NODES:
            return False
        if item.__class__ is tuple:
            stack.extend(reversed(item[1:]))
        else:
            visit(item)
    return True


def _count(term: Term, counts: Dict[Var, int]) -> None:
    for var in variables(term):
        counts[var] = 0

    def visit(leaf: Term) -> None:
        if leaf.__class__ is Var:
            counts[leaf] += 1

    _walk(term, visit)


def _is_endless(term: Term) -> bool:
    return not _walk(term, lambda leaf: None)
