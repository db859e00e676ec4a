"""Reading of terms: a single term, or a program clause by clause.

`Parser` is an operator-precedence parser without recursion. It alternates between two states (ISO 13211-1, 6.3): it
expects an operand, or it has one (``left``) and expects an operator, a separator or the end of the innermost bracket.
The stack is described in `parser_stack`. A name can be an atom, a functor, and a prefix, infix or postfix operator at
the same time. The parser resolves that with at most three tokens of look-ahead, in the way of SWI-Prolog: ``- (1)``
is a compound term, ``- = x`` an equation about the atom ``-``, and ``-1`` a number.

`read_term` reads a text that is exactly one term. `Program` reads clauses incrementally, because a directive may
declare operators or change flags for the clauses that follow: tokens are generated lazily, and each clause is parsed
when it is requested.

Error recovery: after a syntax error, reading continues with the next clause. Two mistakes would otherwise hide
everything up to the next full stop, so they are handled separately:

* A missing full stop. If the erroneous token begins a line, it probably begins a clause, and parsing continues there.
* A missing closing quote in multi-line mode. The quote would extend to the next one in the file. If the clause has an
  error and contains such a quote, the quote is reported, and reading continues after its line.
"""

from typing import Any, Dict, Iterator, List, Optional, Tuple, Type, Union

from ...foundation.errors import SyntaxFault
from ...foundation.source_places import Place
from ..terms.types import FALSE, TRUE, Term, Var, atom, functor
from . import parser_stack
from .literals import quote_end, unclosed_quote_end
from .named_slot_parser import NamedSlotParser
from .named_slots import bind_defaults
from .operators import DECLARING, EVENT_SYNTAX, Operators
from .parser_stack import ARGUMENTS, GROUP, LABEL, LIST, OpenBracket, starts_line
from .rule_detection import NO_RULES, detect_rules
from .tokenizer import (
    END,
    NAME,
    NUMBER,
    OPEN_CT,
    QUOTED,
    TEXT,
    VARIABLE,
    AnyToken,
    ReadFlags,
    Source,
    tokenize,
    unclosed_quote_message,
)

DEFAULT = ReadFlags()
"""Flags for single terms."""
OF_FILES = ReadFlags(multiline=True)
"""Flags for the files of a program."""

_FIRST_TOKENS = 16
"""Tokens that are parsed first after a missing full stop."""

_LOOKAHEAD = 4
"""Tokens from an error on that the parser may have read, plus one."""

_BEFORE_GOALS = ((NAME, ":-"), (NAME, "?-"))
"""Tokens that begin a directive or a query."""
_ENDS = frozenset((")", "]", "}", ",", "|", END, "eof"))
"""Kinds of tokens before which a term must be complete."""
_SPECIAL_FLOATS = {"inf": float("inf"), "nan": float("nan")}
"""Floats of event text that Prolog has no syntax for."""
_SPECIAL_BOOLS = {"True": TRUE, "False": FALSE}
"""Booleans as nodes for the original ETALIS-based Retalis write them."""


