"""Validation of ROS names: packages, message types, slots, and topics.

Names from outside (command line, rosbags, connection headers) are validated here before they are used in paths, event
names or requests. Each function returns an error text, or None for a valid name.
"""

import re
from typing import Optional

from .displayed_text import quote_shortened

MAX_NAME_CHARACTERS = 255
"""Maximum length of a name: the name of a type is also the name of a file."""

_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_TYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*")
_TOPIC = re.compile(r"[A-Za-z/~][A-Za-z0-9_/]*")

_NOT_ALLOWED = re.compile(r"[^A-Za-z0-9_/~]")

_ROS2_TYPE = re.compile(r"([^/]+)/(?:msg|srv|action)/([^/]+)")

_LETTERS = 'ASCII letters, digits and "_", a letter first'


def name_fault(text: str) -> Optional[str]:
    """Return why a text is not the name of a package, slot or constant, or None if it is."""
    return _describe_fault(_PLAIN, text, f"a name of {_LETTERS}")


def ros1_type_name(name: str) -> str:
    """Return the name of a message type in the form of ROS 1: ``pkg/Type`` for ``pkg/msg/Type``.

    ROS 2 also has message types of services and actions: ``pkg/srv/Type_Event``, ``pkg/action/Type_FeedbackMessage``.
    """
    match = _ROS2_TYPE.fullmatch(name) if name.count("/") == 2 else None
    return f"{match[1]}/{match[2]}" if match else name


def type_fault(text: str) -> Optional[str]:
    """Return why a text is not the name of a message type, or None if it is."""
    return _describe_fault(_TYPE, text, f'a message type "package/Type", each of {_LETTERS}')


def topic_fault(text: str) -> Optional[str]:
    """Return why a text is not the name of a topic, which may be relative or private, or None if it is."""
    fault = _describe_fault(
        _TOPIC, text, 'a topic name of ASCII letters, digits, "_" and "/", no digit first'
    )
    # ROS collapses repeated slashes, so one topic would have two names here.
    if fault is None and "//" in text:
        return f'expected a topic name, found {quote_shortened(text)}, which has "//" in it'
    return fault


def strip_slashes(topic: str) -> str:
    """Return the name of a topic without leading and trailing slashes: ROS resolves ``/scan/`` and ``scan`` alike.

    Bags and checks compare names in this form, because no node resolves them.
    """
    return topic.strip("/")


def _describe_fault(form: "re.Pattern[str]", text: str, expected: str) -> Optional[str]:
    problem = f"expected {expected}, found {quote_shortened(text)}"
    if len(text) > MAX_NAME_CHARACTERS:
        return f"{problem}: longer than {MAX_NAME_CHARACTERS} characters"
    if form.fullmatch(text):
        return None
    # An invisible or non-ASCII character is hard to spot in the quoted name, so it is named explicitly.
    invalid = _NOT_ALLOWED.search(text)
    return f"{problem}: {ascii(invalid.group())} is not allowed in it" if invalid else problem
