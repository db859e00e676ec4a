"""Text to terms: one term, or a program clause by clause."""

from itertools import chain
from typing import Dict, Iterator, List, Optional, Tuple, Union

from ..errors import Place, SyntaxFault
from ..terms import Term, Var
from .operators import Operators
from .parser import Parser
from .rules import MARKERS, NO_RULES, layout
from .tokens import END, NAME, QUOTED, AnyToken, ReadFlags, Source, tokens

DEFAULT = ReadFlags()


class ReadTerm:
    """A term that was read, and what is known of its text.

    Attributes:
        term: the term.
        names: name -> variable, in order of appearance; ``_`` is not in it.
        singletons: names that stand in the term once and do not begin with ``_``.
        offset: where the term begins in its text.
    """

    __slots__ = ("term", "names", "singletons", "offset", "_source", "_spots")

    def __init__(self, parser: Parser, term: Term, offset: int):
        self.term = term
        self.names: Dict[str, Var] = parser.names
        self.singletons: List[str] = [
            name for name, count in parser.counts.items() if count == 1 and name[0] != "_"
        ]
        self.offset = offset
        self._source = parser.source
        self._spots = parser.spots or {}

    @property
    def place(self) -> Place:
        """Return the place where the term begins."""
        return self._source.place(self.offset)

    def place_of(self, part: Term) -> Place:
        """Return the place of a compound term inside ``term``: that of its functor or operator.

        ``part`` must be the very object; for any other the place of the whole term is returned.
        """
        spots = self._spots.get(id(part))
        return self._source.place(spots[0] if spots else self.offset)

    def place_at(self, *path: int) -> Place:
        """Return the place of the part that a path of argument numbers (from 1) leads to.

        ``place_at(2, 1)`` is the first argument of the second argument. Where the path leads into a list
        or out of the term, it is the place of what is around it.
        """
        part, offset = self.term, self.offset
        for number in path:
            spots = self._spots.get(id(part))
            if spots is None or number >= len(spots) or part.__class__ is not tuple:
                return self._source.place(offset)
            offset = spots[number]
            part = part[number] if number < len(part) else None
        spots = self._spots.get(id(part))
        return self._source.place(spots[0] if spots else offset)


class Program:
    """Reads a program clause by clause; iterate over it.

    Yields a `ReadTerm` for each clause, and a `SyntaxFault` for each that has an error; then reading goes
    on with the next clause. ``operators`` and ``flags`` may be changed between clauses: they are looked
    at when the next clause is asked for.
    """

    def __init__(self, text: str, operators: Operators, source: str = "text", flags: ReadFlags = DEFAULT):
        self.operators = operators
        self._source = Source(source, text)
        self._flags = flags
        self._stream = tokens(self._source, flags)

    @property
    def flags(self) -> ReadFlags:
        """The flags; setting them holds from the next clause on."""
        return self._flags

    def __iter__(self) -> Iterator[Union[ReadTerm, SyntaxFault]]:
        while True:
            clause = self._clause()
            if not clause:
                return
            yield self._read(clause)

    def _clause(self) -> List[AnyToken]:
        """Return the tokens up to the next full stop; none at the end of the text."""
        clause: List[AnyToken] = []
        for token in self._stream:
            clause.append(token)
            if token[0] == END:
                return clause
        return clause

    def _read(self, clause: List[AnyToken]) -> Union[ReadTerm, SyntaxFault]:
        try:
            if clause[-1][0] != END:
                return self._unfinished(clause)
            return read_tokens(clause, self._source, self.operators, self._flags, positions=True)
        except SyntaxFault as fault:
            self._resume(clause)
            return fault

    def _resume(self, clause: List[AnyToken]) -> None:
        return

    def _unfinished(self, clause: List[AnyToken]) -> SyntaxFault:
        for token in clause:
            if token[0] == "bad":
                return self._source.fault(token[1], token[2])
        return self._source.fault("expected a full stop at the end of the clause", clause[-1][3])


def read_program(
    text: str, operators: Operators, source: str = "text", flags: ReadFlags = DEFAULT
) -> Program:
    """Return a reader of all clauses of a program; see `Program`."""
    return Program(text, operators, source, flags)


def read_term(
    text: str, operators: Operators, source: str = "text", flags: ReadFlags = DEFAULT, positions: bool = True
) -> ReadTerm:
    """Read a text that is one term, with or without a full stop.

    Args:
        text: the text.
        operators: the operators that hold.
        source: a name for the text, for errors.
        flags: see `ReadFlags`.
        positions: keep the places of the parts (see `ReadTerm.place_of`); costs some time.

    Raises:
        SyntaxFault: where the text is not exactly one term.
    """
    where = Source(source, text)
    found = list(tokens(where, flags))
    for at, token in enumerate(found):
        if token[0] == END and at + 1 < len(found):
            raise where.fault("expected nothing behind the full stop", found[at + 1][2])
    if not found or found[0][0] == END:
        raise where.fault("expected a term", found[0][2] if found else 0)
    return read_tokens(found, where, operators, flags, positions)


def read_tokens(
    clause: List[AnyToken], source: Source, operators: Operators, flags: ReadFlags, positions: bool
) -> ReadTerm:
    """Read one clause from its tokens, at least one."""
    marked = False
    for token in clause:
        kind = token[0]
        if kind == "bad":
            raise source.fault(token[1], token[2])
        if (kind in (NAME, QUOTED)) and token[1] in MARKERS:
            marked = True
    start, end = clause[0][2], clause[-1][3]
    if clause[-1][0] != END:
        clause = [*clause, ("eof", None, end, end)]
    clause = [*clause, ("eof", None, end, end), ("eof", None, end, end)]
    rules = layout(clause, operators) if marked else NO_RULES
    spots: Optional[Dict[int, Tuple[int, ...]]] = {} if positions else None
    parser = Parser(clause, source, operators, flags, rules, spots)
    return ReadTerm(parser, parser.read(), start)


__all__ = ["Program", "ReadTerm", "chain", "read_program", "read_term"]
