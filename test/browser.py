"""A headless Chromium, controlled by the DevTools protocol, that collects everything that goes wrong in a page.

`Browser.problems` has the errors and warnings of the console, uncaught exceptions, and failed requests. Objects that
a page parses from JSON are strict: reading a field that they do not have is an exception, so a name that differs
between Python and a script is a problem, and not an empty cell. The fixture ``browser`` in ``conftest.py`` shares a
browser among the tests of a module, and fails each test that leaves a problem.
"""

import asyncio
import base64
import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional
from urllib.request import ProxyHandler, build_opener

from tornado.websocket import WebSocketClientConnection, websocket_connect

COMMANDS = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--remote-debugging-port=0",
)
TIMEOUT_SECONDS = 60.0
"""Limit for each wait. The machine may be busy."""

MAX_MOBILE_WIDTH = 600
"""Width in pixels up to which the browser behaves as on a phone."""

STRICT_JSON = """
(() => {
  // The names that the language itself reads from any object.
  const implicit = new Set(["then", "toJSON"]);
  const handler = {
    get(target, name) {
      if (typeof name === "string" && !(name in target) && !implicit.has(name))
        throw new TypeError(`this object of JSON has no field '${name}', only ${Object.keys(target)}`);
      return target[name];
    },
  };
  const strict = (value) => {
    if (value === null || typeof value !== "object") return value;
    for (const key of Object.keys(value)) value[key] = strict(value[key]);
    return Array.isArray(value) ? value : new Proxy(value, handler);
  };
  const { parse } = JSON;
  JSON.parse = (text, ...others) => strict(parse(text, ...others));
  Response.prototype.json = async function () { return JSON.parse(await this.text()); };
})();
"""
"""Script that makes objects from JSON strict, before the scripts of a page run."""


def chromium() -> Optional[str]:
    """Return the path of an installed Chromium, or None."""
    return next(filter(None, map(shutil.which, COMMANDS)), None)


