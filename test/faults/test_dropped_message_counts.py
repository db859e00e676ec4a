"""Counts of dropped messages in the diagnostics of two nodes."""

from typing import Any, Tuple

import pytest
from faults.dropped_message_counts import Drop, Drops


def topic(name: str, dropped: int = 0, refused: int = 0) -> Tuple[Any, ...]:
    return name, [("messages", "100"), ("dropped", str(dropped)), ("refused", str(refused))]


@pytest.fixture
def drops() -> Drops:
    drops = Drops()
    drops.add(5.0, 3.0, [topic("retalis: input /tf")])
    drops.add(10.0, 8.0, [topic("retalis: input /tf")])
    return drops


def test_constant_counters_are_no_drop(drops: Drops) -> None:
    assert drops.growths == []
    assert drops.total == 0
    assert drops.report_counts == {"retalis": 2}


def test_growth_begins_at_previous_report(drops: Drops) -> None:
    drops.add(15.0, 13.0, [topic("retalis: input /tf", dropped=3)])
    drops.add(20.0, 18.0, [topic("retalis: input /tf", dropped=3)])
    drops.add(25.0, 23.0, [topic("retalis: input /tf", dropped=4, refused=2)])
    assert drops.growths == [
        Drop("retalis: input /tf", 3, 8.0, 15.0),
        Drop("retalis: input /tf", 1, 18.0, 25.0),
        Drop("retalis: input /tf", 2, 18.0, 25.0),
    ]
    assert drops.total == 6


def test_growth_of_first_report_begins_at_start() -> None:
    drops = Drops()
    drops.add(7.0, 5.0, [("retalis: queue", [("dropped events", "12"), ("queued events", "3 of 5000")])])
    assert drops.growths == [Drop("retalis: queue", 12, 0.0, 7.0)]


def test_restarted_node_counts_from_zero(drops: Drops) -> None:
    drops.add(15.0, 13.0, [topic("retalis: input /tf", dropped=9)])
    drops.add(20.0, 18.0, [topic("retalis: input /tf", dropped=2)])
    drops.add(25.0, 23.0, [topic("retalis: input /tf", dropped=2)])
    assert [drop.number for drop in drops.growths] == [9, 2]


def test_each_node_has_own_reports(drops: Drops) -> None:
    drops.add(12.0, 10.0, [("retalis_ros_interface: output /retalisInputEvents", [("dropped", "0")])])
    drops.add(17.0, 15.0, [("retalis_ros_interface: output /retalisInputEvents", [("dropped", "1")])])
    assert [(drop.number, drop.first, drop.last) for drop in drops.growths] == [(1, 10.0, 17.0)]
    assert drops.report_counts == {"retalis": 2, "retalis_ros_interface": 2}


@pytest.mark.parametrize("name", ["/camera", "/input_key7"])
def test_unneeded_topics_are_ignored(drops: Drops, name: str) -> None:
    drops.add(15.0, 13.0, [topic(f"retalis_ros_interface: input {name}", dropped=5, refused=5)])
    assert drops.total == 0
