"""Addresses of brokers and names of robots."""

import pytest

from retalis import UsageError
from retalis.forwarding.forwarding_options import Broker, is_robot_name, read_broker


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("mqtt://fleet", Broker("fleet", 1883)),
        ("mqtts://r07@fleet.example/", Broker("fleet.example", 8883, True, "r07")),
        ("mqtt://[::1]:1900", Broker("::1", 1900)),
    ],
)
def test_address_of_broker_is_read(url: str, expected: Broker) -> None:
    assert read_broker(url) == expected


@pytest.mark.parametrize(
    ("url", "problem"),
    [
        ("fleet:1883", "expected mqtt://HOST"),
        ("http://fleet", "expected mqtt://HOST"),
        ("mqtt://", "expected mqtt://HOST"),
        ("mqtt://fleet/topic", "expected mqtt://HOST"),
        ("mqtt://fleet:99999", "Port out of range"),
        ("mqtt://r07:secret@fleet", "a password in the address is visible to all users"),
    ],
)
def test_wrong_address_is_refused(url: str, problem: str) -> None:
    with pytest.raises(UsageError, match=problem) as caught:
        read_broker(url)
    assert "secret" not in str(caught.value)


def test_name_of_robot_is_level_of_topic() -> None:
    assert is_robot_name("r07")
    assert not any(map(is_robot_name, ["", "a/b", "a b", "+", "#", "a\n", "x" * 101]))


def test_address_is_shown_without_user() -> None:
    assert str(read_broker("mqtts://r07@[::1]")) == "mqtts://[::1]:8883"
