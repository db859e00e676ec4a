"""Commands for a running node: ``query``, ``explain``, ``list``, ``status``, ``watch``, ``reload``.

The process becomes a node only if it subscribes to topics or runs until it is interrupted (``status``, ``watch``).
"""

import argparse
import os
import shutil
import sys
from contextlib import contextmanager, redirect_stdout
from queue import Queue
from time import monotonic, sleep
from typing import IO, Any, Callable, Dict, Iterator, List, Optional, Tuple

from ..foundation.displayed_text import format_number, printable
from ..foundation.errors import RetalisError, UsageError
from ..foundation.interrupts import exit_by_exception
from ..foundation.output_files import print_json
from ..node.text_exchange import INPUT, OUTPUT, WATCH
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.term_writer import write_term, writeq
from ..prolog.terms import timestamps
from ..prolog.terms.types import deref
from . import node_status_tables
from .node_client import (
    ClientConnection,
    NodeClient,
    find_engine_nodes,
    format_solutions,
    make_dictionary,
    print_json_solutions,
    require_ok,
)
from .optional_ros_imports import connect_client

_CLEAR = "\x1b[H\x1b[J"
"""Control sequence that moves the cursor to the top of the terminal and clears the screen."""


_MAX_QUEUED_TEXTS = 10_000
"""Limit for received texts that wait to be printed by ``watch``."""

_MAX_STATUS_INTERVAL_SECONDS = 86_400
"""Limit in seconds for the interval of ``status``."""

MAX_COMPLETION_SECONDS = 1.5
"""Seconds for which the completion of a name waits for nodes."""


def run(options: argparse.Namespace) -> int:
    """Run a command; return its exit status."""
    connection = connect_client()
    try:
        return _COMMANDS[options.command](connection, options)
    finally:
        connection.end()


def _query(connection: ClientConnection, options: argparse.Namespace) -> int:
    response = require_ok(
        NodeClient(connection, options.node).call(
            "query",
            "Query",
            goal=options.goal,
            max_solutions=options.max_solutions,
            seconds=options.seconds,
            inferences=options.inferences,
            wait_for=options.wait_for,
            stamp=_to_nanoseconds(options.stamp, connection.end_of_time),
            timeout=options.timeout,
        )
    )
    if options.json:
        print_json_solutions(response)
    else:
        _print_all(map(printable, format_solutions(response)))
        if not response.solutions:
            print("false")
    if not response.complete:
        reason = (
            "the size of a response is limited"
            if len(response.solutions) < options.max_solutions
            else "see --most"
        )
        print(f"there are more solutions ({reason})", file=sys.stderr)
    return 0 if response.solutions else 1


def _to_nanoseconds(seconds: float, end_of_time: int) -> int:
    if not 0 <= seconds < end_of_time:
        raise UsageError(
            f"--stamp: expected seconds since the epoch, below {end_of_time}, found {format_number(seconds)}"
        )
    return timestamps.from_seconds(seconds)


def _explain(connection: ClientConnection, options: argparse.Namespace) -> int:
    response = require_ok(
        NodeClient(connection, options.node).call("explain", "Explain", event=options.event)
    )
    if options.json:
        print_json({"happened": response.happened, "lines": response.lines})
        return 0
    print(f"{printable(options.event)} {'happened' if response.happened else 'did not happen'}")
    _print_all(map(printable, response.lines))
    return 0


def _print_all(lines: Iterator[str]) -> None:
    for line in lines:
        print(line)


def _reload(connection: ClientConnection, options: argparse.Namespace) -> int:
    response = require_ok(NodeClient(connection, options.node).call("reload", "Reload"))
    if options.json:
        print_json(response.changes)
    else:
        _print_all(map(printable, response.changes))
    return 0


