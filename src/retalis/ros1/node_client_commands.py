"""Commands for a running node: ``query``, ``explain``, ``list``, ``status``, ``watch``, ``reload``, ``console``.

A `NodeClient` finds the node through the master and calls its services. The process itself becomes a ROS node only if
it subscribes to topics or runs until it is interrupted (``status``, ``watch``).
"""

import argparse
import os
import shutil
import signal
import socket
import sys
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from queue import Queue
from time import monotonic, sleep
from typing import (
    IO,
    Any,
    Callable,
    Container,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Set,
    Tuple,
    Union,
)

import genpy
import rosgraph
import rospy
from std_msgs.msg import String

from .. import srv
from ..cli import node_status_tables, toplevel_io
from ..engine.client_requests import decode_bindings
from ..foundation.errors import RetalisError, SyntaxFault, UsageError, printable
from ..foundation.interrupts import interruptible
from ..foundation.output_files import print_json
from ..node.services import NO_DURATION
from ..node.text_exchange import INPUT, OUTPUT, WATCH
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import ReadTerm, read_term
from ..prolog.syntax.term_writer import write_term, writeq
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.types import Atom, deref
from .internode_topics import INPUT_CHANGES_TOPIC
from .master_watch import MasterWatch

ENGINE_SERVICE_SUFFIX = "/add_memory"
"""Suffix of a service that identifies nodes with an engine, in all versions."""

INTERFACE_SERVICE_SUFFIX = "/add_input_subscription"
"""Suffix of a service that identifies nodes with a ROS interface."""

MASTER_TIMEOUT_SECONDS = 5.0
"""Timeout in seconds for calls of the master."""


class MasterState(NamedTuple):
    """The publishers and subscribers of each topic, and the nodes that offer each service."""

    publishers: Dict[str, Set[str]]
    subscribers: Dict[str, Set[str]]
    services: Dict[str, Set[str]]


def get_master_state() -> MasterState:
    """Return the publishers and services that the master knows.

    Raises:
        UsageError: if no master answers.
    """
    master = rosgraph.Master("/retalis_command_line")
    # rosgraph has no parameter for a timeout: without the default of sockets, a master that hangs would block
    # forever.
    default_timeout = socket.getdefaulttimeout()
    socket.setdefaulttimeout(MASTER_TIMEOUT_SECONDS)
    try:
        state = master.getSystemState()
    except (OSError, rosgraph.MasterException) as error:
        uri = rosgraph.get_master_uri()
        raise UsageError(f"no master answers at {uri}: start one (roscore), or set ROS_MASTER_URI") from error
    finally:
        socket.setdefaulttimeout(default_timeout)
    return MasterState(*map(_nodes_by_name, state))


def _nodes_by_name(pairs: List[Tuple[str, List[str]]]) -> Dict[str, Set[str]]:
    return {name: set(nodes) for name, nodes in pairs}


def find_engine_nodes(services: Dict[str, Set[str]], include_interfaces: bool = False) -> List[str]:
    """Return the running nodes with an engine.

    Args:
        services: nodes that offer each service.
        include_interfaces: whether nodes that are only a ROS interface are included.
    """
    suffixes = (
        (ENGINE_SERVICE_SUFFIX, INTERFACE_SERVICE_SUFFIX) if include_interfaces else (ENGINE_SERVICE_SUFFIX,)
    )
    return sorted({node for name, nodes in services.items() if name.endswith(suffixes) for node in nodes})


