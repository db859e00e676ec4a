"""A bridge from MQTT to a log: the events of robots are acknowledged when they are on the disk.

The bridge has a persistent session, so that the broker keeps the events while it is away. If it is killed, the broker
sends the events again that were not acknowledged; the fleet drops those that the log has already, by their ids.
"""

import json
import logging
import time
from pathlib import Path
from typing import Any, Callable, List, Optional, Tuple

from ..forwarding.mqtt_sender import create_client
from ..foundation.displayed_text import quote_shortened
from .line_log import LogWriter

log = logging.getLogger("retalis")

SUBSCRIPTION = "retalis/+/events"
"""Topics of the events of robots."""

MAX_PAYLOAD_BYTES = 1_000_000
"""Maximum size of an event; larger ones are refused."""

MAX_REFUSED_BYTES = 1000
"""Maximum number of bytes of a refused event that the log contains."""

RETRY_SECONDS = 1.0
"""Time between two attempts to connect."""

Configure = Callable[[Any], None]
"""A function that configures a client of paho before it connects, for example with a password and certificates."""


class MqttBridge:
    """Writes the events that a broker receives to a log; see the module.

    Args:
        host: host of the broker.
        port: port of the broker.
        folder: folder of the log.
        client_id: name of the session, which no other client of the broker may have.
        max_bytes: maximum size of the log in bytes, see `LogWriter`.
        configure: configures the client.

    Attributes:
        event_count: number of events that were written.
        refused_count: number of events that were refused; the log has a line for each.

    Raises:
        UsageError: if another process writes the log, or paho is not installed or too old.
        OSError: if the log cannot be opened.
    """

    def __init__(
        self,
        host: str,
        port: int,
        folder: Path,
        client_id: str = "retalis-fleet",
        max_bytes: Optional[int] = None,
        configure: Configure = lambda client: None,
    ):
        self._address = host, port
        self._writer = LogWriter(folder, max_bytes)
        self._messages: List[Any] = []
        self.event_count = self.refused_count = 0
        self._client = create_client(client_id, clean_session=False, manual_ack=True)
        self._client.on_connect = self._subscribe
        self._client.on_message = lambda client, data, message: self._messages.append(message)
        configure(self._client)

    def run(self, must_stop: Callable[[], bool] = lambda: False) -> None:
        """Write events until a function returns true; a broken connection is opened again.

        Raises:
            OSError: if the log cannot be written: the events since then stay in the broker.
        """
        is_connected = False
        while not must_stop():
            if not is_connected:
                is_connected = self._connect()
            # The messages of one read of the socket share a synchronization with the disk.
            elif self._client.loop(timeout=RETRY_SECONDS) == 0:
                self._write()
            else:
                log.warning("MQTT: the connection to %s:%s ended", *self._address)
                self._messages.clear()
                is_connected = False
                # A broker that refuses the bridge ends each connection at once.
                time.sleep(RETRY_SECONDS)
        self._client.disconnect()
        self._writer.close()

    def _connect(self) -> bool:
        host, port = self._address
        try:
            self._client.connect(host, port, keepalive=20)
        except OSError as error:
            log.warning("MQTT: no connection to %s:%s: %s", host, port, error)
            time.sleep(RETRY_SECONDS)
            return False
        return True

    def _subscribe(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            log.error("MQTT: the broker refused the connection: %s", reason)
        else:
            client.subscribe(SUBSCRIPTION, qos=1)

    def _write(self) -> None:
        messages, self._messages = self._messages, []
        if not messages:
            return
        lines = []
        for message in messages:
            line, is_event = read_payload(message.topic, message.payload)
            lines.append(line)
            self.event_count += is_event
            self.refused_count += not is_event
        self._writer.append(lines)
        for message in messages:
            self._client.ack(message.mid, message.qos)


def read_payload(topic: str, payload: bytes) -> Tuple[str, bool]:
    """Return the line for a message, and whether it is an event; otherwise the line contains the reason.

    A robot can send events of its own topic only, so that access lists of the broker for topics hold for robots.

    >>> read_payload("retalis/r07/events", b'{"robot": "r07", "time": 1}')
    ('{"robot": "r07", "time": 1}', True)
    >>> read_payload("retalis/r07/events", b'{"robot": "r08", "time": 1}')[1]
    False
    """
    first, _, rest = topic.partition("/")
    name, _, last = rest.partition("/")
    if (first, last) != ("retalis", "events"):
        return _refuse(topic, payload, "the topic is not that of a robot")
    if len(payload) > MAX_PAYLOAD_BYTES:
        return _refuse(topic, payload, f"{len(payload)} bytes: expected {MAX_PAYLOAD_BYTES} at most")
    try:
        text = payload.decode()
        fields = json.loads(text)
    except (RecursionError, ValueError) as error:
        return _refuse(topic, payload, f"no JSON: {error}")
    robot = fields.get("robot") if isinstance(fields, dict) else None
    if robot != name or "refused" in fields:
        return _refuse(topic, payload, f"expected an event of robot {quote_shortened(name)}")
    # A newline between two tokens of JSON is white space.
    return text.replace("\n", " "), True


def _refuse(topic: str, payload: bytes, reason: str) -> Tuple[str, bool]:
    text = payload[:MAX_REFUSED_BYTES].decode("utf-8", "backslashreplace")
    return json.dumps({"refused": f"topic {quote_shortened(topic)}: {reason}", "payload": text}), False
