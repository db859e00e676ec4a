"""State of the parser: tokens, stack of operators and open brackets, and syntax error messages.

`ParserState` holds the state, `ParserStack` opens and closes operators and brackets, and the functions between them
create the `SyntaxFault` for a state that allows no continuation, with a hint at the most likely mistake.

The parser is an operator-precedence parser with an explicit stack (Pratt 1973, without recursion), so nesting depth
is not limited by Python's stack. The stack holds operators that wait for an argument (`WaitingOperator`), and open
brackets (`OpenBracket`), innermost last. Each entry has a limit, the highest priority that its argument may have. An
operator of a higher priority first closes the operators before it (*reduces* them) as far as their arguments allow;
if it reaches a bracket, the priorities clash.

Each entry also holds the operator table that applied before it: in the pattern of an event rule, some names are other
operators than in a goal, so the table changes within a clause (see `rule_detection`).
"""

import re
from typing import TYPE_CHECKING, Any, Dict, List, Optional, Sequence, Tuple

from ...foundation.errors import SyntaxFault
from ...foundation.similar_names import closest_name
from ..terms.types import COMMA, CONS, NIL, Term, Var, functor
from .operators import EVENT_SYNTAX, Operator, Operators
from .rule_detection import ARROW, NO_RULES, RuleLayout
from .tokenizer import (
    END,
    NAME,
    NUMBER,
    OPEN_CT,
    QUOTED,
    VARIABLE,
    AnyToken,
    ReadFlags,
    Source,
    token_description,
)

if TYPE_CHECKING:
    from .named_slots import ParsedMessage

_MAX_PRIORITY = 1200
"""Highest priority of operators, and so of terms."""

# Kinds of stack entries. Operators come first: `kind <= PREFIX` means an operator that waits for an argument.
INFIX, PREFIX, GROUP, ARGUMENTS, LIST, SLOTS = range(6)

OperatorTable = Dict[str, Operator]


class WaitingOperator:
    """Operator on the stack that waits for its right argument, or for its only one.

    Attributes:
        limit: highest priority that the argument may have.
        kind: ``INFIX`` or ``PREFIX``.
        operator: its definition.
        start: offset of its name.
        table: the operator table that applied before it.
        left: left argument of an infix operator.
    """

    __slots__ = ("limit", "kind", "operator", "start", "table", "left", "left_offset")

    def __init__(
        self,
        kind: int,
        operator: Operator,
        start: int,
        table: OperatorTable,
        left: Term = NIL,
        left_offset: int = 0,
    ):
        self.limit = operator.right
        self.kind = kind
        self.operator = operator
        self.start = start
        self.table = table
        self.left = left
        self.left_offset = left_offset


class OpenBracket:
    """Open bracket on the stack, or the clause itself.

    Attributes:
        limit: highest priority that a term directly within it may have.
        kind: ``GROUP``, ``ARGUMENTS``, ``LIST`` or ``SLOTS``.
        position: index of the bracket's token; None for the clause itself.
        table: the operator table that applied before it.
        start: offset of the term that it builds.
        name: functor name, for arguments.
        pattern_arguments: for arguments of an event operator in functional notation, which of them are patterns.
        items: the arguments or list items that have been read.
        offsets: offsets of the items, if positions are recorded.
        has_bar: whether the bar of a list has been read.
    """

    __slots__ = (
        "limit",
        "kind",
        "position",
        "table",
        "start",
        "name",
        "pattern_arguments",
        "items",
        "offsets",
        "has_bar",
    )

    def __init__(
        self,
        limit: int,
        kind: int,
        position: Optional[int],
        table: OperatorTable,
        start: int,
        name: str = "",
        pattern_arguments: Tuple[bool, ...] = (),
    ):
        self.limit = limit
        self.kind = kind
        self.position = position
        self.table = table
        self.start = start
        self.name = name
        self.pattern_arguments = pattern_arguments
        self.items: List[Term] = []
        self.offsets: List[int] = []
        self.has_bar = False


