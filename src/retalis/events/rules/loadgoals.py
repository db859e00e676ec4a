"""Goals of other Prologs that load files, and what is known of the file that is being loaded."""

from pathlib import Path
from typing import Any, Iterator, Tuple

from ...prolog.machine import Machine
from ...prolog.terms import NIL, Term, atom, deref, functor, list_items, undo

_IF = functor("if", 1)
_ONCE = ("not_loaded", "changed")


def define_load_goals(rules: Any) -> None:
    """Define the goals; those of the event language's own are in `predicates`."""
    logic, loader = rules.logic, rules.loader

    def load(machine: Machine, names: Term, options: Term = NIL) -> bool:
        given = [deref(option) for option in list_items(options) or ()]
        once = any(
            option.__class__ is tuple and option[0] is _IF and getattr(deref(option[1]), "name", "") in _ONCE
            for option in given
        )
        found = list_items(names)
        for name in [names] if found is None else found:
            loader.use(name, once)
        return True

    def context(machine: Machine, key: Term, value: Term) -> Iterator[bool]:
        path = rules.files.innermost
        for one in () if path is None else _known(path):
            mark = len(machine.trail)
            if machine.unify_all((key, one[0]), (value, one[1])):
                yield True
            undo(machine.trail, mark)

    def use(machine: Machine, name: Term, imports: Term = NIL) -> bool:
        loader.use(name, once=False)
        return True

    for name in ("reconsult", "compile", "load_files"):
        logic.define(name, 1, load)
    for name in ("autoload", "reexport"):
        logic.define(name, 1, use)
        logic.define(name, 2, use)
    logic.define("load_files", 2, load)
    logic.define_nondeterministic("prolog_load_context", 2, context)


def _known(path: Path) -> Tuple[Tuple[Term, Term], ...]:
    """Return what is known of the file at a path while it is loaded."""
    return (
        (atom("directory"), atom(str(path.parent))),
        (atom("source"), atom(str(path))),
        (atom("file"), atom(str(path))),
        (atom("module"), atom("user")),
        (atom("dialect"), atom("swi")),
    )
