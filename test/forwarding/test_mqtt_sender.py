"""The client of MQTT: versions of paho, and errors that say how to install it."""

import sys
from types import ModuleType
from typing import Any, Tuple

import pytest

from retalis import UsageError
from retalis.forwarding.mqtt_sender import OLDEST_PAHO, OLDEST_PAHO_WITH_MANUAL_ACK, import_paho


@pytest.fixture(autouse=True)
def _virtual_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let hints name pip; for the Python of Debian they name apt."""
    monkeypatch.setattr(sys, "prefix", "/opt/environment")


def install_paho(monkeypatch: pytest.MonkeyPatch, version: str) -> Any:
    """Install a package with a version; return its client module."""
    modules = [ModuleType(name) for name in ("paho", "paho.mqtt", "paho.mqtt.client")]
    paho, mqtt, client = modules
    paho.mqtt, mqtt.client, mqtt.__version__ = mqtt, client, version  # type: ignore[attr-defined]
    for module in modules:
        monkeypatch.setitem(sys.modules, module.__name__, module)
    return client


@pytest.mark.parametrize("version", ["1.6.1", "2.1.0", "10.0.0rc1"])
def test_supported_version_is_imported(monkeypatch: pytest.MonkeyPatch, version: str) -> None:
    client = install_paho(monkeypatch, version)
    assert import_paho() is client


@pytest.mark.parametrize(
    ("version", "oldest", "needed"),
    [("1.5.1", OLDEST_PAHO, "1.6"), ("1.6.1", OLDEST_PAHO_WITH_MANUAL_ACK, "2.0")],
)
def test_older_version_is_an_error(
    monkeypatch: pytest.MonkeyPatch, version: str, oldest: Tuple[int, int], needed: str
) -> None:
    install_paho(monkeypatch, version)
    with pytest.raises(UsageError) as error:
        import_paho(oldest)
    assert str(error.value) == (
        f"MQTT needs the Python package paho-mqtt {needed} or later: {version} is installed: "
        f"pip install 'paho-mqtt>={needed}'"
    )


def test_missing_package_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "paho", None)
    with pytest.raises(
        UsageError, match=r"^MQTT needs the Python package paho-mqtt 1\.6 or later: .*paho.*: pip "
    ):
        import_paho()
