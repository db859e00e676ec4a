"""Responses of services: effects on events and outputs of a running program, and reasons for refusals."""

import json
import os
import time
from pathlib import Path
from typing import Any, Dict, Iterator, Tuple

import pytest
from node.in_memory_hosts import DEFINITIONS, Robot, encode, start_host
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis.node.text_exchange import serialize_text
from retalis.node.transport import MessageSource

TOPICS = """
<publish_subscribe>
  <subscribe_to name="scan" msg_type="std_msgs/String" event="scan"/>
  <publish_to name="alarm" msg_type="std_msgs/String"/>
  <subscribe_to name="gates" msg_type="lab/Gate"/>
  <publish_to name="gate" msg_type="lab/Gate"/>
</publish_subscribe>
"""
NUMBER = DEFINITIONS.find("std_msgs/Float64")
GATE = DEFINITIONS.add("lab/Gate", "string name\nDoor door\n" + "=" * 80 + "\nMSG: lab/Door\nbool open\n")


class Client:
    """Another node of the network, which calls services and exchanges events as text.

    Attributes:
        outputs: received outputs as texts.
    """

    def __init__(self, network: MemoryNetwork) -> None:
        self._network = network
        self.robot = Robot(network)
        self.robot.subscribe("/retalisOutputEvents")
        self.outputs = self.robot.received["/retalisOutputEvents"]
        self._events = self.robot.publish("/retalisInputEvents")

    def call(self, service: str, **fields: Any) -> Any:
        """Call a service; return the fields of its response."""
        return self._network.call(service, **fields)

    def send(self, *events: Any) -> None:
        for event in events:
            self._events.send(serialize_text(f"event({event})"))

    def subscribe(
        self, event: str, topic: str = "t", name: str = "s", conditions: str = "", form: str = "_"
    ) -> Any:
        """Add an output subscription; return the result."""
        fields = {"event": event, "conditions": conditions, "format": form, "topic": topic, "id": name}
        return self.call("/add_output_subscription", **fields)["result"]

    def unsubscribe(self, topic: str = "t", name: str = "s") -> Any:
        return self.call("/delete_output_subscription", topic=topic, id=name)["result"]

    def memorize(
        self, event: str, name: str = "m", conditions: str = "", form: str = "_", size: str = "2"
    ) -> Any:
        fields = {"event": event, "conditions": conditions, "format": form, "id": name, "size": size}
        return self.call("/add_memory", **fields)["result"]

    def add_input(self, topic: str, message_type: str) -> Any:
        return self.call("/add_input_subscription", topic=topic, message_type=message_type)["result"]

    def delete_input(self, topic: str) -> Any:
        return self.call("/delete_input_subscription", topic=topic)["result"]

    def query(self, goal: str, **limits: Any) -> Any:
        fields = {
            "max_solutions": 0,
            "seconds": 0.0,
            "inferences": 0,
            "wait_for": [],
            "stamp": 0,
            "timeout": 0.0,
        }
        return self.call("/retalis/query", goal=goal, **{**fields, **limits})


@pytest.fixture
def client(network: MemoryNetwork, tmp_path: Path) -> Iterator[Client]:
    """Return the client of a running program without rules."""
    (tmp_path / "pub_sub.xml").write_text(TOPICS)
    (tmp_path / "goalPredicates.txt").write_text("")
    client = Client(network)
    host = start_host(network, tmp_path, explain=True)
    yield client
    host.transport.shut_down()


def test_subscription_sends_matching_events(client: Client) -> None:
    assert client.subscribe("a(X)", conditions="X > 1, X < 9", form="got(X)") == "ok"
    client.send("a(1)", "a(5)", "a(10)", "a(6)")
    assert client.outputs == ["event(got(5),t,s)", "event(got(6),t,s)"]
    assert client.unsubscribe() == "ok"
    client.send("a(7)")
    assert len(client.outputs) == 2


def test_full_stops_and_comments_are_ignored(client: Client) -> None:
    assert client.subscribe("c(X).", conditions="X > 1 % large", form="_.") == "ok"
    client.send("c(1)", "c(2)")
    assert client.outputs == ["event(c(2),t,s)"]


def test_subscription_is_added_once_per_topic(client: Client) -> None:
    assert client.subscribe("b(_)") == "ok"
    assert client.subscribe("b(_)").startswith("error: a subscription s of topic t already exists")
    assert client.subscribe("b(_)", topic="other") == "ok"


