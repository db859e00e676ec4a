"""Test cases on a running node: command ``test --node``.

The cases run one after the other. Before the first one, an event is sent to the node until its output returns: then
the topics of the texts are connected in both directions.
"""

import argparse
import os
from contextlib import contextmanager
from queue import Empty, Full, Queue
from time import monotonic_ns
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from ..events.language.rule_labels import rule_title
from ..foundation.errors import UsageError
from ..foundation.interrupts import exit_by_exception, interruptible
from ..foundation.ros_name_checks import ros1_type_name, strip_slashes
from ..foundation.source_places import line_of
from ..messages.type_definition import Definition
from ..messages.type_registry import Definitions
from ..node.text_exchange import INPUT, OUTPUT, TEXT_TYPE, WATCH, text_serializer
from ..prolog.syntax.event_text import EventReader
from ..prolog.syntax.operators import Operators
from ..prolog.terms.timestamps import SECOND
from ..testing.case_definition import Case
from ..testing.case_run import CaseResult
from ..testing.live_run import LiveNode, ProblemCounts, ReceivedText, parse_output, run_live_case
from .command_options import message_folders
from .node_client import ClientConnection, NodeClient, require_ok
from .node_client_commands import start_node
from .optional_ros_imports import connect_client

MAX_QUEUED_TEXTS = 100_000
"""Limit for received texts that have not been compared; further ones are dropped."""

CONNECTION_PROBE_SECONDS = 10.0
"""Seconds after which a node that returns no output of an event counts as unreachable."""

_PROBE_INTERVAL = SECOND // 5
"""Time in nanoseconds after which an event that has not returned is sent again."""

_MAX_LISTED = 1000
"""Maximum number of rules and topics that are read from the node."""


def run_live_cases(cases: Sequence[Case], options: argparse.Namespace) -> Iterator[Tuple[int, CaseResult]]:
    """Run cases on the node of the options, and yield the position of each case with its result.

    Args:
        cases: cases that `check_live_case` accepts.
        options: options of the command ``test``.

    Raises:
        UsageError: if the node does not exist, or does not answer.
    """
    connection = connect_client()
    try:
        node = NodeClient(connection, options.node)
        definitions = Definitions(connection.installed_types(message_folders(options)))
        # Messages of the middleware are not part of the output.
        with start_node(connection, "retalis_test"), exit_by_exception():
            session = _NodeSession(connection, node, definitions)
            session.connect()
            types = session.input_types()
            for number, case in enumerate(cases):
                yield number, run_live_case(case, session.open, definitions, types, options.seconds)
    finally:
        connection.end()


