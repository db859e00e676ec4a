"""Operator-precedence parser: from the tokens of a clause to its term, without recursion.

The parser alternates between two states (ISO 13211-1, 6.3): it expects an operand, or it has one (``left``) and
expects an operator, a separator or the end of the innermost bracket. The stack is described in `parser_stack`.

Names are ambiguous, as a name can be an atom, a functor, and a prefix, infix or postfix operator at the same time.
The parser resolves them with at most three tokens of look-ahead, in the way of SWI-Prolog: ``- (1)`` is a compound
term, ``- = x`` an equation about the atom ``-``, and ``-1`` a number.
"""

from typing import Optional, Tuple

from ..terms.types import FALSE, TRUE, Term, Var, atom, functor
from . import parser_stack
from .message_slots import bind_defaults
from .named_slot_parser import NamedSlotParser
from .operators import DECLARING, EVENT_SYNTAX
from .parser_stack import ARGUMENTS, LABEL, LIST
from .tokenizer import END, NAME, NUMBER, OPEN_CT, QUOTED, TEXT, VARIABLE, AnyToken

_BEFORE_GOALS = ((NAME, ":-"), (NAME, "?-"))
"""Tokens that begin a directive or a query."""
_ENDS = frozenset((")", "]", "}", ",", "|", END, "eof"))
"""Kinds of tokens before which a term must be complete."""