@pytest.mark.parametrize("topic", ["bad topic!", "4x4", "a//b", "über"])
def test_subscription_of_invalid_topic_is_refused(client: Client, topic: str) -> None:
    assert client.subscribe("a(X)", topic=topic).startswith("error: topic: expected a topic")
    assert client.unsubscribe(topic).startswith("error: there is no subscription s")


@pytest.mark.parametrize(
    ("fields", "parts"),
    [
        ({"event": "a(X"}, ("event", "column")),
        ({"event": "a(X)", "conditions": "X >"}, ("conditions", "column")),
        ({"event": "a(X)", "form": "f(]"}, ("format", "line 1, column 3")),
        ({"event": "a(X)", "conditions": "X > 1, X >"}, ("line 1, column 11",)),
        ({"event": ""}, ("event",)),
        ({"event": "3"}, ("event: expected an event", "found 3")),
        ({"event": "a(X)", "conditions": "X"}, ("conditions: expected goals",)),
        ({"event": "a(X)", "form": "7"}, ("format: expected", "found 7")),
        ({"event": "a),b(X)"}, ("event",)),
        ({"event": "a),(b"}, ("event", "column 2")),
    ],
)
def test_error_names_field_and_position(
    client: Client, fields: Dict[str, Any], parts: Tuple[Any, ...]
) -> None:
    result = client.subscribe(**fields)
    assert result.startswith("error: ")
    assert "\n" not in result
    for part in parts:
        assert part in result
    assert client.unsubscribe().startswith("error: there is no subscription s")


def test_errors_have_one_line(client: Client) -> None:
    assert "two lines" in client.unsubscribe(name="two\nlines")


def test_memory_is_used_by_conditions(client: Client) -> None:
    assert client.memorize("v(X)", form="kept(X)") == "ok"
    findall = "findall(X, access_mem(m, kept(X), _), L)"
    assert client.subscribe("ask", conditions=findall, form="all(L)") == "ok"
    client.send("v(1)", "v(2)", "v(3)", "ask")
    assert client.outputs == ["event(all([3,2]),t,s)"]


def test_topic_without_type_is_warned_of(client: Client, caplog: pytest.LogCaptureFixture) -> None:
    assert client.subscribe("u(_)", topic="nothing/there") == "ok"
    client.send("u(1)")
    assert "topic nothing/there has no type" in caplog.text


def test_input_topic_is_added_and_deleted_once(client: Client) -> None:
    assert client.add_input("number", "std_msgs/msg/Float64") == "ok"
    assert client.add_input("number", "std_msgs/Float64").startswith("error: ")
    assert client.subscribe("std_msgs__0__Float64(X)", form="number(X)") == "ok"
    publication = client.robot.transport.advertise("/number", NUMBER, 10)
    publication.send(b"\0\0\0\0\0\0\x04@")
    assert client.outputs == ["event(number(2.5),t,s)"]
    assert client.delete_input("number") == "ok"
    publication.send(b"\0\0\0\0\0\0\x04@")
    assert len(client.outputs) == 1
    assert client.delete_input("number").startswith("error: ")


@pytest.mark.parametrize(
    ("topic", "message_type", "part"),
    [
        ("number", "Float64", "package/Type"),
        ("a b", "std_msgs/Float64", "a b"),
        ("a?b", "std_msgs/Float64", "a?b"),
        ("tf", "tf/tfMessage", "tf"),
        ("", "std_msgs/Float64", ""),
        ("speed", "std_msgs/Flaot64", "did you mean std_msgs/Float64?"),
        ("speed", "std_msg/Float64", "did you mean std_msgs/Float64?"),
    ],
)
def test_invalid_input_topic_is_refused(client: Client, topic: str, message_type: str, part: str) -> None:
    result = client.add_input(topic, message_type)
    assert result.startswith("error: ")
    assert part in result


def test_unknown_or_published_type_is_accepted(client: Client) -> None:
    assert client.add_input("speed", "far_msgs/Unknown") == "ok"
    assert client.delete_input("speed") == "ok"
    definition = DEFINITIONS.add("std_msgs/Flaot64", "int32 x\n")
    client.robot.transport.advertise("/speed", definition, 1)
    assert client.add_input("speed", "std_msgs/Flaot64") == "ok"


