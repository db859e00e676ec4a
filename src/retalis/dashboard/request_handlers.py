"""HTTP handlers of the dashboard: static files, the event stream, explanations and queries.

This is the only module that imports tornado. Any web page in the user's browser can send requests to a port of the
loopback address (cross-site request forgery, DNS rebinding). `LocalHandler` therefore checks the headers ``Host``,
``Origin`` and ``Sec-Fetch-Site`` of each request, and requests with an effect require JSON, which browsers do not
send across origins without permission.
"""

import asyncio
import json
import threading
from pathlib import Path
from typing import Any, Awaitable, Callable, Dict, List, NamedTuple, Optional, Tuple, Union
from urllib.parse import urlsplit
from weakref import WeakSet

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream, StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler

from ..engine.client_requests import ask
from ..explanation.event_and_output_explanations import explain, records_origins
from ..foundation.displayed_text import printable_json, shorten
from ..foundation.errors import RetalisError
from ..prolog.machine.resource_limits import Limits
from .view_model import DashboardSource, LiveUpdates, Snapshots

MAX_CONCURRENT_ANSWERS = 2
"""Limit for concurrent answers: each holds a thread until the engine has executed it."""

MAX_PAGE_SOLUTIONS = 100
"""Limit for the solutions of a query."""

MAX_PAGE_ANSWER_CHARACTERS = 100_000
"""Limit for the characters of all solutions of a query."""

MAX_GOAL_CHARACTERS = 5_000
"""Limit for the characters of a goal."""

LIMITS = Limits(seconds=5.0, output_megabytes=None)
"""Limits of a query, in addition to the engine's."""

MAX_EXPLANATION_SECONDS = 0.2
"""Limit for the time of an explanation, during which the engine processes no events."""

MAX_EXPLANATION_LINES = 500
"""Limit for the lines of an explanation."""

MAX_LINE_CHARACTERS = 1_000
"""Limit for the characters of a line of an explanation."""

MAX_ERROR_CHARACTERS = 1_000
"""Limit for the characters of an error."""

NOT_RECORDED = "what events come from is not recorded: start the node with explain:=true"
QUERIES_NOT_ALLOWED = "queries are not allowed: start the node with dashboard_queries:=true"
EVENT_NOT_STORED = "this event is no longer kept"
BUSY_ANSWER = "other answers are still awaited: the engine is busy"

Json = Dict[str, Any]


class ErrorAnswer(NamedTuple):
    """Answer to a request that cannot be fulfilled, with the reason; the page reads the name of the field."""

    error: str


class ExplanationAnswer(NamedTuple):
    """Explanation of an event in lines; the page reads the name of the field."""

    lines: List[str]


class QueryAnswer(NamedTuple):
    """Solutions of a goal; the page reads the names of the fields.

    Attributes:
        solutions: for each solution, the name and the value of each variable.
        complete: whether there are no more solutions.
    """

    solutions: List[List[Tuple[str, str]]]
    complete: bool


PageAnswer = Union[ErrorAnswer, ExplanationAnswer, QueryAnswer]


class AnswerService:
    """Answers to requests of the page, each in a thread: a busy engine must not block the server's loop.

    Args:
        source: the program.
        snapshots: contain the events that can be explained.
    """

    def __init__(self, source: DashboardSource, snapshots: Snapshots):
        self._engine = source.engine
        self._allows_queries = source.allows_queries
        self._events = snapshots.events
        self._answer_slots = threading.BoundedSemaphore(MAX_CONCURRENT_ANSWERS)

    async def answer_in_thread(self, work: Callable[[], PageAnswer]) -> PageAnswer:
        """Run ``work`` in a thread; return its result, or an `ErrorAnswer`."""
        if not self._answer_slots.acquire(blocking=False):
            return ErrorAnswer(BUSY_ANSWER)
        loop = asyncio.get_event_loop()
        answer: asyncio.Future[PageAnswer] = loop.create_future()

        def set_answer(result: PageAnswer) -> None:
            # The answer is cancelled if the page was closed.
            if not answer.done():
                answer.set_result(result)

        def run_work() -> None:
            result: PageAnswer = ErrorAnswer("internal error")
            try:
                result = work()
            except RetalisError as error:
                result = ErrorAnswer(shorten(error.brief(), MAX_ERROR_CHARACTERS))
            finally:
                self._answer_slots.release()
                # The server may have been closed while the thread was working.
                if not loop.is_closed():
                    loop.call_soon_threadsafe(set_answer, result)

        try:
            threading.Thread(target=run_work, daemon=True, name="dashboard answer").start()
        except RuntimeError:
            # The system has no further thread.
            self._answer_slots.release()
            return ErrorAnswer(BUSY_ANSWER)
        return await answer

    def explain(self, request: Json) -> PageAnswer:
        """Return the explanation of a recent event, which the page identifies by its serial number."""
        if not records_origins(self._engine):
            return ErrorAnswer(NOT_RECORDED)
        serial: Any = request.get("serial")
        # The page sends a number and no text, so nothing has to be parsed and any event can be explained without
        # permission.
        event = self._events.find(serial) if serial.__class__ is int else None
        if event is None:
            return ErrorAnswer(EVENT_NOT_STORED)
        lines: List[str] = []
        for tree in explain(self._engine, event, MAX_EXPLANATION_SECONDS).lines:
            for line in tree.indented():
                if len(lines) == MAX_EXPLANATION_LINES:
                    return ExplanationAnswer([*lines, "..."])
                lines.append(line[:MAX_LINE_CHARACTERS])
        return ExplanationAnswer(lines)

    def query(self, request: Json) -> PageAnswer:
        """Return the first solutions of a goal as text."""
        if not self._allows_queries:
            return ErrorAnswer(QUERIES_NOT_ALLOWED)
        goal = request.get("goal")
        if not isinstance(goal, str) or len(goal) > MAX_GOAL_CHARACTERS:
            return ErrorAnswer(f"expected a goal of {MAX_GOAL_CHARACTERS} characters at most")
        answer = ask(self._engine, goal, MAX_PAGE_SOLUTIONS, LIMITS, MAX_PAGE_ANSWER_CHARACTERS)
        solutions = [[(value.name, value.text) for value in solution] for solution in answer.solutions]
        return QueryAnswer(solutions, answer.complete)


