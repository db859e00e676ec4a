"""Safe display of external text: shortened, escaped and quoted; and the display of counts and durations."""

import json
import re

MAX_SHOWN_CHARACTERS = 200
"""Maximum number of characters of an external text that are stored and displayed."""


def shorten(text: str, limit: int = MAX_SHOWN_CHARACTERS) -> str:
    """Return a text, shortened to its first ``limit`` characters."""
    return text if len(text) <= limit else f"{text[:limit]}..."


_FORGING_CHARACTERS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ufffe\uffff\ud800-\udfff\U000e0000-\U000e007f]|(?<![^\x00-\x7f])[\u200c\u200d]"
)
"""Characters that could forge the display: C0 except newline and tab, DEL, C1, direction marks, characters without
width, unpaired surrogates, and characters that XML 1.0 excludes. Joiners (U+200C, U+200D) are part of words and
emoji, so they are allowed after a character that is not ASCII."""


def printable(text: str) -> str:
    r"""Return a text in which characters that a terminal, a log or XML would interpret are escaped.

    It is applied wherever a text leaves the program for display. Newlines and tabs are kept.
    >>> print(printable("\x1b[31m alarm \u202e"))
    \x1b[31m alarm \u202e
    """
    # The usual case, decided by two fast methods.
    if text.isascii() and text.isprintable():
        return text
    # `ascii` yields the escape in quotes, which are removed.
    return _FORGING_CHARACTERS.sub(lambda match: ascii(match[0])[1:-1], text)


def printable_json(data: object) -> str:
    """Return data as JSON for display in a web page, with all strings made `printable`."""
    return json.dumps(_printable_parts(data))


def _printable_parts(data: object) -> object:
    if isinstance(data, str):
        return printable(data)
    if isinstance(data, dict):
        return {_printable_parts(key): _printable_parts(value) for key, value in data.items()}
    return [_printable_parts(item) for item in data] if isinstance(data, (list, tuple)) else data


def quote_shortened(text: str) -> str:
    """Return an external text for an error message: quoted, in ASCII, and shortened."""
    return (
        ascii(text)
        if len(text) <= MAX_SHOWN_CHARACTERS
        else f"{ascii(text[:MAX_SHOWN_CHARACTERS])}... ({len(text)} characters)"
    )


def format_count(number: int, singular: str, plural: str = "") -> str:
    """Return a count with its noun: ``1 slot``, ``2 slots``; ``plural`` is an irregular plural."""
    return f"{number} {singular if number == 1 else plural or f'{singular}s'}"


def format_duration(seconds: float) -> str:
    """Return a time span of finite length with its units: ``1 h 23 min 20 s``, ``2.5 s``, ``500 ms``."""
    nanoseconds = round(seconds * 1_000_000_000)
    if 0 < abs(nanoseconds) < 1_000_000_000:
        return f"{nanoseconds / 1_000_000:.6f}".rstrip("0").rstrip(".") + " ms"
    sign, nanoseconds = "-" * (nanoseconds < 0), abs(nanoseconds)
    minutes, nanoseconds = divmod(nanoseconds, 60_000_000_000)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    parts = [f"{count} {unit}" for count, unit in ((days, "d"), (hours, "h"), (minutes, "min")) if count]
    if nanoseconds or not parts:
        whole, fraction = divmod(nanoseconds, 1_000_000_000)
        parts.append(f"{whole}.{fraction:09}".rstrip("0").rstrip(".") + " s")
    return sign + " ".join(parts)


def format_number(number: float) -> str:
    """Return a number, such as a time in seconds, as it is written in programs: ``1234567``, ``0.1``, ``2``."""
    # `g` alone rounds to six digits.
    return f"{number:.15g}"


def describe_decode_error(error: UnicodeDecodeError) -> str:
    """Return an error text for bytes that are not text in an encoding, with line and byte."""
    line = error.object.count(b"\n", 0, error.start) + 1
    return (
        f"not {error.encoding.upper()} text (line {line}: {error.reason} 0x{error.object[error.start]:02x})"
    )