class ParserState:
    """The tokens of a clause, and the state of the parser; ``left`` is the term that was read last.

    Attributes:
        names: variables by name, in order of appearance, without ``_``.
        counts: number of occurrences of each name.
        offsets: ``id`` of a compound term -> offsets of its functor and of its arguments.
        parsed_messages: messages with named slots.
        position: index of the next token.
        stack: waiting operators and open brackets, innermost last.
        brackets: the open brackets of the stack.
        table: the infix operators that apply at the next token.
        patterns: the infix operators of patterns; None in a clause without event rules.
        left_priority: priority of ``left``.
        left_offset: offset of ``left``.
        wants_operand: whether an operand is expected next.
        argument_limit: highest priority of an argument or list item; 999 in ISO Prolog.
    """

    def __init__(
        self,
        tokens: Sequence[AnyToken],
        source: Source,
        operators: Operators,
        flags: ReadFlags,
        rules: RuleLayout = NO_RULES,
        offsets: Optional[Dict[int, Tuple[int, ...]]] = None,
    ):
        self.tokens = tokens
        self.source = source
        self.operators = operators
        self.flags = flags
        self.rules = rules
        self.offsets = offsets
        self.names: Dict[str, Var] = {}
        self.counts: Dict[str, int] = {}
        self.parsed_messages: List[ParsedMessage] = []
        self.position = 0
        self.stack: List[Any] = []
        self.brackets: List[OpenBracket] = []
        self.table: OperatorTable = operators.infix
        self.patterns: Optional[OperatorTable] = operators.patterns() if rules is not NO_RULES else None
        self.left: Term = NIL
        self.left_priority = 0
        self.left_offset = 0
        self.wants_operand = True
        self.argument_limit = 999 if flags.iso else _MAX_PRIORITY

    def token_text(self, start: int) -> str:
        """Return the text of the token that begins at an offset."""
        for token in self.tokens:
            if token[2] == start:
                return self.source.text[start : token[3]]
        return ""


CLOSER = {"(": ")", OPEN_CT: ")", "[": "]", "{": "}"}
"""Closing bracket of each opening one."""
_PROLOG_NECKS = frozenset((":-", "-->"))
"""Operators between the head and the body of a Prolog clause."""

_FOREIGN_OPERATORS = {
    "<=": '"less or equal" is written =<',
    "=>": '"greater or equal" is written >=, a rule\'s arrow <-',
    "!=": '"not equal" is written \\== (or =\\= for numbers)',
    "<>": '"not equal" is written \\== (or =\\= for numbers)',
    "&&": 'goals are joined with "," and patterns with "and"',
    "&": 'goals are joined with "," and patterns with "and"',
    "||": 'alternatives are joined with ";" in goals and with "or" in patterns',
    "#": '"#" is not an operator in a goal; a comment begins with %',
    "+=": "a variable keeps its value: write New is N + 1",
    "-=": "a variable keeps its value: write New is N - 1",
    "not": "a goal is negated with \\+; the absence of an event is written with cnot, fnot or without",
    "<--": "a rule's arrow is written <-",
    ".": "a full stop ends a clause only where a space or a new line follows; a number needs digits on both"
    " sides of its point",
}
"""Operators of other languages, and the notation to use instead."""

_FOREIGN_COMMENTS = ("#", "//", "--")
"""Beginnings of comments in other languages."""

_COMPARISON_PRIORITY = 700
_OPENERS = (",", "(", OPEN_CT, "[", "|")
_FILE_NAME = re.compile(r"\w+\.[a-z]\w*")
_SLASHED_NAME = re.compile(r"[/\w]+")