def _node_status(connection: ClientConnection, node: NodeClient) -> Dict[str, Any]:
    """Return the answer of a node's service ``~list``, with the name of the node and the inputs of its interfaces."""
    status: Dict[str, Any] = make_dictionary(require_ok(node.call("list", "List")))
    del status["result"]
    for name in node.interfaces:
        try:
            interface_status = make_dictionary(
                require_ok(NodeClient(connection, name, include_interfaces=True).call("list", "List"))
            )
        except UsageError as error:
            # An interface that has ended without the master's knowledge does not hide the status of the node.
            node.report_once(error)
            continue
        status["inputs"] += [{"node": name, **topic} for topic in interface_status["inputs"]]
        status["more_inputs"] += interface_status["more_inputs"]
    return {"node": node.name, **status}


def _list(connection: ClientConnection, options: argparse.Namespace) -> int:
    node = NodeClient(connection, options.node, include_interfaces=True)
    status = _node_status(connection, node)
    if options.json:
        print_json(status)
    else:
        _print_all(map(printable, node_status_tables.format_list(status, node.has_engine)))
    return 0


def _status(connection: ClientConnection, options: argparse.Namespace) -> int:
    if not 0 < options.every <= _MAX_STATUS_INTERVAL_SECONDS:
        raise UsageError(
            f"--every: expected a number above 0, up to {_MAX_STATUS_INTERVAL_SECONDS}, "
            f"found {format_number(options.every)}"
        )
    node = NodeClient(connection, options.node, include_interfaces=True)
    # Without a terminal, repeated reports of text would only be separated by control sequences.
    is_single_report = options.once or not (sys.stdout.isatty() or options.json)
    if is_single_report and options.json:
        return _list(connection, options)
    if is_single_report:
        previous, listed_at = _node_status(connection, node), monotonic()
        sleep(options.every)
        status = _node_status(connection, node)
        _print_all(_format_status(node, previous, status, monotonic() - listed_at))
        return 0
    with start_node(connection, "retalis_status") as output:
        _show_status(connection, node, options, output)
    return 0


def _show_status(
    connection: ClientConnection, node: NodeClient, options: argparse.Namespace, output: IO[str]
) -> None:
    """Show the status of a node until the command is interrupted."""
    previous, listed_at, last_error = _node_status(connection, node), monotonic(), ""
    while True:
        sleep(options.every)
        try:
            status, now = _node_status(connection, node), monotonic()
        except UsageError as error:
            # The node or the master may return.
            if str(error) != last_error:
                print(f"retalis: {error}", file=sys.stderr, flush=True)
            last_error = str(error)
            continue
        last_error = ""
        if options.json:
            print_json(_add_event_rate(previous, status, now - listed_at), output)
        else:
            height = shutil.get_terminal_size().lines
            lines = list(_format_status(node, previous, status, now - listed_at))[: height - 1]
            print(_CLEAR + "\n".join(lines), end="", file=output, flush=True)
        previous, listed_at = status, now


@contextmanager
def start_node(connection: ClientConnection, name: str) -> Iterator[IO[str]]:
    """Make this process a node; yield the stream for the output of the command.

    rospy prints messages to stdout, from several threads: that it cannot register, or that the node is asked to end.
    Programs read the output of the command, so these messages are redirected to stderr.
    """
    output = sys.stdout
    with redirect_stdout(sys.stderr):
        connection.start_node(name)
        yield output


def _format_status(
    node: NodeClient, previous: Dict[str, Any], status: Dict[str, Any], seconds: float
) -> Iterator[str]:
    """Yield the lines of a node's status, cut at the width of the terminal."""
    columns = shutil.get_terminal_size().columns
    for line in node_status_tables.format_status(previous, status, seconds, columns, node.has_engine):
        yield printable(line)[:columns]


def _add_event_rate(previous: Dict[str, Any], status: Dict[str, Any], seconds: float) -> Dict[str, Any]:
    """Return a status with the rate of events since the previous one."""
    # A restarted node counts from 0.
    event_count = max(0, status["taken"] - previous["taken"])
    return {"node": status["node"], "events_a_second": round(event_count / seconds, 1), **status}


def _watch(connection: ClientConnection, options: argparse.Namespace) -> int:
    node = NodeClient(connection, options.node)
    with start_node(connection, "retalis_watch") as output:
        _watch_node(connection, node, options, output)
    return 0


