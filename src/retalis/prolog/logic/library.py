"""The library: predicates written in Prolog, in files that are compiled when one of theirs is first called."""

import re
from functools import lru_cache
from pathlib import Path
from typing import Dict, Tuple

from ...foundation import SyntaxFault, unwatched, watched_by
from ..builtins import translate_rule
from ..database import Clause, Database, Predicate, functor_of, split_clause
from ..syntax import Operators, read_program
from ..terms import deref

FOLDER = Path(__file__).resolve().parent.parent / "library"

_EXPORTS = re.compile(r"^% defines: (.*)$", re.MULTILINE)


@lru_cache(maxsize=1)
def library_index() -> Dict[Tuple[str, int], str]:
    """Return which file defines a predicate: each names its predicates in lines ``% defines: name/arity ...``."""
    found = {}
    for path in sorted(FOLDER.glob("*.pl")):
        for line in _EXPORTS.findall(path.read_text(encoding="utf-8")):
            for text in line.split():
                name, _, arity = text.rpartition("/")
                found[name, int(arity)] = path.stem
    return found


def load_library(database: Database, part: str) -> None:
    """Load a file of the library; that does not count for the goal that needs it."""
    before = watched_by(unwatched)
    try:
        _load(database, part)
    finally:
        watched_by(before)


def _load(database: Database, part: str) -> None:
    path = FOLDER / f"{part}.pl"
    for read in read_program(path.read_text(encoding="utf-8"), Operators.prolog(), f"library({part})"):
        if isinstance(read, SyntaxFault):
            raise read
        term = deref(read.term)
        if term.__class__ is tuple and term[0].name == "-->":
            term = translate_rule(term)
        head, body = split_clause(term)
        key = functor_of(head)
        predicate = database.library.predicate(key)
        if not predicate.library:
            if predicate.kind == "user" or predicate.dynamic:  # the program has one of this name
                predicate = database.library.kept[key] = Predicate(database, key)
            predicate.library = True
        predicate.add(Clause(predicate, head, body, read.place))
