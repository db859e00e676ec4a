r"""Which parts of a clause are event rules, decided by its tokens before anything is built.

In the pattern of an event rule ``*``, ``#``, ``/\``, ``\/`` are ``seq``, ``par``, ``and``, ``or`` with
the priorities of those; everywhere else they are Prolog's. So the reader has to know where patterns are
before it meets them. A *segment* is a whole clause, what stands in a pair of brackets, or one argument. By
the tokens at its own level (not those in inner brackets) a segment is

* a rule where it has an infix ``<-`` or ``iff``: what is left of that is the head (with ``do``), what is
  right of it is a pattern;
* a rule without a head where it has an infix ``do`` and no arrow: what is left of that is a pattern;
* plain Prolog otherwise, and always where it has ``:-`` or ``-->``.

A ``:`` or ``'rule:'`` before the rest of a rule is that of its label; any other ``:`` is Prolog's.
"""

from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

from ..terms.types import Functor, functor
from .event_operators import EVENT_OPERATORS, OperatorKind
from .operators import CANONICAL, Operators
from .tokenizer import END, NAME, OPEN_CT, QUOTED, AnyToken

_NECKS = frozenset((":-", "-->", "?-", "=>"))
_OPEN = frozenset(("(", OPEN_CT, "[", "{"))
_CLOSE = frozenset((")", "]", "}"))
_CANNOT_START = frozenset((")", "]", "}", ",", "|", END, "eof"))
MARKERS = frozenset(name for name, same in CANONICAL.items() if same in ("<-", "do", "rule:"))
"""Names that make a clause worth looking at."""

ARROW = functor("<-", 2)

GOAL_RIGHT = frozenset(
    functor(one.name, 2)
    for one in EVENT_OPERATORS
    if one.kind in (OperatorKind.ACTION, OperatorKind.CONDITION, OperatorKind.LIMIT)
)
"""Operators of patterns whose right argument is a goal or a number: there, Prolog's operators hold."""

PATTERN_ARGUMENTS: Dict[Functor, Tuple[bool, ...]] = {
    functor(one.name, len(one.patterns)): one.patterns
    for one in EVENT_OPERATORS
    if one.kind is not OperatorKind.RULE or one.name == "<-"
}
"""Which arguments are patterns, where these are written as functor and arguments in a pattern."""


class Segment:
    """What was found at the own level of a segment."""

    __slots__ = ("start", "arrow", "action", "neck", "colons", "labels", "brace")

    def __init__(self, start: int, brace: str):
        self.start = start
        self.arrow: Optional[int] = None
        self.action: Optional[int] = None
        self.neck = False
        self.colons: List[int] = []
        self.labels: List[int] = []
        self.brace = brace

    def is_rule(self) -> bool:
        """Tell whether this is an event rule."""
        return not self.neck and (self.arrow is not None or self.action is not None)


class Layout(NamedTuple):
    """What the parser has to know of a clause with event rules; all keys are indexes of tokens.

    Attributes:
        rules: first token of each segment that is a rule -> does a head come first (else a pattern).
        labels: ``:`` or ``'rule:'`` of a label -> does a head come after it (else a pattern).
        commas: opening bracket -> how many commas are directly in it.
    """

    rules: Dict[int, bool]
    labels: Dict[int, bool]
    commas: Dict[int, int]


NO_RULES = Layout({}, {}, {})


def layout(tokens: Sequence[AnyToken], operators: Operators) -> Layout:
    """Return where the event rules of a clause are."""
    found = Layout({}, {}, {})
    stack = [Segment(0, "")]
    opened: List[int] = []
    for at, token in enumerate(tokens):
        kind = token[0]
        if kind in (NAME, QUOTED):
            _note(stack[-1], tokens, at, operators)
        elif kind in _OPEN:
            opened.append(at)
            found.commas[at] = 0
            stack.append(Segment(at + 1, kind))
        elif kind in _CLOSE:
            if opened:
                opened.pop()
                _finish(stack.pop(), found)
        elif kind == "," and opened:
            found.commas[opened[-1]] += 1
            if stack[-1].brace in (OPEN_CT, "["):
                _finish(stack.pop(), found)
                stack.append(Segment(at + 1, tokens[opened[-1]][0]))
        elif kind == "|" and stack[-1].brace == "[":
            _finish(stack.pop(), found)
            stack.append(Segment(at + 1, "["))
    while stack:
        _finish(stack.pop(), found)
    return found


def _finish(segment: Segment, found: Layout) -> None:
    if not segment.is_rule():
        return
    headed = segment.arrow is not None
    first = min(at for at in (segment.arrow, segment.action) if at is not None)
    labels = segment.labels + [at for at in segment.colons[:1] if at < first]
    labels = [at for at in labels if at < first]
    found.rules[segment.start] = True if labels else headed
    for at in labels:
        found.labels[at] = headed


def _note(segment: Segment, tokens: Sequence[AnyToken], at: int, operators: Operators) -> None:
    """Note what the name at ``at`` means for its segment."""
    name = tokens[at][1]
    if name in _NECKS:
        if tokens[at][0] == NAME and tokens[at + 1][0] not in _CANNOT_START:
            segment.neck = True
        return
    same = ":" if name == ":" else CANONICAL.get(name)
    if same not in ("<-", "do", "rule:", ":") or not _is_infix(segment, tokens, at, operators):
        return
    if same == "<-":
        if segment.arrow is None:
            segment.arrow = at
    elif same == "do":
        if segment.action is None:
            segment.action = at
    elif same == ":":
        segment.colons.append(at)
    else:
        segment.labels.append(at)


def _is_infix(segment: Segment, tokens: Sequence[AnyToken], at: int, operators: Operators) -> bool:
    if at == segment.start:
        return False
    kind, value = tokens[at + 1][:2]
    if kind in _CANNOT_START:
        return False
    if kind == NAME and value in operators.infix and value not in operators.prefix:
        return tokens[at + 2][0] in _CANNOT_START or tokens[at + 2][0] == OPEN_CT
    kind, value = tokens[at - 1][:2]
    if kind in (",", "|"):
        return False
    if kind != NAME or at - 1 == segment.start or value in operators.postfix:
        return True
    return value not in operators.infix
