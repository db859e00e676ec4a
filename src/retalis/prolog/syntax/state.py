"""Where the reading of a clause stands: its tokens, what has been read, and what is open."""

from typing import Any, Dict, List, Optional, Sequence, Tuple

from ..terms import NIL, Term, Var
from .operators import Operator, Operators
from .rules import NO_RULES, Layout
from .slots import Expanded
from .tokens import AnyToken, ReadFlags, Source

INFIX, PREFIX, GROUP, ARGUMENTS, LIST, SLOTS = range(6)  # the operators come first

OperatorTable = Dict[str, Operator]


class ReadingState:
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
