"""Windows of steps, by a search of all assignments in their order over the list of all events.

A step is the term ``step(Name, Least, Most, Mode, Where, Goal, Until)``: Most is a number or ``many``, Mode is
``greedy`` or ``reluctant``, Where ``later`` or ``next``, and the goals are lists of none or one. A group is the term
``group(Parts, Least, Most, Mode)``, ``alternatives(Parts)`` or ``permutation(Parts)``.
"""

from typing import Any, Callable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from retalis import Atom, Term, Var, atom, list_items, make_list

from .goal_evaluator import Bindings, first, instance, number, value_of
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
    """Return the steps of a window, from left to right."""
    steps: List[Any] = []
    for step in list_items(term) or []:
        if step[0].name != "step":  # type: ignore[index]
            steps += steps_of(step[1])  # type: ignore[index]
            continue
        name, least, most, mode, continuation, goal, until = step[1:]  # type: ignore[index]
        goals = [next(iter(list_items(part) or []), None) for part in (goal, until)]
        limit = None if most.__class__ is Atom else most
        steps.append(
            Step(name.name, least, limit, mode.name == "reluctant", continuation.name == "later", *goals)
        )
    return steps


PAST_LAST = "skip_past_last"


def whole_matches(term: Term, items: Sequence[Bindings], skip: str = PAST_LAST) -> List[Assignment]:
    """Return the matches in a list of items that its end decides.

    The strategy after a match may end with the number of a step, as in ``skip_to_last@1``.
    """
    matches: List[Assignment] = []
    trial = Trial(steps_of(term), items, list_items(term))
    position = 0
    while position < len(items):
        match: Any = trial.begin(position)
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


def decided_matches(term: Term, items: Sequence[Bindings], skip: str = PAST_LAST) -> List[Any]:
    """Return the matches that the last item decides."""
    earlier = whole_matches(term, items[:-1], skip)
    return [match for match in whole_matches(term, items, skip) if match not in earlier]


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


def timed_out_match(term: Term, items: Sequence[Bindings], position: int) -> Optional[Assignment]:
    """Return the preferred match from an item that later items would decide, if none is complete; else None."""
    trial = Trial(steps_of(term), items, list_items(term))
    if trial.begin(position) != OPEN:
        return None
    assigned = trial.open_match
    trial.is_ended = True
    return assigned if trial.begin(position) in (None, OPEN) else None