def missing_operand_error(parser: ParserState) -> SyntaxFault:
    """Return the error for a token at which a term should begin."""
    token = parser.tokens[parser.position]
    shown_token = token_description(token, parser.source.text)
    innermost = parser.stack[-1]
    if innermost.kind == INFIX:
        message = (
            f'expected the right argument of "{parser.token_text(innermost.start)}" before {shown_token}'
        )
    elif innermost.kind == PREFIX:
        message = f'expected the argument of "{parser.token_text(innermost.start)}" before {shown_token}'
    elif token[0] == END and innermost.position is None:
        message = "expected a clause before the full stop"
    else:
        message = f"expected a term before {shown_token}"
    return _fault(parser, message, _operand_hint(parser, token))


def _operand_hint(parser: ParserState, token: AnyToken) -> str:
    """Return a hint at the likely mistake before a token at which a term should begin, or an empty text."""
    previous_token = _previous_token(parser)
    if previous_token is not None and previous_token[0] == ",":
        if token[0] == END:
            return "a clause ends with a full stop, without a comma before it"
        return "is the comma before it superfluous?"
    if token[0] == "|" and previous_token is not None and previous_token[0] == "|":
        return _FOREIGN_OPERATORS["||"]
    if token[0] == "|":
        return '"|" is allowed only between terms; to write the atom, quote it'
    return ""


def missing_operator_error(parser: ParserState) -> SyntaxFault:
    """Return the error for a token that follows a complete term."""
    token = parser.tokens[parser.position]
    text = parser.source.text
    bracket = parser.brackets[-1]
    bracket_position = bracket.position
    if bracket_position is None:
        expected = "an operator or a full stop"
    else:
        opener = parser.tokens[bracket_position][0]
        choice = {"[": '",", "|" or "]"', OPEN_CT: '"," or ")"'}.get(
            opener, f'an operator or "{CLOSER[opener]}"'
        )
        expected = choice if bracket.kind != GROUP else f'an operator or "{CLOSER[opener]}"'
    message = f"expected {expected} before {token_description(token, text)}"
    return _fault(parser, message, _operator_hint(parser, token, bracket_position))


def _operator_hint(parser: ParserState, token: AnyToken, bracket_position: Optional[int]) -> str:
    """Return a hint at the likely mistake between two terms, or an empty text."""
    token_kind, value, start, _ = token
    text = parser.source.text
    previous_token = _previous_token(parser)
    assert previous_token is not None
    if token_kind == VARIABLE and value in EVENT_SYNTAX.canonical:
        return (
            f"{value} is a variable here; as an operator write {EVENT_SYNTAX.canonical[value]} or '{value}'"
        )
    if parser.position == 1 and previous_token[1] in _FOREIGN_COMMENTS:
        return "a comment begins with %"
    layout_hint = _rule_layout_hint(parser, previous_token)
    if layout_hint:
        return layout_hint
    # Clauses usually begin at the start of a line: a missing full stop or bracket is then more likely than an
    # unknown operator.
    if starts_line(text, start):
        if bracket_position is not None:
            return f"the {_bracket_description(parser, bracket_position)} is still open"
        return f"is a full stop missing after {token_description(previous_token, text)}?"
    if previous_token[0] == NAME and previous_token[1] in _FOREIGN_OPERATORS and previous_token[1] != ".":
        return _FOREIGN_OPERATORS[previous_token[1]]
    if token_kind == NAME and value == "!" and text[start + 1 : start + 2] == "=":
        return _FOREIGN_OPERATORS["!="]
    unquoted_name = _find_unquoted_name(parser, token, bracket_position)
    if unquoted_name:
        return f"a name with / or a full stop is quoted: '{unquoted_name}'"
    return _hint_for_adjacent_tokens(previous_token, token) or (
        _unknown_operator_hint(parser, value) if token_kind in (NAME, QUOTED) else ""
    )


