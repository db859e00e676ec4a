"""Comparison of written random terms with SWI-Prolog.

Usage: python writer_comparison.py COUNT [SEED]      print the differences
"""

import random
import sys
from pathlib import Path
from typing import List

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "prolog"))

from swi_comparison import answer, plain  # noqa: E402
from swipl import ask  # noqa: E402

_ATOMS = r"""
a b foo 'A' {} '' + - * / = :- --> ; , ! '|' \+ \ is mod dynamic 'a.b' @ # ~ ^ ** -> *-> '.' é 'É' '_x' '\n'
'\t' 'it''s' ?- $ & == =.. div rem xor table < >= : a1 aB '1a' '/*' '%' '\\' 'a\\b' discontiguous initialization
"""
_NUMBERS = r"""
0 1 -1 2 10 1.0 -1.0 0.1 1e10 1.0e20 -0.0 1.5e-7 123456789012345678901234567890 -3 1.0Inf -1.0Inf 1.5NaN 0'a
"""
_INFIX = r"+ - * / = :- --> ; , -> is mod ^ ** < : =.. | xor >:< @< \= *-> as rdiv div >>"
_PREFIX = r"- + \ \+ ?- :- dynamic table ? $ @ discontiguous initialization"
ATOMS, NUMBERS, INFIX, PREFIX = (text.split() for text in (_ATOMS, _NUMBERS, _INFIX, _PREFIX))
OTHERS = ['"abc"', '""', r'"a\"b"', r'"a\nb"', "X", "Y", "_", "'$VAR'(1)", "'$VAR'(27)", "'$VAR'(x)", "`ab`"]
FUNCTORS = ["f", "foo", "A b", "+", "-", ",", "{}", "is"]
WRITERS = ["writeq", "print", "write_canonical", "write", "portray_clause"]


class Terms:
    """Generator of the texts of random terms, determined by its seed."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)

    def term(self, depth: int) -> str:
        """Return the text of a term that both systems read as the same term: operators are written as functors."""
        choose = self.random.choice
        kind = self.random.random()
        if depth == 0 or kind < 0.15:
            return choose([f"({choose(ATOMS)})", choose(NUMBERS), choose(OTHERS)])
        if kind < 0.45:
            return self._applied(choose(INFIX), 2, depth)
        if kind < 0.65:
            return self._applied(choose(PREFIX), 1, depth)
        if kind < 0.75:
            return f"[{self.term(depth - 1)},{self.term(depth - 1)}|{choose(['[]', self.term(depth - 1)])}]"
        if kind < 0.8:
            return self._applied("{}", 1, depth)
        return self._applied(choose(FUNCTORS), self.random.randint(1, 3), depth)

    def _applied(self, name: str, arity: int, depth: int) -> str:
        escaped = name.replace("\\", "\\\\")
        return f"'{escaped}'({','.join(self.term(depth - 1) for _ in range(arity))})"

    def goals(self, count: int) -> List[str]:
        """Return goals that write terms."""
        return [
            f"{self.random.choice(WRITERS)}({self.term(self.random.randint(1, 3))})" for _ in range(count)
        ]


def main() -> None:
    """Compare."""
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else random.randrange(1 << 30)
    goals = Terms(seed).goals(int(sys.argv[1]))
    differing = 0
    for goal, theirs in zip(goals, ask(goals)):
        here, there = (plain(result).partition(" printed ")[2] for result in (answer(goal), theirs))
        if here != there:
            differing += 1
            print(f"{goal}\n  here  {here}\n  swipl {there}")
    print(f"seed {seed}: {len(goals) - differing} of {len(goals)} have the same text")


if __name__ == "__main__":
    main()
