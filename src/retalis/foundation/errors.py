"""Exceptions of the package, and hints in their texts.

All exceptions derive from `RetalisError`. Errors about a text have a `Place`, and can be shown with a caret after the
source is gone. Texts from outside are shortened and escaped before display.
"""

import os
import sys
from typing import Callable, Hashable, Iterable, List, Optional, Union

from .displayed_text import printable, shorten
from .source_places import Place

MAX_MESSAGE_CHARACTERS = 4000
"""Maximum length of an error message."""


def install_hint(package: str, debian_package: str) -> str:
    """Return the command that installs an optional Python package: apt's if Python is Debian's, otherwise pip's.

    Debian's Python refuses pip, and has a folder ``dist-packages`` that no other Python has.
    """
    is_debian_python = sys.prefix == "/usr" and any("dist-packages" in folder for folder in sys.path)
    return f"apt install {debian_package}" if is_debian_python else f"pip install {package}"


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
    """A warning about a call of a predicate that has no definition yet; another file may define it."""

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
