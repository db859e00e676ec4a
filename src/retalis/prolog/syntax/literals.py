"""How atoms, strings and numbers look in text.

Numbers and their text, in both directions.

Python refuses to convert long decimal texts (4,300 digits, a guard against slow conversion), so long
integers are converted here in halves, which is also faster.
"""

import re
import unicodedata
from decimal import MAX_EMAX, MAX_PREC, Decimal, Inexact, localcontext
from typing import Callable, Dict, Match

from ...foundation.bounded_caches import Texts
from ...foundation.cancellation import look
from ...foundation.python_interpreter import LONG_DECIMALS

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


_SAFE = 4000
"""Decimal digits that every Python version converts."""

_SAFE_BITS = 4096

_MAX_DIGITS = 315_653
"""Digits of the longest number that is read: those of the largest integer that arithmetic makes."""

_SAFE_MAX = 10**_SAFE
_SAFE_MIN = -_SAFE_MAX


def integer(text: str, radix: int = 10) -> int:
    """Return the integer that a text of digits names.

    Raises:
        ValueError: where a digit is none in this radix, or there are too many.
    """
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"a number of {len(text)} digits is too long (at most {_MAX_DIGITS} are allowed)")
    if len(text) <= _SAFE or radix in (2, 4, 8, 16, 32):
        return int(text, radix)
    values = [int(text[max(0, at - _SAFE) : at], radix) for at in range(len(text), 0, -_SAFE)]
    scale = radix**_SAFE
    while len(values) > 1:  # least significant first; neighbours are joined until one is left
        look()
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
        return _divided(value)
    with localcontext() as context:
        context.prec, context.Emax = MAX_PREC, MAX_EMAX
        context.traps[Inexact] = True
        return str(_decimal(value))


def _decimal(value: int) -> Decimal:
    """Return an integer as a decimal number, whose products take little more than linear time.

    The bits are halved until Python converts them quickly; the halves are put together as decimals.
    """
    sizes = [value.bit_length()]
    while sizes[-1] > _SAFE_BITS:
        sizes.append((sizes[-1] + 1) // 2)
    parts = [value]
    for size in sizes[1:]:  # most significant first
        look()
        mask = (1 << size) - 1
        parts = [half for part in parts for half in (part >> size, part & mask)]
    numbers = [Decimal(part) for part in parts]
    for size in reversed(sizes[1:]):
        look()
        scale = Decimal(2) ** size
        numbers = [high * scale + low for high, low in zip(numbers[::2], numbers[1::2])]
    return numbers[0]


def _divided(value: int) -> str:
    """Return the text of an integer of more than `_SAFE` digits by divisions, which take longer."""
    scales = [_SAFE_MAX]
    while scales[-1] <= value:
        look()
        scales.append(scales[-1] ** 2)
    parts = [value]
    for scale in reversed(scales[:-1]):  # most significant first
        halves = []
        for part in parts:
            look()
            halves += divmod(part, scale)
        parts = halves
    return "".join(str(part).zfill(_SAFE) for part in parts).lstrip("0")


def float_text(value: float) -> str:
    """Return a float as SWI-Prolog 9 writes it: shortest text that reads back, always with a point.

    Whole numbers from 1e15 on have an exponent, as there; infinities and nan are ``1.0Inf`` and ``1.5NaN``.
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
    """Return the float that a text names.

    Raises:
        ValueError: where the number is too large for a double.
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
        ValueError: where the radix is not 2 to 36, or a digit is none in it.
    """
    if "'" in text:
        radix, digits = text.split("'")
        if not (1 < len(radix) + 1 < 4 and 2 <= int(radix) <= 36):
            raise ValueError(text)
        return integer(digits, int(radix))
    return integer(text[2:].replace("_", ""), {"x": 16, "o": 8, "b": 2}[text[1]])
