"""Errors of the package: one root, and a place in a text for every error that is about a text."""

import json
import re
from typing import Iterable, List, NamedTuple, Optional

SHOWN = 200
"""Characters of a text from outside that are kept and shown."""


MAX_MESSAGE_CHARACTERS = 4000
"""Characters that the message of an error may have."""


def beginning(text: str, most: int = SHOWN) -> str:
    """Return a text as it is kept and shown: its beginning where it is long."""
    return text if len(text) <= most else f"{text[:most]}..."


_ACTED_ON = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ufffe\uffff\ud800-\udfff\U000e0000-\U000e007f]|(?<![^\x00-\x7f])[\u200c\u200d]"
)
"""Characters that forge what is displayed: C0 but newline and tab, DEL, C1, marks of direction, characters without a
width, halves of surrogate pairs, and what XML 1.0 does not have. Joiners (U+200C, U+200D) belong to words and emoji,
so they are let through behind a character that is not ASCII."""


def printable(text: str) -> str:
    r"""Return a text with escapes in place of what a terminal, a log or XML would act on, or has no way to show.

    It is for each place where a text leaves the program for somebody to read. Newlines and tabs stay.

    >>> print(printable("\x1b[31m alarm \u202e"))
    \x1b[31m alarm \u202e
    """
    if text.isascii() and text.isprintable():
        return text
    return _ACTED_ON.sub(lambda found: ascii(found[0])[1:-1], text)


def printable_json(data: object) -> str:
    """Return data as JSON for a page that shows it, all its texts `printable`."""
    return json.dumps(_printable_parts(data))


def _printable_parts(data: object) -> object:
    if isinstance(data, str):
        return printable(data)
    if isinstance(data, dict):
        return {_printable_parts(key): _printable_parts(value) for key, value in data.items()}
    return [_printable_parts(item) for item in data] if isinstance(data, (list, tuple)) else data


class Place(NamedTuple):
    """A position in a text; line and column count from 1.

    ``text`` is the line itself, so that the error can be shown without reading the source again; of a long one the
    part around the column, which begins ``before`` characters after the start of the line.

    >>> try:
    ...     Engine().query("X = (a b)")
    ... except SyntaxFault as error:
    ...     print(isinstance(error.place, Place), error.place)
    True query:1:8
    """

    source: str
    line: int
    column: int
    text: str = ""
    before: int = 0

    def __str__(self) -> str:
        return f"{self.source}:{self.line}:{self.column}"

    @property
    def character(self) -> str:
        """What stands there; nothing at the end of a line.

        >>> Place("mine", 1, 3, "a $ b").character
        '$'
        """
        at = self.column - 1 - self.before
        return self.text[at : at + 1]

    def context(self) -> str:
        """Return the source line and, under it, a caret at the column.

        >>> print(Place("mine", 1, 3, "a $ b").context())
        a $ b
          ^
        """
        at = self.column - 1 - self.before
        lead = "".join("\t" if char == "\t" else " " for char in self.text[:at])
        return f"{self.text}\n{lead}^"


