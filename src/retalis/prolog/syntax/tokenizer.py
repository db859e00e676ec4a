"""Tokens of Prolog text.

The tokens are those of ISO 13211-1, 6.4, with the extensions that SWI-Prolog users write. One regular expression with
a named group for each kind of token matches at each offset. Quoted text with escapes is the exception: `literals`
finds its end, because a regular expression takes a kilobyte of memory for every escape.

A token is a tuple of kind, value, start and end. Invalid text becomes a token of kind ``bad`` with an error message
and does not raise: the reader then decides whether the error belongs to the clause that it is reading. Which token
may follow which depends on operators, which programs declare; see `term_reader`.
"""

import re
import unicodedata
from bisect import bisect_right
from typing import Any, Callable, Dict, Iterator, List, Match, NamedTuple, Optional, Tuple

from ...foundation.errors import SyntaxFault
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits
from ...foundation.source_places import Place, place_in_line
from ..terms.list_terms import make_list
from ..terms.types import String, Term, atom
from . import literals

NAME, QUOTED, NUMBER, VARIABLE, TEXT, END = "name", "quoted", "number", "variable", "text", "end"
"""Kinds of tokens. Brackets, commas and bars are kinds of their own, named by their character."""
OPEN_CT = "f("
"""Kind of an opening bracket directly after a token (*open ct* in ISO 13211-1): after a name, it begins the arguments
of a compound term."""

AnyToken = Tuple[str, Any, int, int]
"""Kind, value, start and end; the kind of a bracket, comma or bar is the character itself."""


class ReadFlags(NamedTuple):
    """Flags that change how text is read.

    Attributes:
        double_quotes: type of ``"text"``: ``string`` (as SWI-Prolog 9), ``codes``, ``chars`` or ``atom``.
        back_quotes: type of back-quoted text: the same values.
        iso: priorities of ISO 13211-1: arguments at most 999, operators as operands in brackets, no special floats.
        event_text: the syntax of events on String topics: ``inf``, ``nan`` and ``-inf`` are floats wherever they are
            arguments, ``"text"`` is the atom ``'"text"'`` unless `double_quotes` is ``atom``, and ``True`` and
            ``False`` are ``true`` and ``false``.
        is_constructed: whether the term is constructed and not matched: unnamed message slots have default values.
        multiline: quoted text may continue on the next line.
    """

    double_quotes: str = "string"
    back_quotes: str = "codes"
    iso: bool = False
    event_text: bool = False
    is_constructed: bool = False
    multiline: bool = False


class Source:
    """A text with a name, and the places in it.

    Args:
        name: the name in error messages.
        first_line: number of the first line, if the text is a part of a longer one.
    """

    __slots__ = ("name", "text", "first_line", "_starts")

    def __init__(self, name: str, text: str, first_line: int = 1):
        self.name = name
        self.text = text
        self.first_line = first_line
        self._starts: Optional[List[int]] = None

    def place(self, offset: int) -> Place:
        """Return the place of the character at ``offset``."""
        text = self.text
        starts = self._starts
        # The index of line starts is built at the first error or place; most texts never need it.
        if starts is None:
            starts = self._starts = [0]
            line_start = text.find("\n") + 1
            while line_start:
                starts.append(line_start)
                line_start = text.find("\n", line_start) + 1
        line = bisect_right(starts, offset)
        return place_in_line(self.name, line + self.first_line - 1, text, starts[line - 1], offset)

    def fault(self, message: str, offset: int) -> SyntaxFault:
        """Return the error about the character at ``offset``."""
        return SyntaxFault(message, self.place(min(offset, len(self.text))))


