"""Tokens to terms: an operator-precedence parser with a stack of its own.

The parser is in one of two states: it wants an operand, or it has one (``left``) and wants an operator or
the end of what is open. What is open lies on the stack, innermost last: operators that wait for their
right argument, and brackets. There is no recursion, so no depth of nesting can exhaust Python's stack.

Every stack entry begins with the highest priority that may stand there. An operator of a higher priority
closes the operators before it, as far as their arguments allow; at a bracket that is a priority clash.
"""

from typing import Any, Dict, List, Optional, Sequence, Tuple

from ..terms import COMMA, CONS, FALSE, NIL, TRUE, Term, Var, atom, functor
from . import faults
from .operators import CANONICAL_IN_PATTERNS, Operator, Operators
from .rules import ARROW, GOAL_RIGHT, NO_RULES, PATTERN_ARGUMENTS, Layout
from .tokens import END, NAME, NUMBER, OPEN_CT, QUOTED, TEXT, VARIABLE, AnyToken, ReadFlags, Source

_INFIX, _PREFIX, _GROUP, _ARGUMENTS, _LIST = range(5)  # the operators come first

Table = Dict[str, Operator]

_ENDS = frozenset((")", "]", "}", ",", "|", END, "eof"))
_CURLY = functor("{}", 1)
_RULE = functor("rule:", 2)
_LABEL = Operator(1200, 1199, 1200, _RULE, "xfy")
_NECKS = frozenset((functor(":-", 2), functor("-->", 2)))
_COMMA = Operator(1000, 999, 1000, COMMA, "xfy")


