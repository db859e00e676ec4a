"""Queries: examples of the page of predicates changed, and every predicate with arguments of all kinds."""

import re
from pathlib import Path
from typing import Any, List

from retalis import atom
from retalis.prolog.syntax.term_writer import write_term

from ..mutate import mutate_text, to_bytes, to_text
from .base import ARGUMENTS, LOGGED, Kind, create_silent_engine

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "predicates.md"
EXAMPLE = re.compile(r"`` (.+?) ``")
MAX_SOLUTIONS = 5


def examples() -> Any:
    """Return the examples of the page."""
    goals: List[Any] = []
    for line in PAGE.read_text(encoding="utf-8").split("\n"):
        if line.startswith("| ``"):
            cells = re.split(r"(?<!\\) (?<!\\)\| ", line[2:-2])
            goals.append(EXAMPLE.findall(cells[4])[0].replace("\\|", "|"))
    return goals


class Inputs(Kind):
    block_size = 100

    def setup(self) -> None:
        self.texts += examples()
        keys = create_silent_engine().logic.names()
        self.keys = sorted((write_term(atom(key.name), None, quoted=True), key.arity) for key in keys)

    def reset(self) -> None:
        self.engine = create_silent_engine()
        self.engine.load(
            "foo(1). foo(2). foo(f(X)) :- foo(X). a(X) <- b(X). p(X) --> [X], q. q --> []. q --> [x], q."
        )

    def generate(self, rng: Any) -> bytes:
        if rng.random() < 0.5:
            return to_bytes(mutate_text(rng, rng.choice(self.texts), self.texts, ARGUMENTS))
        goals = [self.goal(rng) for _ in range(rng.choice((1, 1, 2, 3)))]
        return to_bytes(rng.choice((", ", ", ", " ; ", " -> ")).join(goals))

    def goal(self, rng: Any, depth: int = 0) -> Any:
        name, arity = rng.choice(self.keys)
        arguments = [self.argument(rng, depth) for _ in range(arity)]
        return f"{name}({', '.join(arguments)})" if arity else name

    def argument(self, rng: Any, depth: Any) -> str:
        draw = rng.random()
        if draw > 0.93 and depth < 3:
            return f"({self.goal(rng, depth + 1)})"
        if draw > 0.88 and depth < 3:
            return f"[{self.argument(rng, depth + 1)}, {self.argument(rng, depth + 1)}]"
        if draw > 0.83 and depth < 3:
            return f"f({self.argument(rng, depth + 1)})"
        return f"({rng.choice(ARGUMENTS)})"

    def run(self, data: Any) -> None:
        solutions = self.attempt(self.engine.query, to_text(data), MAX_SOLUTIONS)
        for solution in solutions or ():
            for value in solution.values():
                self.attempt(self.engine.show, value)
        LOGGED.check()
