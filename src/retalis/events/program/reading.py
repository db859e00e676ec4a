"""What the directives of a file change for the rest of it while it is read: operators, and how quotes read."""

from typing import Any, List

from ...foundation import RetalisError
from ...prolog.syntax import Program
from ...prolog.terms import Atom, Term, conjuncts, deref, functor, list_items

_OP = functor("op", 3)
_SET_FLAG = functor("set_prolog_flag", 2)


def change_reading(goal: Term, program: Program) -> None:
    """Have operators and flags that a directive sets hold for the rest of the file."""
    for one in conjuncts(goal):
        if one.__class__ is not tuple:
            continue
        arguments = [deref(argument) for argument in one[1:]]
        if one[0] is _OP and arguments[0].__class__ is int and arguments[1].__class__ is Atom:
            for name in _names(arguments[2]):
                try:
                    program.operators.add(arguments[0], arguments[1].name, name)
                except (RetalisError, ValueError):
                    continue  # the directive itself reports it when it is run
        elif one[0] is _SET_FLAG and arguments[0].__class__ is Atom and arguments[1].__class__ is Atom:
            name = arguments[0].name
            if name in ("double_quotes", "back_quotes"):
                changed: Any = {name: arguments[1].name}
                program.flags = program.flags._replace(**changed)


def _names(term: Term) -> List[str]:
    items = list_items(term)
    found = [deref(item) for item in items] if items else [term]
    return [item.name for item in found if item.__class__ is Atom]
