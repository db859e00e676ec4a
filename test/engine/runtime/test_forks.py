"""Engines in a forked process: an idle one works, one that another thread was using refuses calls."""

import multiprocessing
import os
import signal
import threading
from typing import Any, Iterator, List, Tuple

import pytest

from retalis import Engine, Limits, Settings, UsageError

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # later Pythons warn of a fork beside threads
]

CHILD_TIMEOUT_SECONDS = 60
"""Time limit of a child process."""

REFUSED = (
    "the engine cannot be used in this process, which was forked while another thread was using it: make"
)


def in_child(work: Any) -> str:
    """Return the result of a function in a forked process, or the text of its error; "" after the time limit."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(CHILD_TIMEOUT_SECONDS)
        try:
            try:
                text = str(work())
            except UsageError as error:
                text = str(error)
            os.write(writing, text.encode())
        finally:
            os._exit(0)
    os.close(writing)
    with open(reading, encoding="utf-8") as pipe:
        text = pipe.read()
    os.waitpid(pid, 0)
    return text


@pytest.fixture
def engine() -> Engine:
    engine = Engine(settings=Settings(limits=Limits(seconds=30.0)))
    engine.load(rules="out(X) <- in(X).\ncount(0).\ncount(N) :- N > 0, M is N - 1, count(M).")
    return engine


def test_idle_engine_works_in_both_processes(engine: Engine) -> None:
    def use() -> Tuple[Any, ...]:
        events: List[Any] = []
        engine.on_event(lambda term, start, end: events.append(engine.show(term)))
        engine.event("in(1)", 1)
        return events, engine.call("assertz(mine)"), len(engine.status().rules)

    assert in_child(use) == "(['in(1)', 'out(1)'], True, 1)"
    assert engine.call("X = 1")
    assert use()[0] == ["in(1)", "out(1)"]
    threads = in_child(lambda: [thread.name for thread in threading.enumerate()])
    assert "retalis watchdog" in threads


@pytest.fixture
def busy(engine: Engine) -> Iterator[Any]:
    """An engine that another thread is using."""
    started, released = threading.Event(), threading.Event()

    def wait(*_: Any) -> None:
        started.set()
        released.wait(CHILD_TIMEOUT_SECONDS)

    engine.on_event(wait)
    worker = threading.Thread(target=lambda: engine.event("in(1)", 1))
    worker.start()
    assert started.wait(CHILD_TIMEOUT_SECONDS)
    yield engine
    released.set()
    worker.join()


@pytest.mark.parametrize(
    "use",
    [
        lambda engine: engine.query("X = 1"),
        lambda engine: engine.post("in(2)", 2),
        lambda engine: engine.event("in(2)", 2),
        lambda engine: engine.post_each([]),
        lambda engine: engine.load(rules="a <- b."),
    ],
)
def test_busy_engine_refuses_calls_in_child(busy: Any, use: Any) -> None:
    assert in_child(lambda: use(busy)).startswith(REFUSED)


def test_child_can_create_engine(busy: Any) -> None:
    assert in_child(lambda: Engine().call("true")) == "True"


def test_working_thread_may_fork(engine: Engine) -> None:
    results: List[Any] = []

    def fork(*_: Any) -> None:
        results.append(in_child(lambda: engine.query("X = 1")))

    engine.on_event(fork)
    engine.event("in(1)", 1)
    assert results == ["[{'X': 1}]"] * 2
    assert engine.call("true")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["fork", "multiprocessing"])
def test_fork_during_other_query_does_not_hang(engine: Engine, kind: str) -> None:
    ending = threading.Event()

    def ask() -> None:
        while not ending.is_set():
            engine.query("count(200)")

    def use() -> int:
        return len(engine.query("member(X, [1, 2])"))

    worker = threading.Thread(target=ask)
    worker.start()
    try:
        answers = [in_child(use) if kind == "fork" else in_process(use) for _ in range(30)]
    finally:
        ending.set()
        worker.join()
    assert all(answer == "2" or answer.startswith(REFUSED) for answer in answers)
    assert engine.call("true")


def in_process(work: Any) -> Any:
    """Return the result of a function in a process of multiprocessing, or the text of its error."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)

    def run() -> None:
        signal.alarm(CHILD_TIMEOUT_SECONDS)
        try:
            sender.send(str(work()))
        except UsageError as error:
            sender.send(str(error))

    process = context.Process(target=run)
    process.start()
    process.join()
    return receiver.recv() if receiver.poll() else ""
