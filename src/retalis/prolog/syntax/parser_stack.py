"""Where the reading of a clause stands: its tokens, what has been read, and what is open.

What is wrong with a clause, and what its author most likely meant.

What is open while a term is read: operators that wait for an argument, and brackets.

It lies on a stack, innermost last. There is no recursion, so no depth of nesting can exhaust Python's stack.

Every stack entry begins with the highest priority that may stand there. An operator of a higher priority
closes the operators before it, as far as their arguments allow; at a bracket that is a priority clash.
"""

from difflib import get_close_matches
from typing import Any, Dict, List, Optional, Sequence, Tuple

from ...foundation.errors import SyntaxFault
from ..terms.types import COMMA, CONS, NIL, Term, Var, functor
from .event_operators import EVENT_OPERATORS, OperatorKind
from .message_fields import Expanded
from .operators import CANONICAL, Operator, Operators
from .rule_detection import ARROW, GOAL_RIGHT, NO_RULES, Layout
from .tokenizer import END, NAME, NUMBER, OPEN_CT, QUOTED, VARIABLE, AnyToken, ReadFlags, Source, shown

INFIX, PREFIX, GROUP, ARGUMENTS, LIST, SLOTS = range(6)  # the operators come first

OperatorTable = Dict[str, Operator]


class ParserState:
    """The tokens of a clause, and how far it has been read; ``left`` is the term that was read last.

    ``INFIX``, ``PREFIX`` and ``GROUP`` are kinds of entries on its stack, for those who look at it.

    Attributes:
        names: name -> variable, in order of appearance, without ``_``.
        counts: name -> how often it stands in the clause.
        spots: ``id`` of a compound term -> offsets of its functor and of its arguments.
        expanded: the messages whose slots were named.
    """

    INFIX, PREFIX, GROUP = INFIX, PREFIX, GROUP

    def __init__(
        self,
        tokens: Sequence[AnyToken],
        source: Source,
        operators: Operators,
        flags: ReadFlags,
        rules: Layout = NO_RULES,
        spots: Optional[Dict[int, Tuple[int, ...]]] = None,
    ):
        self.tokens = tokens
        self.source = source
        self.operators = operators
        self.flags = flags
        self.rules = rules
        self.spots = spots
        self.names: Dict[str, Var] = {}
        self.counts: Dict[str, int] = {}
        self.expanded: List[Expanded] = []
        self.at = 0
        self.stack: List[Any] = []
        self.brackets: List[List[Any]] = []
        self.table: OperatorTable = operators.infix
        self.patterns: Optional[OperatorTable] = operators.patterns() if rules is not NO_RULES else None
        self.left: Term = NIL
        self.left_priority = 0
        self.left_at = 0
        self.wants_operand = True
        self.argument_limit = 999 if flags.iso else 1200

    def text_at(self, start: int) -> str:
        """Return the text of the token that begins at an offset."""
        for token in self.tokens:
            if token[2] == start:
                return self.source.text[start : token[3]]
        return ""


CLOSER = {"(": ")", OPEN_CT: ")", "[": "]", "{": "}"}
_NECKS = frozenset((":-", "-->", *(one.meant for one in EVENT_OPERATORS if one.kind is OperatorKind.RULE)))
_ELSEWHERE = {
    "<=": '"less or equal" is written =<',
    "=>": '"greater or equal" is written >=, a rule\'s arrow <-',
    "!=": '"not equal" is written \\== (or =\\= for numbers)',
    "<>": '"not equal" is written \\== (or =\\= for numbers)',
    "&&": 'goals are joined with "," and patterns with "and"',
    "&": 'goals are joined with "," and patterns with "and"',
    "||": 'alternatives are joined with ";" in goals and with "or" in patterns',
    "#": '"#" is not an operator in a goal',
    "not": "a goal is negated with \\+; the absence of an event is written with cnot or fnot",
    "<--": "a rule's arrow is written <-",
    ".": "a full stop ends a clause only where a space or a new line follows; a number needs digits on both"
    " sides of its point",
}
"""Operators of other languages."""

_ADVICE = {word: one.advice for one in EVENT_OPERATORS for word in one.taken_for}
_JOINING = [
    f'"{one.name}"' for one in EVENT_OPERATORS if one.kind in (OperatorKind.ALTERNATIVES, OperatorKind.PAIR)
]


