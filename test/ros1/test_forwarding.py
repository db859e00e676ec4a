"""Forwarding of a node that the launch file starts, to a broker that starts later."""

from pathlib import Path
from typing import Any, Iterator

import pytest
import yaml
from forwarding.mosquitto import NEEDS_BROKER, Broker

pytestmark = [pytest.mark.slow, NEEDS_BROKER]


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    broker = Broker(tmp_path)
    yield broker
    broker.close()


def forwarding_status(devel: Any) -> Any:
    """Return the status of the forwarding in the next message of the node."""
    messages = yaml.safe_load_all(devel.run("rostopic", "echo", "-n", "4", "/diagnostics"))
    statuses = [status for message in messages if message for status in message["status"]]
    return next(status for status in statuses if status["name"] == "retalis: forwarding")


def test_outputs_wait_for_broker(devel: Any, tmp_path: Path, broker: Broker) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text("<publish_subscribe/>")
    (program / "goalPredicates.txt").write_text("subscribe(delivered(_), [], _, fleet, s)\n")
    devel.start_master()
    options = (f"program:={program}", "embedded:=true", "use_sim_time:=false", "diagnostics:=0.2")
    forwarding = (f"forward:={broker.url}", "forward_topics:=[fleet]", "forward_robot:=r07")
    queue = f"forward_queue:={tmp_path}/queue.db"
    devel.start("roslaunch", "-p", str(devel.port), "retalis", "retalis.launch", *options, *forwarding, queue)
    devel.expect(lambda nodes, services: "/retalis/list" in services or "paho-mqtt" in devel.printed())
    if "needs the Python package paho-mqtt" in devel.printed():
        pytest.skip("needs python3-paho-mqtt")
    devel.post_events("delivered(1)", "delivered(2)")
    devel.expect(lambda nodes, services: "2 events queued" in forwarding_status(devel)["message"])
    status = forwarding_status(devel)
    assert status["level"] == 1
    assert status["message"].endswith("Connection refused; 2 events queued")
    broker.start()
    subscriber = broker.subscribe()
    subscriber.wait_for(2)
    assert [event["event"] for event in subscriber.events] == ["delivered(1)", "delivered(2)"]
    assert [(event["robot"], event["id"]) for event in subscriber.events] == [("r07", 1), ("r07", 2)]
    # Topics that are forwarded need no type.
    assert "fleet" not in devel.printed()
