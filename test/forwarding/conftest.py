"""Fixtures of the tests of forwarding."""

from pathlib import Path
from typing import Any, Iterator

import pytest
from forwarding.mosquitto import Broker, Relay

from retalis import Reports
from retalis.forwarding.event_forwarder import EventForwarder
from retalis.forwarding.forwarding_options import ForwardingOptions, read_broker


@pytest.fixture
def create_broker(tmp_path: Path) -> Iterator[Any]:
    """Return a function that creates a broker with lines of its configuration."""
    brokers = []

    def create(*lines: str, **arguments: Any) -> Broker:
        brokers.append(Broker(tmp_path, *lines, **arguments))
        return brokers[-1]

    yield create
    for broker in brokers:
        broker.close()


@pytest.fixture
def broker(create_broker: Any) -> Broker:
    """Return a running broker."""
    broker: Broker = create_broker()
    broker.start()
    return broker


@pytest.fixture
def relay(broker: Broker) -> Iterator[Relay]:
    """Return a relay to the broker."""
    relay = Relay(broker)
    yield relay
    relay.close()


@pytest.fixture
def forward(tmp_path: Path) -> Iterator[Any]:
    """Return a function that creates a forwarder to a broker of a URL."""
    forwarders = []

    def forward(url: str, queue: Any = None, max_bytes: int = 10_000_000, **login: Any) -> EventForwarder:
        pytest.importorskip("paho.mqtt.client", reason="needs paho-mqtt")
        options = ForwardingOptions(
            broker=read_broker(url)._replace(**login),
            robot="r07",
            topics=("*",),
            queue=queue or tmp_path / "queue.db",
            max_bytes=max_bytes,
        )
        forwarders.append(EventForwarder(options, Reports()))
        return forwarders[-1]

    yield forward
    for forwarder in forwarders:
        forwarder.stop()
