"""Text of atoms, quoted text and numbers, and conversion of numbers from text.

Atoms are quoted if they would not be read back as the same atom (ISO 13211-1, 7.10.5). Floats are written as the
shortest decimal text that reads back, which is what Python's ``repr`` returns.

Long integers: Python refuses to convert decimal texts of more than 4,300 digits, because its conversion takes
quadratic time. The conversions here divide a number into halves, which is faster and needs no change of Python's
limit.
"""

import re
import unicodedata
from decimal import MAX_EMAX, MAX_PREC, Decimal, Inexact, localcontext
from typing import Callable, Dict, Match

from ...foundation.bounded_caches import TextCache
from ...foundation.cancellation import check_limits
from ...foundation.cpython_and_pypy import LONG_DECIMALS

_PLAIN = re.compile(r"[^\W\d_]\w*\Z|[-+*/\\^<>=~:.?@#&$]+\Z|\[\]\Z|\{\}\Z|[!;]\Z")
"""Names that need no quotes: words, symbol characters, and solo atoms."""
_ESCAPED = re.compile(r"""[^ -&(-\[\]-~]|[\\'"`]""")
"""Characters that may need an escape within quotes."""
_CHUNK_CHARACTERS = 1 << 14
"""Characters that are escaped between two checks of the goal's limits."""
_NAMED = {"\a": "\\a", "\b": "\\b", "\f": "\\f", "\n": "\\n", "\t": "\\t", "\v": "\\v", "\r": "\\r"}


def needs_quotes(name: str) -> bool:
    """Return whether an atom of this name must be quoted to be read back."""
    if _PLAIN.match(name) is None:
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
        escape_letter = _NAMED.get(char)
        if escape_letter is not None:
            return escape_letter
        return char if char.isprintable() else f"\\x{ord(char):X}\\"

    if len(text) <= _CHUNK_CHARACTERS:
        return f"{mark}{_ESCAPED.sub(escape, text)}{mark}"
    check_limits(size=len(text))
    pieces = []
    for start in range(0, len(text), _CHUNK_CHARACTERS):
        pieces.append(_ESCAPED.sub(escape, text[start : start + _CHUNK_CHARACTERS]))
        check_limits()
    check_limits(size=sum(map(len, pieces)))
    return f"{mark}{''.join(pieces)}{mark}"


def _atom_text(name: str) -> str:
    return quote(name, "'") if needs_quotes(name) else name


atom_text: Callable[[str], str] = TextCache(_atom_text, 8192, 4 << 20, 2048).__getitem__
"""Return an atom as ``writeq/1`` writes it; cached."""


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
    if not LONG_DECIMALS:
        return _text_by_division(value)
    with localcontext() as context:
        context.prec, context.Emax = MAX_PREC, MAX_EMAX
        context.traps[Inexact] = True
        return str(_decimal(value))


def _decimal(value: int) -> Decimal:
    """Return an integer as a `Decimal`."""
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


def _text_by_division(value: int) -> str:
    """Return the text of an integer of more than `_SAFE_DIGITS` digits by repeated division, which is slower."""
    scales = [_SAFE_MAX]
    while scales[-1] <= value:
        check_limits()
        scales.append(scales[-1] ** 2)
    parts = [value]
    for scale in reversed(scales[:-1]):  # parts are in order of significance, highest first
        halves = []
        for part in parts:
            check_limits()
            halves += divmod(part, scale)
        parts = halves
    return "".join(str(part).zfill(_SAFE_DIGITS) for part in parts).lstrip("0")


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
