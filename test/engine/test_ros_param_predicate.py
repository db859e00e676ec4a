"""ROS parameters that goals read."""

from typing import Any, Dict

import pytest

from retalis import Engine, Reports, RetalisError, Settings
from retalis.engine.ros_param_predicate import no_parameters

NESTED: Any = []
for _ in range(60):
    NESTED = [NESTED]

PARAMETERS: Dict[str, Any] = {
    "/limit": 40.5,
    "~count": 3,
    "on": True,
    "/name": "two words",
    "/group.rate": 10,
    "/arm": {"joints": ["a", "b"], "gains": {"p": 1.5}},
    "/mixed": {1: 2, "a": 3},
    "/empty": [],
    "/nested": NESTED,
    "/date": object(),
}


def engine_with_parameters(strings: str = "plain") -> Engine:
    engine = Engine(settings=Settings(strings=strings))
    engine.on_parameter_read(PARAMETERS.__getitem__)
    return engine


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("/limit", "40.5"),
        ("~count", "3"),
        ("on", "true"),
        ("/name", "'two words'"),
        ("/group.rate", "10"),
        ("/arm", "[gains-[p-1.5],joints-[a,b]]"),
        ("/mixed", "['1'-2,a-3]"),
        ("/empty", "[]"),
    ],
)
def test_parameter_becomes_a_term(name: str, value: str) -> None:
    engine = engine_with_parameters()
    (solution,) = engine.query(f"ros_param('{name}', Value)")
    assert engine.show(solution["Value"]) == value
    assert not engine.call(f"ros_param('{name}', other)")


def test_texts_have_form_of_program() -> None:
    engine = engine_with_parameters("quoted")
    (solution,) = engine.query("ros_param('/name', Value)")
    assert engine.show(solution["Value"]) == """'"two words"'"""


def test_goal_fails_without_parameter() -> None:
    assert not engine_with_parameters().call("ros_param('/unknown', _)")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("'/nested'", "nested more than 50 deep"),
        ("'/date'", "a value of the type object cannot be converted to a term"),
        ("'a b'", "`parameter' expected"),
        ("_", "not sufficiently instantiated"),
        ("3", "`text' expected"),
    ],
)
def test_invalid_parameter_is_an_error(name: str, message: str) -> None:
    with pytest.raises(RetalisError) as error:
        engine_with_parameters().call(f"ros_param({name}, _)")
    assert message in str(error.value)


def test_engine_without_parameters_warns() -> None:
    reports = Reports()
    assert not Engine(reports=reports).call("ros_param('/limit', _)")
    assert reports.warnings == 1


def test_parameter_in_condition_is_read_at_each_event() -> None:
    parameters, events = {"/limit": 40}, []
    engine = Engine()
    engine.on_parameter_read(parameters.__getitem__)
    engine.load(rules="hot(T) <- heat(T) where (ros_param('/limit', Limit), T > Limit).")
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.event("heat(41)", 1)
    parameters["/limit"] = 50
    engine.event("heat(45)", 2)
    assert events == ["heat(41)", "hot(41)", "heat(45)"]


def test_reload_reads_parameters(tmp_path: Any) -> None:
    (tmp_path / "goalPredicates.txt").write_text("ros_param('/limit', L), assertz(limit(L))")
    engine = engine_with_parameters()
    engine.load_program(tmp_path)
    engine.reload(tmp_path)
    assert engine.query("limit(L)") == [{"L": 40.5}]
    engine.on_parameter_read(no_parameters)
    with pytest.raises(RetalisError):
        engine.reload(tmp_path)
