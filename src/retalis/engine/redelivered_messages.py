"""Messages that the engine has processed, and that a middleware may deliver again after a restart.

In ROS 2 a publisher of a transient-local topic sends its last messages to each new subscription. A node that
continues from a checkpoint therefore receives messages whose events its state contains. They are recognized by the
instant and the number with which the publisher has sent them: an equal message that is sent again has others. The
engine records a message together with its event, so that a message whose event is lost is processed again.
"""

from typing import Dict, List, NamedTuple, Tuple

from ..prolog.terms.types import Term
from ..serialization.state_fields import StateFields, StateOwner, constraint, field
from ..serialization.stored_field_types import COUNT, TEXT, mapping_of, sequence_of, tuple_of

MAX_MESSAGES = 100
"""Number of messages of a topic that are recognized: the last ones."""

MAX_TOPICS = 100
"""Number of topics whose messages are recognized: those that have sent last."""

MessageIdentity = Tuple[int, int]
"""Instant at which a message was sent in ns, and its number among the messages of its publisher."""


class IdentifiedMessage(NamedTuple):
    """A message that may be delivered again.

    Attributes:
        topic: full name of its topic.
        identity: tells it apart from the other messages of the topic.
    """

    event: Term
    topic: str
    identity: MessageIdentity


class ProcessedMessages(StateOwner):
    """The last messages of topics that the engine has processed."""

    STATE = StateFields(
        field("identities", mapping_of(TEXT, sequence_of(tuple_of(COUNT, COUNT)))),
        constraint(
            f"at most {MAX_MESSAGES} messages of each of {MAX_TOPICS} topics",
            lambda owner, state: (
                len(state["identities"]) <= MAX_TOPICS
                and all(len(identities) <= MAX_MESSAGES for identities in state["identities"].values())
            ),
        ),
    )

    def __init__(self) -> None:
        self.identities: Dict[str, List[MessageIdentity]] = {}

    def __contains__(self, message: IdentifiedMessage) -> bool:
        return message.identity in self.identities.get(message.topic, ())

    def add(self, message: IdentifiedMessage) -> None:
        """Record a message."""
        # Removed and added again, so that the topic that has not sent for longest is evicted first.
        identities = self.identities.pop(message.topic, [])
        self.identities[message.topic] = identities
        identities.append(message.identity)
        if len(identities) > MAX_MESSAGES:
            del identities[0]
        if len(self.identities) > MAX_TOPICS:
            del self.identities[next(iter(self.identities))]

    def clear(self) -> None:
        """Forget all messages."""
        self.identities.clear()
