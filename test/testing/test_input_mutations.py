"""Mutations of the input of a case."""

from typing import Any, List, Sequence, Tuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from testing.case_texts import parse_case

from retalis import Definitions
from retalis.messages.message_dictionaries import make_message_term
from retalis.playback.rosbag1 import Record, Topic
from retalis.testing.case_definition import InputId, Mutation, MutationType
from retalis.testing.input_mutations import MessageMutator, describe_mutation, largest_amount, mutate_events

SECOND = 10**9
START = 1000 * SECOND

EVENTS = parse_case(
    "rules: a <- b.\ncases: [{name: x, expect: {}, input: [{at: 1, event: a}, {at: 1, event: b}, "
    "{at: 3, event: c, interval: [0, 2]}]}]"
).events


def list_events(*mutations: Mutation) -> List[Tuple[Any, ...]]:
    """Return the names of the mutated events with receipt, start and end in seconds; None if these are not given."""
    return [
        (
            event.event.text,
            *(None if time is None else time / SECOND for time in (event.time, event.start, event.end)),
        )
        for event in mutate_events(EVENTS, mutations)
    ]


def mutation(
    mutation_type: str, seconds: float, number: int = 0, amount: float = 0, topic: str = ""
) -> Mutation:
    input_id = InputId(topic, round(seconds * SECOND), number)
    return Mutation(MutationType(mutation_type), input_id, round(amount * SECOND))


A, B, C = ("a", 1, None, None), ("b", 1, None, None), ("c", 3, 0, 2)


@pytest.mark.parametrize(
    ("mutations", "expected"),
    [
        ([], [A, B, C]),
        ([mutation("lost", 1, 1)], [A, C]),
        ([mutation("repeated", 1)], [A, A, B, C]),
        ([mutation("delayed", 1, 0, 0.5)], [B, ("a", 1.5, 1, 1), C]),
        ([mutation("delayed", 3, 0, 1), mutation("lost", 1, 0)], [B, ("c", 4, 0, 2)]),
        ([mutation("overtaken", 1, 0, 1e-9)], [B, ("a", 1.000000001, 1, 1), C]),
        ([mutation("restamped", 1, 1, -0.5)], [A, ("b", 1, 0.5, 0.5), C]),
        ([mutation("restamped", 3, 0, 0.5)], [A, B, ("c", 3, 0.5, 2.5)]),
        ([mutation("lost", 1, 2), mutation("lost", 2)], [A, B, C]),
    ],
)
def test_events_are_mutated(mutations: Sequence[Mutation], expected: Sequence[Any]) -> None:
    assert list_events(*mutations) == expected


def make_topic(definitions: Definitions, name: str, type_name: str) -> Topic:
    definition = definitions.find(type_name)
    return Topic(name, type_name, definition.full_text, definition.md5sum)


def make_record(topic: Topic, second: float, data: bytes = b"") -> Record:
    return Record(topic, START + round(second * SECOND), data)


@pytest.fixture
def flags(definitions: Definitions) -> List[Record]:
    """Return messages of one topic at 1, 2, 2 and 3 s, each with its position."""
    topic = make_topic(definitions, "/flag", "std_msgs/Int8")
    return [make_record(topic, second, bytes([position])) for position, second in enumerate((1, 2, 2, 3))]


