"""All installed types: this package and genpy decode and encode random messages alike. Needs genpy, no master."""

from typing import Any, Set

import pytest

pytest.importorskip("genpy", reason="ROS is not installed")

from messages.codec_comparison import compare_messages, genpy_references  # noqa: E402

MESSAGES = 10
"""Messages of each type; ``python3 -m messages.codec_comparison genpy`` tries any number, and more types."""


def test_installed_types_are_encoded_as_by_genpy() -> None:
    names: Set[Any] = set()
    for reference in genpy_references(with_stores=False):
        compare_messages(reference, MESSAGES)
        names.add(reference.definition.name)
    assert {"std_msgs/String", "tf2_msgs/TFMessage", "retalis/Radar"} <= names
