"""States that hold from one event until another: open ones, those that are over, and the events that these are."""

from collections import OrderedDict, deque
from itertools import count
from typing import Any, Deque, Dict, Hashable, Iterator, List, NamedTuple, Optional, Set, Tuple

from ...prolog.logic import Logic
from ...prolog.machine import Frame
from ...prolog.terms import Term, Values, Var, WholeSeconds, freeze, variables
from ..dispatch import Dispatcher, Listener, Stage, compile_builder
from ..history import Occurrence
from ..language import StateForm
from .recording import Warn
from .timeouts import AlarmClock, Timeouts

_VERSIONS = count()

_MOST_OPENINGS = 100
"""Events with which a state might have begun that are remembered, where the first of them may be taken back."""

Begun = Tuple[int, Optional[Occurrence]]
"""The end of an event with which a state may have begun, and what tells whether that was taken back."""

KeptState = Tuple[List[Tuple[Hashable, Term, Hashable, List[Begun]]], List[Tuple[Any, ...]], int]
"""Open states (key, term, key of what is shared, openings), those that are over, and how many were dropped."""


class OpenState:
    """A state that holds.

    Attributes:
        key: of its term.
        shared: the keys of the values by which the event is told with which it ends.
        order: tells it from all others, and when it began.
        openings: the events with which it may have begun, the first one first.
    """

    __slots__ = ("key", "term", "shared", "order", "openings")

    def __init__(self, key: Hashable, term: Term, shared: Hashable, order: int, openings: List[Begun]):
        self.key = key
        self.term = term
        self.shared = shared
        self.order = order
        self.openings = openings

    @property
    def begin(self) -> Optional[int]:
        """Since when it holds; None where all with which it might have begun was taken back."""
        openings = self.openings
        while openings:
            begin, token = openings[0]
            if token is None or not token.gone:
                return begin
            openings.pop(0)
        return None


class PastState(NamedTuple):
    """A state that is over: its interval, and the event of that, where what events came from is kept."""

    key: Hashable
    term: Term
    start: int
    end: int
    token: Optional[Occurrence]

    @property
    def gone(self) -> bool:
        """Whether its event was taken back."""
        return self.token is not None and self.token.gone