class Parser(NamedSlotParser):
    """Parses one clause; create a new parser for each clause."""

    def read(self) -> Term:
        """Return the term.

        Raises:
            SyntaxFault: with the place of the error.
        """
        self._push_group(None, 0)
        while self.stack:
            if self.wants_operand:
                self._read_operand()
            else:
                self._read_operator()
        if self.parsed_messages and self.operators.message_types is not None:
            bind_defaults(
                self.left, self.parsed_messages, self.operators.message_types, self.flags.is_constructed
            )
        return self.left

    def _read_operand(self) -> None:
        """Read a token that begins an operand."""
        position = self.position
        token_kind, value, start, _ = self.tokens[position]
        if token_kind in (NAME, QUOTED):
            self._read_name(token_kind, value, start)
            return
        if token_kind == VARIABLE:
            self.position = position + 1
            truth = _SPECIAL_BOOLS.get(value) if self.flags.event_text else None
            self._set_left(self._variable(value) if truth is None else truth, start)
        elif token_kind in (NUMBER, TEXT):
            self.position = position + 1
            self._set_left(value, start)
        elif token_kind == "(" or token_kind == OPEN_CT:
            self.position = position + 1
            self._push_group(position, start)
        elif token_kind == "[" or token_kind == "{":
            self._open_bracket(token_kind, position, start)
        else:
            raise parser_stack.missing_operand_error(self)

    def _variable(self, name: str) -> Var:
        """Return the variable of a name, and count its occurrence; each ``_`` is a new variable."""
        if name == "_":
            return Var()
        variable = self.names.get(name)
        if variable is None:
            variable = self.names[name] = Var()
            self.counts[name] = 1
        else:
            self.counts[name] += 1
        return variable

    def _open_bracket(self, token_kind: str, position: int, start: int) -> None:
        """Open a square or curly bracket: a list, a term in curly brackets, or a nested message."""
        closer = parser_stack.CLOSER[token_kind]
        if token_kind == "{" and self._open_nested_message(start):
            return
        if self.tokens[position + 1][0] == closer:
            self.position = position + 2
            self._read_atom(token_kind + closer, start)
        elif token_kind == "{":
            self.position = position + 1
            self._push_group(position, start)
        else:
            self.position = position + 1
            self._push_bracket(OpenBracket(self.argument_limit, LIST, position, self.table, start))
            self._begin_segment(self.position, self.operators.infix)

    def _read_atom(self, name: str, start: int) -> None:
        """Read a name that is not an operator: an atom, or the functor of a compound term."""
        if self.tokens[self.position][0] == OPEN_CT:
            self._open_arguments(name, start)
        else:
            self._set_left(atom(name), start)

    def _open_arguments(self, name: str, start: int) -> None:
        """Open the arguments of a compound term."""
        position = self.position
        self.position = position + 1
        if self.tokens[self.position][0] == ")":
            raise self.source.fault(
                f'a compound term has at least one argument: expected "{name}" alone', start
            )
        pattern_arguments: Tuple[bool, ...] = ()
        # `seq(a, b)` in a pattern has patterns as arguments. The arity is needed before the arguments are read, to
        # know which arguments these are, so `rule_detection` has counted the commas.
        if self.table is self.patterns:
            arity = self.rules.commas.get(position, 0) + 1
            canonical = functor(EVENT_SYNTAX.canonical_in_patterns.get(name, name), arity)
            pattern_arguments = EVENT_SYNTAX.pattern_arguments.get(canonical, ())
            if pattern_arguments:
                name = canonical.name
        self._push_bracket(
            OpenBracket(self.argument_limit, ARGUMENTS, position, self.table, start, name, pattern_arguments)
        )
        self._begin_segment(
            self.position, self.patterns if pattern_arguments[:1] == (True,) else self.operators.infix
        )

    def _read_name(self, token_kind: str, name: str, start: int) -> None:
        """Read a name at the place of an operand: a functor, a sign, a prefix operator or an atom."""
        self.position += 1
        following = self.tokens[self.position]
        if following[0] == OPEN_CT:
            self._open_arguments(name, start)
            return
        if following[0] == "{" and self._open_named_message(name, start):
            return
        # A minus directly before a number is its sign; `- 1` is the compound term -(1), except in ISO mode.
        if name == "-" and (self.flags.iso or (token_kind == NAME and following[2] == start + 1)):
            number = self._signed_number(following)
            if number is not None:
                self.position += 1
                self._set_left(-number, start)
                return
        prefix = self.operators.prefix.get(name)
        if prefix is not None and self._is_prefix(following):
            self._push_prefix(prefix, start)
            return
        if self.flags.event_text and name in _SPECIAL_FLOATS and token_kind == NAME:
            self._set_left(_SPECIAL_FLOATS[name], start)
            return
        self._set_left(atom(name), start)
        if self.flags.iso and name in self.operators:
            self._check_bare_operator(name, start)

    def _signed_number(self, following: AnyToken) -> Optional[float]:
        """Return the number after a minus sign, or None."""
        if following[0] == NUMBER:
            value: float = following[1]
            return value
        if following[0] == NAME and self.flags.event_text and self.tokens[self.position + 1][0] != OPEN_CT:
            return _SPECIAL_FLOATS.get(following[1])
        return None

    def _check_bare_operator(self, name: str, start: int) -> None:
        """Raise an error if an operator is an operand without brackets, which ISO 13211-1, 6.3.1.3, requires."""
        if self.tokens[self.position][0] not in _ENDS or self.stack[-1].kind < GROUP:
            raise self.source.fault(
                f"expected brackets around the operator {name}, as it is an operand", start
            )

    def _is_prefix(self, following: AnyToken) -> bool:
        """Return whether a prefix operator is used as one, and not as an atom, judging by the tokens that follow."""
        token_kind, value = following[:2]
        if token_kind in _ENDS:
            return False
        if token_kind != NAME and token_kind != QUOTED:
            return True
        operators = self.operators
        if value in operators.prefix or not (value in self.table or value in operators.postfix):
            return True
        # An infix operator follows, so one of the two names is an atom. If an operand follows that operator, it is an
        # infix operator, and the prefix operator is its left operand.
        next_token = self.tokens[self.position + 1]
        if next_token[0] in _ENDS or next_token[0] == OPEN_CT:
            return True
        if next_token[0] != NAME or next_token[1] not in self.table or next_token[1] in operators.prefix:
            return False
        # Two infix operators follow: `- = =` is =(-, =), but in `dynamic seq / 2` the prefix operator is applied.
        return self.tokens[self.position + 2][0] not in _ENDS

    def _read_operator(self) -> None:
        """Read the token after an operand: an operator, a separator, a closing bracket or the end."""
        token_kind, value, start, _ = self.tokens[self.position]
        if token_kind in (NAME, QUOTED):
            self._read_name_after_operand(value, start)
        elif token_kind == ",":
            self._comma(start)
        elif token_kind == "|":
            self._bar(start)
        elif (
            token_kind == ")"
            or token_kind == "]"
            or token_kind == "}"
            or token_kind == END
            or token_kind == "eof"
        ):
            self._close(token_kind)
        else:
            raise self._missing_operator_error()

    def _read_name_after_operand(self, name: str, start: int) -> None:
        """Read a name as an infix or postfix operator."""
        infix = self.table.get(name)
        # The `:` of a label binds more loosely than the rule; elsewhere it is the module operator.
        if self.patterns is not None and self.position in self.rules.labels:
            infix = LABEL
        postfix = self.operators.postfix.get(name)
        if infix is None and postfix is None:
            if self._is_declaration():
                self.wants_operand = True
                self._push_prefix(DECLARING, self.left_offset)
                return
            raise parser_stack.missing_operator_error(self)
        self.position += 1
        if infix is not None and (postfix is None or self._starts_operand(self.tokens[self.position])):
            self._push_infix(infix, name, start)
        elif postfix is not None:
            self._apply_postfix(postfix, start)

    def _is_declaration(self) -> bool:
        """Return whether the operand is the ``event`` of a declaration, ``:- event E.``, and not an atom."""
        position = self.position - 1
        if (
            self.tokens[position][:2] != (NAME, "event")
            or self.patterns is not None
            or self.flags.is_constructed
        ):
            return False
        return position == 0 or (position == 1 and self.tokens[0][:2] in _BEFORE_GOALS)

    def _starts_operand(self, token: AnyToken) -> bool:
        """Return whether a token can begin an operand, so that the operator before it is infix and not postfix."""
        token_kind, value = token[:2]
        if token_kind in _ENDS:
            return False
        if token_kind == NAME and (value in self.table or value in self.operators.postfix):
            return value in self.operators.prefix
        return True


