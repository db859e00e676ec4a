"""Timeouts of network nodes and alarms of rules, which are alarms of the engine's clock.

* `NodeTimers` has one alarm for all nodes with timeouts, such as windows and absence. A timeout runs when the
  watermark of its node reaches it (see `watermarks`). A node that moves its timeout does not search the heap: the old
  entry stays and is skipped when it is reached (lazy deletion). The heap is rebuilt when more than half of it is
  stale.
* `RuleAlarm` emits an event of a rule at a future instant (``exceptionAlarm``).
"""

import heapq
from itertools import count
from typing import TYPE_CHECKING, List, NamedTuple, Optional, Tuple

from ...foundation.errors import RetalisError
from ...prolog.machine.errors import Halt
from ...prolog.machine.machine import Machine
from ...prolog.terms.types import Term
from ...serialization.state_fields import rows_of
from ...serialization.stored_field_types import CALLABLE_TERM, COUNT, INSTANT, reference
from ..clock.clock import Clock
from ..dispatch.dispatcher import Dispatcher
from ..matches.match_types import OPTIONAL_EVENT
from .goal_evaluation import TimedNode
from .lineage_graph import Occurrence

if TYPE_CHECKING:
    from .event_rule import EventRule

_MAX_NEVER_REBUILT = 64
"""Size up to which a heap with stale entries is never rebuilt."""

_FIRST_ORDER = -1
"""Order of the node alarm: before all other alarms of the same instant."""

_TimerEntry = Tuple[int, int, int, int, int, TimedNode]
"""Due time by the clock, serial number of the rule, position of the node in it, order of the request, the instant of
the timeout, and the node."""


class NodeTimers:
    """Timeouts of network nodes.

    A timeout is due when the clock reaches its instant plus the delay of the node's watermark. At one due time, nodes
    of older rules come first, and within a rule nodes further right or below. Each node has its own limits and error
    handling, so an error in one does not affect the others.

    Args:
        clock: has the alarm.
        dispatcher: has no current event while a node processes its timeout.
        machine: runs what a node returns.
    """

    def __init__(self, clock: Clock, dispatcher: Dispatcher, machine: Machine):
        self._clock = clock
        self._dispatcher = dispatcher
        self._machine = machine
        self._heap: List[_TimerEntry] = []
        self._next_number = count()
        self._rebuild_size = _MAX_NEVER_REBUILT
        self._alarm_instants: List[int] = []

    def clear(self) -> None:
        """Remove all timeouts; the clock has been reset and has dropped the alarm."""
        self._heap = []
        self._alarm_instants = []

    def __len__(self) -> int:
        """Return the number of entries, including stale ones.

        Bounded by twice the number of waiting nodes plus a constant.
        """
        return len(self._heap)

    def add(self, node: TimedNode, instant: int) -> None:
        """Set the timeout of a node; a later one replaces an earlier one."""
        self._push(node, instant)
        if len(self._heap) > self._rebuild_size:
            self._drop_all_stale()
        self._set_alarm()

    def _push(self, node: TimedNode, instant: int) -> None:
        due_time = instant + node.watermark.delay
        heapq.heappush(
            self._heap, (due_time, node.serial, node.position, next(self._next_number), instant, node)
        )

    def reschedule(self) -> None:
        """Compute all due times again, because the delays of watermarks have become shorter."""
        entries, self._heap = self._heap, []
        for *_, instant, node in sorted(entries, key=lambda entry: entry[:5]):
            if node.alarm_instant == instant:
                self._push(node, instant)
        self._set_alarm()

    def _set_alarm(self) -> None:
        """Set the clock's alarm for the earliest timeout.

        An alarm for a later instant stays in the clock.
        """
        self._drop_stale_top()
        heap, alarm_instants = self._heap, self._alarm_instants
        if heap and (not alarm_instants or heap[0][0] < alarm_instants[0]):
            heapq.heappush(alarm_instants, heap[0][0])
            self._clock.put_back(heap[0][0], _FIRST_ORDER, self._on_alarm)

    def _drop_stale_top(self) -> None:
        """Remove stale entries from the top of the heap."""
        # An entry is stale if its node has set another alarm since, or if its alarm has run.
        heap = self._heap
        while heap and not _is_current(heap[0]):
            heapq.heappop(heap)

    def _drop_all_stale(self) -> None:
        """Remove all stale and duplicate entries."""
        current_entries = {id(entry[-1]): entry for entry in self._heap if _is_current(entry)}
        self._heap = list(current_entries.values())
        heapq.heapify(self._heap)
        self._rebuild_size = 2 * len(self._heap) + _MAX_NEVER_REBUILT

    def _on_alarm(self, instant: int) -> None:
        """Run the alarm of the first node that is due, and set the next alarm.

        Each call processes one node only, because other alarms of the same instant may have to run between two nodes.
        """
        # Alarms up to this instant have been called, so they are not in the clock any more.
        while self._alarm_instants and self._alarm_instants[0] <= instant:
            heapq.heappop(self._alarm_instants)
        self._drop_stale_top()
        heap = self._heap
        try:
            if heap and heap[0][0] <= instant:
                *_, node_instant, node = heapq.heappop(heap)
                # The delay may have become longer since the due time was computed.
                if node_instant + node.watermark.delay > instant:
                    self._push(node, node_instant)
                    return
                node.alarm_instant = None
                # An inactive rule is being reloaded; its nodes set their timeouts again if the rule is activated.
                if node.active:
                    machine = self._machine
                    self._dispatcher.run_without_context(
                        lambda: machine.run(node.on_alarm(node_instant, machine.done))
                    )
        # The other nodes that are due are not affected. An unexpected exception is handled by the caller, which
        # repairs the state.
        except Halt:
            raise
        except RetalisError as error:
            node.report_alarm_error(error)
        # Also after an error, otherwise no later alarm would run.
        finally:
            self._set_alarm()


