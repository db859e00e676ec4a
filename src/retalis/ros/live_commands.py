"""A node that runs, as the command line reaches it: finding it, and calling its services.

What the commands for a node that runs do.
"""

import argparse
import json
import os
import shutil
import signal
import socket
import sys
from contextlib import contextmanager, redirect_stdout
from queue import Queue
from time import monotonic, sleep
from typing import IO, Any, Callable, Container, Dict, Iterator, List, Optional, Set, Tuple

import genpy
import rosgraph
import rospy
from std_msgs.msg import String

from .. import srv
from ..cli import text_tables
from ..foundation.errors import RetalisError, UsageError, printable
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.term_writer import write_term, writeq
from ..prolog.terms.types import deref
from .internal_topics import INPUT, OUTPUT, WATCH
from .master_watch import MasterWatch
from .services import NEVER

MARK = "/add_memory"
"""End of the name of a service that every node with an engine offers, old and new."""

INTERFACE_MARK = "/add_input_subscription"
"""End of the name of a service that every node with a ROS interface offers."""

MASTER_TIMEOUT_SECONDS = 5.0
"""Seconds in which the master has to answer."""

State = Tuple[Dict[str, Set[str]], Dict[str, Set[str]]]
"""The nodes that publish each topic, and those that have each service."""


def master_state() -> State:
    """Return what the master knows.

    Raises:
        UsageError: where there is none.
    """
    master = rosgraph.Master("/retalis_command_line")
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(MASTER_TIMEOUT_SECONDS)
    try:
        published, _, services = master.getSystemState()
    except (OSError, rosgraph.MasterException) as error:
        uri = rosgraph.get_master_uri()
        raise UsageError(f"no master answers at {uri}: start one (roscore), or set ROS_MASTER_URI") from error
    finally:
        socket.setdefaulttimeout(before)
    return _by_name(published), _by_name(services)


def _by_name(found: List[Tuple[str, List[str]]]) -> Dict[str, Set[str]]:
    return {name: set(nodes) for name, nodes in found}


def nodes_of(services: Dict[str, Set[str]], interfaces: bool = False) -> List[str]:
    """Return the nodes of ours that run and have an engine, or also those that are only a ROS interface."""
    marks = (MARK, INTERFACE_MARK) if interfaces else (MARK,)
    return sorted({node for name, nodes in services.items() if name.endswith(marks) for node in nodes})


class LiveNode:
    """A node ``retalis`` that runs.

    Args:
        wanted: its name, relative to the namespace of environment variable ``ROS_NAMESPACE``; by default the only
            one that runs in that namespace.
        interfaces: whether a node that is only a ROS interface may be named, too.

    Attributes:
        name: its name.
        has_engine: whether it is more than a ROS interface.
        published: the topics that it publishes.

    Raises:
        UsageError: where there is no master, no such node, or more than one.
    """

    def __init__(self, wanted: Optional[str] = None, interfaces: bool = False):
        topics, self._services = master_state()
        found = nodes_of(self._services)
        if wanted is None:
            self.name = _only(found)
        else:
            self.name = _named(wanted, nodes_of(self._services, interfaces), self._services)
        self.has_engine = self.name in found
        self.published = sorted(topic for topic, nodes in topics.items() if self.name in nodes)

    def call(self, service: str, kind: Any, **fields: Any) -> Any:
        """Call a service of the node; return the response.

        Args:
            service: its private name.
            kind: its class.
            fields: of the request.

        Raises:
            UsageError: where it has no such service, or does not answer.
        """
        name = f"{self.name}/{service}"
        if self.name not in self._services.get(name, ()):
            raise UsageError(
                f"node {self.name} has no service ~{service}: it is a ROS interface, or of an older version"
            )
        return self._call(name, kind, fields)

    def call_shared(self, service: str, kind: Any, **fields: Any) -> Any:
        """Call a service of the node whose name is relative: that with this ending which the node has."""
        for name, nodes in self._services.items():
            if name.endswith(f"/{service}") and self.name in nodes:
                return self._call(name, kind, fields)
        raise UsageError(f"node {self.name} has no service {service}")

    def _call(self, name: str, kind: Any, fields: Dict[str, Any]) -> Any:
        try:
            return rospy.ServiceProxy(name, kind)(kind._request_class(**fields))  # noqa: SLF001
        except (rospy.ServiceException, rospy.ROSException, genpy.SerializationError, OSError) as error:
            raise UsageError(f"service {name} does not answer: {error}") from error


