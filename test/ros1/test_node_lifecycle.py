"""End of a node by one signal at any time, and its exit status."""

import os
import resource
import signal
import subprocess
import sys
import threading
from pathlib import Path
from socketserver import ThreadingMixIn
from typing import Any, Iterator
from xmlrpc.server import SimpleXMLRPCServer

import pytest
from asserting_accessors import required

NODES = ("retalis_node", "retalis_ros_converter.py")
SIGNALS = (signal.SIGINT, signal.SIGTERM)
XML = '<publish_subscribe><publish_to name="out" msg_type="std_msgs/String"/></publish_subscribe>'
TIMEOUT_SECONDS = 60
"""Time for the end of a node; only a busy machine needs most of it."""


@pytest.fixture
def program(tmp_path: Path) -> Any:
    """Return a function that writes a program of goals."""
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "pub_sub.xml").write_text(XML)

    def make(*goals: Any, rules: str = "") -> str:
        (folder / "goalPredicates.txt").write_text("".join(goal + "\n" for goal in goals))
        (folder / "rules.txt").write_text(rules)
        return f"_program:={folder}"

    return make


@pytest.fixture
def node(devel: Any) -> Any:
    """Return a function that starts a node."""
    return lambda name, *arguments: devel.start(devel.executable(name), *arguments)


@pytest.fixture
def master(devel: Any) -> Any:
    return devel.start_master()


def end_by_signal(process: Any, number: Any) -> Any:
    process.send_signal(number)
    return process.wait(TIMEOUT_SECONDS)


@pytest.mark.parametrize("name", NODES)
@pytest.mark.parametrize("number", SIGNALS)
def test_node_without_master_ends(devel: Any, node: Any, program: Any, name: str, number: Any) -> None:
    process = node(name, program())
    devel.expect_printed(f"no master answers at http://localhost:{devel.port}")
    assert end_by_signal(process, number) == 0
    assert "Traceback" not in devel.printed()


def test_node_waits_for_master(devel: Any, node: Any, program: Any) -> None:
    process = node("retalis_node", program())
    devel.expect_printed("no master answers")
    devel.start_master()
    devel.expect(lambda nodes, services: "/add_memory" in services)
    assert end_by_signal(process, signal.SIGINT) == 0


@pytest.mark.parametrize("number", SIGNALS)
def test_node_with_endless_goal_ends(devel: Any, master: Any, node: Any, program: Any, number: Any) -> None:
    process = node(
        "retalis_node", program("writeln('it has begun'), flush_output, repeat, fail", "writeln('the next')")
    )
    devel.expect_printed("it has begun")
    assert end_by_signal(process, number) == 0
    assert "the next" not in devel.printed()
    assert devel.state() == (set(), set())


@pytest.mark.parametrize("number", SIGNALS)
def test_signal_in_weak_reference_callback_ends_node(
    devel: Any, master: Any, node: Any, program: Any, tmp_path: Path, number: Any
) -> None:
    """Python ignores the exception of a signal handler that runs within such a callback."""
    module = f"""
import os
import weakref

from retalis import foreign

@foreign
def lose_interrupt() -> None:
    item = set()
    reference = weakref.ref(item, lambda reference: os.kill(os.getpid(), {int(number)}))
    del item
"""
    goals = ("use_foreign(losing)", "lose_interrupt, writeln(it-continues), flush_output, repeat, fail")
    folder = program(*goals)
    (tmp_path / "program" / "losing.py").write_text(module)
    process = node("retalis_node", folder, "_allow_foreign:=true", "_max_seconds:=0")
    devel.expect_printed("it-continues\n")
    assert process.wait(TIMEOUT_SECONDS) == 0
    assert devel.state() == (set(), set())


@pytest.mark.parametrize("name", NODES)
@pytest.mark.parametrize("number", SIGNALS)
def test_idle_node_ends(devel: Any, master: Any, node: Any, program: Any, name: str, number: Any) -> None:
    process = node(name, program())
    service = "/add_memory" if name == "retalis_node" else "/add_input_subscription"
    devel.expect(lambda nodes, services: service in services)
    assert end_by_signal(process, number) == 0
    assert devel.state() == (set(), set())
    assert "Traceback" not in devel.printed()


