"""Sections of bytes by name, one after the other, with what tells whether they are whole."""

import json
from typing import Any, Dict, Tuple
from zlib import crc32

from ...events.network import RuleState
from ...foundation import UsageError
from ...prolog.logic import KeptLogic, KeptValues
from .graph import FIELDS

MAGIC = b"retalis state\n"

_LONGEST_HEAD = 16_000_000
"""Bytes of the first lines, at most: there is a name for each memory."""

FORMAT = 6
"""Raised where what is kept is arranged in another way."""


def _layout() -> int:
    """Return a number of what is kept of objects: it is another one where that has changed."""
    kinds = [(name, *fields) for name, (_, fields) in FIELDS.items()]
    kinds += [(kind.__name__, *kind._fields) for kind in (RuleState, KeptLogic, KeptValues)]
    return crc32(repr(kinds).encode())


LAYOUT = _layout()


def pack(sections: Dict[str, bytes]) -> bytes:
    """Return sections as one text of bytes."""
    listed = [[name, len(data), crc32(data)] for name, data in sections.items()]
    head = json.dumps({"format": FORMAT, "layout": LAYOUT, "sections": listed}).encode()
    return b"".join([MAGIC, b"%d\n" % len(head), head, *sections.values()])


def unpack(data: bytes) -> Dict[str, bytes]:
    """Return the sections of a text of bytes.

    Raises:
        UsageError: where it is none, of another version, or damaged.
    """
    head, at = _head(data)
    check_version(head.get("format"), head.get("layout"))
    sections = {}
    for name, length, check in head["sections"]:
        found = sections[name] = data[at : at + length]
        at += length
        if len(found) != length or crc32(found) != check:
            raise UsageError(f"the state is damaged: section {name} is not what it was")
    if at != len(data):
        raise UsageError("the state is damaged: there is more of it than it says")
    return sections


def _head(data: bytes) -> Tuple[Dict[str, Any], int]:
    if not data.startswith(MAGIC):
        raise UsageError("this is no state of an engine")
    end = data.find(b"\n", len(MAGIC), len(MAGIC) + 20)
    try:
        length = int(data[len(MAGIC) : end])
        if not 0 <= length <= _LONGEST_HEAD:
            raise ValueError
        head = json.loads(data[end + 1 : end + 1 + length])
        names = [name for name, length, check in head["sections"] if length >= 0 and check >= 0]
        memories = [name for name in names if name.startswith("memory ")]
        if (
            not all(one.__class__ is int for _, *numbers in head["sections"] for one in numbers)
            or len(set(names)) != len(head["sections"])
            or memories != [f"memory {at}" for at in range(len(memories))]
        ):
            raise ValueError
    except Exception as error:  # of whatever kind: JSON that is deep, or has other types
        raise UsageError("the state is damaged: its first lines do not read") from error
    return head, end + 1 + length


def check_version(form: object, layout: object) -> None:
    """Check that what is kept is arranged as here.

    Raises:
        UsageError: where it is not.
    """
    if form != FORMAT:
        older = form.__class__ is int and form < FORMAT
        why = ", a pickle of an older version of the package, which is never read" if older else ""
        raise UsageError(f"the state is of format {form}{why}: this version reads format {FORMAT}")
    if layout != LAYOUT:
        raise UsageError("the state was kept by another version of the package")
