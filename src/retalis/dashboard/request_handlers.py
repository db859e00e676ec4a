"""What the page asks on demand: why an event happened, and goals where that is allowed.

What the page's server answers. The only file that imports tornado.
"""

import asyncio
import json
import threading
from pathlib import Path
from typing import Any, Awaitable, Callable, Dict, List, Optional
from urllib.parse import urlsplit
from weakref import WeakSet

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream, StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler

from ..engine.external_queries import ask
from ..explanation.explain import explain, records_origins
from ..foundation.errors import RetalisError, SyntaxFault, beginning, printable_json
from ..prolog.machine.resource_limits import Limits
from .view_model import DashboardSource, LiveUpdates, Snapshots

AT_ONCE = 2
"""Answers that are looked for at once: each may hold a thread until the engine has time."""

MAX_PAGE_SOLUTIONS = 100
"""Solutions of a query."""

MAX_PAGE_ANSWER_CHARACTERS = 100_000
"""Characters of its solutions together."""

MAX_GOAL_CHARACTERS = 5_000
"""Characters of its text."""

LIMITS = Limits(seconds=5.0, output_megabytes=None)
"""What a query may use; the engine's own limits hold besides."""

MAX_EXPLANATION_LINES = 500
"""Lines of an explanation."""

MAX_LINE_CHARACTERS = 1_000
"""Characters of one."""

MAX_ERROR_CHARACTERS = 1_000

NOT_RECORDED = "what events come from is not recorded: start the node with explain:=true"
NOT_ALLOWED = "queries are not allowed: start the node with dashboard_queries:=true"
GONE = "this event is no longer kept"
BUSY_ANSWER = "other answers are still awaited: the engine is busy"

Json = Dict[str, Any]


class Answers:
    """Answers what the page asks, each in a thread of its own: the engine may be busy.

    Args:
        source: is asked.
        snapshots: have the events that can be explained.
    """

    def __init__(self, source: DashboardSource, snapshots: Snapshots):
        self._engine = source.engine
        self._queries = source.queries
        self._events = snapshots.events
        self._free = threading.BoundedSemaphore(AT_ONCE)

    async def run(self, work: Callable[[], Json]) -> Json:
        """Return what some work returns, or why not as ``error``."""
        if not self._free.acquire(blocking=False):
            return {"error": BUSY_ANSWER}
        loop = asyncio.get_event_loop()
        done: asyncio.Future[Json] = loop.create_future()

        def deliver(found: Json) -> None:
            if not done.done():  # somebody has closed the page
                done.set_result(found)

        def run() -> None:
            found: Json = {"error": "internal error"}
            try:
                found = work()
            except SyntaxFault as fault:
                found = {"error": beginning(fault.brief(), MAX_ERROR_CHARACTERS)}
            except RetalisError as error:
                found = {"error": beginning(error.brief(), MAX_ERROR_CHARACTERS)}
            finally:
                self._free.release()
                if not loop.is_closed():
                    loop.call_soon_threadsafe(deliver, found)

        threading.Thread(target=run, daemon=True, name="dashboard answer").start()
        return await done

    def explain(self, asked: Json) -> Json:
        """Say why one of the last events happened; it is named by its number, so that no text is read."""
        if not records_origins(self._engine):
            return {"error": NOT_RECORDED}
        serial: Any = asked.get("serial")
        event = self._events.find(serial) if serial.__class__ is int else None
        if event is None:
            return {"error": GONE}
        lines: List[str] = []
        for tree in explain(self._engine, event).lines:
            for line in tree.indented():
                if len(lines) == MAX_EXPLANATION_LINES:
                    return {"lines": [*lines, "..."]}
                lines.append(line[:MAX_LINE_CHARACTERS])
        return {"lines": lines}

    def query(self, asked: Json) -> Json:
        """Return the first solutions of a goal as texts."""
        if not self._queries:
            return {"error": NOT_ALLOWED}
        goal = asked.get("goal")
        if not isinstance(goal, str) or len(goal) > MAX_GOAL_CHARACTERS:
            return {"error": f"expected a goal of {MAX_GOAL_CHARACTERS} characters at most"}
        found = ask(self._engine, goal, MAX_PAGE_SOLUTIONS, LIMITS, MAX_PAGE_ANSWER_CHARACTERS)
        solutions = [[[value.name, value.text] for value in solution] for solution in found.solutions]
        return {"solutions": solutions, "complete": found.complete}


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

MAX_REQUEST_BYTES = 20_000
"""Bytes of a request's body."""

MAX_HEADER_BYTES = 16_000
"""Bytes of its headers."""

MAX_CONNECTIONS = 40
"""Connections that may be open at once, whatever they are for; one more closes the oldest that has no request."""

BUSY_CONNECTIONS = "busy connections"
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
            self.settings[BUSY_CONNECTIONS].add(self._stream)
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
            self.settings[BUSY_CONNECTIONS].discard(self._stream)

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

    def initialize(self, streams: LiveUpdates) -> None:
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
        if len(self._streams) > MAX_CONNECTIONS:
            application: Any = self.request_callback
            busy = application.settings[BUSY_CONNECTIONS]
            oldest = next(one for one in self._streams if one not in busy)  # the new one has no request yet
            oldest.close()
            if oldest is stream:
                return
        super().handle_stream(stream, address)


def server(streams: LiveUpdates, answers: Answers) -> HTTPServer:
    """Return the server, which has no socket yet."""
    paths = "|".join(path.replace(".", "[.]") for path in FILES)
    routes: Any = [
        (f"({paths})", FileHandler),
        ("/stream", StreamHandler, {"streams": streams}),
        ("/explain", AnswerHandler, {"answer": answers.explain, "answers": answers}),
        ("/query", AnswerHandler, {"answer": answers.query, "answers": answers}),
    ]
    settings: Any = {BUSY_CONNECTIONS: WeakSet()}
    application = Application(
        routes, default_handler_class=NothingHandler, log_function=lambda handler: None, **settings
    )
    return BoundedServer(
        application,
        idle_connection_timeout=IDLE,
        body_timeout=IDLE,
        max_header_size=MAX_HEADER_BYTES,
        max_body_size=MAX_REQUEST_BYTES,
        max_buffer_size=2 * MAX_REQUEST_BYTES,
    )
