"""Serial executor: order, errors, waiting calls, full queues, and callbacks."""

import threading
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, Callable, Iterator, List, Tuple

import pytest
from asserting_accessors import fail
from checked_threads import CheckedThread, wait_until

from retalis import UsageError
from retalis.engine.runtime import serial_executor
from retalis.engine.runtime.serial_executor import (
    HALF_CHANGED,
    MAX_ENTRIES_PER_TURN,
    QueuedCall,
    Recovery,
    SerialExecutor,
)
from retalis.foundation.interrupts import Interrupt, postpone


def make(size: int = 100, **options: Any) -> Tuple[Any, ...]:
    drops: List[Any] = []
    errors: List[Any] = []
    return SerialExecutor(size, drops.append, errors.append, **options), drops, errors


def in_threads(work: Any) -> None:
    """Call a function in four threads, with the number of the thread, and wait for them."""
    threads = [CheckedThread(work, number) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.end()


def wait_for_caller(executor: Any) -> None:
    wait_until(lambda: executor.caller_count, "a call waits")


def test_error_in_entry_does_not_stop_later_entries() -> None:
    executor, _, errors = make()
    done: List[Any] = []
    executor.post(done.append, 1)
    executor.post(lambda: 1 / 0)
    executor.post(done.append, 2)
    assert done == [1, 2]
    assert [type(error) for error in errors] == [ZeroDivisionError]


def test_post_each_executes_in_order_despite_error() -> None:
    executor, _, errors = make()
    done: List[Any] = []

    def work(number: int, divisor: Any) -> None:
        done.append(number // divisor)

    executor.post_each(work, [(1, 1), (2, 0), (6, 2)])
    assert done == [1, 3]
    assert [type(error) for error in errors] == [ZeroDivisionError]
    assert executor.thread is None


def test_other_work_is_executed_between_entries() -> None:
    executor, _, _ = make()
    done: List[Any] = []

    def ask() -> None:
        executor.call(lambda: done.append("called"))

    caller = CheckedThread(ask)

    def work(number: int, then: Any) -> None:
        done.append(number)
        if then == "post":
            executor.post(done.append, "posted")
        elif then == "call":
            caller.start()
            wait_for_caller(executor)
        elif then == "each":
            executor.post_each(lambda *pair: done.append(pair), [(7, 8), (9, 10)])

    executor.post_each(work, [(1, "post"), (2, "call"), (3, "each"), (4, "")])
    caller.end()
    assert done == [1, "posted", 2, "called", 3, (7, 8), (9, 10), 4]


@pytest.fixture
def busy() -> Any:
    """A function that makes another thread work in an executor; it returns a function that ends this."""
    is_working, resume = threading.Event(), threading.Event()

    def first() -> None:
        is_working.set()
        assert resume.wait(10)

    def begin(executor: Any) -> Any:
        worker = CheckedThread(executor.post, first)
        worker.start()
        assert is_working.wait(10)

        def end() -> None:
            resume.set()
            worker.end()

        return end

    return begin


def test_post_each_queues_while_another_thread_works(busy: Any) -> None:
    executor, _, _ = make()
    done: List[Any] = []
    end = busy(executor)
    executor.post_each(lambda *pair: done.append(pair), zip("abc", "123"))
    assert (len(executor), done) == (3, [])
    end()
    assert done == [("a", "1"), ("b", "2"), ("c", "3")]


def test_post_each_executes_directly_when_idle(busy: Any) -> None:
    executor, _, _ = make()
    done: List[Any] = []
    seen: List[Any] = []
    end = busy(executor)

    def entries() -> Iterator[Any]:
        for number in range(5):
            if number == 2:
                end()
            seen.append((len(executor), len(done)))
            yield number, None

    executor.post_each(lambda number, none: done.append(number), entries())
    assert seen == [(0, 0), (1, 0), (0, 2), (0, 3), (0, 4)]
    assert done == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("way", ["free", "busy", "inside"])
def test_post_each_creates_separate_entries(way: str, busy: Any) -> None:
    executor, _, _ = make()
    entries: List[Any] = []
    same = [("a", None)] * 3

    def post() -> None:
        executor.post_each(lambda *pair: entries.append(executor.entry), same)

    if way == "inside":
        executor.post(post)
    else:
        end = busy(executor) if way == "busy" else lambda: None
        post()
        end()
    assert len({id(entry) for entry in entries}) == 3
    assert entries == same


@pytest.mark.parametrize("way", ["free", "busy", "inside"])
def test_work_without_arguments_has_own_entry(way: str, busy: Any) -> None:
    executor, _, _ = make()
    entries: List[Any] = []

    def post() -> None:
        for _ in range(3):
            executor.post(lambda: entries.append(executor.entry))

    if way == "inside":
        executor.post(post)
    else:
        end = busy(executor) if way == "busy" else lambda: None
        post()
        end()
    assert len({id(entry) for entry in entries}) == 3


def test_entry_is_none_while_iterator_advances() -> None:
    executor, _, _ = make()
    seen: List[Any] = []

    def entries() -> Iterator[Any]:
        for number in range(3):
            seen.append(executor.entry)
            yield number, None

    executor.post_each(lambda *pair: seen.append(executor.entry), entries())
    assert seen == [None, (0, None), None, (1, None), None, (2, None)]


def test_error_of_iterator_is_raised_by_post_each() -> None:
    executor, _, errors = make()
    done: List[Any] = []

    def entries() -> Iterator[Any]:
        yield "a", 1
        executor.post(done.append, "meanwhile")
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone"):
        executor.post_each(lambda *pair: done.append(pair), entries())
    assert (done, errors, executor.thread) == ([("a", 1), "meanwhile"], [], None)
    assert executor.call(lambda: 2) == 2


def test_error_of_iterator_leaves_queue_empty(busy: Any) -> None:
    executor, _, _ = make()
    done: List[Any] = []
    end = busy(executor)

    def entries() -> Iterator[Any]:
        yield "a", 1
        end()
        yield "b", 2
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone"):
        executor.post_each(lambda *pair: done.append(pair), entries())
    assert (len(executor), done) == (0, [("a", 1), ("b", 2)])


def test_post_each_of_many_threads_loses_no_entries() -> None:
    executor, drops, _ = make(size=50)
    done: List[Any] = []

    def post(thread: Any) -> None:
        for begin in range(0, 2000, 20):
            executor.post_each(
                lambda *pair: done.append(pair), ((thread, begin + offset) for offset in range(20))
            )

    in_threads(post)
    assert drops == []
    for thread in range(4):
        assert [number for poster, number in done if poster == thread] == list(range(2000))


def test_call_returns_result_or_raises() -> None:
    executor, _, errors = make()
    assert executor.call(lambda: 7) == 7
    with pytest.raises(KeyError):
        executor.call(lambda: {"y": 1}["x"])
    assert errors == []


def test_nested_call_is_executed_immediately() -> None:
    executor, _, _ = make()
    assert executor.call(lambda: executor.call(lambda: 3)) == 3


def test_full_queue_drops_oldest_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("retalis.engine.runtime.serial_executor.FULL_QUEUE_WAIT_SECONDS", 0.01)
    executor, drops, _ = make(size=2)
    started, resume = threading.Event(), threading.Event()
    done: List[Any] = []

    def slow() -> None:
        started.set()
        assert resume.wait(10)

    worker = CheckedThread(executor.post, slow)
    worker.start()
    assert started.wait(10)
    for number in range(4):
        executor.post(done.append, number)
    assert done == []
    assert drops == [1, 2]
    resume.set()
    worker.end()
    assert done == [2, 3]
    assert executor.dropped == 2


def test_full_queue_keeps_work_in_order() -> None:
    executor, drops, _ = make(size=2)
    done: List[Any] = []

    def post() -> None:
        for number in range(4):
            executor.post_kept(done.append, f"kept {number}")
            executor.post(done.append, number)

    executor.post(post)
    assert [entry for entry in done if isinstance(entry, str)] == [f"kept {number}" for number in range(4)]
    assert len(done) + executor.dropped == 8
    assert drops


def test_error_in_kept_work_is_reported() -> None:
    executor, _, errors = make()
    done: List[Any] = []
    executor.post_kept(lambda: 1 / 0)
    executor.post_kept(done.append, 1)
    assert ([type(error) for error in errors], done) == ([ZeroDivisionError], [1])


def test_full_queue_drops_nothing_while_it_progresses(monkeypatch: pytest.MonkeyPatch) -> None:
    started, posting, began, end = (threading.Event() for _ in range(4))
    done: List[Any] = []

    class Lock:
        """A lock whose `acquire` times out while one entry ends and the next begins."""

        def __init__(self) -> None:
            self._lock = threading.Lock()
            self.release = self._lock.release

        def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
            if timeout == -1:
                return self._lock.acquire(blocking)
            posting.set()
            assert began.wait(10)
            return False

    def first() -> None:
        started.set()
        assert posting.wait(10)

    def second() -> None:
        began.set()
        assert end.wait(10)

    with monkeypatch.context() as patched:
        patched.setattr(threading, "RLock", Lock)
        executor, drops, _ = make(size=2)
    worker = CheckedThread(executor.post, first)
    worker.start()
    assert started.wait(10)
    executor.post(second)
    executor.post(done.append, 1)
    executor.post(done.append, 2)
    end.set()
    worker.end()
    assert drops == []
    assert done == [1, 2]


def test_full_queue_blocks_posting_threads() -> None:
    executor, drops, _ = make(size=10)
    done: List[Any] = []

    def post(thread: Any) -> None:
        for number in range(2000):
            executor.post(done.append, (thread, number))

    in_threads(post)
    assert drops == []
    for thread in range(4):
        assert [number for poster, number in done if poster == thread] == list(range(2000))


def test_working_thread_does_not_wait_for_full_queue() -> None:
    executor, drops, _ = make(size=3)
    done: List[Any] = []

    def work() -> None:
        for number in range(5):
            executor.post(done.append, number)

    executor.post(work)
    assert drops == [1, 2]
    assert done == [2, 3, 4]


def test_call_is_executed_before_queued_entries() -> None:
    executor, _, _ = make()
    done: List[Any] = []
    caller = CheckedThread(executor.call, lambda: done.append("called"))

    def first() -> None:
        executor.post(done.append, "posted")
        caller.start()
        wait_for_caller(executor)

    executor.post(first)
    caller.end()
    assert done == ["called", "posted"]


def end_with(exception: Any) -> Any:
    """Return work that an exception ends."""

    def work() -> None:
        raise exception

    return work


def test_interrupt_of_call_is_raised_to_caller() -> None:
    executor, _, errors = make()
    with pytest.raises(Interrupt):
        executor.call(end_with(Interrupt()))
    assert executor.call(lambda: 1) == 1
    assert errors == []


@pytest.mark.parametrize("way", ["post", "post_each", "call"])
def test_postponed_exception_is_raised_after_work(way: str) -> None:
    executor, _, errors = make()
    done: List[Any] = []

    def work(*entry: Any) -> None:
        done.append(entry)
        if len(done) == 1:
            postpone(Interrupt())

    ways = {
        "post": lambda: executor.post(work, 1, 2),
        "post_each": lambda: executor.post_each(work, [(1, 2), (3, 4)]),
        "call": lambda: executor.call(work),
    }
    with pytest.raises(Interrupt):
        ways[way]()
    assert done == [() if way == "call" else (1, 2)]
    ways[way]()
    assert len(done) == (3 if way == "post_each" else 2)
    assert errors == []


def test_postponed_exception_is_raised_after_outermost_call() -> None:
    executor, _, _ = make()
    done: List[Any] = []

    def outer() -> None:
        postpone(Interrupt())
        executor.call(lambda: done.append("nested"))
        executor.post(done.append, "posted")
        done.append("outer")

    with pytest.raises(Interrupt):
        executor.call(outer)
    assert done == ["nested", "outer", "posted"]


@pytest.mark.parametrize("exception", [KeyboardInterrupt, SystemExit])
def test_exception_within_work_makes_executor_unusable(exception: Any) -> None:
    executor, _, errors = make()
    with pytest.raises(exception):
        executor.call(end_with(exception()))
    uses: List[Callable[[], object]] = [
        lambda: executor.call(lambda: 1),
        lambda: executor.post(errors.append, 1),
        lambda: executor.post_each(lambda first, second: errors.append(first), [(1, 2)]),
    ]
    for use in uses:
        with pytest.raises(UsageError, match="continue with a new engine"):
            use()
    assert errors == []


def test_exception_within_work_is_an_error_of_waiting_caller() -> None:
    executor, _, _ = make()
    is_working, resume = threading.Event(), threading.Event()

    def interrupted() -> None:
        is_working.set()
        assert resume.wait(10)
        raise KeyboardInterrupt

    def first() -> None:
        with pytest.raises(KeyboardInterrupt):
            executor.call(interrupted)

    def second() -> None:
        with pytest.raises(UsageError) as error:
            executor.call(lambda: 2)
        assert str(error.value) == HALF_CHANGED

    threads = [CheckedThread(first), CheckedThread(second)]
    threads[0].start()
    assert is_working.wait(10)
    threads[1].start()
    wait_for_caller(executor)
    resume.set()
    for thread in threads:
        thread.end()


def test_exception_while_error_is_handled_makes_executor_unusable() -> None:
    class Interrupted(Recovery):
        def restore(self, state: Any) -> None:
            raise KeyboardInterrupt

    executor = SerialExecutor(10, fail, lambda error: None)
    executor.set_recovery(Interrupted())
    with pytest.raises(KeyboardInterrupt):
        executor.call(end_with(ValueError()))
    with pytest.raises(UsageError, match="continue with a new engine"):
        executor.call(lambda: 1)


class RecordedRecovery(Recovery):
    """A recovery of numbered states, which records the restored ones."""

    def __init__(self) -> None:
        self.state_count = 0
        self.restored: List[object] = []

    def state(self) -> object:
        self.state_count += 1
        return self.state_count

    def restore(self, state: object) -> None:
        self.restored.append(state)


@pytest.mark.parametrize(("error", "restored"), [(ValueError("wrong"), [2, 1]), (UsageError("wrong"), [])])
def test_nested_call_restores_state_at_its_start(error: Exception, restored: List[int]) -> None:
    executor, _, errors = make()
    recovery = RecordedRecovery()
    executor.set_recovery(recovery)

    def outermost() -> int:
        with pytest.raises(type(error)):
            executor.call(lambda: executor.call(end_with(error)))
        return recovery.state_count

    assert executor.call(outermost) == 2
    assert recovery.restored == restored
    assert errors == []


def test_timed_out_call_is_not_executed_later() -> None:
    executor, _, _ = make(callback_timeout=0)
    done: List[Any] = []

    def ask() -> None:
        with pytest.raises(UsageError, match="the engine has been in a callback for 0 s"):
            executor.call(lambda: done.append("asked"))

    def wait() -> None:
        thread = CheckedThread(ask)
        thread.start()
        thread.end()
        done.append("waited")

    def work() -> None:
        outer_callback = executor.begin_callback("a callback")
        wait()
        executor.end_callback(outer_callback)

    executor.call(work)
    assert done == ["waited"]


def test_queued_call_is_executed_once_and_keeps_result() -> None:
    done: List[int] = []

    def work() -> int:
        done.append(1)
        return 7

    call = QueuedCall(work)
    assert not call.is_running
    call()
    call()
    assert done == [1]
    assert call.wait(10)
    assert call.result() == 7


@pytest.mark.parametrize(("exception", "expected"), [(Interrupt, Interrupt), (KeyboardInterrupt, UsageError)])
def test_exception_of_queued_call_is_raised_by_result(exception: Any, expected: Any) -> None:
    call = QueuedCall(end_with(exception()))
    # An exception at any point ends the thread that works, too; an interrupt is only for the waiting caller.
    with pytest.raises(exception) if expected is UsageError else nullcontext():
        call()
    with pytest.raises(expected):
        call.result()


def test_cancelled_call_is_not_executed() -> None:
    done: List[int] = []
    call = QueuedCall(lambda: done.append(1))
    assert call.claim()
    call()
    assert (done, call.claim()) == ([], False)


@pytest.fixture
def at_end_of_turn(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that sets the action of other threads at the end of a turn of this thread."""
    this_thread = threading.current_thread()

    def set_action(action: Any) -> None:
        def sleep(seconds: Any) -> None:
            if threading.current_thread() is this_thread:
                action()

        monkeypatch.setattr(serial_executor, "time", SimpleNamespace(sleep=sleep))

    return set_action


def run_in_thread(name: str, work: Any) -> None:
    thread = CheckedThread(work, name=name)
    thread.start()
    thread.end()


def test_posting_thread_takes_over_from_caller(at_end_of_turn: Any) -> None:
    executor, _, errors = make(10_000)
    workers: List[Any] = []

    def work(number: int) -> None:
        workers.append((number, threading.current_thread().name))

    def post_burst() -> None:
        for number in range(1000):
            executor.post(work, number)

    at_end_of_turn(lambda: run_in_thread("loop", lambda: executor.post(work, 1000)))
    executor.call(lambda: run_in_thread("burst", post_burst))
    assert [number for number, _ in workers] == list(range(1001))
    expected = [threading.current_thread().name] * MAX_ENTRIES_PER_TURN
    assert [name for _, name in workers] == expected + ["loop"] * (1001 - MAX_ENTRIES_PER_TURN)
    assert not errors
    assert executor.thread is None


def test_waiting_caller_takes_over_from_posting_thread(at_end_of_turn: Any) -> None:
    executor, _, _ = make(10_000)
    workers: List[str] = []
    callers: List[CheckedThread] = []

    def work(number: int) -> None:
        workers.append(threading.current_thread().name)

    def begin_call() -> None:
        caller = CheckedThread(executor.call, lambda: work(0), name="caller")
        callers.append(caller)
        caller.start()
        wait_for_caller(executor)

    def post_burst() -> None:
        for number in range(MAX_ENTRIES_PER_TURN - 1):
            executor.post(work, number)
        executor.post(begin_call)
        for number in range(MAX_ENTRIES_PER_TURN):
            executor.post(work, number)

    at_end_of_turn(lambda: callers[0].end())
    executor.post(lambda: run_in_thread("burst", post_burst))
    this_thread = threading.current_thread().name
    assert workers == [this_thread] * (MAX_ENTRIES_PER_TURN - 1) + ["caller"] * (MAX_ENTRIES_PER_TURN + 1)


def test_follow_up_work_is_executed_with_its_entry() -> None:
    executor, _, _ = make(10_000)
    done: List[Any] = []

    def work(number: int) -> None:
        done.append(number)
        executor.call_next(lambda: done.append(-number))

    executor.call(lambda: [executor.post(work, number) for number in range(1, 301)])
    assert done == [value for number in range(1, 301) for value in (number, -number)]
