"""A pytest plugin that runs the tests in a random order, so that a test that depends on others is noticed.

The modules are shuffled, the classes in each of them, and the tests in each of these: a fixture of a module or a
class is set up once. The place of a test depends on its name and the seed alone. With the same seed, a part of the
tests therefore has the order that it has among all of them.
"""

import hashlib
import os
import random
from typing import Any, Dict, List

import pytest

SEED_VARIABLE = "RETALIS_ORDER_SEED"
"""Environment variable with the seed; a run without it chooses one and prints it."""


def format_seed() -> str:
    return f"random order of tests: {SEED_VARIABLE}={os.environ[SEED_VARIABLE]} repeats it"


def pytest_configure() -> None:
    # The processes of pytest-xdist inherit the variable: all of them need the same order.
    os.environ.setdefault(SEED_VARIABLE, str(random.SystemRandom().randrange(1_000_000)))


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session: Any) -> None:
    # The option -q omits what `pytest_report_header` returns. Processes of pytest-xdist have no reporter.
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None:
        reporter.write_line(format_seed())


def pytest_terminal_summary(terminalreporter: Any, exitstatus: Any) -> None:
    # Again where tests have failed: a log may be cut to its end.
    if exitstatus == pytest.ExitCode.TESTS_FAILED:
        terminalreporter.write_line(format_seed())


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: Any) -> None:
    """Shuffle the tests; pytest itself then groups those that share a fixture of a module with parameters."""
    seed = os.environ[SEED_VARIABLE]
    ranks: Dict[Any, Any] = {}

    def rank(node: Any) -> Any:
        if node not in ranks:
            ranks[node] = hashlib.sha256(f"{seed} {node.nodeid}".encode()).digest()
        return ranks[node]

    def place(item: Any) -> List[Any]:
        return [
            rank(node)
            for node in item.listchain()
            if isinstance(node, (pytest.Module, pytest.Class, pytest.Item))
        ]

    items.sort(key=place)