def _rule_layout_hint(parser: ParserState, previous_token: AnyToken) -> str:
    """Return a hint at a rule that begins with a keyword, lacks a term, or labels it with words, or an empty text."""
    tokens, position = parser.tokens, parser.position
    label = _label_of_words(tokens, position)
    if label:
        return f"a label is one name: write {label}"
    if previous_token[0] != NAME or not EVENT_SYNTAX.canonical:
        return ""
    word = previous_token[1]
    is_operator = EVENT_SYNTAX.canonical.get(word) is not None
    if position == 1 and word == "do":
        return "a rule begins with its head; without an event, write null do Goal <- Pattern"
    if position == 1 and (is_operator or word in _RULE_WORDS):
        return "a rule begins with its head: Head <- Pattern where Goal"
    if position < 2 or tokens[position - 2][0] != NAME:
        return ""
    operator = tokens[position - 2][1]
    # An operator without a right argument was read as a name, and the next operator as another one.
    if operator in EVENT_SYNTAX.canonical and (is_operator or word in EVENT_SYNTAX.arrows):
        return f'a term is missing between "{operator}" and "{word}"'
    return ""


_RULE_WORDS = frozenset(("rule", "event", "if", "when", "on"))
"""Words with which rules of other languages begin."""


def _label_of_words(tokens: Sequence[AnyToken], position: int) -> str:
    """Return one name for the words before a colon if the second word is at a position, or an empty text."""
    start = position - 1
    end = start
    while tokens[end][0] == NAME and tokens[end][1].isidentifier():
        end += 1
    follows_label = start == 0 or tokens[start - 1][:2] == (NAME, ":")
    if end - start < 2 or not follows_label or tokens[end][:2] != (NAME, ":"):
        return ""
    words = [token[1] for token in tokens[start:end]]
    return "_".join(words[1:] if words[0] in ("rule", "label") else words)


def _find_unquoted_name(parser: ParserState, token: AnyToken, bracket_position: Optional[int]) -> str:
    """Return the topic or file name without quotes that ends at a token of an argument, or an empty text."""
    kind, value, start, _ = token
    previous_token = parser.tokens[parser.position - 1]
    pattern = None
    if bracket_position is None or kind != NAME or previous_token[3] != start:
        return ""
    if value == ".":
        pattern = _FILE_NAME
    elif previous_token[:2] == (NAME, "/") and parser.tokens[parser.position - 2][0] in _OPENERS:
        pattern = _SLASHED_NAME
    name = None if pattern is None else pattern.match(parser.source.text, previous_token[2])
    return "" if name is None else name.group()


def _hint_for_adjacent_tokens(previous_token: AnyToken, token: AnyToken) -> str:
    """Return a hint at the likely mistake of two adjacent tokens, or an empty text."""
    token_kind, _, start, _ = token
    if previous_token[0] == QUOTED and previous_token[3] == start:
        return "a quote inside quotes is doubled, as in 'it''s'"
    if token_kind == NUMBER and previous_token[0] == NAME and previous_token[1] == ".":
        return "a number needs digits on both sides of its point"
    if token_kind == "(" and previous_token[0] in (NAME, QUOTED):
        return f"no space is allowed between {previous_token[1]} and its bracket"
    if token_kind == OPEN_CT and previous_token[0] == VARIABLE:
        return (
            f"{previous_token[1]} is a variable; "
            "the name of an event or predicate starts with a lower-case letter or is quoted"
        )
    if token_kind == NUMBER and previous_token[0] == NUMBER:
        return "is a comma missing? (groups of digits are written 1_000_000)"
    return ""


def _unknown_operator_hint(parser: ParserState, name: str) -> str:
    """Return a hint at the operator that a name probably stands for."""
    if name in _FOREIGN_OPERATORS:
        return _FOREIGN_OPERATORS[name]
    words = [word for word in {**parser.operators.infix, **parser.operators.postfix} if word[0].isalpha()]
    closest = closest_name(name, words, 0.75)
    if closest:
        return f'did you mean "{closest}"?'
    if parser.table is not parser.patterns:
        return f'"{name}" is not an operator here; is a comma missing?'
    if name in EVENT_SYNTAX.advice:
        return EVENT_SYNTAX.advice[name]
    *quoted, last = [f'"{joining}"' for joining in EVENT_SYNTAX.joining]
    return f'"{name}" is not an operator; two patterns are joined with {", ".join(quoted)} or {last}'


