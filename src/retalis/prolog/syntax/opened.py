"""What is open while a term is read: operators that wait for an argument, and brackets.

It lies on a stack, innermost last. There is no recursion, so no depth of nesting can exhaust Python's stack.

Every stack entry begins with the highest priority that may stand there. An operator of a higher priority
closes the operators before it, as far as their arguments allow; at a bracket that is a priority clash.
"""

from typing import Any, List, Optional, Tuple

from ..terms import COMMA, CONS, NIL, Term, functor
from . import faults
from .operators import Operator
from .rules import ARROW, GOAL_RIGHT
from .state import GROUP, INFIX, LIST, PREFIX, OperatorTable, ReadingState
from .tokens import END

_CURLY = functor("{}", 1)
_RULE = functor("rule:", 2)
LABEL = Operator(1200, 1199, 1200, _RULE, "xfy")
_NECKS = frozenset((functor(":-", 2), functor("-->", 2)))
_COMMA = Operator(1000, 999, 1000, COMMA, "xfy")


class Open(ReadingState):
    """What is open while a clause is read, opened and closed."""

    def _have(self, term: Term, start: int) -> None:
        self.left = term
        self.left_priority = 0
        self.left_at = start
        self.wants_operand = False

    def _push_prefix(self, found: Operator, start: int) -> None:
        if found.priority > self.stack[-1][0]:
            top = self.stack[-1]
            raise faults.clash(self, found, start, top[2] if top[1] <= PREFIX else None)
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
                    raise faults.clash(self, found, start, None)
                break
            if limit == priority and not (found[1] == priority and top[2][0] == priority):
                break
            table = self.table
            self._reduce()
            if table is not self.table:
                found = self.table.get(name, found)
        if self.left_priority > found[1]:
            raise faults.clash(self, found, start, None)
        return found

    def _take_postfix(self, found: Operator, start: int) -> None:
        self._make_room(found, "", start)
        self._build((found.functor, self.left), start, (self.left_at,))
        self.left_priority = found.priority

    def _push_infix(self, found: Operator, name: str, start: int) -> None:
        label = self.rules.labels.get(self.at - 1) if found is LABEL else None
        if found[0] > self.stack[-1][0] or found[0] == self.stack[-1][0] or self.left_priority:
            found = self._make_room(found, name, start)
        if self.table is self.patterns and found.functor in _NECKS:
            raise faults.clash(self, found, start, self.operators.infix.get("<-", found))
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
            raise faults.no_operator(self, self.brackets[-1])
        self.at += 1
        self._push_infix(infix, "|", start)

    def _close(self, kind: str) -> None:
        bracket = self._innermost()
        opened = bracket[2]
        expected = END if opened is None else faults.CLOSER[self.tokens[opened][0]]
        if kind != expected and not (opened is None and kind == "eof"):
            raise faults.unbalanced(self, opened)
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
