"""Files and libraries as ``use_module/1``, ``ensure_loaded/1`` and ``include/1`` name them."""

from pathlib import PurePath
from typing import List

from ...prolog.database import GRAMMAR_NAME, indicated
from ...prolog.machine import CONTEXT, PrologError, existence_error, instantiation_error, type_error
from ...prolog.terms import COLON, NIL, SLASH, Atom, String, Term, Var, atom, deref, functor, list_items

LIBRARY = functor("library", 1)
_EXCEPT, _AS, _CLAUSE = functor("except", 1), functor("as", 2), functor(":-", 2)
_MOST_ARGUMENTS = 1000
_ELSEWHERE = (
    "what the program calls of it has to be defined elsewhere, or the file to be given to SWI-Prolog: "
    ":- use_swi(File), see docs/prolog.md"
)

LIBRARIES = frozenset(
    (
        "aggregate",
        "ansi_term",
        "apply",
        "apply_macros",
        "assoc",
        "backcomp",
        "basics",
        "between",
        "date",
        "dcg/basics",
        "dcg/high_order",
        "debug",
        "dif",
        "edinburgh",
        "error",
        "freeze",
        "gensym",
        "format",
        "heaps",
        "listing",
        "lists",
        "occurs",
        "option",
        "ordsets",
        "pairs",
        "pio",
        "plunit",
        "prolog_code",
        "pure_input",
        "random",
        "rbtrees",
        "readutil",
        "solution_sequences",
        "statistics",
        "system",
        "tabling",
        "terms",
        "time",
        "ugraphs",
        "varnumbers",
        "when",
        "yall",
    )
)
"""Libraries of other Prolog systems whose usual predicates are always there."""


def require_library(term: Term) -> None:
    """Accept ``library(Name)`` where its predicates are always there.

    Raises:
        PrologError: where there is no such library.
    """
    name = deref(term[1])  # type: ignore[index]
    if name.__class__ is Var:
        raise instantiation_error()
    if library_path(name) not in LIBRARIES:
        raise existence_error("library", name, (CONTEXT, Var(), atom(_ELSEWHERE)))


def renaming(file: Term, imports: Term = NIL) -> List[Term]:
    """Return the clauses by which predicates have the names that ``use_module(File, [p/1 as q])`` gives them.

    They call those of the module that is called as its file, and the plain ones where there is no such module.
    """
    imports = deref(imports)
    if imports.__class__ is tuple and imports[0] is _EXCEPT:
        imports = imports[1]
    found: List[Term] = []
    for item in map(deref, list_items(imports) or ()):
        if item.__class__ is tuple and item[0] is _AS:
            named, name = deref(item[1]), deref(item[2])
            key = indicated(named) if named.__class__ is tuple and named[0] in (SLASH, GRAMMAR_NAME) else None
            if key is not None and name.__class__ is Atom and key.arity <= _MOST_ARGUMENTS:
                args = [Var() for _ in range(key.arity)]
                module = atom(PurePath(library_path(file)).stem)
                found.append((_CLAUSE, _call(name.name, args), (COLON, module, _call(key.name, args))))
    return found


def _call(name: str, args: List[Var]) -> Term:
    return (functor(name, len(args)), *args) if args else atom(name)


def library_path(name: Term) -> str:
    """Return the name of a library as a text, with slashes between its parts; "" for what is none."""
    try:
        return file_name(name)
    except PrologError:
        return ""


def file_name(term: Term) -> str:
    """Return the name of a file: an atom, a string, or parts with slashes between them.

    Raises:
        PrologError: where it is none.
    """
    parts = []
    pending = [term]
    while pending:
        part = deref(pending.pop())
        if part.__class__ is Var:
            raise instantiation_error()
        if part.__class__ is Atom:
            parts.append(str(part.name))
        elif part.__class__ is String:
            parts.append(str(part.text))
        elif part.__class__ is tuple and part[0] is SLASH:
            pending += [part[2], part[1]]
        else:
            raise type_error("file", part)
    return "/".join(parts)
