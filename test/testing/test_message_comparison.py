"""Comparison of published messages with expected slots."""

from typing import Any, Mapping, Optional

import pytest

from retalis import Definitions
from retalis.foundation.source_places import Place
from retalis.testing.case_definition import Tolerance
from retalis.testing.message_comparison import SlotComparison
from retalis.testing.yaml_documents import CaseFileError, parse_yaml

START = 1_000_000_000 * 10**9
EXACT = Tolerance()


def find_difference(
    definitions: Definitions,
    type_name: str,
    expected: str,
    actual: Mapping[str, Any],
    tolerance: Tolerance = EXACT,
) -> Optional[str]:
    comparison = SlotComparison(tolerance, {}, START)
    return comparison.find_difference(
        definitions.find(type_name), parse_yaml(expected, "mine_test.yaml"), actual
    )


@pytest.mark.parametrize(
    ("expected", "time", "is_equal"),
    [
        ("{secs: 1000000001, nsecs: 0}", START + 10**9, True),
        ("{secs: 1000000001, nsecs: 0}", START + 10**9 + 1, False),
        ("{secs: 1000000001}", START + 10**9, True),
        ("{nsecs: 5, secs: 1000000001}", START + 10**9 + 5, True),
        ("1.5", START + 1_500_000_000, True),
        ("1.5", START + 1_500_100_000, False),
    ],
)
def test_times(expected: str, time: int, is_equal: bool, definitions: Definitions) -> None:
    difference = find_difference(definitions, "std_msgs/Time", f"data: {expected}", {"data": time})
    assert (difference is None) is is_equal


def test_tolerance_of_times_is_in_seconds(definitions: Definitions) -> None:
    actual = {"data": START + 1_400_000_000}
    for absolute, is_equal in ((0.5, True), (0.3, False)):
        tolerance = Tolerance(absolute=absolute)
        expected = "data: {secs: 1000000001, nsecs: 0}"
        assert (
            find_difference(definitions, "std_msgs/Time", expected, actual, tolerance) is None
        ) is is_equal


@pytest.mark.parametrize(
    ("expected", "actual", "is_equal"),
    [
        (".inf", float("inf"), True),
        (".nan", float("nan"), True),
        (".nan", 1.0, False),
        ("0.1", 0.10000000149011612, True),
        ("_", 5.0, True),
        ("0.2", 0.1, False),
    ],
)
def test_numbers_of_single_precision(
    expected: str, actual: float, is_equal: bool, definitions: Definitions
) -> None:
    difference = find_difference(definitions, "std_msgs/Float32", f"data: {expected}", {"data": actual})
    assert (difference is None) is is_equal


def test_nested_slot_is_named_by_its_path(definitions: Definitions) -> None:
    actual = {"header": {}, "point": {"x": 1.0, "y": 2.0, "z": 0.0}}
    expected = "point: {x: 1, y: 3}"
    difference = find_difference(definitions, "geometry_msgs/PointStamped", expected, actual)
    assert difference == "point.y is 2.0, expected 3"


def test_number_of_elements_differs(definitions: Definitions) -> None:
    difference = find_difference(definitions, "sensor_msgs/LaserScan", "ranges: [1]", {"ranges": [1.0, 2.0]})
    assert difference == "ranges has 2 elements, expected 1"


def test_unknown_slot_is_an_error(definitions: Definitions) -> None:
    with pytest.raises(CaseFileError, match="std_msgs/Bool has no slot daat; did you mean data?"):
        find_difference(definitions, "std_msgs/Bool", "daat: true", {"data": True})


@pytest.mark.parametrize(
    ("expected", "error"),
    [
        ("{position: {z: 1}, orientaton: {}}", "geometry_msgs/Pose has no slot orientaton; did you mean"),
        ("{position: {q: 1}}", "geometry_msgs/Point has no slot q"),
    ],
)
def test_unknown_slot_is_an_error_without_message(
    expected: str, error: str, definitions: Definitions
) -> None:
    comparison = SlotComparison(EXACT, {}, START)
    pose = definitions.find("geometry_msgs/Pose")
    comparison.check_names(pose, parse_yaml("{position: {x: 1, y: _}, orientation: _}", "mine_test.yaml"))
    with pytest.raises(CaseFileError, match=error):
        comparison.check_names(pose, parse_yaml(expected, "mine_test.yaml"))


def test_tolerance_of_unknown_slot_is_an_error(definitions: Definitions) -> None:
    pose = definitions.find("geometry_msgs/PoseWithCovariance")
    place = Place("mine_test.yaml", 3, 1, "")
    known = {"pose.position.x": EXACT, "covariance.0": EXACT, "covariance": EXACT, "pose": EXACT}
    SlotComparison(EXACT, known, START).check_tolerance_paths(pose, place)
    for path in ("pose.positon.x", "pose.position.x.y", "pos"):
        with pytest.raises(CaseFileError, match=f"has no slot {path}"):
            SlotComparison(EXACT, {path: EXACT}, START).check_tolerance_paths(pose, place)


@pytest.mark.parametrize(
    ("level", "difference"),
    [("ERROR", None), ("WARN", "level is 2, expected WARN"), ("1", "level is 2, expected 1")],
)
def test_constant_of_message_is_its_value(
    level: str, difference: Optional[str], definitions: Definitions
) -> None:
    status = "diagnostic_msgs/DiagnosticStatus"
    assert find_difference(definitions, status, f"level: {level}", {"level": 2}) == difference


def test_unknown_constant_has_similar_name(definitions: Definitions) -> None:
    with pytest.raises(CaseFileError, match="found 'ERRO'; did you mean ERROR?"):
        find_difference(definitions, "diagnostic_msgs/DiagnosticStatus", "level: ERRO", {"level": 2})
