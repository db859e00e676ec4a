"""Server of the page: files, access, limits, and streams."""

import os
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack
from typing import Any, Iterator

import pytest
from subprocess_python_path import python_path

pytest.importorskip("tornado", reason="tornado is not installed")

from dashboard_client import TIMEOUT_SECONDS, Visitor, engine, serving  # noqa: E402

from retalis import UsageError  # noqa: E402
from retalis.dashboard import request_handlers  # noqa: E402
from retalis.dashboard.page_server import Dashboard  # noqa: E402
from retalis.dashboard.request_handlers import FILES, MAX_CONNECTIONS, PAGE  # noqa: E402
from retalis.dashboard.view_model import MAX_OPEN_PAGES, DashboardSource, TopicRow  # noqa: E402


@pytest.fixture
def program() -> Any:
    return engine()


@pytest.fixture
def page(program: Any) -> Iterator[Any]:
    with serving(program) as dashboard:
        yield dashboard


@pytest.fixture
def visitor(page: Any) -> Visitor:
    return Visitor(page)


def test_only_files_of_page_are_served(visitor: Visitor) -> None:
    assert {path.name for path in PAGE.iterdir()} == {name for name, _ in FILES.values()}
    for path, (name, content_type) in FILES.items():
        status, headers, body = visitor.ask(path)
        assert (status, headers["Content-Type"], body) == (200, content_type, (PAGE / name).read_bytes())
    for path in ("/index.html", "/page/", "/../server.py", "/%2e%2e/server.py", "/dashboardxjs", "//"):
        assert visitor.ask(path)[0] == 404, path


def test_page_has_no_foreign_or_inline_code() -> None:
    assert len(list(PAGE.iterdir())) == len(FILES)
    for path in PAGE.iterdir():
        text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert "//" not in text.replace("// ", "") or path.suffix == ".js", path
        assert "http:" not in text, path
        assert "https:" not in text, path
        for word in (
            "innerHTML",
            "outerHTML",
            "insertAdjacent",
            "document.write",
            "eval(",
            "onclick",
            "style=",
        ):
            assert word not in text, (path, word)


def test_each_response_has_security_headers(visitor: Visitor) -> None:
    for path in ("/", "/nothing"):
        _, headers, _ = visitor.ask(path)
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert "unsafe" not in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["X-Frame-Options"] == "DENY"
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert headers["Cache-Control"] == "no-store"
        assert "Access-Control-Allow-Origin" not in headers


@pytest.mark.parametrize("path", ["/", "/dashboard.js", "/stream", "/nothing"])
@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "[::1", "", "[::1]"]
)
def test_foreign_host_name_is_refused(visitor: Visitor, path: str, host: str) -> None:
    assert visitor.ask(path, Host=host)[0] in (400, 403)


def test_request_of_foreign_page_is_refused(page: Any, visitor: Visitor) -> None:
    own = f"127.0.0.1:{page.port}"
    for origin in ("http://evil.example", "null", f"https://{own}", "http://127.0.0.1:1", "http://localhost"):
        assert visitor.ask("/stream", Host=own, Origin=origin)[0] == 403, origin
        response = visitor.ask(
            "/explain", "POST", "{}", Host=own, Origin=origin, Content_Type="application/json"
        )
        assert response[0] == 403
    assert visitor.ask("/stream", Sec_Fetch_Site="cross-site")[0] == 403
    assert visitor.ask("/dashboard.js", Sec_Fetch_Site="same-site")[0] == 403
    assert visitor.ask("/", Sec_Fetch_Site="cross-site")[0] == 200  # a link to the page
    assert visitor.ask("/", Host=own, Origin=f"http://{own}")[0] == 200
    assert visitor.ask("/", Host="localhost:9000")[0] == 200  # as through a tunnel


def test_only_json_of_limited_size_is_accepted(visitor: Visitor) -> None:
    assert visitor.ask("/query", "POST", "{}")[0] == 415
    assert visitor.ask("/query", "POST", "{}", Content_Type="text/plain")[0] == 415
    for body in ("", "[]", "1", "{", "[" * 9000):
        assert visitor.ask("/query", "POST", body, Content_Type="application/json")[0] == 400
    try:
        assert visitor.ask("/query", "POST", "1" * 50_000, Content_Type="application/json")[0] in (400, 413)
    except OSError:
        pass  # the server has closed the connection
    assert visitor.ask("/stream", "POST", "{}")[0] == 405
    assert visitor.ask("/query")[0] == 405
    assert visitor.ask("/", "DELETE")[0] == 405


