"""Flags: accepted values, defaults and effects."""

from typing import Any, List, Tuple

import pytest

from retalis import Engine, ProgramErrors, PrologError, Settings, StreamClock, UsageError
from retalis.events.rules.language_flags import FLAGS
from retalis.prolog.terms.timestamps import SECOND

RULE = "out(X) <- a(X) seq b(X)."
EVENTS = (("a(1)", 1), ("a(9)", 50), ("b(1)", 51))


def engine_and_outputs(rules: str, stream: Any = EVENTS, **flags: Any) -> Tuple[Any, ...]:
    """Return the engine after a stream of events, and the derived events."""
    engine = Engine(clock=StreamClock(1000 * SECOND))
    for name, value in flags.items():
        assert engine.call(f"set_etalis_flag({name}, {value})")
    engine.load(rules=rules)
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append((engine.show(term), int(start) // SECOND)))
    for text, instant in stream:
        engine.event(text, instant)
    return engine, [event for event in events if event[0].startswith("out")]


def value(engine: Engine, name: Any) -> Any:
    (answer,) = engine.query(f"get_etalis_flag({name}, V)")
    return engine.show(answer["V"])


@pytest.mark.parametrize("name", FLAGS)
def test_reset_restores_default_of_flag(name: Any) -> None:
    engine = Engine()
    default = value(engine, name)
    flag = FLAGS[name]
    for accepted in flag.values or (("5", "7") if flag.is_integer else ("5", "2.5")):
        assert engine.call(f"set_etalis_flag({name}, {accepted})")
        assert value(engine, name) == accepted
    assert engine.call("reset_etalis")
    assert value(engine, name) == default


@pytest.mark.parametrize(
    "goal",
    [
        "set_etalis_flag(no_such_flag, on)",
        "set_etalis_flag(out_of_order, yes)",
        "set_etalis_flag(event_consumption_policy, newest)",
        "set_etalis_flag(garbage_window, long)",
        "set_etalis_flag(garbage_control, on)",
        "set_etalis_flag(out_of_order, _)",
        "set_etalis_flag(_, on)",
        "set_etalis_flag(3, on)",
        "get_etalis_flag(no_such_flag, _)",
    ],
)
def test_unknown_flag_or_value_is_refused(goal: str) -> None:
    with pytest.raises(PrologError):
        Engine().call(goal)


@pytest.mark.parametrize("name", ["garbage_window", "garbage_window_step", "max_gap", "state_ttl"])
def test_negative_seconds_are_refused_except_for_none(name: str) -> None:
    engine = Engine()
    for value in (-5, -0.5, "-inf"):
        with pytest.raises(PrologError, match=f"{name} takes a number of seconds from 0, or -1 for none"):
            engine.call(f"set_etalis_flag({name}, {value})")
    assert engine.query(f"get_etalis_flag({name}, X)") == [{"X": -1}]
    for value in (0, 2.5, -1):
        assert engine.call(f"set_etalis_flag({name}, {value})")


def test_negative_setting_is_refused() -> None:
    with pytest.raises(UsageError, match="max_gap: expected a number from 0"):
        Engine(settings=Settings(max_gap=-5))


def test_flags_are_listed() -> None:
    assert len(Engine().query("get_etalis_flag(N, V)")) == len(FLAGS)


def test_file_with_invalid_flag_is_refused() -> None:
    engine = Engine()
    with pytest.raises(ProgramErrors):
        engine.load(rules=":- set_etalis_flag(nonsense, on).\n" + RULE)
    assert not engine.rules.rules


def test_policy_flag_applies_to_stored_matches() -> None:
    rules = "out(X,Y) <- a(X) seq b(Y)."
    engine, outputs = engine_and_outputs(rules, (("a(1)", 1), ("a(2)", 2)))
    engine.on_event(lambda term, start, end: outputs.append(engine.show(term)))
    assert engine.call("set_etalis_flag(event_consumption_policy, chronological)")
    engine.event("b(1)", 3)
    assert engine.call("set_etalis_flag(event_consumption_policy, unrestricted)")
    engine.event("b(2)", 4)
    engine.event("b(3)", 5)
    assert [output for output in outputs if output.startswith("out")] == ["out(1,1)", "out(2,2)", "out(2,3)"]


# ---- garbage control ------------------------------------------------------------------------------------

GENERAL = {"garbage_control": "general", "garbage_window": 10, "garbage_window_step": 1}
PATTERN = "r([{}]) : " + RULE
WINDOW_AND_STEP = "property(window,{}),property(window_step,{})"


def test_general_garbage_control_needs_flag_and_window() -> None:
    assert engine_and_outputs(RULE)[1] == [("out(1)", 1)]
    assert engine_and_outputs(RULE, **GENERAL)[1] == []
    assert engine_and_outputs(RULE, **{**GENERAL, "garbage_control": "off"})[1] == [("out(1)", 1)]
    assert engine_and_outputs(RULE, **{**GENERAL, "garbage_window": -1})[1] == [("out(1)", 1)]
    assert engine_and_outputs(RULE, **{**GENERAL, "garbage_window": 100})[1] == [("out(1)", 1)]


def test_general_garbage_control_runs_once_per_step() -> None:
    assert engine_and_outputs(RULE, **{**GENERAL, "garbage_window_step": 49})[1] == []
    assert engine_and_outputs(RULE, **{**GENERAL, "garbage_window_step": 51})[1] == [("out(1)", 1)]


def test_pattern_garbage_control_needs_both_properties() -> None:
    stream = (("a(1)", 1), ("a(9)", 50), ("b(1)", 2))  # within the window, but late by the rule's clock
    for properties, control, expected in (
        ("property(window_step,1)", "pattern", [("out(1)", 1)]),
        ("property(window_step,1)", "off", [("out(1)", 1)]),
        (WINDOW_AND_STEP.format(100, 1), "pattern", [("out(1)", 1)]),
        (WINDOW_AND_STEP.format(10, 1), "pattern", []),
    ):
        assert engine_and_outputs(PATTERN.format(properties), stream, garbage_control=control)[1] == expected


def test_pattern_control_removes_negated_events() -> None:
    rules = "r([property(window,10),property(window_step,{})]) : out(X) <- e(X) fnot g(X)."
    stream = [(f"g({second})", second) for second in range(100)]
    waiting = [
        engine_and_outputs(rules.format(step), stream, garbage_control=control)[0].rules.match_count
        for control, step in (("off", 1), ("pattern", 1), ("pattern", 30))
    ]
    assert waiting == [100, 11, 20]  # with a step of 30 s last at the 90th second


@pytest.mark.parametrize("name", [name for name, flag in FLAGS.items() if not flag.values])
@pytest.mark.parametrize("number", ["inf", "nan"])
def test_infinite_value_of_flag_is_refused(name: Any, number: str) -> None:
    engine = Engine()
    value_before = value(engine, name)
    with pytest.raises(PrologError, match=f"{name} takes a number of"):
        engine.query(f"X is {number}, set_etalis_flag({name}, X)")
    assert value(engine, name) == value_before
    assert engine.call("set_etalis_flag(max_keys, 3)")


# ---- kept events, sharing -------------------------------------------------------------------------------


@pytest.mark.parametrize(("flag", "expected"), [("on", ["a(1)", "a(9)", "b(1)", "out(1)"]), ("off", [])])
def test_events_are_stored_if_flag_is_on(flag: str, expected: List[str]) -> None:
    engine, _ = engine_and_outputs(RULE, store_fired_events=flag)
    assert [engine.show(answer["E"]) for answer in engine.query("stored_event(event(E,_))")] == expected
    assert [engine.show(answer["E"]) for answer in engine.query("fired_event(E,_)")] == expected


@pytest.mark.parametrize("policy", ["recent", "chronological", "unrestricted"])
def test_rule_sharing_keeps_outputs(policy: str) -> None:
    rules = "out1(X) <- a(X) seq b(X).\nout2(X) <- (a(X) seq b(X)) seq c.\nout1(X) <- d(X).\n"
    stream = (("a(1)", 1), ("b(1)", 2), ("d(7)", 3), ("c", 4), ("c", 5))
    on = engine_and_outputs(rules, stream, event_consumption_policy=policy, rule_sharing="on")[1]
    off = engine_and_outputs(rules, stream, event_consumption_policy=policy, rule_sharing="off")[1]
    assert on == off
    assert on[:3] == [("out1(1)", 1), ("out1(7)", 3), ("out2(1)", 1)]
    assert len(on) == (4 if policy == "unrestricted" else 3)


@pytest.mark.parametrize("switch", [name for name, flag in FLAGS.items() if flag.values == ("off", "on")])
def test_switch_keeps_outputs_of_plain_program(switch: Any) -> None:
    for state in ("on", "off"):
        assert engine_and_outputs(RULE, **{switch: state})[1] == [("out(1)", 1)]
