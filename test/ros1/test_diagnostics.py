"""Publishing of ``/diagnostics``."""

import re
import sys
import threading

import pytest
import rospy
import yaml

from retalis.ros1 import diagnostics
from retalis.ros1.diagnostics import Diagnostics, Health, Level, NodeHealth

HEALTH = NodeHealth(list, list, lambda: [Health("queue", Level.WARN, "two\nlines", [("a", "\x1b[31m")])])


@pytest.fixture
def published(monkeypatch):
    """Return what is published, and the publishers that were made."""
    made, messages = [], []

    class Publisher:
        def __init__(self, topic, kind, queue_size):
            made.append(topic)

        def publish(self, message):
            messages.append(message)
            come.set()

    come = threading.Event()
    monkeypatch.setattr(rospy, "Publisher", Publisher)
    monkeypatch.setattr(rospy, "on_shutdown", lambda work: made.append(work))
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time(1, 2))
    monkeypatch.setattr(rospy, "get_name", lambda: "/ns/retalis")
    return made, messages, come


def test_each_thing_is_a_status_of_the_node(published):
    made, messages, come = published
    Diagnostics(0.001, HEALTH)
    assert come.wait(60)
    made[1]()  # as at shutdown
    status = messages[0].status[0]
    assert made[0] == "/diagnostics" and messages[0].header.stamp == rospy.Time(1, 2)
    assert (status.name, status.level, status.message) == ("ns/retalis: queue", 1, "two lines")
    assert [(one.key, one.value) for one in status.values] == [("a", "\\x1b[31m")]
    assert [one.name for one in messages[0].status] == ["ns/retalis: queue", "ns/retalis: process memory"]


def test_it_may_be_off(published):
    Diagnostics(None, HEALTH)
    assert published[0] == []


def test_a_node_without_the_package_warns_once_and_goes_on(published, monkeypatch):
    told = []
    monkeypatch.setitem(sys.modules, "diagnostic_msgs", None)
    monkeypatch.setattr(rospy, "logwarn", lambda text, *values: told.append(text % values))
    Diagnostics(1.0, HEALTH)
    assert told == ["/diagnostics is not published: the package diagnostic_msgs is not installed"]
    assert published[0] == []


def test_a_fault_of_one_look_does_not_end_it(published, monkeypatch):
    _, _, come = published
    looks, told = [], []

    def look():
        looks.append(1)
        if len(looks) == 1:
            raise RuntimeError("changed size during iteration")
        return []

    monkeypatch.setattr(rospy, "logerr_throttle", lambda period, text: told.append(text))
    Diagnostics(0.001, NodeHealth(list, list, look))
    assert come.wait(60)
    published[0][1]()
    assert "changed size" in told[0]
    assert diagnostics.DIAGNOSTICS_TOPIC == "/diagnostics"


def test_the_hardware_id_is_the_one_that_is_given(published):
    _, messages, come = published
    Diagnostics(0.001, HEALTH, "robot7")
    assert come.wait(60)
    published[0][1]()
    assert {one.hardware_id for one in messages[0].status} == {"robot7"}


def statuses(space, arrays=6):
    """Return the newest level of each status, and the hardware ids, of some messages."""
    found = list(yaml.safe_load_all(space.run("rostopic", "echo", "-n", str(arrays), "/diagnostics")))
    told = [one for array in found if array for one in array["status"]]
    return {one["name"]: one["level"] for one in told}, {one["hardware_id"] for one in told}


@pytest.mark.parametrize("embedded", ["false", "true"])
def test_a_node_is_green_by_default_and_yellow_if_the_program_misses_something(devel, tmp_path, embedded):
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text("<publish_subscribe/>")
    (program / "goalPredicates.txt").write_text("true\n")
    devel.start_master()
    options = (f"program:={program}", f"embedded:={embedded}", "use_sim_time:=false", "diagnostics:=0.2")
    devel.start(
        "roslaunch", "-p", str(devel.port), "retalis", "retalis.launch", *options, "hardware_id:=robot7"
    )
    nodes = {"/retalis"} if embedded == "true" else {"/retalis", "/retalis_ros_interface"}
    devel.expect(lambda found, services: nodes <= found and "/retalis/list" in services)
    levels, hardware = statuses(devel)
    assert {"retalis: input /tf", "retalis: input /retalisInputEvents"} <= levels.keys()
    assert {name: level for name, level in levels.items() if level} == {}
    assert hardware == {"robot7"}

    # From now on the program reads tf, and has a rule whose events nothing makes, which is a warning in the log.
    devel.run("rosservice", "call", "/retalis/add_rule", "{rule: 'moved <- tf__0__tfMessage(_)', label: ''}")
    devel.run("rosservice", "call", "/add_memory", "{event: lost(X), format: _, id: lost, size: '5'}")
    levels, _ = statuses(devel)
    assert levels["retalis: input /tf"] == 1
    assert levels["retalis: input /ar_pose_marker"] == 0
    (warnings,) = re.findall(r"(?m)^warnings: (\d+)$", devel.run("rosservice", "call", "/retalis/list", "0"))
    assert int(warnings) == devel.printed().count("[WARN]") > 0
