"""Calls of services by goals: events, failures and limits."""

from typing import Any, List

import pytest

from retalis import Clock, Engine, PrologError, Reports, Settings, Term
from retalis.engine.service_calls import MAX_CALLS_UNDER_WAY, ServiceCall

SET = "ros_service('/arm', 'std_srvs/SetBool', {}, {})"
ON = "std_srvs__0__SetBool_Request(true)"
REPLY = b"\1\2\0\0\0up"


class CallingEngine:
    """An engine whose calls of services are collected.

    Attributes:
        engine: the engine.
        calls: the calls.
        events: texts of its events, without those of calls.
    """

    def __init__(self) -> None:
        self.calls: List[ServiceCall] = []
        self.events: List[str] = []
        self.reports = Reports()
        self.engine = Engine(Clock(lambda: 10**18), reports=self.reports)
        self.engine.on_service_call(self.calls.append)
        self.engine.on_event(self._record_end)

    def _record_end(self, term: Term, start: int, end: int) -> None:
        text = self.engine.show(term)
        if not text.startswith("service_call("):
            self.events.append(text)

    def call(self, request: str = ON, call_id: str = "a") -> None:
        assert self.engine.call(SET.format(request, call_id))


@pytest.fixture
def calling() -> CallingEngine:
    return CallingEngine()


@pytest.mark.parametrize("request_text", [ON, "std_srvs__0__SetBool_Request{data: true}"])
def test_reply_of_service_is_an_event(calling: CallingEngine, request_text: str) -> None:
    calling.call(request_text, "arm(1)")
    (call,) = calling.calls
    assert (call.request.name, call.request.type, call.request.data) == ("/arm", "std_srvs/SetBool", b"\1")
    assert calling.events == []
    call.reply(REPLY)
    assert calling.events == ["""service_reply('/arm',arm(1),std_srvs__0__SetBool_Response(true,'"up"'))"""]


def test_call_is_an_event(calling: CallingEngine) -> None:
    calling.engine.load("called(Id) <- service_call('/arm', Id, std_srvs__0__SetBool_Request(true)).")
    calling.call(call_id="arm(1)")
    assert calling.events == ["called(arm(1))"]


def test_rule_joins_replies_with_calls(calling: CallingEngine) -> None:
    calling.engine.load(
        f"lift(X) do {SET.format(ON, 'X')}.\n"
        "lifted(X) <- lift(X) seq service_reply('/arm', X, std_srvs__0__SetBool_Response(true, _)).\n"
    )
    for side in ("left", "right"):
        calling.engine.event(f"lift({side})")
    for call in reversed(calling.calls):
        call.reply(REPLY)
    assert [event for event in calling.events if event.startswith("lifted")] == [
        "lifted(right)",
        "lifted(left)",
    ]


def test_first_end_of_call_counts(calling: CallingEngine) -> None:
    ends: List[int] = []
    calling.call()
    (call,) = calling.calls
    call.on_end(lambda: ends.append(1))
    call.fail("too slow")
    call.reply(REPLY)
    call.on_end(lambda: ends.append(2))
    assert calling.events == ["service_failed('/arm',a,'too slow')"]
    assert ends == [1, 2]


@pytest.mark.parametrize(
    ("goal", "reason"),
    [
        (SET.format("std_srvs__0__SetBool_Request(up)", "a"), "the request does not fit std_srvs/SetBool: "),
        (SET.format("_", "a"), "got an unbound variable"),
        ("ros_service('/arm', 'no_pkg/Type', x, a)", "the service type no_pkg/Type is unknown: "),
    ],
)
def test_wrong_call_is_an_event(calling: CallingEngine, goal: str, reason: str) -> None:
    assert calling.engine.call(goal)
    assert calling.calls == []
    (event,) = calling.events
    assert event.startswith("service_failed('/arm',a,'")
    assert reason in event
    assert calling.reports.warnings == 1


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (SET.format(ON, "X"), "not sufficiently instantiated"),
        ("ros_service('a b', 'std_srvs/SetBool', x, a)", "`service' expected"),
        ("ros_service('/arm', 'SetBool', x, a)", "`service_type' expected"),
        ("ros_service('/arm', 'std_srvs/SetBool', x, a, timeout(1))", "`list' expected"),
        ("ros_service('/arm', 'std_srvs/SetBool', x, a, [wait(1)])", "expected timeout(Seconds)"),
        ("ros_service('/arm', 'std_srvs/SetBool', x, a, [timeout(0)])", "more than 0"),
        ("ros_service('/arm', 'std_srvs/SetBool', x, a, [timeout(b)])", "`number' expected"),
    ],
)
def test_wrong_argument_is_an_error_of_goal(calling: CallingEngine, goal: str, message: str) -> None:
    with pytest.raises(PrologError) as error:
        calling.engine.call(goal)
    assert message in str(error.value)
    assert (calling.calls, calling.events) == ([], [])


