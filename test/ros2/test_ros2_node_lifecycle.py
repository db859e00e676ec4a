"""The life cycle of the node in the process of the test: transitions at the same time, and time between programs."""

import threading
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from ros2.rclpy_nodes import TIMEOUT_SECONDS, Network, wait_until
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from retalis import Reports, UsageError
from retalis.ros2 import rclpy_transport, ros2_node
from retalis.ros2.rclpy_transport import RclpyTransport
from retalis.ros2.ros2_node import RetalisNode

SECOND = 10**9
TOPICS = """\
<publish_subscribe>
  <subscribe_to name="words" msg_type="std_msgs/String" event="word"/>
  <publish_to name="answers" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = "compile_event_file('rules.txt')\nsubscribe(std_msgs__0__String(_), [], _, answers, a)\n"
RULES = """\
std_msgs__0__String(X) <- word(X).
std_msgs__0__String('"alone"') <- word(_) seq absent(word(_), 50).
"""


@pytest.fixture
def start(
    domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., RetalisNode]]:
    """Return a function that returns the unconfigured node with arguments for ROS."""
    # It changes the settings of the garbage collector for the rest of the process.
    monkeypatch.setattr(ros2_node, "limit_gc_pauses", lambda: None)
    for name, text in {"pub_sub.xml": TOPICS, "goalPredicates.txt": GOALS, "rules.txt": RULES}.items():
        (tmp_path / name).write_text(text)
    nodes: List[RetalisNode] = []

    def start(*arguments: str) -> RetalisNode:
        rclpy.init(args=["--ros-args", "-p", f"program:={tmp_path}", *arguments])
        nodes.append(RetalisNode())
        return nodes[-1]

    yield start
    for node in nodes:
        node.end()
    rclpy.try_shutdown()


class BlockedHost:
    """A program that is loaded until the test releases it.

    Args:
        context: its transport and parameters.
        texts: exchange of texts.

    Attributes:
        is_loading: set while it is loaded.
        is_released: set by the test.
        ended: names of the functions that were called at the end of the transport.
        changes: parameters that were applied.
        apply: called to apply parameters.
        error: raised at the end of the loading.
    """

    is_loading: threading.Event
    is_released: threading.Event
    ended: List[str]
    changes: List[Any]
    apply: Callable[[Any], object]
    error: Any = None

    def __init__(self, context: Any, texts: Any) -> None:
        context.transport.on_shutdown(lambda: self.ended.append("before"))
        self.is_loading.set()
        assert self.is_released.wait(TIMEOUT_SECONDS)
        if self.error is not None:
            raise self.error
        context.transport.on_shutdown(lambda: self.ended.append("after"))

    def change_parameters(self, parameters: Any) -> None:
        """Apply parameters as the test says; by default, record them."""
        type(self).apply(parameters)


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return the class of the programs of the test."""
    attributes: Dict[str, Any] = {
        "is_loading": threading.Event(),
        "is_released": threading.Event(),
        "ended": [],
        "changes": [],
    }
    host: Any = type("Host", (BlockedHost,), attributes)
    host.apply = host.changes.append
    monkeypatch.setattr(ros2_node, "ProgramHost", host)
    yield host
    host.is_released.set()


class LifeCycleClient:
    """Client of the services of a node's life cycle.

    Args:
        network: network of the test.
        node: the node.
    """

    def __init__(self, network: Network, node: RetalisNode) -> None:
        peer = network.add_node()
        self._change_state = peer.create_client(ChangeState, "/retalis/change_state")
        self._get_state = peer.create_client(GetState, "/retalis/get_state")
        for client in (self._change_state, self._get_state):
            assert client.wait_for_service(TIMEOUT_SECONDS)
            # Otherwise the response may be sent before the node has found its reader.
            wait_until(lambda: node.count_clients(client.srv_name))  # noqa: B023 - called at once

    def request(self, transition: int) -> Any:
        """Return the future of a transition."""
        return self._change_state.call_async(ChangeState.Request(transition=Transition(id=transition)))

    def change(self, transition: int) -> bool:
        """Return whether a transition succeeds."""
        return is_successful(self.request(transition))

    def state(self) -> str:
        """Return the state of the node."""
        future = self._get_state.call_async(GetState.Request())
        wait_until(future.done)
        return str(future.result().current_state.label)


def is_successful(future: Any) -> bool:
    """Return whether a requested transition succeeds."""
    wait_until(future.done)
    return bool(future.result().success)


def test_refused_transition_is_answered(
    network: Network, start: Callable[..., RetalisNode], caplog: pytest.LogCaptureFixture
) -> None:
    client = LifeCycleClient(network, start())
    assert not client.change(Transition.TRANSITION_DEACTIVATE)
    assert client.change(Transition.TRANSITION_CONFIGURE)
    assert not client.change(Transition.TRANSITION_CONFIGURE)
    assert client.state() == "inactive"
    assert caplog.messages == [
        "transition 4 is refused: the state of the node does not allow it",
        "transition 1 is refused: the state of the node does not allow it",
    ]


