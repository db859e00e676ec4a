"""Exceptions of the package, positions in source texts, and safe display of external text.

All exceptions derive from `RetalisError`. Errors about a text have a `Place`, which includes the source line, so that
they can be shown with a caret after the source is gone. Texts from outside are shortened and escaped before display.
"""

import json
import os
import re
import sys
from typing import Callable, Hashable, Iterable, List, NamedTuple, Optional, Union

MAX_SHOWN_CHARACTERS = 200
"""Maximum number of characters of an external text that are stored and displayed."""


MAX_MESSAGE_CHARACTERS = 4000
"""Maximum length of an error message."""


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


class Place(NamedTuple):
    """A position in a text; line and column count from 1.

    ``text`` is the line itself, so that the error can be shown without reading the source again. Of a long line, it
    is the part around the column, which begins ``before`` characters after the start of the line.

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
        """The character at the position; empty at the end of a line.

        >>> Place("mine", 1, 3, "a $ b").character
        '$'
        """
        index = self.column - 1 - self.before
        return self.text[index : index + 1]

    def context(self) -> str:
        """Return the source line and, under it, a caret at the column.

        >>> print(Place("mine", 1, 3, "a $ b").context())
        a $ b
          ^
        """
        index = self.column - 1 - self.before
        # Tabs are repeated, so that the caret is in the right column at any tab width.
        lead = "".join("\t" if char == "\t" else " " for char in self.text[:index])
        return f"{self.text}\n{lead}^"


def line_of(place: object) -> str:
    """Return file and line of a position or of its text ``FILE:LINE:COLUMN``; "" if there is none."""
    return str(place or "").rpartition(":")[0]


def place_in_line(source: str, line_number: int, text: str, start: int, offset: int) -> Place:
    """Return the place of the character at ``offset`` of a text, in the line that begins at ``start``."""
    end = text.find("\n", offset, offset + MAX_SHOWN_CHARACTERS)
    if end < 0:
        end = min(len(text), offset + MAX_SHOWN_CHARACTERS)
    # Only a part of at most `MAX_SHOWN_CHARACTERS` around the offset is copied: a line may be as long as the file.
    before = max(0, min(offset - MAX_SHOWN_CHARACTERS // 2, end - MAX_SHOWN_CHARACTERS) - start)
    shown = text[start + before : min(end, start + before + MAX_SHOWN_CHARACTERS)]
    return Place(source, line_number, offset - start + 1, shown, before)


def place_at_column(source: str, line_number: int, column: int, line: str) -> Place:
    """Return the place at a column of a line."""
    return place_in_line(source, line_number, line, 0, column - 1)


def place_at_offset(source: str, text: str, offset: int) -> Place:
    """Return the place of the character at ``offset`` of ``text``."""
    start = text.rfind("\n", 0, offset) + 1
    return place_in_line(source, text.count("\n", 0, start) + 1, text, start, offset)


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


def install_hint(package: str, debian_package: str) -> str:
    """Return the command that installs an optional Python package: apt's if Python is Debian's, otherwise pip's.

    Debian's Python refuses pip, and has a folder ``dist-packages`` that no other Python has.
    """
    is_debian_python = sys.prefix == "/usr" and any("dist-packages" in folder for folder in sys.path)
    return f"apt install {debian_package}" if is_debian_python else f"pip install {package}"


def describe_decode_error(error: UnicodeDecodeError) -> str:
    """Return an error text for bytes that are not text in an encoding, with line and byte."""
    line = error.object.count(b"\n", 0, error.start) + 1
    return (
        f"not {error.encoding.upper()} text (line {line}: {error.reason} 0x{error.object[error.start]:02x})"
    )


def suggest_file(path: Union[str, "os.PathLike[str]"]) -> str:
    """Return "did you mean ...?" with a file whose name differs in capitals or separators only, or ""."""
    folder, name = os.path.split(os.fspath(path))
    try:
        # No search for the most similar name: a goal may try to open the file again and again.
        similar = [other for other in os.listdir(folder or os.curdir) if _simplify(other) == _simplify(name)]
    except OSError:
        return ""
    return f"did you mean {printable(min(similar))}?" if similar else ""


def _simplify(file_name: str) -> str:
    return file_name.lower().replace("_", "").replace("-", "")


class RetalisError(Exception):
    """Base class of all errors that this package raises on purpose.

    >>> try:
    ...     Engine().query("X = [1, 2")
    ... except RetalisError as error:
    ...     print(error.place.line, error.place.column)
    1 10

    Attributes:
        message: what is wrong and what was expected, in one sentence.
        place: position in a source text, or None.
        code: stable code of a finding in a program, as ``RT1203``, or "".
        exit_status: exit status of a command that fails with this error.
    """

    code = ""
    exit_status = 1

    def __init__(self, message: str, place: Optional[Place] = None):
        # Messages can quote terms of any size, and reports keep them in memory.
        message = shorten(message, MAX_MESSAGE_CHARACTERS)
        super().__init__(message)
        self.message = message
        self.place = place

    def __str__(self) -> str:
        message = f"{self.message} [{self.code}]" if self.code else self.message
        if self.place is None:
            return printable(message)
        return printable(f"{self.place}: {message}\n{self.place.context()}")

    def brief(self) -> str:
        """Return the error in one line: message, line and column.

        >>> RetalisError("there is no such room", Place("mine", 1, 3, "a $ b")).brief()
        'there is no such room (line 1, column 3)'
        """
        if self.place is None:
            return printable(self.message)
        return printable(f"{self.message} (line {self.place.line}, column {self.place.column})")


class SyntaxFault(RetalisError):
    """A syntax error in a term.

    >>> try:
    ...     Engine().query("smoke(kitchen")
    ... except SyntaxFault as error:
    ...     print(error.brief())
    expected ")" for the "(" in line 1, column 6 before the end of the text (line 1, column 14)
    """


class RuleError(RetalisError):
    """A rule, clause or directive that is syntactically correct but not allowed.

    >>> try:
    ...     Engine().load(rules="alarm <- 7.")
    ... except ProgramErrors as errors:
    ...     print(type(errors.errors[0]) is RuleError)
    True
    """


class UnknownMessage(SyntaxFault):
    """A message with named slots whose name is no message type, and no event of a topic."""


class UndefinedPredicate(RuleError):
    """A warning about a call of a predicate that has no definition yet; another file may define it.

    Attributes:
        call: the call.
    """

    def __init__(self, message: str, place: Optional[Place], call: object):
        super().__init__(message, place)
        self.call = call


class RecurringWarning(RuleError):
    """A warning about something that recurs, at its 1st, 2nd, 4th, 8th, ... occurrence.

    Attributes:
        category: identity of what recurs.
        count_occurrences: returns the number of its occurrences so far.
    """

    def __init__(
        self, message: str, place: Optional[Place], category: Hashable, count_occurrences: Callable[[], int]
    ):
        super().__init__(message, place)
        self.category = category
        self.count_occurrences = count_occurrences


class Omission(RetalisError):
    """A warning about a term, clause or directive of a Prolog file that was skipped because of an error.

    >>> warnings = []
    >>> class WarningCollector(Reports):
    ...     def warning(self, problem, kind=None, texts=1, once=False):
    ...         warnings.append(problem)
    >>> Engine(reports=WarningCollector()).load(rules="a(1). a(2. a(3).")
    >>> [(type(problem) is Omission, problem.place.column) for problem in warnings]
    [(True, 10)]
    """

    def __init__(self, error: RetalisError):
        super().__init__(f"{error.message}; this is left out", error.place)


MAX_ERRORS = 100
"""Maximum number of errors of a file that are stored and shown."""


class Errors(List[RetalisError]):
    """Errors of a file: a list of the first `MAX_ERRORS` errors, and the number of further ones.

    Attributes:
        omitted_count: number of errors that were not stored.
    """

    def __init__(self) -> None:
        super().__init__()
        self.omitted_count = 0

    def append(self, error: RetalisError) -> None:
        """Add an error, or count it if the list is full."""
        if len(self) < MAX_ERRORS:
            super().append(error)
        else:
            self.omitted_count += 1

    def extend(self, errors: Iterable[RetalisError]) -> None:
        """Add errors, including the number of those that were not stored in ``errors``."""
        for error in errors:
            self.append(error)
        # Errors that the other list counted but did not store.
        self.omitted_count += getattr(errors, "omitted_count", 0)

    def with_omitted_count(self) -> List[RetalisError]:
        """Return the errors, followed by one that states the number of further errors if there are any."""
        return (
            [*self, RetalisError(f"there are {self.omitted_count} more")]
            if self.omitted_count
            else list(self)
        )


class ProgramErrors(RetalisError):
    """All errors of a file. No rule of the file is active; of a goal file, the other goals have been called.

    If there are more than `MAX_ERRORS`, the last entry states the number of further errors.

    >>> try:
    ...     Engine().load(rules="a <- b. c <- 7. d <- . e <- f.", source="mine")
    ... except ProgramErrors as errors:
    ...     print([error.place.column for error in errors.errors])
    [14, 22]
    """

    def __init__(self, errors: Iterable[RetalisError]):
        collected = errors if isinstance(errors, Errors) else Errors()
        if collected is not errors:
            collected.extend(errors)
        self.errors: List[RetalisError] = collected.with_omitted_count()
        super().__init__("")
        self.message = "\n".join(str(error) for error in self.errors)


class MessageError(RetalisError):
    r"""A message or message definition that is invalid, or a term that does not fit a message type.

    >>> try:
    ...     Definitions().add("my_robot/Bumper", "bool left\nbool centre of it")
    ... except MessageError as error:
    ...     print(error.brief())
    expected 'type name' or 'type NAME=value', found 'bool centre of it' (line 2, column 1)
    """


class UsageError(RetalisError):
    """An invalid call of the package, for example with a duplicate id or an unknown memory.

    >>> try:
    ...     Engine().event("smoke(kitchen)", 3, 2)
    ... except UsageError as error:
    ...     print(error)
    smoke(kitchen) ends before it starts
    """


class TermTooLarge(RetalisError):
    """A cyclic term, or a term that is too large to be processed in reasonable time."""

    def __init__(self) -> None:
        super().__init__("the term contains itself or is too large")