PAGE = Path(__file__).resolve().parent / "page"

FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/dashboard.css": ("dashboard.css", "text/css; charset=utf-8"),
    "/dashboard.js": ("dashboard.js", "text/javascript; charset=utf-8"),
    "/graph.js": ("graph.js", "text/javascript; charset=utf-8"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}
"""All served files. Requested paths are looked up here and never joined to a folder."""

CONTENT_SECURITY_POLICY = "; ".join(
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

LOOPBACK_HOSTS = ("127.0.0.1", "localhost")
"""Accepted host names. The port is not compared, because it differs at the other end of an SSH tunnel."""

MAX_REQUEST_BYTES = 20_000
"""Limit for the body of a request."""

MAX_HEADER_BYTES = 16_000
"""Limit for the headers of a request."""

MAX_CONNECTIONS = 40
"""Limit for open connections; a further one closes the oldest connection without a request."""

BUSY_CONNECTIONS = "busy connections"
"""Name of the application setting with the connections whose requests are being answered, including live pages."""

IDLE_TIMEOUT_SECONDS = 60.0
"""Seconds after which a connection without a request is closed."""


class LocalHandler(RequestHandler):
    """Base of all handlers, which accepts requests of the dashboard's page and of clients other than browsers.

    A foreign page in the same browser can reach the port, too: by its address, which the browser reports in
    ``Origin`` and ``Sec-Fetch-Site``, or by a host name that resolves to the loopback address (``Host``).
    """

    # Tornado answers a request with an unknown method without calling `prepare`.
    _stream: Any = None

    def prepare(self) -> None:
        """Refuse requests that a foreign page may have sent."""
        self._stream = getattr(self.request.connection, "stream", None)
        if self._stream is not None:
            self.settings[BUSY_CONNECTIONS].add(self._stream)
        headers = self.request.headers
        host = headers.get("Host", "")
        if _host_name(host) not in LOOPBACK_HOSTS:
            raise HTTPError(403, reason="Not the loopback address")
        # Browsers send Origin with requests of scripts and with POST requests of forms.
        if headers.get("Origin", f"http://{host}") != f"http://{host}":
            raise HTTPError(403, reason="Another page")
        # A link from a foreign page to the start page is harmless, and users follow them.
        if headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin") and self.request.path != "/":
            raise HTTPError(403, reason="Another page")

    def on_finish(self) -> None:
        """Mark the connection as idle."""
        if self._stream is not None:
            self.settings[BUSY_CONNECTIONS].discard(self._stream)

    def set_default_headers(self) -> None:
        """Set headers that restrict the browser to the page's own scripts, styles and connections."""
        for name, value in (
            ("Content-Security-Policy", CONTENT_SECURITY_POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("X-Frame-Options", "DENY"),
            ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("Cross-Origin-Opener-Policy", "same-origin"),
            ("Cache-Control", "no-store"),
            ("Server", "retalis"),
        ):
            self.set_header(name, value)

    def write_error(self, status_code: int, **options: object) -> None:
        """Answer with the status and reason in one line, without internals such as a traceback."""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {self._reason}\n")

    def data_received(self, chunk: bytes) -> Optional[Awaitable[None]]:
        """Refuse streamed bodies."""
        raise HTTPError(400)


class FileHandler(LocalHandler):
    """Serves the files of the page."""

    def get(self, path: str) -> None:
        """Answer with a file."""
        name, content_type = FILES[path]
        self.set_header("Content-Type", content_type)
        self.finish((PAGE / name).read_bytes())


class StreamHandler(LocalHandler):
    """Serves the live data as server-sent events."""

    def initialize(self, live_updates: LiveUpdates) -> None:
        """Store the source of the data; tornado calls this for each request."""
        self._live_updates = live_updates

    async def get(self) -> None:
        """Send updates until the page is closed."""
        # Without events no listener is registered in the engine; see `RecentEvents`.
        connection = self._live_updates.add_page(self.get_query_argument("events", "1") == "1")
        if connection is None:
            raise HTTPError(503, reason="Too many pages are open")
        self._page_connection = connection
        self.set_header("Content-Type", "text/event-stream; charset=utf-8")
        try:
            data = await connection.next()
            while data:
                self.write(data)
                await self.flush()
                data = await connection.next()
        except StreamClosedError:
            pass
        finally:
            self._live_updates.remove_page(connection)

    def on_connection_close(self) -> None:
        """Remove the page."""
        connection = getattr(self, "_page_connection", None)
        if connection is not None:
            self._live_updates.remove_page(connection)
            connection.end_stream()


class AnswerHandler(LocalHandler):
    """Answers requests in JSON with JSON."""

    def initialize(self, answer: Callable[[Json], PageAnswer], answer_service: AnswerService) -> None:
        """Store the answering function; tornado calls this for each request."""
        self._answer = answer
        self._answer_service = answer_service

    async def post(self) -> None:
        """Answer a request, which must be JSON: browsers do not send JSON for foreign pages without permission."""
        if self.request.headers.get("Content-Type", "").partition(";")[0] != "application/json":
            raise HTTPError(415, reason="Expected application/json")
        try:
            fields = json.loads(self.request.body)
        except (ValueError, RecursionError):
            fields = None
        if not isinstance(fields, dict):
            raise HTTPError(400, reason="Expected an object of JSON")
        answer = await self._answer_service.answer_in_thread(lambda: self._answer(fields))
        self.finish(printable_json(answer._asdict()))


class NotFoundHandler(LocalHandler):
    """Answers all other requests with status 404."""

    def prepare(self) -> None:
        """Refuse the request."""
        super().prepare()
        raise HTTPError(404)


def _host_name(host: str) -> Optional[str]:
    """Return the host name in a ``Host`` header, without the port; None if it is malformed."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


class BoundedServer(HTTPServer):
    """HTTP server with a limit for its connections."""

    def initialize(self, *arguments: Any, **options: Any) -> None:
        """Initialize the list of connections; tornado calls this from its constructor."""
        super().initialize(*arguments, **options)
        self._streams: List[IOStream] = []

    def handle_stream(self, stream: IOStream, address: Any) -> None:
        """Accept a connection; beyond the limit, close the oldest one without a complete request."""
        self._streams = [open_stream for open_stream in self._streams if not open_stream.closed()]
        self._streams.append(stream)
        if len(self._streams) > MAX_CONNECTIONS:
            application: Any = self.request_callback
            busy = application.settings[BUSY_CONNECTIONS]
            # There is always one: the new connection has no request yet.
            oldest = next(open_stream for open_stream in self._streams if open_stream not in busy)
            oldest.close()
            if oldest is stream:
                return
        super().handle_stream(stream, address)

    def close_streams(self) -> None:
        """Close all connections."""
        for stream in self._streams:
            stream.close()


def create_server(source: DashboardSource, snapshots: Snapshots, live_updates: LiveUpdates) -> BoundedServer:
    """Return the server, without a socket."""
    answer_service = AnswerService(source, snapshots)
    paths = "|".join(path.replace(".", "[.]") for path in FILES)
    routes: Any = [
        (f"({paths})", FileHandler),
        ("/stream", StreamHandler, {"live_updates": live_updates}),
        ("/explain", AnswerHandler, {"answer": answer_service.explain, "answer_service": answer_service}),
        ("/query", AnswerHandler, {"answer": answer_service.query, "answer_service": answer_service}),
    ]
    # Weak references: a connection that tornado drops without `on_finish` must not stay marked as busy.
    settings: Any = {BUSY_CONNECTIONS: WeakSet()}
    application = Application(
        routes, default_handler_class=NotFoundHandler, log_function=lambda handler: None, **settings
    )
    return BoundedServer(
        application,
        idle_connection_timeout=IDLE_TIMEOUT_SECONDS,
        body_timeout=IDLE_TIMEOUT_SECONDS,
        max_header_size=MAX_HEADER_BYTES,
        max_body_size=MAX_REQUEST_BYTES,
        max_buffer_size=2 * MAX_REQUEST_BYTES,
    )
