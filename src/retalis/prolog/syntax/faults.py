"""What is wrong with a clause, and what its author most likely meant."""

from difflib import get_close_matches
from typing import Any, List, Optional

from ...foundation import SyntaxFault
from .eventoperators import EVENT_OPERATORS, OperatorKind
from .operators import CANONICAL, Operator
from .state import ReadingState
from .tokens import END, NAME, NUMBER, OPEN_CT, QUOTED, VARIABLE, AnyToken, shown

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


def no_operand(parser: ReadingState, innermost: List[Any]) -> SyntaxFault:
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


def _operand_hint(parser: ReadingState, token: AnyToken) -> str:
    before = _before(parser)
    if before is not None and before[0] == ",":
        if token[0] == END:
            return "a clause ends with a full stop, without a comma before it"
        return "is the comma before it superfluous?"
    if token[0] == "|":
        return '"|" is allowed only between terms; to write the atom, quote it'
    return ""


def no_operator(parser: ReadingState, bracket: List[Any]) -> SyntaxFault:
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


def _operator_hint(parser: ReadingState, token: AnyToken, opened: Optional[int]) -> str:
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


def _unknown_operator(parser: ReadingState, name: str) -> str:
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


def unbalanced(parser: ReadingState, opened: Optional[int]) -> SyntaxFault:
    """Return the error about a closing bracket, or an end, that does not fit what is open."""
    token = parser.tokens[parser.at]
    what = shown(token, parser.source.text)
    if opened is None:
        return _fault(
            parser, f"{what} does not close anything: expected an operator or a full stop before it", ""
        )
    closer = CLOSER[parser.tokens[opened][0]]
    return _fault(parser, f'expected "{closer}" for the {_opener(parser, opened)} before {what}', "")


def clash(parser: ReadingState, found: Operator, start: int, outer: Optional[Operator]) -> SyntaxFault:
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


def _opener(parser: ReadingState, opened: int) -> str:
    offset = parser.tokens[opened][2]
    place = parser.source.place(offset)
    return f'"{parser.source.text[offset]}" in line {place.line}, column {place.column}'


def _before(parser: ReadingState) -> Optional[AnyToken]:
    return parser.tokens[parser.at - 1] if parser.at else None


def starts_line(text: str, offset: int) -> bool:
    """Tell whether a token stands where clauses begin: at the start of a line, not of the text."""
    return offset > 0 and text[offset - 1] == "\n"


def _fault(parser: ReadingState, message: str, hint: str, offset: Optional[int] = None) -> SyntaxFault:
    if offset is None:
        offset = parser.tokens[parser.at][2]
    return parser.source.fault(f"{message}; {hint}" if hint else message, offset)
