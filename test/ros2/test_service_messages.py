"""Conversion of requests and responses."""

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")

from builtin_interfaces.msg import Time

from retalis.ros2.installed_interfaces import fill_message


@pytest.mark.parametrize(
    ("instant", "seconds", "nanoseconds"),
    [
        (1_500_000_000, 1, 500_000_000),
        (1 << 62, (1 << 31) - 1, 999_999_999),
        (-(1 << 62), -(1 << 31), 0),
    ],
)
def test_time_out_of_range_becomes_nearest_one(instant: int, seconds: int, nanoseconds: int) -> None:
    class Response:
        stamp = Time()

        @staticmethod
        def get_fields_and_field_types() -> object:
            return {"stamp": "builtin_interfaces/Time"}

    response = fill_message(Response(), {"stamp": instant})
    assert (response.stamp.sec, response.stamp.nanosec) == (seconds, nanoseconds)
