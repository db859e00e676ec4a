"""Operators on streams: windows, shapes, absence with a deadline. Comments name the sentences of the definition.

What came to an operator is kept in a plain list for ever; who is in a window is looked for among all of them.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from retalis import Term, Var, list_items, make_list
from retalis.prolog.terms.term_traversal import variables
from retalis.prolog.terms.types import NIL

from .goals import Bindings, GoalError, instance, number, quotient, show, unbound, unify
from .matches import Event, Match
from .patterns import Aggregate, Awaited, Both, Pattern, Shaped, Star, Windowed, children
from .repetition_runs import IdentifyingRepetitions
from .row_pattern_matches import steps_of, whole_matches
from .rule_conditions import may_bind


@dataclass(eq=False)
class Taken:
    """A match that came to an operator."""

    match: Match
    key: Any
    values: List[Any]
    now: Any
    """When it came, by the clock."""
    newest: Any = None
    """The newest end of all that came to the operator until then."""
    entered: Any = None
    """Of a window that is given on at an instant: at the end of which one it was in for the first time."""
    on: bool = False
    """Whether it was let through."""
    over: bool = False
    """Whether its window is over, or it waits no more."""


class Streams(IdentifyingRepetitions):
    """The operators on streams of one rule."""

    def __init__(self, rule: Any, policy: str, out_of_order: bool = False, expiry: bool = True) -> None:
        super().__init__(rule, policy, out_of_order, expiry)
        self.taken: Dict[Pattern, List[Taken]] = {}
        self.absences: Dict[Pattern, List[Match]] = {}
        self.begins: Dict[Pattern, Dict[Any, Any]] = {}
        self.latest: Dict[Pattern, Any] = {}
        """The newest present instant at which something came to an operator."""
        self.newest: Dict[Pattern, Any] = {}
        self.now: Any = 0
        self.ringing: Optional[Tuple[int, Any]] = None
        self.rank = {node: at for at, node in enumerate(from_below(self.pattern))}

    def arrive(self, node: Pattern, event: Event) -> List[Match]:
        """Return the matches of a pattern that an event completes, in order."""
        raise NotImplementedError

    def streamed(self, node: Any, event: Event) -> List[Match]:
        """Return the results of an operator on streams."""
        results: List[Match] = []
        if self.ringing is not None and self.ringing[0] == self.rank[node]:
            results += self._rung(node, self.ringing[1])
        if isinstance(node, Awaited):
            for q in self.arrive(node.absent, event):
                self.now_at(node)
                self.absences.setdefault(node, []).append(q)
            for p in self.arrive(node.pattern, event):
                self._await(node, p)
            return results
        below = node.collected if isinstance(node, Windowed) else node.pattern
        for match in self.arrive(below, event):
            results += (
                self._measured(node, match) if isinstance(node, Windowed) else self._shaped(node, match)
            )
        return results

    def now_at(self, node: Pattern) -> Any:
        """Return the present instant for what comes to an operator; alarms of the past do not turn its time back."""
        self.latest[node] = max(self.now, self.latest.get(node, self.now))
        return self.latest[node]

    def due(self) -> List[Tuple[Any, int]]:
        """Return when something is due, and the rank of its operator."""
        found: List[Any] = []
        for node in self.taken:
            instants = self._instants(node)
            if instants:
                found.append((min(instants), self.rank[node]))
        return found

    def _instants(self, node: Any) -> List[Any]:
        waiting = [one for one in self.taken[node] if not one.over]
        if isinstance(node, Awaited) or (isinstance(node, Shaped) and node.shape == "debounce"):
            return [one.match.end + node.seconds for one in waiting]
        if isinstance(node, Windowed) and node.window in ("first", "running_first"):
            return [self.begins[node][one.key] + node.span for one in waiting]
        if isinstance(node, Windowed) and node.window == "every":
            return [
                at
                for one in waiting
                for at in self._windows_of(node, one)
                if at > max(one.now, self.reached(node))
            ]
        return []

    def reached(self, node: Pattern) -> Any:
        """Return the last instant at which an operator has emitted windows."""
        return self.newest.get(node, 0)

    @staticmethod
    def _windows_of(node: Any, one: Taken) -> List[Any]:
        """Windows: at each multiple t of M, those with t - N <= end < t."""
        first = (one.match.end // node.step + 1) * node.step
        found: List[Any] = []
        while first <= one.match.end + node.span:
            found.append(first)
            first += node.step
        return found

    # Absence with a deadline.

    def _await(self, node: Awaited, p: Match) -> None:
        taken = self.taken.setdefault(node, [])
        # Absence: a P that comes when its time is over is too late.
        if p.end + node.seconds <= self.now_at(node):
            return
        if self.policy == "recent":
            # Absence: of two waiting variants that end less than N seconds apart, the later one replaces the other.
            waiting = [one for one in taken if not one.over and one.match.variant() == p.variant()]
            for one in waiting:
                one.over = one.match.end <= p.end < one.match.end + node.seconds
            if any(p.end < one.match.end < p.end + node.seconds for one in waiting):
                return
        taken.append(Taken(p, None, [], self.now))

    def _ruled_out(self, node: Awaited, p: Match) -> bool:
        """Absence: a Q wholly between P's end and N seconds later, about the same."""
        return any(
            p.end < q.start and q.end < p.end + node.seconds and self.agree(q, p.bindings)
            for q in self.absences.get(node, [])
        )

    # Shapes.

    def _shaped(self, node: Shaped, match: Match) -> List[Match]:
        taken = self.taken.setdefault(node, [])
        key = [self._key(instance(term, match.bindings)) for term in list_items(node.by) or []]
        value = [self._key(instance(term, match.bindings)) for term in list_items(node.value) or []]
        newest = max([match.end, *(one.match.end for one in taken)])
        same = [one for one in taken if one.key == key]
        one = Taken(match, key, value, self.now, newest)
        taken.append(one)
        if node.shape == "throttle":
            # none that was let through ends less than N seconds before the newest end
            one.on = not any(other.on and other.match.end > newest - node.seconds for other in same)
        elif node.shape == "burst":
            # none at all does
            one.on = not any(other.match.end > newest - node.seconds for other in same)
        elif node.shape == "change":
            # another value than in the last one
            before = self._not_idle(node, [*same, one])[:-1]
            one.on = not before or before[-1].values != value
        elif match.end + node.seconds <= self.now_at(node):
            one.over = True  # debounce: one that comes when its time is over is too late
        else:
            # debounce: waits for N seconds from its end; one with an end within these, as late or later, rules it out
            waiting = [other for other in same if not other.over]
            one.over = any(match.end < other.match.end < match.end + node.seconds for other in waiting)
            for other in waiting:
                other.over = other.match.end <= match.end < other.match.end + node.seconds
        return [match] if one.on else []

    # Windows.

    def _measured(self, node: Windowed, match: Match) -> List[Match]:
        taken = self.taken.setdefault(node, [])
        try:
            values = self._values(node, match)
        except GoalError:
            return []
        newest = max([match.end, *(other.match.end for other in taken)])
        one = Taken(match, self._group(node, match), values, self.now_at(node), newest)
        return self._window[node.window](self, node, taken, one, newest)

    def _not_idle(self, node: Pattern, same: List[Taken]) -> List[Taken]:
        """State of keys: after a time in which a within or a window lets nothing complete, a key begins anew."""
        for at in range(len(same) - 1, 0, -1):
            idle = same[at].newest - same[at - 1].newest
            window = self.rule.window
            if any(idle >= limit for limit in self.limits[node]) or (window is not None and idle > window):
                return same[at:]
        return same

    def _last(self, node: Windowed, taken: List[Taken], one: Taken, newest: Any) -> List[Match]:
        """last(N): those that began less than N seconds before the newest end; one that did not is late."""
        taken.append(one)
        inside = [other for other in taken if other.match.start > newest - node.span and other.key == one.key]
        return self._given(node, inside) if one in inside else []

    def _newest(self, node: Windowed, taken: List[Taken], one: Taken, newest: Any) -> List[Match]:
        taken.append(one)
        same = [other for other in taken if other.key == one.key]
        return self._given(node, self._not_idle(node, same)[-node.span :])

    def _batch(self, node: Windowed, taken: List[Taken], one: Taken, newest: Any) -> List[Match]:
        taken.append(one)
        same = self._not_idle(node, [other for other in taken if other.key == one.key])
        size = (len(same) - 1) % node.span + 1
        if node.window == "running_batch" or size == node.span:
            return self._given(node, same[-size:])
        return []

    def _running(self, node: Windowed, taken: List[Taken], one: Taken, newest: Any) -> List[Match]:
        """running(every(N)): those of the window of the newest end; one of an earlier window is late."""
        taken.append(one)
        here = [
            other
            for other in taken
            if other.match.end // node.span == newest // node.span and other.key == one.key
        ]
        return self._given(node, here) if one in here else []

    def _from_first(self, node: Windowed, taken: List[Taken], one: Taken, newest: Any) -> List[Match]:
        """every(N, first): a window begins with the end of its first, and is over N seconds later."""
        results = self._close(node, newest)
        begins = self.begins.setdefault(node, {})
        end = one.match.end
        here = [other for other in taken if other.key == one.key and not other.over]
        if not here and end + node.span <= max(newest, one.now):
            self._see(node, one)  # its window is over before it begins
            return results
        if not here:
            begins[one.key] = end
        elif not begins[one.key] <= end < begins[one.key] + node.span:
            self._see(node, one)
            return results
        taken.append(one)
        if node.window == "running_first":
            results += self._given(node, [*here, one])
        return results

    def _see(self, node: Windowed, one: Taken) -> None:
        """Note one that is late: its end counts, it does not."""
        one.over = True
        one.key = None
        self.taken[node].append(one)

    def _close(self, node: Windowed, instant: Any) -> List[Match]:
        """Emit the ended windows in the order of their starts."""
        begins = self.begins.setdefault(node, {})
        open_ones = [one for one in self.taken[node] if not one.over]
        keys = list(dict.fromkeys(one.key for one in open_ones))
        results: List[Any] = []
        for key in sorted(keys, key=lambda key: begins[key]):
            begin = begins[key]
            if begin + node.span <= instant:
                inside = [one for one in open_ones if one.key == key]
                for one in inside:
                    one.over = True
                if node.window == "first":
                    results += self._given(node, inside, (begin, begin + node.span))
        return results

    def _every(self, node: Windowed, taken: List[Taken], one: Taken, newest: Any) -> List[Match]:
        one.over = not any(at > one.now for at in self._windows_of(node, one))
        taken.append(one)
        return []

    def _steps(self, node: Windowed, taken: List[Taken], one: Taken, newest: Any) -> List[Match]:
        """Those that one more decides, which have ended at its end then."""
        taken.append(one)
        same = [other for other in taken if other.key == one.key]
        steps, items = steps_of(node.steps), [other.match.bindings for other in same]
        results: List[Any] = []
        for match in whole_matches(steps, items)[len(whole_matches(steps, items[:-1])) :]:
            inside = [same[place] for place, _ in match]
            interval = (
                min(other.match.start for other in inside),
                max(other.match.end for other in (*inside, one)),
            )
            results += self._given(node, inside, interval, [step for _, step in match])
        return results

    _window: Dict[str, Callable[..., List[Match]]] = {
        "steps": _steps,
        "last": _last,
        "newest": _newest,
        "batch": _batch,
        "running_batch": _batch,
        "first": _from_first,
        "running_first": _from_first,
        "running": _running,
        "every": _every,
    }

    # What is due.

    def _rung(self, node: Any, instant: Any) -> List[Match]:
        waiting = [one for one in self.taken[node] if not one.over]
        if isinstance(node, Windowed):
            if node.window in ("first", "running_first"):
                return self._close(node, instant)
            return self._hop(node, waiting, instant)
        results: List[Any] = []
        for one in waiting:
            if one.match.end + node.seconds == instant:
                one.over = True
                if isinstance(node, Shaped) or not self._ruled_out(node, one.match):
                    results.append(replace(one.match, end=instant, composed=True))
        return results

    def _hop(self, node: Windowed, waiting: List[Taken], instant: Any) -> List[Match]:
        self.newest[node] = instant
        for one in waiting:
            if one.entered is None and one.match.end < instant:
                one.entered = instant
        inside = [one for one in waiting if instant - node.span <= one.match.end < instant]
        inside.sort(key=lambda one: one.entered)
        results: List[Match] = []
        for key in dict.fromkeys(one.key for one in self._by_first(inside)):
            group = [one for one in inside if one.key == key]
            results += self._given(node, group, (instant - node.span, instant))
        for one in waiting:
            one.over = not any(at > instant for at in self._windows_of(node, one))
        return results

    def _by_first(self, inside: List[Taken]) -> List[Taken]:
        """Groups are emitted in the order of their first elements."""
        order = {id(one): at for taken in self.taken.values() for at, one in enumerate(taken)}
        firsts: Dict[Any, Taken] = {}
        for one in inside:
            firsts.setdefault(one.key, one)
        return sorted(firsts.values(), key=lambda one: order[id(one)])

    # What a window gives on.

    def _given(
        self, node: Windowed, inside: List[Taken], interval: Any = None, steps: Sequence[int] = ()
    ) -> List[Match]:
        """Return the match of a window: from the first start to the last end, or the window's own interval."""
        columns = list(zip(*(one.values for one in inside)))
        found: List[Term] = []
        for word in node.kinds.split():
            kind, _, step = word.partition("@")
            values = [1] * len(inside) if kind in ("count", "rate") else list(columns.pop(0))
            here = [place for place in range(len(inside)) if not step or steps[place] == int(step)]
            result = self._result_of_kind(
                kind, node, [values[at] for at in here], [inside[at] for at in here]
            )
            if result is None:
                return []
            found.append(result)
        start, end = interval or (
            min(one.match.start for one in inside),
            max(one.match.end for one in inside),
        )
        bindings = self._of_group(node, inside[-1].match)
        results = unify(node.results, make_list(found), bindings)
        if results is None:
            return []
        numbers = frozenset(number for one in inside for number in one.match.numbers)
        return [Match(start, end, results, (), numbers, (), composed=True)]

    @staticmethod
    def _result_of_kind(kind: str, node: Windowed, values: List[Any], inside: List[Taken]) -> Any:
        if not inside:
            return {"count": 0, "sum": 0, "count_distinct": 0, "list": NIL, "distinct": NIL}.get(kind)
        if kind == "rate":
            if node.window not in ("newest", "batch", "running_batch", "steps"):
                return len(values) / float(node.span)
            ends = [one.match.end for one in inside]
            return (len(values) - 1) / float(max(ends) - min(ends)) if max(ends) > min(ends) else None
        return RESULTS[kind](values)

    def _group_variables(self, node: Windowed) -> List[Var]:
        """A variable of Q that stands elsewhere in the rule has one value for the whole match."""
        outside = self.outside(node) | set(variables(node.results))
        return [var for var in may_bind(node.collected) if var in outside]

    def _group(self, node: Windowed, match: Match) -> Any:
        return tuple([self._key(instance(var, match.bindings)) for var in self._group_variables(node)])

    def _of_group(self, node: Windowed, match: Match) -> Bindings:
        return {
            var: instance(var, match.bindings)
            for var in self._group_variables(node)
            if not unbound(var, match.bindings)
        }

    @staticmethod
    def _key(term: Term) -> Any:
        return "open" if term.__class__ is Var else show(term)

    @staticmethod
    def _values(node: Windowed, match: Match) -> List[Any]:
        kinds = [word.partition("@")[0] for word in node.kinds.split()]
        kinds = [kind for kind in kinds if kind not in ("count", "rate")]
        found: List[Any] = []
        for kind, term in zip(kinds, list_items(node.values) or []):
            value = instance(term, match.bindings)
            found.append(number(value, match.bindings) if kind in NUMERIC else value)
        return found


