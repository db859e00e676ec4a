"""A running program on a transport: its engine with topics, services, diagnostics and dashboard.

`ProgramHost` is constructed in this order: the engine, restored from a checkpoint if there is one; the program, so
that the subscriptions of its goals are known; the topics; the services, for which other nodes may look before they
send texts; the texts; time; reports on the state.
"""

import logging
import threading
import time
from typing import Callable, ContextManager, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from ..engine.engine import Engine
from ..engine.event_input import TopicRequest
from ..engine.program_check import explain_missing_events, explain_output_mismatch
from ..engine.runtime.clock_skew import ClockSkewMonitor
from ..events.program.topic_configuration import Topics, TopicType
from ..explanation.event_and_output_explanations import record_origins
from ..foundation.errors import RetalisError, UsageError
from ..messages.action_events import CANCEL, GOAL, STATUS, find_action_event
from ..messages.decoder import Decoder
from ..messages.transform_messages import TRANSFORM_TOPICS
from ..messages.type_registry import Definitions
from ..prolog.terms.types import CompoundTerm, Term
from .checkpoint_file import CheckpointFile
from .diagnostics import (
    DEFAULT_LATE_SECONDS,
    Diagnostics,
    EngineHealth,
    Health,
    InputRole,
    NodeHealth,
    evaluate_program,
)
from .goal_output import log_counts, log_error, print_goal_output
from .graph_watch import GraphWatch
from .latched_deduplication import LatchedConnection
from .node_dashboard import NodeDashboard
from .output_forwarding import OutputForwarding
from .parameters import DEFAULT_WATCHDOG_SECONDS, Parameters
from .program_host_context import HostContext
from .published_topics import OutputRelay, TextOnlyOutputs
from .running_program import OutputCallbacks, ProgramContext, RunningProgram, make_event_handler
from .service_caller import ServiceCaller
from .services import (
    EngineServices,
    InterfaceServices,
    ListService,
    QueryServices,
    ReloadService,
    RuleServices,
)
from .subscribed_topics import (
    MessageHandler,
    MessageProcessing,
    ReadingOptions,
    RequestQueue,
    SubscribedTopics,
)
from .text_exchange import INPUT, OUTPUT, TextExchange
from .topic_statistics import OutputStatus, StartupWarnings
from .transport import MessageSource
from .transport_time import HostClock, ReceiptStamps

log = logging.getLogger("retalis")

MAX_INTERFACE_WAIT_SECONDS = 5.0
"""Longest wait in seconds for the interface before alarms run that became due while the node was not running."""

_INTERFACE_CHECK_SECONDS = 0.05


ConnectInterface = Callable[[Engine, SubscribedTopics], Sequence[Callable[[TopicRequest], object]]]
"""Starts the exchange with the node that offers the services for input topics in place of the host.

Returns the functions to call for each topic that a goal requests."""


