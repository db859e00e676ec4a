r"""Detection of event rules in the tokens of a clause, before any term is built.

In the pattern of an event rule, the names ``*``, ``#``, ``/\``, ``\/`` are the operators ``seq``, ``par``, ``and``,
``or`` with their priorities; everywhere else they are Prolog's. The parser must therefore know where patterns are
before it reads them. A *segment* is a whole clause, the contents of a pair of brackets, or one argument. The tokens
at its own level (outside of inner brackets) determine its kind:

* With an infix ``<-`` or ``iff``, it is a rule: a head (with ``do``) on the left, a pattern on the right.
* With an infix ``do`` and no arrow, it is a rule without a head: a pattern on the left.
* Otherwise it is plain Prolog, and always if it contains ``:-`` or ``-->``.

A ``:`` or ``'rule:'`` before the rest of a rule belongs to its label; any other ``:`` is Prolog's.
"""

from typing import Dict, List, NamedTuple, Optional, Sequence

from ..terms.types import functor
from .operators import EVENT_SYNTAX, Operators
from .tokenizer import END, NAME, OPEN_CT, QUOTED, AnyToken

_NECKS = frozenset((":-", "-->", "?-", "=>"))
"""Operators of Prolog clauses: a segment with such an operator is not an event rule."""
_OPENING = frozenset(("(", OPEN_CT, "[", "{"))
_CLOSING = frozenset((")", "]", "}"))
_CANNOT_START = frozenset((")", "]", "}", ",", "|", END, "eof"))
"""Kinds of tokens with which a term cannot begin."""
ARROW = functor("<-", 2)


class Segment:
    """The operators at the own level of a segment; all positions are indexes of tokens.

    Attributes:
        start: position of its first token.
        arrow_position: position of the first ``<-`` or ``iff``, or None.
        action_position: position of the first ``do``, or None.
        has_neck: whether it contains an operator of Prolog clauses.
        colon_positions: positions of ``:``.
        label_positions: positions of ``'rule:'``.
        opening: kind of the bracket around it; "" for the clause.
    """

    __slots__ = (
        "start",
        "arrow_position",
        "action_position",
        "has_neck",
        "colon_positions",
        "label_positions",
        "opening",
    )

    def __init__(self, start: int, opening: str):
        self.start = start
        self.arrow_position: Optional[int] = None
        self.action_position: Optional[int] = None
        self.has_neck = False
        self.colon_positions: List[int] = []
        self.label_positions: List[int] = []
        self.opening = opening

    def is_rule(self) -> bool:
        """Return whether this is an event rule."""
        return not self.has_neck and (self.arrow_position is not None or self.action_position is not None)


class RuleLayout(NamedTuple):
    """Positions of event rules in a clause; all keys are indexes of tokens.

    Attributes:
        rules: first token of each segment that is a rule -> whether it begins with a head (otherwise with a pattern).
        labels: ``:`` or ``'rule:'`` of a label -> whether a head follows (otherwise a pattern).
        commas: opening bracket -> number of commas directly within it.
    """

    rules: Dict[int, bool]
    labels: Dict[int, bool]
    commas: Dict[int, int]


NO_RULES = RuleLayout({}, {}, {})


def detect_rules(tokens: Sequence[AnyToken], operators: Operators) -> RuleLayout:
    """Return the positions of the event rules in a clause."""
    result = RuleLayout({}, {}, {})
    stack = [Segment(0, "")]
    bracket_starts: List[int] = []
    for position, token in enumerate(tokens):
        token_kind = token[0]
        if token_kind in (NAME, QUOTED):
            _record_name(stack[-1], tokens, position, operators)
        elif token_kind in _OPENING:
            bracket_starts.append(position)
            result.commas[position] = 0
            stack.append(Segment(position + 1, token_kind))
        elif token_kind in _CLOSING:
            if bracket_starts:
                bracket_starts.pop()
                _finish_segment(stack.pop(), result)
        elif token_kind == "," and bracket_starts:
            result.commas[bracket_starts[-1]] += 1
            if stack[-1].opening in (OPEN_CT, "["):
                _finish_segment(stack.pop(), result)
                stack.append(Segment(position + 1, tokens[bracket_starts[-1]][0]))
        elif token_kind == "|" and stack[-1].opening == "[":
            _finish_segment(stack.pop(), result)
            stack.append(Segment(position + 1, "["))
    # Brackets may be unbalanced: the parser reports that later, with a better message than is possible here.
    while stack:
        _finish_segment(stack.pop(), result)
    return result


def _finish_segment(segment: Segment, result: RuleLayout) -> None:
    """Record the rule that a complete segment is, with its labels."""
    if not segment.is_rule():
        return
    has_head = segment.arrow_position is not None
    # Only the first `:` can belong to a label, and only if it precedes the arrow: later ones qualify goals by
    # modules.
    first_operator = min(
        position for position in (segment.arrow_position, segment.action_position) if position is not None
    )
    labels = segment.label_positions + [
        position for position in segment.colon_positions[:1] if position < first_operator
    ]
    labels = [position for position in labels if position < first_operator]
    result.rules[segment.start] = True if labels else has_head
    for position in labels:
        result.labels[position] = has_head


def _record_name(segment: Segment, tokens: Sequence[AnyToken], position: int, operators: Operators) -> None:
    """Record the name at token ``position`` in its segment, if it decides about the kind of the segment."""
    name = tokens[position][1]
    if name in _NECKS:
        # In quotes, or before a bracket or comma, it is an atom: `X = (:-)`.
        if tokens[position][0] == NAME and tokens[position + 1][0] not in _CANNOT_START:
            segment.has_neck = True
        return
    canonical = ":" if name == ":" else EVENT_SYNTAX.canonical.get(name)
    if canonical not in ("<-", "do", "rule:", ":") or not _is_infix(segment, tokens, position, operators):
        return
    if canonical == "<-":
        if segment.arrow_position is None:
            segment.arrow_position = position
    elif canonical == "do":
        if segment.action_position is None:
            segment.action_position = position
    elif canonical == ":":
        segment.colon_positions.append(position)
    else:
        segment.label_positions.append(position)


def _is_infix(segment: Segment, tokens: Sequence[AnyToken], position: int, operators: Operators) -> bool:
    # An infix operator needs an operand on both sides. The tests mirror those of the parser, on the tokens alone.
    if position == segment.start:
        return False
    token_kind, value = tokens[position + 1][:2]
    if token_kind in _CANNOT_START:
        return False
    if token_kind == NAME and value in operators.infix and value not in operators.prefix:
        return tokens[position + 2][0] in _CANNOT_START or tokens[position + 2][0] == OPEN_CT
    token_kind, value = tokens[position - 1][:2]
    if token_kind in (",", "|"):
        return False
    if token_kind != NAME or position - 1 == segment.start or value in operators.postfix:
        return True
    return value not in operators.infix
