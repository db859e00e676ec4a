"""Settings of an engine: checks of their values."""

import math
from typing import Any

import pytest

from retalis import Engine, Settings, UsageError


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("queue", -1, "settings: queue: expected a whole number from 0 to 1e+20, found -1"),
        ("watchdog", math.nan, "settings: watchdog: expected a number from 0 to 1e+09, found nan"),
        ("tf_cache", "10", "settings: tf_cache: expected a number from 0 to 1e+09, found \"'10'\""),
        ("strings", "zzz", "settings: strings: expected quoted or plain, found 'zzz'"),
    ],
)
def test_invalid_setting_is_refused(name: str, value: Any, problem: str) -> None:
    settings = Settings()._replace(**{name: value})
    with pytest.raises(UsageError) as raised:
        Engine(settings=settings)
    assert str(raised.value) == problem
    with pytest.raises(UsageError) as raised:
        Engine().change_settings(settings)
    assert str(raised.value) == problem
