"""Operators on streams: windows, shapes, absence with a deadline. Comments name the sentences of the definition.

All matches that an operator has received stay in a plain list, which is searched for the elements of a window.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from retalis import Term, Var, list_items, make_list
from retalis.prolog.terms.term_traversal import variables
from retalis.prolog.terms.timestamps import SECOND

from .goal_evaluator import Bindings, GoalError, instance, number, show, solve, unbound, unify
from .matches import EMPTY_RESULTS, NUMERIC, RESULTS, Event, Match
from .pattern_classes import (
    HELD,
    Aggregate,
    Awaited,
    Both,
    Pattern,
    Preceded,
    Shaped,
    Star,
    Windowed,
    children,
)
from .repetition_runs import IdentifyingRepetitions
from .row_pattern_matches import decided_matches
from .rule_conditions import may_bind


@dataclass(eq=False)
class Element:
    """A match that an operator has received."""

    match: Match
    key: Any
    values: List[Any]
    arrival: Any
    """Time of its arrival, by the clock."""
    newest: Any = None
    """The latest end of all matches that the operator had received at that time."""
    entered: Any = None
    """End of the first hopping window that contained it."""
    is_emitted: bool = False
    """Whether a rate operator has emitted it."""
    is_over: bool = False
    """Whether its window has ended, or its wait."""
    seconds: Any = None
    """Seconds from its end to its deadline, for an absence."""


class Streams(IdentifyingRepetitions):
    """The operators on streams of one rule."""

    def __init__(self, rule: Any, policy: str, out_of_order: bool = False, expiry: bool = True) -> None:
        super().__init__(rule, policy, out_of_order, expiry)
        self.elements: Dict[Pattern, List[Element]] = {}
        self.absences: Dict[Pattern, List[Match]] = {}
        self.begins: Dict[Pattern, Dict[Any, Any]] = {}
        self.latest: Dict[Pattern, Any] = {}
        """The latest time of arrival at an operator."""
        self.newest: Dict[Pattern, Any] = {}
        self.now: Any = 0
        self.current_alarm: Optional[Tuple[int, Any]] = None
        self.rank = {node: position for position, node in enumerate(patterns_from_below(self.pattern))}

    def arrive(self, node: Pattern, event: Event) -> List[Match]:
        """Return the matches of a pattern that an event completes, in order."""
        raise NotImplementedError

    def streamed(self, node: Any, event: Event) -> List[Match]:
        """Return the results of an operator on streams."""
        results: List[Match] = []
        if self.current_alarm is not None and self.current_alarm[0] == self.rank[node]:
            results += self._due_matches(node, self.current_alarm[1])
        if isinstance(node, Preceded):
            self.absences.setdefault(node, []).extend(self.arrive(node.absent, event))
            return [p for p in self.arrive(node.pattern, event) if not self._is_preceded(node, p)]
        if isinstance(node, Awaited):
            for q in self.arrive(node.absent, event):
                self.now_at(node)
                self.absences.setdefault(node, []).append(q)
            for p in self.arrive(node.pattern, event):
                self._store_pending(node, p)
            return results
        below = node.collected if isinstance(node, Windowed) else node.pattern
        for match in self.arrive(below, event):
            results += (
                self._windowed(node, match) if isinstance(node, Windowed) else self._limited(node, match)
            )
        return results

    def now_at(self, node: Pattern) -> Any:
        """Return the time of an arrival at an operator; alarms of the past do not turn its time back."""
        self.latest[node] = max(self.now, self.latest.get(node, self.now))
        return self.latest[node]

    def due(self) -> List[Tuple[Any, int]]:
        """Return the next deadline of each operator, with the operator's rank."""
        deadlines: List[Any] = []
        for node in self.elements:
            instants = self._instants(node)
            if instants:
                deadlines.append((min(instants), self.rank[node]))
        return deadlines

    def _instants(self, node: Any) -> List[Any]:
        waiting = [element for element in self.elements[node] if not element.is_over]
        if isinstance(node, Awaited):
            return [element.match.end + element.seconds for element in waiting]
        if isinstance(node, Shaped) and node.shape == "debounce":
            return [element.match.end + node.seconds for element in waiting]
        if isinstance(node, Windowed) and node.window in ("first", "running_first"):
            return [self.begins[node][element.key] + node.span for element in waiting]
        if isinstance(node, Windowed) and node.window in ("session", "bounded_session"):
            return [self._session_end(node, session) for session in self._sessions_of(node, waiting)]
        if isinstance(node, Windowed) and node.window in ("held", "bounded_held"):
            return self._held_instants(node)
        if isinstance(node, Windowed) and node.window == "every":
            return [
                end
                for element in waiting
                for end in self._windows_of(node, element)
                if end > max(element.arrival, self.reached(node))
            ]
        return []

    def reached(self, node: Pattern) -> Any:
        """Return the last instant at which an operator has emitted windows."""
        return self.newest.get(node, 0)

    @staticmethod
    def _windows_of(node: Any, element: Element) -> List[Any]:
        """Windows: at each multiple t of M, those with t - N <= end < t."""
        end = (element.match.end // node.step + 1) * node.step
        ends: List[Any] = []
        while end <= element.match.end + node.span:
            ends.append(end)
            end += node.step
        return ends

    # Absence with a deadline.

    def _store_pending(self, node: Awaited, p: Match) -> None:
        elements = self.elements.setdefault(node, [])
        # Absence: a P whose N is not a positive number is dropped.
        seconds = seconds_of(node, p)
        if seconds is None:
            return
        # Absence: a P that arrives after its deadline is too late.
        if p.end + seconds <= self.now_at(node):
            return
        if self.policy == "recent":
            # Absence: of two waiting variants that end less than N seconds apart, the later one replaces the other.
            waiting = [
                element
                for element in elements
                if not element.is_over and element.match.variant() == p.variant()
            ]
            for element in waiting:
                element.is_over = element.match.end <= p.end < element.match.end + element.seconds
            if any(p.end < element.match.end < p.end + seconds for element in waiting):
                return
        # Absence: if N is a variable, a Q that arrived before P counts if it started in the last ten seconds.
        oldest = self.now_at(node) - 10
        forgotten = [q for q in self.absences.get(node, []) if q.start <= oldest]
        is_variable = node.seconds.__class__ is Var
        elements.append(Element(p, None, forgotten if is_variable else [], self.now, seconds=seconds))

    def _is_forbidden(self, node: Awaited, element: Element) -> bool:
        """Absence: a Q with the same variables wholly between P's end and N seconds later."""
        p = element.match
        return any(
            p.end < q.start
            and q.end < p.end + element.seconds
            and q not in element.values
            and self.agree(q, p.bindings)
            for q in self.absences.get(node, [])
        )

    def _is_preceded(self, node: Preceded, p: Match) -> bool:
        """Rates, not_preceded: a Q with the same variables ended less than N seconds before P started."""
        return any(
            p.start - node.seconds < q.end < p.start and self.agree(q, p.bindings)
            for q in self.absences[node]
        )

    # Shapes.

    def _limited(self, node: Shaped, match: Match) -> List[Match]:
        elements = self.elements.setdefault(node, [])
        key = [self._key(instance(term, match.bindings)) for term in list_items(node.by) or []]
        value = [self._key(instance(term, match.bindings)) for term in list_items(node.value) or []]
        newest = max([match.end, *(element.match.end for element in elements)])
        same = [element for element in elements if element.key == key]
        element = Element(match, key, value, self.now, newest)
        elements.append(element)
        if node.shape == "throttle":
            # no emitted element ends less than N seconds before the newest end
            element.is_emitted = not any(
                other.is_emitted and other.match.end > newest - node.seconds for other in same
            )
        elif node.shape == "burst":
            # no element does
            element.is_emitted = not any(other.match.end > newest - node.seconds for other in same)
        elif node.shape in ("change", "change_after_first"):
            # the value differs from that of the last element, if there is one
            before = self._not_idle(node, [*same, element])[:-1]
            element.is_emitted = before[-1].values != value if before else node.shape == "change"
        elif match.end + node.seconds <= self.now_at(node):
            element.is_over = True  # debounce: it arrives after its deadline
        else:
            # debounce: it waits for N seconds from its end; an element that ends within these replaces it
            waiting = [other for other in same if not other.is_over]
            element.is_over = any(match.end < other.match.end < match.end + node.seconds for other in waiting)
            for other in waiting:
                other.is_over = other.match.end <= match.end < other.match.end + node.seconds
        return [match] if element.is_emitted else []

    # Windows.

    def _windowed(self, node: Windowed, match: Match) -> List[Match]:
        elements = self.elements.setdefault(node, [])
        try:
            values = self._values(node, match)
        except GoalError:
            return []
        newest = max([match.end, *(other.match.end for other in elements)])
        element = Element(match, self._group(node, match), values, self.now_at(node), newest)
        return self._window[node.window](self, node, elements, element, newest)

    def _not_idle(self, node: Pattern, same: List[Element]) -> List[Element]:
        """State of keys: after a time that exceeds a within or a window, the state of a key begins again."""
        for position in range(len(same) - 1, 0, -1):
            idle = same[position].newest - same[position - 1].newest
            window = self.rule.window
            if any(idle >= limit for limit in self.limits[node]) or (window is not None and idle > window):
                return same[position:]
        return same

    def _last(self, node: Windowed, elements: List[Element], element: Element, newest: Any) -> List[Match]:
        """last(N): elements that began less than N seconds before the newest end; an earlier one is late."""
        elements.append(element)
        inside = [
            other for other in elements if other.match.start > newest - node.span and other.key == element.key
        ]
        return self._window_match(node, inside) if element in inside else []

    def _newest(self, node: Windowed, elements: List[Element], element: Element, newest: Any) -> List[Match]:
        elements.append(element)
        same = [other for other in elements if other.key == element.key]
        return self._window_match(node, self._not_idle(node, same)[-node.span :])

    def _batch(self, node: Windowed, elements: List[Element], element: Element, newest: Any) -> List[Match]:
        elements.append(element)
        same = self._not_idle(node, [other for other in elements if other.key == element.key])
        size = (len(same) - 1) % node.span + 1
        if node.window == "running_batch" or size == node.span:
            return self._window_match(node, same[-size:])
        return []

    def _running(self, node: Windowed, elements: List[Element], element: Element, newest: Any) -> List[Match]:
        """running(every(N)): elements of the window of the newest end; one of an earlier window is late."""
        elements.append(element)
        inside = [
            other
            for other in elements
            if other.match.end // node.span == newest // node.span and other.key == element.key
        ]
        return self._window_match(node, inside) if element in inside else []

    def _from_first(
        self, node: Windowed, elements: List[Element], element: Element, newest: Any
    ) -> List[Match]:
        """every(N, first): a window begins with the end of its first element, and ends N seconds later."""
        results = self._close(node, newest)
        begins = self.begins.setdefault(node, {})
        end = element.match.end
        inside = [other for other in elements if other.key == element.key and not other.is_over]
        if not inside and end + node.span <= max(newest, element.arrival):
            self._store_late(node, element)  # its window would have ended already
            return results
        if not inside:
            begins[element.key] = end
        elif not begins[element.key] <= end < begins[element.key] + node.span:
            self._store_late(node, element)
            return results
        elements.append(element)
        if node.window == "running_first":
            results += self._window_match(node, [*inside, element])
        return results

    def _store_late(self, node: Windowed, element: Element) -> None:
        """Store a late element: its end counts, but no window contains it."""
        element.is_over = True
        element.key = None
        self.elements[node].append(element)

    def _close(self, node: Windowed, instant: Any) -> List[Match]:
        """Emit the ended windows in the order of their starts."""
        begins = self.begins.setdefault(node, {})
        open_elements = [element for element in self.elements[node] if not element.is_over]
        keys = list(dict.fromkeys(element.key for element in open_elements))
        results: List[Any] = []
        for key in sorted(keys, key=lambda key: begins[key]):
            begin = begins[key]
            if begin + node.span <= instant:
                inside = [element for element in open_elements if element.key == key]
                for element in inside:
                    element.is_over = True
                if node.window == "first":
                    results += self._window_match(node, inside, (begin, begin + node.span))
        return results

    def _every(self, node: Windowed, elements: List[Element], element: Element, newest: Any) -> List[Match]:
        element.is_over = not any(end > element.arrival for end in self._windows_of(node, element))
        elements.append(element)
        return []

    @staticmethod
    def _session_end(node: Windowed, session: List[Element]) -> Any:
        """session(N, max(M)): it ends N seconds after its last end, or M seconds after its first one."""
        end = session[-1].match.end + node.span
        return end if node.window == "session" else min(end, session[0].match.end + node.step)

    def _sessions_of(self, node: Windowed, waiting: List[Element]) -> List[List[Element]]:
        """Sessions of open elements: in the order of their ends, each ends before the session of the previous one."""
        sessions: List[List[Element]] = []
        for key in dict.fromkeys(element.key for element in waiting):
            of_key: List[List[Element]] = []
            for element in sorted(
                [other for other in waiting if other.key == key], key=lambda other: other.match.end
            ):
                if of_key and element.match.end < self._session_end(node, of_key[-1]):
                    of_key[-1].append(element)
                else:
                    of_key.append([element])
            sessions += of_key
        return sessions

    def _session(self, node: Windowed, elements: List[Element], element: Element, newest: Any) -> List[Match]:
        """session(N): an element whose session has ended at its arrival is late."""
        waiting = [other for other in elements if not other.is_over]
        sessions = self._sessions_of(node, [*waiting, element])
        (session,) = [session for session in sessions if element in session]
        element.is_over = self._session_end(node, session) <= element.arrival
        elements.append(element)
        return []

    def _end_sessions(self, node: Windowed, waiting: List[Element], instant: Any) -> List[Match]:
        """Emit the sessions that end, in the order of their first elements; measures are in order of arrival."""
        results: List[Match] = []
        ended = [
            session
            for session in self._sessions_of(node, waiting)
            if self._session_end(node, session) == instant
        ]
        for session in sorted(ended, key=lambda session: self.elements[node].index(session[0])):
            for element in session:
                element.is_over = True
            results += self._window_match(node, sorted(session, key=self.elements[node].index))
        return results

    # Held values.

    def _pieces(self, node: Windowed, elements: Sequence[Element]) -> List[Tuple[Element, Any, Any]]:
        """held(W, max(S)): a value lasts from the end of its Q to that of the next one, S seconds at most.

        Of several Q with the same end, the last to arrive counts.
        """
        limits = {"held": 100_000 * node.step, "bounded_held": node.span, "bounded_held_last": node.step}
        by_end = {element.match.end: element for element in elements}
        ends = sorted(by_end)
        following = [*ends[1:], None]
        pieces: List[Tuple[Element, Any, Any]] = []
        for end, next_end in zip(ends, following):
            last = end + limits[node.window] if node.window in limits else None
            candidates = [instant for instant in (next_end, last) if instant is not None]
            pieces.append((by_end[end], end, min(candidates) if candidates else None))
        return pieces

    def _held_in(
        self, node: Windowed, elements: Sequence[Element], begin: Any, end: Any, closed: bool
    ) -> Any:
        """Return the pieces that reach into a window."""
        return [
            piece
            for piece in self._pieces(node, elements)
            if (piece[2] is None or piece[2] > begin) and (piece[1] < end or (closed and piece[1] == end))
        ]

    def _held_match(self, node: Windowed, pieces: Any, begin: Any, interval: Any) -> List[Match]:
        """Return the match of a window over pieces, up to the end of an interval."""
        columns = list(zip(*(element.values for element, _, _ in pieces)))
        end = interval[1]
        times = [(end if last is None else min(last, end)) - max(first, begin) for _, first, last in pieces]
        measured: List[Term] = []
        for kind in node.kinds.split():
            values = list(columns.pop(0))
            if kind == "avg":
                lasting = [(value, time) for value, time in zip(values, times) if time]
                if not lasting:
                    return []
                total = sum(Fraction(value) * Fraction(time) for value, time in lasting)
                exact = total / Fraction(sum(time for _, time in lasting))
                is_integer = all(isinstance(value, int) for value, _ in lasting) and exact.denominator == 1
                measured.append(int(exact) if is_integer else float(exact))
            elif kind == "duration":
                measured.append(float(sum(time for value, time in zip(values, times) if value)))
            else:
                measured.append(
                    {"min": min, "max": max}[kind](values)
                    if kind in ("min", "max")
                    else values[0 if kind == "first" else -1]
                )
        inside = [element for element, _, _ in pieces]
        results = unify(node.results, make_list(measured), self._of_group(node, inside[-1].match))
        if results is None:
            return []
        numbers = frozenset(number for element in inside for number in element.match.numbers)
        return [Match(interval[0], interval[1], results, (), numbers, (), composed=True)]

    def _held_last(
        self, node: Windowed, elements: List[Element], element: Element, newest: Any
    ) -> List[Match]:
        """held(last(N)): the values of the last N seconds; a Q whose value has ended before these is too late."""
        same = self._not_idle(node, [*(other for other in elements if other.key == element.key), element])
        begin = newest - node.span
        pieces = self._held_in(node, same, begin, newest, True)
        if not any(piece[0] is element for piece in pieces):
            return []
        elements.append(element)
        return self._held_match(node, pieces, begin, (max(begin, pieces[0][1]), newest))

    def _held_every(
        self, node: Windowed, elements: List[Element], element: Element, newest: Any
    ) -> List[Match]:
        elements.append(element)
        return []

    def _held_instants(self, node: Windowed) -> List[Any]:
        """held(last(N, every(M))): each multiple of M, while a value lasts in the N seconds before it."""
        elements = self.elements[node]
        instants: List[Any] = []
        for key in dict.fromkeys(element.key for element in elements):
            for element, begin, end in self._pieces(node, [other for other in elements if other.key == key]):
                after = max(element.arrival, self.reached(node))
                instant = max(begin // node.step + 1, after // node.step + 1) * node.step
                if end > instant - node.span:
                    instants.append(instant)
        return instants

    def _held_due(self, node: Windowed, instant: Any) -> List[Match]:
        """Emit the windows that end, in the order of the first Q of their keys."""
        self.newest[node] = instant
        elements = self.elements[node]
        windows: List[Any] = []
        for key in dict.fromkeys(element.key for element in elements):
            same = [other for other in elements if other.key == key and other.match.end < instant]
            pieces = self._held_in(node, same, instant - node.span, instant, False)
            if pieces:
                windows.append(pieces)
        results: List[Match] = []
        for pieces in sorted(windows, key=lambda pieces: elements.index(pieces[0][0])):
            begin = instant - node.span
            results += self._held_match(node, pieces, begin, (begin, instant))
        return results

    def _steps(self, node: Windowed, elements: List[Element], element: Element, newest: Any) -> List[Match]:
        """Matches of the steps that an element decides; they end at its end at the earliest."""
        elements.append(element)
        same = [other for other in elements if other.key == element.key]
        items = [other.match.bindings for other in same]
        results: List[Any] = []
        for match in decided_matches(node.steps, items, node.skip):
            inside = [same[place] for place, _ in match]
            interval = (
                min(other.match.start for other in inside),
                max(other.match.end for other in (*inside, element)),
            )
            results += self._window_match(node, inside, interval, [step for _, step in match])
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
        "session": _session,
        "bounded_session": _session,
        "held": _held_every,
        "bounded_held": _held_every,
        "held_last": _held_last,
        "bounded_held_last": _held_last,
    }

    # Deadlines.

    def _due_matches(self, node: Any, instant: Any) -> List[Match]:
        waiting = [element for element in self.elements[node] if not element.is_over]
        if isinstance(node, Windowed):
            if node.window in ("first", "running_first"):
                return self._close(node, instant)
            if node.window in ("session", "bounded_session"):
                return self._end_sessions(node, waiting, instant)
            if node.window in HELD:
                return self._held_due(node, instant)
            return self._hop(node, waiting, instant)
        results: List[Any] = []
        for element in waiting:
            seconds = element.seconds if isinstance(node, Awaited) else node.seconds
            if element.match.end + seconds == instant:
                element.is_over = True
                if isinstance(node, Shaped) or not self._is_forbidden(node, element):
                    results.append(replace(element.match, end=instant, composed=True))
        return results

    def _hop(self, node: Windowed, waiting: List[Element], instant: Any) -> List[Match]:
        self.newest[node] = instant
        for element in waiting:
            if element.entered is None and element.match.end < instant:
                element.entered = instant
        inside = [element for element in waiting if instant - node.span <= element.match.end < instant]
        inside.sort(key=lambda element: element.entered)
        results: List[Match] = []
        for key in dict.fromkeys(element.key for element in self._by_first(inside)):
            group = [element for element in inside if element.key == key]
            results += self._window_match(node, group, (instant - node.span, instant))
        for element in waiting:
            element.is_over = not any(end > instant for end in self._windows_of(node, element))
        return results

    def _by_first(self, inside: List[Element]) -> List[Element]:
        """Groups are emitted in the order of their first elements."""
        order = {
            id(element): position
            for elements in self.elements.values()
            for position, element in enumerate(elements)
        }
        firsts: Dict[Any, Element] = {}
        for element in inside:
            firsts.setdefault(element.key, element)
        return sorted(firsts.values(), key=lambda element: order[id(element)])

    # Results of windows.

    def _window_match(
        self, node: Windowed, inside: List[Element], interval: Any = None, steps: Sequence[int] = ()
    ) -> List[Match]:
        """Return the match of a window: from the first start to the last end, or the window's own interval."""
        columns = list(zip(*(element.values for element in inside)))
        measured: List[Term] = []
        for word in node.kinds.split():
            kind, _, step = word.partition("@")
            values = [1] * len(inside) if kind in ("count", "rate") else list(columns.pop(0))
            members = [place for place in range(len(inside)) if not step or steps[place] == int(step)]
            result = self._result_of_kind(
                kind, node, [values[place] for place in members], [inside[place] for place in members]
            )
            if result is None:
                return []
            measured.append(result)
        start, end = interval or (
            min(element.match.start for element in inside),
            max(element.match.end for element in inside),
        )
        bindings = self._of_group(node, inside[-1].match)
        results = unify(node.results, make_list(measured), bindings)
        if results is None:
            return []
        numbers = frozenset(number for element in inside for number in element.match.numbers)
        return [Match(start, end, results, (), numbers, (), composed=True)]

    @staticmethod
    def _result_of_kind(kind: str, node: Windowed, values: List[Any], inside: List[Element]) -> Any:
        if not inside:
            return EMPTY_RESULTS.get(kind)
        if kind == "rate":
            if node.window not in (
                "newest",
                "batch",
                "running_batch",
                "steps",
                "session",
                "bounded_session",
            ):
                return len(values) / float(node.span)
            ends = [element.match.end for element in inside]
            return (len(values) - 1) / float(max(ends) - min(ends)) if max(ends) > min(ends) else None
        return RESULTS[kind](values)

    def _group_variables(self, node: Windowed) -> List[Var]:
        """A variable of Q that occurs elsewhere in the rule has one value for the whole match."""
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
    def _key(term: Term) -> str:
        return "open" if term.__class__ is Var else show(term)

    @staticmethod
    def _values(node: Windowed, match: Match) -> List[Any]:
        kinds = [word.partition("@")[0] for word in node.kinds.split()]
        kinds = [kind for kind in kinds if kind not in ("count", "rate")]
        values: List[Any] = []
        for kind, term in zip(kinds, list_items(node.values) or []):
            value = instance(term, match.bindings)
            if kind == "duration":
                value = next(solve(value, match.bindings), None) is not None
            values.append(number(value, match.bindings) if kind in NUMERIC else value)
        return values


def seconds_of(node: Awaited, match: Match) -> Any:
    """Return the seconds of an absence after a match; None if its variable has no positive number.

    Time: instants are whole nanoseconds, so a time that is no multiple of them is rounded.
    """
    value = instance(node.seconds, match.bindings) if node.seconds.__class__ is Var else node.seconds
    if not isinstance(value, (int, float, Fraction)) or value <= 0:
        return None
    return Fraction(round(Fraction(value) * SECOND), SECOND) or None


def patterns_from_below(node: Pattern) -> List[Pattern]:
    """Return a pattern and all below it: right sides precede left ones, and operands precede operators."""
    parted = children(node)
    if isinstance(node, (Both, Star, Aggregate)):
        parted.reverse()
    return [descendant for child in parted for descendant in patterns_from_below(child)] + [node]
