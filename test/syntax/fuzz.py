"""Random and mutated texts for the reader: a term or a syntax fault, never anything else, never a hang.

Usage: python fuzz.py [COUNT [SEED]]      a million texts by default
"""

import random
import sys
import time
from typing import Iterator, List

from retalis.errors import SyntaxFault
from retalis.syntax import EventReader, Operators, ReadFlags, read_program, read_term, write_term

SEEDS = [
    "foo(X, Y) :- bar(X), \\+ baz(Y), !, X is Y * 2 + 0x1F.",
    "out(X) <- a(X) seq b(X) where X > 1.",
    "h(X) do g(X) <- p(X) and not q(X).within(3)",
    "label rule: a <- b par (c or d) check (X = 1, true).",
    "tf__0__tfMessage([transform(header(1,0,'/map'),\"x\",[1.0,-2.5e10,nan])])",
    "event(a('b c',\"d\\n\"),[datime(2001,1,1,0,0,0,0),datime(2001,1,1,0,0,1,0)])",
    "X = \"a\\x41\\b\", Y = 0'a, Z = `abc`, W = 'it''s'.",
    ":- op(700, xfx, ===>). a ===> b. {x,y}. [a,b|C]. - (1). -1. - a. a:b:c.",
    'p --> "abc", {q}, !, r. /* comment */ % another\n p :- (a -> b ; c *-> d).',
    "f(;, '|', ';;', [], {}, (:-), -, +(1)). 1.0Inf. 1.5NaN. 1 000. 1_000.",
]
PIECES = list("()[]{},|.'\"`\\;:!%/*-+<>=@#&^~?_ \n\t0123456789abcXYZé∀\0\ud7ff")
PIECES += [
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
    "a(",
]
PIECES += ["$VAR("]


def texts(count: int, seed: int) -> Iterator[str]:
    """Yield texts: soups of pieces, and mutations of programs."""
    chance = random.Random(seed)
    for _ in range(count):
        if chance.random() < 0.4:
            yield "".join(chance.choice(PIECES) for _ in range(chance.randint(1, 25)))
            continue
        text: List[str] = list(chance.choice(SEEDS))
        for _ in range(chance.randint(1, 5)):
            at = chance.randrange(len(text) + 1)
            what = chance.random()
            if what < 0.4:
                text[at:at] = chance.choice(PIECES)
            elif what < 0.7:
                del text[at : at + chance.randint(1, 4)]
            else:
                end = at + chance.randint(1, 8)
                other = chance.randrange(len(text) + 1)
                text[other:other] = text[at:end]
        yield "".join(text)


class Reader:
    """All ways to read a text."""

    def __init__(self) -> None:
        self.operators = Operators.prolog()
        self.events = EventReader(self.operators)
        self.flags = (ReadFlags(), ReadFlags(iso=True, double_quotes="codes"), ReadFlags(event_text=True))
        self.read = self.faults = 0

    def check(self, text: str) -> None:
        """Read a text in all ways.

        Raises:
            Exception: whatever is no syntax fault.
        """
        for flags in self.flags:
            for found in read_program(text, self.operators, flags=flags):
                if isinstance(found, SyntaxFault):
                    str(found)
                    self.faults += 1
                else:
                    write_term(found.term, self.operators)
                    self.read += 1
        for read in (lambda: read_term(text, self.operators), lambda: self.events.read(text)):
            try:
                read()
                self.read += 1
            except SyntaxFault as fault:
                str(fault)
                self.faults += 1


def run(count: int, seed: int, slowest: float = 2.0) -> Reader:
    """Check texts; a text that takes more than ``slowest`` seconds of CPU counts as a hang."""
    reader = Reader()
    for text in texts(count, seed):
        start = time.process_time()
        try:
            reader.check(text)
        except Exception:
            print(f"seed {seed}: {text!r}", file=sys.stderr)
            raise
        if time.process_time() - start > slowest:
            raise RuntimeError(f"seed {seed}: slow: {text!r}")
    return reader


def main() -> None:
    """Check as many texts as the command line says."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    block = 20_000
    for done in range(0, count, block):
        size = min(block, count - done)
        reader = run(size, seed + done)
        print(
            f"{done + size} texts; the last {size}: {reader.read} terms, {reader.faults} faults", flush=True
        )


if __name__ == "__main__":
    main()