def place_on(source: str, line: int, text: str, start: int, offset: int) -> Place:
    """Return the place of the character at ``offset`` of a text, on a line that begins at ``start``."""
    end = text.find("\n", offset, offset + SHOWN)
    if end < 0:
        end = min(len(text), offset + SHOWN)
    before = max(0, min(offset - SHOWN // 2, end - SHOWN) - start)
    shown = text[start + before : min(end, start + before + SHOWN)]
    return Place(source, line, offset - start + 1, shown, before)


def place_in(source: str, number: int, column: int, line: str) -> Place:
    """Return the place at a column of a line."""
    return place_on(source, number, line, 0, column - 1)


def place_at(source: str, text: str, offset: int) -> Place:
    """Return the place of the character at ``offset`` of ``text``."""
    start = text.rfind("\n", 0, offset) + 1
    return place_on(source, text.count("\n", 0, start) + 1, text, start, offset)


def shortened(text: str) -> str:
    """Return a text from outside as an error shows it: quoted, in ASCII, its first characters."""
    return ascii(text) if len(text) <= SHOWN else f"{ascii(text[:SHOWN])}... ({len(text)} characters)"


def counted(number: int, one: str, many: str = "") -> str:
    """Return a number of things in words: ``1 slot``, ``2 slots``; ``many`` where it is not ``one`` and an s."""
    return f"{number} {one if number == 1 else many or f'{one}s'}"


def undecodable(error: UnicodeDecodeError) -> str:
    """Return what is wrong with a text that is not UTF-8, and where."""
    line = error.object.count(b"\n", 0, error.start) + 1
    return f"not UTF-8 text (line {line}: {error.reason} 0x{error.object[error.start]:02x})"


class RetalisError(Exception):
    """Root of all errors that this package raises on purpose.

    >>> try:
    ...     Engine().query("X = [1, 2")
    ... except RetalisError as error:
    ...     print(error.place.line, error.place.column)
    1 10

    Attributes:
        message: what is wrong and what was expected, in one sentence.
        place: where in a text, or None.
    """

    def __init__(self, message: str, place: Optional[Place] = None):
        message = beginning(message, MAX_MESSAGE_CHARACTERS)
        super().__init__(message)
        self.message = message
        self.place = place

    def __str__(self) -> str:
        if self.place is None:
            return printable(self.message)
        return printable(f"{self.place}: {self.message}\n{self.place.context()}")

    def brief(self) -> str:
        """Return the error in one line: message, line and column.

        >>> RetalisError("there is no such room", Place("mine", 1, 3, "a $ b")).brief()
        'there is no such room (line 1, column 3)'
        """
        if self.place is None:
            return printable(self.message)
        return printable(f"{self.message} (line {self.place.line}, column {self.place.column})")


class SyntaxFault(RetalisError):
    """A text that does not read as a term.

    >>> try:
    ...     Engine().query("smoke(kitchen")
    ... except SyntaxFault as error:
    ...     print(error.brief())
    expected ")" for the "(" in line 1, column 6 before the end of the text (line 1, column 14)
    """


class RuleError(RetalisError):
    """A rule, clause or directive that reads well and cannot be accepted.

    >>> try:
    ...     Engine().load(rules="alarm <- 7.")
    ... except ProgramErrors as errors:
    ...     print(type(errors.errors[0]) is RuleError)
    True
    """


class Omission(RetalisError):
    """What a Prolog file was loaded without: a term that does not read, a clause or directive that is wrong.

    >>> found = []
    >>> class Told(Reports):
    ...     def warning(self, problem, kind=None, texts=1, once=False):
    ...         found.append(problem)
    >>> Engine(reports=Told()).load(rules="a(1). a(2. a(3).")
    >>> [(type(problem) is Omission, problem.place.column) for problem in found]
    [(True, 10)]
    """

    def __init__(self, error: RetalisError):
        super().__init__(f"{error.message}; this is left out", error.place)


MAX_ERRORS = 100
"""Errors of a file that are kept and shown."""


class Errors(List[RetalisError]):
    """What is wrong with a file, as it is found: the first errors are kept, the others counted.

    Attributes:
        more: how many were not kept.
    """

    def __init__(self) -> None:
        super().__init__()
        self.more = 0

    def append(self, error: RetalisError) -> None:
        """Take an error."""
        if len(self) < MAX_ERRORS:
            super().append(error)
        else:
            self.more += 1

    def extend(self, errors: Iterable[RetalisError]) -> None:
        """Take errors, and count those that were not kept of them."""
        for error in errors:
            self.append(error)
        self.more += getattr(errors, "more", 0)

    def with_rest(self) -> List[RetalisError]:
        """Return the errors, and as the last one how many more there are."""
        return [*self, RetalisError(f"there are {self.more} more")] if self.more else list(self)


class ProgramErrors(RetalisError):
    """All errors of a file at once; nothing of the file is active.

    Of many the first `MAX_ERRORS` are there, and one that says how many more there are.

    >>> try:
    ...     Engine().load(rules="a <- b. c <- 7. d <- . e <- f.", source="mine")
    ... except ProgramErrors as errors:
    ...     print([error.place.column for error in errors.errors])
    [14, 22]
    """

    def __init__(self, errors: Iterable[RetalisError]):
        found = errors if isinstance(errors, Errors) else Errors()
        if found is not errors:
            found.extend(errors)
        self.errors: List[RetalisError] = found.with_rest()
        super().__init__("")
        self.message = "\n".join(str(error) for error in self.errors)


class MessageError(RetalisError):
    r"""A message, message definition, or term that is to become one, which does not fit its type.

    >>> try:
    ...     Definitions().add("my_robot/Bumper", "bool left\nbool centre of it")
    ... except MessageError as error:
    ...     print(error.brief())
    expected 'type name' or 'type NAME=value', found 'bool centre of it' (line 2, column 1)
    """


class UsageError(RetalisError):
    """A call of the package that asks for what cannot be (an id that is taken, an unknown memory).

    >>> try:
    ...     Engine().event("smoke(kitchen)", 3, 2)
    ... except UsageError as error:
    ...     print(error)
    smoke(kitchen) ends before it starts
    """


class TermTooLarge(RetalisError):
    """A term that contains itself, or is so large that nothing can be done with it in reasonable time."""

    def __init__(self) -> None:
        super().__init__("the term contains itself or is too large")
