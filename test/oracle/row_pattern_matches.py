"""Windows of steps, by a search of all assignments in their order over the list of all events.

A step is the term ``step(Name, Least, Most, Mode, Where, Goal, Until)``: Most is a number or ``many``, Mode is
``greedy`` or ``reluctant``, Where ``later`` or ``next``, and the goals are lists of none or one.
"""

from typing import Any, Callable, List, NamedTuple, Optional, Sequence, Tuple

from retalis import Atom, Term, Var, atom, list_items

from .goals import Bindings, first, instance, value_of
from .matches import EMPTY_RESULTS, RESULTS

Assignment = Tuple[Tuple[int, int], ...]
"""Positions of items, with the indexes of the steps that match them."""
OPEN = "open"
"""Undecided: the result depends on later events."""
AGGREGATES = ("count", "sum", "avg", "min", "max")
NONE = atom("none")
STAMPS = {"t1": Var(), "t2": Var()}
"""Variables whose values are the start and the end of an item."""


class Step(NamedTuple):
    """A step of a window."""

    name: str
    least: int
    most: Optional[int]
    reluctant: bool
    later: bool
    goal: Optional[Term]
    until: Optional[Term]


def steps_of(term: Term) -> List[Step]:
    """Return the steps of a window."""
    steps: List[Any] = []
    for step in list_items(term) or []:
        name, least, most, mode, continuation, goal, until = step[1:]  # type: ignore[index]
        goals = [next(iter(list_items(part) or []), None) for part in (goal, until)]
        limit = None if most.__class__ is Atom else most
        steps.append(
            Step(name.name, least, limit, mode.name == "reluctant", continuation.name == "later", *goals)
        )
    return steps


PAST_LAST = "skip_past_last"


def whole_matches(
    steps: Sequence[Step], items: Sequence[Bindings], skip: str = PAST_LAST
) -> List[Assignment]:
    """Return the matches in a list of items that its end decides.

    The strategy after a match may end with the number of a step, as in ``skip_to_last@1``.
    """
    matches: List[Assignment] = []
    position = 0
    while position < len(items):
        match: Any = Trial(steps, items).begin(position)
        if match == OPEN:
            if skip != "skip_to_next":
                return matches
            match = None  # a later start does not depend on it
        if match is None:
            position += 1
        else:
            matches.append(match)
            position = _next_position(match, skip)
    return matches


def decided_matches(steps: Sequence[Step], items: Sequence[Bindings], skip: str = PAST_LAST) -> List[Any]:
    """Return the matches that the last item decides."""
    earlier = whole_matches(steps, items[:-1], skip)
    return [match for match in whole_matches(steps, items, skip) if match not in earlier]


def _next_position(match: Assignment, skip: str) -> int:
    """Return the position at which the search continues after a match."""
    strategy, _, number = skip.partition("@")
    begin = match[0][0]
    if strategy == "skip_to_next":
        return begin + 1
    places = [place for place, step in match if str(step) == number]
    if not places:
        return match[-1][0] + 1
    return max(begin + 1, min(places) if strategy == "skip_to_first" else max(places))


