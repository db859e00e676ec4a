"""Node ``retalis``: an engine with its topics, services, diagnostics and dashboard.

The order of construction matters. The engine exists first, restored from a checkpoint if there is one; then the
program is loaded, so that subscriptions of its goals are known; then topics are subscribed. Services are offered
before the node subscribes to the texts of the interface, because they identify it as the receiver (`late_joiners`).

By default this node itself subscribes to and publishes all topics of the program. The interface node then only offers
the services for input topics; with parameter ``~embedded`` this node offers them, too. If parameter ``~direct`` is
false or a list, messages of the other topics pass as text through the interface node.
"""

import threading
import time
from functools import partial
from typing import Any, Callable, Dict, Iterable, List, Mapping, Optional, Tuple

import rospy

from ..engine.checkpoints import (
    Checkpoint,
    Checkpointer,
    CheckpointStorage,
    ProgramFiles,
    rename_refused_file,
    resume,
)
from ..engine.engine import Engine
from ..engine.program_check import explain_missing_events, explain_output_mismatch
from ..engine.runtime.clock import Alarm, Clock
from ..engine.runtime.clock_epochs import ClockEpochs
from ..engine.runtime.clock_skew import ClockSkewMonitor
from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import TOPICS, Topics, TopicType, direct_topics, read_topics
from ..explanation.event_explanations import record_origins
from ..foundation.errors import RetalisError, UsageError, format_count
from ..messages.decoder import Decoder
from ..messages.transform_messages import TRANSFORM_TOPICS
from ..messages.type_definition import functor_name
from ..messages.type_registry import Definitions
from ..prolog.syntax.event_text import to_text
from ..prolog.terms.types import CompoundTerm, Term, atom
from .diagnostics import (
    DEFAULT_LATE_SECONDS,
    Diagnostics,
    EngineHealth,
    Health,
    InputRole,
    NodeHealth,
    evaluate_program,
)
from .first_outputs import OutputRelay
from .installed_message_classes import installed_types
from .internode_topics import (
    INPUT,
    OUTPUT,
    DynamicSubscriptions,
    InputTopicChangesReceiver,
    ProjectionPublisher,
    SubscriptionPublisher,
    resolve,
    resolve_subscribable_topic,
    subscribe,
)
from .latched_deduplication import LatchedConnection, LatchedMessageDeduplicator
from .node_dashboard import NodeDashboard
from .node_lifecycle import run_node
from .parameters import DEFAULT_WATCHDOG_SECONDS, Parameters
from .ros_interface import (
    OUTPUT_EVENT,
    MessageHandler,
    Publisher,
    RosInterface,
    UntypedTopicWarnings,
    connect,
)
from .ros_log import log_counts, log_error, print_goal_output
from .ros_time import Receipts, SimulatedTime, ros_now
from .services import (
    EngineServices,
    InterfaceServices,
    ListService,
    QueryServices,
    ReloadService,
    RuleServices,
)
from .text_topics import EventTextMirror, OutputTextPublisher
from .tf2_buffer import choose_buffer
from .topic_statistics import OutputStatus, StartupWarnings

MAX_EPOCH_WAIT_SECONDS = 10.0
"""Longest delay in seconds until the engine enters a new clock epoch.

A full queue may have dropped the announcement of the epoch.
"""


MAX_INTERFACE_WAIT_SECONDS = 5.0
"""Longest wait in seconds for the interface before alarms run that became due while the node was not running."""