class Trial:
    """Search for a match that begins at an item.

    The rest of a pattern is a tuple of parts. A part is a term of the pattern, or the tuple of a step, or of a group
    with a term, and the number of its items, or repetitions, so far.
    """

    def __init__(self, steps: Sequence[Step], items: Sequence[Bindings], parts: Any):
        self.steps = steps
        self.items = items
        self.numbers = {step.name: number for number, step in enumerate(steps)}
        self.parts = tuple(parts)
        self.open_match: Assignment = ()
        """The match that was open when the items ended."""
        self.is_ended = False
        """Whether no items follow, so that a match is open only if it would complete in any case."""

    def begin(self, position: int) -> Any:
        """Return the first match in order, None if there is none, `OPEN` if later events decide."""
        return self._try(self._choices(self.parts), position, ())

    def _choices(self, rest: Tuple[Any, ...]) -> List[Any]:
        """Return the steps that may match the next item, each with the rest after it; None is the end."""
        if not rest:
            return [None]
        part, *others = rest
        if part[0].__class__ is int:
            number, taken = part
            step = self.steps[number]
            same = (
                [(number, ((number, taken + 1), *others))] if step.most is None or taken < step.most else []
            )
            following = self._choices(tuple(others)) if taken >= step.least else []
            return following + same if step.reluctant else same + following
        if part[0] == "group":
            _, group, taken = part
            least, most, mode = group[2:]
            again: List[Any] = []
            if most.__class__ is Atom or taken < most:
                inside = (*(list_items(group[1]) or ()), ("group", group, taken + 1), *others)
                again = self._choices(inside)
            following = self._choices(tuple(others)) if taken >= least else []
            return following + again if mode.name == "reluctant" else again + following
        kind = part[0].name
        if kind == "step":
            return self._choices(((self.numbers[part[1].name], 0), *others))
        if kind == "group":
            return self._choices((("group", part, 0), *others))
        inner = list_items(part[1]) or []
        if kind == "alternatives":
            return [choice for one in inner for choice in self._choices((one, *others))]
        # In any order: one of the parts, then the others in any order.
        if not inner:
            return self._choices(tuple(others))
        return [
            choice
            for place, one in enumerate(inner)
            for choice in self._choices(
                (one, (part[0], make_list(inner[:place] + inner[place + 1 :])), *others)
            )
        ]

    def _try(self, choices: List[Any], position: int, assigned: Assignment) -> Any:
        if None in choices:
            end = choices.index(None)
            unused = [choice for choice in choices[end + 1 :] if choice is not None]
            match = self._try_steps(choices[:end], position, assigned, unused) if end else None
            return assigned if match is None else match
        return self._try_steps(choices, position, assigned, [])

    def _try_steps(self, choices: List[Any], position: int, assigned: Assignment, unused: List[Any]) -> Any:
        """Try some steps. Items that fit an unused step, which follows the end, are not skipped."""
        if not choices:
            return None
        if position == len(self.items):
            self.open_match = assigned
            is_certain = all(
                self.steps[step].later and self.steps[step].until is None for step in self._reachable(choices)
            )
            return OPEN if is_certain or not self.is_ended else None
        open_choices = [choice for choice in choices if not self._is_over(choice[0], position, assigned)]
        fitting = [choice for choice in open_choices if self._fits(choice[0], position, assigned)]
        for step, rest in fitting:
            match = self._try(self._choices(rest), position + 1, (*assigned, (position, step)))
            if match is not None:
                return match
        waiting = [choice for choice in unused if not self._is_over(choice[0], position, assigned)]
        if fitting or not assigned or any(self._fits(choice[0], position, assigned) for choice in waiting):
            return None
        later, unused = [
            [choice for choice in candidates if self.steps[choice[0]].later]
            for candidates in (open_choices, waiting)
        ]
        return self._try_steps(later, position + 1, assigned, unused)

    def _reachable(self, choices: List[Any]) -> Iterator[int]:
        """Yield the steps that may match later items."""
        for step, rest in choices:
            yield step
            for part in rest:
                if part[0].__class__ is int:
                    yield part[0]
                elif part[0] == "group":
                    is_over = part[1][3].__class__ is int and part[2] >= part[1][3]
                    yield from [] if is_over else self._steps_in(part[1])
                else:
                    yield from self._steps_in(part)

    def _steps_in(self, part: Any) -> List[int]:
        return [self.numbers[step.name] for step in steps_of(make_list([part]))]

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

            def past(kind: str, name: str, value: Term, distance: int, missing: List[bool] = missing) -> Term:
                is_all = kind == "prev" or name == "match"
                places = [place for place, other in assigned if is_all or self._is(other, name, step)]
                if kind in AGGREGATES:
                    # The current item counts, as if the step of the condition matched it.
                    places += [position] if is_all or self._is(step, name, step) else []
                    values = [
                        instance(value, self.items[place])
                        if value.__class__ in (Atom, Var)
                        else number(value, self.items[place])
                        for place in places
                    ]
                    result = RESULTS[kind](values) if values else EMPTY_RESULTS.get(kind)
                    missing += [] if result is not None else [True]
                    return NONE if result is None else result
                if len(places) < distance:
                    missing.append(True)
                    return value
                return instance(value, self.items[places[0 if kind == "first" else -distance]])

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


def insert_past_values(term: Term, past: Callable[[str, str, Term, int], Term]) -> Term:
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
        return past(name, args[0].name, NONE, 1)
    is_past = name in ("prev", "first", "last") and args[-1].__class__ is Var
    if len(args) <= 2 and (is_past or name in AGGREGATES):
        return past(name, args[0].name if len(args) == 2 else "", args[-1], 1)
    return (term[0], *(insert_past_values(argument, past) for argument in args))