class NodeClient:
    """Client of the services of a running node ``retalis``.

    Args:
        requested_name: name of the node, relative to the namespace of environment variable ``ROS_NAMESPACE``; by
            default the only one that runs in that namespace.
        include_interfaces: whether a node that is only a ROS interface may be named, too.

    Attributes:
        name: full name of the node.
        has_engine: whether the node has an engine.
        interfaces: names of the other nodes that are the ROS interface of this one.
        published_topics: topics that the node publishes.

    Raises:
        UsageError: if no master answers, or the node does not exist or is ambiguous.
    """

    def __init__(self, requested_name: Optional[str] = None, include_interfaces: bool = False):
        publishers, subscribers, self._services = get_master_state()
        # A node is identified by its services, not by its name, which launch files may change.
        engine_nodes = find_engine_nodes(self._services)
        if requested_name is None:
            self.name = _select_only_node(engine_nodes)
        else:
            self.name = _resolve_node(
                requested_name, find_engine_nodes(self._services, include_interfaces), self._services
            )
        self.has_engine = self.name in engine_nodes
        self._reported_errors: Set[str] = set()
        # They send the subscriptions that their services add.
        self.interfaces = sorted(
            interface
            for topic, nodes in publishers.items()
            if topic.endswith(f"/{INPUT_CHANGES_TOPIC}") and self.name in subscribers.get(topic, ())
            for interface in nodes - {self.name}
        )
        self.published_topics = sorted(topic for topic, nodes in publishers.items() if self.name in nodes)

    def report_once(self, error: UsageError) -> None:
        """Print an error that does not end the command, unless the same one was printed before."""
        if str(error) not in self._reported_errors:
            self._reported_errors.add(str(error))
            print(f"retalis: {error}", file=sys.stderr, flush=True)

    def call(self, service: str, service_class: Any, **fields: Any) -> Any:
        """Call a service of the node; return the response.

        Args:
            service: private name of the service.
            service_class: class of the service.
            fields: fields of the request.

        Raises:
            UsageError: if the node does not offer the service, or does not answer.
        """
        name = f"{self.name}/{service}"
        if self.name not in self._services.get(name, ()):
            raise UsageError(
                f"node {self.name} has no service ~{service}: it is a ROS interface, or of an older version"
            )
        return self._call(name, service_class, fields)

    def call_relative_service(self, service: str, service_class: Any, **fields: Any) -> Any:
        """Call a service of the node that is not private; see `call`.

        Its name is relative to the namespace of the node, and may be remapped. The service is therefore found by the
        end of its full name.
        """
        for name, nodes in self._services.items():
            if name.endswith(f"/{service}") and self.name in nodes:
                return self._call(name, service_class, fields)
        raise UsageError(f"node {self.name} has no service {service}")

    def _call(self, name: str, service_class: Any, fields: Dict[str, Any]) -> Any:
        try:
            return rospy.ServiceProxy(name, service_class)(service_class._request_class(**fields))  # noqa: SLF001
        except (rospy.ServiceException, rospy.ROSException, genpy.SerializationError, OSError) as error:
            raise UsageError(f"service {name} does not answer: {error}") from error


def _resolve_node(requested_name: str, nodes: List[str], services: Container[str]) -> str:
    """Return the full name of a node that a user has named.

    Raises:
        UsageError: if there is no such node of this package.
    """
    name = str(
        rosgraph.names.resolve_name(
            requested_name, f"{rosgraph.names.get_ros_namespace()}retalis_command_line"
        )
    )
    if name not in nodes and f"{name}/list" not in services:
        # Each node of this package offers `list`, an interface node, too.
        raise UsageError(f"there is no node {name}; {_name_running_nodes(nodes)}")
    return name


def _select_only_node(nodes: List[str]) -> str:
    """Return the only node in the namespace of ``ROS_NAMESPACE``.

    Raises:
        UsageError: if there are none or several.
    """
    namespace = rosgraph.names.get_ros_namespace()
    in_namespace = [name for name in nodes if name.startswith(namespace)]
    if len(in_namespace) == 1:
        return in_namespace[0]
    if in_namespace:
        raise UsageError(f"which node? {_name_running_nodes(in_namespace)}; choose one by --node")
    if nodes:
        raise UsageError(
            f"no node retalis runs in namespace {namespace[:-1]} (ROS_NAMESPACE); {_name_running_nodes(nodes)}"
        )
    raise UsageError(_name_running_nodes(nodes))


def _name_running_nodes(nodes: List[str]) -> str:
    return f"those that run are {', '.join(nodes)}" if nodes else "no node retalis runs"


def to_plain(message: Any) -> Any:
    """Return a message as dictionaries, lists and plain values; times in seconds, absent ones as None."""
    if isinstance(message, genpy.Message):
        return {name: to_plain(getattr(message, name)) for name in message.__slots__}
    if isinstance(message, (list, tuple)):
        return [to_plain(item) for item in message]
    if isinstance(message, genpy.TVal):
        nanoseconds = message.to_nsec()
        is_absent = nanoseconds == NO_DURATION if isinstance(message, genpy.Duration) else not nanoseconds
        return None if is_absent else message.to_sec()
    return message


