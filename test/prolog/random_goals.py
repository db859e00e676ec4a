"""Generator of random goals over the built-ins.

``goal_predicates.txt`` says for each predicate what kind of argument goes where, ``goal_kinds.txt`` gives the
arguments of a kind. An argument is mostly of its kind, and sometimes a variable or anything at all, so that errors
are asked for too.
"""

from pathlib import Path
from random import Random
from typing import Dict, List

FOLDER = Path(__file__).parent
VARIABLE, ANYTHING = 0.15, 0.12
ARITHMETIC = 0.12

_FUNCTIONS = r"""
+/2 -/2 */2 ///2 mod/2 rem/2 div/2 //2 min/2 max/2 **/2 ^/2 >>/2 <</2 /\/2 \//2 xor/2 gcd/2 atan2/2
atan/2 copysign/2 lcm/2 truncate/1 -/1 +/1 abs/1 sign/1 sqrt/1 sin/1 cos/1 atan/1 exp/1 log/1
log10/1 floor/1 ceiling/1 round/1 integer/1 float/1 float_integer_part/1 float_fractional_part/1 \/1
msb/1 asin/1 acos/1 tan/1 sinh/1 cosh/1 tanh/1 asinh/1 acosh/1 atanh/1 nexttoward/2 popcount/1
getbit/2 erf/1 erfc/1 lgamma/1
"""
FUNCTIONS = _FUNCTIONS.split()
_OPERANDS = r"""
X 1 2 -3 0 2.5 -0.5 7 10 3 a foo(1) inf nan 12345678901234567890 1.0 e pi "a" [5] epsilon "ab" []
0.0 -1 100 1.0e300
"""
OPERANDS = _OPERANDS.split()


def _lines(name: str) -> List[str]:
    text = (FOLDER / name).read_text(encoding="utf-8")
    return [line for line in text.split("\n") if line and line[0] != "#"]


def kinds() -> Dict[str, List[str]]:
    """Return the arguments of each kind."""
    found: Dict[str, List[str]] = {}
    for line in _lines("goal_kinds.txt"):
        kind, *values = line.split("  ")
        found.setdefault(kind[:-1], []).extend(values)
    return found


class Generator:
    """Makes goals; the same ones from the same seed."""

    def __init__(self, seed: int):
        self.random = Random(seed)
        self.kinds = kinds()
        self.predicates = [line.split(" ") for line in _lines("goal_predicates.txt")]

    def goals(self, count: int) -> List[str]:
        """Return different goals."""
        made: Dict[str, None] = {}
        while len(made) < count:
            made[self._goal()] = None
        return list(made)

    def _goal(self) -> str:
        if self.random.random() < ARITHMETIC:
            return "X is " + self._expression(2)
        name, *wanted = self.random.choice(self.predicates)
        return _applied(name, [self._argument(kind) for kind in wanted])

    def _argument(self, kind: str) -> str:
        chance = self.random.random()
        if chance < VARIABLE:
            return self.random.choice("XYZ")
        return self.random.choice(self.kinds["any" if chance < VARIABLE + ANYTHING else kind])

    def _expression(self, depth: int) -> str:
        if depth == 0 or self.random.random() < 0.3:
            return self.random.choice(OPERANDS)
        name, _, arity = self.random.choice(FUNCTIONS).rpartition("/")
        return _applied(name, [self._expression(depth - 1) for _ in range(int(arity))])


def _applied(name: str, arguments: List[str]) -> str:
    quoted = name if name[0].isalpha() else "'" + name.replace("\\", "\\\\") + "'"
    return f"{quoted}({','.join(arguments)})" if arguments else quoted
