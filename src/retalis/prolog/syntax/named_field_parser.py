"""What is wrong with a name before the bracket of slots: ``Temperature{...}``, ``buton{...}``, a blank.

Messages with slots by name, read: ``sensor_msgs__0__BatteryState{percentage: P, header: {stamp: S}}``.
"""

from difflib import get_close_matches
from typing import Any, Dict, List, Optional, Sequence, Tuple

from ...foundation.errors import RetalisError, SyntaxFault
from ..terms.types import Term, Var, atom, functor
from . import parser_stack
from .literals import atom_text
from .message_fields import Expanded, MessageSlot, Slots, as_floats
from .parser_stack import LIST, SLOTS, ParserStack, ParserState
from .tokenizer import NAME, QUOTED, VARIABLE, shown

_MAX_NAMED_TYPES = 3
"""Messages that an error names."""


def misnamed(parser: ParserState, known: Slots) -> Optional[SyntaxFault]:
    """Return the error about the bracket where a parser stands, behind a name; None where it has nothing of slots."""
    before, bracket = parser.tokens[parser.at - 1], parser.tokens[parser.at]
    is_apart = before[3] != bracket[2]
    if before[0] != VARIABLE and _is_message(before[1], known):
        message = f'no blank is allowed between {atom_text(before[1])} and its "{{"'
        return parser.source.fault(message, bracket[2]) if is_apart else None
    name, start = _whole(parser)
    found = known.meant(name)
    names = found.names[:_MAX_NAMED_TYPES]
    if found.other:
        hint = f"; write {' or '.join(f'{atom_text(one)}{{...}}' for one in names)}"
    elif names:
        hint = f"; did you mean {' or '.join(map(atom_text, names))}?"
    elif is_apart or before[0] == VARIABLE or name != before[1]:  # it may be meant as anything
        return None
    else:
        hint = ""
    return parser.source.fault(f"no message type or event of a topic is called {name}{hint}", start)


def _is_message(name: str, known: Slots) -> bool:
    try:
        return known.find(name) is not None
    except RetalisError:  # messages, of which more is not known
        return True


def _whole(parser: ParserState) -> Tuple[str, int]:
    """Return the name before the token where a parser stands, with its package in ``package/Type``; and where."""
    last = parser.tokens[parser.at - 1]
    if parser.at > 2:
        package, slash = parser.tokens[parser.at - 3 : parser.at - 1]
        if slash[:2] == (NAME, "/") and package[0] == NAME and (package[3], slash[3]) == (slash[2], last[2]):
            return f"{package[1]}/{last[1]}", package[2]
    return last[1], last[2]


_MARK = "__0__"
"""What names of message types have in them as terms."""

# The bracket of a message on the stack, after priority, kind, token and table: the values by slot number with their
# offsets, what the term is called, where it begins, its slots, and the number of the one that is being read.
_VALUES, _TERM, _START, _SLOTS, _NUMBER = range(4, 9)