class _NodeSession:
    """A node during the run of several cases; see `LiveNode`.

    Args:
        connection: connection to the middleware, which has been made a node.
        definitions: known message types.

    Attributes:
        start: see `LiveNode`.
        watch_topic: see `LiveNode`.
        format: see `LiveNode`.
    """

    def __init__(self, connection: ClientConnection, node: NodeClient, definitions: Definitions):
        self._connection = connection
        self._node = node
        self._definitions = definitions
        self._namespace = node.name.rpartition("/")[0]
        self._received: Queue[Tuple[int, str]] = Queue(maxsize=MAX_QUEUED_TEXTS)
        self._input_topic = ""
        self._publishers: Dict[str, Callable[[bytes], object]] = {}
        self._serialize = text_serializer(connection.format)
        self._started = 0
        self.start = 0
        self.watch_topic = f"{WATCH}{os.getpid()}"
        self.format = connection.format

    def connect(self) -> None:
        """Connect the topics of texts, and wait until an event that is sent to the node returns.

        Raises:
            UsageError: if none returns.
        """
        name = self._node.name
        output_topic = next(
            (topic for topic in self._node.published_topics if topic.endswith(f"/{OUTPUT}")), None
        )
        if output_topic is None:
            raise UsageError(f"node {name} publishes no {OUTPUT}")
        self._input_topic = output_topic[: -len(OUTPUT)] + INPUT
        self._connection.subscribe(output_topic, self._add_text)
        self._advertise(self._input_topic, self._definitions.find(TEXT_TYPE))
        self._begin()
        reader = EventReader(Operators.prolog())
        probe = f"retalis_test_{os.getpid()}"
        with self._requested_events([probe]):
            while self.now() < CONNECTION_PROBE_SECONDS * SECOND:
                self.send_event(f"event({probe})")
                received = self.receive(self.now() + _PROBE_INTERVAL)
                while received is not None:
                    output = parse_output(received.text, reader)
                    if output is not None and output[1] == self.watch_topic:
                        return
                    received = self.receive(self.now())
        raise UsageError(
            f"node {name} does not return an event within {CONNECTION_PROBE_SECONDS:g} s: "
            "expected a node that processes events"
        )

    def _add_text(self, text: str) -> None:
        try:
            self._received.put_nowait((monotonic_ns(), text))
        except Full:
            # The run compares fewer outputs than the queue holds.
            return

    def input_types(self) -> Dict[str, str]:
        """Return the types of the node's input topics, by full and by relative name without slashes at the ends."""
        types: Dict[str, str] = {}
        for topic in self._list_contents().inputs:
            names = [topic.topic]
            if topic.topic.startswith(f"{self._namespace}/"):
                names.append(topic.topic[len(self._namespace) :])
            types.update((strip_slashes(name), ros1_type_name(topic.type)) for name in names)
        return types

    def _list_contents(self) -> Any:
        return require_ok(self._node.call("list", "List", most=_MAX_LISTED))

    @contextmanager
    def open(self, patterns: Sequence[str], topics: Mapping[str, Definition]) -> Iterator[LiveNode]:
        """Start the run of a case; see `OpenNode`."""
        for topic, definition in topics.items():
            self._advertise(self._resolve_topic(topic), definition)
        with self._requested_events(patterns):
            self._begin()
            yield self

    def _begin(self) -> None:
        """Drop the texts of the time before, and start the clock of a run."""
        self.start = int(self._list_contents().now)
        while not self._received.empty():
            self._received.get_nowait()
        self._started = monotonic_ns()

    def _advertise(self, topic: str, definition: Definition) -> None:
        if topic not in self._publishers:
            self._publishers[topic] = self._connection.advertise(topic, definition)

    def _resolve_topic(self, topic: str) -> str:
        """Return the full name of a topic, which may be relative to the namespace of the node."""
        return topic if topic.startswith("/") else f"{self._namespace}/{topic}"

    @contextmanager
    def _requested_events(self, patterns: Sequence[str]) -> Iterator[None]:
        """Add subscriptions to the node that publish events as text, and delete them at the end."""
        ids: List[str] = []
        try:
            for number, pattern in enumerate(patterns):
                fields = {
                    "event": pattern,
                    "conditions": "",
                    "format": "_",
                    "topic": self.watch_topic,
                    "id": str(number),
                }
                require_ok(
                    self._node.call_relative_service(
                        "add_output_subscription", "AddOutputSubscription", **fields
                    )
                )
                ids.append(str(number))
            yield
        finally:
            for subscription_id in ids:
                self._node.call_relative_service(
                    "delete_output_subscription",
                    "DeleteOutputSubscription",
                    topic=self.watch_topic,
                    id=subscription_id,
                )

    def now(self) -> int:
        """See `LiveNode`."""
        return monotonic_ns() - self._started

    def receive(self, until: int) -> Optional[ReceivedText]:
        """See `LiveNode`."""
        try:
            with interruptible():
                instant, text = self._received.get(timeout=max(0, until - self.now()) / SECOND)
        except Empty:
            return None
        return ReceivedText(instant - self._started, text)

    def send_event(self, text: str) -> None:
        """See `LiveNode`."""
        self._publishers[self._input_topic](self._serialize(text))

    def send_message(self, topic: str, message: bytes) -> None:
        """See `LiveNode`."""
        self._publishers[self._resolve_topic(topic)](message)

    def query(self, goal: str, max_solutions: int) -> List[Dict[str, str]]:
        """See `LiveNode`."""
        response = require_ok(self._node.call("query", "Query", goal=goal, max_solutions=max_solutions))
        return [
            {binding.name: binding.text for binding in solution.bindings} for solution in response.solutions
        ]

    def count_problems(self) -> ProblemCounts:
        """See `LiveNode`."""
        contents = self._list_contents()
        rule_errors = {
            rule_title(rule.name, line_of(rule.place)): int(rule.errors) for rule in contents.rules
        }
        return ProblemCounts(int(contents.errors), int(contents.warnings), rule_errors)
