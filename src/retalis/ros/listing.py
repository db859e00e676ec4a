"""Service ``~list``: what a node holds, with counters."""

from typing import Any, Callable, Optional, Sequence

import rospy

from ..engine import MemoryStatus, RuleStatus, Status, SubscriptionStatus, WaitingStatus
from ..engine.runtime import Reports
from ..prolog.terms import SECOND
from .counting import InputStatus
from .log import log_counts
from .services import OK

MOST = 100
"""How many of each kind are listed where a request does not say it."""

MOST_OF_ALL = 10_000
"""How many of each kind are listed, whatever a request says."""

NEVER = -1
"""Nanoseconds of a duration that is none."""

_LAST = 1 << 32
"""Seconds after the last that a message of ROS can tell."""

_LONGEST = 1 << 31


class Listing:
    """Service ``~list`` of a node.

    Args:
        inputs: gives what has come on its subscribed topics.
        status: gives the status of its engine with at most so many of each kind; None where it has no engine.
        reports: the problems of a node that has no engine.
    """

    def __init__(
        self,
        inputs: Callable[[], Sequence[InputStatus]],
        status: Optional[Callable[[int], Status]] = None,
        reports: Optional[Reports] = None,
    ):
        from retalis import msg, srv  # noqa: PLC0415 - generated: there only where the package was built

        self._inputs = inputs
        self._status = status
        self._reports = reports
        self._msg = msg
        self._response = srv.ListResponse
        rospy.Service("~list", srv.List, self._list)

    def _list(self, request: Any) -> Any:
        most = min(request.most or MOST, MOST_OF_ALL)
        response = self._response(result=OK)
        inputs = self._inputs()
        response.inputs = [self._input(one) for one in inputs[:most]]
        response.more_inputs = max(0, len(inputs) - most)
        if self._status is None:
            response.now = rospy.get_rostime()
            if self._reports is not None:
                response.errors, response.warnings = self._reports.errors, self._reports.warnings
        else:
            self._fill(response, self._status(most))
        response.errors += log_counts.errors
        response.warnings += log_counts.warnings
        return response

    def _fill(self, response: Any, status: Status) -> None:
        response.now = _time(status.now)
        if status.work is not None:
            response.work, response.work_goal = status.work.what, status.work.goal
            response.work_place = status.work.place
            response.work_time = _duration(int(status.work.seconds * SECOND))
        for name in ("taken", "fired", "queued", "dropped", "errors", "warnings", "alarms"):
            setattr(response, name, getattr(status, name))
        response.rules = [self._rule(one) for one in status.rules]
        response.memories = [self._memory(one) for one in status.memories]
        response.subscriptions = [self._subscription(one) for one in status.subscriptions]
        response.waiting = [self._query(one) for one in status.waiting]
        for name, number in status.left_out._asdict().items():
            setattr(response, f"more_{name}", number)

    def _rule(self, one: RuleStatus) -> Any:
        return self._msg.RuleStatus(**one._replace(last_fired=_time(one.last_fired))._asdict())

    def _memory(self, one: MemoryStatus) -> Any:
        return self._msg.MemoryStatus(
            **one._replace(oldest=_time(one.oldest), newest=_time(one.newest))._asdict()
        )

    def _subscription(self, one: SubscriptionStatus) -> Any:
        return self._msg.SubscriptionStatus(**one._asdict())

    def _query(self, one: WaitingStatus) -> Any:
        memories = [
            self._msg.AwaitedMemory(memory.id, _time(memory.instant), _duration(memory.behind))
            for memory in one.memories
        ]
        return self._msg.WaitingStatus(one.event, _time(one.since), memories, one.left_out)

    def _input(self, one: InputStatus) -> Any:
        age = None if one.age is None else int(one.age * SECOND)
        return self._msg.InputStatus(
            **one._replace(age=_duration(age), lag=_duration(one.lag or 0))._asdict()
        )


def _time(instant: Optional[int]) -> Any:
    """Return an instant as ROS has it; zero for none, the first or last one for those that it cannot tell."""
    return rospy.Time(0, min(max(instant or 0, 0), _LAST * SECOND - 1))


def _duration(nanoseconds: Optional[int]) -> Any:
    """Return a time span as ROS has it; the shortest negative one for none."""
    span = NEVER if nanoseconds is None else nanoseconds
    return rospy.Duration(0, min(max(span, -_LONGEST * SECOND), _LONGEST * SECOND - 1))
