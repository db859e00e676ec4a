"""Control data between the nodes: unread arguments, and subscriptions of goals. Needs rospy, no master."""

import json
from types import SimpleNamespace

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import MessageError, functor  # noqa: E402
from retalis.ros import internode_topics  # noqa: E402
from retalis.ros.internode_topics import (  # noqa: E402
    MAX_CONTROL_CHARACTERS,
    ProjectionReceiver,
    read_subscriptions,
)

IMAGE = functor("image", 3)
HEADER = {"callerid": "/retalis"}


@pytest.fixture
def interface(monkeypatch):
    """Return what the interface knows, with rospy's connections and reports in lists."""
    sources = []
    impl = SimpleNamespace(connections=sources)
    monkeypatch.setattr(internode_topics.rospy, "Subscriber", lambda *_, **__: SimpleNamespace(impl=impl))
    texts, said = [SimpleNamespace(endpoint_id="/retalis")], []
    reports = SimpleNamespace(warning=lambda text, kind: said.append(text))
    known = ProjectionReceiver(lambda: texts, reports)
    return SimpleNamespace(known=known, sources=sources, texts=texts, said=said)


def tell(interface, text, header=HEADER):
    interface.sources.append(SimpleNamespace(header=header, done=False))
    interface.known._receive(SimpleNamespace(data=text, _connection_header=header))  # noqa: SLF001


def test_nothing_is_left_out_before_it_is_told(interface):
    assert interface.known.of(IMAGE) == set()


def test_what_is_told_holds_until_something_else_is(interface):
    tell(interface, '{"image/3": [2, 3], "other/1": [1]}')
    assert interface.known.of(IMAGE) == {2, 3}
    assert interface.known.of(functor("image", 2)) == set()
    tell(interface, '{"image/3": [3]}')
    assert interface.known.of(IMAGE) == {3}
    tell(interface, "{}")
    assert interface.known.of(IMAGE) == set()


def test_it_does_not_hold_where_nobody_or_somebody_else_gets_the_texts(interface):
    tell(interface, '{"image/3": [3]}')
    interface.texts.append(SimpleNamespace(endpoint_id="/rostopic_1"))
    assert interface.known.of(IMAGE) == set()
    del interface.texts[0]
    assert interface.known.of(IMAGE) == set()
    del interface.texts[0]
    assert interface.known.of(IMAGE) == set()
    interface.texts.append(SimpleNamespace(endpoint_id="/retalis"))
    assert interface.known.of(IMAGE) == {3}


def test_it_does_not_hold_once_the_one_who_told_it_is_gone(interface):
    tell(interface, '{"image/3": [3]}')
    interface.sources[0].done = True
    assert interface.known.of(IMAGE) == set()
    interface.sources[:] = [
        SimpleNamespace(header=dict(HEADER), done=False)
    ]  # started anew, and not told yet
    assert interface.known.of(IMAGE) == set()
    del interface.sources[:]
    assert interface.known.of(IMAGE) == set()


@pytest.mark.parametrize(
    "text", ["", "nonsense", "[]", '{"image/3": 3}', '{"image/3": ["3"]}', "[" * 100_000, "1" * 2_000_000]
)
def test_what_is_not_understood_is_said_and_everything_is_written(interface, text):
    tell(interface, '{"image/3": [3]}')
    tell(interface, text)
    assert interface.known.of(IMAGE) == set()
    assert len(interface.said) == 1
    assert len(interface.said[0]) < 1000


SUBSCRIPTION = ["right", "std_msgs/Bool", "bumper_right"]


def test_a_list_of_subscriptions_is_read():
    assert [
        tuple(request) for request in read_subscriptions(json.dumps([SUBSCRIPTION, ["a", "b/C", ""]]))
    ] == [
        tuple(SUBSCRIPTION),
        ("a", "b/C", ""),
    ]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[" * 100_000,
        "[1]",
        json.dumps([SUBSCRIPTION[:2]]),
        json.dumps([[*SUBSCRIPTION[:2], 1]]),
        json.dumps([[*SUBSCRIPTION[:2], "seq"]]),
        json.dumps([[*SUBSCRIPTION[:2], "tf__0__tfMessage"]]),
        json.dumps([[*SUBSCRIPTION[:2], "a(b)"]]),
        json.dumps([SUBSCRIPTION]) + " " * MAX_CONTROL_CHARACTERS,
    ],
)
def test_a_malformed_list_is_refused(text):
    with pytest.raises(MessageError, match="expected topics, types and names of events"):
        read_subscriptions(text)
