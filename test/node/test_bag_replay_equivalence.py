"""Ten bags on a network in memory: the outputs of the node equal those of playback, in the same order."""

from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest
from asserting_accessors import fail
from node.equivalence_bags import BAGS, DEFINITIONS_BY_TOPIC, write_bag
from node.in_memory_hosts import start_host
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis import BagReader, Playback, atom, functor
from retalis.prolog.syntax.event_text import to_text

PROGRAM = Path(__file__).resolve().parent / "equivalence_program"
OUTPUT = functor("event", 3)
PUBLISHED = ("copies", "greens")
SECOND = 10**9


def record_outputs(engine: Any) -> Any:
    """Return the list to which the outputs of an engine are added as texts."""
    texts: List[Any] = []
    engine.on_output(lambda term, topic, name: texts.append(to_text((OUTPUT, term, atom(topic), name))))
    return texts


def run_offline(path: Any) -> Tuple[Any, ...]:
    """Return the outputs of playback of a bag, as texts and as messages by topic."""
    with BagReader(path) as bag:
        playback = Playback(PROGRAM, fail, bag=bag)
        texts = record_outputs(playback.engine)
        messages: Dict[Any, Any] = {topic: [] for topic in PUBLISHED}
        for output in playback.run(bag):
            if output.topic in messages:
                messages[output.topic].append(output.data)
    return texts, messages


def run_on_network(path: Any) -> Tuple[Any, ...]:
    """Return the outputs of a node that receives the messages of a bag, as texts and as messages by topic."""
    with BagReader(path) as bag:
        records = list(bag.records())
        network = MemoryNetwork(bag.start)
    host = start_host(network, PROGRAM)
    robot = MemoryTransport(network, "/robot")
    publishers = {
        topic: robot.advertise(f"/{topic}", definition, 10)
        for topic, definition in DEFINITIONS_BY_TOPIC.items()
    }
    try:
        texts = record_outputs(host.engine)
        for record in records:
            network.move_time((record.time - network.now) / SECOND)
            publishers[record.topic.name.strip("/")].send(record.data)
    finally:
        host.transport.shut_down()
    messages = {
        topic: [
            data for publication in network.publications.get(f"/{topic}", ()) for data in publication.messages
        ]
        for topic in PUBLISHED
    }
    return texts, messages


@pytest.mark.parametrize(
    ("number", "specification"), list(enumerate(BAGS)), ids=[specification.name for specification in BAGS]
)
def test_outputs_on_network_equal_those_of_playback(tmp_path: Path, number: Any, specification: Any) -> None:
    path = write_bag(tmp_path / "some.bag", number, specification)
    expected = run_offline(path)
    assert run_on_network(path) == expected
    assert len(expected[0]) > len(specification.topics)
    assert bool(expected[1]["copies"]) == ("marks" in specification.topics)
