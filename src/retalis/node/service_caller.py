"""Calls of services by the goals of a node: permission and time limit.

The transport calls the service. Its time is that of the limit, too: while a simulation stands still, no call times
out. One timer of the transport serves all calls, because a timer of ROS 1 is a thread.
"""

import threading
from fnmatch import fnmatchcase
from typing import Callable, Dict, List, NamedTuple, Optional, Sequence

from ..engine.service_calls import MAX_CALLS_UNDER_WAY, ServiceCall
from ..foundation.displayed_text import shorten
from ..foundation.errors import UsageError
from .transport import Transport

MAX_CALL_THREADS = 2 * MAX_CALLS_UNDER_WAY
"""Maximum number of threads of calls, including those that have ended while the middleware does not answer."""


class _Period(NamedTuple):
    """The time in which a call has to end, in nanoseconds since the epoch."""

    start: int
    end: int


class ServiceCaller:
    """Calls services through a transport.

    Args:
        transport: the middleware.
        allowed: full names of the services that may be called; ``*`` stands for any text.
    """

    def __init__(self, transport: Transport, allowed: Sequence[str]):
        self._transport = transport
        self._allowed = tuple(allowed)
        self._lock = threading.Lock()
        self._periods: Dict[ServiceCall, _Period] = {}
        self._next_check: Optional[int] = None

    def call(self, call: ServiceCall) -> None:
        """Call a service; see `retalis.engine.service_calls.CallService`.

        Raises:
            UsageError: if it is not allowed, or its name is invalid.
        """
        name = self._resolve_allowed(call.request.name)
        period = _start_period(call, self._transport.now())
        with self._lock:
            self._periods[call] = period
        call.on_end(lambda: self._forget(call))
        self._check_at(period.end)
        self._transport.call_service(name, call)

    def find_refusal(self, service: str) -> str:
        """Return the reason why goals may not call a service, or ""."""
        try:
            self._resolve_allowed(service)
        except UsageError as error:
            return error.message
        return ""

    def _resolve_allowed(self, service: str) -> str:
        """Return the full name of a service that goals may call.

        Raises:
            UsageError: if they may not, or the name is invalid.
        """
        name = self._transport.resolve_service(service)
        if not any(fnmatchcase(name, pattern) for pattern in self._allowed):
            raise UsageError(
                f"goals may not call {name}: add it to the parameter ~allow_services, which lists "
                f"{', '.join(self._allowed) or 'no service'}"
            )
        return name

    def fail_all(self, reason: str) -> None:
        """Fail the calls under way."""
        with self._lock:
            calls = list(self._periods)
        for call in calls:
            call.fail(reason)

    def _forget(self, call: ServiceCall) -> None:
        with self._lock:
            self._periods.pop(call, None)

    def _check_at(self, instant: int) -> None:
        """Check the time limits at an instant, or earlier."""
        with self._lock:
            if self._next_check is not None and self._next_check <= instant:
                return
            self._next_check = instant
        self._transport.call_later(instant - self._transport.now(), lambda: self._check(instant))

    def _check(self, instant: int) -> None:
        """Fail the calls whose time is over; called by the timer of an instant."""
        now = self._transport.now()
        with self._lock:
            if self._next_check == instant:
                self._next_check = None
            # Calls of the start, before simulated time was known.
            for call, period in self._periods.items():
                if not period.start:
                    self._periods[call] = _start_period(call, now)
            # If the clock of the machine was set back, the end of a call may be hours away.
            overdue: List[ServiceCall] = [
                call for call, period in self._periods.items() if not period.start <= now < period.end
            ]
            remaining = [period.end for call, period in self._periods.items() if call not in overdue]
        for call in overdue:
            call.fail(f"no reply within {call.request.seconds:g} s")
        if remaining:
            self._check_at(min(remaining))


def _start_period(call: ServiceCall, now: int) -> _Period:
    return _Period(now, now + int(call.request.seconds * 1e9))


class CallThreads:
    """Threads of a transport, one for each call of a service, because a call waits for the middleware.

    They are not those of the node's own services, which calls of missing services would block.
    """

    def __init__(self) -> None:
        self._free_threads = threading.BoundedSemaphore(MAX_CALL_THREADS)

    def start(self, call_service: Callable[[str, ServiceCall], object], name: str, call: ServiceCall) -> None:
        """Call a service in a new thread; its error is the reason of the failure.

        Args:
            call_service: calls the service, and waits.
            name: full name of the service.
            call: the call.

        Raises:
            UsageError: if too many calls wait.
        """
        if not self._free_threads.acquire(blocking=False):
            raise UsageError(f"{MAX_CALL_THREADS} calls wait for the middleware")

        def run() -> None:
            try:
                call_service(name, call)
            except Exception as error:
                # The libraries of ROS may raise any exception.
                call.fail(f"it cannot be called: {type(error).__name__}: {shorten(str(error))}")
            finally:
                self._free_threads.release()

        threading.Thread(target=run, daemon=True, name="service call").start()
