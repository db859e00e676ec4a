"""Node ``retalis_ros_interface``: the services for input topics, and the conversion of messages if they pass as text.

By default node ``retalis`` subscribes and publishes itself, and this node only offers the services (`ServiceNode`).
With ``direct:=false``, or a list of topics, it converts messages to event texts, and output texts to messages
(`TextInterfaceNode`). It then keeps the conversion and the TCP connections to publishers out of the process of the
engine. Messages go to node ``retalis`` as texts on one topic, in the order in which they were received; outputs come
back as texts on another. Fields that the program does not read are left out of the texts (projection pushdown,
`internode_topics`).
"""

from functools import partial
from typing import Iterable, List

import rospy

from ..engine.runtime.clock_skew import ClockSkewMonitor
from ..engine.runtime.problem_reports import Reports
from ..events.dispatch.listeners import NOT_READ
from ..events.program.topic_configuration import TOPICS, Topics, direct_topics, read_topics
from ..foundation.errors import RetalisError
from ..messages.decoder import Decoder
from ..messages.event_text_writer import make_text_writer, write_without_unread
from ..messages.type_registry import Definitions
from ..prolog.syntax.event_text import event_text
from .diagnostics import Diagnostics, InputRole, NodeHealth, evaluate_program
from .installed_message_classes import installed_types
from .internode_topics import (
    INPUT,
    OUTPUT,
    InputTopicChanges,
    ProjectionReceiver,
    SubscriptionReceiver,
    announce_direct,
    subscribe,
)
from .latched_deduplication import LatchedConnection
from .node_lifecycle import run_node
from .parameters import Parameters
from .ros_interface import MessageHandler, Publisher, RosInterface, connect, consume_and_discard
from .ros_log import log_error
from .ros_time import Receipts, SimulatedTime
from .services import InterfaceServices, ListService
from .text_topics import NO_TEXT_HINT, EventTextPublisher
from .topic_statistics import OutputStatus, StartupWarnings

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
        rospy.on_shutdown(reports.sum_up)
        try:
            topics = read_topics(parameters.program / TOPICS)
        except RetalisError:
            # Node retalis reports it.
            topics = Topics()
        direct = direct_topics(parameters.direct, topics, rospy.resolve_name)
        definitions = Definitions(installed_types(), parameters.max_empty_elements)
        self._changes = InputTopicChanges(
            parameters.direct, (*topics.subscribed, *direct), definitions, reports
        )
        InterfaceServices(self._changes)
        ListService(list, reports=reports)
        self._diagnostics = Diagnostics(
            parameters.diagnostics, NodeHealth(list, list, list), parameters.hardware_id
        )


class TextInterfaceNode:
    """Node ``retalis_ros_interface`` if messages pass through it as text."""

    def __init__(self, parameters: Parameters):
        self._reports = reports = Reports()
        self._time = SimulatedTime(reports)
        skew = ClockSkewMonitor(
            reports,
            self._time.now,
            max_distance_seconds=parameters.max_skew,
            buffers_early_messages=self._time.buffers_early_messages,
        )
        rospy.on_shutdown(skew.log_counts)
        rospy.on_shutdown(reports.sum_up)
        self._receipts = Receipts(self._time.now)
        self._texts = EventTextPublisher(
            INPUT, parameters.queue, reports, self._receipts.epoch, self._time.epochs
        )
        self._unread = ProjectionReceiver(self._texts.connections, reports)
        self._interface = RosInterface(
            self._handler_factory,
            parameters.queue,
            reports,
            Definitions(installed_types(), parameters.max_empty_elements),
            self._flush_after,
            max_delay=MAX_DELAY_SECONDS,
            skew=skew,
            latched=self._latched_handler_factory,
            clock_epochs=self._time.epochs,
            loss_hint=NO_TEXT_HINT,
        )
        self._texts.start_identification(self._interface.processing_lock, self._interface.publishers)
        self._time.start([self._interface.processing_lock], skew.begin_epoch, self._texts.begin_epoch)
        errors: List[str] = []
        try:
            topics = read_topics(parameters.program / TOPICS)
        except RetalisError as error:
            errors = log_error(error)
            topics = Topics()
        direct = direct_topics(parameters.direct, topics, rospy.resolve_name)
        # Before `connect`: node retalis subscribes to these topics itself, and each message must enter the engine
        # once.
        self._interface.exclude(direct)
        connect(self._interface, topics, direct)
        for topic, message_type in direct:
            self._interface.learn(topic, message_type)
        self._subscriptions = SubscriptionReceiver(partial(subscribe, self._interface), reports)
        # Node retalis compares it with its own value.
        self._direct = announce_direct(parameters.direct)
        InterfaceServices(self._interface)
        ListService(self._interface.input_statuses, reports=reports)
        # After the services: they identify this node to node retalis as soon as it connects; see `late_joiners`.
        self._interface.subscribe_output_texts()
        program_status = evaluate_program(errors, [])
        StartupWarnings(self._interface.input_statuses, [topic for topic, _ in topics.subscribed])
        self._diagnostics = Diagnostics(
            parameters.diagnostics,
            NodeHealth(self._interface.input_statuses, self._outputs, lambda: [program_status], _input_role),
            parameters.hardware_id,
        )

    def _outputs(self) -> List[OutputStatus]:
        return [self._texts.status(), *self._interface.outputs.status()]

    def _handler_factory(self, decoder: Decoder) -> MessageHandler:
        """Return the handler of messages of a type, which adds their texts to the next write."""
        write, stamp, add = make_text_writer(decoder), decoder.stamp, self._texts.add
        receipt_stamp = self._receipts.stamp

        def handle(data: bytes) -> None:
            instant = stamp(data)
            unread = self._unread.of(decoder.functor) if len(data) > MIN_PROJECTED_BYTES else None
            text = write_without_unread(decoder, data, unread, NOT_READ) if unread else write(data)
            add(event_text(text, receipt_stamp() if instant is None else instant))

        return handle

    def _flush_after(self, sent: Iterable[None]) -> None:
        """Convert messages that were read together, then send their texts with one write."""
        consume_and_discard(sent)
        self._texts.flush()

    def _latched_handler_factory(
        self, decoder: Decoder, publisher: Publisher, connection: LatchedConnection
    ) -> MessageHandler:
        """Return the handler of a latched connection's messages, which stores the last one for later receivers."""
        write, stamp, receipts = make_text_writer(decoder), decoder.stamp, self._receipts
        # Without the clock skew check, which is done.
        write_again = make_text_writer(decoder.plain or decoder)

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
            self._texts.add_latched(event_text(text, instant), message, publisher, current_text, len(data))

        return handle


def _input_role(topic: str) -> InputRole:
    """Return the role of a topic in the program."""
    return InputRole.LINK if topic == rospy.resolve_name(OUTPUT) else InputRole.NEEDED


def main() -> int:
    """Run the node until it is shut down; return its exit status."""

    def create_node(parameters: Parameters) -> object:
        return TextInterfaceNode(parameters) if parameters.uses_texts else ServiceNode(parameters)

    return run_node("retalis_ros_converter", create_node)