def _watch_node(
    connection: ClientConnection, node: NodeClient, options: argparse.Namespace, output: IO[str]
) -> None:
    """Print the outputs of a node, with a temporary subscription for each requested event."""
    # If the terminal is slower than the node, threads of the middleware wait here, and outputs are dropped.
    received: Queue[Tuple[str, str]] = Queue(maxsize=_MAX_QUEUED_TEXTS)
    output_topic = next((topic for topic in node.published_topics if topic.endswith(f"/{OUTPUT}")), None)
    if output_topic is None:
        raise UsageError(f"node {node.name} publishes no {OUTPUT}")
    own_topic = f"{WATCH}{os.getpid()}"
    connection.subscribe(output_topic, lambda text: received.put(("output", text)))
    if options.inputs:
        input_topic = output_topic[: -len(OUTPUT)] + INPUT
        connection.subscribe(input_topic, lambda text: received.put(("input", text)))
    subscription_ids = []
    # The subscriptions exist in the node, so they must be deleted however this process ends.
    with exit_by_exception():
        try:
            for index, pattern in enumerate(options.event):
                # A subscription whose format is a variable sends the event itself.
                fields = {
                    "event": pattern,
                    "conditions": "",
                    "format": "_",
                    "topic": own_topic,
                    "id": str(index),
                }
                require_ok(
                    node.call_relative_service("add_output_subscription", "AddOutputSubscription", **fields)
                )
                subscription_ids.append(str(index))
            _print_received(received, own_topic, options, output)
        finally:
            for subscription_id in subscription_ids:
                node.call_relative_service(
                    "delete_output_subscription",
                    "DeleteOutputSubscription",
                    topic=own_topic,
                    id=subscription_id,
                )


def _print_received(
    received: "Queue[Tuple[str, str]]", own_topic: str, options: argparse.Namespace, output: IO[str]
) -> None:
    """Print received texts until the requested number of lines.

    Args:
        received: pairs of ``output`` or ``input`` and the text.
        own_topic: topic of the temporary subscriptions, whose outputs are printed as events.
        options: options of the command.
        output: stream of the command.
    """
    printed_count = 0
    while not options.count or printed_count < options.count:
        source, text = received.get()
        topic = None
        if source == "output":
            topic, text = _split_output(text)
            if topic == own_topic:
                source, topic = "event", None
            elif topic.startswith(WATCH):
                # An output of another `retalis watch` command.
                continue
        printed_count += 1
        if options.json:
            print_json({"kind": source, "topic": topic, "term": text}, output)
        else:
            print(f"{source if topic is None else topic}: {printable(text)}", file=output, flush=True)


def _split_output(text: str) -> Tuple[str, str]:
    """Return topic and term of an output text ``event(TERM,TOPIC,ID)``."""
    try:
        term: Any = deref(read_term(text, Operators.prolog(), OUTPUT).term)
        return write_term(term[2]), writeq(term[1])
    except (RetalisError, IndexError, TypeError):
        # Any node may publish on this topic: a text of another form is printed as it is.
        return OUTPUT, text


def list_completions(category: str, node: Optional[str]) -> List[str]:
    """Return the names of the running nodes, or the ids of a node's memories, for completion in a shell.

    Args:
        category: ``nodes`` or ``memories``.
        node: name of the node whose memories are listed; None for the only one.

    Raises:
        UsageError: if ROS is not installed, or no node answers.
    """
    connection = connect_client()
    connection.limit_discovery(MAX_COMPLETION_SECONDS)
    try:
        if category == "nodes":
            return find_engine_nodes(connection.find_nodes().services)
        response = NodeClient(connection, node).call(
            "query", "Query", goal="memory_size(Id, _)", max_solutions=1000
        )
    finally:
        connection.end()
    return [binding.text for solution in response.solutions for binding in solution.bindings]


_COMMANDS: Dict[str, Callable[[ClientConnection, argparse.Namespace], int]] = {
    "query": _query,
    "explain": _explain,
    "reload": _reload,
    "list": _list,
    "status": _status,
    "watch": _watch,
}
