"""Reading of terms: a single term, or a program clause by clause.

`read_term` reads a text that is exactly one term. `Program` reads clauses incrementally, because a directive may
declare operators or change flags for the clauses that follow: tokens are generated lazily, and each clause is parsed
when it is requested.

Error recovery: after a syntax error, reading continues with the next clause. Two mistakes would otherwise hide
everything up to the next full stop, so they are handled separately:

* A missing full stop. If the erroneous token begins a line, it probably begins a clause, and parsing continues there.
* A missing closing quote in multi-line mode. The quote would extend to the next one in the file. If the clause has an
  error and contains such a quote, the quote is reported, and reading continues after its line.
"""

from typing import Any, Dict, Iterator, List, Optional, Tuple, Union

from ...foundation.errors import Place, SyntaxFault
from ..terms.types import Term, Var
from .operators import EVENT_SYNTAX, Operators
from .parser import Parser
from .parser_stack import starts_line
from .quoted_text import closing, unclosed_end
from .rule_detection import NO_RULES, layout
from .tokenizer import END, NAME, QUOTED, TEXT, VARIABLE, AnyToken, ReadFlags, Source, tokens, unclosed

DEFAULT = ReadFlags()
"""Flags for single terms."""
OF_FILES = ReadFlags(multiline=True)
"""Flags for the files of a program."""

_FIRST_TOKENS = 16
"""Tokens that are parsed first after a missing full stop."""

_LOOKAHEAD = 4
"""Tokens from an error on that the parser may have read, plus one."""


class ReadTerm:
    """A term that was read, with its variable names and positions.

    Attributes:
        term: the term.
        names: variables by name, in order of appearance, without ``_``.
        singletons: names that occur once and do not begin with ``_``.
        offset: offset of the term in the text.
    """

    __slots__ = ("term", "names", "singletons", "offset", "_source", "_offsets")

    def __init__(self, parser: Parser, term: Term, offset: int):
        self.term = term
        self.names: Dict[str, Var] = parser.names
        self.singletons: List[str] = [
            name for name, count in parser.counts.items() if count == 1 and name[0] != "_"
        ]
        self.offset = offset
        self._source = parser.source
        self._offsets = parser.offsets or {}

    @property
    def place(self) -> Place:
        """The place where the term begins."""
        return self._source.place(self.offset)

    def place_of(self, part: Term, number: int = 0) -> Place:
        """Return the place of a compound term within ``term``: that of its functor or operator.

        Args:
            part: the object itself, not an equal term; for any other object, the place of the whole term is returned.
            number: an argument number from 1 on, for the place where the argument begins; 0 for the functor.
        """
        offsets = self._offsets.get(id(part))
        if offsets is None:
            return self._source.place(self.offset)
        return self._source.place(offsets[number if number < len(offsets) else 0])

    def place_at(self, *path: int) -> Place:
        """Return the place of the subterm at a path of argument numbers (from 1).

        ``place_at(2, 1)`` is the first argument of the second argument. If the path leads into a list or out of the
        term, the place of the enclosing term is returned.
        """
        part: Any = self.term
        offset = self.offset
        for number in path:
            offsets = self._offsets.get(id(part))
            if offsets is None or number >= len(offsets) or part.__class__ is not tuple:
                return self._source.place(offset)
            offset = offsets[number]
            part = part[number] if number < len(part) else None
        offsets = self._offsets.get(id(part))
        return self._source.place(offsets[0] if offsets else offset)