def no_operand(parser: ParserState, innermost: List[Any]) -> SyntaxFault:
    """Return the error about a token that stands where a term should begin."""
    token = parser.tokens[parser.at]
    what = shown(token, parser.source.text)
    kind = innermost[1]
    if kind == parser.INFIX:
        message = f'expected the right argument of "{parser.text_at(innermost[5])}" before {what}'
    elif kind == parser.PREFIX:
        message = f'expected the argument of "{parser.text_at(innermost[3])}" before {what}'
    elif token[0] == END and innermost[2] is None:
        message = "expected a clause before the full stop"
    else:
        message = f"expected a term before {what}"
    return _fault(parser, message, _operand_hint(parser, token))


def _operand_hint(parser: ParserState, token: AnyToken) -> str:
    before = _before(parser)
    if before is not None and before[0] == ",":
        if token[0] == END:
            return "a clause ends with a full stop, without a comma before it"
        return "is the comma before it superfluous?"
    if token[0] == "|":
        return '"|" is allowed only between terms; to write the atom, quote it'
    return ""


def no_operator(parser: ParserState, bracket: List[Any]) -> SyntaxFault:
    """Return the error about a token that stands where a term has ended."""
    token = parser.tokens[parser.at]
    text = parser.source.text
    opened = bracket[2]
    if opened is None:
        expected = "an operator or a full stop"
    else:
        opener = parser.tokens[opened][0]
        choice = {"[": '",", "|" or "]"', OPEN_CT: '"," or ")"'}.get(
            opener, f'an operator or "{CLOSER[opener]}"'
        )
        expected = choice if bracket[1] != parser.GROUP else f'an operator or "{CLOSER[opener]}"'
    message = f"expected {expected} before {shown(token, text)}"
    return _fault(parser, message, _operator_hint(parser, token, opened))


def _operator_hint(parser: ParserState, token: AnyToken, opened: Optional[int]) -> str:
    kind, value, start, _ = token
    text = parser.source.text
    before = _before(parser)
    assert before is not None
    if kind == VARIABLE and value in CANONICAL:
        return f"{value} is a variable here; as an operator write {CANONICAL[value]} or '{value}'"
    if starts_line(text, start):
        if opened is not None:
            return f"the {_opener(parser, opened)} is still open"
        return f"is a full stop missing after {shown(before, text)}?"
    if before[0] == NAME and before[1] in _ELSEWHERE and before[1] != ".":
        return _ELSEWHERE[before[1]]
    if kind == NAME and value == "!" and text[start + 1 : start + 2] == "=":
        return _ELSEWHERE["!="]
    return _hint_of_two(before, token) or (_unknown_operator(parser, value) if kind in (NAME, QUOTED) else "")


def _hint_of_two(before: AnyToken, token: AnyToken) -> str:
    """Return what is likely wrong with two tokens that follow each other, or nothing."""
    kind, _, start, _ = token
    if before[0] == QUOTED and before[3] == start:
        return "a quote inside quotes is doubled, as in 'it''s'"
    if kind == NUMBER and before[0] == NAME and before[1] == ".":
        return "a number needs digits on both sides of its point"
    if kind == "(" and before[0] in (NAME, QUOTED):
        return f"no space is allowed between {before[1]} and its bracket"
    if kind == OPEN_CT and before[0] == VARIABLE:
        return (
            f"{before[1]} is a variable; "
            "the name of an event or predicate starts with a lower-case letter or is quoted"
        )
    if kind == NUMBER and before[0] == NUMBER:
        return "is a comma missing? (groups of digits are written 1_000_000)"
    return ""


def _unknown_operator(parser: ParserState, name: str) -> str:
    if name in _ELSEWHERE:
        return _ELSEWHERE[name]
    words = [known for known in {**parser.operators.infix, **parser.operators.postfix} if known[0].isalpha()]
    close = get_close_matches(name, words, 1, 0.75)
    if close:
        return f'did you mean "{close[0]}"?'
    if parser.table is not parser.patterns:
        return f'"{name}" is not an operator here; is a comma missing?'
    if name in _ADVICE:
        return _ADVICE[name]
    known = f"{', '.join(_JOINING[:-1])} or {_JOINING[-1]}"
    return f'"{name}" is not an operator; two patterns are joined with {known}'


def unbalanced(parser: ParserState, opened: Optional[int]) -> SyntaxFault:
    """Return the error about a closing bracket, or an end, that does not fit what is open."""
    token = parser.tokens[parser.at]
    what = shown(token, parser.source.text)
    if opened is None:
        return _fault(
            parser, f"{what} does not close anything: expected an operator or a full stop before it", ""
        )
    closer = CLOSER[parser.tokens[opened][0]]
    return _fault(parser, f'expected "{closer}" for the {_opener(parser, opened)} before {what}', "")


