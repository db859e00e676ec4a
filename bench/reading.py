#!/usr/bin/env python3
"""Measure how fast texts are read, and that the time grows with their length.

Each reader reads texts of 10 KB to 4 MB: such as are usual for it, and such as are meant to take long (nested, with
errors in each line, never closed). A row gives MB/s at each size; a reader that is linear has about the same number
in all columns. "(E)" marks texts that have errors, "-" what took longer than the limit.
"""

import argparse
import signal
import sys
from contextlib import contextmanager
from pathlib import Path
from time import process_time
from typing import Any, Callable, Dict, Iterator, List, Optional, Tuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))

from retalis.events.program.goal_file import read_goals  # noqa: E402
from retalis.events.program.program_folder import _TopicReader  # noqa: E402
from retalis.foundation.errors import RetalisError, SyntaxFault  # noqa: E402
from retalis.messages.type_definition import parse  # noqa: E402
from retalis.prolog.syntax.event_text import EventReader  # noqa: E402
from retalis.prolog.syntax.operators import Operators  # noqa: E402
from retalis.prolog.syntax.term_reader import read_program, read_term  # noqa: E402  # noqa: E402

Shape = Callable[[int], str]
Read = Callable[[str], bool]
"""Reads a text; tells whether it had no errors."""

SIZES = (10_000, 100_000, 1_000_000, 4_000_000)
OPERATORS = Operators.prolog()
POSE = "pose('\"/odom\"',[1413748205,981209993],vector(0.1,-0.2,1.5e-3),quaternion(0.0,0.0,0.0,1.0))"