TOKEN_PATTERNS: Dict[str, str] = {
    "LAYOUT": r"[\s\ufeff]+",
    "LINE_COMMENT": r"%[^\n]*",
    "BLOCK_COMMENT": r"/\*[\s\S]*?\*/",
    # A comment that is never closed reaches to the end of the text.
    "BAD_COMMENT": r"/\*[\s\S]*",
    # The full stop: only before layout, a comment or the end.
    "END": r"\.(?=[\s%]|\Z)",
    # A word is an atom or, by its first character, a variable.
    "WORD": r"[^\W\d]\w*",
    # Groups of digits may be separated by "_". SWI-Prolog's blank between groups is not accepted, because it
    # would turn a forgotten comma, [1 2], into [12].
    "NUMBER": "|".join(
        (
            # character code, radix, hexadecimal, octal, binary, float, integer
            r"0'(?:\\x[0-9a-fA-F]+\\?|\\[0-7]+\\?|\\u[0-9a-fA-F]{4}|\\U[0-9a-fA-F]{8}|\\[^\n]|''|[^\\\n])",
            r"[0-9]+'[0-9a-zA-Z]+",
            r"0x[0-9a-fA-F]+(?:_[0-9a-fA-F]+)*",
            r"0o[0-7]+(?:_[0-7]+)*",
            r"0b[01]+(?:_[01]+)*",
            r"[0-9]+\.[0-9]+(?:[eE][+-]?[0-9]+|Inf|NaN)?",
            r"[0-9]+[eE][+-]?[0-9]+",
            r"[0-9]+(?:_\s*[0-9]+)*",
        )
    ),
    # Atoms, strings and back-quoted text without escapes and doubled quotes. Others begin with QUOTE, and
    # `literals` finds their end: a regular expression takes a kilobyte of memory for every escape.
    "QUOTED": r"""'[^'\\\n]*'(?!')|"[^"\\\n]*"(?!")|`[^`\\\n]*`(?!`)""",
    "QUOTE": r"""['"`]""",
    "SYMBOL": r"[-+*/\\^<>=~:.?@#&$]+",
    "SOLO": r"[!;]",
    "PUNCTUATION": r"[()\[\]{},|]",
    "BAD_CHAR": r"[\s\S]",
}
"""Patterns of tokens, in the order in which they are tried; at every offset, a pattern matches.

The first pattern that matches is the token, not the longest. The BAD_... patterns match text that is not a token, so
that the reader can report it and continue. No pattern can match the same characters in two ways, so text that does
not match takes no longer than text that does.
"""


_CHECK_MASK = len(STEPS_PER_ROUND) // 16 - 1
"""Bit mask of token counts at which the goal's limits are checked; a token takes as long as some 16 inferences."""

_match: Optional[Callable[[str, int], Optional[Match[str]]]] = None


def _matcher() -> Callable[[str, int], Any]:
    """Return the function that matches the token at an offset; it is compiled at first use, which takes 5 ms."""
    global _match
    if _match is None:
        groups = (f"(?P<{name}>{pattern})" for name, pattern in TOKEN_PATTERNS.items())
        _match = re.compile("|".join(groups)).match
    return _match


_LAYOUT = frozenset(("LAYOUT", "LINE_COMMENT", "BLOCK_COMMENT"))


def tokenize(source: Source, flags: Callable[[], ReadFlags], start: int = 0) -> Iterator[AnyToken]:
    """Yield the tokens of a text from ``start`` on. Invalid text is yielded as ``("bad", message, start, end)``.

    Args:
        source: the text.
        flags: called for each token, because a program may change its flags between clauses.
        start: the first offset.
    """
    text = source.text
    match = _matcher()
    size = len(text)
    count = 0
    previous_end = -1
    while start < size:
        count += 1
        if not count & _CHECK_MASK:
            check_limits()
        token_match = match(text, start)
        token_kind = token_match.lastgroup
        end = token_match.end()
        if token_kind in _LAYOUT:
            start = end
            continue
        if token_kind == "PUNCTUATION":
            char = text[start]
            # `f(` is a compound term, `f (` is not: the position decides, not the kind of the token before.
            yield (OPEN_CT if char == "(" and start == previous_end else char), None, start, end
        elif token_kind == "WORD":
            name = text[start:end]
            first = name[0]
            # Title-case letters (category Lt) count as capitals, as in SWI-Prolog.
            is_variable = first == "_" or first.isupper() or first.istitle()
            yield VARIABLE if is_variable else NAME, name, start, end
        elif token_kind == "SYMBOL" or token_kind == "SOLO":
            yield NAME, text[start:end], start, end
        elif token_kind == "END":
            yield END, None, start, end
        elif token_kind == "QUOTE":
            end = literals.quote_end(text, start, flags().multiline)
            if end is None:
                end = literals.unclosed_quote_end(text, start)
                yield "bad", unclosed_quote_message(text[start], start, text), start, end
            else:
                yield _quoted_token(text[start:end], start, end, flags())
        else:
            yield _token_with_value(token_kind, text[start:end], start, end, text, flags())
        previous_end = start = end


def comment_spans(text: str, start: int, end: int) -> Iterator[Tuple[int, int]]:
    """Yield start and end of each comment between two tokens.

    Args:
        text: the text.
        start: end of the first token, or the start of the text.
        end: start of the second token, or the end of the text; there is only layout and comments before it.
    """
    match = _matcher()
    while start < end:
        token_match = match(text, start)
        if token_match.lastgroup != "LAYOUT":
            yield start, token_match.end()
        start = token_match.end()