def _named(wanted: str, found: List[str], services: Container[str]) -> str:
    """Return the full name of a node that a user has named."""
    name = str(
        rosgraph.names.resolve_name(wanted, f"{rosgraph.names.get_ros_namespace()}retalis_command_line")
    )
    if name not in found and f"{name}/list" not in services:  # which the ROS interface has too
        raise UsageError(f"there is no node {name}; {_there(found)}")
    return name


def _only(found: List[str]) -> str:
    """Return the only node that runs in the namespace of ``ROS_NAMESPACE``."""
    space = rosgraph.names.get_ros_namespace()
    inside = [name for name in found if name.startswith(space)]
    if len(inside) == 1:
        return inside[0]
    if inside:
        raise UsageError(f"which node? {_there(inside)}; choose one by --node")
    if found:
        raise UsageError(f"no node retalis runs in namespace {space[:-1]} (ROS_NAMESPACE); {_there(found)}")
    raise UsageError(_there(found))


def _there(found: List[str]) -> str:
    return f"those that run are {', '.join(found)}" if found else "no node retalis runs"


def plain(message: Any) -> Any:
    """Return a message as dictionaries, lists and plain values; times as seconds, None where there is none."""
    if isinstance(message, genpy.Message):
        return {name: plain(getattr(message, name)) for name in message.__slots__}
    if isinstance(message, (list, tuple)):
        return [plain(one) for one in message]
    if isinstance(message, genpy.TVal):
        nanoseconds = message.to_nsec()
        none = nanoseconds == NEVER if isinstance(message, genpy.Duration) else not nanoseconds
        return None if none else message.to_sec()
    return message


def checked(response: Any) -> Any:
    """Return a response whose result is good.

    Raises:
        UsageError: what its result says.
    """
    if response.result != "ok":
        raise UsageError(response.result[len("error: ") :])
    return response


_CLEAR = "\x1b[H\x1b[J"
"""Has a terminal begin at its top, with nothing below."""


_SELDOM = 86_400
"""Seconds from one look at a node's status to the next, at most."""

_LAST = 1 << 32
"""Seconds after the last that a message of ROS can tell."""


def run(options: argparse.Namespace) -> int:
    """Run a command; return its exit status."""
    try:
        return _COMMANDS[options.command](options)
    finally:
        rospy.signal_shutdown("done")


def solutions(found: Any) -> Iterator[Dict[str, Any]]:
    """Yield the solutions of a response as plain values by the variables' names."""
    for solution in found.solutions:
        yield {one.name: json.loads(one.json) for one in solution.bindings}


def lines_of(found: Any) -> Iterator[str]:
    """Yield the solutions of a response as a top level shows them."""
    for solution in found.solutions:
        yield ", ".join(f"{one.name} = {one.text}" for one in solution.bindings) or "true"


def _query(options: argparse.Namespace) -> int:
    found = checked(
        LiveNode(options.node).call(
            "query",
            srv.Query,
            goal=options.goal,
            max_solutions=options.most,
            seconds=options.seconds,
            inferences=options.inferences,
            wait_for=options.wait_for,
            stamp=_time(options.stamp),
            timeout=options.timeout,
        )
    )
    if options.json:
        _print_all(map(json.dumps, solutions(found)))
    else:
        _print_all(map(printable, lines_of(found)))
        if not found.solutions:
            print("false")
    if not found.complete:
        told = "one answer holds no more" if len(found.solutions) < options.most else "see --most"
        print(f"there are more solutions ({told})", file=sys.stderr)
    return 0 if found.solutions else 1


