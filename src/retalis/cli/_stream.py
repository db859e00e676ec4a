"""Streams of terms: events and goals, one after the other, from a file or a pipe."""

from typing import IO, Iterator, Union

from ..errors import SyntaxFault
from ..syntax import Operators, ReadTerm, read_program

Read = Union[ReadTerm, SyntaxFault]


def read_stream(file: IO[str], operators: Operators, source: str) -> Iterator[Read]:
    """Yield the terms of a stream as soon as their lines have come, and a `SyntaxFault` for each error."""
    held = ""
    first = 1
    for line, text in enumerate(file, 1):
        held += text
        if "." not in text:
            continue
        found = list(read_program(held, operators, source, first_line=first))
        if not found or not _is_unfinished(found[-1], held, line):
            yield from found
            held, first = "", line + 1
    yield from read_program(held, operators, source, first_line=first)


def _is_unfinished(last: Read, text: str, line: int) -> bool:
    """Tell whether the last clause was cut off by the end of the text, and may go on in the next line."""
    if not isinstance(last, SyntaxFault) or last.place is None or text.rstrip().endswith("."):
        return False
    return last.place.line >= line