class Parser(NamedSlotParser):
    """Parses one clause; create a new parser for each clause."""

    def read(self) -> Term:
        """Return the term.

        Raises:
            SyntaxFault: with the place of the error.
        """
        self._push_group(None, 0)
        while self.stack:
            if self.wants_operand:
                self._operand()
            else:
                self._operator()
        if self.parsed_messages and self.operators.message_types is not None:
            bind_defaults(
                self.left, self.parsed_messages, self.operators.message_types, self.flags.is_constructed
            )
        return self.left

    def _operand(self) -> None:
        position = self.position
        token_kind, value, start, _ = self.tokens[position]
        if token_kind in (NAME, QUOTED):
            self._name(token_kind, value, start)
            return
        if token_kind == VARIABLE:
            self.position = position + 1
            truth = _SPECIAL_BOOLS.get(value) if self.flags.event_text else None
            self._set_left(self._variable(value) if truth is None else truth, start)
        elif token_kind in (NUMBER, TEXT):
            self.position = position + 1
            self._set_left(value, start)
        elif token_kind == "(" or token_kind == OPEN_CT:
            self.position = position + 1
            self._push_group(position, start)
        elif token_kind == "[" or token_kind == "{":
            self._open_bracket(token_kind, position, start)
        else:
            raise parser_stack.missing_operand_error(self, self.stack[-1])

    def _variable(self, name: str) -> Var:
        if name == "_":
            return Var()
        variable = self.names.get(name)
        if variable is None:
            variable = self.names[name] = Var()
            self.counts[name] = 1
        else:
            self.counts[name] += 1
        return variable

    def _open_bracket(self, token_kind: str, position: int, start: int) -> None:
        closer = parser_stack.CLOSER[token_kind]
        if token_kind == "{" and self._open_nested_message(position, start):
            return
        if self.tokens[position + 1][0] == closer:
            self.position = position + 2
            self._atom(token_kind + closer, start)
        elif token_kind == "{":
            self.position = position + 1
            self._push_group(position, start)
        else:
            self.position = position + 1
            self._push_bracket([self.argument_limit, LIST, position, self.table, [], [], False])
            self._begin_segment(self.position, self.operators.infix)

    def _atom(self, name: str, start: int) -> None:
        """Read a name that is not an operator: an atom, or the functor of a compound term."""
        if self.tokens[self.position][0] == OPEN_CT:
            self._open_arguments(name, start)
        else:
            self._set_left(atom(name), start)

    def _open_arguments(self, name: str, start: int) -> None:
        position = self.position
        self.position = position + 1
        if self.tokens[self.position][0] == ")":
            raise self.source.fault(
                f'a compound term has at least one argument: expected "{name}" alone', start
            )
        modes: Tuple[bool, ...] = ()
        # `seq(a, b)` in a pattern has patterns as arguments. The arity is needed before the arguments are read, to
        # know which arguments these are, so `rule_detection` has counted the commas.
        if self.table is self.patterns:
            arity = self.rules.commas.get(position, 0) + 1
            canonical = functor(EVENT_SYNTAX.canonical_in_patterns.get(name, name), arity)
            modes = EVENT_SYNTAX.pattern_arguments.get(canonical, ())
            if modes:
                name = canonical.name
        self._push_bracket([self.argument_limit, ARGUMENTS, position, self.table, [], [], name, start, modes])
        self._begin_segment(self.position, self.patterns if modes[:1] == (True,) else self.operators.infix)

    def _name(self, token_kind: str, name: str, start: int) -> None:
        self.position += 1
        following = self.tokens[self.position]
        if following[0] == OPEN_CT:
            self._open_arguments(name, start)
            return
        if following[0] == "{" and self._open_named_message(name, start):
            return
        # A minus directly before a number is its sign; `- 1` is the compound term -(1), except in ISO mode.
        if name == "-" and (self.flags.iso or (token_kind == NAME and following[2] == start + 1)):
            number = self._signed_number(following)
            if number is not None:
                self.position += 1
                self._set_left(-number, start)
                return
        prefix = self.operators.prefix.get(name)
        if prefix is not None and self._is_prefix(following):
            self._push_prefix(prefix, start)
            return
        if self.flags.event_text and name in _SPECIAL_FLOATS and token_kind == NAME:
            self._set_left(_SPECIAL_FLOATS[name], start)
            return
        self._set_left(atom(name), start)
        if self.flags.iso and name in self.operators:
            self._check_bare_operator(name, start)

    def _signed_number(self, following: AnyToken) -> Optional[float]:
        """Return the number after a minus sign, or None."""
        if following[0] == NUMBER:
            value: float = following[1]
            return value
        if following[0] == NAME and self.flags.event_text and self.tokens[self.position + 1][0] != OPEN_CT:
            return _SPECIAL_FLOATS.get(following[1])
        return None

    def _check_bare_operator(self, name: str, start: int) -> None:
        """Raise an error if an operator is an operand without brackets, which ISO 13211-1, 6.3.1.3, requires."""
        if self.tokens[self.position][0] not in _ENDS or self.stack[-1][1] < self.GROUP:
            raise self.source.fault(
                f"expected brackets around the operator {name}, as it is an operand", start
            )

    def _is_prefix(self, following: AnyToken) -> bool:
        """Return whether a prefix operator is used as one, and not as an atom, judging by the tokens that follow."""
        token_kind, value = following[:2]
        if token_kind in _ENDS:
            return False
        if token_kind != NAME and token_kind != QUOTED:
            return True
        operators = self.operators
        if value in operators.prefix or not (value in self.table or value in operators.postfix):
            return True
        # An infix operator follows, so one of the two names is an atom. If an operand follows that operator, it is an
        # infix operator, and the prefix operator is its left operand.
        next_token = self.tokens[self.position + 1]
        if next_token[0] in _ENDS or next_token[0] == OPEN_CT:
            return True
        if next_token[0] != NAME or next_token[1] not in self.table or next_token[1] in operators.prefix:
            return False
        # Two infix operators follow: `- = =` is =(-, =), but in `dynamic seq / 2` the prefix operator is applied.
        return self.tokens[self.position + 2][0] not in _ENDS

    def _operator(self) -> None:
        token_kind, value, start, _ = self.tokens[self.position]
        if token_kind in (NAME, QUOTED):
            self._name_operator(value, start)
        elif token_kind == ",":
            self._comma(start)
        elif token_kind == "|":
            self._bar(start)
        elif (
            token_kind == ")"
            or token_kind == "]"
            or token_kind == "}"
            or token_kind == END
            or token_kind == "eof"
        ):
            self._close(token_kind)
        else:
            raise self._missing_operator_error()

    def _name_operator(self, name: str, start: int) -> None:
        infix = self.table.get(name)
        # The `:` of a label binds more loosely than the rule; elsewhere it is the module operator.
        if self.patterns is not None and self.position in self.rules.labels:
            infix = LABEL
        postfix = self.operators.postfix.get(name)
        if infix is None and postfix is None:
            if self._is_declaration():
                self.wants_operand = True
                self._push_prefix(DECLARING, self.left_offset)
                return
            raise parser_stack.missing_operator_error(self, self.brackets[-1])
        self.position += 1
        if infix is not None and (postfix is None or self._starts_operand(self.tokens[self.position])):
            self._push_infix(infix, name, start)
        elif postfix is not None:
            self._apply_postfix(postfix, start)

    def _is_declaration(self) -> bool:
        """Return whether the operand is the ``event`` of a declaration, ``:- event E.``, and not an atom."""
        position = self.position - 1
        if (
            self.tokens[position][:2] != (NAME, "event")
            or self.patterns is not None
            or self.flags.is_constructed
        ):
            return False
        return position == 0 or (position == 1 and self.tokens[0][:2] in _BEFORE_GOALS)

    def _starts_operand(self, token: AnyToken) -> bool:
        token_kind, value = token[:2]
        if token_kind in _ENDS:
            return False
        if token_kind == NAME and (value in self.table or value in self.operators.postfix):
            return value in self.operators.prefix
        return True


_SPECIAL_FLOATS = {"inf": float("inf"), "nan": float("nan")}
"""Floats of event text that Prolog has no syntax for."""
_SPECIAL_BOOLS = {"True": TRUE, "False": FALSE}
"""Booleans as nodes for the original ETALIS-based Retalis write them."""
