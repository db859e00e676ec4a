import threading
import time

import pytest

from retalis import UsageError
from retalis.engine.runtime.serial_executor import Recovery, SerialExecutor


def make(size=100, **options):
    drops, errors = [], []
    return SerialExecutor(size, drops.append, errors.append, **options), drops, errors


def in_threads(work):
    """Have four threads work at once, each called with its number, until all are done."""
    threads = [threading.Thread(target=work, args=(thread,)) for thread in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)


def test_work_is_done_in_order_and_an_error_stops_nothing():
    runner, _, errors = make()
    done = []
    runner.post(done.append, 1)
    runner.post(lambda: 1 / 0)
    runner.post(done.append, 2)
    assert done == [1, 2]
    assert [type(error) for error in errors] == [ZeroDivisionError]


def test_what_is_posted_together_is_done_in_order_and_an_error_stops_nothing():
    runner, _, errors = make()
    done = []

    def work(number, divisor):
        done.append(number // divisor)

    runner.post_each(work, [(1, 1), (2, 0), (6, 2)])
    assert done == [1, 3]
    assert [type(error) for error in errors] == [ZeroDivisionError]
    assert runner.thread is None


def test_what_is_posted_or_called_meanwhile_comes_between_what_is_posted_together():
    runner, _, _ = make()
    done = []

    def ask():
        runner.call(lambda: done.append("called"))

    caller = threading.Thread(target=ask)

    def work(number, then):
        done.append(number)
        if then == "post":
            runner.post(done.append, "posted")
        elif then == "call":
            caller.start()
            deadline = time.monotonic() + 10
            while not runner.callers and time.monotonic() < deadline:  # until it waits
                pass
        elif then == "each":
            runner.post_each(lambda *pair: done.append(pair), [(7, 8), (9, 10)])

    runner.post_each(work, [(1, "post"), (2, "call"), (3, "each"), (4, "")])
    caller.join(10)
    assert done == [1, "posted", 2, "called", 3, (7, 8), (9, 10), 4]


@pytest.fixture
def busy():
    """A function that has another thread at work in a runner until the function is called that it returns."""
    at_work, go_on = threading.Event(), threading.Event()

    def first():
        at_work.set()
        assert go_on.wait(10)

    def begin(runner):
        worker = threading.Thread(target=runner.post, args=(first,))
        worker.start()
        assert at_work.wait(10)

        def end():
            go_on.set()
            worker.join(10)

        return end

    return begin


def test_what_is_posted_together_while_another_is_at_work_waits_for_it(busy):
    runner, _, _ = make()
    done = []
    end = busy(runner)
    runner.post_each(lambda *pair: done.append(pair), zip("abc", "123"))
    assert (len(runner), done) == (3, [])
    end()
    assert done == [("a", "1"), ("b", "2"), ("c", "3")]


def test_what_is_posted_together_is_done_in_turn_again_as_soon_as_nobody_is_at_work(busy):
    runner, _, _ = make()
    done, seen = [], []
    end = busy(runner)

    def entries():
        for number in range(5):
            if number == 2:
                end()
            seen.append((len(runner), len(done)))
            yield number, None

    runner.post_each(lambda number, none: done.append(number), entries())
    assert seen == [(0, 0), (1, 0), (0, 2), (0, 3), (0, 4)]
    assert done == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("way", ["free", "busy", "inside"])
def test_each_of_what_is_posted_together_is_an_entry_of_its_own(way, busy):
    runner, _, _ = make()
    entries = []
    same = [("a", None)] * 3

    def post():
        runner.post_each(lambda *pair: entries.append(runner.entry), same)

    if way == "inside":
        runner.post(post)
    else:
        end = busy(runner) if way == "busy" else lambda: None
        post()
        end()
    assert len({id(entry) for entry in entries}) == 3
    assert entries == same


def test_nothing_is_at_work_while_what_is_posted_next_is_made():
    runner, _, _ = make()
    seen = []

    def entries():
        for number in range(3):
            seen.append(runner.entry)
            yield number, None

    runner.post_each(lambda *pair: seen.append(runner.entry), entries())
    assert seen == [None, (0, None), None, (1, None), None, (2, None)]


def test_an_error_of_what_makes_that_which_is_posted_together_reaches_who_posts():
    runner, _, errors = make()
    done = []

    def entries():
        yield "a", 1
        runner.post(done.append, "meanwhile")
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone"):
        runner.post_each(lambda *pair: done.append(pair), entries())
    assert (done, errors, runner.thread) == ([("a", 1), "meanwhile"], [], None)
    assert runner.call(lambda: 2) == 2


def test_an_error_of_what_makes_that_which_is_posted_together_leaves_nothing_in_the_queue(busy):
    runner, _, _ = make()
    done = []
    end = busy(runner)

    def entries():
        yield "a", 1
        end()
        yield "b", 2
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone"):
        runner.post_each(lambda *pair: done.append(pair), entries())
    assert (len(runner), done) == (0, [("a", 1), ("b", 2)])


def test_many_threads_that_post_together_lose_nothing():
    runner, drops, _ = make(size=50)
    done = []

    def post(thread):
        for begin in range(0, 2000, 20):
            runner.post_each(lambda *pair: done.append(pair), ((thread, begin + at) for at in range(20)))

    in_threads(post)
    assert drops == []
    for thread in range(4):
        assert [number for one, number in done if one == thread] == list(range(2000))


def test_a_call_returns_its_result_or_raises():
    runner, _, errors = make()
    assert runner.call(lambda: 7) == 7
    with pytest.raises(KeyError):
        runner.call(lambda: {}["x"])
    assert errors == []


def test_a_call_from_inside_is_done_at_once():
    runner, _, _ = make()
    assert runner.call(lambda: runner.call(lambda: 3)) == 3


def test_while_one_works_others_return_and_the_oldest_is_dropped(monkeypatch):
    monkeypatch.setattr("retalis.engine.runtime.serial_executor.FULL_QUEUE_WAIT_SECONDS", 0.01)
    runner, drops, _ = make(size=2)
    started, go_on = threading.Event(), threading.Event()
    done = []

    def slow():
        started.set()
        go_on.wait(10)

    worker = threading.Thread(target=runner.post, args=(slow,))
    worker.start()
    assert started.wait(10)
    for number in range(4):
        runner.post(done.append, number)
    assert done == []
    assert drops == [1, 2]
    go_on.set()
    worker.join(10)
    assert done == [2, 3]
    assert runner.dropped == 2


def test_nothing_is_dropped_while_a_full_queue_is_worked_off_however_long_that_takes(monkeypatch):
    started, posting, began, end = (threading.Event() for _ in range(4))
    done = []

    class Lock:
        """A lock for which the one who posts waits in vain, while one piece of work is done and the next begins."""

        def __init__(self):
            self._lock = threading.Lock()
            self.release = self._lock.release

        def acquire(self, blocking=True, timeout=-1):
            if timeout == -1:
                return self._lock.acquire(blocking)
            posting.set()
            assert began.wait(10)
            return False

    def first():
        started.set()
        assert posting.wait(10)

    def second():
        began.set()
        assert end.wait(10)

    with monkeypatch.context() as patched:
        patched.setattr(threading, "RLock", Lock)
        runner, drops, _ = make(size=2)
    worker = threading.Thread(target=runner.post, args=(first,))
    worker.start()
    assert started.wait(10)
    runner.post(second)
    runner.post(done.append, 1)
    runner.post(done.append, 2)
    end.set()
    worker.join(10)
    assert drops == []
    assert done == [1, 2]


def test_a_full_queue_holds_up_those_who_post_and_nothing_is_lost():
    runner, drops, _ = make(size=10)
    done = []

    def post(thread):
        for number in range(2000):
            runner.post(done.append, (thread, number))

    in_threads(post)
    assert drops == []
    for thread in range(4):
        assert [number for one, number in done if one == thread] == list(range(2000))


def test_one_at_work_who_posts_too_much_does_not_wait_for_itself():
    runner, drops, _ = make(size=3)
    done = []

    def work():
        for number in range(5):
            runner.post(done.append, number)

    runner.post(work)
    assert drops == [1, 2]
    assert done == [2, 3, 4]


def test_a_call_goes_before_what_waits():
    runner, _, _ = make()
    done = []
    caller = threading.Thread(target=runner.call, args=(lambda: done.append("called"),))

    def first():
        runner.post(done.append, "posted")
        caller.start()
        while not runner.callers:  # until it waits
            pass

    runner.post(first)
    caller.join(10)
    assert done == ["called", "posted"]


def test_many_threads_lose_nothing():
    runner, _, _ = make(size=100_000)
    total = [0]

    def add():
        total[0] += 1

    def post(thread):
        for _ in range(2000):
            runner.post(add)

    in_threads(post)
    runner.call(lambda: None)
    assert total[0] == 8000


def test_an_interrupt_is_no_result():
    runner, _, errors = make()

    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        runner.call(interrupted)
    assert runner.call(lambda: 1) == 1
    assert errors == []


def test_an_interrupt_gives_the_lock_back_and_who_waits_gets_its_answer():
    runner, _, _ = make()
    at_work, go_on = threading.Event(), threading.Event()
    answers = []

    def interrupted():
        at_work.set()
        assert go_on.wait(10)
        raise KeyboardInterrupt

    def first():
        with pytest.raises(KeyboardInterrupt):
            runner.call(interrupted)

    def second():
        answers.append(runner.call(lambda: 2))

    threads = [threading.Thread(target=first), threading.Thread(target=second)]
    threads[0].start()
    assert at_work.wait(10)
    threads[1].start()
    while not runner.callers:  # until it waits
        pass
    go_on.set()
    for thread in threads:
        thread.join(10)
    assert answers == [2]


def test_a_mark_that_an_interrupt_has_left_is_no_work_from_inside():
    class Noting(Recovery):
        def restore(self, state, mend_all):
            found.append((state, mend_all))
            if len(found) == 1:
                raise KeyboardInterrupt

    def interrupted():
        raise KeyboardInterrupt

    found = []
    runner = SerialExecutor(10, found.append, found.append, Noting())
    with pytest.raises(KeyboardInterrupt):
        runner.call(interrupted)
    assert runner.thread == threading.get_ident()  # going back after the interrupt was interrupted as well
    assert found == [(None, True)]
    found.clear()
    found.append("the mark")
    done = []
    runner.post(done.append, 1)
    assert runner.call(lambda: 2) == 2
    assert done == [1]
    assert found == ["the mark", (None, True)]
    thread = threading.Thread(target=runner.post, args=(done.append, 3))
    thread.start()
    thread.join(10)
    assert done == [1, 3]


def test_what_is_called_in_vain_is_not_done_later():
    runner, _, _ = make(patience=0)
    done = []

    def ask():
        with pytest.raises(UsageError, match="the engine has been in a callback for 0 s"):
            runner.call(lambda: done.append("asked"))

    def wait():
        thread = threading.Thread(target=ask)
        thread.start()
        thread.join(10)
        done.append("waited")

    def work():
        runner.callback = ("a callback",)
        wait()
        runner.callback = None

    runner.call(work)
    assert done == ["waited"]
