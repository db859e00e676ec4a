"""Bytes of bags of ROS 1, databases and mcap files of ROS 2, and a program that is fed from them."""

import os
from typing import Any

from retalis import Playback
from retalis.playback.bag_locations import MergedBag

from ..mutate import mutate_bytes
from .base import LOGGED, SETTINGS, Kind

TOPICS = """<publish_subscribe>
<subscribe_to name="a" msg_type="fuzz/A"/><subscribe_to name="b" msg_type="fuzz/B"/>
<subscribe_to name="c" msg_type="std_msgs/String"/><publish_to name="out" msg_type="fuzz/A"/>
</publish_subscribe>"""
GOALS = """subscribe(fuzz__0__A(_,_), [], _, out, s)
memorize(fuzz__0__B(_,X), [], X, bs, 10)
"""


ENDINGS = ((b"SQLite", ".db3"), (b"\x89MCAP", ".mcap"), (b"", ".bag"))
"""Endings of the file for an input, by the first bytes of the input."""

MEGABYTES = 8
"""The largest chunk; bombs of the corpus have 200 MB."""


class Inputs(Kind):
    block_size = 20

    def setup(self) -> None:
        self.paths = {ending: self.scratch / f"fuzz{ending}" for _, ending in ENDINGS}
        self.files = {
            ending: os.open(str(path), os.O_RDWR | os.O_CREAT) for ending, path in self.paths.items()
        }
        self.path = self.paths[".bag"]
        for name, text in (("pub_sub.xml", TOPICS), ("goalPredicates.txt", GOALS)):
            (self.scratch / name).write_text(text)

    def reset(self) -> None:
        self.playback = Playback(self.scratch, self.report, settings=SETTINGS)

    def report(self, error: Any) -> None:
        str(error)

    def generate(self, rng: Any) -> bytes:
        return mutate_bytes(rng, rng.choice(self.corpus), self.corpus)

    def prepare(self, data: Any) -> None:
        ending = next(ending for begin, ending in ENDINGS if data.startswith(begin))
        self.path = self.paths[ending]
        os.ftruncate(self.files[ending], 0)
        os.pwrite(self.files[ending], data, 0)

    def run(self, data: Any) -> None:
        self.attempt(self.play)
        LOGGED.check()

    def play(self) -> None:
        with MergedBag([self.path], max_chunk_megabytes=MEGABYTES) as bag:
            for _ in self.playback.run(bag):
                pass
