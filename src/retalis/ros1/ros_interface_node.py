"""Node ``retalis_ros_interface``: the services for input topics, and the conversion of messages if they pass as text.

By default node ``retalis`` subscribes and publishes itself, and this node only offers the services (`ServiceNode`).
With ``direct:=false``, or a list of topics, it converts messages to event texts, and output texts to messages
(`TextInterfaceNode`). It then keeps the conversion and the TCP connections to publishers out of the process of the
engine. Messages go to node ``retalis`` as texts on one topic, in the order in which they were received; outputs come
back as texts on another. Fields that the program does not read are left out of the texts (projection pushdown,
`internode_control_topics`).
"""

import threading
from typing import Iterable, List

from ..engine.runtime.problem_reports import Reports
from ..events.dispatch.argument_projection import NOT_READ
from ..events.program.topic_configuration import Topics, direct_topics
from ..messages.action_events import STATUS, find_action_event
from ..messages.decoder import Decoder
from ..messages.message_to_event_text import make_text_writer, write_without_unread
from ..node.diagnostics import Diagnostics, InputRole, NodeHealth, evaluate_program
from ..node.goal_output import log_error
from ..node.latched_deduplication import LatchedConnection
from ..node.parameters import Parameters
from ..node.program_host_context import HostContext
from ..node.published_topics import PublishedTopics
from ..node.running_program import open_topics
from ..node.services import InterfaceServices, ListService
from ..node.subscribed_topics import (
    MessageHandler,
    MessageProcessing,
    ReadingOptions,
    SubscribedTopics,
    consume_and_discard,
)
from ..node.text_exchange import INPUT, OUTPUT
from ..node.topic_statistics import OutputStatus, StartupWarnings
from ..node.transport import MessageSource
from ..node.transport_time import Receipts
from ..prolog.syntax.event_text import event_text
from .internode_control_topics import (
    InputTopicChanges,
    ProjectionReceiver,
    SubscriptionReceiver,
    announce_direct,
)
from .node_lifecycle import run_node
from .rospy_transport import RospyTransport, resolve
from .text_topics import NO_TEXT_HINT, EventTextPublisher, make_text_handler_factory

MAX_DELAY_SECONDS = 0.0018
"""Seconds for which a message may wait for the next ones, to be converted and sent together.

The value is below two intervals of a topic of 1,000 Hz, so that its messages are read one by one; see
`MIN_FURTHER_MESSAGES`.
"""


MIN_PROJECTED_BYTES = 1024
"""Size in bytes from which on unread fields of a message are left out; for smaller ones the check costs more."""


class ServiceNode:
    """Node ``retalis_ros_interface`` if node ``retalis`` itself subscribes and publishes: only the services."""

    def __init__(self, parameters: Parameters):
        reports = Reports()
        transport = RospyTransport(reports)
        transport.on_shutdown(reports.sum_up)
        # Node retalis reports errors of the topics.
        context = HostContext(transport, parameters, reports)
        topics = context.topics
        direct = direct_topics(parameters.direct, topics, transport.resolve_topic)
        self._changes = InputTopicChanges(parameters.direct, (*topics.subscribed, *direct), reports)
        InterfaceServices(transport, context.definitions, self._changes.subscribe, self._changes.unsubscribe)
        ListService(transport, list, reports=reports)
        self._diagnostics = Diagnostics(
            transport, parameters.diagnostics, NodeHealth(list, list, list), reports, parameters.hardware_id
        )


