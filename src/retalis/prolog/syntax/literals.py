"""Atoms, quoted text and numbers: conversion to text, and from text.

Atoms are quoted if they would not be read back as the same atom (ISO 13211-1, 7.10.5). The escapes of quoted text are
those of ISO 13211-1, 6.4.2.1, and of SWI-Prolog. Floats are written as the shortest decimal text that reads back,
which is what Python's ``repr`` returns.

Long integers: Python refuses to convert decimal texts of more than 4,300 digits, because its conversion takes
quadratic time. The conversions here divide a number into halves, which is faster and needs no change of Python's
limit.
"""

import re
import unicodedata
from decimal import MAX_EMAX, MAX_PREC, Decimal, Inexact, localcontext
from typing import Callable, Dict, Match, Optional, Pattern

from ...foundation.bounded_caches import TextCache
from ...foundation.limit_checks import check_limits

_UNQUOTED_NAME = re.compile(r"[^\W\d_]\w*\Z|[-+*/\\^<>=~:.?@#&$]+\Z|\[\]\Z|\{\}\Z|[!;]\Z")
"""Names that need no quotes: words, symbol characters, and solo atoms."""
_ESCAPE_CANDIDATE = re.compile(r"""[^ -&(-\[\]-~]|[\\'"`]""")
"""Characters that may need an escape within quotes."""
_CHUNK_CHARACTERS = 1 << 14
"""Characters that are escaped between two checks of the goal's limits."""
_ESCAPES = {"\a": "\\a", "\b": "\\b", "\f": "\\f", "\n": "\\n", "\t": "\\t", "\v": "\\v", "\r": "\\r"}
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
_PLAIN_TEXT = {
    "'": re.compile(r"[^'\\\n]*"),
    '"': re.compile(r'[^"\\\n]*'),
    "`": re.compile(r"[^`\\\n]*"),
}
"""For each quote, text without the quote itself, escapes and line ends."""
_PLAIN_TEXT_OF_LINE = re.compile(r"[^\\\n]*")
_ESCAPED_CHARACTERS = {
    "a": "\a",
    "b": "\b",
    "f": "\f",
    "n": "\n",
    "r": "\r",
    "t": "\t",
    "v": "\v",
    "0": "\0",
    "e": "\x1b",
    "s": " ",
    "\\": "\\",
    "'": "'",
    '"': '"',
    "`": "`",
}
"""Characters after a backslash, and the characters that they denote."""


def needs_quotes(name: str) -> bool:
    """Return whether an atom of this name must be quoted to be read back."""
    if _UNQUOTED_NAME.match(name) is None:
        return len(name) != 1 or ord(name) < 128 or unicodedata.category(name)[0] != "S"
    first = name[0]
    # Title-case letters (category Lt) begin variables, too. `.` would end the clause, and `/*` begin a comment.
    return first.isupper() or first.istitle() or name == "." or name[:2] == "/*"


def quote(text: str, mark: str) -> str:
    """Return a text in quotes, with the escapes that reading it back requires."""

    def escape(match: "Match[str]") -> str:
        char = match.group()
        if char in "'\"`":
            return "\\" + char if char == mark else char
        if char == "\\":
            return "\\\\"
        escape_letter = _ESCAPES.get(char)
        if escape_letter is not None:
            return escape_letter
        return char if char.isprintable() else f"\\x{ord(char):X}\\"

    if len(text) <= _CHUNK_CHARACTERS:
        return f"{mark}{_ESCAPE_CANDIDATE.sub(escape, text)}{mark}"
    check_limits(size=len(text))
    pieces = []
    for start in range(0, len(text), _CHUNK_CHARACTERS):
        pieces.append(_ESCAPE_CANDIDATE.sub(escape, text[start : start + _CHUNK_CHARACTERS]))
        check_limits()
    check_limits(size=sum(map(len, pieces)))
    return f"{mark}{''.join(pieces)}{mark}"


def _atom_text(name: str) -> str:
    return quote(name, "'") if needs_quotes(name) else name


atom_text: Callable[[str], str] = TextCache(_atom_text, 8192, 4 << 20, 2048).__getitem__
"""Return an atom as ``writeq/1`` writes it; cached."""


def quote_end(text: str, start: int, multiline: bool = False) -> Optional[int]:
    """Return the offset after the quoted text at ``start``, or None if it is not closed on its line.

    Args:
        text: the whole text.
        start: offset of the opening quote.
        multiline: allow line ends without a backslash before them.
    """
    # Runs of plain characters are skipped by a regular expression, escapes one by one: a single expression for the
    # whole would take a kilobyte of memory for every escape.
    quote = text[start]
    run = _PLAIN_TEXT[quote]
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


def unclosed_quote_end(text: str, start: int) -> int:
    """Return the end of an unclosed quote: the end of its line, or before a full stop there."""
    offset = start + 1
    while True:
        end = _match_end(_PLAIN_TEXT_OF_LINE, text, offset)
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
            if letter in _ESCAPED_CHARACTERS and letter:
                return _ESCAPED_CHARACTERS[letter]
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


