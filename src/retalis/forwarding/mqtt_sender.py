"""Thread that sends the events of a queue to a broker of MQTT 3.1.1, with quality of service 1.

A limited number of events is in flight: sent, but not acknowledged. If the connection ends, they return to the queue,
and the next connection sends them again, in order, so that each event arrives at least once. Each connection has its
own client of paho, which does not repeat messages itself. The thread waits for the socket and for `wake`; paho has no
thread of its own.
"""

import json
import logging
import random
import selectors
import socket
import threading
import time
from collections import deque
from typing import Any, Deque, List, Optional, Set, Tuple

from ..foundation.displayed_text import format_count, printable, shorten
from ..foundation.errors import RetalisError, UsageError, install_hint
from .disk_queue import DiskQueue, QueuedEvent
from .forwarding_options import Broker

log = logging.getLogger("retalis")

MAX_IN_FLIGHT_EVENTS = 100
"""Limit for the number of events in flight."""

MAX_IN_FLIGHT_BYTES = 250_000
"""Limit for the length of the events that are taken from the queue together."""

KEEPALIVE_SECONDS = 20
"""Seconds after which a silent connection is tested; after the same time without an answer it ends."""

MIN_RETRY_SECONDS = 1.0
"""Seconds after the first failed connection until the next one; they double with each failure."""

MAX_RETRY_SECONDS = 30.0
"""Maximum of these seconds."""

_MAINTENANCE_SECONDS = 1.0
"""Seconds between two checks of the connection, in which confirmed events are deleted from the queue."""


OLDEST_PAHO = (1, 6)
"""Oldest version of paho; newer ones are accepted."""

OLDEST_PAHO_WITH_MANUAL_ACK = (2, 0)
"""Oldest version that lets a receiver acknowledge messages itself."""


def import_paho(oldest: Tuple[int, int] = OLDEST_PAHO) -> Any:
    """Return the module of the client.

    Args:
        oldest: oldest version that is accepted.

    Raises:
        UsageError: if it is not installed, or older.
    """
    version = f"{oldest[0]}.{oldest[1]}"
    hint = f"pip install 'paho-mqtt>={version}'"
    if oldest == OLDEST_PAHO:
        hint = install_hint(f"'paho-mqtt>={version}'", "python3-paho-mqtt")
    try:
        import paho.mqtt  # noqa: PLC0415 - optional
        import paho.mqtt.client  # noqa: PLC0415
    except ImportError as error:
        raise UsageError(
            f"MQTT needs the Python package paho-mqtt {version} or later: {error}: {hint}"
        ) from error
    installed = paho.mqtt.__version__
    if tuple(int(part) for part in installed.split(".")[:2]) < oldest:
        raise UsageError(
            f"MQTT needs the Python package paho-mqtt {version} or later: {installed} is installed: {hint}"
        )
    return paho.mqtt.client


def create_client(client_id: str, clean_session: bool = True, manual_ack: bool = False) -> Any:
    """Return a client of paho.

    Args:
        client_id: name of the client; "" for a random one.
        clean_session: whether the broker forgets the client when the connection ends.
        manual_ack: whether messages are acknowledged by `Client.ack`.

    Raises:
        UsageError: if paho is not installed, or too old.
    """
    paho = import_paho(OLDEST_PAHO_WITH_MANUAL_ACK if manual_ack else OLDEST_PAHO)
    versions = getattr(paho, "CallbackAPIVersion", None)
    arguments = {} if versions is None else {"callback_api_version": versions.VERSION2}
    if manual_ack:
        arguments["manual_ack"] = True
    return paho.Client(client_id=client_id, clean_session=clean_session, **arguments)


class InFlightEvents:
    """Events that were sent on a connection, in the order of sending, and their acknowledgements."""

    def __init__(self) -> None:
        self._sent: Deque[Tuple[int, QueuedEvent]] = deque()
        self._acknowledged: Set[int] = set()

    def __len__(self) -> int:
        """Return the number of events that are not confirmed."""
        return len(self._sent)

    def add(self, message_id: int, event: QueuedEvent) -> None:
        """Add an event with the id of its message on the connection."""
        self._sent.append((message_id, event))

    def acknowledge(self, message_id: int) -> None:
        """Record the acknowledgement of a message."""
        self._acknowledged.add(message_id)

    def pop_confirmed(self) -> List[QueuedEvent]:
        """Remove and return the events before the first one without an acknowledgement.

        A broker acknowledges in order, so that usually these are all acknowledged ones.
        """
        confirmed = []
        while self._sent and self._sent[0][0] in self._acknowledged:
            message_id, event = self._sent.popleft()
            self._acknowledged.discard(message_id)
            confirmed.append(event)
        return confirmed