def test_unknown_method_is_refused(visitor: Visitor, caplog: pytest.LogCaptureFixture) -> None:
    status, _, body = visitor.ask("/", "FOO")
    assert (status, body) == (405, b"405: Method Not Allowed\n")
    assert caplog.text == ""


def test_server_is_on_loopback_address_only(page: Any) -> None:
    # A server on all addresses would accept this connection.
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", page.port), timeout=5)


def test_stream_has_events_and_counters(program: Any, visitor: Visitor) -> None:
    with visitor.stream() as stream:
        snapshot = stream.next()
        assert (snapshot["title"], snapshot["queries"], snapshot["watching"]) == ("/retalis", False, True)
        program.event("smoke(hall)", 1)
        program.event("heat(hall)", 2)
        snapshot = stream.until(
            lambda snapshot: snapshot["status"]["taken"] == 2 and len(snapshot["events"]) == 3
        )
        assert [event["text"] for event in snapshot["events"]] == ["alarm(hall)", "heat(hall)", "smoke(hall)"]
        assert snapshot["events"][0]["start"] == 1.0
        assert snapshot["status"]["memories"][0]["newest"] == 1.0
        assert snapshot["status"]["subscriptions"][0]["sent"] == 1
        stream.until(lambda snapshot: snapshot["rates"]["taken"] > 0)


def test_changed_graph_is_sent_again(program: Any, visitor: Visitor) -> None:
    with visitor.stream() as stream:
        graph = stream.next("graph")
        assert {"rule:0", "memory:fires", "event:smoke/1", "output:alarms"} <= {
            node["id"] for node in graph["nodes"]
        }
        program.load(rules="late <- alarm(_).")
        graph = stream.next("graph")
        assert "event:late/0" in {node["id"] for node in graph["nodes"]}


def listener_count(program: Any) -> Any:
    """Return the number of listeners for all events, without that for origins."""
    listener_count = program.dispatcher._listeners.get(None, ())  # noqa: SLF001
    return sum(listener.accepts_unread for listener in listener_count)


def wait_until(condition: Any) -> None:
    """Wait for another thread until a condition holds."""
    event = threading.Event()
    for _ in range(int(TIMEOUT_SECONDS / 0.02)):
        if condition():
            return
        event.wait(0.02)
    raise AssertionError("waited in vain")


def test_engine_has_listener_while_page_shows_events(program: Any, visitor: Visitor) -> None:
    assert listener_count(program) == 0
    with visitor.stream("/stream?events=0") as quiet:
        assert not quiet.next()["watching"]
        assert listener_count(program) == 0
        with visitor.stream() as stream:
            stream.next()
            assert listener_count(program) == 1
        wait_until(lambda: listener_count(program) == 0)
        quiet.until(lambda snapshot: not snapshot["watching"])


def test_number_of_open_pages_is_limited(visitor: Visitor) -> None:
    with ExitStack() as stack:
        for _ in range(MAX_OPEN_PAGES):
            assert stack.enter_context(visitor.stream()).status == 200
        with visitor.stream() as excess_stream:
            assert excess_stream.status == 503

    def can_open_page() -> bool:
        with visitor.stream() as stream:
            return stream.status == 200

    wait_until(can_open_page)


@pytest.mark.slow
def test_idle_connections_are_closed_before_pages(page: Any, visitor: Visitor) -> None:
    with visitor.stream() as stream:
        links = [
            socket.create_connection(("127.0.0.1", page.port), timeout=TIMEOUT_SECONDS)
            for _ in range(MAX_CONNECTIONS)
        ]
        try:
            assert visitor.ask("/")[0] == 200
            assert links[0].recv(1) == b""
            assert stream.next()
        finally:
            for link in links:
                link.close()
    assert visitor.ask("/")[0] == 200


@pytest.mark.slow
def test_slow_reader_does_not_block_others(program: Any, visitor: Visitor) -> None:
    program.load(rules="".join(f"a{number} <- b{number}(_). " for number in range(100)))
    with visitor.stream() as slow, visitor.stream() as stream:
        assert slow.status == 200
        for _ in range(30):
            stream.next()


def test_event_is_explained(program: Any, visitor: Visitor) -> None:
    with visitor.stream() as stream:
        stream.next()
        program.event("smoke(hall)", 1)
        program.event("heat(hall)", 2)
        snapshot = stream.until(lambda snapshot: len(snapshot["events"]) == 3)
        snapshot = visitor.post("/explain", {"serial": snapshot["events"][0]["serial"]})
        assert snapshot["lines"][0].startswith("alarm(hall) [")
        assert "smoke(hall)" in snapshot["lines"][1]
        for serial in (10_000, -1, "1", None, True, [1]):
            assert "error" in visitor.post("/explain", {"serial": serial}), serial