class ProgramHost:
    """A running program.

    Args:
        context: transport, parameters and what the parts share.
        texts: exchange of events and outputs as text.
        connect_interface: connects the node that offers the services for input topics; None if the host does.
    """

    def __init__(
        self,
        context: HostContext,
        texts: TextExchange,
        connect_interface: Optional[ConnectInterface] = None,
    ):
        transport, parameters = context.transport, context.parameters
        self._context = context
        self._transport = transport
        self._parameters = parameters
        self._reports = context.reports
        self._texts = texts
        self._errors: List[str] = []
        self._program_warnings: List[str] = []

        checkpoint = CheckpointFile(parameters.checkpoint, parameters.program, self._reports)
        self.engine = checkpoint.create_engine(
            lambda: HostClock(transport, context.time.epochs),
            parameters.settings._replace(transform_buffer=transport.create_transform_buffer),
            context.definitions,
        )
        self._clock = self._start_clock(checkpoint.is_resumed)
        self._service_caller = ServiceCaller(transport, parameters.allow_services)
        self.engine.on_service_call(self._service_caller.call, transport.format)
        try:
            transport.refresh_ros_parameters()
        except RetalisError as error:
            self._errors += log_error(error)
        self.engine.on_parameter_read(transport.ros_parameter)
        print_goal_output(self.engine.program.logic, transport.on_shutdown)
        if parameters.explain:
            record_origins(self.engine)

        self._topics = context.topics
        # If messages pass as text, the interface node reports it.
        if context.topics_error is not None and not parameters.uses_texts:
            self._errors += log_error(context.topics_error)
        self._skew = skew = context.make_skew_monitor()
        self._processing = MessageProcessing(
            self._make_handler,
            threading.Lock(),
            skew=skew,
            clock_epochs=context.time.epochs,
            stamp_receipt=None if transport.is_time_simulated else ReceiptStamps(transport.now).stamp,
        )
        self._stop_checkpoints: Callable[[], object] = lambda: None
        self._forwarding = self._create_forwarding()
        # They store the outputs and requested topics of goals until topics can be opened.
        outputs = OutputRelay(parameters.queue, self._reports)
        requests = RequestQueue(transport.on_shutdown)
        self._program = RunningProgram(
            ProgramContext(transport, context.definitions, self._reports, self._topics, parameters.direct),
            self.engine,
            self._processing,
            ReadingOptions(parameters.queue),
            OutputCallbacks(outputs, TextOnlyOutputs(self._reports, self._is_forwarded).report),
        )
        self._program.accept_requests(requests.put)
        self._published, self._subscribed = self._program.published, self._program.subscribed
        if not checkpoint.is_resumed:
            self._load()
        self._log_mistakes(self._topics)
        self._open_topics(outputs, requests, connect_interface)
        self._offer_services(connect_interface is None)
        locks = texts.receive_events(self._subscribed.subscribe_texts, self.engine.post_text)
        self._follow_time(skew, locks)
        log.info("%s: %s", parameters.program, self.engine.summary())
        self._report_state()
        checkpoint.start_writing(self.engine, self._on_checkpoints_end)
        if checkpoint.is_resumed:
            threading.Thread(target=self._continue_after_pause, daemon=True).start()

    def change_parameters(self, parameters: Parameters) -> None:
        """Apply other values of the parameters that can be changed, all or none; see `AdjustableParameters`.

        Raises:
            RetalisError: if the engine does not end a callback in time, or the topic of diagnostics cannot be
                published.
        """
        # Both may fail, and the following steps cannot.
        self._diagnostics.prepare(parameters.diagnostics)
        self.engine.change_settings(
            parameters.settings._replace(transform_buffer=self.engine.settings.transform_buffer)
        )
        self._parameters = parameters
        self._skew.set_max_distance(parameters.max_skew)
        self._diagnostics.set_options(parameters.diagnostics, parameters.hardware_id)
        self._engine_health.set_work_limits(*_work_limits(parameters))

    def _start_clock(self, is_resumed: bool) -> HostClock:
        """Start to wake the engine, which exists from here on."""
        clock = self.engine.clock
        assert isinstance(clock, HostClock)
        clock.start(self.engine.advance, is_resumed)
        return clock

    def _create_forwarding(self) -> Optional[OutputForwarding]:
        """Return the forwarding of outputs, if a parameter requests it.

        Raises:
            UsageError: if the queue cannot be used, or paho is not installed.
        """
        options = self._parameters.forwarding
        if options is None:
            return None
        engine, dispatcher = self.engine, self.engine.program.rules.dispatcher

        def find_interval() -> Tuple[int, int]:
            interval = dispatcher.current_interval
            if interval is None:
                # The outputs of rate operators, which their alarms emit, have no event.
                now = engine.clock.now()
                return now, now
            return interval

        forwarding = OutputForwarding(options, self._reports, self._transport.resolve_topic, find_interval)

        def stop() -> None:
            # First: the last checkpoint must not contain events whose outputs are not in the queue.
            self._stop_checkpoints()
            forwarding.stop()

        self._transport.on_shutdown(stop)
        return forwarding

    def _on_checkpoints_end(self, stop: Callable[[], object]) -> None:
        """Register the function that writes the last checkpoint; it may be called twice."""
        self._stop_checkpoints = stop
        self._transport.on_shutdown(stop)

    def _describe_forwarding(self) -> str:
        return "" if self._forwarding is None else self._forwarding.describe()

    def _is_forwarded(self, topic: str) -> bool:
        return self._forwarding is not None and self._forwarding.includes(topic)

    # ---- the program

    def _load(self) -> None:
        try:
            self.engine.load_program(self._parameters.program)
        except RetalisError as error:
            self._errors += log_error(error)

    def _log_mistakes(self, topics: Topics) -> None:
        """Log probable mistakes in the loaded program."""
        forwarding = self._parameters.forwarding
        warnings = self._program.log_mistakes(
            self._parameters.program,
            self._make_short_lived_definitions(),
            topics if forwarding is None else topics._replace(forwarded=forwarding.topics),
            self._service_caller.find_refusal,
        )
        if self._forwarding is not None:
            unused_topics = self._forwarding.check_topics(self.engine.output_topics())
            for warning in unused_topics:
                log.warning("%s", warning)
            warnings += unused_topics
        self._program_warnings += [warning.brief() for warning in warnings]

    def _make_short_lived_definitions(self) -> Definitions:
        """Return definitions that are freed after use: checks load types that the node does not need."""
        installed = self._transport.installed_types(include_rosbags=False)
        return Definitions(installed, strings=self.engine.strings)

    def _on_reload(self, topics: Topics) -> None:
        self._errors.clear()
        self._program_warnings.clear()
        self.engine.do(self._program.require_transforms)
        self._log_mistakes(topics)

    # ---- topics

    def _open_topics(
        self, outputs: OutputRelay, requests: RequestQueue, connect_interface: Optional[ConnectInterface]
    ) -> None:
        """Publish and subscribe the topics of the program; messages arrive from here on."""
        receivers = [self._send_text]
        if self._forwarding is not None:
            receivers.append(self._forwarding.forward)
        if not self._parameters.uses_texts:
            self._program.open_topics()
            self._texts.receive_outputs(self._subscribed.subscribe_texts, self._published.publish_text)
            receivers.append(lambda term, topic, name: self._published.publish(term, topic))
        self.engine.do(lambda: outputs.start(*receivers))
        self._program.start_transforms(self._start_transform_feed)
        self._program.subscribe_direct_topics()
        requests.start(
            *(
                (self._subscribed.try_to_subscribe,)
                if connect_interface is None
                else connect_interface(self.engine, self._subscribed)
            )
        )

    def _send_text(self, term: Term, topic: str, name: Term) -> None:
        if not self._is_forwarded(topic):
            # A rule may have added a subscription to a new topic.
            self._program.untyped_topics.check(topic)
        self._texts.send_output(term, topic, name)

    def _start_transform_feed(self) -> None:
        """Subscribe to the topics of transforms, because the program reads transforms.

        A goal may be the first that does, and must not wait for the middleware.
        """
        threading.Thread(target=self._subscribe_transforms, daemon=True).start()

    def _subscribe_transforms(self) -> None:
        log.info(
            "the program reads transforms: %s are subscribed, with a history of %g s",
            " and ".join(map(self._transport.resolve_topic, TRANSFORM_TOPICS)),
            self.engine.settings.tf_cache,
        )
        self._program.subscribe_transforms()

    def _make_handler(self, decoder: Decoder, topic: str, source: MessageSource) -> MessageHandler:
        """Return the handler of a source's messages, which returns the event and its instant.

        Of a latched source it skips messages that the engine has processed already.
        """
        send_text = self._texts.make_event_sender(decoder)
        connection = LatchedConnection(topic, source.node, source.address) if source.is_latched else None
        if send_text is None and connection is None:
            return make_event_handler(decoder, topic, source)
        decode, stamp, deduplicator = decoder.decode, decoder.stamp, self._context.latched

        def handle(data: bytes) -> Optional[Tuple[Term, Optional[int]]]:
            # Before `record_message`, which records the message as processed: decoding may fail, or the message may
            # belong to the next clock epoch.
            event, instant = decode(data), stamp(data)
            if connection is not None and deduplicator.record_message(connection.describe_message(data)):
                return None
            if send_text is not None:
                send_text(data, instant)
            return event, instant

        return handle

    # ---- services

    def _offer_services(self, offers_interface: bool) -> None:
        transport, engine, parameters = self._transport, self.engine, self._parameters
        if offers_interface:
            InterfaceServices(
                transport, self._context.definitions, self._subscribed.subscribe, self._subscribed.unsubscribe
            )
        types = {
            transport.resolve_topic(topic): message_type for topic, message_type in self._topics.published
        }
        EngineServices(
            transport,
            engine,
            self._program.untyped_topics,
            self._explain_missing_source,
            lambda goal, topic: self._explain_type_mismatch(goal, topic, types),
        )
        QueryServices(transport, engine)
        RuleServices(transport, engine)
        ReloadService(
            transport,
            engine,
            parameters.program,
            parameters.settings.write_folders,
            self._topics,
            self._on_reload,
        )
        ListService(transport, self._subscribed.statuses, engine.status, forwarding=self._describe_forwarding)

    def _explain_missing_source(self, pattern: Term) -> str:
        """Return the reason why no events of a pattern are expected; "" if there may be some."""
        return explain_missing_events(
            self.engine, pattern, self._make_short_lived_definitions(), self._topics, self._program.direct
        )

    def _explain_type_mismatch(self, goal: CompoundTerm, topic: str, types: Mapping[str, str]) -> str:
        """Return the reason why no output of a subscription fits its topic's type; "" if some may."""
        try:
            message_type = types.get(self._transport.resolve_topic(topic))
        except UsageError:
            # A name for other nodes only.
            message_type = None
        if message_type is None:
            return ""
        # Types that publishers define are in the node's definitions; `find` there would load the types of rosbags.
        definitions = self._context.definitions
        if not definitions.known(message_type):
            definitions = self._make_short_lived_definitions()
        return explain_output_mismatch(goal, topic, message_type, definitions)

    # ---- time

    def _follow_time(self, skew: ClockSkewMonitor, text_locks: List[ContextManager[object]]) -> None:
        def begin_epoch(previous_end: int) -> None:
            skew.begin_epoch(previous_end)
            self._subscribed.forget_goals()

        self._context.time.start(
            [self._processing.lock, *text_locks], begin_epoch, lambda end: self._schedule_epoch()
        )

    def _schedule_epoch(self) -> None:
        """Enter a new clock epoch after the engine has processed its queue, which belongs to the former one."""
        epoch = self._context.time.epoch()

        def begin_epoch() -> None:
            self._service_caller.fail_all("the time was set back before the reply")
            self._clock.begin_epoch(epoch)

        self.engine.advance(begin_epoch)

    def _continue_after_pause(self) -> None:
        """Fail calls of services and run alarms of the time without the node, after the interface has connected."""
        end = time.monotonic() + MAX_INTERFACE_WAIT_SECONDS
        while not self._texts.is_output_received() and time.monotonic() < end:
            time.sleep(_INTERFACE_CHECK_SECONDS)
        self.engine.fail_interrupted_calls()
        self.engine.advance()

    # ---- reports on the state

    def _report_state(self) -> None:
        """Start the warnings after the start, the diagnostics and the dashboard."""
        transport, parameters = self._transport, self._parameters
        StartupWarnings(
            transport,
            self._subscribed.statuses,
            self._expected_topics(self.engine.with_requested_topics(self._topics)),
        )
        self._diagnostics = Diagnostics(
            transport,
            parameters.diagnostics,
            NodeHealth(
                self._subscribed.statuses,
                self._output_statuses,
                self._make_engine_health(),
                self._make_role_lookup(),
            ),
            self._reports,
            parameters.hardware_id,
        )
        try:
            GraphWatch(transport, self._topics, self._context.definitions, self._reports)
        except RetalisError as error:
            self._errors += log_error(error)
        self._dashboard = NodeDashboard(
            transport=transport,
            reports=self._reports,
            port=parameters.dashboard,
            allow_queries=parameters.dashboard_queries,
            engine=self.engine,
            inputs=self._subscribed.statuses,
            forwarding=self._describe_forwarding,
            program_topics=[*self._topics.subscribed, *self._program.direct],
            event_names=lambda: self.engine.with_requested_topics(self._topics).events,
        )

    def _make_engine_health(self) -> Callable[[], List[Health]]:
        self._engine_health = engine_health = EngineHealth(*_work_limits(self._parameters))
        forwarding = self._forwarding

        def evaluate() -> List[Health]:
            now = time.monotonic()
            status = self.engine.status()
            status = status._replace(
                errors=status.errors + log_counts.errors, warnings=status.warnings + log_counts.warnings
            )
            return [
                *engine_health.evaluate(now, status, self._unstamped_events()),
                *([] if forwarding is None else forwarding.evaluate(now)),
                evaluate_program(list(self._errors), list(self._program_warnings)),
            ]

        return evaluate

    def _unstamped_events(self) -> Set[str]:
        """Return the names of the events whose messages have no stamp, so that their lag is not measured."""
        names: Dict[bool, Set[str]] = {True: set(), False: set()}
        topics, resolve_topic = self.engine.with_requested_topics(self._topics), self._transport.resolve_topic
        for status in self._subscribed.statuses():
            if status.messages:
                name = topics.functor_name_of(TopicType(status.topic, status.type), resolve_topic)
                names[status.lag is None].add(name)
        # Several topics may have events of one name.
        return names[True] - names[False]

    def _make_role_lookup(self) -> Callable[[str], InputRole]:
        """Return a function from a topic to its present role in the program, whose rules may change."""
        uses_texts, is_read = (
            self._parameters.uses_texts,
            self.engine.program.rules.dispatcher.has_listener_for_name,
        )
        resolve_topic = self._transport.resolve_topic
        named_topics = {resolve_topic(topic) for topic, _ in self._named_topics(self._topics)}
        events = [(topic, find_action_event(topic.type)) for topic in self._topics.subscribed]
        action_events = {
            resolve_topic(topic.topic): (event.kind, self._topics.functor_name_of(topic))
            for topic, event in events
            if event is not None
        }
        # Topics that the node subscribes to by default, with the names of their events.
        default_events = {
            resolve_topic(topic.topic): self._topics.functor_name_of(topic, resolve_topic)
            for topic in self._program.direct
            if resolve_topic(topic.topic) not in named_topics
        }
        text_topics = {resolve_topic(INPUT), resolve_topic(OUTPUT)}
        transforms = self.engine.program.knowledge.transforms
        # A robot need not have static transforms.
        transform_roles: Dict[str, InputRole] = dict(
            zip(map(resolve_topic, TRANSFORM_TOPICS), (InputRole.NEEDED, InputRole.OPTIONAL))
        )

        def get_role(topic: str) -> InputRole:
            if topic in text_topics:
                return InputRole.LINK if uses_texts else InputRole.OPTIONAL
            if transforms.is_required and topic in transform_roles:
                return transform_roles[topic]
            if topic in action_events:
                return _role_of_action_event(*action_events[topic], is_read)
            event = default_events.get(topic)
            return InputRole.NEEDED if event is None or is_read(event) else InputRole.UNREAD

        return get_role

    def _output_statuses(self) -> List[OutputStatus]:
        return [*self._texts.statuses(), *self._published.statuses()]

    def _named_topics(self, topics: Topics) -> List[TopicType]:
        """Return the topics of this node that its program or parameters name, without those subscribed by default."""
        direct = self._parameters.direct
        topic_types: List[TopicType] = [*(() if self._parameters.uses_texts else topics.subscribed)]
        return topic_types + [*(direct if isinstance(direct, tuple) else ())]

    def _expected_topics(self, topics: Topics) -> List[str]:
        """Return the named topics that should have a publisher; of an action those that the program reads."""
        is_read = self.engine.program.rules.dispatcher.has_listener_for_name
        expected: List[str] = []
        for topic in self._named_topics(topics):
            event = find_action_event(topic.type)
            if event is None or event.kind == STATUS or is_read(topics.functor_name_of(topic)):
                expected.append(topic.topic)
        return expected


def _role_of_action_event(kind: str, name: str, is_read: Callable[[str], bool]) -> InputRole:
    """Return the role of the topic of an action's event: nothing is published between goals."""
    if not is_read(name):
        return InputRole.UNREAD
    # Clients publish goals, and need not run.
    return InputRole.OPTIONAL if kind in (GOAL, CANCEL) else InputRole.LINK


def _work_limits(parameters: Parameters) -> Tuple[float, float]:
    """Return the seconds after which work in progress is a warning and an error."""
    settings = parameters.settings
    return settings.watchdog or DEFAULT_WATCHDOG_SECONDS, settings.limits.seconds or DEFAULT_LATE_SECONDS