def _time(seconds: float) -> genpy.Time:
    if not 0 <= seconds < _LAST:
        raise UsageError(f"--stamp: expected seconds since the epoch, below {_LAST}, found {seconds:g}")
    return genpy.Time.from_sec(seconds)


def _explain(options: argparse.Namespace) -> int:
    found = checked(LiveNode(options.node).call("explain", srv.Explain, event=options.event))
    if options.json:
        print(json.dumps({"happened": found.happened, "lines": found.lines}))
        return 0
    print(f"{printable(options.event)} {'happened' if found.happened else 'did not happen'}")
    _print_all(map(printable, found.lines))
    return 0


def _print_all(lines: Iterator[str]) -> None:
    for line in lines:
        print(line)


def _reload(options: argparse.Namespace) -> int:
    found = checked(LiveNode(options.node).call("reload", srv.Reload))
    if options.json:
        print(json.dumps(found.changes))
    else:
        _print_all(map(printable, found.changes))
    return 0


def _listed(node: LiveNode) -> Dict[str, Any]:
    """Return what a node says of itself."""
    found: Dict[str, Any] = plain(checked(node.call("list", srv.List)))
    del found["result"]
    return {"node": node.name, **found}


def _list(options: argparse.Namespace) -> int:
    found = _listed(LiveNode(options.node, interfaces=True))
    print(json.dumps(found) if options.json else "\n".join(map(printable, text_tables.report(found))))
    return 0


def _status(options: argparse.Namespace) -> int:
    if not 0 < options.every <= _SELDOM:
        raise UsageError(f"--every: expected a number above 0, up to {_SELDOM}, found {options.every:g}")
    node = LiveNode(options.node, interfaces=True)
    once = options.once or not (sys.stdout.isatty() or options.json)
    if once and options.json:
        return _list(options)
    if once:
        before, looked = _listed(node), monotonic()
        sleep(options.every)
        found = _listed(node)
        _print_all(_page(node, before, found, monotonic() - looked))
        return 0
    with _ros_node("retalis_status") as output:
        _show_status(node, options, output)
    return 0


def _show_status(node: LiveNode, options: argparse.Namespace, output: IO[str]) -> None:
    """Show the status of a node until the command is interrupted."""
    before, looked, told = _listed(node), monotonic(), ""
    while True:
        rospy.rostime.wallsleep(options.every)
        try:
            found, now = _listed(node), monotonic()
        except UsageError as error:  # node or master may come back
            if str(error) != told:
                print(f"retalis: {error}", file=sys.stderr, flush=True)
            told = str(error)
            continue
        told = ""
        if options.json:
            print(json.dumps(_rate(before, found, now - looked)), file=output, flush=True)
        else:
            height = shutil.get_terminal_size().lines
            lines = list(_page(node, before, found, now - looked))[: height - 1]
            print(_CLEAR + "\n".join(lines), end="", file=output, flush=True)
        before, looked = found, now


@contextmanager
def _ros_node(name: str) -> Iterator[IO[str]]:
    """Make this process a ROS node; yield the stream for the output of the command.

    rospy prints messages of its own to stdout, from several threads: that it cannot register, or that somebody asks
    the node to end. Programs read the output of the command, so these messages go to stderr.
    """
    output = sys.stdout
    with redirect_stdout(sys.stderr):
        rospy.init_node(name, anonymous=True, disable_signals=True, disable_rosout=True)
        yield output


def _page(node: LiveNode, before: Dict[str, Any], found: Dict[str, Any], seconds: float) -> Iterator[str]:
    """Yield the status of a node in lines that are no longer than those of the terminal."""
    columns = shutil.get_terminal_size().columns
    for line in text_tables.status_page(before, found, seconds, columns, node.has_engine):
        yield printable(line)[:columns]