def test_request_during_start_follows_it(
    network: Network, start: Callable[..., RetalisNode], host: Any
) -> None:
    node = start()
    client = LifeCycleClient(network, node)
    results: List[bool] = []
    starting = threading.Thread(target=lambda: results.append(node.start()), name="starting")
    starting.start()
    assert host.is_loading.wait(TIMEOUT_SECONDS)
    future = client.request(Transition.TRANSITION_DEACTIVATE)
    host.is_released.set()
    assert is_successful(future)
    starting.join()
    assert results == [True]
    assert client.state() == "inactive"
    assert host.ended == ["before", "after"]


def test_node_that_was_configured_by_request_is_not_started_again(
    network: Network, start: Callable[..., RetalisNode], caplog: pytest.LogCaptureFixture
) -> None:
    node = start()
    client = LifeCycleClient(network, node)
    assert client.change(Transition.TRANSITION_CONFIGURE)
    assert node.start()
    assert client.state() == "inactive"
    assert "the node does not activate itself: a request has changed its state" in caplog.text


def test_end_during_activation_ends_program(start: Callable[..., RetalisNode], host: Any) -> None:
    node = start()
    node.trigger_configure()
    # In the thread of requests, without a client: discovery may lose its response on a busy machine.
    node.executor.create_task(node.trigger_activate)
    assert host.is_loading.wait(TIMEOUT_SECONDS)
    ending = threading.Thread(target=node.end, name="ending")
    ending.start()
    wait_until(lambda: host.ended == ["before"])
    host.is_released.set()
    ending.join()
    wait_until(lambda: host.ended == ["before", "after"])


@pytest.mark.parametrize("error", [UsageError("no program"), OSError("no memory")])
def test_failed_activation_ends_program(
    start: Callable[..., RetalisNode], host: Any, caplog: pytest.LogCaptureFixture, error: Exception
) -> None:
    node = start()
    host.error = error
    host.is_released.set()
    node.trigger_configure()
    assert node.trigger_activate() == TransitionCallbackReturn.FAILURE
    assert host.ended == ["before"]
    assert str(error) in caplog.text
    host.error = None
    assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS


def test_parameters_change_together_or_not_at_all(start: Callable[..., RetalisNode], host: Any) -> None:
    node = start()
    host.is_released.set()
    node.start()
    good = Parameter("max_skew", value=2.0)
    result = node.set_parameters_atomically([good, Parameter("max_seconds", value=-1)])
    assert "max_seconds" in result.reason
    assert node.get_parameter("max_skew").value is None
    assert node.set_parameters_atomically([good, Parameter("max_seconds", value=3.0)]).successful
    assert [(each.max_skew, each.settings.limits.seconds) for each in host.changes] == [(2.0, 3.0)]


def test_change_that_rclpy_rejects_is_not_applied(start: Callable[..., RetalisNode], host: Any) -> None:
    node = start("-p", "limit:=4")
    host.is_released.set()
    node.start()
    result = node.set_parameters_atomically(
        [Parameter("max_skew", value=2.0), Parameter("limit", value="four")]
    )
    assert not result.successful
    assert host.changes == []


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (UsageError("the engine cannot be used any more"), "the engine cannot be used any more"),
        (OSError("no memory"), "internal error; the log of the node has the details"),
    ],
)
def test_change_that_cannot_be_applied_is_rejected(
    start: Callable[..., RetalisNode], host: Any, error: Exception, reason: str
) -> None:
    node = start()
    host.is_released.set()
    node.start()

    def refuse(parameters: Any) -> None:
        raise error

    host.apply = refuse
    result = node.set_parameters_atomically([Parameter("max_skew", value=2.0)])
    assert (result.successful, result.reason) == (False, reason)
    assert node.get_parameter("max_skew").value is None
    # The program still has its former value.
    host.apply = host.changes.append
    assert node.set_parameters_atomically([Parameter("diagnostics", value=2.0)]).successful
    assert [each.max_skew for each in host.changes] == [None]


def test_change_that_cannot_be_applied_at_start_fails_activation(
    start: Callable[..., RetalisNode], host: Any, caplog: pytest.LogCaptureFixture
) -> None:
    node = start()
    results: List[bool] = []
    starting = threading.Thread(target=lambda: results.append(node.start()), name="starting")
    starting.start()
    assert host.is_loading.wait(TIMEOUT_SECONDS)
    assert node.set_parameters_atomically([Parameter("max_skew", value=2.0)]).successful

    def refuse(parameters: Any) -> None:
        raise UsageError(f"{parameters.max_skew} s is refused")

    host.apply = refuse
    host.is_released.set()
    starting.join()
    assert results == [False]
    assert "2.0 s is refused" in caplog.text


