"""Fixtures of the tests on ROS 2: nodes of rclpy in a domain of their own.

The tests are skipped where rclpy, or the generated classes of this package, are not installed.
"""

import fcntl
import itertools
import os
import socket
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Callable, Iterator, List

import pytest
from ros2.node_processes import NodeProcess

import retalis

FIRST_PORT, PORTS_PER_DOMAIN, MAX_DOMAIN = 7400, 250, 100
"""UDP ports of DDS: those of a domain begin at FIRST_PORT + PORTS_PER_DOMAIN * domain."""


_domain_numbers = itertools.count(os.getpid())
"""Each test has another domain: a participant that has the identity of an ended one is not discovered for a while."""


def add_generated_classes() -> None:
    """Extend the package of the sources by the generated classes of an installation."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        for folder in Path(prefix).glob("lib/python3*/site-packages/retalis"):
            if str(folder) not in retalis.__path__:
                retalis.__path__.append(str(folder))


add_generated_classes()


def is_unused(domain: int) -> bool:
    """Return whether no process on this machine takes part in a domain."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", FIRST_PORT + PORTS_PER_DOMAIN * domain + 10))
        except OSError:
            return False
    return True


@contextmanager
def reserve_domain() -> Iterator[int]:
    """Reserve an unused domain, also from other processes that run tests at the same time."""
    for _ in range(MAX_DOMAIN):
        domain = 1 + next(_domain_numbers) % MAX_DOMAIN
        with (Path(tempfile.gettempdir()) / f"retalis_test_domain_{domain}.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            if is_unused(domain):
                yield domain
                return
    pytest.fail("all domains are in use")


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Return an unused domain, which the processes of the test use, on this machine only."""
    with reserve_domain() as unused:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(unused))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")  # Humble
        yield unused


@pytest.fixture
def network(domain: int) -> Iterator[Any]:
    """Return a network for the nodes of a test."""
    from ros2.rclpy_nodes import Network  # noqa: PLC0415 - rclpy is optional

    network = Network()
    yield network
    network.close()


@pytest.fixture
def long_discovery(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands of this process wait for a node on a busy machine; its discovery ends the wait."""
    from retalis.ros2 import rclpy_client  # noqa: PLC0415 - rclpy is optional

    monkeypatch.setattr(rclpy_client, "DISCOVERY_SECONDS", 120.0)


@pytest.fixture
def start_node(domain: int, tmp_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Return a function that starts the installed node with arguments for ROS."""
    started: List[NodeProcess] = []

    def start(*arguments: str) -> NodeProcess:
        started.append(NodeProcess(tmp_path / f"{len(started)}.log", *arguments))
        return started[-1]

    yield start
    for node in started:
        node.kill()
