"""Reading of clauses with their tokens and the roles of their operators, without message types.

`ClauseReader` reads a rule file as `Program` does, with the operators and flags that its directives set. Its parser
differs in two points: it records which tokens are operators, and it accepts any slots in a message with named slots,
because the types of messages may not be known on the computer on which a file is edited. `read_goal_clauses` reads a
goal file in the same way.
"""

from typing import Any, Dict, Iterator, List, Optional, Union

from ..events.language import event_operators  # noqa: F401  registers the operators of the event language
from ..events.program.event_file_loader import apply_reader_settings
from ..events.program.event_file_parser import DIRECTIVES
from ..events.program.goal_file import GoalLines, read_goal_lines
from ..foundation.errors import SyntaxFault
from ..prolog.files.library_names import declare_operators
from ..prolog.syntax.named_slot_parser import OpenMessage
from ..prolog.syntax.operators import Operator, Operators
from ..prolog.syntax.term_reader import (
    DEFAULT,
    OF_FILES,
    Parser,
    Program,
    ReadTerm,
    create_parser,
    create_term_parser,
)
from ..prolog.syntax.tokenizer import NAME, QUOTED, VARIABLE, AnyToken, Source
from ..prolog.terms.list_terms import conjuncts
from ..prolog.terms.types import Term, atom, deref, functor

_SLOT = functor(":", 2)
_LOADING = frozenset(functor(name, arity) for name in ("use_module", "ensure_loaded") for arity in (1, 2))


class ClauseParser(Parser):
    """Parser that records the operators of a clause, and accepts any slots of messages.

    Attributes:
        uses: definitions of the operators of the clause, by the offsets of their names.
    """

    def __init__(self, *arguments: Any):
        super().__init__(*arguments)
        self.uses: Dict[int, Operator] = {}

    def _push_infix(self, operator: Operator, name: str, start: int) -> None:
        super()._push_infix(operator, name, start)
        # The definition may be that of another table, in which the name has the same role.
        self.uses[start] = self.stack[-1].operator

    def _push_prefix(self, operator: Operator, start: int) -> None:
        super()._push_prefix(operator, start)
        self.uses[start] = operator

    def _apply_postfix(self, operator: Operator, start: int) -> None:
        super()._apply_postfix(operator, start)
        self.uses[start] = operator

    def _open_named_message(self, name: str, start: int) -> bool:
        if self.tokens[self.position][2] != self.tokens[self.position - 1][3]:
            return False
        # An operator before a curly bracket is not the name of a message, as in `X = {a}`.
        if name in self.operators.prefix or name in self.table:
            return False
        if self._is_constant():
            # The text of the constant; its value is not known here.
            self.position += 3
            self._set_left(atom(f"{name}{{{self.tokens[self.position - 2][1]}}}"), start)
        else:
            self._open_message(name, start, ())
        return True

    def _is_constant(self) -> bool:
        """Return whether the bracket at the position contains one word, the name of a constant."""
        name, closing = self.tokens[self.position + 1 : self.position + 3]
        return name[0] in (NAME, VARIABLE) and closing[0] == "}"

    def _open_nested_message(self, start: int) -> bool:
        # A message in a list and a constant are read as terms in curly brackets, which have the same tokens.
        if (
            self._is_constant()
            or self.stack[-1] is not self.brackets[-1]
            or not isinstance(self.brackets[-1], OpenMessage)
        ):
            return False
        self._open_message("{}", start, ())
        return True

    def _begin_slot(self, message: OpenMessage) -> None:
        token, following = self.tokens[self.position], self.tokens[self.position + 1]
        if token[0] not in (NAME, QUOTED) or following[:2] != (NAME, ":"):
            raise self._slot_name_error()
        message.items.append(atom(token[1]))
        message.slot_number = len(message.items)
        self.position += 2
        self._begin_segment(self.position, self.operators.infix)

    def _close_message(self, message: OpenMessage) -> None:
        self.brackets.pop()
        self.stack.pop()
        self.position += 1
        self.table = message.table
        values = [message.values[number] for number in range(1, len(message.items) + 1)]
        if values:
            slots = [(_SLOT, name, value) for name, (value, _) in zip(message.items, values)]
            self._build(
                (functor(message.name, len(slots)), *slots),
                message.start,
                tuple(offset for _, offset in values),
            )
        else:
            self.left = atom(message.name)
        self.left_offset = message.start
        self.left_priority = 0
        self.wants_operand = False


class ParsedClause(ReadTerm):
    """A clause, directive or goal with its tokens.

    Attributes:
        source: the text that contains the clause.
        tokens: its tokens; the last one is the full stop, which a goal may lack.
        uses: definitions of its operators, by the offsets of their names.
    """

    __slots__ = ("source", "tokens", "uses")

    def __init__(self, parser: ClauseParser, term: Term, offset: int):
        super().__init__(parser, term, offset)
        self.source = parser.source
        # Without the tokens after the end, which the parser looks ahead to.
        self.tokens: List[AnyToken] = list(parser.tokens[:-3])
        self.uses = parser.uses


class ClauseReader(Program):
    """Reads a rule file clause by clause, see `Program`; yields a `ParsedClause` or a `SyntaxFault` for each."""

    def __init__(self, text: str, source: str):
        super().__init__(text, Operators.prolog(), source, OF_FILES)

    def __iter__(self) -> Iterator[Union[ReadTerm, SyntaxFault]]:
        for read_term in super().__iter__():
            yield read_term
            term = None if isinstance(read_term, SyntaxFault) else deref(read_term.term)
            if term.__class__ is tuple and term[0] in DIRECTIVES:
                self.apply_directive(term[1])

    def apply_directive(self, goal: Term) -> None:
        """Apply the operators and flags of a directive to the rest of the text."""
        apply_reader_settings(goal, self)
        for part in conjuncts(goal):
            if part.__class__ is tuple and part[0] in _LOADING:
                declare_operators(part[1], self.operators)

    def _create_parser(self, clause: List[AnyToken]) -> Parser:
        return create_parser(clause, self._source, self.operators, self.flags, True, ClauseParser)

    def _create_result(self, parser: Parser, term: Term, offset: int) -> ReadTerm:
        assert isinstance(parser, ClauseParser)
        return ParsedClause(parser, term, offset)


def read_goal_clauses(text: str, source: str, settings: Optional[ClauseReader] = None) -> Iterator[GoalLines]:
    """Yield the goals of a goal file with their lines; a goal is a `ParsedClause`.

    Args:
        text: text of the file, or a part of it.
        source: name of the file in errors.
        settings: operators and flags, which the goals change; by default those of a new file.
    """
    if settings is None:
        settings = ClauseReader("", source)

    def read_lines(part: str, first_line: int) -> ReadTerm:
        parser = create_term_parser(
            Source(source, part, first_line), settings.operators, DEFAULT, True, ClauseParser
        )
        assert isinstance(parser, ClauseParser)
        return ParsedClause(parser, parser.read(), parser.tokens[0][2])

    for goal_lines in read_goal_lines(text, read_lines):
        yield goal_lines
        if isinstance(goal_lines.goal, ReadTerm):
            settings.apply_directive(goal_lines.goal.term)