def _is_current(entry: _TimerEntry) -> bool:
    return entry[-1].alarm_instant == entry[-2]


class StoredRuleAlarm(NamedTuple):
    """Stored form of a `RuleAlarm` in the clock.

    Attributes:
        due_at: instant of the alarm in ns.
        order: order of the alarm among those of the same instant.
        rule, term, start, instant, token: as in `RuleAlarm`.
    """

    due_at: int
    order: int
    rule: "EventRule"
    term: Term
    start: int
    instant: int
    token: Optional[Occurrence]


RULE_ALARMS = rows_of(
    StoredRuleAlarm,
    due_at=INSTANT,
    order=COUNT,
    rule=reference("rule"),
    term=CALLABLE_TERM,
    start=INSTANT,
    instant=INSTANT,
    token=OPTIONAL_EVENT,
)


class RuleAlarm:
    """An event of a rule that is emitted when the clock reaches an instant.

    Args:
        rule: the rule that has set the alarm.
        start: start of the event's interval.
        instant: end of the interval, at which the event is emitted.
        token: occurrence of the event if lineage is tracked.
    """

    __slots__ = ("rule", "term", "start", "instant", "token")

    def __init__(
        self,
        rule: "EventRule",
        term: Term,
        start: int,
        instant: int,
        token: Optional[Occurrence],
    ):
        self.rule = rule
        self.term = term
        self.start = start
        self.instant = instant
        self.token = token

    def __call__(self, now: int) -> None:
        """Emit the event, unless an event that it was derived from has been retracted."""
        token = self.token
        if token is not None:
            if token.retracted:
                return
            token.term, token.start, token.end = self.term, self.start, self.instant
        network, fire = self.rule.network, self.rule.fire
        machine = network.logic.machine
        network.dispatcher.run_without_context(
            lambda: machine.run(fire(self.term, self.start, self.instant, machine.done, token))
        )