def unbalanced_bracket_error(parser: ParserState, bracket_position: Optional[int]) -> SyntaxFault:
    """Return the error for a closing bracket, or an end, that does not match the open bracket."""
    token = parser.tokens[parser.position]
    shown_token = token_description(token, parser.source.text)
    if bracket_position is None:
        return _fault(
            parser,
            f"{shown_token} does not close anything: expected an operator or a full stop before it",
            "",
        )
    closer = CLOSER[parser.tokens[bracket_position][0]]
    return _fault(
        parser,
        f'expected "{closer}" for the {_bracket_description(parser, bracket_position)} before {shown_token}',
        "",
    )


def priority_clash_error(
    parser: ParserState, operator: Operator, start: int, outer_operator: Optional[Operator]
) -> SyntaxFault:
    """Return the error for an operator whose priority does not fit.

    Args:
        parser: the parser.
        operator: the operator.
        start: the offset of the operator.
        outer_operator: the operator whose argument it should be; None if its own left argument has too high priority.
    """
    name = parser.token_text(start)
    left = parser.left[0].name if parser.left.__class__ is tuple else ""
    necks = _PROLOG_NECKS | EVENT_SYNTAX.arrows
    if operator.functor.name in necks and (outer_operator or left in necks):
        first = outer_operator.functor.name if outer_operator else left
        message = f'expected one arrow in a clause, not "{first}" and "{name}"'
        hint = "an event rule has <-, a Prolog clause :-; is a full stop missing between two clauses?"
    elif outer_operator is not None:
        message = (
            f'expected brackets: "{name}" ({operator.priority} {operator.type}) cannot be an argument of "'
            f'{outer_operator.functor.name}"'
            f" ({outer_operator.priority} {outer_operator.type})"
        )
        hint = ""
    elif left:
        message = (
            f'expected brackets: the left argument of "{name}" ({operator.priority} {operator.type}) is '
            f'"{left}"'
        )
        hint = f"{name} cannot be chained" if left == name else ""
        if operator.priority == _COMPARISON_PRIORITY and left == name:
            hint += f"; two comparisons are joined with a comma, as A {name} B, B {name} C"
    else:
        message, hint = f'expected brackets around the argument with "{name}" ({operator.priority})', ""
    return _fault(parser, message, hint, start)


def _bracket_description(parser: ParserState, bracket_position: int) -> str:
    offset = parser.tokens[bracket_position][2]
    place = parser.source.place(offset)
    return f'"{parser.source.text[offset]}" in line {place.line}, column {place.column}'


def _previous_token(parser: ParserState) -> Optional[AnyToken]:
    return parser.tokens[parser.position - 1] if parser.position else None


def starts_line(text: str, offset: int) -> bool:
    """Return whether a token begins a line other than the first."""
    return offset > 0 and text[offset - 1] == "\n"


def _fault(parser: ParserState, message: str, hint: str, offset: Optional[int] = None) -> SyntaxFault:
    if offset is None:
        offset = parser.tokens[parser.position][2]
    return parser.source.fault(f"{message}; {hint}" if hint else message, offset)


_CURLY = functor("{}", 1)
_RULE = functor("rule:", 2)
LABEL = Operator(1200, 1199, 1200, _RULE, "xfy")
"""The operator between the label of an event rule and the rule."""
_RULE_NECKS = frozenset((functor(":-", 2), functor("-->", 2)))
_COMMA = Operator(1000, 999, 1000, COMMA, "xfy")


