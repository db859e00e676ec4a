"""The scenarios on bags of ROS 1 and ROS 2, which rosbags writes."""

from pathlib import Path

import pytest

pytest.importorskip("rosbags")
from asserting_accessors import fail
from scenarios.scenario_runs import SCENARIOS, MessageCodec, Outputs, Scenario, collect_outputs, read_scenario

from retalis import Playback
from retalis.playback.bag_locations import MergedBag


def write_bag(path: Path, scenario: Scenario, codec: MessageCodec) -> None:
    """Write a bag with the messages of a scenario, and a message that nobody reads at its end."""
    rows = [
        (message.time, message.topic, codec.encode(message.fields, scenario.types[message.topic]))
        for message in scenario.messages
    ]
    types = {**scenario.types, "end": "std_msgs/msg/Empty"}
    rows.append((scenario.end, "end", codec.encode({}, types["end"])))
    with codec.open_writer(path) as bag:
        connections = {}
        for time, topic, data in rows:
            if topic not in connections:
                name = f"/{topic.lstrip('/')}"
                connections[topic] = bag.add_connection(name, types[topic], typestore=codec.store)
            bag.write(connections[topic], time, data)


def play_bag(path: Path, scenario: Scenario, codec: MessageCodec) -> Outputs:
    """Return the outputs of the program of a scenario for a bag."""
    with MergedBag([path]) as bag:
        playback = Playback(scenario.program, fail, bag=bag)
        outputs = list(playback.run(bag))
    # The bytes of an output are those of ROS 1.
    return collect_outputs([(output.topic, output.data) for output in outputs], scenario, MessageCodec(1))


@pytest.mark.parametrize("folder", SCENARIOS, ids=lambda folder: folder.name)
@pytest.mark.parametrize("version", [1, 2])
def test_bag_has_expected_outputs(folder: Path, version: int, tmp_path: Path) -> None:
    scenario, codec = read_scenario(folder), MessageCodec(version)
    path = tmp_path / ("recorded.bag" if version == 1 else "recorded")
    write_bag(path, scenario, codec)
    assert play_bag(path, scenario, codec) == scenario.outputs
