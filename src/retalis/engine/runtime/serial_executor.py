"""Serial executor: one thread at a time works on the engine, without a worker thread.

Callers append work to a bounded queue. The caller that acquires the lock without waiting works the queue off; the
others return at once, or wait for the result of a call. Passing each event to a worker thread would double its cost
(the technique is called flat combining).

While one thread posts in a loop, the queue may never be empty, and the thread that processes it could never return.
It therefore releases the lock after `MAX_ENTRIES_PER_TURN` entries and lets other threads run: a thread that posts or
waits for a call then takes over.

An interrupt is raised when the work of a thread has ended (`foundation.interrupts`). An exception that ends the work
itself, such as the `KeyboardInterrupt` of Python's own handler of SIGINT, may leave data half changed: the thread id
in `_working_thread` remains, and the executor refuses all further work.

A forked process contains only the thread that forked. If another thread was working at that moment, its work stays
unfinished in the child, so the executor of the child refuses all work. An idle executor continues in both processes.
"""

import os
import sys
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Callable, Deque, Iterable, Iterator, NoReturn, Optional, Tuple, TypeVar
from weakref import WeakSet

from ...events.dispatch.dispatcher import Dispatcher
from ...foundation.errors import RetalisError, UsageError
from ...foundation.interrupts import PENDING, SafeExit, interruptible, raise_pending
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.types import atom
from ...serialization.state_fields import StateFields, StateOwner, field
from ...serialization.stored_field_types import COUNT

if TYPE_CHECKING:
    from types import FrameType

UNNAMED_REQUEST = atom("a request")
"""Name, in warnings about its duration, of work that has no name of its own."""


FORKED_IN_USE = (
    "the engine cannot be used in this process, which was forked while another thread was using it:"
    " make an engine in the forked process, or fork while the engine is idle"
)
"""Reason for which the engine of a forked process refuses all work."""

HALF_CHANGED = (
    "the engine cannot be used any more, because an exception that may come at any point, as that of Ctrl-C, has"
    " ended its work: continue with a new engine, for example of `Engine.restore`; within"
    " `retalis.deferred_interrupts()` Ctrl-C leaves engines usable"
)
"""Reason for which an engine refuses all work after an exception that is no error."""


class QueuedCall:
    """A unit of work that waits for the working thread: a call of another thread, or work scheduled by `call_next`.

    Args:
        work: function that does the work.
        entry: identity of the work for the limits, see `SerialExecutor.entry`; by default a new one.
    """

    def __init__(self, work: Callable[[], object], entry: object = None):
        self._work = work
        self.entry = (work,) if entry is None else entry
        # Popped once: by the thread that does the work, or by the caller if it stops waiting.
        self._ticket = [None]
        self._state_changed = threading.Event()
        self._result: object = None
        self.error: Optional[BaseException] = None
        self.is_finished = self.is_follow_up = False

    def __call__(self) -> None:
        """Do the work, unless another thread has claimed it."""
        if not self.claim():
            return
        try:
            self._result = self._work()
        except (Exception, SafeExit) as error:  # raised again in the waiting caller, by `result`
            self.error = error
        except BaseException:
            self.error = UsageError(HALF_CHANGED)
            raise
        finally:
            self.finish()

    def claim(self) -> bool:
        """Claim the call, so that no other thread does its work. Return False if another thread has claimed it."""
        try:
            self._ticket.pop()
        except IndexError:
            return False
        return True

    def finish(self) -> None:
        """Mark the call as done."""
        self.is_finished = True
        self._state_changed.set()

    @property
    def is_running(self) -> bool:
        """True while the work is in progress."""
        return not self._ticket and not self.is_finished

    def wake(self) -> None:
        """Wake the waiting caller, so that it checks the state again."""
        self._state_changed.set()

    def wait(self, seconds: float) -> bool:
        """Wait until the call is done or `wake` is called; return False after the timeout in seconds."""
        was_signalled = self._state_changed.wait(seconds)
        self._state_changed.clear()
        return was_signalled or self.is_finished

    def result(self) -> Any:
        """Return the result of the work, or raise its error."""
        if self.error is not None:
            raise self.error
        return self._result