def test_queries_are_answered_if_allowed(program: Any, visitor: Visitor) -> None:
    program.call("assertz(room(hall))")
    assert "dashboard_queries" in visitor.post("/query", {"goal": "room(X)"})["error"]
    with serving(program, allows_queries=True) as allowed:
        allowed_visitor = Visitor(allowed)
        assert allowed_visitor.post("/query", {"goal": "room(X)"}) == {
            "solutions": [[["X", "hall"]]],
            "complete": True,
        }
        assert len(allowed_visitor.post("/query", {"goal": "repeat"})["solutions"]) == 100
        for goal in ("room(", "throw(x)", "nobody_has_defined_this", 7, None, "a" * 6000):
            assert "error" in allowed_visitor.post("/query", {"goal": goal}), goal


def test_busy_engine_does_not_block_page(program: Any) -> None:
    released = threading.Event()
    started = threading.Event()

    def work() -> None:
        started.set()
        released.wait(TIMEOUT_SECONDS)

    with serving(program, allows_queries=True) as page:
        visitor = Visitor(page)
        worker = threading.Thread(target=program.do, args=(work,), daemon=True)
        query_threads = [
            threading.Thread(target=visitor.post, args=("/query", {"goal": "true"}), daemon=True)
            for _ in range(2)
        ]
        try:
            worker.start()
            assert started.wait(TIMEOUT_SECONDS)
            with visitor.stream() as stream:
                stream.next()
                for thread in query_threads:
                    thread.start()
                wait_until(lambda: program.status().callers == 2)
                assert "busy" in visitor.post("/query", {"goal": "true"})["error"]
                stream.next()
        finally:
            released.set()
        for thread in (worker, *query_threads):
            thread.join(TIMEOUT_SECONDS)
            assert not thread.is_alive()


def test_topics_have_counts_of_source_or_engine(program: Any) -> None:
    topics = [
        TopicRow("/smoke", "house/Smoke", 7, 1, 0, 0.5, 0.01),
        TopicRow("/other", "house/Other"),
    ]
    with serving(program, topics=lambda: topics) as page, Visitor(page).stream() as stream:
        stream.next()
        program.event("house__0__Other(1)", 5)
        rows = stream.until(lambda snapshot: snapshot["topics"][1]["messages"] == 1)["topics"]
        assert rows[0] == topics[0]._asdict()
        assert rows[1]["age"] == 0


def test_used_port_is_an_error(page: Any) -> None:
    with pytest.raises(UsageError, match=f"^the dashboard cannot bind port {page.port} of 127.0.0.1: "):
        Dashboard(DashboardSource(engine(), "x"), page.port)


def test_error_of_start_releases_port(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

    def fail(*arguments: Any) -> None:
        raise OSError("no such page")

    with monkeypatch.context() as patches:
        patches.setattr(request_handlers, "create_server", fail)
        with pytest.raises(OSError, match="no such page"):
            Dashboard(DashboardSource(engine(), "x"), port)
    assert "dashboard" not in [thread.name for thread in threading.enumerate()]
    with serving(port=port) as page:
        assert page.port == port


def test_next_ports_are_tried_on_request(page: Any) -> None:
    other = Dashboard(DashboardSource(engine(), "x"), page.port, port_count=20)
    try:
        assert page.port < other.port < page.port + 20
    finally:
        other.close()


def test_ports_end_at_65535() -> None:
    with pytest.raises(UsageError, match="port 70000 of 127.0.0.1"):
        Dashboard(DashboardSource(engine(), "x"), 70_000, port_count=20)


def test_missing_tornado_is_an_error() -> None:
    # In a new process, because the modules of this one have been imported with tornado.
    code = """import sys
sys.modules["tornado"] = None
from retalis import Engine
from retalis.dashboard.page_server import Dashboard
from retalis.dashboard.view_model import DashboardSource
Dashboard(DashboardSource(Engine(), "x"), 0)
"""
    environment = {**os.environ, "PYTHONPATH": python_path()}
    process = subprocess.run([sys.executable, "-c", code], env=environment, stderr=subprocess.PIPE, text=True)
    assert process.stderr.splitlines()[-1].startswith("retalis.foundation.errors.UsageError: ")
    assert "python3-tornado" in process.stderr


def test_close_ends_streams_and_listeners(program: Any) -> None:
    with serving(program) as page, Visitor(page).stream() as stream:
        stream.next()
        page.close()
        page.close()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", page.port), timeout=5)
    wait_until(lambda: listener_count(program) == 0)
