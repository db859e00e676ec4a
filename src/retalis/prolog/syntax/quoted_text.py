"""Quoted text: its end, its escapes and doubled quotes (ISO 13211-1, 6.4.2.1, and SWI-Prolog's escapes)."""

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
"""An escape sequence or a doubled quote; see `unquote` for the groups."""
_ESCAPE_END = re.compile(r"\\(?:x[0-9a-fA-F]+\\?|[0-7]+\\?|c\s*|[\s\S])")
"""An escape sequence of any kind, valid or not."""
_RUNS = {
    "'": re.compile(r"[^'\\\n]*"),
    '"': re.compile(r'[^"\\\n]*'),
    "`": re.compile(r"[^`\\\n]*"),
}
"""For each quote, text without the quote itself, escapes and line ends."""
_LINE = re.compile(r"[^\\\n]*")
_PLAIN = {
    "a": "\a", "b": "\b", "f": "\f", "n": "\n", "r": "\r", "t": "\t", "v": "\v", "0": "\0", "e": "\x1b",
    "s": " ", "\\": "\\", "'": "'", '"': '"', "`": "`",
}  # fmt: skip
"""Characters after a backslash, and the characters that they denote."""


def closing(text: str, start: int, multiline: bool = False) -> Optional[int]:
    """Return the offset after the quoted text at ``start``, or None if it is not closed on its line.

    Args:
        text: the whole text.
        start: offset of the opening quote.
        multiline: allow line ends without a backslash before them.
    """
    # Runs of plain characters are skipped by a regular expression, escapes one by one: a single expression for the
    # whole would take a kilobyte of memory for every escape.
    quote = text[start]
    run = _RUNS[quote]
    offset = start + 1
    while True:
        offset = _match_end(run, text, offset)
        char = text[offset : offset + 1]
        if char == quote:
            if text[offset + 1 : offset + 2] != quote:
                return offset + 1
            offset += 2
            continue
        if multiline and char == "\n":
            offset += 1
            continue
        escape = _ESCAPE_END.match(text, offset)
        if escape is None:
            return None
        offset = escape.end()


def unclosed_end(text: str, start: int) -> int:
    """Return the end of an unclosed quote: the end of its line, or before a full stop there."""
    offset = start + 1
    while True:
        end = _match_end(_LINE, text, offset)
        escape = _ESCAPE_END.match(text, end)
        if escape is None:
            break
        offset = escape.end()
    # A full stop at the end of the line probably ends the clause; leaving it out of the quote lets the reader
    # continue with the next clause.
    line = text[offset:end].rstrip(" \t")
    return offset + len(line) - 1 if line.endswith(".") and text[end : end + 1] != "\\" else end


def _match_end(pattern: "Pattern[str]", text: str, offset: int) -> int:
    run = pattern.match(text, offset)
    assert run is not None
    return run.end()


def unquote(body: str, quote: str, strict: bool = False) -> str:
    """Return the text that quoted text denotes.

    Args:
        body: the text without its outer quotes.
        quote: the quote around it; if doubled inside, it denotes itself.
        strict: accept only the escapes of ISO 13211-1, with character codes closed by a backslash.

    Raises:
        ValueError: with a message and the offset of an invalid escape.
    """

    def value(match: "Match[str]") -> str:
        hexadecimal, octal, short, long, newline, nothing, letter, doubled = match.groups()
        if doubled is not None:
            return doubled if doubled == quote else doubled + doubled
        if strict and not _is_standard(match):
            raise ValueError(f"{match.group(0)} is not an escape sequence of ISO Prolog", match.start())
        if newline or nothing:
            return ""
        if letter is not None:
            if letter in _PLAIN and letter:
                return _PLAIN[letter]
            raise ValueError(_unknown_escape_message(match.group(0)), match.start())
        code = int(octal, 8) if octal else int(hexadecimal or short or long, 16)
        if code > 0x10FFFF or 0xD800 <= code < 0xE000:
            raise ValueError(f"{match.group(0)} is not a Unicode character", match.start())
        return chr(code)

    return _ESCAPE.sub(value, body)


def _is_standard(match: "Match[str]") -> bool:
    hexadecimal, octal, _, _, newline, _, letter, _ = match.groups()
    if hexadecimal or octal:
        return match.group(0).endswith("\\")
    return bool(newline) or (letter is not None and letter not in ("e", "s"))


def _unknown_escape_message(escape: str) -> str:
    return rf"{escape} is not an escape sequence: to write a backslash in quotes, double it (\\)"
