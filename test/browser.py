"""A headless Chromium, driven by the protocol of its developer tools."""

import asyncio
import base64
import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from urllib.request import ProxyHandler, build_opener

from tornado.websocket import websocket_connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
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
PATIENCE = 60.0
"""Seconds to wait for anything: the machine may be busy."""


def chromium():
    """Return the path of a Chromium that is installed, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """A browser with one page, and what that has said on its console."""

    def __init__(self, width=1280, height=900, dark=False):
        self._folder = tempfile.mkdtemp(prefix="browser-")
        self._link = None
        command = [chromium(), *OPTIONS, f"--user-data-dir={self._folder}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._loop = asyncio.new_event_loop()
        self._last = 0
        self.console = []
        try:
            self._link = self._loop.run_until_complete(self._connect())
            for part in ("Page", "Runtime", "Log", "Network"):
                self.do(f"{part}.enable")
            self.resize(width, height)
            self.do("Emulation.setScrollbarsHidden", hidden=True)
            scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
            self.do("Emulation.setEmulatedMedia", features=[scheme])
        except BaseException:
            self.close()
            raise

    async def _connect(self):
        told = Path(self._folder) / "DevToolsActivePort"
        port = await self._until(lambda: told.exists() and told.read_text().split("\n")[0])
        opener = build_opener(ProxyHandler({}))

        def page():
            with opener.open(f"http://127.0.0.1:{port}/json/list", timeout=PATIENCE) as answer:
                found = json.load(answer)
            return next((one["webSocketDebuggerUrl"] for one in found if one["type"] == "page"), None)

        return await websocket_connect(await self._until(page), max_message_size=1 << 28)

    async def _until(self, what):
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            found = what()
            if found:
                return found
            await asyncio.sleep(0.05)
        raise AssertionError("the browser does not start")

    def do(self, method, **parameters):
        """Call a method of the protocol and return its result."""
        return self._loop.run_until_complete(asyncio.wait_for(self._do(method, parameters), PATIENCE))

    async def _do(self, method, parameters):
        self._last += 1
        await self._link.write_message(json.dumps({"id": self._last, "method": method, "params": parameters}))
        while True:
            message = json.loads(await self._link.read_message())
            if message.get("id") == self._last:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _note(self, message):
        """Keep what a page says on its console, and what goes wrong in it."""
        kind, told = message.get("method"), message.get("params", {})
        if kind == "Runtime.consoleAPICalled":
            self.console.append(" ".join(str(one.get("value")) for one in told["args"]))
        elif kind == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            self.console.append(details.get("exception", {}).get("description", details["text"]))
        elif kind == "Log.entryAdded":
            self.console.append(f"{told['entry']['text']} {told['entry'].get('url', '')}")

    def resize(self, width, height):
        """Give the page a size; a narrow one is a phone's."""
        self.do(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )

    def open(self, url):
        self.do("Page.navigate", url=url)

    def ask(self, expression):
        """Return the value of an expression in the page."""
        found = self.do("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait_for(self, expression):
        """Return the value of an expression as soon as it is one that counts."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            found = self.ask(expression)
            if found:
                return found
            self._loop.run_until_complete(asyncio.sleep(0.05))
        raise AssertionError(f"waited in vain for {expression}; console: {self.console}")

    def picture(self, whole=True):
        """Return the page as PNG, or what is seen of it."""
        found = self.do("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        return base64.b64decode(found["data"])

    def height(self):
        """Return how high all of the page is."""
        return self.ask("document.documentElement.scrollHeight")

    def close(self):
        if self._link is not None:
            self._link.close()
            self._loop.run_until_complete(_settle())
        self._process.terminate()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._loop.close()
        shutil.rmtree(self._folder, ignore_errors=True)  # its other processes may be just ending


async def _settle():
    """Let what reads from the browser end."""
    me = asyncio.current_task()
    others = [task for task in asyncio.all_tasks() if task is not me]
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)
