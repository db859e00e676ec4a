"""What is wrong with a name before the bracket of slots: ``Temperature{...}``, ``buton{...}``, a blank."""

from typing import Optional, Tuple

from ...foundation import RetalisError, SyntaxFault
from .atoms import atom_text
from .slots import Slots
from .state import ReadingState
from .tokens import NAME, VARIABLE

_MOST = 3
"""Messages that an error names."""


def misnamed(parser: ReadingState, known: Slots) -> Optional[SyntaxFault]:
    """Return the error about the bracket where a parser stands, behind a name; None where it has nothing of slots."""
    before, bracket = parser.tokens[parser.at - 1], parser.tokens[parser.at]
    is_apart = before[3] != bracket[2]
    if before[0] != VARIABLE and _is_message(before[1], known):
        message = f'no blank is allowed between {atom_text(before[1])} and its "{{"'
        return parser.source.fault(message, bracket[2]) if is_apart else None
    name, start = _whole(parser)
    found = known.meant(name)
    names = found.names[:_MOST]
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


def _whole(parser: ReadingState) -> Tuple[str, int]:
    """Return the name before the token where a parser stands, with its package in ``package/Type``; and where."""
    last = parser.tokens[parser.at - 1]
    if parser.at > 2:
        package, slash = parser.tokens[parser.at - 3 : parser.at - 1]
        if slash[:2] == (NAME, "/") and package[0] == NAME and (package[3], slash[3]) == (slash[2], last[2]):
            return f"{package[1]}/{last[1]}", package[2]
    return last[1], last[2]
