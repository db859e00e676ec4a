"""The scenarios of ``test/scenarios`` on the node of ROS 2: the outputs are those of bags and of ROS 1."""

import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

from ros2.node_processes import NodeProcess
from ros2.rclpy_nodes import Network, wait_until
from ros2.simulated_time_node import SimulatedTimeNode
from scenarios.scenario_runs import HERE, SCENARIOS, MessageCodec, Scenario, play_live, read_scenario

from retalis.engine.checkpoints import read_checkpoint


def connect(network: Network, scenario: Scenario) -> SimulatedTimeNode:
    """Connect to the node with the topics of a scenario."""
    return SimulatedTimeNode(
        network,
        {topic: scenario.types[topic] for topic in scenario.inputs()},
        {topic: scenario.types[topic] for topic in scenario.published},
    )


def check_end(process: NodeProcess) -> None:
    """Check that the node ends without errors."""
    assert process.interrupt() == 0
    assert "[ERROR]" not in process.log()
    assert "Traceback" not in process.log()


@pytest.mark.slow
@pytest.mark.parametrize("folder", SCENARIOS, ids=lambda folder: folder.name)
def test_each_round_of_loop_has_expected_outputs(network: Network, start_node: Any, folder: Path) -> None:
    scenario, codec = read_scenario(folder), MessageCodec(2)
    process = start_node("-p", f"program:={scenario.program}", "-p", "use_sim_time:=true")
    node = connect(network, scenario)
    assert play_live(scenario, node, codec) == scenario.outputs
    assert play_live(scenario, node, codec) == scenario.outputs
    check_end(process)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["door_watch", "lost_robots"])
def test_killed_node_continues_from_checkpoint(
    domain: int, start_node: Any, name: str, tmp_path: Path
) -> None:
    scenario = read_scenario(HERE / name)
    path = tmp_path / "state.db"
    parameters = (f"program:={scenario.program}", "use_sim_time:=true", f"checkpoint:={path}")
    outputs = []
    for part in (slice(0, 4), slice(4, None)):
        process = start_node(*(word for parameter in parameters for word in ("-p", parameter)))
        # A network that knows the killed node believes for 20 s that it runs.
        network = Network()
        try:
            outputs.append(play_live(scenario, connect(network, scenario), MessageCodec(2), part))
            now = time.time()
            wait_until(lambda: written_at(path) > now)  # noqa: B023 - called at once
        finally:
            network.close()
        if part.stop:
            process.kill()
    assert {topic: first + outputs[1][topic] for topic, first in outputs[0].items()} == scenario.outputs
    assert "restored from" in process.log()
    check_end(process)


def written_at(path: Path) -> float:
    """Return the time at which the state in a file was written, 0 without a state."""
    checkpoint = read_checkpoint(path)
    return 0.0 if checkpoint is None else checkpoint.written_at