def _token_with_value(
    token_kind: str, token_text: str, start: int, end: int, text: str, flags: ReadFlags
) -> AnyToken:
    """Return the token of a number or of quoted text without escapes, or of text that is no token."""
    if token_kind == "NUMBER":
        return _number_token(token_text, start, end, text, flags)
    if token_kind == "QUOTED":
        return _quoted_token(token_text, start, end, flags)
    if token_kind == "BAD_COMMENT":
        return "bad", 'this comment is never closed: expected "*/"', start, end
    if unicodedata.category(token_text)[0] == "S":
        return NAME, token_text, start, end
    return "bad", _stray_character_message(token_text), start, end


def unclosed_quote_message(quote: str, start: int, text: str) -> str:
    """Return the error message for an unclosed quote at an offset."""
    message = f"this quote {quote} is not closed on its line"
    if quote == "'" and text[start - 1 : start].isalnum():
        message += "; a name with an apostrophe must be quoted, as in 'it''s'"
    return message


_TYPOGRAPHIC_QUOTES = {"\u2018": "'", "\u2019": "'", "\u201a": "'", "\u201b": "'", "\u00b4": "'"}
"""Typographic quotes, and the ASCII quotes to write instead."""
_TYPOGRAPHIC_QUOTES.update(
    {"\u201c": '"', "\u201d": '"', "\u201e": '"', "\u201f": '"', "\u00ab": '"', "\u00bb": '"'}
)


def _stray_character_message(char: str) -> str:
    straight = _TYPOGRAPHIC_QUOTES.get(char)
    if straight is not None:
        return (
            f"{char} is a typographic quote, as produced by word processors and web pages: write {straight}"
        )
    name = unicodedata.name(char, f"U+{ord(char):04X}")
    return f"the character {char!r} ({name}) is allowed only in quotes or comments"


def _number_token(token_text: str, start: int, end: int, text: str, flags: ReadFlags) -> AnyToken:
    # The number pattern stops at the first character that does not belong to it. `12abc` is an error, not two tokens.
    next_char = text[end : end + 1]
    if next_char == "_" or next_char.isalnum():
        return (
            "bad",
            f"{token_text}{next_char}... is not a number, and a name cannot start with a digit",
            start,
            end,
        )
    try:
        return NUMBER, _number_value(token_text, flags), start, end
    except ValueError as error:
        return "bad", str(error), start, end


def _number_value(text: str, flags: ReadFlags) -> Term:
    """Return the number that a token denotes.

    Raises:
        ValueError: if it is no number.
    """
    if text.isdigit():
        return literals.integer(text)
    second = text[1]
    if flags.iso and (text == "0''" or (second == "'" and text[0] != "0")):
        raise ValueError(f"{text} is not a number in ISO Prolog")
    if second == "'" and text[0] == "0":
        char = "'" if text == "0'''" else literals.unquote(text[2:], "", flags.iso)
        if not char:
            raise ValueError(f"{text} is not a character")
        return ord(char[0])
    if second in "xob" or "'" in text:
        try:
            return literals.radix_integer(text)
        except ValueError:
            raise ValueError(f"{text} is not a number: expected digits in a radix from 2 to 36") from None
    if "." in text or "e" in text or "E" in text:
        if flags.iso and ("." not in text or text[-1] in "fN"):
            raise ValueError(f"{text} is not a number in ISO Prolog: expected digits, a point and digits")
        try:
            return literals.float_value(text)
        except ValueError:
            raise ValueError(f"{text} is too large for a float (the largest is 1.8e308)") from None
    return literals.integer("".join(part.strip() for part in text.split("_")))


def _quoted_token(token_text: str, start: int, end: int, flags: ReadFlags) -> AnyToken:
    quote = token_text[0]
    body = token_text[1:-1]
    if "\\" in body or quote in body:
        try:
            body = literals.unquote(body, quote, flags.iso)
        except ValueError as error:
            message, offset = error.args
            return "bad", message, start + 1 + offset, end
    if quote == "'":
        return QUOTED, body, start, end
    if quote == '"':
        if flags.event_text:
            return QUOTED, body if flags.double_quotes == "atom" else f'"{body}"', start, end
        return TEXT, _text_term(body, flags.double_quotes), start, end
    return TEXT, _text_term(body, flags.back_quotes), start, end


def _text_term(body: str, form: str) -> Term:
    if form == "codes":
        return make_list([ord(char) for char in body])
    if form == "chars":
        return make_list([atom(char) for char in body])
    return atom(body) if form == "atom" else String(body)


_TOKEN_DESCRIPTIONS: Dict[str, str] = {
    OPEN_CT: '"("',
    END: "the end of the clause",
    "eof": "the end of the text",
}


def token_description(token: AnyToken, text: str) -> str:
    """Return a token as error messages show it."""
    name = _TOKEN_DESCRIPTIONS.get(token[0])
    if name is None:
        name = text[token[2] : token[3]]
        name = f'"{name[:40]}..."' if len(name) > 45 else f'"{name}"'
    return name
