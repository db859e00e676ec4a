"""Windows of steps, by trying all ways in their order over the plain list of what has come.

A step is the term ``step(Name, Least, Most, Mode, Where, Goal, Until)``: Most is a number or ``many``, Mode is
``greedy`` or ``reluctant``, Where ``later`` or ``next``, and the goals are lists of none or one.
"""

from typing import Any, Callable, List, NamedTuple, Optional, Sequence, Tuple

from retalis import Atom, Term, Var, list_items

from .goals import Bindings, first, instance, value_of

Taken = Tuple[Tuple[int, int], ...]
"""Places of items, and the numbers of the steps that took them."""
OPEN = "open"
"""Nobody can say yet: it depends on what comes."""


class Step(NamedTuple):
    """A step as its term has it."""

    name: str
    least: int
    most: Optional[int]
    reluctant: bool
    later: bool
    goal: Optional[Term]
    until: Optional[Term]


def steps_of(term: Term) -> List[Step]:
    """Return the steps of a window."""
    found: List[Any] = []
    for one in list_items(term) or []:
        name, least, most, mode, where, goal, until = one[1:]  # type: ignore[index]
        goals = [(list_items(part) or [None])[0] for part in (goal, until)]
        limit = None if most.__class__ is Atom else most
        found.append(Step(name.name, least, limit, mode.name == "reluctant", where.name == "later", *goals))
    return found


def whole_matches(steps: Sequence[Step], items: Sequence[Bindings]) -> List[Taken]:
    """Return the matches in a list of items that are decided at its end."""
    found: List[Taken] = []
    at = 0
    while at < len(items):
        match: Any = Trial(steps, items).begin(at)
        if match == OPEN:
            return found
        if match is None:
            at += 1
        else:
            found.append(match)
            at = match[-1][0] + 1
    return found


class Trial:
    """The ways in which a match may begin at an item, one after the other."""

    def __init__(self, steps: Sequence[Step], items: Sequence[Bindings]) -> None:
        self.steps = steps
        self.items = items

    def begin(self, at: int) -> Any:
        """Return the first match in order, None where there is none, `OPEN` where what comes decides."""
        return self._try(self._before(0), at, ())

    def _before(self, step: int) -> List[Any]:
        """Steps that may precede a step without events; None is the end."""
        if step == len(self.steps):
            return [None]
        return self._order(step, self.steps[step].least == 0, True)

    def _order(self, step: int, enough: bool, more: bool) -> List[Any]:
        """At each Q: first, whether the step goes on, then whether one after it begins; reluctant: the other way."""
        on, after = [step] if more else [], self._before(step + 1) if enough else []
        return after + on if self.steps[step].reluctant else on + after

    def _after(self, taken: Taken) -> List[Any]:
        step = taken[-1][1]
        count = sum(other == step for _, other in taken)
        most = self.steps[step].most
        return self._order(step, count >= self.steps[step].least, most is None or count < most)

    def _try(self, choices: List[Any], at: int, taken: Taken) -> Any:
        if None in choices:
            end = choices.index(None)
            found = self._try_steps(choices[:end], at, taken, choices[end + 1 :]) if end else None
            return taken if found is None else found
        return self._try_steps(choices, at, taken, [])

    def _try_steps(self, choices: List[int], at: int, taken: Taken, unused: List[int]) -> Any:
        """Try some steps; what one of the unused ones, which come after the end, would take is not passed over."""
        if not choices:
            return None
        if at == len(self.items):
            return OPEN
        open_ones = [one for one in choices if not self._is_over(one, at, taken)]
        takers = [one for one in open_ones if self._fits(one, at, taken)]
        for one in takers:
            longer = (*taken, (at, one))
            found = self._try(self._after(longer), at + 1, longer)
            if found is not None:
                return found
        waiting = [one for one in unused if not self._is_over(one, at, taken)]
        if takers or not taken or any(self._fits(one, at, taken) for one in waiting):
            return None
        later, unused = [[one for one in some if self.steps[one].later] for some in (open_ones, waiting)]
        return self._try_steps(later, at + 1, taken, unused)

    def _fits(self, step: int, at: int, taken: Taken) -> bool:
        goal = self.steps[step].goal
        return goal is None or all(holds is not False for holds in self._asked(goal, step, at, taken))

    def _is_over(self, step: int, at: int, taken: Taken) -> bool:
        until = self.steps[step].until
        if until is None:
            return False
        asked = [holds for holds in self._asked(until, step, at, taken) if holds is not None]
        return bool(asked) and all(asked)

    def _asked(self, goal: Term, step: int, at: int, taken: Taken) -> List[Optional[bool]]:
        """For each part of a condition whether it holds; None where it looks back at what is not there."""
        found: List[Optional[bool]] = []
        for part in conjuncts(goal):
            missing: List[bool] = []

            def past(kind: str, name: str, var: Var, missing: List[bool] = missing) -> Term:
                places = [place for place, other in taken if kind == "prev" or self._is(other, name, step)]
                if not places:
                    missing.append(True)
                    return var
                return instance(var, self.items[places[0 if kind == "first" else -1]])

            asked = looking_back(part, past)
            if missing:
                found.append(None)
            else:
                found.append(first(asked, self.items[at]) is not None)
        return found

    def _is(self, other: int, name: str, step: int) -> bool:
        return self.steps[other].name == name if name else other == step


def conjuncts(goal: Term) -> List[Term]:
    """Return the parts of a goal between its commas."""
    if goal.__class__ is tuple and goal[0].name == ",":
        return [part for one in goal[1:] for part in conjuncts(one)]
    return [goal]


def looking_back(term: Term, past: Callable[[str, str, Var], Term]) -> Term:
    """Return a condition with values in the place of what it looks back at."""
    term = value_of(term, {})
    if term.__class__ is not tuple:
        return term
    name, args = term[0].name, term[1:]
    if name in ("prev", "first", "last") and args[-1].__class__ is Var and len(args) <= 2:
        return past(name, args[0].name if len(args) == 2 else "", args[-1])
    return (term[0], *(looking_back(one, past) for one in args))
