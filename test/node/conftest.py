"""Fixtures of the tests of nodes."""

import pytest
from node.memory_transport import MemoryNetwork

from retalis import Reports


@pytest.fixture
def network() -> MemoryNetwork:
    return MemoryNetwork()


@pytest.fixture
def reports() -> Reports:
    return Reports()