def require_ok(response: Any) -> Any:
    """Return a response if its result is ``ok``.

    Raises:
        UsageError: with the reason in the result.
    """
    if response.result != "ok":
        raise UsageError(response.result[len("error: ") :])
    return response


_CLEAR = "\x1b[H\x1b[J"
"""Control sequence that moves the cursor to the top of the terminal and clears the screen."""


_MAX_QUEUED_TEXTS = 10_000
"""Limit for received texts that wait to be printed by ``watch``."""

_MAX_STATUS_INTERVAL_SECONDS = 86_400
"""Limit in seconds for the interval of ``status``."""

_TIME_LIMIT_SECONDS = 1 << 32
"""First second that a time in a ROS message cannot represent."""


def run(options: argparse.Namespace) -> int:
    """Run a command; return its exit status."""
    try:
        return _COMMANDS[options.command](options)
    finally:
        rospy.signal_shutdown("done")


def decode_solutions(response: Any) -> Iterator[Dict[str, Any]]:
    """Yield the solutions of a response as dictionaries from variable names to plain values."""
    for solution in response.solutions:
        yield decode_bindings(solution.bindings)


def _print_json_solutions(response: Any) -> None:
    """Print each solution of a response as a line of JSON."""
    for solution in decode_solutions(response):
        print_json(solution)


def format_solutions(response: Any) -> Iterator[str]:
    """Yield the solutions of a response in the form of a Prolog top level."""
    for solution in response.solutions:
        yield ", ".join(f"{binding.name} = {binding.text}" for binding in solution.bindings) or "true"


def _query(options: argparse.Namespace) -> int:
    response = require_ok(
        NodeClient(options.node).call(
            "query",
            srv.Query,
            goal=options.goal,
            max_solutions=options.max_solutions,
            seconds=options.seconds,
            inferences=options.inferences,
            wait_for=options.wait_for,
            stamp=_to_ros_time(options.stamp),
            timeout=options.timeout,
        )
    )
    if options.json:
        _print_json_solutions(response)
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


def _to_ros_time(seconds: float) -> genpy.Time:
    if not 0 <= seconds < _TIME_LIMIT_SECONDS:
        raise UsageError(
            f"--stamp: expected seconds since the epoch, below {_TIME_LIMIT_SECONDS}, found {seconds:g}"
        )
    return genpy.Time.from_sec(seconds)


def _explain(options: argparse.Namespace) -> int:
    response = require_ok(NodeClient(options.node).call("explain", srv.Explain, event=options.event))
    if options.json:
        print_json({"happened": response.happened, "lines": response.lines})
        return 0
    print(f"{printable(options.event)} {'happened' if response.happened else 'did not happen'}")
    _print_all(map(printable, response.lines))
    return 0


def _print_all(lines: Iterator[str]) -> None:
    for line in lines:
        print(line)


def _reload(options: argparse.Namespace) -> int:
    response = require_ok(NodeClient(options.node).call("reload", srv.Reload))
    if options.json:
        print_json(response.changes)
    else:
        _print_all(map(printable, response.changes))
    return 0


def _node_status(node: NodeClient) -> Dict[str, Any]:
    """Return the answer of a node's service ``~list``, with the name of the node and the inputs of its interfaces."""
    status: Dict[str, Any] = to_plain(require_ok(node.call("list", srv.List)))
    del status["result"]
    for name in node.interfaces:
        try:
            interface_status = to_plain(
                require_ok(NodeClient(name, include_interfaces=True).call("list", srv.List))
            )
        except UsageError as error:
            # An interface that has ended without the master's knowledge does not hide the status of the node.
            node.report_once(error)
            continue
        status["inputs"] += [{"node": name, **topic} for topic in interface_status["inputs"]]
        status["more_inputs"] += interface_status["more_inputs"]
    return {"node": node.name, **status}


def _list(options: argparse.Namespace) -> int:
    node = NodeClient(options.node, include_interfaces=True)
    status = _node_status(node)
    if options.json:
        print_json(status)
    else:
        _print_all(map(printable, node_status_tables.format_list(status, node.has_engine)))
    return 0


