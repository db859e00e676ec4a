"""The evaluator: each arriving event is handed to the whole pattern, which looks at plain lists of all that waits.

Nothing here is fast and nothing is shared: no index, no expiry unless it is asked for, one list for each operand
place. Quotations in comments are the sentences of the language's definition that the code next to them realises.
Times are any exact numbers, in seconds.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Callable, Dict, FrozenSet, Iterable, List, NamedTuple, Optional, Sequence, Tuple

from retalis.terms import Term, Var, copy, variables

from .goals import (
    Bindings,
    GoalError,
    first,
    instance,
    make_list,
    merge,
    number,
    quotient,
    show,
    solve,
    unbound,
    unify,
)
from .patterns import (
    EITHER_ORDER,
    Aggregate,
    Both,
    Check,
    Cnot,
    Do,
    Fnot,
    Leaf,
    Multiply,
    Or,
    Pattern,
    Prolog,
    Rule,
    Star,
    Where,
    Within,
    children,
    expand,
    parts,
    pattern_variables,
    strip,
    take_out_subpatterns,
    walk,
)

POLICIES = ("recent", "recent_2", "chronological", "chronological_2", "unrestricted")


class Event(NamedTuple):
    """An occurrence: ``number`` counts arrivals."""

    term: Term
    start: Any
    end: Any
    number: int = 0


@dataclass(frozen=True, eq=False)
class Pending:
    """A condition that waits for variables of patterns to its left, with the interval that it is about."""

    goal: Term
    facts: Dict[str, Term]


@dataclass(frozen=True, eq=False)
class Match:
    """An occurrence of a pattern: its interval, what its variables stand for, and the events that make it up."""

    start: Any
    end: Any
    bindings: Bindings
    terms: Tuple[Tuple[int, str], ...]
    """For each leaf that took part: its place in the rule and the text of its event; no repetitions."""
    numbers: FrozenSet[int]
    """The numbers of all events that make up this match."""
    pending: Tuple[Pending, ...] = ()

    def variant(self) -> Any:
        """Return a key that two matches share when they are the very same event term."""
        values = sorted((id(var), show(var, self.bindings)) for var in self.bindings)
        return self.terms, tuple(values)


@dataclass(eq=False)
class Run:
    """A running star_times or aggregate: its start, where it stands, and what it has collected."""

    start: Match
    now: Match
    values: List[Any] = field(default_factory=list)


Test = Callable[[Match], Optional[Match]]


def overlap(p: Match, q: Match) -> bool:
    return max(p.start, q.start) < min(p.end, q.end)


# "fires when": the table of patterns, column two.
FIRES: Dict[str, Callable[[Match, Match], bool]] = {
    "seq": lambda p, q: p.end < q.start,
    "forall_seq": lambda p, q: p.end < q.start,
    "and": lambda p, q: True,
    "par": overlap,
    "equals": lambda p, q: p.start == q.start and p.end == q.end,
    "meets": lambda p, q: p.end == q.start,
    "during": lambda p, q: q.start <= p.start and p.end <= q.end,
    "starts": lambda p, q: p.start == q.start and p.end < q.end,
    "finishes": lambda p, q: p.end == q.end and q.start < p.start,
}

# "interval": column three.
INTERVAL: Dict[str, Callable[[Match, Match], Tuple[Any, Any]]] = {
    "seq": lambda p, q: (p.start, q.end),
    "forall_seq": lambda p, q: (p.start, q.end),
    "and": lambda p, q: (min(p.start, q.start), max(p.end, q.end)),
    "par": lambda p, q: (min(p.start, q.start), max(p.end, q.end)),
    "equals": lambda p, q: (q.start, q.end),
    "meets": lambda p, q: (p.start, q.end),
    "during": lambda p, q: (q.start, q.end),
    "starts": lambda p, q: (q.start, q.end),
    "finishes": lambda p, q: (q.start, q.end),
}


class RuleState:
    """One rule and everything that waits in it."""

    def __init__(self, rule: Rule, policy: str, out_of_order: bool = False, expiry: bool = False):
        self.rule = rule
        self.pattern = expand(rule.pattern)
        self.policy = policy
        self.consuming = policy != "unrestricted"
        self.out_of_order = out_of_order
        self.expiry = expiry
        self.clock: Any = None
        self.waiting: Dict[Tuple[Pattern, str], List[Match]] = {}
        self.runs: Dict[Pattern, List[Run]] = {}
        self.place = {node: at for at, node in enumerate(walk(self.pattern))}
        self.left_of: Dict[Pattern, List[Var]] = {}
        self._note_left(self.pattern, [])
        self.limits: Dict[Pattern, List[Any]] = {}
        self._note_limits(self.pattern, [])

    def _note_left(self, node: Pattern, before: List[Var]) -> None:
        """Note for each pattern which variables stand to its left."""
        self.left_of[node] = list(before)
        seen = list(before)
        for part in parts(node):
            if isinstance(part, Pattern):
                self._note_left(part, seen)
                seen += pattern_variables(part)
            elif part is not None and not isinstance(part, (str, bool)):
                seen += variables(part)

    def _note_limits(self, node: Pattern, limits: List[Any]) -> None:
        """Note for each pattern the seconds of each within around it."""
        if isinstance(node, Within):
            limits = [*limits, node.seconds]
        self.limits[node] = limits
        for child in children(node):
            self._note_limits(child, limits)

    # An event arrives.

    def fired_by(self, event: Event) -> List[Event]:
        """Take an event and return the events that the rule derives from it, in order."""
        self._advance(event)
        fired = []
        for match in self.arrive(self.pattern, event):
            if not self._in_window(match):
                continue
            if self.rule.do is not None:  # "H do G <- P": as P do G
                solution = first(self.rule.do, match.bindings)
                if solution is None:
                    continue
                match = replace(match, bindings=solution)
            fired.append(Event(copy(instance(self.rule.head, match.bindings)), match.start, match.end))
        return fired

    def arrive(self, node: Pattern, event: Event) -> List[Match]:
        """Return the matches of a pattern that an event completes, in order."""
        operator, conditions = strip(node)
        tests = [self._test_of(condition) for condition in conditions]
        if isinstance(operator, Cnot):
            inner, between = strip(operator.pattern)
            if isinstance(inner, Both) and inner.kind == "seq":
                # "(P seq Q) cnot R"; cnot "looks through conditions and labels to a seq"
                self.waiting.setdefault((operator, "absent"), [])
                self.waiting[operator, "absent"] += self.arrive(operator.absent, event)
                lower = [self._test_of(condition) for condition in between]
                return self._two_sided(inner, event, [*lower, *tests], operator)
        if isinstance(operator, Leaf):
            matches = self._leaf(operator, event)
        elif isinstance(operator, Or):
            matches = self.arrive(operator.left, event) + self.arrive(operator.right, event)
        elif isinstance(operator, Both):
            return self._two_sided(operator, event, tests, None)
        elif isinstance(operator, (Star, Aggregate)):
            return self._repetition(operator, event, conditions)
        elif isinstance(operator, Do):
            # "G is called once before the result fires; if G fails nothing fires"
            matches = [
                replace(match, bindings=solution)
                for match in self.arrive(operator.pattern, event)
                for solution in [first(operator.goal, match.bindings)]
                if solution is not None
            ]
        elif isinstance(operator, Multiply):
            matches = [
                replace(match, bindings=solution)
                for match in self.arrive(operator.pattern, event)
                for solution in _all(operator.goal, match.bindings)
            ]
        else:
            assert isinstance(operator, (Cnot, Fnot))
            matches = self._never_before(operator, event)
        settled = [found for match in matches for found in [self._settle(match, operator)] if found]
        return [passed for match in settled for passed in [self._passes(match, tests)] if passed]

    # Single patterns.

    def _leaf(self, node: Leaf, event: Event) -> List[Match]:
        """ "an event unifies with E": "its own" interval."""
        bindings = unify(node.term, copy(event.term), {})
        if bindings is None:
            return []
        taken = ((self.place[node], show(event.term)),)
        return [Match(event.start, event.end, bindings, taken, frozenset([event.number]))]

    def _never_before(self, node: Any, event: Event) -> List[Match]:
        """ "P, and no matching R ended before P started"."""
        absent = self.waiting.setdefault((node, "absent"), [])
        absent += self.arrive(node.absent, event)
        return [
            match
            for match in self.arrive(node.pattern, event)
            if not any(r.end < match.start and self._agree(r, match) for r in absent)
        ]

    # Two sides.

    def _two_sided(self, node: Both, event: Event, tests: List[Test], cnot: Optional[Cnot]) -> List[Match]:
        lefts = self.arrive(node.left, event)
        rights = self.arrive(node.right, event)
        p_waiting = self.waiting.setdefault((node, "left"), [])
        q_waiting = self.waiting.setdefault((node, "right"), [])

        def fit(p: Match, q: Match) -> Optional[Match]:
            return self._fit(node, p, q, tests, cnot)

        if node.kind in EITHER_ORDER:
            return self._either_order(lefts, rights, p_waiting, q_waiting, fit)
        # "An event that fits both sides completes first, then waits."
        results: List[Match] = []
        for q in rights:
            if node.kind == "forall_seq":
                # "for all waiting P at once (identical terms too, oldest first), which are used up under every policy"
                results += self._take(p_waiting, lambda p, q=q: fit(p, q), "all", used_up=True)
            else:
                results += self._complete(p_waiting, lambda p, q=q: fit(p, q))
        late = []
        for p in lefts:
            # "takes a late first side only under out_of_order(on)"
            found = self._complete(q_waiting, lambda q, p=p: fit(p, q)) if self.out_of_order else []
            results += found
            # "having matched, it does not wait for others (except under unrestricted ...)"
            late.append(bool(found) and (self.consuming or node.kind == "forall_seq"))
        for p, matched in zip(lefts, late):
            if not matched:
                self._wait(p_waiting, p, identical_too=node.kind == "forall_seq")
        for q in rights if self.out_of_order else ():
            # "the second side of a seq under out_of_order(on), which also waits for late first sides"
            self._wait(q_waiting, q)
        return results

    def _either_order(
        self,
        lefts: List[Match],
        rights: List[Match],
        p_waiting: List[Match],
        q_waiting: List[Match],
        fit: Callable[[Match, Match], Optional[Match]],
    ) -> List[Match]:
        """ "Every two-sided pattern but seq takes its sides in either order of arrival."

        Composed sides come first, left before right; then the event itself where it is a side: first as the
        right side, then as the left one.
        """
        results: List[Match] = []
        completed = False

        def as_left(p: Match, may_complete: bool = True) -> bool:
            found = self._complete(q_waiting, lambda q: fit(p, q)) if may_complete else []
            results.extend(found)
            if not found or not self.consuming:
                self._wait(p_waiting, p)
            return bool(found)

        def as_right(q: Match) -> bool:
            found = self._complete(p_waiting, lambda p: fit(p, q))
            results.extend(found)
            if not found or not self.consuming:
                self._wait(q_waiting, q)
            return bool(found)

        for p in lefts:
            if len(p.numbers) > 1:
                as_left(p)
        for q in rights:
            if len(q.numbers) > 1:
                as_right(q)
        for q in rights:
            if len(q.numbers) == 1:
                completed |= as_right(q)
        for p in lefts:
            if len(p.numbers) == 1:
                # "An event that fits both sides completes first, then waits": it completes once.
                as_left(p, may_complete=not (completed and self.consuming))
        return results

    def _fit(
        self, node: Both, p: Match, q: Match, tests: List[Test], cnot: Optional[Cnot]
    ) -> Optional[Match]:
        """ "Fits means all of the test: times, shared variables, conditions, windows"."""
        if not FIRES[node.kind](p, q):
            return None
        # "An event never pairs with itself: one single event is not both sides; composed sides may share events."
        if len(p.numbers) == 1 and p.numbers == q.numbers:
            return None
        start, end = INTERVAL[node.kind](p, q)
        match = self._join(p, q, start, end, node)
        if match is None or not self._in_window(match):
            return None
        if cnot is None:
            return self._passes(match, tests)
        match = self._passes(match, tests)
        if match is None:
            return None
        # "no matching R lay wholly between (e1 < sR and eR < s2)"; "an R is never used up"
        for r in self.waiting[cnot, "absent"]:
            if p.end < r.start and r.end < q.start and self._agree(r, match):
                return None
        return match

    def _join(self, p: Match, q: Match, start: Any, end: Any, node: Pattern) -> Optional[Match]:
        bindings = merge(p.bindings, q.bindings)
        if bindings is None:
            return None
        match = Match(start, end, bindings, p.terms + q.terms, p.numbers | q.numbers, p.pending + q.pending)
        return self._settle(match, node)

    # Who is taken, and who waits.

    def _complete(self, waiting: List[Match], fit: Callable[[Match], Optional[Match]]) -> List[Match]:
        return self._take(waiting, fit, self.policy, used_up=self.consuming)

    @staticmethod
    def _take(
        waiting: List[Match], fit: Callable[[Match], Optional[Match]], policy: str, used_up: bool
    ) -> List[Match]:
        """Return the results of a completing event with the partners that its policy takes.

        ``waiting`` is in order of arrival: "newest and oldest mean arrival, never stamps".
        """
        candidates = list(reversed(waiting)) if policy.startswith("recent") else list(waiting)
        results = []
        for partner in candidates:
            result = fit(partner)
            if result is None:
                continue  # "a partner that they reject stays where it was"
            results.append(result)
            if used_up:
                waiting.remove(partner)
            if policy.startswith(("recent", "chronological")):
                break  # "the newest that fits", "the oldest that fits"; else "all that fit, oldest first"
        return results

    def _wait(self, waiting: List[Match], match: Match, identical_too: bool = False) -> None:
        if self.policy == "recent" and not identical_too:
            # "An arrival under recent replaces the waiting variant at the same place, whatever the stamps."
            variant = match.variant()
            waiting[:] = [other for other in waiting if other.variant() != variant]
        waiting.append(match)

    # Repetition.

    def _repetition(self, node: Any, event: Event, conditions: List[Pattern]) -> List[Match]:
        runs = self.runs.setdefault(node, [])
        starts = self.arrive(node.first, event)
        results: List[Match] = []
        for q in self.arrive(node.repeated, event):
            for run in self._order(runs):
                result = self._extended(node, run, q, conditions)
                if result is None:
                    continue
                results += result
                if self.consuming:
                    break  # "recent extends the newest that fits, chronological the oldest, unrestricted all"
        for p in starts:
            if any(run.start.variant() == p.variant() and _stamps(run.start) == _stamps(p) for run in runs):
                continue  # "a start with the same term and stamps as a running one adds none"
            if self.policy == "recent":
                # "Under recent a newer start with the same term replaces the older."
                runs[:] = [run for run in runs if run.start.variant() != p.variant()]
            run = Run(p, p)
            runs.append(run)
            # "P (zero repetitions)"; "count, sum and list fire at P with 0, 0 and []"
            results += self._result(node, run, conditions)
        return results

    def _order(self, runs: List[Run]) -> List[Run]:
        return list(reversed(runs)) if self.policy.startswith("recent") else list(runs)

    def _extended(self, node: Any, run: Run, q: Match, conditions: List[Pattern]) -> Optional[List[Match]]:
        """Extend a run in place and return what fires, or None where the repetition does not fit."""
        # "each Q starts after the last one (or P) ended"; for an aggregate "each Q must start after P ended"
        last = run.now if isinstance(node, Star) else run.start
        if not last.end < q.start:
            return None
        # "the end is the largest so far"
        joined = self._join(run.now, q, run.start.start, max(run.now.end, q.end), node)
        if joined is None or not self._in_window(joined):
            return None
        fits = [
            self._test_of(condition) for condition in conditions if not self._about_result(node, condition)
        ]
        if self._passes(joined, fits) is None:
            return None
        values = run.values
        if isinstance(node, Aggregate):
            try:
                values = [*run.values, self._value(node, joined)]
            except GoalError:
                return None
        run.values = values
        # "A variable of Q that stands elsewhere in the rule has one value for the whole match, set by the first
        # repetition; any other is fresh each time."
        fresh = self._only_inside(node)
        kept = {var: instance(var, joined.bindings) for var in joined.bindings if var not in fresh}
        run.now = replace(joined, bindings=kept, terms=run.start.terms)
        return self._result(node, run, conditions)

    def _value(self, node: Aggregate, match: Match) -> Any:
        if node.value is None:
            return 1
        value = instance(node.value, match.bindings)
        return value if node.kind == "list" else number(value, match.bindings)

    def _result(self, node: Any, run: Run, conditions: List[Pattern]) -> List[Match]:
        match: Optional[Match] = run.now
        if not self._in_window(run.now):
            return []
        if isinstance(node, Aggregate):
            value = AGGREGATES[node.kind](run.values)
            if value is None:
                return []  # "min, max and avg fire with the first Q"
            bindings = unify(node.result, value, run.now.bindings)
            if bindings is None:
                return []
            match = replace(run.now, bindings=bindings)
        assert match is not None
        match = self._passes(match, [self._test_of(condition) for condition in conditions])
        return [] if match is None else [match]

    def _about_result(self, node: Any, condition: Pattern) -> bool:
        """Tell whether a condition asks for the result of an aggregate: then it chooses what fires, not the run."""
        if isinstance(node, Star) or isinstance(condition, Within):
            return False
        return bool(unbound(node.result, {}) & unbound(condition.goal, {}))  # type: ignore[attr-defined]

    def _only_inside(self, node: Any) -> FrozenSet[Var]:
        """Return the variables of the repeated pattern that stand nowhere else in the rule."""
        outside = set(variables(self.rule.head))
        if self.rule.do is not None:
            outside |= set(variables(self.rule.do))

        def gather(other: Pattern) -> None:
            for part in parts(other):
                if part is node.repeated or (other is node and part is getattr(node, "value", None)):
                    continue
                if isinstance(part, Pattern):
                    gather(part)
                elif part is not None and not isinstance(part, (str, bool)):
                    outside.update(variables(part))

        gather(self.pattern)
        return frozenset(set(pattern_variables(node.repeated)) - outside)

    # Conditions and windows.

    def _test_of(self, condition: Pattern) -> Test:
        if isinstance(condition, Within):
            # "P within N: e - s < N seconds"
            return lambda match: match if match.end - match.start < condition.seconds else None
        assert isinstance(condition, (Where, Check))

        def test(match: Match) -> Optional[Match]:
            facts = {"t1": match.start, "t2": match.end} if isinstance(condition, Check) else {}
            waits = replace(match, pending=(*match.pending, Pending(condition.goal, facts)))
            return self._settle(waits, condition)

        return test

    def _settle(self, match: Match, node: Pattern) -> Optional[Match]:
        """Call the conditions of a match that wait for nothing more to the left; None where one does not hold.

        "A condition under several operators sees all variables of the patterns to its left".
        """
        kept: List[Pending] = []
        bindings = match.bindings
        for item in match.pending:
            if unbound(item.goal, bindings) & set(self.left_of[node]):
                kept.append(Pending(instance(item.goal, bindings), item.facts))
                continue
            solution = first(item.goal, bindings, item.facts)  # "the goal G has a solution (first one)"
            if solution is None:
                return None
            bindings = solution
        return replace(match, bindings=bindings, pending=tuple(kept))

    @staticmethod
    def _passes(match: Match, tests: Iterable[Test]) -> Optional[Match]:
        result: Optional[Match] = match
        for test in tests:
            if result is not None:
                result = test(result)
        return result

    def _agree(self, absent: Match, match: Match) -> bool:
        """Tell whether an R is one that matches: its variables agree, and so does what it left open."""
        bindings = merge(match.bindings, absent.bindings)
        for item in absent.pending:
            if bindings is not None:
                bindings = first(item.goal, bindings, item.facts)
        return bindings is not None

    def _in_window(self, match: Match) -> bool:
        """ "fires if e - s =< V seconds, exactly, tested at every operator of the rule on the interval so far"."""
        return self.rule.window is None or match.end - match.start <= self.rule.window

    # The rule's clock.

    def _advance(self, event: Event) -> None:
        """ "A rule's clock is the newest end among events that its own patterns matched; windows expire by it"."""
        leaves = [node for node in self.place if isinstance(node, Leaf)]
        if any(unify(leaf.term, copy(event.term), {}) is not None for leaf in leaves):
            self.clock = event.end if self.clock is None else max(self.clock, event.end)
        if not self.expiry or self.clock is None:
            return
        for (node, side), waiting in self.waiting.items():
            if side != "absent":
                waiting[:] = [match for match in waiting if not self._expired(node, match)]
        for node, runs in self.runs.items():
            runs[:] = [run for run in runs if not self._expired(node, run.start)]

    def _expired(self, node: Pattern, match: Match) -> bool:
        """ "a match that can no longer complete is removed"."""
        age = self.clock - match.start
        if self.rule.window is not None and age > self.rule.window:
            return True
        return any(age >= seconds for seconds in self.limits[node])


def _stamps(match: Match) -> Tuple[Any, Any]:
    return match.start, match.end


def _all(goal: Term, bindings: Bindings) -> List[Bindings]:
    """ "once for every solution of G, in order"; none of a goal that raises an error."""
    try:
        return list(solve(goal, bindings))
    except GoalError:
        return []


AGGREGATES: Dict[str, Callable[[List[Any]], Any]] = {
    "count": len,
    "sum": sum,
    "list": make_list,
    "min": lambda values: min(values) if values else None,
    "max": lambda values: max(values) if values else None,
    "avg": lambda values: quotient(sum(values), len(values)) if values else None,
}


class Program:
    """Rules and their state: takes events and returns everything that is dispatched."""

    def __init__(
        self,
        rules: Sequence[Rule],
        policy: str = "recent",
        out_of_order: bool = False,
        expiry: bool = False,
        depth: int = 50,
    ):
        assert policy in POLICIES
        self.states = [
            RuleState(rule, policy, out_of_order, expiry) for rule in take_out_subpatterns(list(rules))
        ]
        self.depth = depth
        self.count = 0

    def event(self, term: Term, start: Any, end: Any, depth: int = 0) -> List[Event]:
        """Dispatch an event: return it and all that is derived from it, in order of dispatch.

        "depth first ... the rules, oldest first. An event derived inside is finished before the next rule of the
        outer event."
        """
        if depth > self.depth:
            raise RecursionError("rules that feed each other without end")
        self.count += 1
        event = Event(term, start, end, self.count)
        dispatched = [event]
        for state in self.states:
            for derived in state.fired_by(event):
                dispatched += self.event(derived.term, derived.start, derived.end, depth + 1)
        return dispatched


def run(
    rules: Sequence[Rule], stream: Iterable[Tuple[Term, Any, Any]], **options: Any
) -> List[Tuple[str, Any, Any]]:
    """Run a program over a stream and return all dispatched events: text of the term, start and end."""
    program = Program(rules, **options)
    return [
        (show(event.term), event.start, event.end)
        for term, start, end in stream
        for event in program.event(term, start, end)
    ]


__all__ = ["POLICIES", "Event", "Match", "Program", "Prolog", "RuleState", "run"]