class DeclaredState:
    """One declaration with what holds of it; as code of a frame it tells of states that are over.

    Args:
        form: what it says.
        logic: whose machine runs what an event starts.
        dispatcher: whose events begin and end it.
        clock: rings where it ends by itself.
        warn: takes a warning.

    Attributes:
        open: those that hold, by the keys of their terms, the oldest first.
        past: those that are over, the newest last.
        dropped: how many were dropped since too many were open.
        version: another number after each change; no other declaration has it.
    """

    def __init__(self, form: StateForm, logic: Logic, dispatcher: Dispatcher, clock: AlarmClock, warn: Warn):
        self.form = form
        self._logic = logic
        self._dispatcher = dispatcher
        self._warn = warn
        begins, ends, own = (variables(one) for one in (form.begins, form.ends, form.state))
        self.name = f"state {logic.brief(form.state, dict.fromkeys(own, '_'))}"
        shared = [var for var in own if var in set(ends)]
        self._build = compile_builder(form.state, begins, "state")
        self._shared_of_begin = [begins.index(var) for var in shared]
        self._shared_of_end = [ends.index(var) for var in shared]
        self._unused: Tuple[Set[Var], Set[Var]] = (set(begins) - set(own), set(ends) - set(shared))
        # the first of a plain dict is looked for among all that have gone before it
        self.open: OrderedDict[Hashable, OpenState] = OrderedDict()
        self._by_shared: Dict[Hashable, Dict[Hashable, OpenState]] = {}
        self._by_order: Dict[int, OpenState] = {}
        self._order = count()
        self.past: Deque[PastState] = deque(maxlen=form.past)
        self.dropped = 0
        self.version = next(_VERSIONS)
        self._timeouts = Timeouts(clock, self._by_order, self._time_over)
        self.listeners: List[Listener] = []

    def listen(self) -> None:
        """Take events; what ends a state is looked at first, so that an event ends one and begins the next."""
        listen, (begins, ends) = self._dispatcher.listen, self._unused
        self.listeners = [
            listen(Stage.STATES, self.form.ends, self._end, unused=ends),
            listen(Stage.STATES, self.form.begins, self._begin, unused=begins),
        ]

    def unlisten(self) -> None:
        """Take no events."""
        for listener in self.listeners:
            self._dispatcher.remove(listener)
        self.listeners = []

    # ---- beginning -----------------------------------------------------------------------------------

    def _begin(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        state = self._build(values)
        try:
            key = freeze(state)
            shared = tuple([freeze(values[at]) for at in self._shared_of_begin])
        except ValueError:
            self._warn_of_variables(term, "begins")
            return after
        token = self._dispatcher.token() if self._dispatcher.tracked else None
        known = self.open.get(key)
        if known is not None and known.begin is None:
            self._remove(known)
            known = None
        if known is None:
            self._add(OpenState(key, state, shared, next(self._order), [(end, token)]))
        elif token is not None and len(known.openings) < _MOST_OPENINGS:
            known.openings.append((end, token))
            self.version = next(_VERSIONS)
        return after

    def _add(self, one: OpenState) -> None:
        self.version = next(_VERSIONS)
        if len(self.open) >= self.form.open:
            self._drop(next(iter(self.open.values())))
        self.open[one.key] = one
        self._by_shared.setdefault(one.shared, {})[one.key] = one
        self._by_order[one.order] = one
        begin = one.begin
        if self.form.within is not None and begin is not None:
            self._timeouts.add_at(one.order, int(begin) + self.form.within)

    def _drop(self, oldest: OpenState) -> None:
        self._remove(oldest)
        self.dropped += 1
        text = f"more than {self.form.open} are open; {self.dropped} of the oldest have been dropped so far"
        self._warn(f"{self.name}: {text}", ("open", self.name))

    def _remove(self, one: OpenState) -> None:
        self.version = next(_VERSIONS)
        del self.open[one.key]
        del self._by_order[one.order]
        group = self._by_shared[one.shared]
        del group[one.key]
        if not group:
            del self._by_shared[one.shared]

    def _warn_of_variables(self, event: Term, what: str) -> None:
        text = f"{self._logic.brief(event)} has variables: it {what} no state"
        self._warn(f"{self.name}: {text}", ("variables", self.name))

    # ---- ending --------------------------------------------------------------------------------------

    def _end(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        try:
            group = self._by_shared.get(tuple([freeze(values[at]) for at in self._shared_of_end]))
        except ValueError:
            self._warn_of_variables(term, "ends")
            return after
        if group is None:
            return after
        token = self._dispatcher.token() if self._dispatcher.tracked else None
        over = [self._over(one, start, token) for one in list(group.values())]
        return self._tell((self, iter([one for one in over if one is not None]), after))

    def _over(self, one: OpenState, end: int, token: Optional[Occurrence]) -> Optional[PastState]:
        """Have a state end with an event; None where it has not begun before that, or not at all."""
        begin = one.begin
        if begin is not None and begin > end:
            return None
        self._remove(one)  # a new version, also for what is over from here on
        if begin is None:
            return None
        made = None
        if self._dispatcher.tracked:
            made = Occurrence(one.term, begin, end, None, None)
            made.follows([source for source in (one.openings[0][1], token) if source is not None])
        found = PastState(one.key, one.term, begin, end, made)
        self.past.append(found)
        return found

    def run(self, frame: Frame) -> Frame:
        """Tell of those that are left."""
        return self._tell(frame)

    def _tell(self, frame: Frame) -> Frame:
        """Have the events of states happen that are over, one after the other."""
        over: Iterator[PastState] = frame[1]
        for one in over:
            found = self._dispatcher.dispatch(one.term, one.start, one.end, frame, one.token, True)
            if found is not frame:
                return found
        after: Frame = frame[2]
        return after

    def _time_over(self, order: int, instant: int) -> None:
        """Have a state end by itself."""
        one, within = self._by_order[order], self.form.within
        begin = one.begin
        if within is not None and begin is not None and int(begin) + within > instant:
            self._timeouts.add_at(order, int(begin) + within)  # it began later: the first was taken back
            return
        over = self._over(one, WholeSeconds(instant), None)
        if over is not None:
            machine = self._logic.machine
            self._dispatcher.apart(lambda: machine.run(self._tell((self, iter([over]), machine.done))))

    # ---- asking --------------------------------------------------------------------------------------

    def holding(self, key: Optional[Hashable]) -> List[Tuple[Term, int]]:
        """Return those that hold with since when; of one key, or all with None."""
        found = list(self.open.values()) if key is None else [self.open[key]] if key in self.open else []
        return [(one.term, begin) for one in found for begin in (one.begin,) if begin is not None]

    def holding_at(self, key: Optional[Hashable], instant: int) -> List[Term]:
        """Return those that held at an instant, as far as they are known."""
        found: Dict[Hashable, Term] = {}
        for past in list(self.past):
            if key in (None, past.key) and past.start <= instant <= past.end and not past.gone:
                found[past.key] = past.term
        for term, begin in self.holding(key):
            if begin <= instant:
                found[freeze(term)] = term
        return list(found.values())

    # ---- from outside --------------------------------------------------------------------------------

    def clear(self) -> None:
        """Forget what held: time went back, or the declaration is gone."""
        self.close(True)

    def close(self, past: bool) -> None:
        """Forget what holds, and with ``past`` what is over."""
        self.version = next(_VERSIONS)
        for found in (self.open, self._by_shared, self._by_order):
            found.clear()
        self._timeouts.clear()
        if past:
            self.past.clear()

    def mend(self) -> None:
        """Find all that is open in all ways, after an interrupt."""
        everything = list(self.open.values())
        self.open.clear()
        self._by_shared.clear()
        self._by_order.clear()
        self._timeouts.clear()
        for one in everything:
            self._add(one)

    def kept(self) -> KeptState:
        """Return what holds and held as data; see `restore`."""
        held = [(one.key, one.term, one.shared, list(one.openings)) for one in self.open.values()]
        return held, [tuple(one) for one in self.past], self.dropped

    def restore(self, kept: KeptState) -> None:
        """Have hold what another one knew."""
        held, past, self.dropped = kept
        self.version = next(_VERSIONS)
        for key, term, shared, openings in held:
            self._add(OpenState(key, term, shared, next(self._order), list(openings)))
        self.past.extend([PastState(*one) for one in past])
