"""Parser of messages with named slots: ``sensor_msgs__0__BatteryState{percentage: P, header: {stamp: S}}``.

A message with named slots is an entry of kind ``SLOTS`` on the parser's stack. When its bracket closes, the term is
built with all arguments in the order of the message type: a variable for each slot that is not named, and floats in
place of integers in float slots. `MessageTypes` provides the slots of a message type.

One word between the brackets is the name of a constant of the message type: ``sensor_msgs__0__BatteryState{NAME}``
stands for its value. In the value of a slot the type can be omitted, as that of a nested message. A constant is not
written without brackets, because a word that begins with a capital letter is a variable.

`misnamed_message_error` creates the error for a name before the bracket that is not a message type: a ROS notation
(``Temperature``, ``sensor_msgs/Temperature``), a misspelt name, or a space before the bracket.
"""

from typing import Any, Dict, List, Optional, Sequence, Tuple

from ...foundation.errors import RetalisError, SyntaxFault, UnknownMessage
from ...foundation.similar_names import did_you_mean
from ..terms.types import Term, Var, atom, functor
from . import parser_stack
from .literals import atom_text
from .named_slots import MessageSlot, MessageTypes, ParsedMessage, integers_to_floats
from .parser_stack import LIST, SLOTS, OpenBracket, OperatorTable, ParserStack, ParserState
from .tokenizer import NAME, QUOTED, VARIABLE, token_description

_MAX_SUGGESTED_TYPES = 3
"""Maximum number of message types that an error suggests."""


def misnamed_message_error(parser: ParserState, message_types: MessageTypes) -> Optional[SyntaxFault]:
    """Return the error for a curly bracket after a name that is not a message type.

    Returns:
        The error, or None if the name is probably not meant as a message type.
    """
    previous_token, bracket = parser.tokens[parser.position - 1], parser.tokens[parser.position]
    has_space_before = previous_token[3] != bracket[2]
    if previous_token[0] != VARIABLE and _is_message(previous_token[1], message_types):
        message = f'no space is allowed between {atom_text(previous_token[1])} and its "{{"'
        return parser.source.fault(message, bracket[2]) if has_space_before else None
    name, start = _full_name(parser)
    suggestions = message_types.suggest(name)
    names = suggestions.names[:_MAX_SUGGESTED_TYPES]
    if suggestions.is_other_notation:
        hint = f"; write {' or '.join(f'{atom_text(suggestion)}{{...}}' for suggestion in names)}"
    elif names:
        hint = f"; did you mean {' or '.join(map(atom_text, names))}?"
    # Without a similar name, the general error is better, because nothing indicates a message.
    elif has_space_before or previous_token[0] == VARIABLE or name != previous_token[1]:
        return None
    else:
        hint = ""
    fault = parser.source.fault(f"no message type or event of a topic is called {name}{hint}", start)
    return UnknownMessage(fault.message, fault.place)


def _is_message(name: str, message_types: MessageTypes) -> bool:
    try:
        return message_types.find(name) is not None
    except RetalisError:  # The message type exists, but its definition cannot be read.
        return True


def _full_name(parser: ParserState) -> Tuple[str, int]:
    """Return the name before the current token, with the package if one precedes it, and the offset of the name."""
    last = parser.tokens[parser.position - 1]
    if parser.position > 2:
        package, slash = parser.tokens[parser.position - 3 : parser.position - 1]
        if slash[:2] == (NAME, "/") and package[0] == NAME and (package[3], slash[3]) == (slash[2], last[2]):
            return f"{package[1]}/{last[1]}", package[2]
    return last[1], last[2]


_TYPE_INFIX = "__0__"
"""Infix of all names of message types as terms."""


class OpenMessage(OpenBracket):
    """Open curly bracket of a message with named slots.

    Attributes:
        slots: slots of the message type.
        values: by slot number, the value and its offset.
        constants: by slot number, the text of a constant and its value.
        slot_number: number of the slot that is being read, from 1.
    """

    __slots__ = ("slots", "values", "constants", "slot_number")

    def __init__(
        self,
        limit: int,
        position: int,
        table: OperatorTable,
        start: int,
        name: str,
        slots: Sequence[MessageSlot],
    ):
        super().__init__(limit, SLOTS, position, table, start, name)
        self.slots = slots
        self.values: Dict[int, Tuple[Term, int]] = {}
        self.constants: Dict[int, Tuple[str, Term]] = {}
        self.slot_number = 0

    @property
    def current_slot(self) -> MessageSlot:
        """The slot that is being read."""
        return self.slots[self.slot_number - 1]


