"""A page that is served for a test, and who asks for it as a browser does, without a proxy."""

import http.client
import json
import socket
import time
from contextlib import contextmanager

from retalis import Engine, record_origins
from retalis.dashboard.page_server import Dashboard
from retalis.dashboard.view_model import DashboardSource

PATIENCE = 30.0
RULES = "alarm(X) <- smoke(X) seq heat(X). synchronized(seen(X), true, [[fires, 100]]) <- marker(X)."
GOALS = "memorize(smoke(_), [], _, fires, 10)\nsubscribe(alarm(_), [], _, alarms, a)"


def engine():
    """Return an engine with a small program that has taken a few events."""
    made = Engine()
    record_origins(made)
    made.load(rules=RULES, goals=GOALS)
    return made


@contextmanager
def serving(of=None, port=0, **known):
    """Serve a page on a port, by default on a free one."""
    page = Dashboard(DashboardSource(of or engine(), "/retalis", **known), port, period=0.05)
    try:
        yield page
    finally:
        page.close()


class Visitor:
    """Asks a page for things."""

    def __init__(self, page):
        self.port = page.port

    def ask(self, path, method="GET", body=None, **headers):
        """Return the status, the headers and the body of an answer."""
        link = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        try:
            names = {name.replace("_", "-"): value for name, value in headers.items()}
            link.request(method, path, body, names)
            answer = link.getresponse()
            return answer.status, answer.headers, answer.read()
        finally:
            link.close()

    def post(self, path, asked, **headers):
        """Return the answer to a request in JSON."""
        status, _, body = self.ask(
            path, "POST", json.dumps(asked), Content_Type="application/json", **headers
        )
        assert status == 200, body
        return json.loads(body)

    @contextmanager
    def stream(self, path="/stream"):
        """Give what reads the next event of the stream, as its name and data."""
        link = socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE)
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
    """A stream of events, chunk by chunk."""

    def __init__(self, status, file):
        self.status = status
        self._file = file

    def next(self, name="snapshot"):
        """Return the data of the next event of a name."""
        while True:
            line = self._file.readline()
            assert line, "the stream has ended"
            if line.strip() == f"event: {name}".encode():
                data = self._file.readline()
                return json.loads(data[len("data: ") :])

    def until(self, condition):
        """Return the first look of which something is true."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            found = self.next()
            if condition(found):
                return found
        raise AssertionError(found)
