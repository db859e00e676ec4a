"""A piece of work whose caller waits, to be done by whoever is at work.

One runner at a time, without handing work to another thread.

Callers append to a queue; whoever gets the lock without waiting works the queue off, the others return at
once. Handing each event to a worker thread instead would double its cost.

An interrupt (a signal, usually) may end any of this between any two of its steps. So it is not made of steps that
each leave all in order: who comes in first and is interrupted goes back to the idle state (`Recovery`), and where
that is interrupted as well, the next one to come in does so.

A process that is forked has the thread that forked and no other. If another thread was at work, its work stays half
done there, so that the runner refuses all work in the child. A runner that was idle goes on in both processes.

What an engine does when an interrupt or an error of its own has ended the work on an event or a goal.

An interrupt may come between any two steps, also between two that only together leave all in order. So each part
that outlives an event can be mended: from what it is made of first it makes anew what follows from that.
"""

import os
import sys
import threading
from collections import deque
from types import FrameType
from typing import Any, Callable, Deque, Iterable, Iterator, Optional, Tuple, TypeVar
from weakref import WeakSet

from ...events.dispatch.dispatcher import Dispatcher
from ...events.knowledge.knowledge_base import KnowledgeBase
from ...events.rules.rule_base import RuleBase
from ...foundation.errors import RetalisError, UsageError
from ...prolog.system.prolog_system import PrologSystem, go_back, mend, state_of


class Request:
    """A piece of work whose caller waits for the result.

    Args:
        work: does it.
        entry: what tells it from others, see `Runner`; by default what nothing else is.
    """

    def __init__(self, work: Callable[[], object], entry: object = None):
        self._work = work
        self.entry = (work,) if entry is None else entry
        self._ticket = [None]  # whoever takes it decides what becomes of the call: it is done, or given up
        self._woken = threading.Event()
        self._result: object = None
        self.error: Optional[BaseException] = None
        self.over = self.follows = False

    def __call__(self) -> None:
        """Do the work, unless it has been taken already."""
        if not self.take():
            return
        try:
            self._result = self._work()
        except Exception as error:  # handed over to the caller that waits, in `result`
            self.error = error
        except BaseException as error:  # an interrupt, which the one who waits must not take for a result
            self.error = error
            raise
        finally:
            self.end()

    def take(self) -> bool:
        """Take the call over; False where somebody has done so already."""
        try:
            self._ticket.pop()
        except IndexError:
            return False
        return True

    def end(self) -> None:
        """Note that it has been done."""
        self.over = True
        self._woken.set()

    @property
    def begun(self) -> bool:
        """Whether it is being done."""
        return not self._ticket and not self.over

    def abandon(self) -> None:
        """End it where an interrupt has ended the work on it, wherever that was."""
        if self.begun:
            self.error = self.error or KeyboardInterrupt()
            self.end()

    def wake(self) -> None:
        """Have who waits look again."""
        self._woken.set()

    def wait(self, seconds: float) -> bool:
        """Wait until it is over or somebody wakes the caller; False where the time is up."""
        woken = self._woken.wait(seconds)
        self._woken.clear()
        return woken or self.over

    def result(self) -> Any:
        """Return the result of work that is over, or raise what it raised."""
        if self.error is not None:
            raise self.error
        return self._result


_Result = TypeVar("_Result")
_One = TypeVar("_One")
_Two = TypeVar("_Two")

_this_thread = threading.get_ident


FULL_QUEUE_WAIT_SECONDS = 1.0
"""Seconds that one who posts to a full queue waits for a piece of work to be done."""


class Recovery:
    """How to go back to a state that was before an error or an interrupt; here, for work that has no state."""

    def state(self) -> object:
        """Return the state now, for `restore`."""

    def restore(self, state: object, mend_all: bool) -> None:
        """Go back to a state, to the idle one with None; ``mend_all`` that may have been left half done."""