def _rate(before: Dict[str, Any], found: Dict[str, Any], seconds: float) -> Dict[str, Any]:
    """Return what a node says of itself, with the events that it has taken a second."""
    taken = max(0, found["taken"] - before["taken"])  # a node that was started anew counts anew
    return {"node": found["node"], "events_a_second": round(taken / seconds, 1), **found}


def _watch(options: argparse.Namespace) -> int:
    node = LiveNode(options.node)
    with _ros_node("retalis_watch") as output:
        _watch_node(node, options, output)
    return 0


def _watch_node(node: LiveNode, options: argparse.Namespace, output: IO[str]) -> None:
    """Print what a node sends, with a subscription for each event that is asked for."""
    MasterWatch().start()
    came: Queue[Tuple[str, str]] = Queue(maxsize=10_000)
    outputs = next((topic for topic in node.published if topic.endswith(f"/{OUTPUT}")), None)
    if outputs is None:
        raise UsageError(f"node {node.name} publishes no {OUTPUT}")
    topic = f"{WATCH}{os.getpid()}"
    rospy.Subscriber(outputs, String, lambda text: came.put(("output", text.data)))
    if options.inputs:
        place = outputs[: -len(OUTPUT)] + INPUT
        rospy.Subscriber(place, String, lambda text: came.put(("input", text.data)))
    for end in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(end) is not signal.SIG_IGN:  # as under nohup
            signal.signal(end, _leave)
    added = []
    try:
        for number, pattern in enumerate(options.event):
            fields = {"event": pattern, "conditions": "", "format": "_", "topic": topic, "id": str(number)}
            checked(node.call_shared("add_output_subscription", srv.AddOutputSubscription, **fields))
            added.append(str(number))
        _print_what_comes(came, topic, options, output)
    finally:
        for name in added:
            node.call_shared("delete_output_subscription", srv.DeleteOutputSubscription, topic=topic, id=name)


def _leave(number: int, frame: Any) -> None:
    """End by a signal, with the subscriptions deleted."""
    raise SystemExit(128 + number)


def _print_what_comes(came: Any, own: str, options: argparse.Namespace, output: IO[str]) -> None:
    shown = 0
    while not options.count or shown < options.count:
        kind, text = came.get()
        topic = None
        if kind == "output":
            kind, topic, text = _taken_apart(text)
            if topic == own:
                kind, topic = "event", None
            elif topic.startswith(WATCH):
                continue
        shown += 1
        if options.json:
            print(json.dumps({"kind": kind, "topic": topic, "term": text}), file=output, flush=True)
        else:
            print(f"{kind if topic is None else topic}: {printable(text)}", file=output, flush=True)


def _taken_apart(text: str) -> Tuple[str, str, str]:
    """Return kind, topic and term of a text ``event(TERM,TOPIC,ID)``."""
    try:
        term: Any = deref(read_term(text, Operators.prolog(), OUTPUT).term)
        return "output", write_term(term[2]), writeq(term[1])
    except (RetalisError, IndexError, TypeError):  # from others, who may write what they like
        return "output", OUTPUT, text


def names(kind: str, node: Optional[str]) -> List[str]:
    """Return the names of the nodes that run, or the ids of the memories of one, for a shell to complete.

    Raises:
        UsageError: where no master answers, or no node.
    """
    try:
        if kind == "nodes":
            return list(nodes_of(master_state()[1]))
        found = LiveNode(node).call("query", srv.Query, goal="memory_size(Id, _)", max_solutions=1000)
    finally:
        rospy.signal_shutdown("done")
    return [one.text for solution in found.solutions for one in solution.bindings]


_COMMANDS: Dict[str, Callable[[argparse.Namespace], int]] = {
    "query": _query,
    "explain": _explain,
    "reload": _reload,
    "list": _list,
    "status": _status,
    "watch": _watch,
}