def _status(options: argparse.Namespace) -> int:
    if not 0 < options.every <= _MAX_STATUS_INTERVAL_SECONDS:
        raise UsageError(
            f"--every: expected a number above 0, up to {_MAX_STATUS_INTERVAL_SECONDS}, found {options.every:g}"
        )
    node = NodeClient(options.node, include_interfaces=True)
    # Without a terminal, repeated reports of text would only be separated by control sequences.
    is_single_report = options.once or not (sys.stdout.isatty() or options.json)
    if is_single_report and options.json:
        return _list(options)
    if is_single_report:
        previous, listed_at = _node_status(node), monotonic()
        sleep(options.every)
        status = _node_status(node)
        _print_all(_format_status(node, previous, status, monotonic() - listed_at))
        return 0
    with _ros_node("retalis_status") as output:
        _show_status(node, options, output)
    return 0


def _show_status(node: NodeClient, options: argparse.Namespace, output: IO[str]) -> None:
    """Show the status of a node until the command is interrupted."""
    previous, listed_at, last_error = _node_status(node), monotonic(), ""
    while True:
        rospy.rostime.wallsleep(options.every)
        try:
            status, now = _node_status(node), monotonic()
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
def _ros_node(name: str) -> Iterator[IO[str]]:
    """Make this process a ROS node; yield the stream for the output of the command.

    rospy prints messages to stdout, from several threads: that it cannot register, or that the node is asked to end.
    Programs read the output of the command, so these messages are redirected to stderr.
    """
    output = sys.stdout
    with redirect_stdout(sys.stderr):
        rospy.init_node(name, anonymous=True, disable_signals=True, disable_rosout=True)
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


def _watch(options: argparse.Namespace) -> int:
    node = NodeClient(options.node)
    with _ros_node("retalis_watch") as output:
        _watch_node(node, options, output)
    return 0


def _watch_node(node: NodeClient, options: argparse.Namespace, output: IO[str]) -> None:
    """Print the outputs of a node, with a temporary subscription for each requested event."""
    MasterWatch().start()
    # If the terminal is slower than the node, rospy's threads wait here, and the node drops outputs for this process.
    received: Queue[Tuple[str, str]] = Queue(maxsize=_MAX_QUEUED_TEXTS)
    output_topic = next((topic for topic in node.published_topics if topic.endswith(f"/{OUTPUT}")), None)
    if output_topic is None:
        raise UsageError(f"node {node.name} publishes no {OUTPUT}")
    own_topic = f"{WATCH}{os.getpid()}"
    rospy.Subscriber(output_topic, String, lambda text: received.put(("output", text.data)))
    if options.inputs:
        input_topic = output_topic[: -len(OUTPUT)] + INPUT
        rospy.Subscriber(input_topic, String, lambda text: received.put(("input", text.data)))
    # The subscriptions exist in the node, so they must be deleted however this process ends. Under nohup, SIGHUP is
    # ignored and must stay so.
    for signal_number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(signal_number) is not signal.SIG_IGN:
            signal.signal(signal_number, _raise_system_exit)
    subscription_ids = []
    try:
        for index, pattern in enumerate(options.event):
            # A subscription whose format is a variable sends the event itself.
            fields = {"event": pattern, "conditions": "", "format": "_", "topic": own_topic, "id": str(index)}
            require_ok(
                node.call_relative_service("add_output_subscription", srv.AddOutputSubscription, **fields)
            )
            subscription_ids.append(str(index))
        _print_received(received, own_topic, options, output)
    finally:
        for subscription_id in subscription_ids:
            node.call_relative_service(
                "delete_output_subscription",
                srv.DeleteOutputSubscription,
                topic=own_topic,
                id=subscription_id,
            )