class CheckpointFile:
    """File of parameter ``~checkpoint``, if it is set: restored at the start, then written periodically.

    A file that does not fit the program is renamed, and the node starts without state.

    Args:
        parameters: parameters of the node.
        reports: receives the errors of writing.

    Attributes:
        resumed: whether the engine was restored from the file, with its program loaded.
    """

    def __init__(self, parameters: Parameters, reports: Reports):
        self._parameters = parameters
        self._reports = reports
        self.resumed = False
        self._is_usable = parameters.checkpoint is not None
        self._files: Optional[ProgramFiles] = None

    def create_engine(self, clock: Callable[[], Clock], definitions: Definitions) -> Engine:
        """Return the engine of the node: restored from the file, or a new one.

        Args:
            clock: creates a clock; called again if restoring fails.
            definitions: known message types.
        """
        parameters = self._parameters
        path = parameters.checkpoint
        if path is not None:
            try:
                restored = resume(
                    path, parameters.program, clock(), parameters.settings, self._reports, definitions
                )
            except RetalisError as error:
                self._rename_unusable(error)
                restored = None
            if restored is not None:
                self.resumed = True
                self._files = restored[1].files
                self._log_restored(*restored)
                return restored[0]
        return Engine(clock(), parameters.settings, self._reports, definitions)

    def _rename_unusable(self, error: RetalisError) -> None:
        path = self._parameters.checkpoint
        assert path is not None
        try:
            outcome = f"the file is kept as {rename_refused_file(path)}"
        except RetalisError as rename_error:
            outcome = f"{rename_error.message}, so no state is kept"
            self._is_usable = False
        rospy.logwarn(
            "%s is not restored: %s: the node starts without state; %s", path, error.message, outcome
        )

    def _log_restored(self, engine: Engine, restored: Checkpoint) -> None:
        records = sum(len(entry.memory) for entry in engine.knowledge.memories)
        rospy.loginfo(
            "restored from %s, written %.1f s ago: %s with %s, %s, %s",
            self._parameters.checkpoint,
            time.time() - restored.written_at,
            engine.summary(),
            format_count(records, "record"),
            format_count(engine.rules.match_count, "partial match", "partial matches"),
            format_count(len(engine.knowledge.pending_queries), "waiting query", "waiting queries"),
        )

    def start_writing(self, engine: Engine) -> None:
        """Start to write the engine's state periodically, until the node ends."""
        path = self._parameters.checkpoint
        if path is None or not self._is_usable:
            return
        try:
            storage = CheckpointStorage(path)
        except RetalisError as error:
            rospy.logerr("parameter ~checkpoint: %s", error.message)
            return
        # The files that the restored program was read from, which may have changed since.
        checkpointer = Checkpointer(
            engine, storage, self._parameters.program, self._reports, files=self._files
        )
        checkpointer.start()
        rospy.on_shutdown(checkpointer.stop)


class RosClock(Clock):
    """ROS time, simulated or not, with alarms that wake the engine.

    Attributes:
        engine: the engine to wake.
        resumed: whether the engine continues from a checkpoint, and simulated time is still unknown.
    """

    def __init__(self, epochs: Optional[ClockEpochs] = None) -> None:
        super().__init__(ros_now if epochs is None else lambda: self._time_of_epoch(epochs))
        self._epoch = 0
        self.resumed = False
        self.engine: Optional[Engine] = None
        self._timer: Optional[rospy.Timer] = None
        self._timer_instant: Optional[int] = None

    def _time_of_epoch(self, epochs: ClockEpochs) -> int:
        """Return the time of the engine's epoch; messages of an older epoch may still be queued."""
        if self._epoch != epochs.epoch and time.monotonic() - epochs.epoch_start > MAX_EPOCH_WAIT_SECONDS:
            self._epoch = epochs.epoch
        now = epochs.now(self._epoch)
        if self.resumed and not now:
            # Without a message on /clock, time is 0, which is not a jump back.
            return self._newest
        self.resumed = False
        return now

    def begin_epoch(self, epoch: int) -> None:
        """Set the engine's clock epoch."""
        self._epoch = epoch

    def call_at(self, instant: int, alarm: Alarm) -> None:
        """Schedule ``alarm`` for an instant of ROS time in nanoseconds."""
        super().call_at(instant, alarm)
        self._set_timer()

    def put_back(self, instant: int, order: int, alarm: Alarm) -> None:
        """Schedule ``alarm`` with the order that it had in another clock; see `call_at`."""
        super().put_back(instant, order, alarm)
        self._set_timer()

    def due(self, until: Optional[int] = None) -> Optional[Tuple[int, Alarm]]:
        """Remove and return the next due alarm; if there is none, start the timer for the next one.

        The timer is started here, in the engine's thread, and not when it fires: a busy engine would be called again
        and again for the same alarm.
        """
        due_alarm = super().due(until)
        if due_alarm is None:
            self._set_timer()
        return due_alarm

    def _set_timer(self) -> None:
        """Start a timer for the earliest alarm, in place of a later one.

        Without an engine to wake, nothing is started: an engine that continues from a checkpoint schedules its alarms
        earlier, when ROS time may be unknown, too.
        """
        if self.engine is None:
            return
        instant = self.next_alarm()
        # `_wake` may reset both in another thread.
        timer, timer_instant = self._timer, self._timer_instant
        if instant is None or (timer_instant is not None and timer_instant <= instant):
            return
        if timer is not None:
            timer.shutdown()
        self._timer_instant = instant
        # At least 1 ms: rospy rejects negative durations, and the alarm may be due by now.
        delay = max(1_000_000, instant - self.now())
        self._timer = rospy.Timer(rospy.Duration.from_sec(delay / 1e9), self._wake, oneshot=True, reset=True)

    def _wake(self, event: object) -> None:
        self._timer = self._timer_instant = None
        if self.engine is not None:
            self.engine.advance()


