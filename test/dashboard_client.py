"""Served page of the dashboard and a client that sends requests as a browser does, without a proxy."""

import http.client
import json
import socket
import time
from contextlib import contextmanager
from typing import Any, Iterator, Tuple

from retalis import Engine, record_origins
from retalis.dashboard.page_server import Dashboard
from retalis.dashboard.view_model import DashboardSource

TIMEOUT_SECONDS = 30.0
RULES = "alarm(X) <- smoke(X) seq heat(X). synchronized(seen(X), true, [[fires, 100]]) <- marker(X)."
GOALS = "memorize(smoke(_), [], _, fires, 10)\nsubscribe(alarm(_), [], _, alarms, a)"


def engine() -> Engine:
    """Return an engine with a small program."""
    program = Engine()
    record_origins(program)
    program.load(rules=RULES, goals=GOALS)
    return program


@contextmanager
def serving(program: Any = None, port: int = 0, **source: Any) -> Iterator[Dashboard]:
    """Serve a page on a port, by default on a free one."""
    page = Dashboard(DashboardSource(program or engine(), "/retalis", **source), port, period=0.05)
    try:
        yield page
    finally:
        page.close()


class Visitor:
    """Client of a page."""

    def __init__(self, page: Any) -> None:
        self.port = page.port

    def ask(self, path: Any, method: str = "GET", body: Any = None, **headers: Any) -> Tuple[Any, ...]:
        """Return the status, the headers and the body of a response."""
        link = http.client.HTTPConnection("127.0.0.1", self.port, timeout=TIMEOUT_SECONDS)
        try:
            names = {name.replace("_", "-"): value for name, value in headers.items()}
            link.request(method, path, body, names)
            response = link.getresponse()
            return response.status, response.headers, response.read()
        finally:
            link.close()

    def post(self, path: Any, request: Any, **headers: Any) -> Any:
        """Return the response to a request in JSON."""
        status, _, body = self.ask(
            path, "POST", json.dumps(request), Content_Type="application/json", **headers
        )
        assert status == 200, body
        return json.loads(body)

    @contextmanager
    def stream(self, path: str = "/stream") -> Iterator[Any]:
        """Open the stream of events."""
        link = socket.create_connection(("127.0.0.1", self.port), timeout=TIMEOUT_SECONDS)
        file = link.makefile("rb")
        try:
            link.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost:{self.port}\r\n\r\n".encode())
            status = int(file.readline().split()[1])
            while file.readline().strip():
                pass
            yield Stream(status, file)
        finally:
            file.close()
            link.close()


class Stream:
    """A stream of server-sent events."""

    def __init__(self, status: Any, file: Any) -> None:
        self.status = status
        self._file = file

    def next(self, name: str = "snapshot") -> Any:
        """Return the data of the next event of a name."""
        while True:
            line = self._file.readline()
            assert line, "the stream has ended"
            if line.strip() == f"event: {name}".encode():
                data = self._file.readline()
                return json.loads(data[len("data: ") :])

    def until(self, condition: Any) -> Any:
        """Return the first snapshot for which a condition holds."""
        end = time.monotonic() + TIMEOUT_SECONDS
        while time.monotonic() < end:
            snapshot = self.next()
            if condition(snapshot):
                return snapshot
        raise AssertionError(snapshot)
