"""Operators that libraries of SWI-Prolog export: with them the clauses of a file read whose library is not there."""

from typing import Dict

from ...prolog.syntax import Operators
from ...prolog.terms import Term, deref
from .libraries import LIBRARY, library_path

_META = "1150 fx rdf_meta"
_EXPORTED: Dict[str, str] = {
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
        {_META}
        650 xfx ^^
        110 xfx @""",
    "semweb/rdf_db": _META,
    "semweb/rdf_prefixes": _META,
}


def declare_operators(name: Term, operators: Operators) -> None:
    """Declare the operators of ``library(Name)`` in a table; nothing for another name."""
    name = deref(name)
    if name.__class__ is not tuple or name[0] is not LIBRARY:
        return
    for line in _EXPORTED.get(library_path(name[1]), "").strip().split("\n"):
        priority, kind, *names = line.split() or ("0", "fx")
        for one in names:
            operators.add(int(priority), kind, one)
