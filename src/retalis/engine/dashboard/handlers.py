"""What the page's server answers. The only file that imports tornado."""

import json
from pathlib import Path
from typing import Any, Awaitable, Callable, Dict, List, Optional
from urllib.parse import urlsplit
from weakref import WeakSet

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream, StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler

from ...foundation import printable_json
from .answering import Answers
from .streaming import Streams

PAGE = Path(__file__).resolve().parent / "page"

FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/dashboard.css": ("dashboard.css", "text/css; charset=utf-8"),
    "/dashboard.js": ("dashboard.js", "text/javascript; charset=utf-8"),
    "/graph.js": ("graph.js", "text/javascript; charset=utf-8"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}
"""All files that are served; nothing else of the disk can be asked for."""

POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self'",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)

LOOPBACK = ("127.0.0.1", "localhost")
"""Names by which the page may be asked for. Its port is another one at the far end of a tunnel."""

LARGEST_REQUEST = 20_000
"""Bytes of a request's body."""

LARGEST_HEADER = 16_000
"""Bytes of its headers."""

MOST_CONNECTIONS = 40
"""Connections that may be open at once, whatever they are for; one more closes the oldest that has no request."""

BUSY = "busy connections"
"""The setting of the application with the connections whose requests are being answered, live pages among them."""

IDLE = 60.0
"""Seconds after which a connection on which nothing is asked is closed."""


class LocalHandler(RequestHandler):
    """Answers requests for the loopback address that come from nowhere or from the page itself.

    A page of somebody else that is open in the same browser can reach the port too: by its address, which the
    browser tells (``Origin``, ``Sec-Fetch-Site``), or by a name that was made to lead to it (``Host``).
    """

    _stream: Any = None  # a request with an unknown method is answered without `prepare`

    def prepare(self) -> None:
        """Refuse what a foreign page may have sent."""
        self._stream = getattr(self.request.connection, "stream", None)
        if self._stream is not None:
            self.settings[BUSY].add(self._stream)
        headers = self.request.headers
        host = headers.get("Host", "")
        if _name_of(host) not in LOOPBACK:
            raise HTTPError(403, reason="Not the loopback address")
        if headers.get("Origin", f"http://{host}") != f"http://{host}":
            raise HTTPError(403, reason="Another page")
        if headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin") and self.request.path != "/":
            raise HTTPError(403, reason="Another page")

    def on_finish(self) -> None:
        """Note that the connection waits for its next request."""
        if self._stream is not None:
            self.settings[BUSY].discard(self._stream)

    def set_default_headers(self) -> None:
        """Have the browser run, load and tell others nothing that is not the page's own."""
        for name, value in (
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("X-Frame-Options", "DENY"),
            ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("Cross-Origin-Opener-Policy", "same-origin"),
            ("Cache-Control", "no-store"),
            ("Server", "retalis"),
        ):
            self.set_header(name, value)

    def write_error(self, status_code: int, **known: object) -> None:
        """Say what is wrong in a line, and nothing of the inside."""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {self._reason}\n")

    def data_received(self, chunk: bytes) -> Optional[Awaitable[None]]:
        """Take no streamed bodies."""
        raise HTTPError(400)


class FileHandler(LocalHandler):
    """Serves the files of the page."""

    def get(self, path: str) -> None:
        """Answer with a file."""
        name, kind = FILES[path]
        self.set_header("Content-Type", kind)
        self.finish((PAGE / name).read_bytes())


class StreamHandler(LocalHandler):
    """Serves the live numbers as server-sent events."""

    def initialize(self, streams: Streams) -> None:
        """Take what gives the numbers."""
        self._streams = streams

    async def get(self) -> None:
        """Send what there is to see until nobody looks any more."""
        client = self._streams.enter(self.get_query_argument("events", "1") == "1")
        if client is None:
            raise HTTPError(503, reason="Too many pages are open")
        self._client = client
        self.set_header("Content-Type", "text/event-stream; charset=utf-8")
        try:
            data = await client.next()
            while data:
                self.write(data)
                await self.flush()
                data = await client.next()
        except StreamClosedError:
            pass
        finally:
            self._streams.leave(client)

    def on_connection_close(self) -> None:
        """Note that nobody looks any more."""
        client = getattr(self, "_client", None)
        if client is not None:
            self._streams.leave(client)
            client.end()


class AnswerHandler(LocalHandler):
    """Answers what the page asks: JSON in, JSON out."""

    def initialize(self, answer: Callable[[Dict[str, Any]], Any], answers: Answers) -> None:
        """Take who answers."""
        self._answer = answer
        self._answers = answers

    async def post(self) -> None:
        """Answer; only with JSON, which a browser lets no foreign page send unasked."""
        if self.request.headers.get("Content-Type", "").partition(";")[0] != "application/json":
            raise HTTPError(415, reason="Expected application/json")
        try:
            asked = json.loads(self.request.body)
        except (ValueError, RecursionError):
            asked = None
        if not isinstance(asked, dict):
            raise HTTPError(400, reason="Expected an object of JSON")
        found = await self._answers.run(lambda: self._answer(asked))
        self.finish(printable_json(found))


class NothingHandler(LocalHandler):
    """Answers all other requests."""

    def prepare(self) -> None:
        """Say that there is nothing."""
        super().prepare()
        raise HTTPError(404)


def _name_of(host: str) -> Optional[str]:
    """Return the name in a ``Host`` header, without the port."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


class BoundedServer(HTTPServer):
    """A server with so many connections at most."""

    def initialize(self, *arguments: Any, **known: Any) -> None:
        """Begin without connections."""
        super().initialize(*arguments, **known)
        self._streams: List[IOStream] = []

    def handle_stream(self, stream: IOStream, address: Any) -> None:
        """Take a connection; if there are too many, close the oldest one without a complete request."""
        self._streams = [one for one in self._streams if not one.closed()]
        self._streams.append(stream)
        if len(self._streams) > MOST_CONNECTIONS:
            application: Any = self.request_callback
            busy = application.settings[BUSY]
            oldest = next(one for one in self._streams if one not in busy)  # the new one has no request yet
            oldest.close()
            if oldest is stream:
                return
        super().handle_stream(stream, address)


def server(streams: Streams, answers: Answers) -> HTTPServer:
    """Return the server, which has no socket yet."""
    paths = "|".join(path.replace(".", "[.]") for path in FILES)
    routes: Any = [
        (f"({paths})", FileHandler),
        ("/stream", StreamHandler, {"streams": streams}),
        ("/explain", AnswerHandler, {"answer": answers.explain, "answers": answers}),
        ("/query", AnswerHandler, {"answer": answers.query, "answers": answers}),
    ]
    settings: Any = {BUSY: WeakSet()}
    application = Application(
        routes, default_handler_class=NothingHandler, log_function=lambda handler: None, **settings
    )
    return BoundedServer(
        application,
        idle_connection_timeout=IDLE,
        body_timeout=IDLE,
        max_header_size=LARGEST_HEADER,
        max_body_size=LARGEST_REQUEST,
        max_buffer_size=2 * LARGEST_REQUEST,
    )