def many(unit: str, before: str = "", after: str = "", between: str = "") -> Shape:
    """Return texts of as many units as fit."""
    return lambda size: before + between.join([unit] * max(1, size // len(unit + between))) + after


def nested(opened: str, closed: str) -> Shape:
    """Return texts that are nested as deep as fits."""

    def text(size: int) -> str:
        depth = size // len(opened + closed)
        return opened * depth + "a" + closed * depth

    return text


def numbered(unit: str) -> Shape:
    """Return texts of units with a number in each."""
    return lambda size: "".join(unit.format(at) for at in range(size // len(unit)))


TERMS: Dict[str, Shape] = {
    "poses": many(POSE, "event(tf([", "]))", ","),
    "list of integers": many("12345", "f([", "])", ","),
    "list of floats": many("1.2345e-3", "f([", "])", ","),
    "variables": lambda size: "f(" + ",".join(f"Name{at}" for at in range(size // 9)) + ")",
    "long atom": many("a"),
    "long quoted atom": many("a", "'", "'"),
    "escapes": many("\\1\\", "'", "'"),
    "doubled quotes": many("''", "'", "'"),
    "escapes, never closed": many("\\1e", "f('"),
    "quotes, never closed": many("'a\n"),
    "comments": many("/* a */ % b\n", "", "a"),
    "comment, never closed": many("/*", "a "),
    "round brackets": nested("(", ")"),
    "list in list": nested("[", "]"),
    "arguments": nested("f(", ")"),
    "prefix operators": many("- ", "", "a"),
    "infix operators": many("a+b*c-d^e", between=","),
    "brackets, never closed": many("f("),
    "operators in a row": many("a", between=" = "),
    "blanks": many(" ", "f(", "a)"),
    "digits": lambda size: "9" * min(size, 1_000_000),
    "strange characters": many("\x01"),
}
CLAUSES: Dict[str, Shape] = {
    "clauses": numbered("holds(X, {0}, 'a b') :- is_it(X, Y), Y > {0}, \\+ other([X, Y|_]).\n"),
    "event rules": numbered("out{0}(X) <- (a(X, Y) seq b(Y)) within 60 where (X > {0}).\n"),
    "unknown operators": numbered("h{0}(X) <- a(X) folowed b(X).\n"),
    "no full stops": numbered("h{0}(X) <- a(X) seq b(X)\n"),
    "brackets open": numbered("h{0}(X) <- a(X seq b(X)\n"),
    "an error, many on a line": many("a b. "),
    "error in the last line": lambda size: numbered("p({0}).\n")(size) + "p(.\n",
}
GOALS: Dict[str, Shape] = {
    "goals": numbered("memorize(event(X, Y), [X > {0}], format(X), id{0}, 2500)\n"),
    "goals over lines": numbered("memorize(event(X, Y),\n  [X > {0}], format(X),\n  id{0}, 2500).\n"),
    "no goals": lambda size: many("a b\n")(size) + "c.\n",
    "open comments": lambda size: many("/* a\n")(size) + "c.\n",
}
EVENTS: Dict[str, Shape] = {
    name: TERMS[name]
    for name in ("poses", "list of integers", "escapes", "escapes, never closed", "arguments")
}
DEFINITIONS: Dict[str, Shape] = {
    "comments": many("# what it is\n", "", "float64 x\n"),
    "blanks in brackets": many(" ", "int8["),
    "one constant": many("1", "float64 X="),
}
TOPICS: Dict[str, Shape] = {
    "topics": many(
        '<subscribe_to name="t" msg_type="a/B"/>\n', "<publish_subscribe>", "</publish_subscribe>"
    ),
    "one line": many(
        '<subscribe_to name="t" msg_type="a/B"/>', "<publish_subscribe>", "</publish_subscribe>"
    ),
}


def whole(read: Callable[[str], Any]) -> Read:
    """Return what tells whether a text reads."""

    def reads(text: str) -> bool:
        try:
            read(text)
        except RetalisError:
            return False
        return True

    return reads


def each(read: Callable[[str], Iterator[Any]]) -> Read:
    """Return what tells whether all of a text reads."""
    return lambda text: sum(isinstance(one, SyntaxFault) for one in read(text)) == 0


def again(text: str) -> bool:
    """Read the poses of an event one by one, as they come on a topic."""
    reader = EventReader()
    event = f"event({POSE})"
    for _ in range(len(text) // len(event)):
        reader.read(event)
    return True


READERS: Dict[str, Tuple[Read, Dict[str, Shape]]] = {
    "terms": (whole(lambda text: read_term(text, OPERATORS)), TERMS),
    "rule files": (each(lambda text: iter(read_program(text, OPERATORS))), CLAUSES),
    "goal files": (each(lambda text: read_goals(text, OPERATORS, "goals")), GOALS),
    "event text": (whole(lambda text: EventReader().read(text)), EVENTS),
    "events of one shape": (again, {"poses": TERMS["poses"]}),
    "message definitions": (whole(lambda text: parse("a/B", text, _nothing)), DEFINITIONS),
    "pub_sub.xml": (whole(lambda text: _TopicReader("topics", text).read()), TOPICS),
}


def _nothing(kind: str, package: str) -> Any:
    raise AssertionError(kind)


class Late(Exception):
    """The limit has passed."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise `Late` past some seconds of the processor's time."""

    def late(number: int, frame: Any) -> None:
        raise Late

    signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def speed(read: Read, text: str, limit: float) -> Optional[Tuple[float, bool]]:
    """Return MB/s and whether the text reads; None where it takes longer than the limit."""
    try:
        with at_most(limit):
            start = process_time()
            reads = read(text)
            return len(text) / max(process_time() - start, 1e-6) / 1e6, reads
    except Late:
        return None


def row(read: Read, shape: Shape, sizes: List[int], limit: float) -> Iterator[str]:
    """Yield the columns of one shape."""
    for size in sizes:
        found = speed(read, shape(size), limit)
        if found is None:
            yield "-"
            return
        shown = f"{found[0]:.2f}" if found[0] < 100 else "> 100"
        yield shown if found[1] else f"{shown} (E)"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("readers", nargs="*", help=f"which readers; all by default: {', '.join(READERS)}")
    parser.add_argument("--largest", type=int, default=SIZES[-1], help="characters of the longest text")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds that one text may take")
    options = parser.parse_args()
    sizes = [size for size in SIZES if size <= options.largest]
    unknown = set(options.readers) - set(READERS)
    if unknown:
        parser.error(f"there is no reader {', '.join(sorted(unknown))}; there are {', '.join(READERS)}")
    EventReader().read("a")  # the grammar is read once
    print("| reader | text | " + " | ".join(f"{size // 1000} KB" for size in sizes) + " |")
    print("| --- | --- |" + " ---: |" * len(sizes))
    for name in options.readers or READERS:
        read, shapes = READERS[name]
        for text, shape in shapes.items():
            print(f"| {name} | {text} | {' | '.join(row(read, shape, sizes, options.limit))} |", flush=True)


if __name__ == "__main__":
    main()