def test_option_sets_time_limit(calling: CallingEngine) -> None:
    assert calling.engine.call(f"ros_service('/arm', 'std_srvs/SetBool', {ON}, a, [timeout(0.5)])")
    assert calling.calls[0].request.seconds == 0.5


def test_calls_beyond_limit_are_refused(calling: CallingEngine) -> None:
    for number in range(MAX_CALLS_UNDER_WAY + 1):
        calling.call(call_id=str(number))
    assert calling.events == [
        f"service_failed('/arm',{MAX_CALLS_UNDER_WAY},'100 calls are under way: this one is refused')"
    ]
    calling.calls[0].reply(REPLY)
    calling.call()
    status: Any = calling.engine.status().services
    assert tuple(status) == (MAX_CALLS_UNDER_WAY + 2, MAX_CALLS_UNDER_WAY, 1, 1)


def test_reply_of_another_type_is_a_failure(calling: CallingEngine) -> None:
    calling.call()
    calling.calls[0].reply(b"\1")
    (event,) = calling.events
    assert event.startswith("service_failed('/arm',a,'the reply does not fit std_srvs/SetBool: ")


def test_engine_without_services_fails_calls() -> None:
    engine, events = Engine(Clock()), []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    assert engine.call(SET.format(ON, "a"))
    assert events[1].startswith("service_failed('/arm',a,'services are called only in a node: use --answers")


def test_interrupted_call_fails_after_restoration(calling: CallingEngine) -> None:
    calling.call(call_id="arm(1)")
    calling.call(call_id="arm(2)")
    calling.calls[1].reply(REPLY)
    restored = Engine.restore(calling.engine.snapshot(), Clock(lambda: 10**18))
    events: List[str] = []
    restored.on_event(lambda term, start, end: events.append(restored.show(term)))
    status = restored.status().services
    assert status is not None
    assert (status.calls, status.failed) == (2, 0)
    restored.fail_interrupted_calls()
    restored.fail_interrupted_calls()
    assert events == ["service_failed('/arm',arm(1),'the program ended before the reply')"]
    assert restored.status().services == status._replace(failed=1, under_way=0)


def test_interrupted_calls_of_several_restorations_are_limited(calling: CallingEngine) -> None:
    engine = calling.engine
    for _ in range(3):
        for number in range(MAX_CALLS_UNDER_WAY):
            assert engine.call(SET.format(ON, number))
        engine = Engine.restore(engine.snapshot(), Clock(lambda: 10**18))
        engine.on_service_call(lambda call: None)
    events: List[str] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    status: Any = engine.status().services
    assert (status.calls, status.failed) == (3 * MAX_CALLS_UNDER_WAY, 2 * MAX_CALLS_UNDER_WAY)
    engine.fail_interrupted_calls()
    assert len(events) == MAX_CALLS_UNDER_WAY


def test_error_of_caller_fails_call(calling: CallingEngine) -> None:
    calling.engine.on_service_call(lambda call: 1 / 0)
    for _ in range(3):
        calling.call()
    assert (
        calling.events
        == ["service_failed('/arm',a,'the callback of on_service_call raised ZeroDivisionError')"] * 3
    )
    status: Any = calling.engine.status().services
    assert (status.under_way, status.failed, calling.reports.errors) == (0, 3, 3)


def test_error_in_callback_of_end_does_not_keep_call(calling: CallingEngine) -> None:
    ends: List[int] = []
    calling.call()
    (call,) = calling.calls
    call.on_end(lambda: 1 / 0)
    call.on_end(lambda: ends.append(1))
    with pytest.raises(ZeroDivisionError):
        call.fail("too slow")
    assert calling.events == ["service_failed('/arm',a,'too slow')"]
    assert ends == [1]
    status: Any = calling.engine.status().services
    assert status.under_way == 0


def test_call_knows_whether_it_has_ended(calling: CallingEngine) -> None:
    calling.call()
    (call,) = calling.calls
    assert not call.is_ended
    call.fail("too slow")
    assert call.is_ended


@pytest.mark.parametrize(
    ("call_count", "reply_count"), [(20, 20), (MAX_CALLS_UNDER_WAY + 5, MAX_CALLS_UNDER_WAY)]
)
def test_full_queue_drops_no_accepted_call(call_count: int, reply_count: int) -> None:
    engine, names = Engine(Clock(), settings=Settings(queue=10)), []
    engine.on_service_call(lambda call: call.reply(REPLY))
    engine.on_event(lambda term, start, end: names.append(engine.show(term).partition("(")[0]))
    goal = SET.format(ON, "X")
    engine.load(rules=f"go do (between(1, {call_count}, X), {goal}, fail ; true).")
    engine.event("go")
    assert names.count("service_reply") == reply_count
    status: Any = engine.status().services
    refused_count = call_count - reply_count
    assert tuple(status) == (call_count, 0, refused_count, refused_count)
