"""Files and libraries as ``use_module/1``, ``ensure_loaded/1`` and ``include/1`` name them."""

from ..logic import existence_error, instantiation_error, type_error
from ..terms import SLASH, Atom, String, Term, Var, deref, functor

LIBRARY = functor("library", 1)

LIBRARIES = frozenset(
    (
        "aggregate",
        "apply",
        "apply_macros",
        "assoc",
        "basics",
        "between",
        "date",
        "debug",
        "error",
        "gensym",
        "format",
        "listing",
        "lists",
        "ordsets",
        "pairs",
        "random",
        "readutil",
        "solution_sequences",
        "system",
        "tabling",
        "terms",
        "time",
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
    if name.__class__ is not Atom or name.name not in LIBRARIES:
        raise existence_error("library", name)


def file_name(term: Term) -> str:
    """Return the name of a file: an atom, a string, or parts with slashes between them.

    Raises:
        PrologError: where it is none.
    """
    term = deref(term)
    if term.__class__ is Var:
        raise instantiation_error()
    if term.__class__ is Atom:
        return str(term.name)
    if term.__class__ is String:
        return str(term.text)
    if term.__class__ is tuple and term[0] is SLASH:
        return f"{file_name(term[1])}/{file_name(term[2])}"
    raise type_error("file", term)