class Parser:
    """Reads one clause from its tokens; make a new one for each clause.

    ``INFIX``, ``PREFIX`` and ``GROUP`` are kinds of entries on its stack, for those who look at it.

    Attributes:
        names: name -> variable, in order of appearance, without ``_``.
        counts: name -> how often it stands in the clause.
        spots: ``id`` of a compound term -> offsets of its functor and of its arguments.
    """

    INFIX, PREFIX, GROUP = _INFIX, _PREFIX, _GROUP

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
        self.at = 0
        self.stack: List[Any] = []
        self.brackets: List[List[Any]] = []
        self.table: Table = operators.infix
        self.patterns: Optional[Table] = operators.patterns() if rules is not NO_RULES else None
        self.left: Term = None
        self.left_priority = 0
        self.left_at = 0
        self.wants_operand = True
        self.argument_limit = 999 if flags.iso else 1200

    def read(self) -> Term:
        """Return the term.

        Raises:
            SyntaxFault: with the place.
        """
        self._push_group(None, 0)
        while self.stack:
            if self.wants_operand:
                self._operand()
            else:
                self._operator()
        return self.left

    # -- operands ------------------------------------------------------------------------------------

    def _operand(self) -> None:
        at = self.at
        kind, value, start, _ = self.tokens[at]
        if kind in (NAME, QUOTED):
            self._name(kind, value, start)
            return
        if kind == VARIABLE:
            self.at = at + 1
            truth = _TRUTHS.get(value) if self.flags.event_text else None
            self._have(self._variable(value) if truth is None else truth, start)
        elif kind in (NUMBER, TEXT):
            self.at = at + 1
            self._have(value, start)
        elif kind == "(" or kind == OPEN_CT:
            self.at = at + 1
            self._push_group(at, start)
        elif kind == "[" or kind == "{":
            self._open_bracket(kind, at, start)
        else:
            raise faults.no_operand(self, self.stack[-1])

    def _have(self, term: Term, start: int) -> None:
        self.left = term
        self.left_priority = 0
        self.left_at = start
        self.wants_operand = False

    def _variable(self, name: str) -> Var:
        if name == "_":
            return Var()
        found = self.names.get(name)
        if found is None:
            found = self.names[name] = Var()
            self.counts[name] = 1
        else:
            self.counts[name] += 1
        return found

    def _open_bracket(self, kind: str, at: int, start: int) -> None:
        closer = faults.CLOSER[kind]
        if self.tokens[at + 1][0] == closer:
            self.at = at + 2
            self._atom(kind + closer, start)
        elif kind == "{":
            self.at = at + 1
            self._push_group(at, start)
        else:
            self.at = at + 1
            self._push_bracket([self.argument_limit, _LIST, at, self.table, [], [], False])
            self._begin_segment(self.at, self.operators.infix)

    def _atom(self, name: str, start: int) -> None:
        """Take a name that is no operator here: an atom, or the functor of a compound term."""
        if self.tokens[self.at][0] == OPEN_CT:
            self._open_arguments(name, start)
        else:
            self._have(atom(name), start)

    def _open_arguments(self, name: str, start: int) -> None:
        at = self.at
        self.at = at + 1
        if self.tokens[self.at][0] == ")":
            raise self.source.fault(f'a term has at least one argument: expected "{name}" alone', start)
        modes: Tuple[bool, ...] = ()
        if self.table is self.patterns:
            arity = self.rules.commas.get(at, 0) + 1
            canonical = functor(CANONICAL_IN_PATTERNS.get(name, name), arity)
            modes = PATTERN_ARGUMENTS.get(canonical, ())
            if modes:
                name = canonical.name
        self._push_bracket([self.argument_limit, _ARGUMENTS, at, self.table, [], [], name, start, modes])
        self._begin_segment(self.at, self.patterns if modes[:1] == (True,) else self.operators.infix)

    def _name(self, kind: str, name: str, start: int) -> None:
        self.at += 1
        following = self.tokens[self.at]
        if following[0] == OPEN_CT:
            self._open_arguments(name, start)
            return
        if name == "-" and (self.flags.iso or (kind == NAME and following[2] == start + 1)):
            number = self._signed(following)
            if number is not None:
                self.at += 1
                self._have(-number, start)
                return
        prefix = self.operators.prefix.get(name)
        if prefix is not None and self._is_prefix(following):
            self._push_prefix(prefix, start)
            return
        if self.flags.event_text and name in _SPECIAL_FLOATS and kind == NAME:
            self._have(_SPECIAL_FLOATS[name], start)
            return
        self._have(atom(name), start)
        if self.flags.iso and name in self.operators:
            self._bare_operator(name, start)

    def _signed(self, following: AnyToken) -> Term:
        """Return the number behind a minus, or None (ISO Prolog allows layout between the two)."""
        if following[0] == NUMBER:
            return following[1]
        if following[0] == NAME and self.flags.event_text and self.tokens[self.at + 1][0] != OPEN_CT:
            return _SPECIAL_FLOATS.get(following[1])
        return None

    def _bare_operator(self, name: str, start: int) -> None:
        """Check ISO's demand that an operator that is an operand stands alone or in brackets."""
        if self.tokens[self.at][0] not in _ENDS or self.stack[-1][1] < _GROUP:
            raise self.source.fault(f"expected the operator {name} in brackets, as it is an operand", start)

    def _is_prefix(self, following: AnyToken) -> bool:
        """Tell whether a prefix operator is one here, and not an atom, by what follows."""
        kind, value = following[:2]
        if kind in _ENDS:
            return False
        if kind != NAME and kind != QUOTED:
            return True
        operators = self.operators
        if value in operators.prefix or not (value in self.table or value in operators.postfix):
            return True
        # An infix operator follows: with an operand behind it, it is that; else it is an atom itself.
        after = self.tokens[self.at + 1]
        if after[0] in _ENDS or after[0] == OPEN_CT:
            return True
        if after[0] != NAME or after[1] not in self.table or after[1] in operators.prefix:
            return False
        return self.tokens[self.at + 2][0] not in _ENDS  # "- = =" is =(-, =), "dynamic seq / 2" is none

    def _push_prefix(self, found: Operator, start: int) -> None:
        if found.priority > self.stack[-1][0]:
            top = self.stack[-1]
            raise faults.clash(self, found, start, top[2] if top[1] <= _PREFIX else None)
        self.stack.append((found.right, _PREFIX, found, start, self.table))

    def _push_group(self, at: Optional[int], start: int) -> None:
        """Open a round or curly bracket, or the clause itself (``at`` is None)."""
        self._push_bracket([1200, _GROUP, at, self.table, start])
        inner = self.table if at is None or self.tokens[at][0] != "{" else self.operators.infix
        self._begin_segment(self.at, inner)

    def _push_bracket(self, entry: List[Any]) -> None:
        self.stack.append(entry)
        self.brackets.append(entry)

    def _begin_segment(self, at: int, table: Optional[Table]) -> None:
        """Set the operators for what begins at the token ``at``."""
        headed = self.rules.rules.get(at) if self.patterns is not None else None
        if headed is not None:
            table = self.operators.infix if headed else self.patterns
        self.table = table if table is not None else self.operators.infix
        self.wants_operand = True

    def text_at(self, start: int) -> str:
        """Return the text of the token that begins at an offset."""
        for token in self.tokens:
            if token[2] == start:
                return self.source.text[start : token[3]]
        return ""

    # -- operators -----------------------------------------------------------------------------------

    def _operator(self) -> None:
        kind, value, start, _ = self.tokens[self.at]
        if kind in (NAME, QUOTED):
            self._name_operator(value, start)
        elif kind == ",":
            self._comma(start)
        elif kind == "|":
            self._bar(start)
        elif kind == ")" or kind == "]" or kind == "}" or kind == END or kind == "eof":
            self._close(kind)
        else:
            raise faults.no_operator(self, self.brackets[-1])

    def _name_operator(self, name: str, start: int) -> None:
        infix = self.table.get(name)
        if self.patterns is not None and self.at in self.rules.labels:
            infix = _LABEL
        postfix = self.operators.postfix.get(name)
        if infix is None and postfix is None:
            raise faults.no_operator(self, self.brackets[-1])
        self.at += 1
        if postfix is not None and (infix is None or not self._starts_operand(self.tokens[self.at])):
            self._take_postfix(postfix, start)
        else:
            assert infix is not None
            self._push_infix(infix, name, start)

    def _starts_operand(self, token: AnyToken) -> bool:
        kind, value = token[:2]
        if kind in _ENDS:
            return False
        if kind == NAME and (value in self.table or value in self.operators.postfix):
            return value in self.operators.prefix
        return True

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
            if top[1] > _PREFIX:
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
        label = self.rules.labels.get(self.at - 1) if found is _LABEL else None
        if found[0] > self.stack[-1][0] or found[0] == self.stack[-1][0] or self.left_priority:
            found = self._make_room(found, name, start)
        if self.table is self.patterns and found.functor in _NECKS:
            raise faults.clash(self, found, start, self.operators.infix.get("<-", found))
        self.stack.append((found.right, _INFIX, found, self.left, self.left_at, start, self.table))
        self.wants_operand = True
        if self.patterns is not None:
            self._switch(found, label)

    def _switch(self, found: Operator, label: Optional[bool]) -> None:
        """Set the operators for the right argument of ``found``, in a clause with event rules."""
        if found is _LABEL:
            self.table = self.patterns if label is False and self.patterns else self.operators.infix
        elif found.functor is ARROW:
            self.table = self.patterns or self.table
        elif self.table is self.patterns and found.functor in GOAL_RIGHT:
            self.table = self.operators.infix

    def _reduce(self) -> None:
        """Build the term of the innermost waiting operator."""
        top = self.stack.pop()
        found = top[2]
        if top[1] == _INFIX:
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

    # -- brackets ------------------------------------------------------------------------------------

    def _innermost(self) -> List[Any]:
        """Close all waiting operators of the innermost bracket and return its entry."""
        stack = self.stack
        while stack[-1][1] <= _PREFIX:
            self._reduce()
        return self.brackets[-1]

    def _comma(self, start: int) -> None:
        kind = self.brackets[-1][1]
        self.at += 1
        if kind == _GROUP:
            self._push_infix(_COMMA, ",", start)
            return
        bracket = self._innermost()
        if kind == _LIST:
            if bracket[6]:
                raise self.source.fault('expected "]": a list has one term behind "|"', start)
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
        if self.brackets[-1][1] == _LIST:
            bracket = self._innermost()
            if bracket[6]:
                raise self.source.fault('expected "]": a list has one term behind "|"', start)
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
        if bracket[1] == _GROUP:
            if kind == "}":
                self._build((_CURLY, self.left), bracket[4], (self.left_at,))
            self.left_at = bracket[4]
        else:
            self._add(bracket)
            if bracket[1] == _LIST:
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


_SPECIAL_FLOATS = {"inf": float("inf"), "nan": float("nan")}
_TRUTHS = {"True": TRUE, "False": FALSE}
"""How other people's nodes, written for the original, write a bool."""