def clash(parser: ParserState, found: Operator, start: int, outer: Optional[Operator]) -> SyntaxFault:
    """Return the error about an operator whose priority does not fit.

    Args:
        parser: where it is.
        found: the operator.
        start: its offset.
        outer: the operator that it should be an argument of; None where its own left argument is too high.
    """
    name = parser.text_at(start)
    left = parser.left[0].name if parser.left.__class__ is tuple else ""
    if found.functor.name in _NECKS and (outer or left in _NECKS):
        other = outer.functor.name if outer else left
        message = f'expected one arrow in a clause, not "{other}" and "{name}"'
        hint = "an event rule has <-, a Prolog clause :-; is a full stop missing between two clauses?"
    elif outer is not None:
        message = (
            f'expected brackets: "{name}" ({found.priority} {found.type}) cannot be an argument of "'
            f'{outer.functor.name}"'
            f" ({outer.priority} {outer.type})"
        )
        hint = ""
    elif left:
        message = (
            f'expected brackets: the left argument of "{name}" ({found.priority} {found.type}) is "{left}"'
        )
        hint = f"{name} cannot be chained" if left == name else ""
    else:
        message, hint = f'expected brackets around the argument with "{name}" ({found.priority})', ""
    return _fault(parser, message, hint, start)


def _opener(parser: ParserState, opened: int) -> str:
    offset = parser.tokens[opened][2]
    place = parser.source.place(offset)
    return f'"{parser.source.text[offset]}" in line {place.line}, column {place.column}'


def _before(parser: ParserState) -> Optional[AnyToken]:
    return parser.tokens[parser.at - 1] if parser.at else None


def starts_line(text: str, offset: int) -> bool:
    """Tell whether a token stands where clauses begin: at the start of a line, not of the text."""
    return offset > 0 and text[offset - 1] == "\n"


def _fault(parser: ParserState, message: str, hint: str, offset: Optional[int] = None) -> SyntaxFault:
    if offset is None:
        offset = parser.tokens[parser.at][2]
    return parser.source.fault(f"{message}; {hint}" if hint else message, offset)


_CURLY = functor("{}", 1)
_RULE = functor("rule:", 2)
LABEL = Operator(1200, 1199, 1200, _RULE, "xfy")
_RULE_NECKS = frozenset((functor(":-", 2), functor("-->", 2)))
_COMMA = Operator(1000, 999, 1000, COMMA, "xfy")