class NamedFieldParser(ParserStack):
    """What is open while a clause is read, messages with named slots included."""

    def _open_slots(self, name: str, start: int) -> bool:
        """Open a message whose name has just been read, if it is one; tell whether so."""
        at = self.at
        if self.tokens[at][2] != self.tokens[at - 1][3] or self.flags.event_text:
            return False
        if name in self.operators.prefix or name in self.table:
            return False
        known = self.operators.slots
        if known is None:
            if _MARK in name:
                raise self.source.fault(f"slots by name are not read here: write all slots of {name}", start)
            return False
        try:
            slots = known.find(name)
        except RetalisError as error:
            raise self.source.fault(error.message, start) from error
        if slots is None:
            return False
        self._open_message(name, start, slots)
        return True

    def _no_operator(self) -> SyntaxFault:
        """Return the error about a token where a term has ended, which may be the bracket of a message."""
        known = self.operators.slots
        found = None
        if self.tokens[self.at][0] == "{" and self.tokens[self.at - 1][0] in (NAME, QUOTED, VARIABLE):
            found = misnamed(self, known) if known is not None and not self.flags.event_text else None
        return found or parser_stack.no_operator(self, self.brackets[-1])

    def _open_inner(self, at: int, start: int) -> bool:
        """Open a message that is the value of a slot, whose type says its name; tell whether it is one."""
        around = self.brackets[-1]
        if self.stack[-1] is not around:
            return False
        if around[1] == SLOTS:
            slot = around[_SLOTS][around[_NUMBER] - 1]
            if slot.array:
                raise self.source.fault(f"{slot.name} is {slot.type}: expected a list of its elements", start)
        elif around[1] == LIST and len(self.brackets) > 1 and self.brackets[-2][1] == SLOTS:
            slot = self.brackets[-2][_SLOTS][self.brackets[-2][_NUMBER] - 1]
            if not slot.array or around[6]:
                return False
        else:
            return False
        if not slot.message:
            raise self.source.fault(f"{slot.name} is {slot.type}, which has no slots", start)
        slots = self.operators.slots and self.operators.slots.find(slot.message)
        self._open_message(slot.message, start, slots or ())
        return True

    def _open_message(self, name: str, start: int, slots: Sequence[MessageSlot]) -> None:
        """Open a message at its bracket."""
        opened = self.at
        self.at = opened + 1
        self._push_bracket([self.argument_limit, SLOTS, opened, self.table, {}, name, start, slots, 0])
        if self.tokens[self.at][0] == "}":
            self._close_slots()
        else:
            self._begin_slot()

    def _begin_slot(self) -> None:
        """Read the name of a slot and its colon."""
        bracket = self.brackets[-1]
        token, following = self.tokens[self.at], self.tokens[self.at + 1]
        if token[0] not in (NAME, QUOTED) or following[0] != NAME or following[1] != ":":
            raise self._no_slot()
        name, slots = token[1], bracket[_SLOTS]
        names = [slot.name for slot in slots]
        if name not in names:
            raise self.source.fault(_unknown(bracket[_TERM], name, slots), token[2])
        number = bracket[_NUMBER] = names.index(name) + 1
        if number in bracket[_VALUES]:
            raise self.source.fault(f"slot {name} has a value already", token[2])
        self.at += 2
        self._begin_segment(self.at, self.operators.infix)

    def _no_slot(self) -> RetalisError:
        token, following = self.tokens[self.at : self.at + 2]
        what = shown(token, self.source.text)
        if token[0] in (NAME, QUOTED) and following[0] == NAME:
            if following[1].startswith(":"):
                return self.source.fault("expected a blank between : and the sign that follows", following[2])
            if following[1] == ".":
                message = f"slots of a message in a slot are written in brackets: {token[1]}: {{slot: Value}}"
                return self.source.fault(message, following[2])
        if token[0] in (NAME, QUOTED):
            message = f"expected a colon and a value after {what}"
            return self.source.fault(message, following[2])
        return self.source.fault(f"expected the name of a slot before {what}", token[2])

    def _comma(self, start: int) -> None:
        if self.brackets[-1][1] != SLOTS:
            super()._comma(start)
            return
        self._have_slot()
        self.at += 1
        self._begin_slot()

    def _have_slot(self) -> None:
        """Take the value of a slot that has just been read."""
        bracket = self._innermost()
        bracket[_VALUES][bracket[_NUMBER]] = (self.left, self.left_at)

    def _close(self, kind: str) -> None:
        if self.brackets[-1][1] != SLOTS:
            super()._close(kind)
            return
        self._have_slot()
        if kind != "}":
            raise parser_stack.unbalanced(self, self.brackets[-1][2])
        self._close_slots()

    def _close_slots(self) -> None:
        """Build the message."""
        bracket = self.brackets.pop()
        self.stack.pop()
        self.at += 1
        self.table = bracket[3]
        name, start, slots = bracket[_TERM], bracket[_START], bracket[_SLOTS]
        values: Dict[int, Tuple[Term, int]] = bracket[_VALUES]
        zeros: Dict[Var, Term] = {}
        arguments: List[Any] = []
        offsets = []
        whole = []
        for number, slot in enumerate(slots, 1):
            value, offset = values.get(number, (None, start))
            if value is None:
                value = Var()
                zeros[value] = slot.zero
            elif slot.real:
                written, value = value, as_floats(value, slot.array)
                if value is not written:
                    whole.append(number)
                    self._moved(written, value)
            arguments.append(value)
            offsets.append(offset)
        if arguments:
            term = (functor(name, len(slots)), *arguments)
            self._build(term, start, tuple(offsets))
            self.expanded.append(Expanded(term, tuple(values), zeros, tuple(whole)))
        else:
            self.left = atom(name)
        self.left_at = start
        self.left_priority = 0
        self.wants_operand = False

    def _moved(self, old: Term, new: Term) -> None:
        """Note that a term stands where another one stood."""
        if self.spots is not None and id(old) in self.spots:
            self.spots[id(new)] = self.spots.pop(id(old))


def _unknown(term: str, name: str, slots: Sequence[MessageSlot]) -> str:
    """Return what is wrong with the name of a slot that there is not."""
    names = [slot.name for slot in slots]
    near = get_close_matches(name, names, 1)
    if near:
        return f"{term} has no slot {name}; did you mean {near[0]}?"
    return f"{term} has no slot {name}; it has {', '.join(names) or 'none'}"
