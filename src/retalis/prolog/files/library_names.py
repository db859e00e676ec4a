"""Names of libraries: those that are built in, imports under other names, and operators of the others.

Libraries of SWI-Prolog whose predicates are built in are accepted without a file. For libraries that are not
available (clpfd, chr, ...) the operators are declared, so that a file with their clauses can still be read.
"""

from pathlib import PurePath
from typing import Dict, List

from ..database.module_system import GRAMMAR_NAME, functor_of_indicator
from ..machine.errors import CONTEXT, PrologError, existence_error, instantiation_error, type_error
from ..syntax.operators import Operators
from ..terms.list_terms import list_items
from ..terms.types import COLON, NIL, SLASH, Atom, String, Term, Var, atom, deref, functor

LIBRARY = functor("library", 1)
_EXCEPT, _AS, _CLAUSE = functor("except", 1), functor("as", 2), functor(":-", 2)
_MAX_ARGUMENTS = 1000
_UNKNOWN_LIBRARY_ADVICE = (
    "what the program calls of it has to be defined elsewhere, or the file to be given to SWI-Prolog: "
    ":- use_swi(File), see docs/how-to/swi-prolog.md"
)

LIBRARIES = frozenset(
    (
        "aggregate",
        "ansi_term",
        "apply",
        "apply_macros",
        "assoc",
        "basics",
        "between",
        "date",
        "dcg/basics",
        "dcg/high_order",
        "debug",
        "dif",
        "error",
        "freeze",
        "gensym",
        "format",
        "listing",
        "lists",
        "occurs",
        "option",
        "ordsets",
        "pairs",
        "pio",
        "pure_input",
        "random",
        "readutil",
        "solution_sequences",
        "statistics",
        "system",
        "tabling",
        "time",
        "when",
        "yall",
    )
)
"""Libraries of other Prolog systems whose usual predicates are built in."""


def check_library(term: Term) -> None:
    """Check that ``library(Name)`` is built in.

    Raises:
        PrologError: if the library is unknown.
    """
    name = deref(term[1])  # type: ignore[index]
    if name.__class__ is Var:
        raise instantiation_error()
    if library_path(name) not in LIBRARIES:
        raise existence_error("library", name, (CONTEXT, Var(), atom(_UNKNOWN_LIBRARY_ADVICE)))


def renaming_clauses(file: Term, imports: Term = NIL) -> List[Term]:
    """Return clauses that define the names given by ``use_module(File, [p/1 as q])``.

    They call the predicates of the module named like the file, or global ones if there is no such module.
    """
    imports = deref(imports)
    if imports.__class__ is tuple and imports[0] is _EXCEPT:
        imports = imports[1]
    clauses: List[Term] = []
    for item in map(deref, list_items(imports) or ()):
        if item.__class__ is tuple and item[0] is _AS:
            renamed_indicator, name = deref(item[1]), deref(item[2])
            key = (
                functor_of_indicator(renamed_indicator)
                if renamed_indicator.__class__ is tuple and renamed_indicator[0] in (SLASH, GRAMMAR_NAME)
                else None
            )
            if key is not None and name.__class__ is Atom and key.arity <= _MAX_ARGUMENTS:
                args = [Var() for _ in range(key.arity)]
                module = atom(PurePath(library_path(file)).stem)
                clauses.append(
                    (_CLAUSE, _goal_term(name.name, args), (COLON, module, _goal_term(key.name, args)))
                )
    return clauses


def _goal_term(name: str, args: List[Var]) -> Term:
    return (functor(name, len(args)), *args) if args else atom(name)


def library_path(name: Term) -> str:
    """Return the name of a library as text with slashes, or "" for an invalid name."""
    try:
        return file_name(name)
    except PrologError:
        return ""


def file_name(term: Term) -> str:
    """Return the name of a file from an atom, a string, or a term of these with slashes.

    Raises:
        PrologError: if the term is not a file name.
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


_RDF_META_OPERATOR = "1150 fx rdf_meta"
_LIBRARY_OPERATORS: Dict[str, str] = {
    "clpfd": """
        760 yfx #<==>
        750 xfy #==>
        750 yfx #<==
        740 yfx #\\/
        730 yfx #\\
        720 yfx #/\\
        710 fy #\\
        700 xfx #> #< #>= #=< #= #\\= in ins in_set
        450 xfx ..""",
    "clpb": """
        500 yfx #
        300 fy ~""",
    "chr": """
        1200 xfx @
        1190 xfx pragma
        1180 xfx ==> <=>
        1150 fx chr_constraint chr_type chr_declaration constraints handler rules
        1130 xfx --->
        1100 xfx \\
        500 yfx #""",
    "persistency": "1150 fx persistent",
    "record": "1150 fx record",
    "semweb/rdf11": f"""
        {_RDF_META_OPERATOR}
        650 xfx ^^
        110 xfx @""",
    "semweb/rdf_db": _RDF_META_OPERATOR,
    "semweb/rdf_prefixes": _RDF_META_OPERATOR,
}


def declare_operators(name: Term, operators: Operators) -> None:
    """Declare the operators of ``library(Name)``; do nothing for another name."""
    name = deref(name)
    if name.__class__ is not tuple or name[0] is not LIBRARY:
        return
    for line in _LIBRARY_OPERATORS.get(library_path(name[1]), "").strip().split("\n"):
        priority, operator_type, *names = line.split() or ("0", "fx")
        for operator in names:
            operators.add(int(priority), operator_type, operator)
