"""Context of a position in an unfinished text.

In a clause, the context consists of the brackets around the position and of the names that are expected there. In a
``pub_sub.xml``, it is the element and the attribute.
"""

import re
from typing import List, NamedTuple, Optional, Tuple

from ..events.checks.memory_and_state_checks import MEMORY_READS
from ..prolog.syntax.term_reader import OF_FILES
from ..prolog.syntax.tokenizer import (
    END,
    NAME,
    NUMBER,
    OPEN_CT,
    QUOTED,
    VARIABLE,
    AnyToken,
    Source,
    comment_spans,
    tokenize,
)
from .symbol_uses import SymbolKind

MAX_GOAL_LINES = 100
"""Maximum number of lines before a position that are searched for the begin of its goal."""

_OPENING = ("(", OPEN_CT, "[", "{")
_CLOSING = (")", "]", "}")

_MEMORY_READ_NAMES = frozenset(key.name for key in MEMORY_READS) | {"delete_memory"}


WindowPath = Tuple[Tuple[str, int], ...]
"""Functors around a part of a window, from ``aggregate``, each with the number of its argument."""


class CompletionContext(NamedTuple):
    """Names that are expected at a position.

    Attributes:
        symbol_kind: kind of the symbols that are expected; None for events, predicates and operators.
        message_path: in a message with named slots, the name of the message and the slots that lead to the position.
        is_slot_name: whether the name of a slot is expected there.
        named_slots: names of the slots before the position in the same bracket.
        variables: names of the variables before the position in the clause.
        window_path: in the window of an aggregate, the functors around the position, ``aggregate`` first, each with
            the number of its argument; else empty.
    """

    symbol_kind: Optional[SymbolKind]
    message_path: Tuple[str, ...]
    is_slot_name: bool
    named_slots: Tuple[str, ...]
    variables: Tuple[str, ...]
    window_path: WindowPath = ()


class _UnclosedBracket:
    """A bracket before the position that is still open."""

    def __init__(self, kind: str, functor: str, message_path: Tuple[str, ...]):
        self.kind = kind
        self.functor = functor
        self.message_path = message_path
        self.argument = 1
        self.slots: List[str] = []


def find_context(text: str, offset: int, is_goal_file: bool) -> Optional[CompletionContext]:
    """Return the context of an offset; None in a comment, in quotes or in a number.

    Args:
        text: text of the file.
        offset: the offset.
        is_goal_file: whether each line begins a goal.
    """
    prefix = text[:offset]
    start = _find_goal_start(prefix) if is_goal_file else 0
    clause: List[AnyToken] = []
    end = start
    for token in tokenize(Source("", prefix), lambda: OF_FILES, start):
        clause.append(token)
        end = token[3]
        if token[0] == END and token[3] < offset:
            clause = []
    if _ends_in_comment(prefix, end) or (clause and clause[-1][0] in ("bad", NUMBER) and end == offset):
        return None
    if clause and clause[-1][3] == offset and clause[-1][0] in (NAME, VARIABLE):
        # The word that is completed.
        clause.pop()
    return _context_after(clause)


def _find_goal_start(prefix: str) -> int:
    """Return the offset of the first line of the goal at the end of a part of a goal file.

    A line continues on the next one if one of its brackets is open, or if it ends with a comma or a bar.
    """
    start = prefix.rfind("\n") + 1
    for _ in range(MAX_GOAL_LINES):
        previous_start = prefix.rfind("\n", 0, max(0, start - 1)) + 1
        tokens = list(tokenize(Source("", prefix[previous_start:start]), lambda: OF_FILES))
        opened = sum((kind in _OPENING) - (kind in _CLOSING) for kind, _, _, _ in tokens)
        if not tokens or not (opened > 0 or tokens[-1][0] in (",", "|")):
            break
        start = previous_start
    return start


def _ends_in_comment(prefix: str, end: int) -> bool:
    """Return whether the end of a text is in a comment, after its last token."""
    last_start = -1
    for first, last in comment_spans(prefix, end, len(prefix)):
        last_start = first if last == len(prefix) else -1
    return last_start >= 0 and (prefix[last_start] == "%" or not prefix.endswith("*/"))


