"""Actions and services of rclpy that a program of the node observes."""

from pathlib import Path
from typing import Any, Iterator, List

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")
pytest.importorskip("example_interfaces.action", reason="the package example_interfaces is not built")

from action_msgs.msg import GoalStatus
from example_interfaces.action import Fibonacci
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.qos import qos_profile_services_default
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.task import Future
from ros2.node_processes import NodeProcess
from ros2.rclpy_nodes import TIMEOUT_SECONDS, Network, wait_until
from std_msgs.msg import String
from std_srvs.srv import SetBool
from unique_identifier_msgs.msg import UUID

from retalis.ros2.installed_interfaces import InstalledInterfaces

PUB_SUB = """\
<publish_subscribe>
  <observe_action name="fibonacci" action_type="example_interfaces/Fibonacci" event="fibonacci"/>
  <observe_service name="switch" srv_type="std_srvs/SetBool" event="switch"/>
  <publish_to name="seen" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = """\
compile_event_file('rules.txt')
subscribe(seen(Text), [], std_msgs__0__String(Text), seen, s1)
"""
RULES = """\
seen(S) <- fibonacci__status(_, S).
seen(T) <- fibonacci__feedback{feedback: {sequence: [A, B]}} where format(atom(T), '"feedback ~w ~w"', [A, B]).
seen(T) <- fibonacci__goal{goal: {order: N}} where format(atom(T), '"goal ~w"', [N]).
seen(T) <- fibonacci__result{status: S, result: {sequence: [A]}}
  where format(atom(T), '"result ~w ~w"', [S, A]).

accepted(G) <- fibonacci__status(G, '"executing"').
ended(G) <- fibonacci__status(G, S) where memberchk(S, ['"canceling"', '"canceled"', '"succeeded"']).
progress(G) <- fibonacci__feedback(G, _).
active(G) <- accepted(G).
active(G) <- progress(G).
seen('"stalled"') <- active(G) seq absent((active(G) or ended(G)), 0.5).

seen(T) <- switch(service_msgs__0__ServiceEventInfo(1, _, C, N), [std_srvs__0__SetBool_Request(On)], _)
  seq switch(service_msgs__0__ServiceEventInfo(2, _, C, N), _, [std_srvs__0__SetBool_Response(true, Text)])
  where format(atom(T), '"switch ~w ~w"', [On, Text]).
