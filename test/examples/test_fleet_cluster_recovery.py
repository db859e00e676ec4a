"""``examples/fleet`` on a cluster whose processes are killed, with events and outputs through a broker of MQTT."""

import json
import shutil
import threading
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any, Dict, Iterator, List

import pytest
from examples.flink_cluster import NEEDS_CLUSTER, TIMEOUT_SECONDS, Cluster, wait_until
from script_modules import load_script

from retalis.fleet.robot_engine import FleetProgram, RobotEngine
from retalis.fleet.robot_events import read_robot_event

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "fleet"

KILLED = ("worker 1", "manager", "bridge", "worker 1 python", "worker 2", "worker 2 python")
"""Processes that are killed."""

pytestmark = [pytest.mark.slow, NEEDS_CLUSTER]


def create_lines(robots: int, seconds: int) -> List[str]:
    """Return numbered events, and a last line whose time lets all alarms run."""
    make_events = load_script(FOLDER / "make_events.py", "fleet_make_events")
    numbers: Dict[str, int] = Counter()
    lines = []
    for event in make_events.events(robots, seconds):
        numbers[event["robot"]] += 1
        lines.append(json.dumps({**event, "id": numbers[event["robot"]], "session": "first"}))
    lines.append(json.dumps({"robot": "clock", "time": seconds + 400, "id": 1, "session": "first"}))
    return lines


def run_loop(program: Path, lines: List[str]) -> Dict[Any, str]:
    """Return the outputs of a loop over the lines, by robot and number."""
    fleet_program, outputs = FleetProgram(program), {}
    robots: Dict[str, RobotEngine] = {}
    for line in lines:
        event = read_robot_event(line)
        if event.robot not in robots:
            robots[event.robot] = RobotEngine(fleet_program)
        for output in robots[event.robot].process(event).outputs:
            outputs[event.robot, output.number] = output.text
    for name, robot in robots.items():
        for output in robot.fire_alarms(robot.reached + 300_000_000_000):
            outputs[name, output.number] = output.text
    return outputs


def identify(lines: List[str]) -> List[Any]:
    """Return the robot, number and text of each line."""
    outputs = [json.loads(line) for line in lines]
    return [((output["robot"], output["number"]), output["output"]) for output in outputs]


class Client:
    """A client that publishes events, some of them twice, and receives outputs."""

    def __init__(self, port: int):
        from paho.mqtt.client import Client  # noqa: PLC0415 - optional
        from paho.mqtt.enums import CallbackAPIVersion  # noqa: PLC0415

        self.received: List[str] = []
        self._chance = Random(4)
        self._client = Client(CallbackAPIVersion.VERSION2, "test")
        subscribed = threading.Event()
        self._client.on_message = lambda client, data, message: self.received.append(message.payload.decode())
        self._client.on_subscribe = lambda *arguments: subscribed.set()
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        self._client.subscribe("retalis/+/outputs", qos=1)
        assert subscribed.wait(TIMEOUT_SECONDS)

    def publish(self, lines: List[str]) -> None:
        """Publish events, and wait until the broker has them."""
        messages = []
        for line in lines:
            for _ in range(1 + (self._chance.random() < 0.05)):
                topic = f"retalis/{json.loads(line)['robot']}/events"
                messages.append(self._client.publish(topic, line, qos=1))
        for message in messages:
            message.wait_for_publish(TIMEOUT_SECONDS)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


