"""One runner at a time, without handing work to another thread.

Callers append to a queue; whoever gets the lock without waiting works the queue off, the others return at
once. Handing each event to a worker thread instead would double its cost.
"""

import threading
from collections import deque
from typing import Any, Callable, Deque, Optional, Tuple

_this_thread = threading.get_ident


PATIENCE = 1.0
"""Seconds that one who posts waits for room in a full queue."""


class Call:
    """A piece of work whose caller waits for the result."""

    def __init__(self, work: Callable[[], Any]):
        self._work = work
        self._done = threading.Event()
        self._result: Any = None
        self._error: Optional[BaseException] = None

    def __call__(self) -> None:
        try:
            self._result = self._work()
        except Exception as error:  # handed over to the caller that waits, in `result`
            self._error = error
        except BaseException as error:  # an interrupt, which the one who waits must not take for a result
            self._error = error
            raise
        finally:
            self._done.set()

    def result(self) -> Any:
        """Wait for the work and return its result, or raise what it raised."""
        self._done.wait()
        if self._error is not None:
            raise self._error
        return self._result


class Runner:
    """A bounded queue of work and the lock that lets one thread at a time do it.

    Args:
        size: how many pieces of work may wait. Past that those who post wait for a moment; where that does
            not help the oldest goes, is counted in ``dropped``, and ``on_drop`` is called.
        on_error: called with an exception that a piece of work let out.
    """

    def __init__(self, size: int, on_drop: Callable[[int], None], on_error: Callable[[Exception], None]):
        self._size = size
        self._queue: Deque[Tuple[Any, ...]] = deque()
        self._calls: Deque[Call] = deque()
        self._lock = threading.Lock()
        self._running: Optional[int] = None
        self._patient = True
        """Whether it is worth while to wait for room; not after a wait in vain, until the queue was empty again."""
        self._on_drop = on_drop
        self._on_error = on_error
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._queue)

    def post(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Do a piece of work now if nobody is at work, else queue it."""
        if not self._queue and not self._calls and self._lock.acquire(False):
            try:
                self._running = _this_thread()
                work(*arguments)
            except Exception as error:  # one bad event must not take the others with it
                self._on_error(error)
            finally:
                self._running = None
                self._lock.release()
        else:
            if len(self._queue) >= self._size:
                self._make_room()
            self._queue.append((work, arguments))
        if self._queue or self._calls:
            self._drain()

    def call(self, work: Callable[[], Any]) -> Any:
        """Do a piece of work, after the one that runs and before those that wait; return its result.

        From inside a piece of work (a subscriber that calls back) it is done at once.
        """
        if self._running == _this_thread():
            return work()
        call = Call(work)
        self._calls.append(call)
        self._drain()
        return call.result()

    def _make_room(self) -> None:
        """Wait until the queue is worked off, or help with it; drop the oldest where that takes too long.

        Whoever posts faster than events are worked off is held up, and so are those who send to it: a
        connection that is not read fills up and holds its publisher up in turn. So a burst loses nothing.
        """
        if self._patient and self._running != _this_thread():
            self._patient = self._lock.acquire(timeout=PATIENCE)
            if self._patient:
                self._work_off_locked()
                return
        self._drop()

    def _drop(self) -> None:
        try:
            self._queue.popleft()
        except IndexError:  # the runner took it meanwhile
            return
        self.dropped += 1
        self._on_drop(self.dropped)

    def _drain(self) -> None:
        # Again after the release: something may have been appended by one who found the lock taken.
        while self._queue or self._calls:
            if not self._lock.acquire(False):
                return
            self._work_off_locked()

    def _work_off_locked(self) -> None:
        """Do all that waits, and give back the lock, which the caller has taken."""
        try:
            self._running = _this_thread()
            self._work_off()
            self._patient = True
        finally:
            self._running = None
            self._lock.release()

    def _work_off(self) -> None:
        queue, calls = self._queue, self._calls
        while True:
            if calls:
                calls.popleft()()
                continue
            try:
                work, arguments = queue.popleft()
            except IndexError:
                return
            self._do(work, arguments)

    def _do(self, work: Callable[..., Any], arguments: Tuple[Any, ...]) -> None:
        try:
            work(*arguments)
        except Exception as error:  # one bad event must not take the others with it
            self._on_error(error)
