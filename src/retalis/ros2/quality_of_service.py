"""Choice of the quality of service of subscriptions.

A subscription receives nothing from a publisher that offers less than it requests. It therefore requests the strict
profile (reliable; transient local, which repeats the last messages for late subscribers) only if all publishers of
the topic offer it. Without publishers it is reliable, as publishers are by default in ROS 2, and the choice is made
again when a publisher appears.
"""

from typing import Any, Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)

from ..events.program.topic_configuration import QualityOfService
from ..node.transport import Mismatch

_NO_NAMES = ("_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_")
"""Beginnings of the texts that rmw has in place of unknown names."""


class Offer(NamedTuple):
    """Quality of service that a publisher offers.

    Attributes:
        node: full name of its node.
        is_reliable: whether it sends lost messages again.
        is_transient_local: whether it sends its last messages to late subscribers.
    """

    node: str
    is_reliable: bool
    is_transient_local: bool

    def __str__(self) -> str:
        return f"{self.node or 'an unknown node'} ({_describe(self.is_reliable, self.is_transient_local)})"


class Quality(NamedTuple):
    """The quality of service of a subscription or a publication.

    Attributes:
        is_reliable: whether lost messages are sent again.
        is_transient_local: whether the last messages are sent to late subscribers.
        depth: number of messages to queue.
    """

    is_reliable: bool
    is_transient_local: bool
    depth: int

    def __str__(self) -> str:
        return _describe(self.is_reliable, self.is_transient_local)

    def profile(self) -> QoSProfile:
        """Return the profile for rclpy."""
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=self.depth,
            reliability=ReliabilityPolicy.RELIABLE if self.is_reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=(
                DurabilityPolicy.TRANSIENT_LOCAL if self.is_transient_local else DurabilityPolicy.VOLATILE
            ),
        )


def read_offers(endpoints: Iterable[Any]) -> List[Offer]:
    """Return what publishers offer, given rclpy's descriptions of them."""
    return [
        Offer(
            full_node_name(endpoint),
            endpoint.qos_profile.reliability == ReliabilityPolicy.RELIABLE,
            endpoint.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        )
        for endpoint in endpoints
    ]


def full_node_name(endpoint: Any) -> str:
    """Return the full name of an endpoint's node; "" if it is unknown, or the endpoint belongs to no node."""
    return join_node_name(endpoint.node_namespace, endpoint.node_name)


def join_node_name(namespace: str, name: str) -> str:
    """Return the full name of a node; "" for the texts that rmw has in place of unknown names."""
    return "" if name.startswith(_NO_NAMES) else f"{namespace.rstrip('/')}/{name}"


def choose_quality(offers: Sequence[Offer], demands: QualityOfService) -> Quality:
    """Return the quality of a subscription: as demanded, otherwise the strictest that all publishers offer."""
    is_reliable, is_transient_local, depth = demands
    if is_reliable is None:
        is_reliable = all(offer.is_reliable for offer in offers)
    if is_transient_local is None:
        is_transient_local = bool(offers) and all(offer.is_transient_local for offer in offers)
    return Quality(is_reliable, is_transient_local, depth or 1)


def choose_published_quality(demands: QualityOfService, is_latched: bool, queue_size: int) -> Quality:
    """Return the quality of a publication: as demanded, otherwise reliable, and volatile unless it is latched.

    Args:
        demands: what the program demands.
        is_latched: whether late subscribers receive the last message.
        queue_size: number of messages to queue if it is not latched.
    """
    is_transient_local = is_latched if demands.is_transient_local is None else demands.is_transient_local
    depth = 1 if is_transient_local and is_latched else queue_size
    return Quality(demands.is_reliable is not False, is_transient_local, demands.depth or depth)


def list_mismatches(offers: Sequence[Offer], quality: Quality) -> List[Offer]:
    """Return the publishers that offer less than a subscription requests, so that it receives nothing from them."""
    return [
        offer
        for offer in offers
        if (quality.is_reliable and not offer.is_reliable)
        or (quality.is_transient_local and not offer.is_transient_local)
    ]


def find_mismatches(topic: str, published: Iterable[Any], subscribed: Sequence[Any]) -> Iterator[Mismatch]:
    """Yield the publishers and subscribers of a topic that cannot connect: their types or qualities differ.

    Args:
        topic: full name of the topic.
        published: rclpy's descriptions of the publishers.
        subscribed: rclpy's descriptions of the subscriptions.
    """
    # Topics such as /parameter_events have hundreds of publishers and subscribers, with two or three profiles.
    obstacles: Dict[Tuple[Any, Any], str] = {}
    subscribers = [(subscriber, _describe_profile(subscriber)) for subscriber in subscribed]
    for publisher in published:
        profile = _describe_profile(publisher)
        for subscriber, subscriber_profile in subscribers:
            pair = profile, subscriber_profile
            if pair not in obstacles:
                obstacles[pair] = _find_obstacle(publisher, subscriber)
            if obstacles[pair]:
                name = full_node_name(publisher)
                reason = f"{name or 'an unknown node'}: {obstacles[pair]}"
                yield Mismatch(topic, name, full_node_name(subscriber), reason)


def _describe_profile(endpoint: Any) -> Tuple[Any, ...]:
    """Return the facts on which a connection depends."""
    profile = endpoint.qos_profile
    return (
        endpoint.topic_type,
        profile.reliability,
        profile.durability,
        profile.deadline.nanoseconds,
        profile.liveliness,
        profile.liveliness_lease_duration.nanoseconds,
    )


def _find_obstacle(publisher: Any, subscriber: Any) -> str:
    """Return the reason why a publisher and a subscription cannot connect; "" if they can."""
    if publisher.topic_type != subscriber.topic_type:
        return f"it publishes {publisher.topic_type}, expected {subscriber.topic_type}"
    compatibility, reason = qos_check_compatible(publisher.qos_profile, subscriber.qos_profile)
    return str(reason).strip() if compatibility == QoSCompatibility.ERROR else ""


def _describe(is_reliable: bool, is_transient_local: bool) -> str:
    reliability = "reliable" if is_reliable else "best effort"
    return f"{reliability}, {'transient local' if is_transient_local else 'volatile'}"
