"""Text to terms: one term, or a program clause by clause."""

from typing import Any, Dict, Iterator, List, Optional, Tuple, Union

from ...foundation.errors import Place, SyntaxFault
from ..terms.types import Term, Var
from .operators import Operators
from .parser import Parser
from .parser_stack import starts_line
from .quoted_text import closing, unclosed_end
from .rule_detection import MARKERS, NO_RULES, layout
from .tokenizer import END, NAME, QUOTED, TEXT, VARIABLE, AnyToken, ReadFlags, Source, tokens, unclosed

DEFAULT = ReadFlags()
OF_FILES = ReadFlags(multiline=True)
"""How the files of a program are read."""

_FIRST_TOKENS = 16
"""Tokens that are looked at first where a full stop was missing."""

_AHEAD = 4
"""Tokens after the one that it is at that the parser may look at, and one."""


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

    def place_of(self, part: Term, number: int = 0) -> Place:
        """Return the place of a compound term inside ``term``: that of its functor or operator.

        With ``number`` it is the place where that argument begins. ``part`` must be the very object; for any
        other the place of the whole term is returned.
        """
        spots = self._spots.get(id(part))
        if spots is None:
            return self._source.place(self.offset)
        return self._source.place(spots[number if number < len(spots) else 0])

    def place_at(self, *path: int) -> Place:
        """Return the place of the part that a path of argument numbers (from 1) leads to.

        ``place_at(2, 1)`` is the first argument of the second argument. Where the path leads into a list
        or out of the term, it is the place of what is around it.
        """
        part: Any = self.term
        offset = self.offset
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
    at when the next clause is asked for. ``end`` is where the full stop of the last clause ends.
    """

    def __init__(
        self,
        text: str,
        operators: Operators,
        source: str = "text",
        flags: ReadFlags = DEFAULT,
        first_line: int = 1,
    ):
        self.operators = operators
        self._source = Source(source, text, first_line)
        self.flags = flags
        self._stream = self._tokens_from(_after_interpreter(text))
        self._again: Optional[Tuple[List[AnyToken], int]] = None
        self.end = 0

    def __iter__(self) -> Iterator[Union[ReadTerm, SyntaxFault]]:
        while True:
            if self._again is not None:
                yield self._read_rest(*self._again)
                continue
            clause = self._clause()
            if not clause:
                return
            read = self._read(clause, 0, len(clause)) or self._no_clause(clause)
            yield self._without_lines(clause) or read if isinstance(read, SyntaxFault) else read

    def _clause(self) -> List[AnyToken]:
        """Return the tokens up to the next full stop; none at the end of the text."""
        clause: List[AnyToken] = []
        for token in self._stream:
            clause.append(token)
            if token[0] == END:
                self.end = token[3]
                break
        return clause

    def _tokens_from(self, start: int) -> Iterator[AnyToken]:
        return tokens(self._source, lambda: self.flags, start)

    def _without_lines(self, clause: List[AnyToken]) -> Optional[SyntaxFault]:
        """Return the fault of the first quote that goes on in the next line, and go on behind its own; None for none.

        Of a clause that does not read, such a quote was most often meant to end on its line.
        """
        text = self._source.text
        for kind, _, start, end in clause if self.flags.multiline else ():
            if kind in (QUOTED, TEXT) and "\n" in text[start:end] and closing(text, start) is None:
                self._again = None
                self._stream = self._tokens_from(unclosed_end(text, start))
                return self._rest_of_clause(self._source.fault(unclosed(text[start], start, text), start))
        return None

    def _rest_of_clause(self, fault: SyntaxFault) -> SyntaxFault:
        """Pass over the rest of a clause that has a fault."""
        self._clause()
        return fault

    def _read_rest(self, clause: List[AnyToken], start: int) -> Union[ReadTerm, SyntaxFault]:
        """Read the tokens of a clause from ``start`` on, where a full stop was missing.

        Another may be missing soon: of thousands of lines without one, each is read by looking at the next few.
        """
        end = start + _FIRST_TOKENS
        while end < len(clause):
            found = self._read(clause, start, end)
            if found is not None:
                return found
            end = start + 4 * (end - start)
        return self._read(clause, start, len(clause)) or self._no_clause(clause)

    def _read(self, clause: List[AnyToken], start: int, end: int) -> Union[ReadTerm, SyntaxFault, None]:
        """Return what the tokens from ``start`` to ``end`` are, or None where more of the clause has to be seen."""
        parser = None
        try:
            parser = _parser(clause[start:end], self._source, self.operators, self.flags, positions=True)
            term = parser.read()
        except SyntaxFault as fault:
            at = start if parser is None else start + parser.at
            if end < len(clause) and at + _AHEAD >= end:
                return None
            self._again = (clause, at) if start < at < len(clause) and self._begins(clause[at]) else None
            return fault
        if end < len(clause) or clause[-1][0] != END:
            return None
        self._again = None
        return ReadTerm(parser, term, clause[start][2])

    def _no_clause(self, clause: List[AnyToken]) -> SyntaxFault:
        self._again = None
        return self._source.fault("expected a full stop at the end of the clause", clause[-1][3])

    def _begins(self, token: AnyToken) -> bool:
        """Tell whether a token that is an error begins a clause: a full stop was missing before its line."""
        kind, _, start, _ = token
        return kind in (NAME, QUOTED, VARIABLE) and starts_line(self._source.text, start)


def _after_interpreter(text: str) -> int:
    """Return where a program begins whose first line may name what runs it."""
    if not text.startswith("#!"):
        return 0
    end = text.find("\n")
    return len(text) if end < 0 else end


def read_program(
    text: str, operators: Operators, source: str = "text", flags: ReadFlags = DEFAULT, first_line: int = 1
) -> Program:
    """Return a reader of all clauses of a program; see `Program`."""
    return Program(text, operators, source, flags, first_line)


def read_term(
    text: str,
    operators: Operators,
    source: str = "text",
    flags: ReadFlags = DEFAULT,
    positions: bool = True,
    first_line: int = 1,
) -> ReadTerm:
    """Read a text that is one term, with or without a full stop.

    Args:
        text: the text.
        operators: the operators that hold.
        source: a name for the text, for errors.
        flags: see `ReadFlags`.
        positions: keep the places of the parts (see `ReadTerm.place_of`); costs some time.
        first_line: the number of the text's first line, where it is a part of a longer one.

    Raises:
        SyntaxFault: where the text is not exactly one term.
    """
    where = Source(source, text, first_line)
    found = list(tokens(where, lambda: flags))
    for at, token in enumerate(found):
        if token[0] == END and at + 1 < len(found):
            raise where.fault("expected nothing after the full stop", found[at + 1][2])
    if not found or found[0][0] == END:
        raise where.fault("expected a term", found[0][2] if found else 0)
    parser = _parser(found, where, operators, flags, positions)
    return ReadTerm(parser, parser.read(), found[0][2])


def _parser(
    clause: List[AnyToken], source: Source, operators: Operators, flags: ReadFlags, positions: bool
) -> Parser:
    """Return a parser for the tokens of one clause, at least one; SyntaxFault where a token is bad."""
    marked = False
    for kind, value, start, _ in clause:
        if kind == "bad":
            raise source.fault(value, start)
        if (kind in (NAME, QUOTED)) and value in MARKERS:
            marked = True
    end = ("eof", None, clause[-1][3], clause[-1][3])
    clause = [*clause, end, end, end]  # so that looking ahead needs no test
    rules = layout(clause, operators) if marked else NO_RULES
    spots: Optional[Dict[int, Tuple[int, ...]]] = {} if positions else None
    return Parser(clause, source, operators, flags, rules, spots)
