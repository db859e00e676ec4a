"""What ROS allows as a name: of packages, types, slots and topics. The doors for names that come from outside."""

import re
from typing import Optional

from .errors import shortened

MAX_NAME_CHARACTERS = 255
"""Characters that a name may have: a type's is also that of a file."""

_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_TYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*")
_TOPIC = re.compile(r"[A-Za-z/~][A-Za-z0-9_/]*")

_STRANGE = re.compile(r"[^A-Za-z0-9_/~]")

_ROS2_TYPE = re.compile(r"([^/]+)/(?:msg|action)/([^/]+)")

_LETTERS = 'ASCII letters, digits and "_", a letter first'


def plain_fault(text: str) -> Optional[str]:
    """Return what is wrong with the name of a package, slot or constant, or None."""
    return _fault(_PLAIN, text, f"a name of {_LETTERS}")


def plain_type(name: str) -> str:
    """Return the name of a message type as ROS 1 writes it: ``pkg/Type`` also for ``pkg/msg/Type``."""
    found = _ROS2_TYPE.fullmatch(name) if name.count("/") == 2 else None
    return f"{found[1]}/{found[2]}" if found else name


def type_fault(text: str) -> Optional[str]:
    """Return what is wrong with the name of a message type, or None."""
    return _fault(_TYPE, text, f'a message type "package/Type", each of {_LETTERS}')


def topic_fault(text: str) -> Optional[str]:
    """Return what is wrong with the name of a topic, which may be relative or private, or None."""
    fault = _fault(_TOPIC, text, 'a topic name of ASCII letters, digits, "_" and "/", no digit first')
    if fault is None and "//" in text:
        return f'expected a topic name, found {shortened(text)}, which has "//" in it'
    return fault


def _fault(form: "re.Pattern[str]", text: str, expected: str) -> Optional[str]:
    problem = f"expected {expected}, found {shortened(text)}"
    if len(text) > MAX_NAME_CHARACTERS:
        return f"{problem}: longer than {MAX_NAME_CHARACTERS} characters"
    if form.fullmatch(text):
        return None
    strange = _STRANGE.search(text)
    return f"{problem}: {ascii(strange.group())} is not allowed in it" if strange else problem