class Trial:
    """Search for a match that begins at an item."""

    def __init__(self, steps: Sequence[Step], items: Sequence[Bindings]) -> None:
        self.steps = steps
        self.items = items

    def begin(self, position: int) -> Any:
        """Return the first match in order, None if there is none, `OPEN` if later events decide."""
        return self._try(self._before(0), position, ())

    def _before(self, step: int) -> List[Any]:
        """Steps that may precede a step without events; None is the end."""
        if step == len(self.steps):
            return [None]
        return self._order(step, self.steps[step].least == 0, True)

    def _order(self, step: int, may_end: bool, may_continue: bool) -> List[Any]:
        """At each Q, the step continues or a following step begins; reluctant steps prefer the latter."""
        same, following = [step] if may_continue else [], self._before(step + 1) if may_end else []
        return following + same if self.steps[step].reluctant else same + following

    def _after(self, assigned: Assignment) -> List[Any]:
        step = assigned[-1][1]
        count = sum(other == step for _, other in assigned)
        most = self.steps[step].most
        return self._order(step, count >= self.steps[step].least, most is None or count < most)

    def _try(self, choices: List[Any], position: int, assigned: Assignment) -> Any:
        if None in choices:
            end = choices.index(None)
            match = self._try_steps(choices[:end], position, assigned, choices[end + 1 :]) if end else None
            return assigned if match is None else match
        return self._try_steps(choices, position, assigned, [])

    def _try_steps(self, choices: List[int], position: int, assigned: Assignment, unused: List[int]) -> Any:
        """Try some steps. Items that fit an unused step, which follows the end, are not skipped."""
        if not choices:
            return None
        if position == len(self.items):
            return OPEN
        open_steps = [step for step in choices if not self._is_over(step, position, assigned)]
        fitting = [step for step in open_steps if self._fits(step, position, assigned)]
        for step in fitting:
            longer = (*assigned, (position, step))
            match = self._try(self._after(longer), position + 1, longer)
            if match is not None:
                return match
        waiting = [step for step in unused if not self._is_over(step, position, assigned)]
        if fitting or not assigned or any(self._fits(step, position, assigned) for step in waiting):
            return None
        later, unused = [
            [step for step in candidates if self.steps[step].later] for candidates in (open_steps, waiting)
        ]
        return self._try_steps(later, position + 1, assigned, unused)

    def _fits(self, step: int, position: int, assigned: Assignment) -> bool:
        goal = self.steps[step].goal
        return goal is None or all(
            holds is not False for holds in self._evaluate(goal, step, position, assigned)
        )

    def _is_over(self, step: int, position: int, assigned: Assignment) -> bool:
        until = self.steps[step].until
        if until is None:
            return False
        results = [holds for holds in self._evaluate(until, step, position, assigned) if holds is not None]
        return bool(results) and all(results)

    def _evaluate(self, goal: Term, step: int, position: int, assigned: Assignment) -> List[Optional[bool]]:
        """Return for each part of a condition whether it holds; None if it refers to a missing earlier item."""
        results: List[Optional[bool]] = []
        for part in conjuncts(goal):
            missing: List[bool] = []

            def past(
                kind: str, name: str, var: Optional[Var], number: int, missing: List[bool] = missing
            ) -> Term:
                is_all = kind == "prev" or name == "match"
                places = [place for place, other in assigned if is_all or self._is(other, name, step)]
                if kind in AGGREGATES:
                    # The current item counts, as if the step of the condition matched it.
                    places += [position] if is_all or self._is(step, name, step) else []
                    values = [instance(var or NONE, self.items[place]) for place in places]
                    result = RESULTS[kind](values) if values else EMPTY_RESULTS.get(kind)
                    missing += [] if result is not None else [True]
                    return NONE if result is None else result
                if len(places) < number:
                    missing.append(True)
                    return var or NONE
                return instance(var or NONE, self.items[places[0 if kind == "first" else -number]])

            condition = insert_past_values(part, past)
            if missing:
                results.append(None)
            else:
                results.append(first(condition, self.items[position]) is not None)
        return results

    def _is(self, other: int, name: str, step: int) -> bool:
        return self.steps[other].name == name if name else other == step


def conjuncts(goal: Term) -> List[Term]:
    """Return the conjuncts of a goal."""
    if goal.__class__ is tuple and goal[0].name == ",":
        return [part for argument in goal[1:] for part in conjuncts(argument)]
    return [goal]


def insert_past_values(term: Term, past: Callable[[str, str, Optional[Var], int], Term]) -> Term:
    """Return a condition in which references to earlier items are replaced by their values."""
    term = value_of(term, {})
    if term.__class__ is not tuple:
        return term
    name, args = term[0].name, term[1:]
    if name in ("prev", "first", "last"):
        args = tuple([STAMPS.get(getattr(argument, "name", ""), argument) for argument in args])
    if name == "prev" and len(args) == 2:
        return past(name, "", args[0], args[1])
    if name == "count":
        return past(name, args[0].name, None, 1)
    if name in ("prev", "first", "last", *AGGREGATES) and args[-1].__class__ is Var and len(args) <= 2:
        return past(name, args[0].name if len(args) == 2 else "", args[-1], 1)
    return (term[0], *(insert_past_values(argument, past) for argument in args))
