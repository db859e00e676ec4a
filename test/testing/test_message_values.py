"""Messages in test files: slots, times, and errors."""

from typing import Any

import pytest

from retalis import Definitions
from retalis.foundation.source_places import Place
from retalis.messages.message_dictionaries import read_message_term
from retalis.testing.case_definition import CaseMessage
from retalis.testing.message_values import make_input_message
from retalis.testing.yaml_documents import CaseFileError, parse_yaml

NOW = 1_500_000_000_250_000_000


def encode(type_name: str, text: str, definitions: Definitions) -> Any:
    """Return the slots of a message after it was encoded and decoded."""
    definition = definitions.find(type_name)
    value = parse_yaml(text, "mine_test.yaml") if text else None
    message = CaseMessage(0, "/topic", None, value, Place("mine_test.yaml", 1, 1))
    data = make_input_message(message, definition, definitions, NOW)
    return read_message_term(definition, definitions.decoder(definition).decode(data))


def test_omitted_slots_are_zero(definitions: Definitions) -> None:
    assert encode("geometry_msgs/Point", "y: 2", definitions) == {"x": 0.0, "y": 2.0, "z": 0.0}
    assert encode("geometry_msgs/Point", "", definitions) == {"x": 0.0, "y": 0.0, "z": 0.0}


@pytest.mark.parametrize(
    ("stamp", "expected"),
    [
        ("{secs: 5, nsecs: 6}", 5_000_000_006),
        ("{sec: 5, nanosec: 6}", 5_000_000_006),
        ("{sec: 5}", 5_000_000_000),
        ("5.5", 5_500_000_000),
        ("now", NOW),
    ],
)
def test_stamp_forms(stamp: str, expected: int, definitions: Definitions) -> None:
    message = encode("geometry_msgs/PointStamped", f"header: {{stamp: {stamp}, frame_id: map}}", definitions)
    assert (message["header"]["stamp"], message["header"]["frame_id"]) == (expected, "map")


@pytest.mark.parametrize("header", ["", "header: auto", "header: {frame_id: map}"])
def test_header_without_stamp_has_time_of_message(header: str, definitions: Definitions) -> None:
    assert encode("geometry_msgs/PointStamped", header, definitions)["header"]["stamp"] == NOW


def test_constant_of_message_is_an_integer(definitions: Definitions) -> None:
    battery = "power_supply_status: POWER_SUPPLY_STATUS_DISCHARGING"
    assert encode("sensor_msgs/BatteryState", battery, definitions)["power_supply_status"] == 2


def test_arrays_and_bytes(definitions: Definitions) -> None:
    scan = encode("sensor_msgs/LaserScan", "ranges: [1, .inf, 2.5]", definitions)
    assert scan["ranges"] == [1.0, float("inf"), 2.5]
    image = encode("sensor_msgs/Image", "data: [1, 2, 255]", definitions)
    assert image["data"] == bytes((1, 2, 255))
    path = encode("nav_msgs/Path", "poses: [{pose: {position: {x: 1}}}, {}]", definitions)
    assert [pose["pose"]["position"]["x"] for pose in path["poses"]] == [1.0, 0.0]


@pytest.mark.parametrize(
    ("type_name", "text", "error"),
    [
        ("geometry_msgs/Point", "w: 1", "geometry_msgs/Point has no slot w"),
        ("sensor_msgs/LaserScan", "rangs: []", "sensor_msgs/LaserScan has no slot rangs; did you mean ranges?"),
        ("geometry_msgs/Point", "x: far", "x: expected a number, found 'far'"),
        ("std_msgs/Bool", "data: 1", "data: expected true or false, found '1'"),
        ("std_msgs/UInt8", "data: 256", "data: 256 is too large for uint8: expected at most 255"),
        ("std_msgs/UInt8", "data: -1", "data: -1 is too small: expected at least 0"),
        (
            "sensor_msgs/BatteryState",
            "power_supply_status: POWER_SUPPLY_STATUS_DISCHARGIN",
            "power_supply_status: expected an integer or the name of a constant of sensor_msgs/BatteryState, found "
            "'POWER_SUPPLY_STATUS_DISCHARGIN'; did you mean POWER_SUPPLY_STATUS_DISCHARGING?",
        ),
        ("std_msgs/UInt8", "data: FULL", "data: expected an integer, found 'FULL'"),
        ("std_msgs/String", "data: [a]", "data: expected a text, found a list of 1 value"),
        ("nav_msgs/Path", "poses: {}", "poses: expected a list, found a mapping of 0 keys"),
        ("geometry_msgs/PoseWithCovariance", "covariance: [1]", "covariance: float64[36] has 36 elements, not 1"),
        ("std_msgs/Time", "data: {hours: 1}", "data: expected {secs: S, nsecs: N}, a number of seconds, or now"),
    ],
)  # fmt: skip
def test_wrong_slot_is_an_error_at_its_place(
    type_name: str, text: str, error: str, definitions: Definitions
) -> None:
    with pytest.raises(CaseFileError) as raised:
        encode(type_name, text, definitions)
    assert raised.value.message == error
    assert raised.value.place is not None
    assert raised.value.place.source == "mine_test.yaml"
