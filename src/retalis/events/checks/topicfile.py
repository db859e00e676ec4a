"""What ``pub_sub.xml`` says that nobody reads: unknown tags and attributes, types that are nowhere, a topic twice."""

from pathlib import Path
from typing import Dict, Iterator, List, NamedTuple, Optional, Tuple
from xml.parsers import expat

from ...foundation import Place, RuleError, UsageError, beginning, place_in, printable
from ...prolog.terms import deref
from ..program import ATTRIBUTES, TOPICS, read_text
from .made import SUBSCRIBE_TO
from .near import meant
from .outputs import plain
from .overview import Overview

_ROOT = "publish_subscribe"


class Element(NamedTuple):
    """An element of the file, and where it stands."""

    tag: str
    attributes: Dict[str, str]
    place: Place


def elements(path: Path) -> List[Element]:
    """Return the elements of a file that has been read without errors; none where it cannot be read."""
    found: List[Element] = []
    try:
        text = read_text(path)
    except UsageError:
        return found
    lines = text.splitlines()
    parser = expat.ParserCreate()

    def element(tag: str, attributes: Dict[str, str]) -> None:
        number = parser.CurrentLineNumber
        line = lines[number - 1] if number <= len(lines) else ""
        found.append(
            Element(tag, attributes, place_in(str(path), number, parser.CurrentColumnNumber + 1, line))
        )

    parser.StartElementHandler = element
    try:
        parser.Parse(text, True)
    except expat.ExpatError:  # said when it was read
        return []
    return found


def topics(program: Overview) -> Iterator[RuleError]:
    """Yield what is hardly meant in the file, and which types goals misspell."""
    yield from _asked(program)
    if program.folder is None:
        return
    seen: Dict[Tuple[str, str], Element] = {}
    for one in elements(program.folder / TOPICS):
        known = ATTRIBUTES.get(one.tag)
        if known is None:
            if one.attributes and one.tag != _ROOT:
                tag = printable(beginning(one.tag))
                yield RuleError(
                    f"<{tag}> is not known: what it says is not read{meant(one.tag, ATTRIBUTES, 0.5)}",
                    one.place,
                )
            continue
        for name in one.attributes:
            if name not in known:
                text = printable(beginning(name))
                hint = meant(name, known) or f"; it has {', '.join(known)}"
                yield RuleError(f"<{one.tag}> has no attribute {text}{hint}", one.place)
        topic, kind = (one.attributes.get(name, "").strip() for name in ("name", "msg_type"))
        before = seen.setdefault((one.tag, plain(topic)), one)
        if before is not one:
            yield RuleError(_twice(one, before, topic, kind), one.place)
        yield from _misspelt(program, kind, one.place)


def _asked(program: Overview) -> Iterator[RuleError]:
    for inner in program.calls():
        if inner.key in SUBSCRIBE_TO:
            yield from _misspelt(program, getattr(deref(inner.term[2]), "name", ""), inner.place)


def _misspelt(program: Overview, kind: str, place: Optional[Place]) -> Iterator[RuleError]:
    found = program.definitions.misspelt(kind)
    if found:
        yield RuleError(f"there is no message type {kind}; did you mean {found}?", place)


def _twice(one: Element, before: Element, topic: str, kind: str) -> str:
    done = "subscribed" if one.tag == "subscribe_to" else "published"
    other = before.attributes.get("msg_type", "").strip()
    types = "" if other == kind else f", as {other}"
    return f"topic {topic} is {done} already in line {before.place.line}{types}: take one of them out"