class ParserStack(ParserState):
    """Opens and closes operators and brackets while a clause is parsed."""

    def _set_left(self, term: Term, start: int) -> None:
        self.left = term
        self.left_priority = 0
        self.left_offset = start
        self.wants_operand = False

    def _push_prefix(self, operator: Operator, start: int) -> None:
        # A prefix operator cannot reduce anything, as it has no left argument: it must fit as it is.
        top = self.stack[-1]
        if operator.priority > top.limit:
            raise priority_clash_error(self, operator, start, top.operator if top.kind <= PREFIX else None)
        self.stack.append(WaitingOperator(PREFIX, operator, start, self.table))

    def _push_group(self, bracket_position: Optional[int], start: int) -> None:
        """Open a round or curly bracket, or the clause itself (``bracket_position`` is None)."""
        self._push_bracket(OpenBracket(_MAX_PRIORITY, GROUP, bracket_position, self.table, start))
        # Round brackets keep the table: in `(a seq b) or c` the pattern continues. A curly bracket holds Prolog
        # terms.
        inner_table = (
            self.table
            if bracket_position is None or self.tokens[bracket_position][0] != "{"
            else self.operators.infix
        )
        self._begin_segment(self.position, inner_table)

    def _push_bracket(self, bracket: OpenBracket) -> None:
        self.stack.append(bracket)
        self.brackets.append(bracket)

    def _begin_segment(self, start_position: int, table: Optional[OperatorTable]) -> None:
        """Set the operator table for the segment that begins at a token; see `rule_detection`."""
        has_head = self.rules.rules.get(start_position) if self.patterns is not None else None
        if has_head is not None:
            table = self.operators.infix if has_head else self.patterns
        self.table = table if table is not None else self.operators.infix
        self.wants_operand = True

    # Operators

    def _reduce_until_fits(self, operator: Operator, name: str, start: int) -> Operator:
        """Reduce operators until ``operator`` fits; return its definition in the table that applies then.

        The table changes when the goal of a pattern ends.
        """
        stack = self.stack
        while True:
            top = stack[-1]
            # An operator of a priority below the limit becomes part of the argument, which needs no reduction.
            limit, priority = top.limit, operator.priority
            if limit > priority:
                break
            if top.kind > PREFIX:
                if limit < priority:
                    raise priority_clash_error(self, operator, start, None)
                break
            # Equal priorities: `operator` becomes the argument of the one on the stack (right-associative), unless
            # both have this priority and `operator` accepts it on its left (left-associative).
            if limit == priority and not (operator.left == priority and top.operator.priority == priority):
                break
            # Reducing the last operator of a goal restores the table of the pattern, where the same name may be
            # another operator.
            table = self.table
            self._reduce()
            if table is not self.table:
                operator = self.table.get(name, operator)
        if self.left_priority > operator.left:
            raise priority_clash_error(self, operator, start, None)
        return operator

    def _apply_postfix(self, operator: Operator, start: int) -> None:
        self._reduce_until_fits(operator, "", start)
        self._build((operator.functor, self.left), start, (self.left_offset,))
        self.left_priority = operator.priority

    def _push_infix(self, operator: Operator, name: str, start: int) -> None:
        label = self.rules.labels.get(self.position - 1) if operator is LABEL else None
        # Most operators have a priority below the limit and a left argument without an operator, so they fit as they
        # are.
        if operator.priority >= self.stack[-1].limit or self.left_priority:
            operator = self._reduce_until_fits(operator, name, start)
        if self.table is self.patterns and operator.functor in _RULE_NECKS:
            raise priority_clash_error(self, operator, start, self.operators.infix.get("<-", operator))
        self.stack.append(WaitingOperator(INFIX, operator, start, self.table, self.left, self.left_offset))
        self.wants_operand = True
        if self.patterns is not None:
            self._switch_table(operator, label)

    def _switch_table(self, operator: Operator, label: Optional[bool]) -> None:
        """Set the operator table for the right argument of an operator, in a clause with event rules."""
        if operator is LABEL:
            self.table = self.patterns if label is False and self.patterns else self.operators.infix
        elif operator.functor is ARROW:
            self.table = self.patterns or self.table
        elif self.table is self.patterns and operator.functor in EVENT_SYNTAX.goal_right:
            self.table = self.operators.infix

    def _reduce(self) -> None:
        """Build the term of the operator on top of the stack."""
        top = self.stack.pop()
        operator = top.operator
        if top.kind == INFIX:
            self._build(
                (operator.functor, top.left, self.left), top.start, (top.left_offset, self.left_offset)
            )
            self.left_offset = top.left_offset
        else:
            self._build((operator.functor, self.left), top.start, (self.left_offset,))
            self.left_offset = top.start
        self.table = top.table
        self.left_priority = operator.priority

    def _build(self, term: Term, start: int, arguments: Tuple[int, ...]) -> None:
        self.left = term
        # Identities stay unique while the clause is parsed: every term is part of the clause or on the stack.
        if self.offsets is not None:
            self.offsets[id(term)] = (start, *arguments)

    # Brackets

    def _close_operators(self) -> OpenBracket:
        """Reduce all operators within the innermost bracket, and return the entry of the bracket."""
        stack = self.stack
        while stack[-1].kind <= PREFIX:
            self._reduce()
        return self.brackets[-1]

    def _comma(self, start: int) -> None:
        kind = self.brackets[-1].kind
        self.position += 1
        # Within round brackets the comma is an operator; in argument lists and lists it is a separator.
        if kind == GROUP:
            self._push_infix(_COMMA, ",", start)
            return
        bracket = self._close_operators()
        if kind == LIST:
            if bracket.has_bar:
                raise self.source.fault('expected "]": a list has one term after "|"', start)
            self._add_item(bracket)
            self._begin_segment(self.position, self.operators.infix)
            return
        self._add_item(bracket)
        number, pattern_arguments = len(bracket.items), bracket.pattern_arguments
        is_pattern = number < len(pattern_arguments) and pattern_arguments[number]
        self._begin_segment(self.position, self.patterns if is_pattern else self.operators.infix)

    def _add_item(self, bracket: OpenBracket) -> None:
        bracket.items.append(self.left)
        if self.offsets is not None:
            bracket.offsets.append(self.left_offset)

    def _bar(self, start: int) -> None:
        if self.brackets[-1].kind == LIST:
            bracket = self._close_operators()
            if bracket.has_bar:
                raise self.source.fault('expected "]": a list has one term after "|"', start)
            self._add_item(bracket)
            bracket.has_bar = True
            self.position += 1
            self._begin_segment(self.position, self.operators.infix)
            return
        infix = self.table.get("|")
        if infix is None:
            raise missing_operator_error(self)
        self.position += 1
        self._push_infix(infix, "|", start)

    def _close(self, token_kind: str) -> None:
        bracket = self._close_operators()
        bracket_position = bracket.position
        # A clause ends with a full stop; a single term may also end with the text.
        expected = END if bracket_position is None else CLOSER[self.tokens[bracket_position][0]]
        if token_kind != expected and not (bracket_position is None and token_kind == "eof"):
            raise unbalanced_bracket_error(self, bracket_position)
        self.position += 1
        self.stack.pop()
        self.brackets.pop()
        self.table = bracket.table
        if bracket.kind == GROUP:
            if token_kind == "}":
                self._build((_CURLY, self.left), bracket.start, (self.left_offset,))
            self.left_offset = bracket.start
        else:
            self._add_item(bracket)
            if bracket.kind == LIST:
                self._close_list(bracket)
            else:
                self._close_arguments(bracket)
        self.left_priority = 0

    def _close_list(self, bracket: OpenBracket) -> None:
        items = bracket.items
        term = items.pop() if bracket.has_bar else NIL
        for item in reversed(items):
            term = (CONS, item, term)
        self._build(term, bracket.start, tuple(bracket.offsets))
        self.left_offset = bracket.start

    def _close_arguments(self, bracket: OpenBracket) -> None:
        items = bracket.items
        self._build((functor(bracket.name, len(items)), *items), bracket.start, tuple(bracket.offsets))
        self.left_offset = bracket.start
