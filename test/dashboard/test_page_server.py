"""The page's server: what it serves, to whom, and how much of it."""

import os
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack

import pytest
from python_path import python_path

pytest.importorskip("tornado", reason="tornado is not installed")

from dashboard_client import PATIENCE, Visitor, engine, serving  # noqa: E402

from retalis import UsageError  # noqa: E402
from retalis.dashboard.page_server import Dashboard  # noqa: E402
from retalis.dashboard.request_handlers import FILES, MAX_CONNECTIONS, PAGE  # noqa: E402
from retalis.dashboard.view_model import MAX_OPEN_PAGES, DashboardSource, TopicRow  # noqa: E402


@pytest.fixture
def program():
    return engine()


@pytest.fixture
def page(program):
    with serving(program) as served:
        yield served


@pytest.fixture
def visitor(page):
    return Visitor(page)


def test_all_files_of_the_page_are_served_and_nothing_else(visitor):
    assert {path.name for path in PAGE.iterdir()} == {name for name, _ in FILES.values()}
    for path, (name, kind) in FILES.items():
        status, headers, body = visitor.ask(path)
        assert (status, headers["Content-Type"], body) == (200, kind, (PAGE / name).read_bytes())
    for path in ("/index.html", "/page/", "/../server.py", "/%2e%2e/server.py", "/dashboardxjs", "//"):
        assert visitor.ask(path)[0] == 404, path


def test_nothing_comes_from_elsewhere_and_no_script_stands_in_the_page():
    for path in PAGE.iterdir():
        text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert "//" not in text.replace("// ", "") or path.suffix == ".js", path
        assert "http:" not in text and "https:" not in text, path
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


def test_each_answer_says_what_the_browser_may_do(visitor):
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
def test_a_name_that_was_made_to_lead_here_is_refused(visitor, path, host):
    assert visitor.ask(path, Host=host)[0] in (400, 403)


def test_a_foreign_page_is_refused(page, visitor):
    own = f"127.0.0.1:{page.port}"
    for origin in ("http://evil.example", "null", f"https://{own}", "http://127.0.0.1:1", "http://localhost"):
        assert visitor.ask("/stream", Host=own, Origin=origin)[0] == 403, origin
        asked = visitor.ask(
            "/explain", "POST", "{}", Host=own, Origin=origin, Content_Type="application/json"
        )
        assert asked[0] == 403
    assert visitor.ask("/stream", Sec_Fetch_Site="cross-site")[0] == 403
    assert visitor.ask("/dashboard.js", Sec_Fetch_Site="same-site")[0] == 403
    assert visitor.ask("/", Sec_Fetch_Site="cross-site")[0] == 200  # a link to the page
    assert visitor.ask("/", Host=own, Origin=f"http://{own}")[0] == 200
    assert visitor.ask("/", Host="localhost:9000")[0] == 200  # the far end of a tunnel


def test_only_json_of_some_size_is_taken(visitor):
    assert visitor.ask("/query", "POST", "{}")[0] == 415
    assert visitor.ask("/query", "POST", "{}", Content_Type="text/plain")[0] == 415
    for wrong in ("", "[]", "1", "{", "[" * 9000):
        assert visitor.ask("/query", "POST", wrong, Content_Type="application/json")[0] == 400
    try:
        assert visitor.ask("/query", "POST", "1" * 50_000, Content_Type="application/json")[0] in (400, 413)
    except OSError:
        pass  # it was cut off
    assert visitor.ask("/stream", "POST", "{}")[0] == 405
    assert visitor.ask("/query")[0] == 405
    assert visitor.ask("/", "DELETE")[0] == 405


def test_a_method_that_http_does_not_have_is_refused_without_a_traceback(visitor, caplog):
    status, _, body = visitor.ask("/", "FOO")
    assert (status, body) == (405, b"405: Method Not Allowed\n")
    assert caplog.text == ""


def test_it_is_on_the_loopback_address_only(page):
    with pytest.raises(OSError):  # what listens on all addresses of the machine answers on this one too
        socket.create_connection(("127.0.0.2", page.port), timeout=5)


def test_numbers_come_while_the_program_runs(program, visitor):
    with visitor.stream() as stream:
        look = stream.next()
        assert (look["title"], look["queries"], look["watching"]) == ("/retalis", False, True)
        program.event("smoke(hall)", 1)
        program.event("heat(hall)", 2)
        look = stream.until(lambda found: found["status"]["taken"] == 2 and len(found["events"]) == 3)
        assert [one["text"] for one in look["events"]] == ["alarm(hall)", "heat(hall)", "smoke(hall)"]
        assert look["events"][0]["start"] == 1.0
        assert look["status"]["memories"][0]["newest"] == 1.0
        assert look["status"]["subscriptions"][0]["sent"] == 1
        stream.until(lambda found: found["rates"]["taken"] > 0)


def test_the_graph_comes_once_and_again_when_the_program_has_changed(program, visitor):
    with visitor.stream() as stream:
        graph = stream.next("graph")
        assert {"rule:0", "memory:fires", "event:smoke/1", "output:alarms"} <= {
            one["id"] for one in graph["nodes"]
        }
        program.load(rules="late <- alarm(_).")
        graph = stream.next("graph")
        assert "event:late/0" in {one["id"] for one in graph["nodes"]}


def listeners(program):
    """Return how many take all events whole or in part, but for the record of what events come from."""
    return sum(one.accepts_unread for one in program.dispatcher._listeners.get(None, ()))  # noqa: SLF001


def until(condition):
    """Wait for what another thread does."""
    event = threading.Event()
    for _ in range(int(PATIENCE / 0.02)):
        if condition():
            return
        event.wait(0.02)
    raise AssertionError("waited in vain")