def _raise_system_exit(signal_number: int, frame: Any) -> None:
    """Exit after a signal, so that the subscriptions are deleted."""
    raise SystemExit(128 + signal_number)


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
        UsageError: if no master or node answers.
    """
    try:
        if category == "nodes":
            return list(find_engine_nodes(get_master_state().services))
        response = NodeClient(node).call("query", srv.Query, goal="memory_size(Id, _)", max_solutions=1000)
    finally:
        rospy.signal_shutdown("done")
    return [binding.text for solution in response.solutions for binding in solution.bindings]


_MAX_TERMINAL_SOLUTIONS = 100
"""Limit for the solutions of a goal that is typed in a terminal."""


def _console(options: argparse.Namespace) -> int:
    """Run ``console --node``: goals are parsed here and solved by the node.

    Returns:
        The exit status: 1 after an error or if a goal of ``--goal`` failed, 0 otherwise and always for a terminal.
    """
    if options.files:
        raise UsageError("files are loaded where the console is: leave them out with --node")
    console = NodeConsole(NodeClient(options.node), options.max_solutions, options.json)
    if options.goal:
        for goal in options.goal:
            console.solve_goals(
                toplevel_io.PipedInput(StringIO(goal if goal.rstrip().endswith(".") else f"{goal} .\n"))
            )
    elif sys.stdin.isatty():
        print(f"% {console.node.name}: goals end with a full stop; quit. or ctrl-D ends the console")
        console.solve_goals(toplevel_io.TerminalInput(list))
        return 0
    else:
        console.solve_goals(toplevel_io.PipedInput(sys.stdin))
    return 1 if console.errors or (options.goal and console.has_failed_goal) else 0


class NodeConsole:
    """Top level whose goals are solved by a node.

    Args:
        node: the node.
        max_solutions: limit for the solutions of a goal if the input is not a terminal.
        as_json: whether to print solutions as JSON objects.

    Attributes:
        errors: number of errors.
        has_failed_goal: whether a goal had no solution.
    """

    def __init__(self, node: NodeClient, max_solutions: int, as_json: bool = False):
        self.node = node
        self.errors = 0
        self.has_failed_goal = False
        self._as_json = as_json
        self._max_solutions = max_solutions
        self._logic = PrologSystem()

    def solve_goals(self, source: Union[toplevel_io.PipedInput, toplevel_io.TerminalInput]) -> None:
        """Read and solve goals until the end of the input or ``halt``."""
        while True:
            try:
                parsed = toplevel_io.read_clause(source, self._logic, "?- ")
                if parsed is None:
                    return
                if isinstance(parsed, SyntaxFault):
                    self._print_error(str(parsed))
                    continue
                goal = deref(parsed.term)
                if isinstance(goal, Atom) and goal.name in toplevel_io.QUIT_GOALS:
                    return
                with interruptible():
                    self._solve(parsed, source)
            except UsageError as error:
                self._print_error(str(error))
            except KeyboardInterrupt:
                # At a terminal it ends the goal; the goals of a pipe and of --goal have nobody to ask others.
                if not source.is_terminal:
                    raise
                toplevel_io.discard_unread_text(source)
                print("\n% interrupted", flush=True)

    def _print_error(self, text: str) -> None:
        self.errors += 1
        print(text, file=sys.stderr, flush=True)

    def _solve(
        self, parsed: ReadTerm, source: Union[toplevel_io.PipedInput, toplevel_io.TerminalInput]
    ) -> None:
        variable_names = {var: name for name, var in parsed.names.items()}
        # Parsed and written again: the node gets a single goal without comments, with the names of its variables.
        goal = write_term(parsed.term, self._logic.operators, quoted=True, variable_names=variable_names)
        limit = _MAX_TERMINAL_SOLUTIONS if source.is_terminal else self._max_solutions
        response = require_ok(self.node.call("query", srv.Query, goal=goal, max_solutions=limit))
        self.has_failed_goal |= not response.solutions
        if self._as_json:
            _print_json_solutions(response)
            if not response.complete:
                print("there may be more solutions (see --most)", file=sys.stderr, flush=True)
            return
        texts = list(format_solutions(response))
        if not texts:
            print("false.")
        for number, text in enumerate(texts, 1):
            print(printable(text), end="", flush=True)
            if number < len(texts):
                if not source.wants_more():
                    print(" .")
                    return
                print(" ;", flush=True)
            elif response.complete:
                print(".")
            else:
                print(" .\n% there may be more")


_COMMANDS: Dict[str, Callable[[argparse.Namespace], int]] = {
    "query": _query,
    "explain": _explain,
    "reload": _reload,
    "list": _list,
    "status": _status,
    "watch": _watch,
    "console": _console,
}
