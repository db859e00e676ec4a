"""Parsing and size limits of service requests. Needs rospy, no master."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Engine  # noqa: E402
from retalis.ros1 import services  # noqa: E402


def test_a_long_format_is_walked_through_once_and_not_for_each_of_its_variables(monkeypatch):
    walked = []
    variables = services.variables
    monkeypatch.setattr(services, "variables", lambda term: walked.append(term) or variables(term))
    reader = services.EngineServices.__new__(services.EngineServices)
    reader._engine = Engine()  # noqa: SLF001
    slots = ",".join(f"X{at}" for at in range(200))
    request = SimpleNamespace(event=f"a({slots})", conditions="", format=f"b({slots},Y)")
    found = reader._parse_request(request)  # noqa: SLF001
    assert found.unbound_names == ["Y"]
    assert len(walked) < 5


def test_a_long_request_is_refused_unread(monkeypatch):
    provided = {}
    monkeypatch.setattr(
        services.rospy, "Service", lambda name, kind, handler: provided.update({name: handler})
    )
    handled = []
    services.offer_service("~query", object, lambda request: handled.append(request) or "done")

    def call(goal, wait_for):
        request = SimpleNamespace(__slots__=["goal", "wait_for", "seconds"], seconds=1.0)
        request.goal, request.wait_for = goal, wait_for
        return provided["~query"](request)

    half = services.MAX_REQUEST_CHARACTERS // 2
    assert call("a" * half, ["b", "b" * (half - 1)]) == "done"
    assert len(handled) == 1
    assert call("a" * half, ["b", "b" * half]) == {
        "result": "error: the request has 100001 characters: expected at most 100000"
    }
    assert len(handled) == 1
