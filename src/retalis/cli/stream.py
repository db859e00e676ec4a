"""Streams of terms: events and goals, one after the other, from a file or a pipe."""

import os
import re
import stat
from array import array
from typing import IO, Iterator, NamedTuple, Optional, Sequence, Union

from ..foundation import Place, SyntaxFault, place_in
from ..prolog.syntax import EventReader, Operators, ReadTerm, read_program
from ..prolog.terms import Term


class ReadLine(NamedTuple):
    """A term that was a line of its own, and the place of that."""

    term: Term
    place: Place


Read = Union[ReadTerm, ReadLine, SyntaxFault]

_DIFFERENT = re.compile(r"[\"`]|\b(?:inf|nan|True|False)\b")


def read_stream(file: IO[str], operators: Operators, source: str) -> Iterator[Read]:
    """Yield the terms of a stream as soon as their lines have come, and a `SyntaxFault` for each error."""
    held = ""
    first = 1
    reader = EventReader(operators)
    for line, text in enumerate(file, 1):
        if not held and text.startswith("event("):
            event = _event(reader, text.rstrip(), place_in(source, line, 1, text.rstrip("\n")))
            if event is not None:
                yield event
                first = line + 1
                continue
        held += text
        if "." not in text:
            continue
        found = list(read_program(held, operators, source, first_line=first))
        if not found or not _is_unfinished(found, held, line):
            yield from found
            held, first = "", line + 1
    yield from read_program(held, operators, source, first_line=first)


def _event(reader: EventReader, text: str, place: Place) -> Optional[ReadLine]:
    """Return the event of a line that holds nothing else: the usual case, and much faster than the full reader.

    What event text and a program read differently is left to the full reader.
    """
    if not text.endswith(").") or _DIFFERENT.search(text):
        return None
    try:
        return ReadLine(reader.read(text[:-1]), place)
    except SyntaxFault:  # several terms, or an error: the full reader tells
        return None


def _is_unfinished(found: Sequence[Read], text: str, line: int) -> bool:
    """Tell whether the last clause was cut off by the end of the text, and may go on in the next line."""
    for one in found:
        if isinstance(one, SyntaxFault) and one.message.startswith("this comment is never closed"):
            return True
    last = found[-1]
    if not isinstance(last, SyntaxFault) or last.place is None or text.rstrip().endswith("."):
        return False
    return last.place.line >= line


def is_left_unread(number: int = 0) -> bool:
    """Tell whether there is something to read in a pipe or file, by its number, that nobody has read; never waits."""
    try:
        import fcntl  # noqa: PLC0415 (not every system has them)
        import termios  # noqa: PLC0415
    except ImportError:
        return False
    try:
        mode = os.fstat(number)
        if stat.S_ISREG(mode.st_mode):
            return mode.st_size > os.lseek(number, 0, os.SEEK_CUR)
        if not stat.S_ISFIFO(mode.st_mode):
            return False
        waiting = array("i", [0])
        fcntl.ioctl(number, termios.FIONREAD, waiting)
    except OSError:  # closed
        return False
    return waiting[0] > 0
