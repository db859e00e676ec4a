"""Programs with plain strings in the nodes of ROS 1."""

from pathlib import Path
from typing import Any

import pytest

PUB_SUB = """\
<publish_subscribe strings="plain">
  <subscribe_to name="names" msg_type="std_msgs/String"/>
  <publish_to name="greetings" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = """\
compile_event_file('rules.txt')
subscribe(greeting(Text), [], std_msgs__0__String(Text), greetings, s1)
"""
RULES = """\
greeting('hello there') <- std_msgs__0__String(anna).
greeting(Text) <- std_msgs__0__String('"bob"') where string_concat("bye ", bob, Text).
"""
PEER = """\
import rospy
from std_msgs.msg import String

rospy.init_node("peer")
names = rospy.Publisher("names", String, queue_size=10)
received = []
rospy.Subscriber("greetings", String, lambda message: received.append(message.data))
for name in ("anna", '"bob"'):
    count = len(received)
    while len(received) == count and not rospy.is_shutdown():
        names.publish(name)
        rospy.sleep(0.2)
    received.append("")
print(sorted(set(received)))
"""


@pytest.mark.parametrize("direct", ["auto", "false"])
def test_strings_have_no_quotes_inside(devel: Any, tmp_path: Path, direct: str) -> None:
    """With ``direct:=false``, messages and outputs pass as text between the two nodes."""
    (tmp_path / "pub_sub.xml").write_text(PUB_SUB)
    (tmp_path / "goalPredicates.txt").write_text(GOALS)
    (tmp_path / "rules.txt").write_text(RULES)
    (tmp_path / "peer.py").write_text(PEER)
    devel.start_master()
    options = [f"program:={tmp_path}", f"direct:={direct}", "use_sim_time:=false"]
    devel.start("roslaunch", "retalis", "retalis.launch", *options)
    devel.expect(lambda nodes, services: "/retalis/reload" in services)
    printed = devel.run("python3", str(tmp_path / "peer.py"))
    assert printed.strip() == "['', 'bye bob', 'hello there']"
    assert "ERROR" not in devel.printed()