"""


@pytest.fixture
def network(domain: int) -> Iterator[Network]:
    network = Network()
    yield network
    network.close()


@pytest.fixture
def seen(network: Network, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[List[str]]:
    """Start the node with the program, and remappings; return the list to which its outputs are added."""
    remappings: List[str] = getattr(request, "param", [])
    (tmp_path / "pub_sub.xml").write_text(PUB_SUB)
    (tmp_path / "goalPredicates.txt").write_text(GOALS)
    (tmp_path / "rules.txt").write_text(RULES)
    outputs: List[str] = []
    peer = network.add_node("reader")
    peer.create_subscription(String, "seen", lambda message: outputs.append(message.data), 100)
    node = NodeProcess(tmp_path / "node.log", "-p", f"program:={tmp_path}", *remappings)
    try:
        # The topics of the program are subscribed before the services are offered.
        wait_until(lambda: "/retalis/query" in dict(peer.get_service_names_and_types()))
        yield outputs
        assert node.interrupt() == 0
        assert "[ERROR]" not in node.log()
        assert "Traceback" not in node.log()
    finally:
        node.kill()


class Server:
    """A server that publishes one feedback for a goal, and waits until the goal is canceled or released.

    Attributes:
        server: the server of rclpy.
    """

    def __init__(self, node: Any, name: str = "fibonacci") -> None:
        # A coroutine waits for it: a callback that blocks would keep the executor from receiving a cancellation.
        self._end = Future()
        self.server = ActionServer(node, Fibonacci, name, self._execute, cancel_callback=self._cancel)

    def release(self) -> None:
        """End the goal with success."""
        self._end.set_result(None)

    def _cancel(self, goal: Any) -> CancelResponse:
        self.release()
        return CancelResponse.ACCEPT

    async def _execute(self, goal: Any) -> Any:
        goal.publish_feedback(Fibonacci.Feedback(sequence=[0, 1]))
        await self._end
        if goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.succeed()
        return Fibonacci.Result(sequence=[7])


def send_goal(client: Any) -> Any:
    """Return the handle of a goal that the server has accepted."""
    assert client.wait_for_server(TIMEOUT_SECONDS)
    future = client.send_goal_async(Fibonacci.Goal(order=5))
    wait_until(future.done)
    return future.result()


@pytest.mark.slow
def test_stalled_and_canceled_goal_is_seen(network: Network, seen: List[str]) -> None:
    server = Server(network.add_node("server"))
    client = ActionClient(network.add_node("client"), Fibonacci, "fibonacci")
    goal = send_goal(client)
    wait_until(lambda: "stalled" in seen)
    future = goal.cancel_goal_async()
    wait_until(future.done)
    wait_until(lambda: "canceled" in seen)
    # The status may change too fast for `accepted` to be received; the feedback is another topic.
    without_accepted = [text for text in seen if text != "accepted"]
    assert sorted(without_accepted[:2]) == ["executing", "feedback 0 1"]
    assert without_accepted[2:] == ["stalled", "canceling", "canceled"]
    result = goal.get_result_async()
    wait_until(result.done)
    assert result.result().status == GoalStatus.STATUS_CANCELED
    server.server.destroy()
    client.destroy()


@pytest.mark.slow
@pytest.mark.parametrize("seen", [["-r", "fibonacci:=/other/fibonacci"]], indirect=True)
def test_goal_of_remapped_action_is_seen(network: Network, seen: List[str]) -> None:
    server = Server(network.add_node("server"), "/other/fibonacci")
    server.release()
    client = ActionClient(network.add_node("client"), Fibonacci, "/other/fibonacci")
    send_goal(client)
    wait_until(lambda: "succeeded" in seen)
    assert "stalled" not in seen
    server.server.destroy()
    client.destroy()


@pytest.mark.slow
def test_events_of_services_of_action_are_seen(network: Network, seen: List[str]) -> None:
    """The messages are those that a server publishes whose introspection is enabled, which Jazzy cannot."""
    peer = network.add_node("server")
    send_goal_class, get_result_class = Fibonacci.Impl.SendGoalService, Fibonacci.Impl.GetResultService
    goals = peer.create_publisher(send_goal_class.Event, "fibonacci/_action/send_goal/_service_event", 10)
    results = peer.create_publisher(get_result_class.Event, "fibonacci/_action/get_result/_service_event", 10)
    wait_until(lambda: goals.get_subscription_count() and results.get_subscription_count())
    goal_id = UUID(uuid=range(16))
    goal = send_goal_class.Event(
        request=[send_goal_class.Request(goal_id=goal_id, goal=Fibonacci.Goal(order=5))]
    )
    goal.info.event_type = goal.info.REQUEST_RECEIVED
    goals.publish(goal)
    request = get_result_class.Event(request=[get_result_class.Request(goal_id=goal_id)])
    request.info.event_type = request.info.REQUEST_RECEIVED
    request.info.sequence_number = 3
    results.publish(request)
    response = get_result_class.Event(
        response=[get_result_class.Response(status=4, result=Fibonacci.Result(sequence=[7]))]
    )
    response.info.event_type = response.info.RESPONSE_SENT
    response.info.sequence_number = 3
    results.publish(response)
    wait_until(lambda: len(seen) == 2)
    assert sorted(seen) == ["goal 5", 'result "succeeded" 7']


@pytest.mark.slow
@pytest.mark.skipif(
    not hasattr(ActionServer, "configure_introspection"), reason="servers of this rclpy have no introspection"
)
def test_goal_and_result_of_server_with_introspection_are_seen(network: Network, seen: List[str]) -> None:
    node = network.add_node("server")
    server = Server(node)
    server.release()
    server.server.configure_introspection(
        node.get_clock(), qos_profile_services_default, ServiceIntrospectionState.CONTENTS
    )
    client = ActionClient(network.add_node("client"), Fibonacci, "fibonacci")
    wait_until(lambda: node.count_subscribers("/fibonacci/_action/get_result/_service_event"))
    goal = send_goal(client)
    result = goal.get_result_async()
    wait_until(result.done)
    # Each is on a topic of its own, and may be received first.
    wait_until(lambda: {"goal 5", 'result "succeeded" 7'} <= set(seen))
    server.server.destroy()
    client.destroy()


@pytest.mark.slow
def test_request_and_response_of_service_are_seen(network: Network, seen: List[str]) -> None:
    node = network.add_node("server")

    def answer(request: Any, response: Any) -> Any:
        response.success, response.message = True, "done"
        return response

    service = node.create_service(SetBool, "switch", answer)
    service.configure_introspection(
        node.get_clock(), qos_profile_services_default, ServiceIntrospectionState.CONTENTS
    )
    client = network.add_node("client").create_client(SetBool, "switch")
    assert client.wait_for_service(TIMEOUT_SECONDS)
    # The publisher of the events must have found the node.
    wait_until(lambda: node.count_subscribers("/switch/_service_event"))
    future = client.call_async(SetBool.Request(data=True))
    wait_until(future.done)
    wait_until(lambda: seen)
    assert seen == ['switch true "done"']


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("example_interfaces/Fibonacci_FeedbackMessage", Fibonacci.Impl.FeedbackMessage),
        ("example_interfaces/Fibonacci_SendGoal_Event", Fibonacci.Impl.SendGoalService.Event),
        ("example_interfaces/Fibonacci_GetResult_Request", Fibonacci.Impl.GetResultService.Request),
        ("std_srvs/SetBool_Event", SetBool.Event),
        ("std_srvs/srv/SetBool_Request", SetBool.Request),
    ],
)
def test_classes_of_derived_types_are_those_of_rosidl(name: str, expected: Any) -> None:
    assert InstalledInterfaces().message_class(name) is expected
