"""What is counted as dropped, from what two nodes tell."""

import pytest
from faults.dropped_messages import Drop, Drops


def topic(name, dropped=0, refused=0):
    return name, [("messages", "100"), ("dropped", str(dropped)), ("refused", str(refused))]


@pytest.fixture
def drops():
    found = Drops()
    found.take(5.0, 3.0, [topic("retalis: input /tf")])
    found.take(10.0, 8.0, [topic("retalis: input /tf")])
    return found


def test_nothing_is_dropped(drops):
    assert drops.found == []
    assert drops.total == 0
    assert drops.looks == {"retalis": 2}


def test_a_growth_counts_since_what_had_come_through_at_the_last_look(drops):
    drops.take(15.0, 13.0, [topic("retalis: input /tf", dropped=3)])
    drops.take(20.0, 18.0, [topic("retalis: input /tf", dropped=3)])
    drops.take(25.0, 23.0, [topic("retalis: input /tf", dropped=4, refused=2)])
    assert drops.found == [
        Drop("retalis: input /tf", 3, 8.0, 15.0),
        Drop("retalis: input /tf", 1, 18.0, 25.0),
        Drop("retalis: input /tf", 2, 18.0, 25.0),
    ]
    assert drops.total == 6


def test_what_is_dropped_before_the_first_look_counts_from_the_beginning():
    drops = Drops()
    drops.take(7.0, 5.0, [("retalis: queue", [("dropped events", "12"), ("queued events", "3 of 5000")])])
    assert drops.found == [Drop("retalis: queue", 12, 0.0, 7.0)]


def test_a_node_that_was_started_again_counts_from_zero(drops):
    drops.take(15.0, 13.0, [topic("retalis: input /tf", dropped=9)])
    drops.take(20.0, 18.0, [topic("retalis: input /tf", dropped=2)])
    drops.take(25.0, 23.0, [topic("retalis: input /tf", dropped=2)])
    assert [one.number for one in drops.found] == [9, 2]


def test_each_node_has_its_own_looks(drops):
    drops.take(12.0, 10.0, [("retalis_ros_interface: output /retalisInputEvents", [("dropped", "0")])])
    drops.take(17.0, 15.0, [("retalis_ros_interface: output /retalisInputEvents", [("dropped", "1")])])
    assert [(one.number, one.first, one.last) for one in drops.found] == [(1, 10.0, 17.0)]
    assert drops.looks == {"retalis": 2, "retalis_ros_interface": 1 + 1}


@pytest.mark.parametrize("name", ["/camera", "/input_key7"])
def test_topics_that_no_pose_needs_do_not_count(drops, name):
    drops.take(15.0, 13.0, [topic(f"retalis_ros_interface: input {name}", dropped=5, refused=5)])
    assert drops.total == 0