class ParserStack(ParserState):
    """What is open while a clause is read, opened and closed."""

    def _have(self, term: Term, start: int) -> None:
        self.left = term
        self.left_priority = 0
        self.left_at = start
        self.wants_operand = False

    def _push_prefix(self, found: Operator, start: int) -> None:
        if found.priority > self.stack[-1][0]:
            top = self.stack[-1]
            raise clash(self, found, start, top[2] if top[1] <= PREFIX else None)
        self.stack.append((found.right, PREFIX, found, start, self.table))

    def _push_group(self, at: Optional[int], start: int) -> None:
        """Open a round or curly bracket, or the clause itself (``at`` is None)."""
        self._push_bracket([1200, GROUP, at, self.table, start])
        inner = self.table if at is None or self.tokens[at][0] != "{" else self.operators.infix
        self._begin_segment(self.at, inner)

    def _push_bracket(self, entry: List[Any]) -> None:
        self.stack.append(entry)
        self.brackets.append(entry)

    def _begin_segment(self, at: int, table: Optional[OperatorTable]) -> None:
        """Set the operators for what begins at the token ``at``."""
        headed = self.rules.rules.get(at) if self.patterns is not None else None
        if headed is not None:
            table = self.operators.infix if headed else self.patterns
        self.table = table if table is not None else self.operators.infix
        self.wants_operand = True

    # -- operators ---------------------------------------------------------------------------------------

    def _make_room(self, found: Operator, name: str, start: int) -> Operator:
        """Close operators until ``found`` fits as the next one; return it as it is in the table then.

        The table may change on the way, when the goal of a pattern ends.
        """
        stack = self.stack
        while True:
            top = stack[-1]
            limit, priority = top[0], found[0]
            if limit > priority:
                break
            if top[1] > PREFIX:
                if limit < priority:
                    raise clash(self, found, start, None)
                break
            if limit == priority and not (found[1] == priority and top[2][0] == priority):
                break
            table = self.table
            self._reduce()
            if table is not self.table:
                found = self.table.get(name, found)
        if self.left_priority > found[1]:
            raise clash(self, found, start, None)
        return found

    def _take_postfix(self, found: Operator, start: int) -> None:
        self._make_room(found, "", start)
        self._build((found.functor, self.left), start, (self.left_at,))
        self.left_priority = found.priority

    def _push_infix(self, found: Operator, name: str, start: int) -> None:
        label = self.rules.labels.get(self.at - 1) if found is LABEL else None
        if found[0] > self.stack[-1][0] or found[0] == self.stack[-1][0] or self.left_priority:
            found = self._make_room(found, name, start)
        if self.table is self.patterns and found.functor in _RULE_NECKS:
            raise clash(self, found, start, self.operators.infix.get("<-", found))
        self.stack.append((found.right, INFIX, found, self.left, self.left_at, start, self.table))
        self.wants_operand = True
        if self.patterns is not None:
            self._switch(found, label)

    def _switch(self, found: Operator, label: Optional[bool]) -> None:
        """Set the operators for the right argument of ``found``, in a clause with event rules."""
        if found is LABEL:
            self.table = self.patterns if label is False and self.patterns else self.operators.infix
        elif found.functor is ARROW:
            self.table = self.patterns or self.table
        elif self.table is self.patterns and found.functor in GOAL_RIGHT:
            self.table = self.operators.infix

    def _reduce(self) -> None:
        """Build the term of the innermost waiting operator."""
        top = self.stack.pop()
        found = top[2]
        if top[1] == INFIX:
            left_at = top[4]
            self._build((found.functor, top[3], self.left), top[5], (left_at, self.left_at))
            self.left_at = left_at
            self.table = top[6]
        else:
            self._build((found.functor, self.left), top[3], (self.left_at,))
            self.left_at = top[3]
            self.table = top[4]
        self.left_priority = found.priority

    def _build(self, term: Term, start: int, arguments: Tuple[int, ...]) -> None:
        self.left = term
        if self.spots is not None:
            self.spots[id(term)] = (start, *arguments)

    # -- brackets ----------------------------------------------------------------------------------------

    def _innermost(self) -> List[Any]:
        """Close all waiting operators of the innermost bracket and return its entry."""
        stack = self.stack
        while stack[-1][1] <= PREFIX:
            self._reduce()
        return self.brackets[-1]

    def _comma(self, start: int) -> None:
        kind = self.brackets[-1][1]
        self.at += 1
        if kind == GROUP:
            self._push_infix(_COMMA, ",", start)
            return
        bracket = self._innermost()
        if kind == LIST:
            if bracket[6]:
                raise self.source.fault('expected "]": a list has one term after "|"', start)
            self._add(bracket)
            self._begin_segment(self.at, self.operators.infix)
            return
        self._add(bracket)
        modes = bracket[8]
        pattern = len(bracket[4]) < len(modes) and modes[len(bracket[4])]
        self._begin_segment(self.at, self.patterns if pattern else self.operators.infix)

    def _add(self, bracket: List[Any]) -> None:
        bracket[4].append(self.left)
        if self.spots is not None:
            bracket[5].append(self.left_at)

    def _bar(self, start: int) -> None:
        if self.brackets[-1][1] == LIST:
            bracket = self._innermost()
            if bracket[6]:
                raise self.source.fault('expected "]": a list has one term after "|"', start)
            self._add(bracket)
            bracket[6] = True
            self.at += 1
            self._begin_segment(self.at, self.operators.infix)
            return
        infix = self.table.get("|")
        if infix is None:
            raise no_operator(self, self.brackets[-1])
        self.at += 1
        self._push_infix(infix, "|", start)

    def _close(self, kind: str) -> None:
        bracket = self._innermost()
        opened = bracket[2]
        expected = END if opened is None else CLOSER[self.tokens[opened][0]]
        if kind != expected and not (opened is None and kind == "eof"):
            raise unbalanced(self, opened)
        self.at += 1
        self.stack.pop()
        self.brackets.pop()
        self.table = bracket[3]
        if bracket[1] == GROUP:
            if kind == "}":
                self._build((_CURLY, self.left), bracket[4], (self.left_at,))
            self.left_at = bracket[4]
        else:
            self._add(bracket)
            if bracket[1] == LIST:
                self._close_list(bracket)
            else:
                self._close_arguments(bracket)
        self.left_priority = 0

    def _close_list(self, bracket: List[Any]) -> None:
        items = bracket[4]
        term = items.pop() if bracket[6] else NIL
        for item in reversed(items):
            term = (CONS, item, term)
        self._build(term, self.tokens[bracket[2]][2], tuple(bracket[5]))
        self.left_at = self.tokens[bracket[2]][2]

    def _close_arguments(self, bracket: List[Any]) -> None:
        items = bracket[4]
        self._build((functor(bracket[6], len(items)), *items), bracket[7], tuple(bracket[5]))
        self.left_at = bracket[7]