@pytest.mark.parametrize("topic", ["gate", "/gate"])
@pytest.mark.parametrize(
    ("form", "reason"),
    [
        ("got(X)", "expected lab__0__Gate/2, got got/1"),
        ("_", "expected lab__0__Gate/2, got p/1"),
        ("lab__0__Gate(X, here)", "slot door: expected lab__0__Door/1"),
    ],
)
def test_format_unlike_type_of_topic_is_refused(client: Client, topic: str, form: str, reason: str) -> None:
    client.robot.transport.advertise("/gates", GATE, 10)
    result = client.subscribe("p(X)", topic=topic, form=form)
    assert result.startswith(f"error: format: topic {topic}, lab/Gate")
    assert reason in result
    assert client.unsubscribe(topic).startswith("error: there is no subscription s")


def test_format_of_unknown_type_is_accepted(client: Client) -> None:
    client.robot.transport.advertise("/gates", GATE, 10)
    assert client.subscribe("p(X)", topic="gate", form="X") == "ok"


def test_goal_subscribes_topic_of_running_program(client: Client, network: MemoryNetwork) -> None:
    goal = "subscribe_to(asked, 'std_msgs/Float64', asked_number)"
    assert [client.query(goal)["result"] for _ in range(2)] == ["ok", "ok"]
    assert "subscribed already" in client.query("subscribe_to(asked, 'std_msgs/Int8')")["result"]
    while "/asked" not in network.subscriptions:  # the node subscribes in a thread
        time.sleep(0.001)
    assert client.add_input("asked", "std_msgs/Float64").startswith("error: ")
    assert client.subscribe("asked_number(X)", form="asked(X)") == "ok"
    client.robot.transport.advertise("/asked", NUMBER, 10).send(b"\0\0\0\0\0\0\x04@")
    assert client.outputs == ["event(asked(2.5),t,s)"]


@pytest.mark.parametrize(
    "template", ["a/b:={}", "a/b({})", 'a/b",{},"'], ids=["assignment", "call", "quotes"]
)
def test_names_of_types_are_not_executed(
    client: Client, network: MemoryNetwork, tmp_path: Path, caplog: pytest.LogCaptureFixture, template: str
) -> None:
    created_file = tmp_path / "harm"
    message_type = template.format(f"__import__('os').system('touch {created_file}')")
    assert client.add_input("hostile", message_type).startswith("error: ")
    assert client.add_input("hostile", "unknown_msgs/Kind") == "ok"
    (subscription,) = network.subscriptions["/hostile"]
    source = MessageSource("/talker", message_type, "int32 x\n", "0" * 32)
    subscription.connect(source).receive([b"\1\0\0\0"])
    assert "topic /hostile: expected a message type" in caplog.text
    assert not os.path.exists(created_file)


@pytest.mark.parametrize(
    ("goal", "part"),
    [
        ("f(X", "column 4"),
        ("", "goal: expected a term"),
        ("no_such(1)", "no_such/1"),
        ("X", "instantiat"),
        ("compile_event_file('/etc/passwd')", "ermission"),
    ],
)
def test_failed_query_has_reason(client: Client, goal: str, part: str) -> None:
    result = client.query(goal)["result"]
    assert result.startswith("error: ")
    assert part in result
    assert "\n" not in result


@pytest.mark.slow
def test_query_has_limits(client: Client) -> None:
    answer = client.query("repeat", max_solutions=3)
    assert (answer["result"], answer["complete"], len(answer["solutions"])) == ("ok", False, 3)
    assert "inferences" in client.query("repeat, fail", inferences=1000)["result"]
    assert "seconds" in client.query("repeat, fail", seconds=0.1)["result"]
    assert "more than" in client.query("numlist(1, 1000000, L)")["result"]
    assert "seconds: expected" in client.query("true", seconds=-1)["result"]


def test_solutions_of_query_have_text_and_json(client: Client) -> None:
    answer = client.query("member(X-Y, [1-a, f(Z)-[b, 2.5]])")
    texts = [{binding["name"]: binding["text"] for binding in row["bindings"]} for row in answer["solutions"]]
    assert texts == [{"X": "1", "Y": "a", "Z": "_1"}, {"X": "f(_1)", "Y": "[b,2.5]", "Z": "_1"}]
    assert json.loads(answer["solutions"][1]["bindings"][1]["json"]) == ["b", 2.5]


