"""Random cases whose absences contain each other, and have conditions on variables further left, with retractions."""

from typing import Sequence, Tuple

from retalis import Var, atom, functor

from .matches import POLICIES
from .pattern_classes import Both, Cnot, Fnot, Leaf, Pattern, Rule, Where, Without
from .strategies import Case, Generator, bindable, certain_in_order


class NestedAbsences(Generator):
    """Generator of sequences of an event and a pattern with absences that depend on the event."""

    def case(self, depth: int = 4) -> Case:
        """Draw a program of one rule, and a stream with retractions."""
        rules = [self.rule("out", depth)]
        stream = self.with_revisions(self.stream(self.choice(range(4, 24)), rules))
        return Case(
            (self.with_properties(rules[0]),), self.choice(POLICIES), self.chance(20), tuple(stream), ()
        )

    def rule(self, head: str, depth: int, bound_only: bool = False) -> Rule:
        """Draw a rule; ``depth`` is the maximum depth of absences within absences."""
        first = Leaf(functor("c", 2)(*[self.choice([Var(), self.value(2)]) for _ in range(2)]))
        if self.chance(70):
            first = Leaf(functor(self.choice(["a", "b"]), 1)(Var()))
        body: Pattern = Both(
            self.choice(["seq"] * 4 + ["and", "forall_seq"]), first, self._second(certain_in_order(first), 2)
        )
        if self.chance(60):
            body = self._absence(body, (), depth // 2)
        if self.chance(25):
            body = Both("seq", body, self._event(certain_in_order(body)))
        if self.chance(25):
            body = self._absence(body, (), depth // 2)
        arguments = [var for var in dict.fromkeys(bindable(body)) if var in certain_in_order(body)]
        return Rule(functor(head, len(arguments))(*arguments) if arguments else atom(head), body)

    def _event(self, known: Sequence[Var]) -> Leaf:
        """Draw a pattern of one event, mostly with known variables."""
        name = self.choice(list(self.names))
        arguments = [self.choice([*known, *known, Var(), self.value(2)]) for _ in range(self.names[name])]
        return Leaf(functor(name, len(arguments))(*arguments) if arguments else atom(name))

    def _second(self, left: Sequence[Var], depth: int) -> Pattern:
        """Draw a pattern with absences; ``left`` are the variables of the patterns to the left."""
        below: Pattern = self._event(left)
        if self.chance(50):
            known = [*left, *certain_in_order(below)]
            other = self._second(known, depth - 1) if depth and self.chance(50) else self._event(known)
            below = Both(self.choice(["seq"] * 12 + ["and", "par"]), below, other)
        for _ in range(self.choice([1, 1, 2, 2, 3])):
            if self.chance(25):
                below = Where(below, self.goal(below, tuple(left), outer=100))
            else:
                below = self._absence(below, left, 2)
        return below

    def _absence(self, below: Pattern, left: Sequence[Var], depth: int) -> Pattern:
        """Draw an absence around a pattern, perhaps with a condition or an absence inside."""
        known: Tuple[Var, ...] = (*certain_in_order(below), *left)
        absent: Pattern = self._event([*known, *left])
        form = self.choice(["condition", "condition", "absence", "pair", "event", "event"])
        if form == "condition" and known:
            absent = Where(absent, self.goal(absent, known, outer=100))
        elif form == "absence" and depth:
            absent = self._absence(absent, known, depth - 1)
        elif form == "pair":
            absent = Both(self.choice(["seq", "and"]), absent, self._event(known))
        kinds = [Fnot, Fnot, *[Without] * (2 * self.overlaps)]
        if isinstance(below, Both) and below.kind == "seq":
            kinds += [Cnot] * 3
        return self.choice(kinds)(below, absent)
