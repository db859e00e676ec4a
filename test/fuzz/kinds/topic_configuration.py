"""Texts of ``pub_sub.xml``."""

import os
from typing import Any, Tuple

from retalis.events.program.topic_configuration import read_topics

from ..mutate import mutate_bytes, mutate_text, random_tokens, to_bytes
from .base import Kind

PIECES: Tuple[str, ...] = (
    "<subscribe_to ",
    "<publish_to ",
    "<observe_action ",
    "<observe_service ",
    'action_type="a/B" ',
    'srv_type="a/B" ',
    'event="',
    'name="',
    'msg_type="',
    "/>",
    "<publish_subscribe>",
    "</publish_subscribe>",
)
PIECES += (
    "<!DOCTYPE a [",
    '<!ENTITY a "aaaa">',
    "&a;",
    "&lt;",
    "&#0;",
    "&#x41;",
    "<![CDATA[",
    "]]>",
    "<!--",
    "-->",
)
PIECES += (
    '<?xml version="1.0" encoding="utf-16"?>',
    "SYSTEM 'file:///etc/passwd'",
    "xmlns:a='b'",
    "<a>",
    "</a>",
    '"',
)


class Inputs(Kind):
    block_size = 1000

    def setup(self) -> None:
        self.path = self.scratch / "pub_sub.xml"
        self.file = os.open(str(self.path), os.O_RDWR | os.O_CREAT)

    def generate(self, rng: Any) -> bytes:
        draw = rng.random()
        if draw < 0.1:
            return to_bytes(random_tokens(rng, PIECES))
        if draw < 0.25:
            return mutate_bytes(rng, rng.choice(self.corpus), self.corpus)
        return to_bytes(mutate_text(rng, rng.choice(self.texts), self.texts, PIECES))

    def prepare(self, data: Any) -> None:
        os.ftruncate(self.file, 0)
        os.pwrite(self.file, data, 0)

    def run(self, data: Any) -> None:
        self.attempt(read_topics, self.path)