def test_the_engine_is_listened_to_only_while_a_page_shows_events(program, visitor):
    assert listeners(program) == 0
    with visitor.stream("/stream?events=0") as quiet:
        assert not quiet.next()["watching"]
        assert listeners(program) == 0
        with visitor.stream() as stream:
            stream.next()
            assert listeners(program) == 1
        until(lambda: listeners(program) == 0)
        quiet.until(lambda found: not found["watching"])


def test_so_many_pages_may_be_open(visitor):
    with ExitStack() as stack:
        for _ in range(MAX_OPEN_PAGES):
            assert stack.enter_context(visitor.stream()).status == 200
        with visitor.stream() as one_more:
            assert one_more.status == 503

    def again():
        with visitor.stream() as stream:
            return stream.status == 200

    until(again)


@pytest.mark.slow
def test_idle_connections_make_room_and_live_pages_stay(page, visitor):
    with visitor.stream() as stream:
        links = [
            socket.create_connection(("127.0.0.1", page.port), timeout=PATIENCE)
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
def test_one_who_does_not_read_gets_the_newest_and_holds_up_nobody(program, visitor):
    program.load(rules="".join(f"a{number} <- b{number}(_). " for number in range(100)))
    with visitor.stream() as slow, visitor.stream() as stream:
        assert slow.status == 200
        for _ in range(30):
            stream.next()


def test_why_an_event_happened(program, visitor):
    with visitor.stream() as stream:
        stream.next()
        program.event("smoke(hall)", 1)
        program.event("heat(hall)", 2)
        look = stream.until(lambda found: len(found["events"]) == 3)
        found = visitor.post("/explain", {"serial": look["events"][0]["serial"]})
        assert found["lines"][0].startswith("alarm(hall) [")
        assert "smoke(hall)" in found["lines"][1]
        for serial in (10_000, -1, "1", None, True, [1]):
            assert "error" in visitor.post("/explain", {"serial": serial}), serial


def test_queries_are_answered_only_where_they_are_allowed(program, visitor):
    program.call("assertz(room(hall))")
    assert "dashboard_queries" in visitor.post("/query", {"goal": "room(X)"})["error"]
    with serving(program, allows_queries=True) as allowed:
        ask = Visitor(allowed)
        assert ask.post("/query", {"goal": "room(X)"}) == {"solutions": [[["X", "hall"]]], "complete": True}
        assert len(ask.post("/query", {"goal": "repeat"})["solutions"]) == 100
        for goal in ("room(", "throw(x)", "nobody_has_defined_this", 7, None, "a" * 6000):
            assert "error" in ask.post("/query", {"goal": goal}), goal


def test_a_busy_engine_holds_up_no_page(program):
    free = threading.Event()
    begun = threading.Event()

    def work():
        begun.set()
        free.wait(PATIENCE)

    with serving(program, allows_queries=True) as page:
        visitor = Visitor(page)
        worker = threading.Thread(target=program.do, args=(work,), daemon=True)
        asking = [
            threading.Thread(target=visitor.post, args=("/query", {"goal": "true"}), daemon=True)
            for _ in range(2)
        ]
        try:
            worker.start()
            assert begun.wait(PATIENCE)
            with visitor.stream() as stream:
                stream.next()
                for one in asking:
                    one.start()
                until(lambda: program.status().callers == 2)
                assert "busy" in visitor.post("/query", {"goal": "true"})["error"]
                stream.next()
        finally:
            free.set()
        for one in (worker, *asking):
            one.join(PATIENCE)
            assert not one.is_alive()


def test_topics_have_what_is_known_of_them(program):
    topics = [
        TopicRow("/smoke", "house/Smoke", 7, 1, 0, 0.5, 0.01),
        TopicRow("/other", "house/Other"),
    ]
    with serving(program, topics=lambda: topics) as page, Visitor(page).stream() as stream:
        stream.next()
        program.event("house__0__Other(1)", 5)
        rows = stream.until(lambda found: found["topics"][1]["messages"] == 1)["topics"]
        assert rows[0] == topics[0]._asdict()
        assert rows[1]["age"] == 0


def test_a_port_that_is_taken_is_an_error_with_its_number(page):
    with pytest.raises(UsageError, match=f"port {page.port} of 127.0.0.1"):
        Dashboard(DashboardSource(engine(), "x"), page.port)


def test_next_ports_are_tried_on_request(page):
    other = Dashboard(DashboardSource(engine(), "x"), page.port, port_count=20)
    try:
        assert page.port < other.port < page.port + 20
    finally:
        other.close()


def test_ports_end_at_65535():
    with pytest.raises(UsageError, match="port 70000 of 127.0.0.1"):
        Dashboard(DashboardSource(engine(), "x"), 70_000, port_count=20)


def test_without_tornado_the_error_names_its_package():
    # In a new process, because the modules of this one have been imported with tornado.
    code = """import sys
sys.modules["tornado"] = None
from retalis import Engine
from retalis.dashboard.page_server import Dashboard
from retalis.dashboard.view_model import DashboardSource
Dashboard(DashboardSource(Engine(), "x"), 0)
"""
    environment = {**os.environ, "PYTHONPATH": python_path()}
    ran = subprocess.run([sys.executable, "-c", code], env=environment, stderr=subprocess.PIPE, text=True)
    assert ran.stderr.splitlines()[-1].startswith("retalis.foundation.errors.UsageError: ")
    assert "python3-tornado" in ran.stderr


def test_closing_ends_what_is_open(program):
    with serving(program) as page, Visitor(page).stream() as stream:
        stream.next()
        page.close()
        page.close()
        with pytest.raises(OSError):
            socket.create_connection(("127.0.0.1", page.port), timeout=5)
    until(lambda: listeners(program) == 0)
