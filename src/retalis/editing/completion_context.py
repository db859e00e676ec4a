"""Context of a position in an unfinished text.

In a clause, the context consists of the brackets around the position and of the names that are expected there. In a
``pub_sub.xml``, it is the element and the attribute.
"""

import re
from typing import List, NamedTuple, Optional, Tuple

from ..events.checks.memory_checks import MEMORY_READS
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

_MEMORY_READ_NAMES = frozenset(key.name for key in MEMORY_READS) | {"delete_memory"}


class CompletionContext(NamedTuple):
    """Names that are expected at a position.

    Attributes:
        symbol_kind: kind of the symbols that are expected; None for events, predicates and operators.
        message_path: in a message with named slots, the name of the message and the slots that lead to the position.
        is_slot_name: whether the name of a slot is expected there.
        named_slots: names of the slots before the position in the same bracket.
        variables: names of the variables before the position in the clause.
    """

    symbol_kind: Optional[SymbolKind]
    message_path: Tuple[str, ...]
    is_slot_name: bool
    named_slots: Tuple[str, ...]
    variables: Tuple[str, ...]


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
    start = text.rfind("\n", 0, offset) + 1 if is_goal_file else 0
    prefix = text[:offset]
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


def _ends_in_comment(prefix: str, end: int) -> bool:
    """Return whether the end of a text is in a comment, after its last token."""
    last_start = -1
    for first, last in comment_spans(prefix, end, len(prefix)):
        last_start = first if last == len(prefix) else -1
    return last_start >= 0 and (prefix[last_start] == "%" or not prefix.endswith("*/"))


def _context_after(clause: List[AnyToken]) -> CompletionContext:
    """Return the context after the tokens of an unfinished clause."""
    brackets: List[_UnclosedBracket] = []
    variables: List[str] = []
    for position, (kind, value, start, _) in enumerate(clause):
        previous = clause[position - 1] if position else None
        if kind in ("(", OPEN_CT, "[", "{"):
            is_functor = previous is not None and previous[0] in (NAME, QUOTED) and previous[3] == start
            brackets.append(_open(kind, brackets, previous[1] if previous and is_functor else ""))
        elif kind in (")", "]", "}") and brackets:
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
    is_message = innermost is not None and innermost.kind == "{" and bool(innermost.message_path)
    return CompletionContext(
        _expected_symbols(innermost),
        innermost.message_path if innermost is not None and is_message and last_kind in ("{", ",") else (),
        last_kind in ("{", ","),
        tuple(innermost.slots) if innermost is not None else (),
        tuple(variables),
    )


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


def find_xml_context(text: str, offset: int) -> Optional[XmlContext]:
    """Return the context of an offset in an XML file; None in a comment and outside of tags.

    Args:
        text: text of the file.
        offset: the offset.
    """
    prefix = text[:offset]
    start = prefix.rfind("<")
    if start < 0 or prefix.rfind("<!--") > prefix.rfind("-->"):
        return None
    name = _XML_NAME.match(prefix, start + 1)
    position = start + 1 if name is None else name.end()
    # The declaration and comments begin with `<?` and `<!`.
    has_root = any(beginning[:1].isalpha() for beginning in prefix[:start].split("<")[1:])
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