_Result = TypeVar("_Result")
_Argument1 = TypeVar("_Argument1")
_Argument2 = TypeVar("_Argument2")

_thread_id = threading.get_ident


FULL_QUEUE_WAIT_SECONDS = 1.0
"""Time for which a caller of `post` waits for progress if the queue is full."""


MAX_ENTRIES_PER_TURN = 100
"""Maximum number of entries and calls that a thread does before it lets another thread take over the queue."""


class Recovery:
    """Restoration of an earlier state after an error. This base class is for work without state."""

    def state(self) -> object:
        """Return the current state, for `restore`."""

    def restore(self, state: object) -> None:
        """Return to a state of `state`, or to the idle state if it is None."""


class SerialExecutor(StateOwner):
    """A bounded queue of work, and the lock with which one thread at a time does it.

    Args:
        size: capacity of the queue. If it is full, callers of `post` wait for progress; without progress the oldest
            entry is dropped, counted in ``dropped``, and ``on_drop`` is called.
        on_drop: called with the number of dropped entries.
        on_error: called with an exception that a unit of work raised.
        callback_timeout: seconds for which a call from another thread waits for one callback.

    Attributes:
        running_callback: 1-tuple with the name of the running callback, a new object for each call, so that two calls
            can be told apart by identity; None if none runs.
        entry: identity of the current work: the arguments of a posted event, or the ``entry`` of a call.
        dropped: number of entries that were dropped because the queue was full.
        refusal: reason for which all work is refused; empty while the executor can be used.
    """

    STATE = StateFields(field("dropped", COUNT))

    def __init__(
        self,
        size: int,
        on_drop: Callable[[int], None],
        on_error: Callable[[Exception], None],
        callback_timeout: float = 10.0,
    ):
        self._size = size
        self._queue: Deque[Tuple[Callable[..., object], Tuple[object, ...]]] = deque()
        self._kept_work: Deque[Tuple[Callable[..., object], Tuple[object, ...]]] = deque()
        """Work of `post_kept`; the queue has an entry of `_do_kept_work` for each."""
        self._calls: Deque[QueuedCall] = deque()
        self._lock = threading.RLock()
        self._working_thread: Optional[int] = None
        """The working thread. If it is set although the lock is free, an exception has ended the last work."""
        self._waits_for_room = True
        """True if `post` waits for room in the queue; False after a timeout until the queue has been empty."""
        self._on_drop = on_drop
        self._on_error = on_error
        self._recovery = Recovery()
        self._callback_timeout = callback_timeout
        self.running_callback: Optional[Tuple[str]] = None
        self.entry: object = None
        self.dropped = 0
        self.refusal = ""
        _EXECUTORS.add(self)

    def __len__(self) -> int:
        return len(self._queue)

    @property
    def caller_count(self) -> int:
        """Number of pending calls of other threads, including the running one."""
        return len(self._calls)

    @property
    def thread(self) -> Optional[int]:
        """The working thread; None if the executor is idle."""
        return self._working_thread

    def set_recovery(self, recovery: Recovery) -> None:
        """Set what returns to an earlier state after an error, once the data exists."""
        self._recovery = recovery

    def replace_entry(self, entry: object) -> object:
        """Set the identity of the current work; return the previous one."""
        previous, self.entry = self.entry, entry
        return previous

    def begin_callback(self, name: str) -> Optional[Tuple[str]]:
        """Record that a callback of the user runs; return the outer one, for `end_callback`."""
        outer_callback, self.running_callback = self.running_callback, (name,)
        return outer_callback

    def end_callback(self, outer_callback: Optional[Tuple[str]]) -> None:
        """Record that a callback has ended."""
        self.running_callback = outer_callback

    def post(self, work: Callable[..., object], *arguments: object) -> None:
        """Do work now if the executor is idle, otherwise queue it. Errors of the work are passed to ``on_error``."""
        this_thread = _thread_id()
        if self._working_thread == this_thread and self._is_nested():
            self._append(work, arguments)
            return
        try:
            if not self._queue and not self._calls and self._lock.acquire(False):
                if self._working_thread is not None:
                    self._refuse_work()
                # Work without arguments gets a new tuple: the limits of entries compare them by identity.
                self.entry = arguments or (work,)
                self._working_thread = this_thread
                work(*arguments)
                self._working_thread = None
                self._lock.release()
            else:
                self._append(work, arguments)
            if self._queue or self._calls:
                self._process_if_free()
        except Exception as error:  # a failing event must not affect the others
            self._handle_failed_work(error, self._on_error)
        except BaseException as exception:
            self._abandon_work(exception)
            raise
        if PENDING:
            raise_pending()

    def post_kept(self, work: Callable[..., object], *arguments: object) -> None:
        """Post work that is not dropped and does not wait for room if the queue is full; see `post`.

        The caller limits the number of such pieces of work.
        """
        self._kept_work.append((work, arguments))
        self.post(self._do_kept_work)

    def _do_kept_work(self) -> None:
        """Do the oldest work of `post_kept`."""
        work, arguments = self._kept_work.popleft()
        self.entry = arguments or (work,)
        work(*arguments)

    def post_each(
        self,
        work: Callable[[_Argument1, _Argument2], object],
        entries: Iterable[Tuple[_Argument1, _Argument2]],
    ) -> None:
        """Post each pair of arguments, under one acquisition of the lock while no other thread posts or calls.

        Work of other threads is done between two entries. ``entries`` is advanced while the lock is held: it must not
        use the executor, and an error that it raises ends this method.
        """
        this_thread = _thread_id()
        remaining = iter(entries)
        if self._working_thread == this_thread and self._is_nested():
            for first, second in remaining:
                self._append(work, (first, second))
            return
        try:
            while self._post_under_lock(work, remaining):
                if PENDING:
                    raise_pending()
        except Exception as error:  # raised by the iterator: all entries before it are done
            self._handle_failed_work(error, _ignore_error)
            raise
        except BaseException as exception:
            self._abandon_work(exception)
            raise
        if PENDING:
            raise_pending()

    def _post_under_lock(
        self,
        work: Callable[[_Argument1, _Argument2], object],
        remaining: Iterator[Tuple[_Argument1, _Argument2]],
    ) -> bool:
        """Do entries until another thread posts or calls, or an interrupt comes; queue one if another thread works.

        Returns:
            Whether entries may remain.
        """
        queue, calls = self._queue, self._calls
        if queue or calls or not self._lock.acquire(False):
            entry = next(remaining, None)
            if entry is not None:
                first, second = entry
                self._append(work, (first, second))
            self._process_if_free()
            return entry is not None
        if self._working_thread is not None:
            self._refuse_work()
        self._working_thread = _thread_id()
        entries_remain = False
        for first, second in remaining:
            self.entry = first, second  # a new tuple for each entry: the limits compare by identity
            try:
                work(first, second)
            except Exception as error:  # a failing event must not affect the others
                self._handle_entry_error(error)
            if queue or calls or PENDING:
                entries_remain = True
                break
            self.entry = None  # the iterator runs outside of any entry
        self._release()
        return entries_remain

    def call(self, work: Callable[[], _Result], entry: object = None) -> _Result:
        """Do work after the current entry and before queued ones, and return its result.

        A call from inside of work (a callback that uses the engine) runs at once, as a part of that work.

        Args:
            work: function that does the work.
            entry: its identity for the limits; by default a new one.

        Raises:
            UsageError: if another thread stays in one callback for longer than ``callback_timeout``, because that
                callback may wait for this thread.
        """
        this_thread = _thread_id()
        if self._working_thread == this_thread and self._is_nested():
            return self._call_nested(work)
        try:
            if self._calls or not self._lock.acquire(False):
                return self._wait_for_call(work, entry)
            if self._working_thread is not None:
                self._refuse_work()
            self.entry = (work,) if entry is None else entry
            self._working_thread = this_thread
            result = work()
            self._release()
        except Exception as error:
            self._handle_failed_work(error, _ignore_error)
            if PENDING:
                raise_pending()
            raise
        except BaseException as exception:
            self._abandon_work(exception)
            raise
        if PENDING:
            raise_pending()
        return result

    def report_isolated_error(self, error: Exception, is_idle: bool) -> None:
        """Report an error of a part of the current work that does not affect the rest.

        Args:
            error: the error.
            is_idle: whether no event is being dispatched and no goal runs.
        """
        if is_idle and is_unexpected(error):
            self._recovery.restore(None)
        self._on_error(error)

    def _handle_failed_work(self, error: Exception, report: Callable[[Exception], None]) -> None:
        """Return to the idle state after an error of this thread's work, and work off the queue.

        If this thread does not work, the error was raised before its work began, and there is nothing to restore.
        """
        try:
            if self.refusal:
                raise error
            if self._working_thread == _thread_id():
                self._restore()
                report(error)
                self._release()
        except BaseException as exception:
            self._abandon_work(exception)
            raise

    def _call_nested(self, work: Callable[[], _Result]) -> _Result:
        """Do work as a part of the current work; after an error, return to the state at its start."""
        state = self._recovery.state()
        try:
            return work()
        except BaseException as error:
            # A `RetalisError` leaves the engine in a consistent state, so there is nothing to restore.
            if is_unexpected(error):
                self._recovery.restore(state)
            raise

    def call_next(self, work: Callable[[], object]) -> None:
        """Schedule work directly after the current one; called from inside of work.

        Of several pieces of work that the current one schedules, the last is done first.
        """
        calls = self._calls
        call = QueuedCall(work)
        call.is_follow_up = True
        calls.insert(1 if calls and calls[0].is_running else 0, call)

    def _wait_for_call(self, work: Callable[[], _Result], entry: object) -> _Result:
        """Pass a call to the working thread and wait for its result."""
        call = QueuedCall(work, entry)
        self._calls.append(call)
        try:
            self._process_if_free()
            while not call.is_finished:
                callback = self.running_callback
                with interruptible():
                    was_signalled = call.wait(self._callback_timeout)
                if not was_signalled and callback is not None and self.running_callback is callback:
                    self._fail_waiting_call(call, callback)
                self._process_if_free()  # an exception may have ended the work of the other thread
        except BaseException:
            call.claim()
            raise
        result: _Result = call.result()
        return result

    def _fail_waiting_call(self, call: QueuedCall, callback: Tuple[str]) -> None:
        """Raise an error in the waiting thread, unless the work of its call has begun."""
        if call.claim():
            raise UsageError(
                f"the engine has been in {callback[0]} for {self._callback_timeout:g} s or longer and may be waiting"
                " for this thread: a thread that a callback waits for must not query the engine (post to it instead)"
            )

    def _is_nested(self) -> bool:
        """Return whether a caller of this method already runs work of this executor.

        Raises:
            UsageError: if not. The thread id in `_working_thread` then remains from work that an exception has ended.
        """
        frame: Optional[FrameType] = sys._getframe(2)
        while frame is not None:
            if frame.f_code in _CODE_OF_WORKING_METHODS and frame.f_locals.get("self") is self:
                return True
            frame = frame.f_back
        return self._refuse_work()

    def _append(self, work: Callable[..., object], arguments: Tuple[object, ...]) -> None:
        if len(self._queue) >= self._size and work != self._do_kept_work:
            self._make_room()
        self._queue.append((work, arguments))

    def _make_room(self) -> None:
        """Wait for room in the queue, or work it off; drop the oldest entry if there is no progress.

        The wait is the backpressure of the engine: meanwhile the caller's connection is not read, so TCP slows down
        the publisher, and a short burst of messages loses none.
        """
        if self._waits_for_room and self._working_thread != _thread_id():
            while len(self._queue) >= self._size:
                oldest = self._oldest_entry()
                with interruptible():
                    is_free = self._lock.acquire(timeout=FULL_QUEUE_WAIT_SECONDS)
                if is_free:
                    self._process_queue()
                    return
                # A whole queue can take longer on a busy machine; progress means a new oldest entry.
                self._waits_for_room = self._oldest_entry() is not oldest
                if not self._waits_for_room:
                    break
            else:
                return
        self._drop_oldest()

    def _oldest_entry(self) -> object:
        """Return the next entry of the queue, or None."""
        try:
            return self._queue[0]
        except IndexError:
            return None

    def _drop_oldest(self) -> None:
        """Drop the oldest entry that is not one of `post_kept`."""
        kept_entries = []
        try:
            while True:
                entry = self._queue.popleft()
                if entry[0] != self._do_kept_work:
                    break
                kept_entries.append(entry)
        except IndexError:  # the working thread took it in the meantime, or all entries are kept
            return
        finally:
            # The working thread may do later entries meanwhile. The order of the kept work does not change: the
            # entries are equal, and each does the oldest work of `_kept_work`.
            self._queue.extendleft(kept_entries)
        self.dropped += 1
        self._on_drop(self.dropped)

    def _process_if_free(self) -> None:
        """Do all queued work, unless another thread works or takes over."""
        # Repeated after each release: a thread that found the lock taken may have appended work just before.
        while self._queue or self._calls:
            if not self._lock.acquire(False):
                return
            self._process_queue()
            if self._queue or self._calls:
                # Releases Python's global lock, so that a thread that posts or has been woken finds the lock free.
                time.sleep(0)

    def _release(self) -> None:
        """Release the lock, and do the work that arrived in the meantime."""
        self._working_thread = None
        self._lock.release()
        if self._queue or self._calls:
            self._process_if_free()

    def _process_queue(self) -> None:
        """Do at most `MAX_ENTRIES_PER_TURN` pieces of work and release the lock, which the caller has acquired."""
        if self._working_thread is not None:
            self._refuse_work()
        self._working_thread = _thread_id()
        queue, calls = self._queue, self._calls
        remaining = MAX_ENTRIES_PER_TURN
        # Work of `call_next` belongs to the work before it and is done in the same turn.
        while remaining > 0 or (calls and calls[0].is_follow_up):
            remaining -= 1
            if calls:
                self.entry = calls[0].entry
                calls[0]()
                if calls[0].error is not None:
                    self._restore()
                # Removed last: during its work, `call_next` recognizes the running call by its place in the queue.
                calls.popleft()
                continue
            try:
                work, arguments = queue.popleft()
            except IndexError:
                self._waits_for_room = True
                break
            self.entry = arguments or (work,)
            try:
                work(*arguments)
            except Exception as error:  # a failing event must not affect the others
                self._handle_entry_error(error)
        next_call = calls[0] if calls else None
        self._working_thread = None
        self._lock.release()
        if next_call is not None:
            # Its caller can do the work itself.
            next_call.wake()

    def _handle_entry_error(self, error: Exception) -> None:
        self._restore()
        self._on_error(error)

    def reset_in_child(self) -> None:
        """Continue in a forked process, or refuse all work if another thread was working."""
        for call in tuple(self._calls):
            if not (call.is_running or call.is_follow_up):  # its caller is a thread of the parent process
                self._calls.remove(call)
        if not self._lock.acquire(False):
            # The thread that holds the lock does not exist in this process, so the lock is never released.
            self._make_unusable(FORKED_IN_USE)
        else:
            # The executor is idle, or this thread was working when it forked: its work continues with the lock that
            # it already holds.
            self._lock.release()

    def _restore(self) -> None:
        """Return to the idle state after an error."""
        self.running_callback = None
        self._recovery.restore(None)

    def _abandon_work(self, exception: BaseException) -> None:
        """End the work of this thread after an exception that is no error, and release the lock."""
        if self._working_thread == _thread_id():
            if isinstance(exception, SafeExit):
                self._restore()
                self._release()
                return
            self._make_unusable(HALF_CHANGED)
        try:
            # Also if the exception came between the acquisition of the lock and the start of the work.
            self._lock.release()
        except RuntimeError:  # this thread does not hold the lock
            pass
        for call in tuple(self._calls):
            call.wake()

    def _refuse_work(self) -> NoReturn:
        """Refuse all work from now on, because an exception has ended the last work at any point.

        Raises:
            UsageError: the error that all further callers get, too.
        """
        self._make_unusable(HALF_CHANGED)
        raise UsageError(self.refusal)

    def _make_unusable(self, refusal: str) -> None:
        self.refusal = refusal
        # The class changes because a check of `refusal` in its methods would cost each event.
        self.__class__ = _UnusableExecutor


