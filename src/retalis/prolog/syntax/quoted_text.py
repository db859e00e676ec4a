r"""Backslash escapes and doubled quotes inside quotes (ISO 13211-1, 6.4.2.1, and SWI-Prolog's)."""

import re
from typing import Match, Optional, Pattern

_ESCAPE = re.compile(
    r"""\\(?: x([0-9a-fA-F]+)\\?
          | ([0-7]+)\\?
          | u([0-9a-fA-F]{4}) | U([0-9a-fA-F]{8})
          | (\n)
          | (c)\s*
          | ([\s\S]?) )
      | (['"`])\8""",
    re.VERBOSE,
)
_ESCAPE_END = re.compile(r"\\(?:x[0-9a-fA-F]+\\?|[0-7]+\\?|c\s*|[\s\S])")
_RUNS = {
    "'": re.compile(r"[^'\\\n]*"),
    '"': re.compile(r'[^"\\\n]*'),
    "`": re.compile(r"[^`\\\n]*"),
}
_LINE = re.compile(r"[^\\\n]*")
_PLAIN = {
    "a": "\a", "b": "\b", "f": "\f", "n": "\n", "r": "\r", "t": "\t", "v": "\v", "0": "\0", "e": "\x1b",
    "s": " ", "\\": "\\", "'": "'", '"': '"', "`": "`",
}  # fmt: skip


def closing(text: str, start: int, multiline: bool = False) -> Optional[int]:
    """Return where the quoted text that begins at ``start`` ends; None where it is not closed on its line.

    A new line may stand inside only after a backslash, but where it is ``multiline``. (A regular expression for the
    whole would take a kilobyte of memory for every escape.)
    """
    quote = text[start]
    run = _RUNS[quote]
    at = start + 1
    while True:
        at = _end(run, text, at)
        char = text[at : at + 1]
        if char == quote:
            if text[at + 1 : at + 2] != quote:
                return at + 1
            at += 2
            continue
        if multiline and char == "\n":
            at += 1
            continue
        escape = _ESCAPE_END.match(text, at)
        if escape is None:
            return None
        at = escape.end()


def unclosed_end(text: str, start: int) -> int:
    """Return where a quote that is never closed ends: with its line, before a full stop at the end of that."""
    at = start + 1
    while True:
        end = _end(_LINE, text, at)
        escape = _ESCAPE_END.match(text, end)
        if escape is None:
            break
        at = escape.end()
    line = text[at:end].rstrip(" \t")
    return at + len(line) - 1 if line.endswith(".") and text[end : end + 1] != "\\" else end


def _end(pattern: "Pattern[str]", text: str, at: int) -> int:
    found = pattern.match(text, at)
    assert found is not None
    return found.end()


def unquote(body: str, quote: str, strict: bool = False) -> str:
    """Return what the text between quotes stands for.

    Args:
        body: the text without its outer quotes.
        quote: the quote around it; doubled inside, it stands for itself.
        strict: take the escapes of ISO 13211-1 only, codes closed by a backslash.

    Raises:
        ValueError: with a message and the offset of the escape that is none.
    """

    def value(found: "Match[str]") -> str:
        hexadecimal, octal, short, long, newline, nothing, other, doubled = found.groups()
        if doubled is not None:
            return doubled if doubled == quote else doubled + doubled
        if strict and not _is_standard(found):
            raise ValueError(f"{found.group(0)} is not an escape sequence of ISO Prolog", found.start())
        if newline or nothing:
            return ""
        if other is not None:
            if other in _PLAIN and other:
                return _PLAIN[other]
            raise ValueError(_unknown(found.group(0)), found.start())
        code = int(octal, 8) if octal else int(hexadecimal or short or long, 16)
        if code > 0x10FFFF or 0xD800 <= code < 0xE000:
            raise ValueError(f"{found.group(0)} is not a Unicode character", found.start())
        return chr(code)

    return _ESCAPE.sub(value, body)


def _is_standard(found: "Match[str]") -> bool:
    hexadecimal, octal, _, _, newline, _, other, _ = found.groups()
    if hexadecimal or octal:
        return found.group(0).endswith("\\")
    return bool(newline) or (other is not None and other not in ("e", "s"))


def _unknown(escape: str) -> str:
    return rf"{escape} is not an escape sequence: to write a backslash in quotes, double it (\\)"