@pytest.mark.parametrize(
    ("mutations", "expected"),
    [
        ([], [(0, 1), (1, 2), (2, 2), (3, 3)]),
        ([mutation("lost", 2, 1, topic="/flag")], [(0, 1), (1, 2), (3, 3)]),
        ([mutation("lost", 2, 1, topic="/other")], [(0, 1), (1, 2), (2, 2), (3, 3)]),
        ([mutation("repeated", 2, 0, topic="/flag")], [(0, 1), (1, 2), (1, 2), (2, 2), (3, 3)]),
        ([mutation("delayed", 1, 0, 1, "/flag")], [(1, 2), (2, 2), (0, 2), (3, 3)]),
        ([mutation("delayed", 1, 0, 9, "/flag"), mutation("delayed", 3, 0, 1, "/flag")],
         [(1, 2), (2, 2), (3, 4), (0, 10)]),
        ([mutation("restamped", 1, 0, 9, "/flag")], [(0, 1), (1, 2), (2, 2), (3, 3)]),
    ],
)  # fmt: skip
def test_messages_are_mutated(
    flags: List[Record], definitions: Definitions, mutations: Sequence[Mutation], expected: Sequence[Any]
) -> None:
    mutator = MessageMutator(mutations, definitions, START)
    records = [(record.data[0], (record.time - START) / SECOND) for record in mutator.mutate(flags)]
    if mutations and mutations[0].type is MutationType.RESTAMPED:
        # A message of four bytes has no header: nothing is changed.
        assert not any(message.has_stamp for message in mutator.inputs)
    assert records == expected
    assert [message.id.number for message in mutator.inputs] == [0, 0, 1, 0]


def test_header_of_message_gets_other_stamp(definitions: Definitions) -> None:
    definition = definitions.find("geometry_msgs/PointStamped")
    topic = make_topic(definitions, "point", definition.name)
    stamps = [5 * SECOND, 6 * SECOND + 1]
    messages = [
        definitions.encoder(definition).encode(
            make_message_term(definition, {"header": {"stamp": stamp}}), "point"
        )
        for stamp in stamps
    ]
    change = mutation("restamped", 1, 0, 1.000000001, "point")
    mutator = MessageMutator([change], definitions, START)
    (record,) = mutator.mutate([make_record(topic, 1, messages[0])])
    assert record == make_record(topic, 1, messages[1])
    assert mutator.inputs[0].has_stamp


@given(
    st.lists(
        st.tuples(st.integers(0, 9), st.integers(1, 9 * SECOND)), max_size=5, unique_by=lambda each: each[0]
    )
)
def test_delayed_messages_remain_ordered_by_time(delays: List[Tuple[int, int]]) -> None:
    topic = Topic("t", "unknown/Type", "", "")
    records = [make_record(topic, second, bytes([second])) for second in range(10)]
    mutations = [
        Mutation(MutationType.DELAYED, InputId("t", second * SECOND, 0), amount) for second, amount in delays
    ]
    mutated = list(MessageMutator(mutations, Definitions(), START).mutate(records))
    times = [record.time for record in mutated]
    assert times == sorted(times)
    assert sorted(record.data for record in mutated) == [record.data for record in records]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (mutation("lost", 1), "X is lost"),
        (mutation("repeated", 1), "X is received twice"),
        (mutation("delayed", 1, 0, 0.32), "X is received 0.32 s later"),
        (mutation("restamped", 1, 0, 0.01), "X has a stamp that is 0.01 s later"),
        (mutation("restamped", 1, 0, -1.28), "X has a stamp that is 1.28 s earlier"),
        (mutation("overtaken", 1)._replace(next_input=InputId("", 2, 0)), "X is received after Y"),
    ],
)
def test_mutation_is_described(change: Mutation, text: str) -> None:
    assert describe_mutation(change, lambda input_id: "X" if input_id == change.input else "Y") == text


def test_largest_amount_is_absolute() -> None:
    assert largest_amount([mutation("restamped", 1, 0, -2), mutation("delayed", 1, 0, 1)]) == 2 * SECOND
    assert largest_amount([]) == 0


def test_late_input_follows_input_in_time() -> None:
    assert list_events(mutation("delayed", 1, 0, 2)) == [B, C, ("a", 3, 1, 1)]
    topic = Topic("t", "unknown/Type", "", "")
    records = [make_record(topic, second, bytes([second])) for second in (1, 3)]
    mutator = MessageMutator([mutation("delayed", 1, 0, 2, "t")], Definitions(), START)
    assert [record.data for record in mutator.mutate(records)] == [b"\x03", b"\x01"]
