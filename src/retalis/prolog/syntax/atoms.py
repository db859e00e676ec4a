"""How atoms, strings and numbers look in text."""

import re
import unicodedata
from typing import Callable, Match

from ...foundation import Texts, look

_PLAIN = re.compile(r"[^\W\d_]\w*\Z|[-+*/\\^<>=~:.?@#&$]+\Z|\[\]\Z|\{\}\Z|[!;]\Z")
_ESCAPED = re.compile(r"""[^ -&(-\[\]-~]|[\\'"`]""")
_LONG = 1 << 14
"""Characters that are escaped between two looks at the limits of a goal."""
_NAMED = {"\a": "\\a", "\b": "\\b", "\f": "\\f", "\n": "\\n", "\t": "\\t", "\v": "\\v", "\r": "\\r"}


def needs_quotes(name: str) -> bool:
    """Tell whether an atom of this name has to be quoted to be read back."""
    if _PLAIN.match(name) is None:
        return len(name) != 1 or ord(name) < 128 or unicodedata.category(name)[0] != "S"
    first = name[0]
    return first.isupper() or first.istitle() or name == "." or name[:2] == "/*"


def quote(text: str, mark: str) -> str:
    """Return a text between quotes, escaped so that it is read back."""

    def escape(found: "Match[str]") -> str:
        char = found.group()
        if char in "'\"`":
            return "\\" + char if char == mark else char
        if char == "\\":
            return "\\\\"
        named = _NAMED.get(char)
        if named is not None:
            return named
        return char if char.isprintable() else f"\\x{ord(char):X}\\"

    if len(text) <= _LONG:
        return f"{mark}{_ESCAPED.sub(escape, text)}{mark}"
    look(size=len(text))
    pieces = []
    for start in range(0, len(text), _LONG):
        pieces.append(_ESCAPED.sub(escape, text[start : start + _LONG]))
        look()
    look(size=sum(map(len, pieces)))
    return f"{mark}{''.join(pieces)}{mark}"


def _atom_text(name: str) -> str:
    return quote(name, "'") if needs_quotes(name) else name


atom_text: Callable[[str], str] = Texts(_atom_text, 8192, 4 << 20, 2048).__getitem__
"""Return an atom as `writeq` shows it."""