class Program:
    """Reads a program clause by clause; iterate over it.

    Yields a `ReadTerm` for each clause, and a `SyntaxFault` for each clause with an error.

    Attributes:
        operators: the operators for the next clause; may be changed between clauses.
        flags: the flags for the next clause; may be changed between clauses.
        end: offset after the full stop of the last clause.
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
        self._tokens = self._tokens_from(_after_interpreter(text))
        self._resume_at: Optional[Tuple[List[AnyToken], int]] = None
        self.end = 0

    def __iter__(self) -> Iterator[Union[ReadTerm, SyntaxFault]]:
        while True:
            if self._resume_at is not None:
                yield self._read_rest(*self._resume_at)
                continue
            clause = self._clause()
            if not clause:
                return
            read = self._read(clause, 0, len(clause)) or self._missing_full_stop(clause)
            yield self._unclosed_quote(clause) or read if isinstance(read, SyntaxFault) else read

    def _clause(self) -> List[AnyToken]:
        """Return the tokens up to the next full stop; none at the end of the text."""
        clause: List[AnyToken] = []
        for token in self._tokens:
            clause.append(token)
            if token[0] == END:
                self.end = token[3]
                break
        return clause

    def _tokens_from(self, start: int) -> Iterator[AnyToken]:
        return tokens(self._source, lambda: self.flags, start)

    def _unclosed_quote(self, clause: List[AnyToken]) -> Optional[SyntaxFault]:
        """Return the error of the first quoted text that extends over a line end, and continue after its line.

        Return None if there is none. In a clause with an error, such a quote was probably meant to end on its line.
        """
        text = self._source.text
        for token_kind, _, start, end in clause if self.flags.multiline else ():
            if token_kind in (QUOTED, TEXT) and "\n" in text[start:end] and closing(text, start) is None:
                # The tokens after the quote were wrong as well, so the text is tokenised anew from there.
                self._resume_at = None
                self._tokens = self._tokens_from(unclosed_end(text, start))
                return self._rest_of_clause(self._source.fault(unclosed(text[start], start, text), start))
        return None

    def _rest_of_clause(self, fault: SyntaxFault) -> SyntaxFault:
        """Skip the rest of a clause that has an error."""
        self._clause()
        return fault

    def _read_rest(self, clause: List[AnyToken], start: int) -> Union[ReadTerm, SyntaxFault]:
        """Read the tokens of a clause from ``start`` on, after a missing full stop."""
        # More full stops may be missing. Parsing all remaining tokens for each of n lines would take time in n^2, so
        # a few tokens are tried first, and four times as many if the error may lie beyond them.
        end = start + _FIRST_TOKENS
        while end < len(clause):
            read = self._read(clause, start, end)
            if read is not None:
                return read
            end = start + 4 * (end - start)
        return self._read(clause, start, len(clause)) or self._missing_full_stop(clause)

    def _read(self, clause: List[AnyToken], start: int, end: int) -> Union[ReadTerm, SyntaxFault, None]:
        """Parse the tokens from ``start`` to ``end``; return None if the result depends on later tokens."""
        parser = None
        try:
            parser = _parser(clause[start:end], self._source, self.operators, self.flags, positions=True)
            term = parser.read()
        except SyntaxFault as fault:
            position = start if parser is None else start + parser.position
            # Near the end of the excerpt, the error may be the missing continuation.
            if end < len(clause) and position + _LOOKAHEAD >= end:
                return None
            self._resume_at = (
                (clause, position)
                if start < position < len(clause) and self._begins_clause(clause[position])
                else None
            )
            return fault
        # Without its full stop, the term may continue.
        if end < len(clause) or clause[-1][0] != END:
            return None
        self._resume_at = None
        return ReadTerm(parser, term, clause[start][2])

    def _missing_full_stop(self, clause: List[AnyToken]) -> SyntaxFault:
        self._resume_at = None
        return self._source.fault("expected a full stop at the end of the clause", clause[-1][3])

    def _begins_clause(self, token: AnyToken) -> bool:
        """Return whether an erroneous token probably begins a clause, after a missing full stop."""
        token_kind, _, start, _ = token
        return token_kind in (NAME, QUOTED, VARIABLE) and starts_line(self._source.text, start)


def _after_interpreter(text: str) -> int:
    """Return the offset after a first line that names an interpreter (``#!``)."""
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
        operators: the operators.
        source: a name for the text in error messages.
        flags: see `ReadFlags`.
        positions: record the positions of subterms (see `ReadTerm.place_of`); takes more time.
        first_line: number of the first line, if the text is a part of a longer one.

    Raises:
        SyntaxFault: if the text is not exactly one term.
    """
    source_text = Source(source, text, first_line)
    clause = list(tokens(source_text, lambda: flags))
    for position, token in enumerate(clause):
        if token[0] == END and position + 1 < len(clause):
            raise source_text.fault("expected nothing after the full stop", clause[position + 1][2])
    if not clause or clause[0][0] == END:
        raise source_text.fault("expected a term", clause[0][2] if clause else 0)
    parser = _parser(clause, source_text, operators, flags, positions)
    return ReadTerm(parser, parser.read(), clause[0][2])


def _parser(
    clause: List[AnyToken], source: Source, operators: Operators, flags: ReadFlags, positions: bool
) -> Parser:
    """Return a parser for the tokens of one clause.

    Raises:
        SyntaxFault: if a token is invalid.
    """
    # Only clauses that contain an arrow or `do` can be event rules; the analysis of rules is skipped for all others.
    marked = False
    markers = EVENT_SYNTAX.markers
    for token_kind, value, start, _ in clause:
        if token_kind == "bad":
            raise source.fault(value, start)
        if (token_kind in (NAME, QUOTED)) and value in markers:
            marked = True
    end = ("eof", None, clause[-1][3], clause[-1][3])
    clause = [*clause, end, end, end]  # the parser looks ahead without testing for the end
    rules = layout(clause, operators) if marked else NO_RULES
    offsets: Optional[Dict[int, Tuple[int, ...]]] = {} if positions else None
    return Parser(clause, source, operators, flags, rules, offsets)