_SAFE_DIGITS = 4000
"""Decimal digits that every Python version converts."""

_SAFE_BITS = 4096
"""Bits of an integer that `Decimal` converts quickly."""

_MAX_DIGITS = 315_653
"""Digits of the longest number that is read: those of the largest integer of arithmetic."""

_SAFE_MAX = 10**_SAFE_DIGITS
_SAFE_MIN = -_SAFE_MAX


def integer(text: str, radix: int = 10) -> int:
    """Return the integer that a text of digits denotes.

    Raises:
        ValueError: if a character is not a digit in this radix, or there are too many digits.
    """
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"a number of {len(text)} digits is too long (at most {_MAX_DIGITS} are allowed)")
    # Python converts radices that are powers of two in linear time, without a limit.
    if len(text) <= _SAFE_DIGITS or radix in (2, 4, 8, 16, 32):
        return int(text, radix)
    ends = range(len(text), 0, -_SAFE_DIGITS)
    values = [int(text[max(0, end - _SAFE_DIGITS) : end], radix) for end in ends]
    scale = radix**_SAFE_DIGITS
    # The blocks are in order of significance, lowest first. Adjacent blocks are combined until one is left: the
    # number of multiplications is logarithmic in the number of blocks, and Python multiplies large numbers in
    # n^1.58 (Karatsuba).
    while len(values) > 1:
        check_limits()
        if len(values) % 2:
            values.append(0)
        values = [low + high * scale for low, high in zip(values[::2], values[1::2])]
        scale *= scale
    return values[0]


def integer_text(value: int) -> str:
    """Return the decimal text of an integer of any size."""
    if _SAFE_MIN < value < _SAFE_MAX:
        return str(value)
    if value < 0:
        return "-" + integer_text(-value)
    with localcontext() as context:
        context.prec, context.Emax = MAX_PREC, MAX_EMAX
        context.traps[Inexact] = True
        return str(_decimal(value))


def _decimal(value: int) -> Decimal:
    # The bits are halved until `Decimal` converts them quickly, and the halves are combined as decimals. libmpdec
    # multiplies with a number-theoretic transform, in little more than linear time.
    sizes = [value.bit_length()]
    while sizes[-1] > _SAFE_BITS:
        sizes.append((sizes[-1] + 1) // 2)
    parts = [value]
    for size in sizes[1:]:  # parts are in order of significance, highest first
        check_limits()
        mask = (1 << size) - 1
        parts = [half for part in parts for half in (part >> size, part & mask)]
    numbers = [Decimal(part) for part in parts]
    for size in reversed(sizes[1:]):
        check_limits()
        scale = Decimal(2) ** size
        numbers = [high * scale + low for high, low in zip(numbers[::2], numbers[1::2])]
    return numbers[0]


def float_text(value: float) -> str:
    """Return a float as SWI-Prolog 9 writes it: the shortest text that reads back, always with a decimal point.

    Whole numbers from 1e15 on have an exponent. Infinities and nan are ``1.0Inf`` and ``1.5NaN``.
    """
    text = repr(value)
    if "e" in text:
        mantissa, exponent = text.split("e")
        return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{int(exponent):+d}"
    if len(text) > 17 and text.endswith(".0") and len(text) - (text[0] == "-") > 17:
        return _exponent_form(text)
    return _SPECIAL.get(text, text)


_SPECIAL: Dict[str, str] = {"inf": "1.0Inf", "-inf": "-1.0Inf", "nan": "1.5NaN"}


def _exponent_form(text: str) -> str:
    """Return a whole number of 16 digits or more in exponent form."""
    sign = "-" if text[0] == "-" else ""
    digits = text[len(sign) : -2]
    fraction = digits[1:].rstrip("0") or "0"
    return f"{sign}{digits[0]}.{fraction}e+{len(digits) - 1}"


def float_value(text: str) -> float:
    """Return the float that a text denotes.

    Raises:
        ValueError: if the number is too large for a double.
    """
    if text.endswith("Inf"):
        return float("inf")
    if text.endswith("NaN"):
        return float("nan")
    value = float(text)
    if value == float("inf"):
        raise ValueError(text)
    return value


def radix_integer(text: str) -> int:
    """Return the integer of a text such as ``16'FF``, ``0xFF``, ``0o17`` or ``0b11``.

    Raises:
        ValueError: if the radix is not 2 to 36, or a character is not a digit in it.
    """
    if "'" in text:
        radix, digits = text.split("'")
        if not (1 < len(radix) + 1 < 4 and 2 <= int(radix) <= 36):
            raise ValueError(text)
        return integer(digits, int(radix))
    return integer(text[2:].replace("_", ""), {"x": 16, "o": 8, "b": 2}[text[1]])