class Browser:
    """A browser with one page.

    Args:
        width: width of the page in pixels.
        height: height of the page in pixels.
        dark: whether the page is shown in dark colours.

    Attributes:
        console: all messages of the page's console.
        problems: errors and warnings of the console, exceptions, and failed requests.
    """

    def __init__(self, width: int = 1280, height: int = 900, dark: bool = False) -> None:
        self._folder = tempfile.mkdtemp(prefix="browser-")
        self._socket: Optional[WebSocketClientConnection] = None
        program = chromium()
        assert program is not None, "Chromium is not installed"
        command = [program, *OPTIONS, f"--user-data-dir={self._folder}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._loop = asyncio.new_event_loop()
        self._last_id = 0
        self._urls: Dict[str, str] = {}
        self.console: List[str] = []
        self.problems: List[str] = []
        try:
            self._socket = self._loop.run_until_complete(self._connect())
            for domain in ("Page", "Runtime", "Log", "Network"):
                self.call(f"{domain}.enable")
            self.call("Page.addScriptToEvaluateOnNewDocument", source=STRICT_JSON)
            self.call("Emulation.setScrollbarsHidden", hidden=True)
            self.resize(width, height)
            self.set_dark(dark)
        except BaseException:
            self.close()
            raise

    async def _connect(self) -> WebSocketClientConnection:
        port_file = Path(self._folder) / "DevToolsActivePort"
        port = await self._wait_until(
            lambda: port_file.read_text().split("\n")[0] if port_file.exists() else None
        )
        opener = build_opener(ProxyHandler({}))

        def find_page() -> Optional[str]:
            with opener.open(f"http://127.0.0.1:{port}/json/list", timeout=TIMEOUT_SECONDS) as response:
                targets = json.load(response)
            return next(
                (target["webSocketDebuggerUrl"] for target in targets if target["type"] == "page"), None
            )

        return await websocket_connect(await self._wait_until(find_page), max_message_size=1 << 28)

    async def _wait_until(self, condition: Callable[[], Optional[str]]) -> str:
        deadline = time.monotonic() + TIMEOUT_SECONDS
        while time.monotonic() < deadline:
            value = condition()
            if value:
                return value
            await asyncio.sleep(0.05)
        raise AssertionError("the browser does not start")

    def call(self, method: str, **parameters: Any) -> Any:
        """Call a method of the protocol and return its result."""
        return self._loop.run_until_complete(
            asyncio.wait_for(self._call(method, parameters), TIMEOUT_SECONDS)
        )

    async def _call(self, method: str, parameters: Dict[str, Any]) -> Any:
        assert self._socket is not None
        self._last_id += 1
        request = {"id": self._last_id, "method": method, "params": parameters}
        await self._socket.write_message(json.dumps(request))
        while True:
            text = await self._socket.read_message()
            assert text is not None, "the browser has closed the connection"
            message = json.loads(text)
            if message.get("id") == self._last_id:
                assert "error" not in message, message
                return message["result"]
            self._record(message.get("method"), message.get("params", {}))

    def _record(self, event: Any, details: Any) -> None:
        """Record a message of the console, an exception, or a request."""
        if event == "Runtime.consoleAPICalled":
            text = " ".join(str(argument.get("value")) for argument in details["args"])
            self.console.append(text)
            if details["type"] in ("error", "warning", "assert"):
                self._add_problem(text)
        elif event == "Runtime.exceptionThrown":
            exception = details["exceptionDetails"]
            self._add_problem(exception.get("exception", {}).get("description", exception["text"]))
        elif event == "Log.entryAdded":
            entry = details["entry"]
            text = f"{entry['text']} {entry.get('url', '')}"
            self.console.append(text)
            if entry["level"] in ("error", "warning"):
                self._add_problem(text)
        elif event == "Network.requestWillBeSent":
            self._urls[details["requestId"]] = details["request"]["url"]
        elif event == "Network.responseReceived" and details["response"]["status"] >= 400:
            self._add_problem(f"status {details['response']['status']} {details['response']['url']}")
        # A page that is left, or that closes its stream, cancels requests.
        elif event == "Network.loadingFailed" and not details.get("canceled"):
            url = self._urls.get(details["requestId"], "")
            self._add_problem(f"{details['errorText']} {url}")

    def _add_problem(self, text: str) -> None:
        # A page that is updated in a loop repeats its problem.
        if text not in self.problems:
            self.problems.append(text)

    def take_problems(self) -> List[str]:
        """Return the problems so far, and forget them."""
        # Messages are read during a call only.
        self.ask("0")
        problems, self.problems = self.problems, []
        return problems

    def reset(self) -> None:
        """Leave the page, forget messages and problems, and restore the default size and colours."""
        self.call("Page.navigate", url="about:blank")
        self.take_problems()
        self.console.clear()
        self.resize(1280, 900)
        self.set_dark(False)

    def resize(self, width: int, height: int) -> None:
        """Set the size of the page in pixels; a narrow page is shown as on a phone."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < MAX_MOBILE_WIDTH,
        )

    def set_dark(self, dark: Any) -> None:
        """Show the page in dark or in light colours."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def open(self, url: str) -> None:
        """Open a page, and wait until its scripts have run."""
        self.call("Page.navigate", url=url)
        self.wait_for("document.readyState === 'complete'")

    def ask(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait_for(self, expression: str, allow_problems: bool = False) -> Any:
        """Return the value of an expression as soon as it is true; fail at the first problem unless it is allowed."""
        deadline = time.monotonic() + TIMEOUT_SECONDS
        while time.monotonic() < deadline:
            value = self.ask(expression)
            if value:
                return value
            if self.problems and not allow_problems:
                break
            self._loop.run_until_complete(asyncio.sleep(0.05))
        raise AssertionError(f"{expression} is not true; problems: {self.problems}")

    def send_mouse_event(self, event: Any, x: Any, y: Any, **details: Any) -> None:
        """Send an event of the mouse, such as ``mouseMoved``, at a position in pixels."""
        self.call("Input.dispatchMouseEvent", type=event, x=x, y=y, **details)

    def click(self, x: Any, y: Any, count: int = 1) -> None:
        """Click at a position in pixels; a double click has the count 2."""
        for number in range(1, count + 1):
            for event in ("mousePressed", "mouseReleased"):
                self.send_mouse_event(event, x, y, button="left", clickCount=number)

    def press(self, key: Any) -> None:
        """Press and release a key, such as ``ArrowLeft``."""
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    def picture(self, whole: bool = True) -> bytes:
        """Return the page as PNG, or only the visible part of it."""
        result = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        return base64.b64decode(result["data"])

    def height(self) -> Any:
        """Return the height of the whole page in pixels."""
        return self.ask("document.documentElement.scrollHeight")

    def close(self) -> None:
        """End the browser."""
        if self._socket is not None:
            self._socket.close()
            self._loop.run_until_complete(_cancel_other_tasks())
        self._process.terminate()
        try:
            self._process.wait(TIMEOUT_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._loop.close()
        # Other processes of the browser may still write to the folder.
        shutil.rmtree(self._folder, ignore_errors=True)


async def _cancel_other_tasks() -> None:
    """Cancel the tasks that read from the browser, and wait for their end."""
    current = asyncio.current_task()
    others = [task for task in asyncio.all_tasks() if task is not current]
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)