def test_rule_emits_events_until_deleted(client: Client) -> None:
    added = client.call("/retalis/add_rule", rule="fire(X) <- smoke(X) seq heat(X) where X > 1.", label="hot")
    assert (added["result"], added["label"]) == ("ok", "hot")
    assert client.subscribe("fire(_)") == "ok"
    client.send("smoke(1)", "smoke(2)", "heat(1)", "heat(2)")
    assert client.outputs == ["event(fire(2),t,s)"]
    assert "already exists" in client.call("/retalis/add_rule", rule="a <- b", label="hot")["result"]
    assert client.call("/retalis/delete_rule", label="hot")["result"] == "ok"
    assert "there is no rule hot" in client.call("/retalis/delete_rule", label="hot")["result"]
    client.send("smoke(2)", "heat(2)")
    assert len(client.outputs) == 1


def test_invalid_rule_is_an_error_with_caret(client: Client) -> None:
    result = client.call("/retalis/add_rule", rule="a <- b seq\n  (c where X > )", label="")["result"]
    assert result.startswith("error: rule:2:16: ")
    assert result.splitlines()[1:] == ["  (c where X > )", " " * 15 + "^"]


def test_events_are_explained(client: Client) -> None:
    client.call("/retalis/add_rule", rule="glow(X) <- warm(X) seq dark(X)", label="glow")
    client.send("warm(1)", "warm(2)", "dark(1)")
    answer = client.call("/retalis/explain", event="glow(1)")
    assert (answer["result"], answer["happened"]) == ("ok", True)
    assert "by rule glow: " in answer["lines"][0]
    assert [line[:8] for line in answer["lines"][1:]] == ["  warm(1", "  dark(1"]
    answer = client.call("/retalis/explain", event="glow(2)")
    assert (answer["result"], answer["happened"]) == ("ok", False)
    assert "    - dark(2): did not happen" in answer["lines"]
    assert client.call("/retalis/explain", event="f(")["result"].startswith("error: ")


def test_invalid_texts_are_ignored(client: Client) -> None:
    client.subscribe("after(X)")
    publication = client.robot.publish("/retalisInputEvents")
    for text in (
        "shell('true')",
        "event(",
        "halt",
        "assertz(x)",
        "event(3)",
        "",
        "event(a,[2,1])",
        "event(X)",
    ):
        publication.send(serialize_text(text))
    client.send("after(1)")
    assert client.outputs == ["event(after(1),t,s)"]


def test_valid_output_texts_are_published(client: Client) -> None:
    client.robot.subscribe("/alarm")
    publication = client.robot.publish("/retalisOutputEvents")
    for text in (
        "event(std_msgs__0__String('\"x\"'),alarm,m)",
        'event(std_msgs__0__String("y"), alarm, m)',
        "event(std_msgs__0__String(7.5),alarm,m)",
        "event(geometry_msgs__0__Point(1,2,3),alarm,m)",
        "event(std_msgs__0__String(z),no_such_topic,m)",
        "nonsense",
        "event(",
        "event(std_msgs__0__String(last),alarm,m)",
    ):
        publication.send(serialize_text(text))
    assert client.robot.received["/alarm"] == ["x", "y", "last"]


def test_burst_is_processed_in_order(client: Client) -> None:
    client.subscribe("scan(_)")
    client.robot.publish("/scan").send(*(encode(f"{number}") for number in range(3000)))
    assert client.outputs == [f"event(scan('\"{number}\"'),t,s)" for number in range(3000)]


def test_type_of_publisher_is_subscribed(client: Client, network: MemoryNetwork) -> None:
    assert client.add_input("thing", "nowhere_msgs/Thing") == "ok"
    client.subscribe("nowhere_msgs__0__Thing(_,_)")
    definition = DEFINITIONS.add(
        "nowhere_msgs/Thing", "float64 x\nPart[] parts\n" + "=" * 80 + "\nMSG: nowhere_msgs/Part\nstring name"
    )
    MemoryTransport(network, "/maker").advertise("/thing", definition, 10).send(
        b"\0\0\0\0\0\0\xe0?" + b"\1\0\0\0" + b"\3\0\0\0arm"
    )
    assert client.outputs == ["event(nowhere_msgs__0__Thing(0.5,[nowhere_msgs__0__Part('\"arm\"')]),t,s)"]
