"""What goes out: formats of subscriptions against the types of their topics, and topics that nobody publishes."""

from typing import Iterator, Optional, Set, Tuple

from ...foundation import RuleError, beginning
from ...messages import Definition, fault_of
from ...prolog.terms import CompoundTerm, deref
from ..program import TOPICS, nowhere
from .near import meant
from .overview import Kept, Overview, is_open


def outputs(program: Overview) -> Iterator[RuleError]:
    """Yield the outputs that are no messages of the types of their topics."""
    published = {plain(topic): kind for topic, kind in program.topics.published}
    for kept, topic in _named(program):
        kind = published.get(plain(topic))
        definition = None if kind is None else program.definition(kind)
        wrong = None if definition is None else output_fault(definition, kept.term, topic)
        if wrong is not None:
            yield RuleError(f"{kept.who}{wrong}", kept.spot(kept.term, 1 if kept.stands_for_event else 3))


def unpublished(program: Overview) -> Iterator[RuleError]:
    """Yield the topics to which events go that have no type."""
    published = [plain(topic) for topic, _ in program.topics.published]
    said: Set[str] = set()
    for kept, topic in _named(program):
        if topic in said or any(_may_be(plain(topic), other) for other in published):
            continue
        said.add(topic)
        name = beginning(topic)
        advice = f'; <publish_to name="{name}" msg_type="package/Type"/> in {TOPICS} would give it one'
        yield RuleError(
            f"topic {name} has no type: its events are published only as text on retalisOutputEvents"
            f"{meant(plain(topic), published) or advice}",
            kept.spot(kept.term, 4),
        )


def _named(program: Overview) -> Iterator[Tuple[Kept, str]]:
    """Yield the subscriptions whose topics are known, with these."""
    for kept in program.subscriptions:
        if not is_open(kept.term[4]):
            yield kept, program.topic(kept.term[4])


def _may_be(one: str, other: str) -> bool:
    """Tell whether two topics may be the same in some namespace."""
    return one == other or one.endswith(f"/{other}") or other.endswith(f"/{one}")


def plain(topic: str) -> str:
    """Return a topic's name by which two are compared."""
    return topic.lstrip("/")


def output_fault(definition: Definition, subscription: CompoundTerm, topic: str) -> Optional[str]:
    """Return why the term that a subscription sends is no message of a type, whatever the values of its variables.

    Return None if it may be one.

    Args:
        definition: the type.
        subscription: the goal ``subscribe/5``.
        topic: is named in the answer.
    """
    sent = deref(Kept(subscription, "", nowhere).made)
    return None if is_open(sent) else fault_of(definition, sent, topic)