class SerialExecutor:
    """A bounded queue of work and the lock that lets one thread at a time do it.

    Args:
        size: how many pieces of work may wait. Past that those who post wait for a moment; where that does
            not help the oldest goes, is counted in ``dropped``, and ``on_drop`` is called.
        on_error: called with an exception that a piece of work let out.
        recovery: what goes back to how things were where work is interrupted.
        patience: seconds that a call from another thread waits for one callback.

    Attributes:
        callback: what stands for the callback that runs now, with its name; another one each time. None for none.
        entry: what tells the piece of work at hand from all others: the arguments of what was posted, or what `call`
            was given.
    """

    def __init__(
        self,
        size: int,
        on_drop: Callable[[int], None],
        on_error: Callable[[Exception], None],
        recovery: Optional[Recovery] = None,
        patience: float = 10.0,
    ):
        self._size = size
        self._queue: Deque[Tuple[Callable[..., object], Tuple[object, ...]]] = deque()
        self._calls: Deque[Request] = deque()
        self._lock = threading.RLock()
        self._running: Optional[int] = None
        """The thread that is at work. Where somebody comes in and it is set, the last one has not ended well."""
        self._patient = True
        """Whether it is worth while to wait for room; not after a wait in vain, until the queue was empty again."""
        self._on_drop = on_drop
        self._on_error = on_error
        self._recovery = Recovery() if recovery is None else recovery
        self._patience = patience
        self.callback: Optional[Tuple[str]] = None
        self.entry: object = None
        self.dropped = 0
        _RUNNERS.add(self)

    def __len__(self) -> int:
        return len(self._queue)

    @property
    def callers(self) -> int:
        """How many calls are under way or wait for their turn, made while another was at work."""
        return len(self._calls)

    @property
    def thread(self) -> Optional[int]:
        """The thread in which there is work at hand; None while there is none."""
        return self._running

    def post(self, work: Callable[..., object], *arguments: object) -> None:
        """Do a piece of work now if nobody is at work, else queue it."""
        me = _this_thread()
        if self._running == me and self._is_inside():
            self._append(work, arguments)
            return
        try:
            if not self._queue and not self._calls and self._lock.acquire(False):
                if self._running is not None:
                    self._restore(True)
                self.entry = arguments
                self._running = me
                work(*arguments)
                self._running = None
                self._lock.release()
            else:
                self._append(work, arguments)
            if self._queue or self._calls:
                self._drain()
        except Exception as error:  # one bad event must not take the others with it
            self._end(error, self._on_error)
        except BaseException:
            self._give_up()
            raise

    def post_each(self, work: Callable[[_One, _Two], object], entries: Iterable[Tuple[_One, _Two]]) -> None:
        """Do as `post` with each pair of arguments, with one turn for all while nobody else comes.

        What others call or post meanwhile comes between two of them. ``entries`` is asked for the next one when the
        one before is done or queued, in the midst of this turn: it must not call the runner, and its errors end this.
        """
        me = _this_thread()
        left = iter(entries)
        if self._running == me and self._is_inside():
            for first, second in left:
                self._append(work, (first, second))
            return
        try:
            while self._post_some(work, left):
                pass
        except Exception as error:  # of the entries: all that was before them is done
            self._end(error, lambda error: None)
            raise
        except BaseException:
            self._give_up()
            raise

    def _post_some(self, work: Callable[[_One, _Two], object], left: Iterator[Tuple[_One, _Two]]) -> bool:
        """Do what is left until somebody else comes, or queue one where somebody is at work; tell if more is left."""
        queue, calls = self._queue, self._calls
        if queue or calls or not self._lock.acquire(False):
            entry = next(left, None)
            if entry is not None:
                first, second = entry
                self._append(work, (first, second))
            self._drain()
            return entry is not None
        if self._running is not None:
            self._restore(True)
        self._running = _this_thread()
        more = False
        for first, second in left:
            self.entry = first, second  # a tuple of its own: what is one entry for the limits is one here
            try:
                work(first, second)
            except Exception as error:  # one bad event must not take the others with it
                self._failed(error)
            if queue or calls:
                more = True
                break
            self.entry = None  # while the next one is made
        self._leave()
        return more

    def call(self, work: Callable[[], _Result], entry: object = None) -> _Result:
        """Do a piece of work, after the one that runs and before those that wait; return its result.

        From inside a piece of work (a subscriber that calls back) it is done at once, as a part of that.

        Args:
            work: does it.
            entry: what tells it from others; by default what nothing else is.

        Raises:
            UsageError: where another thread is in one callback for too long: it may be waiting for this one.
        """
        me = _this_thread()
        if self._running == me and self._is_inside():
            return self._call_inside(work)
        try:
            if self._calls or not self._lock.acquire(False):
                return self._call_later(work, entry)
            if self._running is not None:
                self._restore(True)
            self.entry = (work,) if entry is None else entry
            self._running = me
            result = work()
            self._leave()
            return result
        except Exception as error:
            self._end(error, lambda error: None)
            raise
        except BaseException:
            self._give_up()
            raise

    def _end(self, error: Exception, report: Callable[[Exception], None]) -> None:
        """Be idle again after an error of the work that was being done, if any was, and do what waits."""
        # Not in a second `try` of the methods that work: where one begins an interrupt would be in neither of them.
        try:
            if self._running == _this_thread():
                self._restore(is_unexpected(error))
                report(error)
                self._leave()
        except BaseException:
            self._give_up()
            raise

    def _call_inside(self, work: Callable[[], _Result]) -> _Result:
        state = self._recovery.state()
        try:
            return work()
        except BaseException as error:
            self._recovery.restore(state, is_unexpected(error))
            raise

    def follow(self, work: Callable[[], object]) -> None:
        """Have something done, from inside a piece of work, right after that."""
        calls = self._calls
        call = Request(work)
        call.follows = True
        calls.insert(1 if calls and calls[0].begun else 0, call)

    def _call_later(self, work: Callable[[], _Result], entry: object) -> _Result:
        """Have whoever is at work do a piece of work, and wait for that."""
        call = Request(work, entry)
        self._calls.append(call)
        try:
            self._drain()
            while not call.over:
                callback = self.callback
                if not call.wait(self._patience) and callback is not None and self.callback is callback:
                    self._refuse(call, callback)
                self._drain()  # whoever was at work may have been interrupted
        except BaseException:
            call.take()
            raise
        result: _Result = call.result()
        return result

    def _refuse(self, call: Request, callback: Tuple[str]) -> None:
        if call.take():
            raise UsageError(
                f"the engine has been in {callback[0]} for {self._patience:g} s or longer and may be waiting for"
                " this thread: a thread that a callback waits for must not query the engine (post to it instead)"
            )

    def _is_inside(self) -> bool:
        """Tell whether this thread is at work below, or an interrupt has left only the mark of it."""
        frame: Optional[FrameType] = sys._getframe(2)
        while frame is not None:
            if frame.f_code in _AT_WORK and frame.f_locals.get("self") is self:
                return True
            frame = frame.f_back
        self._give_up()
        return False

    def _append(self, work: Callable[..., object], arguments: Tuple[object, ...]) -> None:
        if len(self._queue) >= self._size:
            self._make_room()
        self._queue.append((work, arguments))

    def _make_room(self) -> None:
        """Wait until the queue is worked off, or help with it; drop the oldest where nothing is done for too long.

        Whoever posts faster than events are worked off is held up, and so are those who send to it: a
        connection that is not read fills up and holds its publisher up in turn. So a burst loses nothing.
        """
        if self._patient and self._running != _this_thread():
            while len(self._queue) >= self._size:
                oldest = self._oldest()
                if self._lock.acquire(timeout=FULL_QUEUE_WAIT_SECONDS):
                    self._work_off()
                    return
                # On a busy machine all of a queue may take longer; not so one piece of work.
                self._patient = self._oldest() is not oldest
                if not self._patient:
                    break
            else:
                return
        self._drop()

    def _oldest(self) -> object:
        """Return the piece of work that comes next; None where nothing waits."""
        try:
            return self._queue[0]
        except IndexError:
            return None

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
            self._work_off()

    def _leave(self) -> None:
        """Give back the lock, and do what has come meanwhile."""
        self._running = None
        self._lock.release()
        if self._queue or self._calls:
            self._drain()

    def _work_off(self) -> None:
        """Do all that waits, and give back the lock, which the caller has taken."""
        if self._running is not None:
            self._restore(True)
        self._running = _this_thread()
        queue, calls = self._queue, self._calls
        while True:
            if calls:
                self.entry = calls[0].entry
                calls[0]()
                if calls[0].error is not None:
                    self._restore(is_unexpected(calls[0].error))
                calls.popleft()
                continue
            try:
                work, arguments = queue.popleft()
            except IndexError:
                break
            self.entry = arguments
            try:
                work(*arguments)
            except Exception as error:  # one bad event must not take the others with it
                self._failed(error)
        self._patient = True
        self._running = None
        self._lock.release()

    def _failed(self, error: Exception) -> None:
        self._restore(is_unexpected(error))
        self._on_error(error)

    def begin_in_child(self) -> None:
        """Go on in a process that has just been forked, or refuse all work if another thread was at work."""
        for call in tuple(self._calls):
            if not (call.begun or call.follows):  # its caller is a thread of the other process
                self._calls.remove(call)
        if not self._lock.acquire(False):
            self.__class__ = _Unusable
        elif self._running == _this_thread():
            self._lock.release()  # the piece of work that has forked goes on
        else:
            self._lock = threading.RLock()

    def _restore(self, mend: bool) -> None:
        self.callback = None
        self._recovery.restore(None, mend)

    def _give_up(self) -> None:
        """Be idle again after an interrupt, wherever it was, and leave the lock to others; twice is no harm."""
        if not self._lock.acquire(False):
            return  # it is another's
        if self._running is not None or self._calls:
            self._restore(self._running is not None)
            for call in tuple(self._calls):
                call.abandon()
                if call.over or call.follows:  # going back has done what was to follow
                    self._calls.remove(call)
            self._running = None
        try:
            while True:
                self._lock.release()
        except RuntimeError:  # the lock is not this thread's any more
            pass
        for call in tuple(self._calls):
            call.wake()