class MqttSender:
    """Sends the events of a queue to a broker, in a thread.

    Args:
        broker: the broker.
        robot: name of the robot: events are sent to the topic ``retalis/ROBOT/events``.
        queue: the queue.

    Attributes:
        is_connected: whether the broker has accepted the connection.
        changed_at: time of the monotonic clock in seconds since when ``is_connected`` has its value.
        problem: reason of the end of the last connection, or of the last failure to connect; "" if there is none.
        connection_count: number of connections.
        confirmed_count: number of events that the broker has acknowledged.
        repeated_count: number of times that an event was sent again.

    Raises:
        UsageError: if paho is not installed or too old, or a certificate cannot be read.
    """

    def __init__(self, broker: Broker, robot: str, queue: DiskQueue):
        self._paho = import_paho()
        self._broker = broker
        self._robot = robot
        self._topic = f"retalis/{robot}/events"
        self._queue = queue
        self.is_connected = False
        self.changed_at = time.monotonic()
        self.problem = ""
        self.connection_count = self.confirmed_count = self.repeated_count = 0
        self._has_new_events = True
        self._next_release = 0.0
        self._last_sent: Tuple[str, int] = ("", 0)
        self._end: Optional[float] = None
        """Instant of the monotonic clock at which the thread ends at the latest; None before `stop`."""
        # Wrong certificates are an error at the start.
        self._make_client()
        self._is_stopping = threading.Event()
        self._wake_receiver, self._wake_sender = socket.socketpair()
        self._wake_receiver.setblocking(False)
        self._wake_sender.setblocking(False)
        self._thread = threading.Thread(target=self._run, name="retalis forwarding", daemon=True)

    def start(self) -> None:
        """Start to connect."""
        self._thread.start()

    def wake(self) -> None:
        """Send the new events of the queue; may be called by any thread."""
        self._has_new_events = True
        try:
            self._wake_sender.send(b"w")
        except OSError:
            # The buffer is full of such bytes, or the thread has ended.
            pass

    def stop(self, seconds: float) -> None:
        """Send what can be sent within some seconds, and end."""
        self._end = time.monotonic() + seconds
        self._is_stopping.set()
        self.wake()
        # A thread that looks up a name may not end in time.
        self._thread.join(seconds + _MAINTENANCE_SECONDS)

    def _run(self) -> None:
        delay = MIN_RETRY_SECONDS
        while not self._is_stopping.is_set():
            connection_count = self.connection_count
            try:
                reason = self._connect_and_send()
            # A broker may send anything, and paho raises errors of several kinds.
            except Exception as error:
                reason = str(error) if isinstance(error, (OSError, RetalisError)) else repr(error)
            if self._is_stopping.is_set():
                break
            self._record_end(reason, was_connected=self.connection_count > connection_count)
            if self.connection_count > connection_count:
                delay = MIN_RETRY_SECONDS
            # Many robots lose their connections at the same time, and must not return at the same time.
            self._is_stopping.wait(delay * random.uniform(0.5, 1))
            delay = min(2 * delay, MAX_RETRY_SECONDS)
        self.is_connected = False
        self._wake_receiver.close()
        self._wake_sender.close()

    def _record_end(self, reason: str, was_connected: bool) -> None:
        if was_connected:
            self.changed_at = time.monotonic()
        self.is_connected = False
        # Once for each outage: the attempts to connect fail for the same reason, or an equivalent one.
        if was_connected or not self.problem:
            log.warning(
                "forwarding: no connection to %s: %s; events are queued",
                self._broker,
                printable(shorten(reason)),
            )
        self.problem = reason

    def _make_client(self) -> Any:
        """Return a client that is configured for the broker.

        Raises:
            UsageError: if a certificate cannot be read.
        """
        broker = self._broker
        client = create_client(f"retalis-{self._robot}")
        client.max_inflight_messages_set(MAX_IN_FLIGHT_EVENTS)
        if broker.user is not None:
            client.username_pw_set(broker.user, broker.password)
        if broker.uses_tls:
            try:
                client.tls_set(None if broker.ca_file is None else str(broker.ca_file))
            except OSError as error:
                raise UsageError(f"{broker.ca_file}: the certificates cannot be read: {error}") from error
        return client

    def _connect_and_send(self) -> str:
        """Connect, and send events until the connection ends; return the reason of its end."""
        client, in_flight = self._make_client(), InFlightEvents()
        answers: List[Any] = []
        # The further arguments of these callbacks depend on the version of paho.
        client.on_connect = lambda _client, _data, _flags, code, *_: answers.append(code)
        client.on_publish = lambda _client, _data, message_id, *_: in_flight.acknowledge(message_id)
        self._queue.rewind()
        self._has_new_events = True
        client.connect(self._broker.host, self._broker.port, KEEPALIVE_SECONDS)
        with selectors.DefaultSelector() as selector:
            selector.register(self._wake_receiver, selectors.EVENT_READ)
            selector.register(client.socket(), selectors.EVENT_READ)
            while True:
                status = self._transfer(client, selector)
                if answers and answers[0] != 0:
                    reason = str(self._paho.connack_string(answers[0])).rstrip(".")
                    return f"the broker refuses it: {reason}"
                if status:
                    return str(self._paho.error_string(status)).rstrip(".")
                if answers:
                    self._record_connection()
                    self._confirm(in_flight.pop_confirmed())
                    self._send_events(client, in_flight)
                if self._end is not None and (
                    time.monotonic() >= self._end or not answers or not (in_flight or self._queue.count)
                ):
                    client.disconnect()
                    return ""

    def _transfer(self, client: Any, selector: selectors.BaseSelector) -> int:
        """Wait for the socket or for `wake`, and read and write; return 0, or the error code of paho."""
        connection = client.socket()
        if connection is None:
            # Sending has failed, and paho has closed the socket.
            return int(self._paho.MQTT_ERR_CONN_LOST)
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.want_write() else 0)
        if selector.get_key(connection).events != events:
            selector.modify(connection, events)
        # Data that TLS has decrypted already do not make the socket readable.
        has_pending_data = bool(getattr(connection, "pending", int)())
        timeout = 0.0 if has_pending_data else _MAINTENANCE_SECONDS
        if self._end is not None:
            timeout = max(0.0, min(timeout, self._end - time.monotonic()))
        ready = {key.fileobj: mask for key, mask in selector.select(timeout)}
        if self._wake_receiver in ready:
            self._wake_receiver.recv(4096)
        status = 0
        if has_pending_data or ready.get(connection, 0) & selectors.EVENT_READ:
            status = client.loop_read()
        if not status and ready.get(connection, 0) & selectors.EVENT_WRITE:
            status = client.loop_write()
        self._release_when_due()
        return int(status or client.loop_misc())

    def _record_connection(self) -> None:
        if self.is_connected:
            return
        self.is_connected = True
        self.changed_at = time.monotonic()
        self.connection_count += 1
        self.problem = ""
        log.info(
            "forwarding: connected to %s, %s queued", self._broker, format_count(self._queue.count, "event")
        )

    def _confirm(self, events: List[QueuedEvent]) -> None:
        if events:
            session, last_id, _ = events[-1]
            # If the file was damaged meanwhile, the first ones belong to an earlier session.
            self._queue.confirm(session, last_id, sum(event.session == session for event in events))
            self.confirmed_count += len(events)

    def _release_when_due(self) -> None:
        now = time.monotonic()
        if now < self._next_release:
            return
        self._next_release = now + _MAINTENANCE_SECONDS
        try:
            self._queue.release()
        except RetalisError:
            # Events that cannot be deleted now are deleted later, or sent again after a restart.
            pass

    def _send_events(self, client: Any, in_flight: InFlightEvents) -> None:
        """Send further events, if fewer than half of the maximum are in flight: reading single events is slow."""
        while self._has_new_events and 2 * len(in_flight) <= MAX_IN_FLIGHT_EVENTS:
            # Before reading: `wake` may set it again at any moment.
            self._has_new_events = False
            events = self._queue.take(MAX_IN_FLIGHT_EVENTS - len(in_flight), MAX_IN_FLIGHT_BYTES)
            if events:
                self._has_new_events = True
            for event in events:
                message = client.publish(self._topic, self._make_payload(event), qos=1)
                in_flight.add(message.mid, event)
                session, last_id = self._last_sent
                if event.session == session and event.id <= last_id:
                    self.repeated_count += 1
                else:
                    self._last_sent = event.session, event.id

    def _make_payload(self, queued: QueuedEvent) -> bytes:
        start, end, text = queued.event
        fields = {
            "robot": self._robot,
            "session": queued.session,
            "id": queued.id,
            "time": end,
            "event": text,
        }
        if start != end:
            fields["start"] = start
        # Escapes would double the length, and receivers limit it.
        return json.dumps(fields, separators=(",", ":"), ensure_ascii=False).encode()