class TextInterfaceNode:
    """Node ``retalis_ros_interface`` if messages pass through it as text."""

    def __init__(self, parameters: Parameters):
        reports = Reports()
        transport = RospyTransport(reports)
        context = HostContext(transport, parameters, reports)
        time = context.time
        skew = context.make_skew_monitor()
        self._receipts = Receipts(time.now)
        self._texts = EventTextPublisher(INPUT, parameters.queue, reports, self._receipts.epoch, time.epochs)
        self._projection = ProjectionReceiver(self._texts.connections, reports)
        self._published = PublishedTopics(transport, context.definitions, parameters.queue, reports)
        lock = threading.Lock()
        self._subscribed = subscribed = SubscribedTopics(
            transport,
            context.definitions,
            reports,
            MessageProcessing(self._make_handler, lock, self._flush_after, skew, time.epochs),
            ReadingOptions(parameters.queue, MAX_DELAY_SECONDS, NO_TEXT_HINT),
            self._published.advertise_learned_types,
        )
        self._texts.start_identification(lock, subscribed.publishers)
        time.start([lock], skew.begin_epoch, self._texts.begin_epoch)
        topics = context.topics
        errors = [] if context.topics_error is None else log_error(context.topics_error)
        self._open_topics(parameters, topics, transport)
        self._subscriptions = SubscriptionReceiver(subscribed.try_to_subscribe, reports)
        # Node retalis compares it with its own value.
        self._direct = announce_direct(parameters.direct)
        InterfaceServices(transport, context.definitions, subscribed.subscribe, subscribed.unsubscribe)
        ListService(transport, subscribed.statuses, reports=reports)
        # After the services: they identify this node to node retalis once it connects; see `internode_delivery`.
        subscribed.subscribe_texts(OUTPUT, make_text_handler_factory(self._published.publish_text))
        program_status = evaluate_program(errors, [])
        expected_topics = [
            topic
            for topic, message_type in topics.subscribed
            for event in (find_action_event(message_type),)
            if event is None or event.kind == STATUS
        ]
        StartupWarnings(transport, subscribed.statuses, expected_topics)
        self._diagnostics = Diagnostics(
            transport,
            parameters.diagnostics,
            NodeHealth(subscribed.statuses, self._outputs, lambda: [program_status], _input_role),
            reports,
            parameters.hardware_id,
        )

    def _open_topics(self, parameters: Parameters, topics: Topics, transport: RospyTransport) -> None:
        direct = direct_topics(parameters.direct, topics, transport.resolve_topic)
        # Before topics are subscribed: node retalis subscribes to these itself, and each message must enter the
        # engine once.
        self._subscribed.exclude(direct)
        open_topics(self._published, self._subscribed, topics, direct)
        for topic, message_type in direct:
            self._subscribed.learn(topic, message_type)

    def _outputs(self) -> List[OutputStatus]:
        return [self._texts.status(), *self._published.statuses()]

    def _make_handler(self, decoder: Decoder, topic: str, source: MessageSource) -> MessageHandler:
        """Return the handler of a source's messages, which adds their texts to the next write."""
        if source.is_latched:
            return self._make_latched_handler(decoder, topic, source)
        write, stamp, add = make_text_writer(decoder), decoder.stamp, self._texts.add
        receipt_stamp = self._receipts.stamp

        def handle(data: bytes) -> None:
            instant = stamp(data)
            unread = (
                self._projection.unread_positions(decoder.functor)
                if len(data) > MIN_PROJECTED_BYTES
                else None
            )
            text = write_without_unread(decoder, data, unread, NOT_READ) if unread else write(data)
            add(event_text(text, receipt_stamp() if instant is None else instant))

        return handle

    def _flush_after(self, sent: Iterable[None]) -> None:
        """Convert messages that were read together, then send their texts with one write."""
        consume_and_discard(sent)
        self._texts.flush()

    def _make_latched_handler(self, decoder: Decoder, topic: str, source: MessageSource) -> MessageHandler:
        """Return the handler of a latched source's messages, which stores the last one for later receivers."""
        write, stamp, receipts = make_text_writer(decoder), decoder.stamp, self._receipts
        # Without the clock skew check, which is done.
        write_again = make_text_writer(decoder.plain or decoder)
        connection = LatchedConnection(topic, source.node, source.address)

        def handle(data: bytes) -> None:
            text = write(data)
            header_stamp = stamp(data)
            instant = receipts.stamp() if header_stamp is None else header_stamp
            epoch = receipts.epoch()

            def current_text() -> str:
                """Return the text for a node that connects later, stamped in the present clock epoch."""
                # A receipt time of a former epoch would be in the future of the present one.
                is_valid = header_stamp is not None or epoch == receipts.epoch()
                return event_text(write_again(data), instant if is_valid else receipts.stamp())

            message = connection.describe_message(data)
            self._texts.add_latched(
                event_text(text, instant), message, (topic, source.node), current_text, len(data)
            )

        return handle


def _input_role(topic: str) -> InputRole:
    return InputRole.LINK if topic == resolve(OUTPUT) else InputRole.NEEDED


def main() -> int:
    """Run the node until it is shut down; return its exit status."""

    def create_node(parameters: Parameters) -> object:
        return TextInterfaceNode(parameters) if parameters.uses_texts else ServiceNode(parameters)

    return run_node("retalis_ros_converter", create_node)
