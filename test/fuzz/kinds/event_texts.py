"""Texts of events, for an engine that accepts events only."""

from typing import Any

from ..mutate import mutate_text, random_tokens, to_bytes, to_text
from .base import ARGUMENTS, LOGGED, Kind, create_silent_engine

PIECES = (
    "event(",
    "new_event(",
    "datime(2014,10,19,19,50,5,1)",
    ",[datime(",
    "[1,2]",
    "a(1)",
    "b(X)",
    "'\"text\"'",
    "nan",
    "-inf",
    "1e400",
    "99999999999999999999",
    "[[1,2],[3|T]]",
    "'x y'",
    ")",
    "])",
    "0'a",
    "assertz(a)",
    "halt",
)
FORMS = (
    "event({0})",
    "event({0},[5,6])",
    "new_event({0},1,2)",
    "new_event({0},{1},2,3,4)",
    "event({0},[{1},{1}])",
)
RULES = """
ab(X, Y) <- a(X) seq b(Y).
both(X) <- (a(X) and c(X)) within 60.
many(S) <- a(_) seq aggregate(sum(X), b(X), S).
late(X) <- c(X) where (number(X), X > 1).
unless(X) <- (a(X) seq c(_)) cnot b(X).
"""
GOALS = """
memorize(a(X), [], X, as, 10)
subscribe(ab(_,_), [], _, t, s)
memorize(c(X), [number(X)], got(X), cs, 3)
"""


class Inputs(Kind):
    block_size = 200

    def reset(self) -> None:
        self.engine = create_silent_engine()
        self.engine.load(rules=RULES, goals=GOALS)
        self.engine.on_output(lambda term, topic, name: self.engine.show(term))

    def generate(self, rng: Any) -> bytes:
        if rng.random() < 0.15:
            return to_bytes("event(" + random_tokens(rng, PIECES))
        if rng.random() < 0.3:
            name, argument = rng.choice("abc"), rng.choice(ARGUMENTS)
            return to_bytes(rng.choice(FORMS).format(f"{name}({argument})", rng.choice(ARGUMENTS)))
        return to_bytes(mutate_text(rng, rng.choice(self.texts), self.texts, PIECES))

    def run(self, data: Any) -> None:
        before = self.engine.reports.warnings
        self.engine.post_text(to_text(data))
        if self.engine.reports.warnings > before:
            self.refused_count += 1
        else:
            self.accepted_count += 1
        LOGGED.check()