class _UnusableExecutor(SerialExecutor):
    """An executor that refuses all work, because data may be half changed; see `refusal`."""

    def post(self, work: Callable[..., object], *arguments: object) -> None:
        """Refuse the work."""
        raise UsageError(self.refusal)

    def post_each(
        self,
        work: Callable[[_Argument1, _Argument2], object],
        entries: Iterable[Tuple[_Argument1, _Argument2]],
    ) -> None:
        """Refuse the work."""
        raise UsageError(self.refusal)

    def call(self, work: Callable[[], _Result], entry: object = None) -> _Result:
        """Refuse the work."""
        raise UsageError(self.refusal)

    def _process_if_free(self) -> None:
        """Refuse the work that threads have queued before."""
        raise UsageError(self.refusal)


_EXECUTORS: "WeakSet[SerialExecutor]" = WeakSet()


def _reset_executors_in_child() -> None:
    for executor in tuple(_EXECUTORS):
        executor.reset_in_child()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_reset_executors_in_child)


_CODE_OF_WORKING_METHODS = frozenset(
    method.__code__
    for method in (
        SerialExecutor.post,
        SerialExecutor._post_under_lock,  # noqa: SLF001
        SerialExecutor.call,
        SerialExecutor._process_queue,  # noqa: SLF001
    )
)
"""Code objects of the methods that do work; `_is_nested` searches the stack for them."""


def _ignore_error(error: Exception) -> None:
    """Ignore an error, because it is raised again in the caller."""


def is_unexpected(error: BaseException) -> bool:
    """Return whether an error has skipped the end of goals: an internal error, or an exception that is no error."""
    return not isinstance(error, RetalisError)


class EngineRecovery(Recovery):
    """Recovery of an engine: to the state at the start of a nested call, or to the idle state."""

    def __init__(self, logic: PrologSystem, dispatcher: Dispatcher):
        self._logic = logic
        self._dispatcher = dispatcher

    def state(self) -> Any:
        """Return the states of machine, dispatcher and compiler, for `restore`."""
        return (
            self._logic.machine.state(),
            self._dispatcher.context_state(),
            self._logic.new_goals,
        )

    def restore(self, state: Any) -> None:
        """Return to a state of `state`, or to the idle state if it is None."""
        saved_machine, saved_dispatch, new_goals = (None, (None, None), None) if state is None else state
        self._logic.machine.restore(saved_machine)
        self._dispatcher.restore_context(*saved_dispatch)
        self._logic.continue_precompiling(new_goals)
