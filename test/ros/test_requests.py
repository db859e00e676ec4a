"""Requests of services as they are read. Needs rospy, no master."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Engine  # noqa: E402
from retalis.ros import services  # noqa: E402


def test_a_long_format_is_walked_through_once_and_not_for_each_of_its_variables(monkeypatch):
    walked = []
    variables = services.variables
    monkeypatch.setattr(services, "variables", lambda term: walked.append(term) or variables(term))
    reader = services.EngineServices.__new__(services.EngineServices)
    reader._engine = Engine()  # noqa: SLF001
    slots = ",".join(f"X{at}" for at in range(200))
    found = reader._fields(SimpleNamespace(event=f"a({slots})", conditions="", format=f"b({slots},Y)"))
    assert found.free == ["Y"]
    assert len(walked) < 5