def test_node_with_endless_event_ends(devel: Any, master: Any, node: Any, program: Any) -> None:
    rules = "a <- begin do (writeln('it has begun'), flush_output, repeat, fail)."
    process = node("retalis_node", program("compile_event_file('rules.txt')", rules=rules), "_max_seconds:=0")
    devel.expect(lambda nodes, services: "/add_memory" in services)
    devel.post_events("begin")
    devel.expect_printed("it has begun")
    assert end_by_signal(process, signal.SIGINT) == 0
    assert devel.state() == (set(), set())


def test_recorded_events_do_not_delay_end(devel: Any, master: Any, node: Any, program: Any) -> None:
    """Processor time is measured, because elapsed time depends on the load of the machine."""
    rules = """
b(N) <- a(N).
c <- begin do (forall(between(1, 50000, N), event(a([[[N], [N]], [[N], [N]], [[N], [N]], [[N], [N]]]))),
               writeln('all came'), flush_output).
"""
    folder = program("compile_event_file('rules.txt')", rules=rules)
    process = node("retalis_node", folder, "_explain:=true", "_max_seconds:=0")
    devel.expect(lambda nodes, services: "/add_memory" in services)
    devel.post_events("begin")
    devel.expect_printed("all came")
    before_seconds = seconds_of_children()
    statistics = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    ticks = sum(map(int, statistics[11:15]))  # those of the process and of its children
    assert end_by_signal(process, signal.SIGINT) == 0
    spent = seconds_of_children() - before_seconds - ticks / os.sysconf("SC_CLK_TCK")
    assert spent < 1.0


def seconds_of_children() -> float:
    """Return the processor time of all ended child processes, in seconds."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_node_ends_while_master_is_blocked(devel: Any, master: Any, node: Any, program: Any) -> None:
    process = node("retalis_node", program())
    devel.expect(lambda nodes, services: "/add_memory" in services)
    master.send_signal(signal.SIGSTOP)
    try:
        assert end_by_signal(process, signal.SIGINT) == 0
    finally:
        master.send_signal(signal.SIGCONT)


class SilentMaster(ThreadingMixIn, SimpleXMLRPCServer):
    """A master that answers that it is there, and no other call.

    Attributes:
        has_call: set when another call has arrived.
        is_closing: ends the calls.
    """

    daemon_threads = True

    def __init__(self, port: int) -> None:
        super().__init__(("localhost", port), logRequests=False)
        self.has_call, self.is_closing = threading.Event(), threading.Event()

    def _dispatch(self, method: str, params: Any) -> Any:
        if method != "getPid":
            self.has_call.set()
            self.is_closing.wait()
        return 1, "", os.getpid()


@pytest.fixture
def silent_master(devel: Any) -> Iterator[SilentMaster]:
    with SilentMaster(devel.port) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.is_closing.set()
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("number", SIGNALS)
def test_signal_while_master_is_silent_ends_construction(
    silent_master: SilentMaster, node: Any, program: Any, devel: Any, number: Any
) -> None:
    process = node("retalis_node", program())
    assert silent_master.has_call.wait(TIMEOUT_SECONDS)
    assert end_by_signal(process, number) == 0
    assert "Traceback" not in devel.printed()


@pytest.mark.parametrize("name", NODES)
def test_missing_program_is_an_error(devel: Any, master: Any, node: Any, tmp_path: Path, name: str) -> None:
    process = node(name, f"_program:={tmp_path}/nowhere")
    assert process.wait(TIMEOUT_SECONDS) == 1
    assert f"{tmp_path}/nowhere does not exist: give the absolute path" in devel.printed()
    assert devel.state() == (set(), set())


@pytest.mark.parametrize(
    ("name", "numbers"), [*((name, SIGNALS) for name in NODES), ("retalis", [signal.SIGINT])]
)
def test_signal_while_importing_ends_node(name: Any, numbers: Any) -> None:
    script = Path(__file__).resolve().parents[2] / "nodes" / name
    code = f"""
import sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "retalis":
            print("importing", flush=True)
            sys.stdin.read()

sys.meta_path.insert(0, Finder())
exec(open({str(script)!r}).read())
"""
    command = [sys.executable, "-c", code]
    for number in numbers:
        with subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        ) as process:
            ready = threading.Thread(target=required(process.stdout).readline)
            ready.start()
            ready.join(TIMEOUT_SECONDS)
            process.send_signal(number)
            assert process.wait(TIMEOUT_SECONDS) == -number
            assert required(process.stderr).read() == b""
