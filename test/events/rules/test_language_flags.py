"""Flags: accepted values, defaults and effects."""

from typing import Any, List, Tuple

import pytest
from events.program_runner import ProgramRunner, outputs_of

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


def test_general_garbage_control_removes_matches() -> None:
    flags = [("garbage_window", 2), ("garbage_window_step", 1), ("garbage_control", "general")]
    rules = "c(X) <- a(X) seq b(X). f(X) <- e fnot g(X). s(N) <- i(X) seq aggregate(count, j(X), N)."
    stream = " ".join(f"a({i})@{i} g({i})@{i} i({i})@{i}" for i in range(50))
    program, collecting_program = ProgramRunner(rules), ProgramRunner(rules, flags)
    program.feed(stream)
    collecting_program.feed(stream)
    assert program.engine.rules.match_count == 101
    assert collecting_program.engine.rules.match_count < 10


def test_garbage_control_keeps_active_runs() -> None:
    flags = [("garbage_window", 10), ("garbage_window_step", 1), ("garbage_control", "general")]
    program = ProgramRunner("s(N) <- i seq aggregate(count, j, N). t <- i seq j star_times.", flags)
    assert program.feed("i@1 j@8") == "s(0)@1-1 t@1-1 s(1)@1-8 t@1-8"
    assert program.feed("j@17 j@26") == "s(2)@1-17 t@1-17 s(3)@1-26 t@1-26"
    assert program.feed("j@38") == ""
    assert program.engine.rules.match_count == 0


def test_pattern_garbage_control_uses_windows() -> None:
    rules = (
        "r([property(window,50), property(window_step,1)]) : c(X) <- a(X) seq b(X). d(X) <- a(X) seq e(X)."
    )
    program = ProgramRunner(rules, [("garbage_control", "pattern")])
    program.feed(" ".join(f"a({i})@{i}" for i in range(200)))
    assert [rule.stored_match_count for rule in program.engine.rules.rules] == [51, 200]


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


# ---- late events ----------------------------------------------------------------------------------------


def test_rule_has_own_out_of_order_property() -> None:
    rules = "r([property(out_of_order,{})]) : c <- a seq b. d <- a seq b."
    assert outputs_of(rules.format("on"), "b@5 a@2") == "c@2-5"
    assert outputs_of(rules.format("off"), "b@5 a@2", flags=["out_of_order"]) == "d@2-5"


def test_negated_event_is_kept_for_late_first_side() -> None:
    rules = "r([property(window,3),property(out_of_order,on)]) : c <- (a seq b) cnot d."
    assert outputs_of(rules, "b@2 b@4 a@1") == "c@1-4"
    assert outputs_of(rules, "d@1.5 b@2 b@4 a@1") == ""


@pytest.mark.parametrize(
    ("rule", "stream", "expected"),
    [
        ("c <- a seq b.", "b@2 a@1", "c@1-2"),
        ("c <- (a seq b) cnot d.", "d@2 b@3 a@1", ""),
        ("c(X) <- a(X) forall_seq b.", "b@3 a(1)@1", "c(1)@1-3"),
        ("c <- a seq b seq d.", "d@3 b@2 a@1", "c@1-3"),
        ("c <- a forall_seq a.", "a@33 a@29-31", "c@29-33"),
    ],
)
def test_out_of_order_flag_accepts_late_events(rule: str, stream: str, expected: str) -> None:
    assert outputs_of(rule, stream) == ""
    assert outputs_of(rule, stream, flags=["out_of_order"]) == expected


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        ("recent", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-6 n(2)@1-8"),
        ("recent_2", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-2 n(2)@1-6 n(3)@1-8"),
        ("chronological", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-2 n(2)@1-6 n(3)@3-8"),
        ("unrestricted", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-2 n(2)@1-4 n(3)@1-6 n(3)@3-8 n(4)@1-8"),
    ],
)
def test_late_start_includes_earlier_repetitions(policy: str, expected: str) -> None:
    rules, stream = "n(N) <- a seq aggregate(count, b, N).", "b@2 b@4 a@3 b@6 a@1 b@8"
    assert outputs_of(rules, stream, policy, ["out_of_order"]) == expected
    assert "n(1)@3-4" not in outputs_of(rules, stream, policy)


def test_late_first_side_consumes_no_second_side() -> None:
    rule, flags = "c(X) <- a forall_seq b(X).", ["out_of_order"]
    assert (
        outputs_of(rule, "b(1)@5 b(2)@6 a@2 a@3", "unrestricted", flags)
        == "c(1)@2-5 c(2)@2-6 c(1)@3-5 c(2)@3-6"
    )
    assert outputs_of(rule, "b(1)@5 b(2)@6 a@2 a@3", "chronological", flags) == "c(1)@2-5 c(2)@3-6"