def test_node_answers_while_change_waits_for_engine(
    network: Network, start: Callable[..., RetalisNode], host: Any
) -> None:
    node = start()
    host.is_released.set()
    node.start()
    is_applying, is_idle = threading.Event(), threading.Event()

    def apply(parameters: Any) -> None:
        is_applying.set()
        assert is_idle.wait(TIMEOUT_SECONDS)

    host.apply = apply
    client = LifeCycleClient(network, node)
    setting = network.add_node("setter").create_client(SetParameters, "/retalis/set_parameters")
    assert setting.wait_for_service(TIMEOUT_SECONDS)
    wait_until(lambda: node.count_clients(setting.srv_name))
    parameter = Parameter("max_skew", value=2.0).to_parameter_msg()
    future = setting.call_async(SetParameters.Request(parameters=[parameter]))
    assert is_applying.wait(TIMEOUT_SECONDS)
    assert client.state() == "active"
    # The program ends while its engine is busy.
    assert client.change(Transition.TRANSITION_DEACTIVATE)
    assert client.change(Transition.TRANSITION_CLEANUP)
    is_idle.set()
    wait_until(future.done)
    (result,) = future.result().results
    assert (result.successful, result.reason) == (
        False,
        "the program has ended meanwhile: set the parameters again",
    )
    assert node.get_parameter("max_skew").value is None


def test_request_beyond_limit_of_threads_is_rejected(
    network: Network, start: Callable[..., RetalisNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rclpy_transport, "MAX_CONCURRENT_REQUESTS", 0)
    monkeypatch.setattr(rclpy_transport, "MAX_WAITING_REQUESTS", 0)
    node = start()
    setting = network.add_node().create_client(SetParameters, "/retalis/set_parameters")
    assert setting.wait_for_service(TIMEOUT_SECONDS)
    wait_until(lambda: node.count_clients(setting.srv_name))
    parameter = Parameter("max_skew", value=2.0).to_parameter_msg()
    future = setting.call_async(SetParameters.Request(parameters=[parameter]))
    wait_until(future.done)
    (result,) = future.result().results
    assert (result.successful, result.reason) == (
        False,
        "0 requests are running and 0 are waiting: send this one later",
    )


class ClockPublisher:
    """Publisher of simulated time.

    Args:
        peer: its node.
        node: the node whose time it is.
    """

    def __init__(self, peer: Any, node: Any) -> None:
        self._publisher = peer.create_publisher(Clock, "/clock", 10)
        self._node = node

    def set(self, seconds: int) -> None:
        """Publish a time, until the node has it."""
        message = Clock()
        message.clock.sec = seconds
        clock = self._node.get_clock()

        def is_set() -> bool:
            self._publisher.publish(message)
            return bool(clock.now().nanoseconds == seconds * SECOND)

        wait_until(is_set)


def test_inactive_node_follows_clock(network: Network, start: Callable[..., RetalisNode]) -> None:
    node = start("-p", "use_sim_time:=true")
    peer = network.add_node()
    clock = ClockPublisher(peer, node)
    clock.set(90)
    assert node.start()
    for seconds in (100, 200):
        clock.set(seconds)
        node.trigger_deactivate()
        clock.set(seconds + 50)
        node.trigger_activate()
    clock.set(300)
    assert [each.node_name for each in peer.get_subscriptions_info_by_topic("/clock")] == ["retalis"]


def test_inactive_node_makes_no_outputs(network: Network, start: Callable[..., RetalisNode]) -> None:
    answers: List[str] = []
    node = start("-p", "use_sim_time:=true")
    peer = network.add_node()
    peer.create_subscription(String, "answers", lambda message: answers.append(message.data), 10)
    words = peer.create_publisher(String, "words", 10)
    clock = ClockPublisher(peer, node)
    clock.set(100)
    assert node.start()
    wait_until(words.get_subscription_count)
    words.publish(String(data="first"))
    wait_until(lambda: answers == ["first"])
    node.trigger_deactivate()
    wait_until(lambda: not words.get_subscription_count())
    words.publish(String(data="unread"))
    clock.set(200)
    node.trigger_activate()
    wait_until(words.get_subscription_count)
    words.publish(String(data="second"))
    wait_until(lambda: answers[1:])
    # The alarm of the second message is due, and that of the first message has ended with its program.
    clock.set(260)
    wait_until(lambda: answers[2:])
    assert answers == ["first", "second", "alone"]


def test_transport_begins_with_time_of_node(network: Network) -> None:
    node = network.add_node("retalis", parameter_overrides=[Parameter("use_sim_time", value=True)])
    ClockPublisher(network.add_node(), node).set(100)
    transport = RclpyTransport(node, SingleThreadedExecutor(context=network.context), Reports())
    try:
        assert transport.now() == 100 * SECOND
    finally:
        transport.shut_down()
