"""Texts of rule files, and events for what is in them."""

from ..mutate import changed_text, soup, to_bytes, to_text
from .base import LOGGED, Kind, silent_engine

PIECES = (
    " <- ",
    " seq ",
    " and ",
    " or ",
    " par ",
    " where ",
    " within ",
    " cnot ",
    " fnot ",
    " do ",
    " check ",
)
PIECES += (
    " equals ",
    " meets ",
    " during ",
    " starts ",
    " finishes ",
    " star_times",
    " ntimes 3",
    " forall_seq ",
)
PIECES += (
    " event_multiply ",
    "aggregate(sum(X),b(X),S)",
    "prolog(true)",
    " : ",
    ":- ",
    ". ",
    "a(X)",
    "b(Y)",
    "c",
)
PIECES += (
    ":- dynamic f/1. ",
    "-->",
    "label([property(a,b)])",
    "X",
    "_",
    "(",
    ")",
    ",",
    "|",
    "\\+",
    "!",
    " is ",
    "1",
)
PIECES += (
    "set_etalis_flag(out_of_order,on)",
    "assertz(",
    ":- op(700,xfx,",
    "retract(",
    "findall(X,",
    "0'",
    "->",
    ";",
)
EVENTS = ("a(1)", "b(2)", "c", "a(b(3))")


class Inputs(Kind):
    block = 8
    reads = True  # a program that is loaded may name any file

    def begin(self):
        self.engine = silent_engine()
        self.time = 0

    def make(self, chance):
        if chance.random() < 0.1:
            return to_bytes(soup(chance, PIECES))
        return to_bytes(changed_text(chance, chance.choice(self.texts), self.texts, PIECES))

    def run(self, data):
        self.attempt(self.engine.load_rules, to_text(data))
        for event in EVENTS:
            self.time += 1
            self.attempt(self.engine.event, event, self.time)
        LOGGED.check()
