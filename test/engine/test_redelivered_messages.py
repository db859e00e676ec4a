"""Messages that an engine has processed, and that are delivered again."""

from typing import Any, List

import pytest

from retalis import Engine, StreamClock, UsageError
from retalis.engine.redelivered_messages import (
    MAX_MESSAGES,
    MAX_TOPICS,
    IdentifiedMessage,
    ProcessedMessages,
)
from retalis.prolog.terms.types import functor

SECOND = 10**9


def make_message(number: int, topic: str = "/door") -> IdentifiedMessage:
    return IdentifiedMessage(functor("door", 1)(number), topic, (number * SECOND, number))


def post(engine: Engine, *numbers: int) -> List[int]:
    """Return the numbers of the messages that have become events."""
    events: List[int] = []
    engine.on_event(lambda term, start, end: events.append(term[1]))
    engine.post_identified([(make_message(number), number * SECOND) for number in numbers])
    return events


def test_message_of_restored_state_is_ignored() -> None:
    engine = Engine()
    assert post(engine, 1, 2, 2) == [1, 2]
    assert post(Engine.restore(engine.snapshot()), 1, 2, 3) == [3]


def test_message_after_time_went_back_is_processed() -> None:
    clock = StreamClock()
    engine = Engine(clock)
    clock.move_to(100 * SECOND)
    post(engine, 100)
    engine.advance(lambda: clock.move_to(50 * SECOND, back=True))
    assert post(engine, 100) == [100]


def test_number_of_messages_is_bounded() -> None:
    messages = ProcessedMessages()
    for number in range(MAX_MESSAGES + 1):
        messages.add(make_message(number))
    assert make_message(0) not in messages
    assert make_message(1) in messages
    for number in range(MAX_TOPICS):
        messages.add(make_message(1, f"/door{number}"))
    assert make_message(MAX_MESSAGES) not in messages
    assert make_message(1, "/door0") in messages


@pytest.mark.parametrize(
    "identities",
    [
        {f"/door{number}": [] for number in range(MAX_TOPICS + 1)},
        {"/door": [(number, number) for number in range(MAX_MESSAGES + 1)]},
    ],
)
def test_state_with_too_many_messages_is_refused(identities: Any) -> None:
    engine = Engine()
    engine.event_input.processed_messages.identities.update(identities)
    with pytest.raises(UsageError, match="at most 100 messages of each of 100 topics"):
        Engine.restore(engine.snapshot())
