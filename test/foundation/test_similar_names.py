"""Similar names."""

import pytest

from retalis.foundation.similar_names import MAX_CANDIDATES, closest_name, did_you_mean


@pytest.mark.parametrize(
    ("name", "cutoff", "closest"),
    [("scna", 0.6, "scan"), ("scan", 0.6, "scan"), ("scna", 0.9, ""), ("odometry", 0.6, "")],
)
def test_closest_name_is_similar_enough(name: str, cutoff: float, closest: str) -> None:
    assert closest_name(name, ["pose", "scan", "imu"], cutoff) == closest


def test_hint_is_empty_without_similar_name() -> None:
    assert (did_you_mean("scna", ["scan"]), did_you_mean("scna", [])) == ("; did you mean scan?", "")


def test_number_of_candidates_is_bounded() -> None:
    names = (f"name{number}" for number in range(10 * MAX_CANDIDATES))
    assert closest_name("unlike", [f"{number}" for number in range(MAX_CANDIDATES)] + ["unlike"]) == ""
    assert closest_name("name7", names) == "name7"