def from_below(node: Pattern) -> List[Pattern]:
    """Return a pattern and all below it: what is further right in a pair, or below, comes first."""
    parted = children(node)
    if isinstance(node, (Both, Star, Aggregate)):
        parted.reverse()
    return [one for child in parted for one in from_below(child)] + [node]


def quantile(part: Fraction, values: List[Any]) -> Any:
    """Return a quantile, linear between two numbers."""
    ordered = sorted(values)
    place = part * (len(ordered) - 1)
    low = ordered[int(place)]
    if place == int(place):
        return low
    return low + (ordered[int(place) + 1] - low) * float(place - int(place))


def deviation(values: List[Any]) -> Any:
    """Return the standard deviation of a sample."""
    if len(values) < 2:
        return None
    mean = Fraction(sum(map(Fraction, values))) / len(values)
    spread = sum((Fraction(value) - mean) ** 2 for value in values) / (len(values) - 1)
    return float(spread) ** 0.5


def different(values: List[Any]) -> List[Any]:
    """Return those that are different terms, in their order."""
    found: Dict[str, Any] = {}
    for value in values:
        found.setdefault(show(value), value)
    return list(found.values())


NUMERIC = ("sum", "min", "max", "avg", "stddev", "median", "quantile")
RESULTS: Dict[str, Callable[[List[Any]], Any]] = {
    "count": len,
    "sum": sum,
    "min": min,
    "max": max,
    "avg": lambda values: quotient(sum(values), len(values)),
    "stddev": deviation,
    "median": lambda values: quantile(Fraction(1, 2), values),
    "quantile": lambda values: quantile(Fraction(1, 4), values),
    "first": lambda values: values[0],
    "last": lambda values: values[-1],
    "list": make_list,
    "distinct": lambda values: make_list(different(values)),
    "count_distinct": lambda values: len(different(values)),
}
"""What is measured of a window that is not empty. Its order is that in which its matches came into it."""