class ReadTerm:
    """A term that was read, with its variable names and positions.

    Attributes:
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
        return tokenize(self._source, lambda: self.flags, start)

    def _unclosed_quote(self, clause: List[AnyToken]) -> Optional[SyntaxFault]:
        """Return the error of the first quoted text that extends over a line end, and continue after its line.

        Return None if there is none. In a clause with an error, such a quote was probably meant to end on its line.
        """
        text = self._source.text
        for token_kind, _, start, end in clause if self.flags.multiline else ():
            if token_kind in (QUOTED, TEXT) and "\n" in text[start:end] and quote_end(text, start) is None:
                # The tokens after the quote were wrong as well, so the text is tokenised anew from there.
                self._resume_at = None
                self._tokens = self._tokens_from(unclosed_quote_end(text, start))
                return self._rest_of_clause(
                    self._source.fault(unclosed_quote_message(text[start], start, text), start)
                )
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
            parser = self._create_parser(clause[start:end])
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
        return self._create_result(parser, term, clause[start][2])

    def _create_parser(self, clause: List[AnyToken]) -> Parser:
        """Return a parser for tokens; a subclass may use another parser."""
        return create_parser(clause, self._source, self.operators, self.flags, True, Parser)

    def _create_result(self, parser: Parser, term: Term, offset: int) -> ReadTerm:
        """Return the result for a term that a parser has read; a subclass may add to it."""
        return ReadTerm(parser, term, offset)

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
    parser = create_term_parser(Source(source, text, first_line), operators, flags, positions, Parser)
    return ReadTerm(parser, parser.read(), parser.tokens[0][2])


def create_term_parser(
    source: Source,
    operators: Operators,
    flags: ReadFlags,
    positions: bool,
    parser_class: Type[Parser],
) -> Parser:
    """Return a parser for a text that is one term, with or without a full stop.

    Raises:
        SyntaxFault: if the text is empty, a token is invalid, or something follows the full stop.
    """
    clause = list(tokenize(source, lambda: flags))
    for position, token in enumerate(clause):
        if token[0] == END and position + 1 < len(clause):
            raise source.fault(
                "expected nothing after the full stop: a goal has a line of its own", clause[position + 1][2]
            )
    if not clause or clause[0][0] == END:
        raise source.fault("expected a term", clause[0][2] if clause else 0)
    return create_parser(clause, source, operators, flags, positions, parser_class)


def create_parser(
    clause: List[AnyToken],
    source: Source,
    operators: Operators,
    flags: ReadFlags,
    positions: bool,
    parser_class: Type[Parser],
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
    rules = detect_rules(clause, operators) if marked else NO_RULES
    offsets: Optional[Dict[int, Tuple[int, ...]]] = {} if positions else None
    return parser_class(clause, source, operators, flags, rules, offsets)