class _Unusable(SerialExecutor):
    """A runner in a forked process, whose work another thread of the first process has under way."""

    def post(self, work: Callable[..., object], *arguments: object) -> None:
        """Refuse a piece of work."""
        raise _refusal()

    def post_each(self, work: Callable[[_One, _Two], object], entries: Iterable[Tuple[_One, _Two]]) -> None:
        """Refuse pieces of work."""
        raise _refusal()

    def call(self, work: Callable[[], _Result], entry: object = None) -> _Result:
        """Refuse a piece of work."""
        raise _refusal()


def _refusal() -> UsageError:
    return UsageError(
        "the engine cannot be used in this process, which was forked while another thread was at work in it:"
        " make an engine in the forked process, or fork while the engine is idle"
    )


_RUNNERS: "WeakSet[SerialExecutor]" = WeakSet()


def _begin_in_child() -> None:
    for runner in tuple(_RUNNERS):
        runner.begin_in_child()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_begin_in_child)


_AT_WORK = frozenset(
    method.__code__
    for method in (
        SerialExecutor.post,
        SerialExecutor._post_some,  # noqa: SLF001
        SerialExecutor.call,
        SerialExecutor._work_off,  # noqa: SLF001
    )
)


def is_unexpected(error: BaseException) -> bool:
    """Tell whether an error may have come between any two steps, or is none that a program makes."""
    return not isinstance(error, RetalisError)


class EngineRecovery(Recovery):
    """Goes back to a state of an engine, or to that in which nothing is worked on."""

    def __init__(
        self, logic: PrologSystem, dispatcher: Dispatcher, rules: RuleBase, knowledge: KnowledgeBase
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._rules = rules
        self._knowledge = knowledge

    def state(self) -> Any:
        """Return what is being worked on."""
        return (
            state_of(self._logic.machine),
            self._rules.files.state(),
            self._dispatcher.state(),
            self._logic.new_goals,
        )

    def restore(self, state: Any, mend_all: bool) -> None:
        """Go back to a state, to the idle one with None; that one is made sound where ``mend_all`` says so."""
        if state is not None and not mend_all:
            return  # an error of a program has left all in order
        dispatcher = self._dispatcher
        machine, files, served, goals = (None, None, (None, None), None) if state is None else state
        go_back(self._logic.machine, machine)
        if mend_all:
            self._rules.files.restore(files)
        dispatcher.restore(*served)
        self._logic.new_goals = goals
        if mend_all and state is None:
            mend(self._logic)
            self._logic.from_outside = False
            dispatcher.mend()
            self._rules.mend()
            self._knowledge.mend()
