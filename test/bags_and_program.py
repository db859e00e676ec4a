"""Bags and a program for tests of many bags: it says what it hears, and what it has heard twice in a row."""

import struct

from retalis import BagWriter, Definitions

SECOND = 10**9
STRING = Definitions().add("std_msgs/String", "string data")


def make_program(folder):
    """Write the program; return its folder."""
    folder.mkdir()
    kind = 'msg_type="std_msgs/String"'
    (folder / "pub_sub.xml").write_text(
        f'<publish_subscribe><subscribe_to name="heard" {kind}/><publish_to name="said" {kind}/></publish_subscribe>'
    )
    (folder / "eventRules.txt").write_text(
        "again(Text) <- std_msgs__0__String(Text) seq std_msgs__0__String(Text).\n"
    )
    (folder / "goalPredicates.txt").write_text(
        "compile_event_file('eventRules.txt')\n"
        "subscribe(std_msgs__0__String(_), [], _, said, all)\n"
        "subscribe(again(Text), [], std_msgs__0__String(Text), said, twice)\n"
    )
    return folder


def make_bag(path, *texts, start=1):
    """Write a bag with these texts, one a second from a second on; return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with BagWriter(path) as bag:
        connection = bag.add("/heard", STRING)
        for second, text in enumerate(texts, start):
            data = text.encode()
            bag.write(connection, second * SECOND, struct.pack("<I", len(data)) + data)
    return path
