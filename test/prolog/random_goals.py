"""Generator of random goals over the built-ins.

``goal_predicates.txt`` lists the kinds of the arguments of each predicate, ``goal_kinds.txt`` the values of a kind.
An argument is mostly of its kind, and sometimes a variable or of any kind, which also tests errors.
"""

from pathlib import Path
from random import Random
from typing import Dict, List

FOLDER = Path(__file__).parent
VARIABLE_SHARE, ANYTHING_SHARE = 0.15, 0.12
ARITHMETIC_SHARE = 0.12

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
    """Return the values of each kind of argument."""
    values_by_kind: Dict[str, List[str]] = {}
    for line in _lines("goal_kinds.txt"):
        kind, *values = line.split("  ")
        values_by_kind.setdefault(kind[:-1], []).extend(values)
    return values_by_kind


class Generator:
    """Generator of random goals, determined by its seed."""

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)
        self.kinds = kinds()
        self.predicates = [line.split(" ") for line in _lines("goal_predicates.txt")]

    def goals(self, count: int) -> List[str]:
        """Return distinct goals."""
        distinct: Dict[str, None] = {}
        while len(distinct) < count:
            distinct[self._goal()] = None
        return list(distinct)

    def _goal(self) -> str:
        if self.random.random() < ARITHMETIC_SHARE:
            return "X is " + self._expression(2)
        name, *argument_kinds = self.random.choice(self.predicates)
        return _applied(name, [self._argument(kind) for kind in argument_kinds])

    def _argument(self, kind: str) -> str:
        chance = self.random.random()
        if chance < VARIABLE_SHARE:
            return self.random.choice("XYZ")
        return self.random.choice(self.kinds["any" if chance < VARIABLE_SHARE + ANYTHING_SHARE else kind])

    def _expression(self, depth: int) -> str:
        if depth == 0 or self.random.random() < 0.3:
            return self.random.choice(OPERANDS)
        name, _, arity = self.random.choice(FUNCTIONS).rpartition("/")
        return _applied(name, [self._expression(depth - 1) for _ in range(int(arity))])


def _applied(name: str, arguments: List[str]) -> str:
    quoted = name if name[0].isalpha() else "'" + name.replace("\\", "\\\\") + "'"
    return f"{quoted}({','.join(arguments)})" if arguments else quoted