class RetalisNode:
    """Node ``retalis``, constructed from its parameters."""

    def __init__(self, parameters: Parameters):
        settings = parameters.settings._replace(transform_buffer=choose_buffer())
        self._parameters = parameters = parameters._replace(settings=settings)
        self._errors: List[str] = []
        self._program_warnings: List[str] = []
        self._reports = Reports()
        self._time = SimulatedTime(self._reports)
        definitions = Definitions(installed_types(), parameters.max_empty_elements)
        checkpoint_file = CheckpointFile(parameters, self._reports)
        self.engine = checkpoint_file.create_engine(lambda: RosClock(self._time.epochs), definitions)
        print_goal_output(self.engine.logic)
        # Now the engine can be woken, and its alarms get a timer.
        clock: Any = self.engine.clock
        clock.engine, clock.resumed = self.engine, checkpoint_file.resumed
        skew = ClockSkewMonitor(
            self._reports,
            self._time.now,
            max_distance_seconds=parameters.max_skew,
            buffers_early_messages=self._time.buffers_early_messages,
        )
        rospy.on_shutdown(skew.log_counts)
        rospy.on_shutdown(self._reports.sum_up)
        if parameters.explain:
            record_origins(self.engine)
        topics = self._read_topics()
        direct = direct_topics(parameters.direct, topics, rospy.resolve_name)
        # Before the program is loaded: its goals may emit events, and subscribe to topics, which are queued until the
        # interface exists.
        outputs = OutputRelay(parameters.queue, self._reports)
        self.engine.on_output(outputs)
        subscriptions = DynamicSubscriptions()
        input_topics = self.engine.input_topics
        input_topics.set_subscriber(subscriptions.request, topics, direct, resolve_subscribable_topic)
        if not checkpoint_file.resumed:
            self._load()
        epochs = self._time.epochs
        self._latched = LatchedMessageDeduplicator(int if epochs is None else lambda: epochs.epoch)
        self._event_texts = None if parameters.uses_texts else self._make_event_mirror()
        self._texts = self._make_output_publisher(topics)
        self._interface = RosInterface(
            self._handler_factory,
            parameters.queue,
            self._reports,
            definitions,
            self.engine.post_each,
            skew=skew,
            latched=self._latched_handler_factory,
            clock_epochs=epochs,
        )
        self._untyped_topics = UntypedTopicWarnings((topic for topic, _ in topics.published), self._reports)
        self._log_mistakes(topics)
        receivers = [self._send_text]
        if parameters.uses_texts:
            ProjectionPublisher(self.engine)
        else:
            receivers.append(lambda term, topic, name: self._interface.outputs.publish(term, topic))
            connect(self._interface, topics, direct)
            self._interface.subscribe_output_texts()
        self.engine.do(lambda: outputs.start(*receivers))
        transforms = self.engine.knowledge.transforms
        transforms.require_if_mentioned(self.engine.rules.terms())
        transforms.set_feed(self._start_transform_feed)
        for topic, message_type in direct:
            self._subscribe(topic, message_type, topics.event_name_of(topic, rospy.resolve_name))
        self._connect_interface_node(subscriptions)
        types = {rospy.resolve_name(topic): message_type for topic, message_type in topics.published}
        EngineServices(
            self.engine,
            self._untyped_topics,
            lambda pattern: self._explain_missing_source(pattern, topics, direct),
            lambda goal, topic: self._explain_type_mismatch(goal, topic, types, definitions),
        )
        QueryServices(self.engine)
        RuleServices(self.engine)
        ReloadService(
            self.engine, parameters.program, parameters.settings.write_folders, topics, self._on_reload
        )
        ListService(self._interface.input_statuses, self.engine.status)
        text_lock = self._interface.subscribe_texts(INPUT, self.engine.post_text, epochs, self._latched)
        self._time.start(
            [self._interface.processing_lock, text_lock],
            skew.begin_epoch,
            lambda end: self._schedule_epoch(clock),
        )
        rospy.loginfo("%s: %s", parameters.program, self.engine.summary())
        StartupWarnings(
            self._interface.input_statuses,
            self._named_topics(input_topics.merge_with(topics)),
            check_clock=True,
        )
        self._diagnostics = Diagnostics(
            parameters.diagnostics,
            NodeHealth(
                self._interface.input_statuses,
                self._output_statuses,
                self._make_engine_health(),
                self._make_role_lookup(topics, direct),
            ),
            parameters.hardware_id,
        )
        self._dashboard = NodeDashboard(
            parameters.dashboard,
            parameters.dashboard_queries,
            self.engine,
            self._interface.input_statuses,
            [*topics.subscribed, *direct],
            lambda: input_topics.merge_with(topics).events,
        )
        checkpoint_file.start_writing(self.engine)
        if checkpoint_file.resumed:
            threading.Thread(target=self._run_missed_alarms, daemon=True).start()

    def _connect_interface_node(self, subscriptions: DynamicSubscriptions) -> None:
        """Start to exchange the topics of goals and services with the interface node, if there is one."""
        parameters, interface = self._parameters, self._interface
        if parameters.embedded:
            InterfaceServices(interface)
            subscriptions.start(partial(subscribe, interface))
            return
        publish = SubscriptionPublisher().publish_added
        if parameters.uses_texts:
            subscriptions.start(publish)
        else:
            subscriptions.start(partial(subscribe, interface), publish)
        self._input_changes = InputTopicChangesReceiver(
            None if parameters.uses_texts else interface, parameters.direct, self._reports
        )

    def _start_transform_feed(self) -> None:
        """Subscribe to the topics of transforms, because the program reads transforms.

        A goal may be the first that does, and must not wait for the master.
        """
        threading.Thread(target=self._subscribe_transforms, daemon=True).start()

    def _subscribe_transforms(self) -> None:
        engine = self.engine
        process_input, post_each = engine.event_input.process_input, engine.executor.post_each
        rospy.loginfo(
            "the program reads transforms: %s are subscribed, with a history of %g s",
            " and ".join(map(rospy.resolve_name, TRANSFORM_TOPICS)),
            engine.settings.tf_cache,
        )
        self._interface.subscribe_transforms(lambda messages: post_each(process_input, messages))

    def _run_missed_alarms(self) -> None:
        """Run the alarms that became due while the node was not running, after the interface has connected."""
        end = time.monotonic() + MAX_INTERFACE_WAIT_SECONDS
        while self._parameters.uses_texts and not self._texts.connections() and time.monotonic() < end:
            time.sleep(0.05)
        self.engine.advance()

    def _schedule_epoch(self, clock: RosClock) -> None:
        """Enter a new clock epoch after the engine has processed its queue, which belongs to the former one."""
        if self._time.epochs is not None:
            self.engine.advance(partial(clock.begin_epoch, self._time.epochs.epoch))

    def _make_engine_health(self) -> Callable[[], List[Health]]:
        settings = self._parameters.settings
        engine_health = EngineHealth(
            settings.watchdog or DEFAULT_WATCHDOG_SECONDS, settings.limits.seconds or DEFAULT_LATE_SECONDS
        )

        def evaluate() -> List[Health]:
            status = self.engine.status()
            status = status._replace(
                errors=status.errors + log_counts.errors, warnings=status.warnings + log_counts.warnings
            )
            return [
                *engine_health.evaluate(time.monotonic(), status),
                evaluate_program(list(self._errors), list(self._program_warnings)),
            ]

        return evaluate

    def _make_role_lookup(self, topics: Topics, direct: Iterable[TopicType]) -> Callable[[str], InputRole]:
        """Return a function from a topic to its present role in the program, whose rules may change."""
        uses_texts, is_read = self._parameters.uses_texts, self.engine.dispatcher.has_listener_for_name
        resolve_name = rospy.resolve_name
        named_topics = set(map(resolve_name, self._named_topics(topics)))
        # Topics that the node subscribes to by default, with the names of their events.
        default_events = {
            resolve_name(topic): topics.event_name_of(topic, resolve_name) or functor_name(message_type)
            for topic, message_type in direct
            if resolve_name(topic) not in named_topics
        }
        text_topics = {resolve_name(INPUT), resolve_name(OUTPUT)}
        transforms = self.engine.knowledge.transforms
        # A robot need not have static transforms.
        transform_roles: Dict[str, InputRole] = dict(
            zip(map(resolve_name, TRANSFORM_TOPICS), (InputRole.NEEDED, InputRole.OPTIONAL))
        )

        def get_role(topic: str) -> InputRole:
            if topic in text_topics:
                return InputRole.LINK if uses_texts else InputRole.OPTIONAL
            if transforms.is_required and topic in transform_roles:
                return transform_roles[topic]
            event = default_events.get(topic)
            return InputRole.NEEDED if event is None or is_read(event) else InputRole.UNREAD

        return get_role

    def _output_statuses(self) -> List[OutputStatus]:
        event_texts = [] if self._event_texts is None else [self._event_texts.status()]
        return [self._texts.status(), *event_texts, *self._interface.outputs.status()]

    def _on_reload(self, topics: Topics) -> None:
        self._errors.clear()
        self._program_warnings.clear()
        engine = self.engine
        engine.do(lambda: engine.knowledge.transforms.require_if_mentioned(engine.rules.terms()))
        self._log_mistakes(topics)

    def _log_mistakes(self, topics: Topics) -> None:
        """Log probable mistakes in the loaded program."""
        self._untyped_topics.mark_reported(self.engine.output_topics())
        # Separate definitions, which are freed afterwards: the checks load types that the node does not need.
        definitions = Definitions(installed_types(include_rosbags=False))
        direct = direct_topics(self._parameters.direct, topics, rospy.resolve_name)
        for warning in self.engine.warnings(self._parameters.program, definitions, topics, direct):
            self._program_warnings.append(warning.brief())
            rospy.logwarn("%s", warning)

    def _named_topics(self, topics: Topics) -> List[str]:
        """Return the topics of this node that its program or parameters name, without those subscribed by default."""
        direct = self._parameters.direct
        topic_types = [*(() if self._parameters.uses_texts else topics.subscribed)]
        topic_types += direct if isinstance(direct, tuple) else ()
        return [topic for topic, _ in topic_types]

    def _explain_missing_source(self, pattern: Term, topics: Topics, direct: Iterable[TopicType]) -> str:
        """Return the reason why no events of a pattern are expected; "" if there may be some."""
        definitions = Definitions(installed_types(include_rosbags=False))
        return explain_missing_events(self.engine, pattern, definitions, topics, direct)

    def _explain_type_mismatch(
        self, goal: CompoundTerm, topic: str, types: Mapping[str, str], definitions: Definitions
    ) -> str:
        """Return the reason why no output of a subscription fits its topic's type; "" if some may."""
        try:
            message_type = types.get(resolve(topic))
        except UsageError:
            # A name for other nodes only.
            message_type = None
        if message_type is None:
            return ""
        # Types that publishers define are in the node's definitions; `find` there would load the types of rosbags.
        type_definitions = (
            definitions
            if definitions.known(message_type)
            else Definitions(installed_types(include_rosbags=False))
        )
        return explain_output_mismatch(goal, topic, message_type, type_definitions)

    def _load(self) -> None:
        try:
            self.engine.load_program(self._parameters.program)
        except RetalisError as error:
            self._errors += log_error(error)

    def _read_topics(self) -> Topics:
        try:
            return read_topics(self._parameters.program / TOPICS)
        except RetalisError as error:
            if not self._parameters.uses_texts:
                # Otherwise the interface node reports it.
                self._errors += log_error(error)
            return Topics()

    def _subscribe(self, topic: str, message_type: str, event: str) -> None:
        try:
            self._interface.subscribe(topic, message_type, event)
        except RetalisError as error:
            rospy.logerr("parameter ~direct: %s", error)

    def _handler_factory(self, decoder: Decoder) -> MessageHandler:
        """Return the handler of messages of a type, which returns the event and its instant."""
        decode, stamp = decoder.decode, decoder.stamp
        if self._event_texts is None:
            return lambda data: (decode(data), stamp(data))
        send_text = self._event_texts.make_sender(decoder)

        def handle(data: bytes) -> Tuple[Term, Optional[int]]:
            event, instant = decode(data), stamp(data)
            send_text(data, instant)
            return event, instant

        return handle

    def _latched_handler_factory(
        self, decoder: Decoder, publisher: Publisher, connection: LatchedConnection
    ) -> MessageHandler:
        """Return the handler of latched messages, which skips messages that the engine has processed already."""
        decode, stamp, deduplicator = decoder.decode, decoder.stamp, self._latched
        send_text = None if self._event_texts is None else self._event_texts.make_sender(decoder)

        def handle(data: bytes) -> Any:
            # Before `record_message`, which records the message as processed: decoding may fail, or the message may
            # belong to the next clock epoch.
            event, instant = decode(data), stamp(data)
            if deduplicator.record_message(connection.describe_message(data)):
                return None
            if send_text is not None:
                send_text(data, instant)
            return event, instant

        return handle

    def _make_output_publisher(self, topics: Topics) -> OutputTextPublisher:
        """Return the publisher of output texts; if this node publishes the messages, no other node requires them."""
        if not self._parameters.uses_texts:
            topics = Topics()
        published = [topic for topic, _ in topics.published]
        return OutputTextPublisher(OUTPUT, self._parameters.queue, self._reports, published, topics.latched)

    def _make_event_mirror(self) -> EventTextMirror:
        """Return the publisher of event texts for nodes that subscribe to `INPUT`."""
        return EventTextMirror(INPUT, self._parameters.queue, self._reports, Receipts(self._time.now).stamp)

    def _send_text(self, term: Term, topic: str, name: Term) -> None:
        # A rule may have added a subscription to a new topic.
        self._untyped_topics.check(topic)
        self._texts.send(topic, lambda: to_text((OUTPUT_EVENT, term, atom(topic), name)))


def main() -> int:
    """Run the node until it is shut down; return its exit status."""
    return run_node("retalis", RetalisNode)
