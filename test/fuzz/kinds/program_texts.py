"""Texts for the reader: a term or a syntax fault."""

from typing import Any, Tuple

import retalis.events.language.event_operators  # noqa: F401 -- adds its operators to those of Prolog
from retalis import Operators, SyntaxFault
from retalis.prolog.syntax.event_text import EventReader
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.syntax.tokenizer import ReadFlags

from ..mutate import TOKENS, mutate_text, random_tokens, to_bytes, to_text
from .base import Kind

PIECES: Tuple[str, ...] = (
    " :- ",
    " <- ",
    " do ",
    "0'",
    "0x",
    "/*",
    "*/",
    "-->",
    " seq ",
    " where ",
    ". ",
    "\\x",
    "1e",
    "1.0e",
    "\\+",
)
PIECES += (
    "a(",
    "$VAR(",
    "0b",
    "'\\",
    '"',
    "%\n",
    ":- op(",
    "\ud7ff",
    "\x7f",
    "```",
    "|| ",
    "- 1",
    "inf",
    "nan",
)


class Inputs(Kind):
    block_size = 1000

    def reset(self) -> None:
        self.operators = Operators.prolog()
        self.events = EventReader(self.operators)
        self.flags = (ReadFlags(), ReadFlags(iso=True, double_quotes="codes"), ReadFlags(event_text=True))

    def generate(self, rng: Any) -> bytes:
        if rng.random() < 0.4:
            return to_bytes(random_tokens(rng, PIECES if rng.random() < 0.3 else TOKENS))
        return to_bytes(mutate_text(rng, rng.choice(self.texts), self.texts, PIECES))

    def run(self, data: Any) -> None:
        text = to_text(data)
        for clause in read_program(text, self.operators, flags=self.flags[len(text) % 3]):
            if isinstance(clause, SyntaxFault):
                str(clause)
                self.refused_count += 1
            else:
                write_term(clause.term, self.operators)
                self.accepted_count += 1
        self.attempt(read_term, text, self.operators)
        self.attempt(self.events.read, text)