@pytest.fixture
def program(tmp_path: Path) -> Path:
    shutil.copytree(FOLDER, tmp_path / "program", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "program"


@pytest.fixture
def cluster(tmp_path: Path, program: Path) -> Iterator[Cluster]:
    started = Cluster(tmp_path, program)
    yield started
    started.close()


@pytest.fixture
def client(cluster: Cluster) -> Iterator[Client]:
    connected = Client(cluster.mqtt_port)
    yield connected
    connected.close()


def wait_for_outputs(cluster: Cluster, count: int) -> None:
    """Wait until complete files have a number of outputs."""
    wait_until(lambda: len(cluster.lines_of("outputs")) >= count, f"{count} outputs")


def check_outputs(cluster: Cluster, client: Client, expected: Dict[Any, str]) -> None:
    """Check that files have each output once, and that the broker has sent each output at least once."""
    wait_for_outputs(cluster, len(expected))
    outputs = identify(cluster.lines_of("outputs"))
    assert len(outputs) == len(set(outputs))
    assert dict(outputs) == expected
    wait_until(lambda: dict(identify(list(client.received))) == expected, "all outputs by MQTT")
    # A repetition has the number and the text of the output.
    assert set(identify(client.received)) == set(outputs)
    assert cluster.lines_of("failed") == cluster.lines_of("late") == []


def run_and_kill(
    cluster: Cluster, client: Client, program: Path, tmp_path: Path, kills: int, seed: int
) -> None:
    from retalis.fleet.flink_job import find_newest_checkpoint  # noqa: PLC0415 - imports pyflink

    chance = Random(seed)
    lines = create_lines(robots=4, seconds=60 + 15 * kills)
    expected = run_loop(program, lines)
    part = len(lines) // (kills + 1)
    # Each worker has one slot, so that both have robots.
    cluster.configure(parallelism=2)
    cluster.submit()
    for number in range(kills):
        wait_until(cluster.is_running, "the job")
        before = len(cluster.lines_of("outputs"))
        client.publish(lines[number * part : (number + 1) * part])
        # Killed after a random number of the outputs of these events.
        wait_for_outputs(cluster, before + chance.randrange(2, 6))
        name = KILLED[number % len(KILLED)]
        cluster.kill(name)
        if name == "manager":
            # Without a highly available store the job ends with its manager.
            wait_until(lambda: cluster.count_free_slots() >= 2, "workers")
            cluster.submit(find_newest_checkpoint(tmp_path / "checkpoints"))
    client.publish(lines[kills * part :])
    check_outputs(cluster, client, expected)


def test_killed_processes_lose_no_output(cluster: Any, client: Any, program: Path, tmp_path: Path) -> None:
    run_and_kill(cluster, client, program, tmp_path, kills=3, seed=1)


@pytest.mark.nightly
def test_many_killed_processes_lose_no_output(
    cluster: Any, client: Any, program: Path, tmp_path: Path
) -> None:
    run_and_kill(cluster, client, program, tmp_path, kills=20, seed=2)


def test_job_continues_with_other_parallelism(cluster: Cluster, client: Client, program: Path) -> None:
    lines = create_lines(robots=4, seconds=60)
    expected = run_loop(program, lines)
    part, savepoint = len(lines) // 3, None
    for number, parallelism in enumerate((1, 2, 1)):
        cluster.configure(parallelism)
        cluster.submit(savepoint)
        wait_until(cluster.is_running, "the job")
        before = len(cluster.lines_of("outputs"))
        client.publish(lines[number * part : None if number == 2 else (number + 1) * part])
        if number < 2:
            wait_for_outputs(cluster, before + 3)
            savepoint = cluster.stop_with_savepoint()
    check_outputs(cluster, client, expected)


def test_changed_program_is_refused_or_loaded(cluster: Cluster, client: Client, program: Path) -> None:
    lines = create_lines(robots=4, seconds=60)
    expected = run_loop(program, lines)
    cluster.submit()
    wait_until(cluster.is_running, "the job")
    client.publish(lines[: len(lines) // 2])
    wait_for_outputs(cluster, 3)
    savepoint = cluster.stop_with_savepoint()
    with open(program / "goalPredicates.txt", "a", encoding="utf-8") as goals:
        goals.write("subscribe(picked(_), [], _, picks, q1)\n")
    cluster.submit(savepoint)
    client.publish(lines[len(lines) // 2 :])

    def find_refusal() -> bool:
        exceptions = json.dumps(cluster.get(f"/jobs/{cluster.job}/exceptions"))
        return "the program has changed since the state of this robot was stored" in exceptions

    wait_until(find_refusal, "the refusal")
    cluster.get(f"/jobs/{cluster.job}/yarn-cancel")
    wait_until(lambda: cluster.get(f"/jobs/{cluster.job}").get("state") == "CANCELED", "the end of the job")
    job = program / "fleet_mqtt.py"
    job.write_text(job.read_text().replace('on_change="refuse"', 'on_change="reload"'))
    cluster.submit(savepoint)

    def texts_of(topic_is_new: bool) -> Any:
        outputs = [json.loads(line) for line in cluster.lines_of("outputs")]
        chosen = [output for output in outputs if (output["topic"] == "picks") == topic_is_new]
        return sorted((output["robot"], output["output"]) for output in chosen)

    expected_texts = sorted((robot, text) for (robot, _), text in expected.items())
    wait_until(lambda: texts_of(topic_is_new=False) == expected_texts, "all outputs")
    assert 0 < len(texts_of(topic_is_new=True)) < sum("picked(" in line for line in lines)
