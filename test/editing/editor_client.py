"""Client of the language server, as an editor: messages of JSON-RPC on the standard streams of a process."""

import json
import queue
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Dict, List, Optional

from asserting_accessors import required
from subprocess_python_path import python_path

TIMEOUT_SECONDS = 60


class EditorClient:
    """An editor that has started the server in a process."""

    def __init__(self, *options: str, encoding: str = "utf-16") -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "retalis", "lsp", *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={"PYTHONPATH": python_path(), "PATH": "/usr/bin:/bin"},
        )
        self._messages: queue.Queue[Any] = queue.Queue()
        self._readers = [
            threading.Thread(target=self._read, name="editor client"),
            threading.Thread(target=self._read_errors, name="editor client errors"),
        ]
        self.errors = b""
        for reader in self._readers:
            reader.start()
        self._last_id = 0
        self._versions: Dict[str, int] = {}
        self.notifications: List[Any] = []
        capabilities = {"general": {"positionEncodings": [encoding]}}
        self.capabilities = self.request(
            "initialize", processId=None, rootUri=None, capabilities=capabilities
        )
        self.notify("initialized")

    def _read(self) -> None:
        stream = required(self.process.stdout)
        while True:
            length = 0
            for line in iter(stream.readline, b"\r\n"):
                if not line:
                    self._messages.put(None)
                    return
                if line.lower().startswith(b"content-length:"):
                    length = int(line.partition(b":")[2])
            self._messages.put(json.loads(stream.read(length)))

    def _read_errors(self) -> None:
        self.errors = required(self.process.stderr).read()

    def _send(self, message: Any) -> None:
        data = json.dumps({"jsonrpc": "2.0", **message}).encode()
        stream = required(self.process.stdin)
        stream.write(b"Content-Length: %d\r\n\r\n" % len(data) + data)
        stream.flush()

    def _receive(self) -> Any:
        message = self._messages.get(timeout=TIMEOUT_SECONDS)
        assert message is not None, self.errors.decode()
        return message

    def notify(self, method: str, **parameters: Any) -> None:
        """Send a notification."""
        self._send({"method": method, "params": parameters})

    def response(self, method: str, **parameters: Any) -> Any:
        """Send a request; return the whole response."""
        self._last_id += 1
        self._send({"id": self._last_id, "method": method, "params": parameters})
        while True:
            message = self._receive()
            if message.get("id") == self._last_id:
                return message
            self.notifications.append(message)

    def request(self, method: str, **parameters: Any) -> Any:
        """Send a request; return its result."""
        response = self.response(method, **parameters)
        assert "error" not in response, response
        return response["result"]

    def open(self, path: Path, text: Optional[str] = None) -> None:
        """Open a file, with its text on the disk by default."""
        uri = path.as_uri()
        self._versions[uri] = 1
        content = path.read_text(encoding="utf-8") if text is None else text
        document = {"uri": uri, "languageId": "retalis", "version": 1, "text": content}
        self.notify("textDocument/didOpen", textDocument=document)

    def change(self, path: Path, text: str) -> None:
        """Replace the text of an open file."""
        uri = path.as_uri()
        self._versions[uri] += 1
        document = {"uri": uri, "version": self._versions[uri]}
        self.notify("textDocument/didChange", textDocument=document, contentChanges=[{"text": text}])

    def close(self, path: Path) -> None:
        """Close a file without saving it."""
        self.notify("textDocument/didClose", textDocument={"uri": path.as_uri()})

    def problems(self, path: Path) -> Any:
        """Return the next problems of a file that the server sends."""
        while True:
            for position, message in enumerate(self.notifications):
                if (
                    message.get("method") == "textDocument/publishDiagnostics"
                    and message["params"]["uri"] == path.as_uri()
                ):
                    del self.notifications[position]
                    return message["params"]["diagnostics"]
            self.notifications.append(self._receive())

    def at(self, method: str, path: Path, line: int, character: int, **parameters: Any) -> Any:
        """Send a request about a position of a file; return its result."""
        position = {"line": line, "character": character}
        return self.request(method, textDocument={"uri": path.as_uri()}, position=position, **parameters)

    def stop(self) -> int:
        """End the server; return its exit status."""
        self.request("shutdown")
        self.notify("exit")
        status = self.process.wait(TIMEOUT_SECONDS)
        for reader in self._readers:
            reader.join(TIMEOUT_SECONDS)
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            required(stream).close()
        return status
