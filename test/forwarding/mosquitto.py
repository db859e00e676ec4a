"""A real broker of MQTT and a subscriber, as processes of the packages ``mosquitto`` and ``mosquitto-clients``."""

import json
import shutil
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path
from typing import Any, Callable, Dict, List, Sequence

import pytest

TIMEOUT_SECONDS = 20.0

NEEDS_BROKER = pytest.mark.skipif(
    shutil.which("mosquitto", path="/usr/sbin:/usr/bin") is None or shutil.which("mosquitto_sub") is None,
    reason="needs the packages mosquitto and mosquitto-clients",
)


def wait_until(condition: Callable[[], object], description: str) -> None:
    """Wait until a condition holds; fail after `TIMEOUT_SECONDS`."""
    end = time.monotonic() + TIMEOUT_SECONDS
    while not condition():
        assert time.monotonic() < end, f"waited in vain for {description}"
        time.sleep(0.01)


def find_free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        port: int = server.getsockname()[1]
        return port


class Broker:
    """A broker on a port of its own, without persistence: it forgets its sessions at each end.

    Args:
        folder: folder of its configuration.
        lines: further lines of the configuration.
        address: address of the port.
        prefix: words before its command, such as those that select a network namespace.
    """

    def __init__(
        self, folder: Path, *lines: str, address: str = "127.0.0.1", prefix: Sequence[str] = ()
    ) -> None:
        self.port = find_free_port()
        self.address = address
        self.prefix = list(prefix)
        self._configuration = folder / "mosquitto.conf"
        access = () if any("password_file" in line for line in lines) else ("allow_anonymous true",)
        self._configuration.write_text(
            "\n".join(
                (f"listener {self.port} {address}", "max_queued_messages 0", *access, *lines, "user root", "")
            )
        )
        self._process: Any = None
        self._subscribers: List[Any] = []

    @property
    def url(self) -> str:
        return f"mqtt://{self.address}:{self.port}"

    def start(self) -> None:
        self._process = subprocess.Popen(
            [*self.prefix, "/usr/sbin/mosquitto", "-c", str(self._configuration)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        # The last line of its start.
        for line in self._process.stderr:
            if line.rstrip().endswith("running"):
                break
        else:
            raise AssertionError("mosquitto has not started")
        threading.Thread(target=self._process.stderr.read, daemon=True).start()

    def kill(self, number: signal.Signals = signal.SIGKILL) -> None:
        """End it, by default without the chance to write or send anything."""
        self._process.send_signal(number)
        self._process.wait(TIMEOUT_SECONDS)

    def send_signal(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def subscribe(self, *options: str) -> "Subscriber":
        """Return a subscriber to the events of all robots, which is connected."""
        subscriber = Subscriber(self, options)
        self._subscribers.append(subscriber)
        return subscriber

    def close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.close()
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGCONT)
            self.kill()
        if self._process is not None:
            self._process.stderr.close()


class Relay:
    """Passes bytes between clients and a broker, until the connections are cut.

    Args:
        broker: the broker.

    Attributes:
        url: its address for clients.
    """

    def __init__(self, broker: Broker) -> None:
        self._target = (broker.address, broker.port)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"mqtt://127.0.0.1:{self._server.getsockname()[1]}"
        self._sockets: List[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            try:
                server = socket.create_connection(self._target)
            except OSError:
                # The broker is down: later clients may reach it again.
                client.close()
                continue
            self._sockets += [client, server]
            for source, target in ((client, server), (server, client)):
                self._threads.append(threading.Thread(target=self._pass_on, args=(source, target)))
                self._threads[-1].start()

    @staticmethod
    def _pass_on(source: socket.socket, target: socket.socket) -> None:
        try:
            while True:
                data = source.recv(1000)
                if not data:
                    break
                target.sendall(data)
        except OSError:
            pass

    def cut(self) -> None:
        """Close all connections; bytes that are under way are lost."""
        while self._sockets:
            connection = self._sockets.pop()
            try:
                connection.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
            connection.close()

    def close(self) -> None:
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self.cut()
        for thread in self._threads:
            thread.join()


class Subscriber:
    """A process ``mosquitto_sub`` that receives events, and connects again if the broker is restarted.

    Attributes:
        events: the received events, as dictionaries.
    """

    def __init__(self, broker: Broker, options: Sequence[str]) -> None:
        self.events: List[Dict[str, Any]] = []
        address = [] if any(option.startswith("-L") for option in options) else ["-h", broker.address]
        self._process: Any = subprocess.Popen(
            [
                *broker.prefix,
                "stdbuf",
                "-oL",
                "mosquitto_sub",
                *address,
                "-p",
                str(broker.port),
                "-q",
                "1",
                "-d",
            ]
            + ["-t", "retalis/+/events", *options],
            stdout=subprocess.PIPE,
            text=True,
        )
        self._is_subscribed = threading.Event()
        self._thread = threading.Thread(target=self._read)
        self._thread.start()
        assert self._is_subscribed.wait(TIMEOUT_SECONDS)

    def _read(self) -> None:
        for line in self._process.stdout:
            if line.startswith("{"):
                self.events.append(json.loads(line))
            elif "SUBACK" in line or line.startswith("Subscribed"):
                self._is_subscribed.set()

    def await_resubscription(self) -> None:
        """Wait until it is connected to a restarted broker."""
        self._is_subscribed.clear()
        assert self._is_subscribed.wait(TIMEOUT_SECONDS)

    def wait_for(self, count: int) -> None:
        """Wait for a number of different events."""
        # Repetitions are counted seldom, because that takes time from other threads.
        wait_until(lambda: len(self.events) >= count, f"{count} events")
        wait_until(lambda: len(self.identified()) >= count, f"{count} different events")

    def identified(self) -> Dict[Any, str]:
        """Return the events without repetitions: texts by session and id, in the order of their first arrival.

        Fails if two different events have the same session and id.
        """
        texts: Dict[Any, str] = {}
        for event in list(self.events):
            key = event["session"], event["id"]
            assert texts.setdefault(key, event["event"]) == event["event"]
        return texts

    def close(self) -> None:
        self._process.kill()
        self._process.wait(TIMEOUT_SECONDS)
        self._thread.join()
        self._process.stdout.close()
