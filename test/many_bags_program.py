"""Bags and a program for tests of many bags: it publishes each received text, and texts that are received twice."""

import struct
from pathlib import Path
from typing import Any

from retalis import BagWriter, Definitions

SECOND = 10**9
STRING = Definitions().add("std_msgs/String", "string data")


def make_program(folder: Path) -> Any:
    """Write the program; return its folder."""
    folder.mkdir()
    message_type = 'msg_type="std_msgs/String"'
    (folder / "pub_sub.xml").write_text(
        f'<publish_subscribe><subscribe_to name="heard" {message_type}/>'
        f'<publish_to name="speech" {message_type}/></publish_subscribe>'
    )
    (folder / "eventRules.txt").write_text(
        "again(Text) <- std_msgs__0__String(Text) seq std_msgs__0__String(Text).\n"
    )
    (folder / "goalPredicates.txt").write_text(
        "compile_event_file('eventRules.txt')\n"
        "subscribe(std_msgs__0__String(_), [], _, speech, all)\n"
        "subscribe(again(Text), [], std_msgs__0__String(Text), speech, twice)\n"
    )
    return folder


def make_bag(path: Any, *texts: Any, start: int = 1) -> Any:
    """Write a bag with texts, one per second from the second ``start`` on; return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with BagWriter(path) as bag:
        connection = bag.add("/heard", STRING)
        for second, text in enumerate(texts, start):
            data = text.encode()
            bag.write(connection, second * SECOND, struct.pack("<I", len(data)) + data)
    return path
