"""Forwarding of a node of ROS 2 that is killed."""

from pathlib import Path
from typing import Any, Iterator

import pytest
from forwarding.mosquitto import NEEDS_BROKER, Broker

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("paho.mqtt.client", reason="needs paho-mqtt")

from ros2.rclpy_nodes import Network, wait_until
from std_msgs.msg import String

pytestmark = [pytest.mark.slow, NEEDS_BROKER]


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    broker = Broker(tmp_path)
    yield broker
    broker.close()


def test_restarted_node_sends_stored_events(
    network: Network, start_node: Any, tmp_path: Path, broker: Broker
) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="words" msg_type="std_msgs/String" event="word"/></publish_subscribe>'
    )
    (program / "goalPredicates.txt").write_text("subscribe(word(_), [], _, fleet, w)\n")
    parameters = {
        "program": program,
        "forward": broker.url,
        "forward_topics": "[fleet]",
        "forward_robot": "r07",
        "forward_queue": tmp_path / "queue.db",
    }
    arguments = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    publisher = network.add_node("peer").create_publisher(String, "words", 10)
    node = start_node(*arguments)
    wait_until(publisher.get_subscription_count)
    publisher.publish(String(data="a"))
    # The process has locked the file.
    wait_until(lambda: any(b"word(" in path.read_bytes() for path in tmp_path.glob("queue.db*")))
    node.kill()
    node = start_node(*arguments)
    broker.start()
    subscriber = broker.subscribe()
    subscriber.wait_for(1)
    (event,) = subscriber.events
    assert (event["robot"], event["id"], event["event"]) == ("r07", 1, "word('\"a\"')")
    assert node.interrupt() == 0
    assert "Traceback" not in node.log()
