"""Tokens to terms: an operator-precedence parser with a stack of its own, without recursion.

The parser is in one of two states: it wants an operand, or it has one (``left``) and wants an operator or
the end of what is open.
"""

from typing import Optional, Tuple

from ..terms.types import FALSE, TRUE, Term, Var, atom, functor
from . import parser_stack
from .message_fields import complete
from .named_field_parser import NamedFieldParser
from .operators import CANONICAL_IN_PATTERNS, DECLARING
from .parser_stack import ARGUMENTS, LABEL, LIST
from .rule_detection import PATTERN_ARGUMENTS
from .tokenizer import END, NAME, NUMBER, OPEN_CT, QUOTED, TEXT, VARIABLE, AnyToken

_BEFORE_GOALS = ((NAME, ":-"), (NAME, "?-"))
_ENDS = frozenset((")", "]", "}", ",", "|", END, "eof"))


class Parser(NamedFieldParser):
    """Reads one clause from its tokens; make a new one for each clause."""

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
        if self.expanded and self.operators.slots is not None:
            complete(self.left, self.expanded, self.operators.slots, self.flags.made)
        return self.left

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
            raise parser_stack.no_operand(self, self.stack[-1])

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
        closer = parser_stack.CLOSER[kind]
        if kind == "{" and self._open_inner(at, start):
            return
        if self.tokens[at + 1][0] == closer:
            self.at = at + 2
            self._atom(kind + closer, start)
        elif kind == "{":
            self.at = at + 1
            self._push_group(at, start)
        else:
            self.at = at + 1
            self._push_bracket([self.argument_limit, LIST, at, self.table, [], [], False])
            self._begin_segment(self.at, self.operators.infix)

    def _atom(self, name: str, start: int) -> None:
        """Take a name that is not an operator here: an atom, or the functor of a compound term."""
        if self.tokens[self.at][0] == OPEN_CT:
            self._open_arguments(name, start)
        else:
            self._have(atom(name), start)

    def _open_arguments(self, name: str, start: int) -> None:
        at = self.at
        self.at = at + 1
        if self.tokens[self.at][0] == ")":
            raise self.source.fault(
                f'a compound term has at least one argument: expected "{name}" alone', start
            )
        modes: Tuple[bool, ...] = ()
        if self.table is self.patterns:
            arity = self.rules.commas.get(at, 0) + 1
            canonical = functor(CANONICAL_IN_PATTERNS.get(name, name), arity)
            modes = PATTERN_ARGUMENTS.get(canonical, ())
            if modes:
                name = canonical.name
        self._push_bracket([self.argument_limit, ARGUMENTS, at, self.table, [], [], name, start, modes])
        self._begin_segment(self.at, self.patterns if modes[:1] == (True,) else self.operators.infix)

    def _name(self, kind: str, name: str, start: int) -> None:
        self.at += 1
        following = self.tokens[self.at]
        if following[0] == OPEN_CT:
            self._open_arguments(name, start)
            return
        if following[0] == "{" and self._open_slots(name, start):
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

    def _signed(self, following: AnyToken) -> Optional[float]:
        """Return the number after a minus, or None (ISO Prolog allows layout between the two)."""
        if following[0] == NUMBER:
            value: float = following[1]
            return value
        if following[0] == NAME and self.flags.event_text and self.tokens[self.at + 1][0] != OPEN_CT:
            return _SPECIAL_FLOATS.get(following[1])
        return None

    def _bare_operator(self, name: str, start: int) -> None:
        """Check ISO's demand that an operator that is an operand stands alone or in brackets."""
        if self.tokens[self.at][0] not in _ENDS or self.stack[-1][1] < self.GROUP:
            raise self.source.fault(
                f"expected brackets around the operator {name}, as it is an operand", start
            )

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
        # An infix operator follows: with an operand after it, it is that; else it is an atom itself.
        after = self.tokens[self.at + 1]
        if after[0] in _ENDS or after[0] == OPEN_CT:
            return True
        if after[0] != NAME or after[1] not in self.table or after[1] in operators.prefix:
            return False
        return self.tokens[self.at + 2][0] not in _ENDS  # "- = =" is =(-, =), "dynamic seq / 2" is none

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
            raise self._no_operator()

    def _name_operator(self, name: str, start: int) -> None:
        infix = self.table.get(name)
        if self.patterns is not None and self.at in self.rules.labels:
            infix = LABEL
        postfix = self.operators.postfix.get(name)
        if infix is None and postfix is None:
            if self._declares():
                self.wants_operand = True
                self._push_prefix(DECLARING, self.left_at)
                return
            raise parser_stack.no_operator(self, self.brackets[-1])
        self.at += 1
        if infix is not None and (postfix is None or self._starts_operand(self.tokens[self.at])):
            self._push_infix(infix, name, start)
        elif postfix is not None:
            self._take_postfix(postfix, start)

    def _declares(self) -> bool:
        """Tell whether what was read is the ``event`` of a declaration, ``:- event E.``, and not an atom."""
        at = self.at - 1
        if self.tokens[at][:2] != (NAME, "event") or self.patterns is not None or self.flags.made:
            return False
        return at == 0 or (at == 1 and self.tokens[0][:2] in _BEFORE_GOALS)

    def _starts_operand(self, token: AnyToken) -> bool:
        kind, value = token[:2]
        if kind in _ENDS:
            return False
        if kind == NAME and (value in self.table or value in self.operators.postfix):
            return value in self.operators.prefix
        return True


_SPECIAL_FLOATS = {"inf": float("inf"), "nan": float("nan")}
_TRUTHS = {"True": TRUE, "False": FALSE}
"""How other people's nodes, written for the original, write a bool."""
