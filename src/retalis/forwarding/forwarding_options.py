"""Options of forwarding: the broker, the robot, the topics and the queue."""

from pathlib import Path
from typing import NamedTuple, Optional, Tuple
from urllib.parse import urlsplit

from ..foundation.displayed_text import quote_shortened
from ..foundation.errors import UsageError

DEFAULT_QUEUE_MEGABYTES = 100
"""Default limit for the size of a queue."""

_PORTS = {"mqtt": 1883, "mqtts": 8883}
"""Default port of each scheme."""

_EXPECTED_BROKER = "expected mqtt://HOST, mqtt://USER@HOST:PORT, or mqtts:// for TLS"


class Broker(NamedTuple):
    """Address of a broker, and how to log in.

    Attributes:
        host: its name or address.
        port: its port.
        uses_tls: whether the connection is encrypted, and the certificate of the broker is checked.
        user: name of the user; None for an anonymous one.
        password: password of the user.
        ca_file: certificates of trusted authorities, in place of those of the system.
    """

    host: str
    port: int
    uses_tls: bool = False
    user: Optional[str] = None
    password: Optional[str] = None
    ca_file: Optional[Path] = None

    def __str__(self) -> str:
        """Return the address without the user."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'mqtts' if self.uses_tls else 'mqtt'}://{host}:{self.port}"


def read_broker(url: str) -> Broker:
    """Return the broker of a URL.

    >>> str(read_broker("mqtt://r07@fleet"))
    'mqtt://fleet:1883'

    Raises:
        UsageError: if it is not the URL of a broker, or has a password.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise UsageError(f"{quote_shortened(url)} is not the address of a broker: {error}") from error
    if parts.password is not None:
        # Command lines and parameters are visible to all users.
        raise UsageError(
            "a password in the address is visible to all users: write it into the file of forward_password"
        )
    if (
        parts.scheme not in _PORTS
        or not parts.hostname
        or parts.path.strip("/")
        or parts.query
        or parts.fragment
    ):
        raise UsageError(f"{quote_shortened(url)} is not the address of a broker: {_EXPECTED_BROKER}")
    return Broker(parts.hostname, port or _PORTS[parts.scheme], parts.scheme == "mqtts", parts.username)


def is_robot_name(name: str) -> bool:
    """Return whether a text can be a level of a topic of MQTT, and is readable."""
    return 0 < len(name) <= 100 and name.isprintable() and not any(sign in name for sign in " /+#")


class ForwardingOptions(NamedTuple):
    """Destination and queue of forwarded events.

    Attributes:
        broker: the broker.
        robot: name of the robot.
        topics: topics of the subscriptions whose events are forwarded; ``*`` stands for any text.
        queue: file of the queue.
        max_bytes: limit for the size of the file.
    """

    broker: Broker
    robot: str
    topics: Tuple[str, ...]
    queue: Path
    max_bytes: int