class NamedSlotParser(ParserStack):
    """Parser state for messages with named slots: opens and closes their brackets."""

    def _open_named_message(self, name: str, start: int) -> bool:
        """Open the message whose name was just read; return whether the name is a message type."""
        position = self.position
        if self.tokens[position][2] != self.tokens[position - 1][3] or self.flags.event_text:
            return False
        # An operator before a curly bracket is not the name of a message, as in `X = {a}`.
        if name in self.operators.prefix or name in self.table:
            return False
        message_types = self.operators.message_types
        if message_types is None:
            if _TYPE_INFIX in name:
                raise self.source.fault(
                    f"slots by name are not available here: write all slots of {name}", start
                )
            return False
        if self._read_constant(name, start):
            return True
        try:
            slots = message_types.find(name)
        except RetalisError as error:
            raise self.source.fault(error.message, start) from error
        if slots is None:
            return False  # If the clause is invalid, `_missing_operator_error` reports the name.
        self._open_message(name, start, slots)
        return True

    def _read_constant(self, name: str, start: int) -> bool:
        """Read a constant at its opening bracket.

        Args:
            name: name of the message.
            start: offset of the term.

        Returns:
            Whether the brackets contain the name of a constant, and the name before is a message type.

        Raises:
            SyntaxFault: if the type has no such constant.
        """
        position = self.position
        token_kind, constant, offset = self.tokens[position + 1][:3]
        if token_kind not in (NAME, VARIABLE) or self.tokens[position + 2][0] != "}":
            return False
        message_types = self.operators.message_types
        assert message_types is not None
        try:
            value = message_types.find_constant(name, constant, self.source.place(offset))
        except RetalisError as error:
            raise SyntaxFault(error.message, error.place or self.source.place(start)) from error
        if value is None:
            return False
        self.position = position + 3
        self._set_left(value, start)
        bracket = self.brackets[-1] if self.brackets else None
        if isinstance(bracket, OpenMessage) and self.stack[-1] is bracket:
            text = f"{{{constant}}}" if name == bracket.name else f"{atom_text(name)}{{{constant}}}"
            bracket.constants[bracket.slot_number] = (text, value)
        return True

    def _missing_operator_error(self) -> SyntaxFault:
        """Return the error for a token after a complete term; the token may be the bracket of a misspelt message."""
        message_types = self.operators.message_types
        previous_token, token = self.tokens[self.position - 1], self.tokens[self.position]
        may_be_message = token[0] == "{" and previous_token[0] in (NAME, QUOTED, VARIABLE)
        error = None
        if may_be_message and message_types is not None and not self.flags.event_text:
            error = misnamed_message_error(self, message_types)
        return error or parser_stack.missing_operator_error(self)

    def _open_nested_message(self, start: int) -> bool:
        """Open a nested message without a name, whose type is that of the slot.

        Returns:
            Whether the bracket opened a message.
        """
        enclosing_bracket = self.brackets[-1]
        # If an operator is on the stack, the bracket is its operand and not the value of the slot.
        if self.stack[-1] is not enclosing_bracket:
            return False
        if isinstance(enclosing_bracket, OpenMessage):
            slot = enclosing_bracket.current_slot
            if not slot.message_functor and self._read_constant(enclosing_bracket.name, start):
                return True
            if slot.is_array:
                raise self.source.fault(f"{slot.name} is {slot.type}: expected a list of its elements", start)
        else:
            # The bracket may also open an element of a list of messages.
            outer_bracket = self.brackets[-2] if len(self.brackets) > 1 else None
            if enclosing_bracket.kind != LIST or not isinstance(outer_bracket, OpenMessage):
                return False
            slot = outer_bracket.current_slot
            if not slot.is_array or enclosing_bracket.has_bar:
                return False
            if not slot.message_functor and self._read_constant(outer_bracket.name, start):
                return True
        if not slot.message_functor:
            raise self.source.fault(f"{slot.name} is {slot.type}, which has no slots", start)
        slots = self.operators.message_types and self.operators.message_types.find(slot.message_functor)
        self._open_message(slot.message_functor, start, slots or ())
        return True

    def _open_message(self, name: str, start: int, slots: Sequence[MessageSlot]) -> None:
        bracket_position = self.position
        self.position = bracket_position + 1
        message = OpenMessage(self.argument_limit, bracket_position, self.table, start, name, slots)
        self._push_bracket(message)
        if self.tokens[self.position][0] == "}":
            self._close_message(message)
        else:
            self._begin_slot(message)

    def _begin_slot(self, message: OpenMessage) -> None:
        """Read the name of a slot and its colon."""
        token, following = self.tokens[self.position], self.tokens[self.position + 1]
        if token[0] not in (NAME, QUOTED) or following[0] != NAME or following[1] != ":":
            raise self._slot_name_error()
        # Slots may be named in any order, each at most once.
        name, slots = token[1], message.slots
        names = [slot.name for slot in slots]
        if name not in names:
            raise self.source.fault(_unknown_slot_message(message.name, name, slots), token[2])
        number = message.slot_number = names.index(name) + 1
        if number in message.values:
            raise self.source.fault(f"slot {name} has a value already", token[2])
        self.position += 2
        self._begin_segment(self.position, self.operators.infix)

    def _slot_name_error(self) -> RetalisError:
        token, following = self.tokens[self.position : self.position + 2]
        shown_token = token_description(token, self.source.text)
        if token[0] in (NAME, QUOTED) and following[0] == NAME:
            if following[1].startswith(":"):
                return self.source.fault("expected a space between : and the sign that follows", following[2])
            if following[1] == ".":
                message = f"slots of a message in a slot are written in brackets: {token[1]}: {{slot: Value}}"
                return self.source.fault(message, following[2])
        if token[0] in (NAME, QUOTED):
            message = f"expected a colon and a value after {shown_token}"
            return self.source.fault(message, following[2])
        return self.source.fault(f"expected the name of a slot before {shown_token}", token[2])

    def _comma(self, start: int) -> None:
        bracket = self.brackets[-1]
        if not isinstance(bracket, OpenMessage):
            super()._comma(start)
            return
        self._store_value(bracket)
        self.position += 1
        self._begin_slot(bracket)

    def _store_value(self, message: OpenMessage) -> None:
        """Store the value of the slot that was just read."""
        self._close_operators()
        message.values[message.slot_number] = (self.left, self.left_offset)

    def _close(self, token_kind: str) -> None:
        bracket = self.brackets[-1]
        if not isinstance(bracket, OpenMessage):
            super()._close(token_kind)
            return
        self._store_value(bracket)
        if token_kind != "}":
            raise parser_stack.unbalanced_bracket_error(self, bracket.position)
        self._close_message(bracket)

    def _close_message(self, message: OpenMessage) -> None:
        """Build the term of the innermost message."""
        self.brackets.pop()
        self.stack.pop()
        self.position += 1
        self.table = message.table
        name, start, slots, values = message.name, message.start, message.slots, message.values
        default_values: Dict[Var, Term] = {}
        arguments: List[Any] = []
        offsets = []
        integer_slots = []
        constants = []
        for number, slot in enumerate(slots, 1):
            value, offset = values.get(number, (None, start))
            if value is None:
                # `named_slots.bind_defaults` binds the variable if the message is in a constructed part of the
                # clause, which is known when the whole clause has been read.
                value = Var()
                default_values[value] = slot.default
            elif slot.is_float:
                original_value, value = value, integers_to_floats(value, slot.is_array)
                # Recorded, so that listings show `{x: 0}` as it was written, not as `{x: 0.0}`.
                if value is not original_value:
                    integer_slots.append(number)
                    self._move_positions(original_value, value)
            constant = message.constants.get(number)
            # An operator or a list around the constant makes it a part of the value.
            if constant is not None and values[number][0] is constant[1]:
                constants.append((number, constant[0], value))
            arguments.append(value)
            offsets.append(offset)
        if arguments:
            term = (functor(name, len(slots)), *arguments)
            self._build(term, start, tuple(offsets))
            self.parsed_messages.append(
                ParsedMessage(term, tuple(values), default_values, tuple(integer_slots), tuple(constants))
            )
        else:
            self.left = atom(name)
        self.left_offset = start
        self.left_priority = 0
        self.wants_operand = False

    def _move_positions(self, old: Term, new: Term) -> None:
        """Move the recorded positions of a term to the term that replaces it."""
        if self.offsets is not None and id(old) in self.offsets:
            self.offsets[id(new)] = self.offsets.pop(id(old))


def _unknown_slot_message(term: str, name: str, slots: Sequence[MessageSlot]) -> str:
    """Return the error message for the name of a slot that does not exist."""
    names = [slot.name for slot in slots]
    hint = did_you_mean(name, names) or f"; it has {', '.join(names) or 'none'}"
    return f"{term} has no slot {name}{hint}"