def _context_after(clause: List[AnyToken]) -> CompletionContext:
    brackets: List[_UnclosedBracket] = []
    variables: List[str] = []
    for position, (kind, value, start, _) in enumerate(clause):
        previous = clause[position - 1] if position else None
        if kind in _OPENING:
            is_functor = previous is not None and previous[0] in (NAME, QUOTED) and previous[3] == start
            brackets.append(_open(kind, brackets, previous[1] if previous and is_functor else ""))
        elif kind in _CLOSING and brackets:
            brackets.pop()
        elif kind == "," and brackets:
            brackets[-1].argument += 1
        elif kind == NAME and value == ":" and brackets and previous is not None:
            if brackets[-1].message_path and previous[0] in (NAME, QUOTED):
                brackets[-1].slots.append(previous[1])
        # After a bracket, the name of a constant.
        elif kind == VARIABLE and value not in ("_", *variables) and not (previous and previous[0] == "{"):
            variables.append(value)
    innermost = brackets[-1] if brackets else None
    last_kind = clause[-1][0] if clause else ""
    is_slot_name = innermost is not None and innermost.kind == "{" and last_kind in ("{", ",")
    is_slot_name = is_slot_name and innermost is not None and bool(innermost.message_path)
    return CompletionContext(
        _expected_symbols(innermost),
        innermost.message_path if innermost is not None and is_slot_name else (),
        is_slot_name,
        tuple(innermost.slots) if innermost is not None else (),
        tuple(variables),
        _find_window_path(brackets),
    )


def _find_window_path(brackets: List[_UnclosedBracket]) -> WindowPath:
    path: List[Tuple[str, int]] = []
    for bracket in reversed(brackets):
        # Steps are in a list, and have no parts of windows.
        if bracket.kind != OPEN_CT:
            return ()
        path.append((bracket.functor, bracket.argument))
        if bracket.functor == "aggregate":
            return tuple(reversed(path)) if bracket.argument == 4 else ()
    return ()


def _open(kind: str, brackets: List[_UnclosedBracket], functor: str) -> _UnclosedBracket:
    outer = brackets[-1] if brackets else None
    path: Tuple[str, ...] = ()
    if kind == "{" and functor:
        path = (functor,)
    elif kind in ("{", "[") and outer is not None and outer.message_path:
        # The value of a slot, or an element of a list in a slot.
        path = (*outer.message_path, *outer.slots[-1:]) if outer.kind == "{" else outer.message_path
    return _UnclosedBracket(kind, functor, path)


def _expected_symbols(bracket: Optional[_UnclosedBracket]) -> Optional[SymbolKind]:
    if bracket is None or bracket.kind != OPEN_CT:
        return None
    if bracket.functor in _MEMORY_READ_NAMES and bracket.argument == 1:
        return SymbolKind.MEMORY
    if bracket.functor == "subscribe" and bracket.argument == 4:
        return SymbolKind.TOPIC
    return None


class XmlContext(NamedTuple):
    """Names that are expected at a position of an XML file.

    Attributes:
        element: name of the element whose attributes are expected; "" if the name of an element is expected.
        attribute: name of the attribute whose value is expected; "" for the name of an attribute or element.
        given_attributes: names of the attributes that the element has before the position.
        has_root: whether an element begins before the position.
    """

    element: str
    attribute: str
    given_attributes: Tuple[str, ...]
    has_root: bool


_XML_NAME = re.compile(r"[\w.-]*")
_XML_OPEN_ATTRIBUTE = re.compile(r"""\s+([\w.-]+)\s*=\s*(?:"[^"]*|'[^']*)""")


def _has_element(text: str) -> bool:
    """Return whether an element begins in a part of an XML file. The declaration begins with ``<?``."""
    tag = text.find("<")
    while tag >= 0 and not text[tag + 1 : tag + 2].isalpha():
        comment_end = text.find("-->", tag) if text.startswith("<!--", tag) else tag
        tag = text.find("<", comment_end + 1) if comment_end >= 0 else -1
    return tag >= 0


def find_xml_context(text: str, offset: int) -> Optional[XmlContext]:
    """Return the context of an offset in an XML file; None in a comment and outside of tags."""
    prefix = text[:offset]
    start = prefix.rfind("<")
    if start < 0 or prefix.rfind("<!--") > prefix.rfind("-->"):
        return None
    name = _XML_NAME.match(prefix, start + 1)
    position = start + 1 if name is None else name.end()
    has_root = _has_element(prefix[:start])
    if position == offset:
        return XmlContext("", "", (), has_root)
    element = prefix[start + 1 : position]
    given: List[str] = []
    while True:
        attribute = _XML_OPEN_ATTRIBUTE.match(prefix, position)
        if attribute is None:
            break
        if attribute.end() == offset:
            return XmlContext(element, attribute[1], tuple(given), has_root)
        given.append(attribute[1])
        # After the closing quotation mark.
        position = attribute.end() + 1
    remainder = prefix[position:]
    word = remainder.lstrip()
    if not element or word == remainder or _XML_NAME.fullmatch(word) is None:
        return None
    return XmlContext(element, "", tuple(given), has_root)
