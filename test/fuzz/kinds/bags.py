"""Bytes of bags, and a program that is fed from them."""

import os

from retalis.engine.playback import BagReader, Playback

from ..mutate import changed_bytes
from .base import LOGGED, SETTINGS, Kind

TOPICS = """<publish_subscribe>
<subscribe_to name="a" msg_type="fuzz/A"/><subscribe_to name="b" msg_type="fuzz/B"/>
<subscribe_to name="c" msg_type="std_msgs/String"/><publish_to name="out" msg_type="fuzz/A"/>
</publish_subscribe>"""
GOALS = """subscribe(fuzz__0__A(_,_), [], _, out, s)
memorize(fuzz__0__B(_,X), [], X, bs, 10)
"""


class Inputs(Kind):
    block = 20

    def setup(self):
        self.path = self.scratch / "fuzz.bag"
        self.file = os.open(str(self.path), os.O_RDWR | os.O_CREAT)
        for name, text in (("pub_sub.xml", TOPICS), ("goalPredicates.txt", GOALS)):
            (self.scratch / name).write_text(text)

    def begin(self):
        self.playback = Playback(self.scratch, self.report, settings=SETTINGS)

    def report(self, error):
        str(error)

    def make(self, chance):
        return changed_bytes(chance, chance.choice(self.corpus), self.corpus)

    def prepare(self, data):
        os.ftruncate(self.file, 0)
        os.pwrite(self.file, data, 0)

    def run(self, data):
        self.attempt(self.play)
        LOGGED.check()

    def play(self):
        with BagReader(self.path) as bag:
            for _ in self.playback.run(bag):
                pass
