"""Rules on ROS 1 that call services, with a reply and each kind of failure, and read a parameter."""

import socket
from contextlib import closing
from pathlib import Path
from typing import Any, Callable, List

import pytest

from retalis import Clock, Engine
from retalis.engine.service_calls import ServiceCall

PUB_SUB = """\
<publish_subscribe strings="plain">
  <subscribe_to name="start" msg_type="std_msgs/String" event="start"/>
  <publish_to name="ends" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = """\
compile_event_file('rules.txt')
subscribe(end(Text), [], std_msgs__0__String(Text), ends, s1)
"""
RULES = """\
start(_) do (
    ros_service('arm', 'std_srvs/SetBool', std_srvs__0__SetBool_Request{data: true}, reply),
    ros_service('/arm', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, type),
    ros_service('/broken', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, error),
    ros_service('/missing', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, missing),
    ros_service('/slow', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, slow, [timeout(0.2)]),
    ros_service('/other', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, other)).
end(Text) <- start(_) where (ros_param('/arm/limit', Limit), atomic_list_concat([limit, Limit], ': ', Text)).
end(Text) <- service_failed(_, Id, Reason) where atomic_list_concat([Id, Reason], ': ', Text).
end(Text) <- service_reply(_, Id, std_srvs__0__SetBool_Response(true, Message))
    where atomic_list_concat([Id, Message], ': ', Text).
"""
PEER = """\
import threading
import rospy
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

rospy.init_node("peer")
ended = threading.Event()


def fail(request):
    raise rospy.ServiceException("no power")


def wait(request):
    ended.wait(30)


rospy.Service("arm", SetBool, lambda request: (request.data, "up"))
rospy.Service("broken", Trigger, fail)
rospy.Service("slow", Trigger, wait)
start = rospy.Publisher("start", String, queue_size=1)
received = set()
rospy.Subscriber("ends", String, lambda message: received.add(message.data))
while len(received) < 8 and not rospy.is_shutdown():
    start.publish("now")
    rospy.sleep(0.5)
    if "limit: 40" in received:
        rospy.set_param("/arm/limit", 50)
ended.set()
print("\\n".join(sorted(received)))
"""


def test_rules_call_services_and_read_parameters(devel: Any, tmp_path: Path) -> None:
    (tmp_path / "pub_sub.xml").write_text(PUB_SUB)
    (tmp_path / "goalPredicates.txt").write_text(GOALS)
    (tmp_path / "rules.txt").write_text(RULES)
    (tmp_path / "peer.py").write_text(PEER)
    devel.start_master()
    devel.run("rosparam", "set", "/arm/limit", "40")
    options = [f"program:={tmp_path}", "allow_services:=[/arm, /broken, /missing, /slow]"]
    devel.start("roslaunch", "retalis", "retalis.launch", "use_sim_time:=false", *options)
    devel.expect(lambda nodes, services: "/retalis/reload" in services)
    lines = devel.run("python3", str(tmp_path / "peer.py")).splitlines()
    assert lines == [
        "error: its node reports an error: service cannot process request: no power",
        "limit: 40",
        "limit: 50",
        "missing: no node offers it",
        "other: goals may not call /other: add it to the parameter ~allow_services, which lists /arm, /broken, "
        "/missing, /slow",
        "reply: up",
        "slow: no reply within 0.2 s",
        "type: it has another type than std_srvs/Trigger",
    ]


def call_with_master(monkeypatch: pytest.MonkeyPatch, look_up: Callable[[ServiceCall], str]) -> List[str]:
    """Call a service with a function in place of the master's; return the texts of the events."""
    rosgraph = pytest.importorskip("rosgraph", reason="ROS is not installed")
    from retalis.ros1.rospy_transport import call_service  # noqa: PLC0415

    engine, events = Engine(Clock()), []
    calls: List[ServiceCall] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.on_service_call(calls.append)
    assert engine.call("ros_service('/dock', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, a)")
    monkeypatch.setattr(rosgraph.Master, "lookupService", lambda master, name: look_up(calls[0]))
    call_service("/dock", calls[0])
    return events[1:]


def test_request_is_not_sent_after_end_of_call(monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        server.setblocking(False)

        def look_up(call: ServiceCall) -> str:
            call.fail("no reply within 5 s")
            return f"rosrpc://127.0.0.1:{server.getsockname()[1]}"

        events = call_with_master(monkeypatch, look_up)
        with pytest.raises(BlockingIOError):
            server.accept()
    assert events == ["service_failed('/dock',a,'no reply within 5 s')"]


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ("no provider", "no node offers it"),
        ("ERROR: bad name", "the master reports an error: ERROR: bad name"),
    ],
)
def test_errors_of_master_have_reasons(monkeypatch: pytest.MonkeyPatch, message: str, reason: str) -> None:
    def look_up(call: ServiceCall) -> str:
        raise pytest.importorskip("rosgraph").MasterError(message)

    assert call_with_master(monkeypatch, look_up) == [f"service_failed('/dock',a,'{reason}')"]
