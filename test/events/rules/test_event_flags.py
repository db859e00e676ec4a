"""Flags: accepted values, defaults and effects."""

import pytest

from retalis import Engine, ProgramErrors, PrologError, Settings, StreamClock, UsageError
from retalis.events.rules.event_flags import FLAGS
from retalis.prolog.terms.timestamps import SECOND

SEQ = "out(X) <- a(X) seq b(X)."
AB = (("a(1)", 1), ("a(9)", 50), ("b(1)", 51))


def run(rules, stream=AB, **flags):
    """Return the engine after a stream of instants, and what it derived."""
    engine = Engine(clock=StreamClock(1000 * SECOND))
    for name, value in flags.items():
        assert engine.call(f"set_etalis_flag({name}, {value})")
    engine.load(rules=rules)
    seen = []
    engine.on_event(lambda term, start, end: seen.append((engine.show(term), int(start) // SECOND)))
    for text, instant in stream:
        engine.event(text, instant)
    return engine, [event for event in seen if event[0].startswith("out")]


def value(engine, name):
    (answer,) = engine.query(f"get_etalis_flag({name}, V)")
    return engine.show(answer["V"])


@pytest.mark.parametrize("name", FLAGS)
def test_every_flag_has_its_default_and_comes_back_to_it(name):
    engine = Engine()
    default = value(engine, name)
    flag = FLAGS[name]
    for one in flag.values or (("5", "7") if flag.is_integer else ("5", "2.5")):
        assert engine.call(f"set_etalis_flag({name}, {one})")
        assert value(engine, name) == one
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
def test_unknown_names_and_values_are_errors(goal):
    with pytest.raises(PrologError):
        Engine().call(goal)


@pytest.mark.parametrize("name", ["garbage_window", "garbage_window_step", "max_gap", "state_ttl"])
def test_seconds_are_not_negative_except_for_none(name):
    engine = Engine()
    for value in (-5, -0.5, "-inf"):
        with pytest.raises(PrologError, match=f"{name} takes a number of seconds from 0, or -1 for none"):
            engine.call(f"set_etalis_flag({name}, {value})")
    assert engine.query(f"get_etalis_flag({name}, X)") == [{"X": -1}]
    for value in (0, 2.5, -1):
        assert engine.call(f"set_etalis_flag({name}, {value})")


def test_a_negative_setting_of_a_flag_is_an_error():
    with pytest.raises(UsageError, match="max_gap takes a number of seconds from 0"):
        Engine(settings=Settings(max_gap=-5))


def test_all_flags_can_be_listed():
    assert len(Engine().query("get_etalis_flag(N, V)")) == len(FLAGS)


def test_a_directive_that_sets_a_wrong_flag_refuses_the_file():
    engine = Engine()
    with pytest.raises(ProgramErrors):
        engine.load(rules=":- set_etalis_flag(nonsense, on).\n" + SEQ)
    assert not engine.rules.rules


def test_the_policy_holds_at_once_for_what_waits():
    rules = "out(X,Y) <- a(X) seq b(Y)."
    engine, seen = run(rules, (("a(1)", 1), ("a(2)", 2)))
    engine.on_event(lambda term, start, end: seen.append(engine.show(term)))
    assert engine.call("set_etalis_flag(event_consumption_policy, chronological)")
    engine.event("b(1)", 3)
    assert engine.call("set_etalis_flag(event_consumption_policy, unrestricted)")
    engine.event("b(2)", 4)
    engine.event("b(3)", 5)
    assert [one for one in seen if one.startswith("out")] == ["out(1,1)", "out(2,2)", "out(2,3)"]


# ---- garbage control ------------------------------------------------------------------------------------

GENERAL = {"garbage_control": "general", "garbage_window": 10, "garbage_window_step": 1}
PATTERN = "r([{}]) : " + SEQ
BOTH = "property(window,{}),property(window_step,{})"


def test_general_garbage_control_needs_its_flag_and_a_window():
    assert run(SEQ)[1] == [("out(1)", 1)]
    assert run(SEQ, **GENERAL)[1] == []
    assert run(SEQ, **{**GENERAL, "garbage_control": "off"})[1] == [("out(1)", 1)]
    assert run(SEQ, **{**GENERAL, "garbage_window": -1})[1] == [("out(1)", 1)]
    assert run(SEQ, **{**GENERAL, "garbage_window": 100})[1] == [("out(1)", 1)]


def test_general_garbage_control_collects_at_most_once_a_step():
    assert run(SEQ, **{**GENERAL, "garbage_window_step": 49})[1] == []
    assert run(SEQ, **{**GENERAL, "garbage_window_step": 51})[1] == [("out(1)", 1)]


def test_pattern_garbage_control_needs_both_properties():
    stream = (("a(1)", 1), ("a(9)", 50), ("b(1)", 2))  # within the window, but late by the rule's clock
    for properties, control, wanted in (
        ("property(window_step,1)", "pattern", [("out(1)", 1)]),
        ("property(window_step,1)", "off", [("out(1)", 1)]),
        (BOTH.format(100, 1), "pattern", [("out(1)", 1)]),
        (BOTH.format(10, 1), "pattern", []),
    ):
        assert run(PATTERN.format(properties), stream, garbage_control=control)[1] == wanted


def test_pattern_garbage_control_removes_what_no_window_does():
    rules = "r([property(window,10),property(window_step,{})]) : out(X) <- e(X) fnot g(X)."
    stream = [(f"g({at})", at) for at in range(100)]
    waiting = [
        run(rules.format(step), stream, garbage_control=control)[0].rules.match_count
        for control, step in (("off", 1), ("pattern", 1), ("pattern", 30))
    ]
    assert waiting == [100, 11, 20]  # with a step of 30 s last at the 90th second


@pytest.mark.parametrize("name", [name for name, flag in FLAGS.items() if not flag.values])
@pytest.mark.parametrize("number", ["inf", "nan"])
def test_a_number_that_is_not_finite_is_refused_and_not_stored(name, number):
    engine = Engine()
    before = value(engine, name)
    with pytest.raises(PrologError, match=f"{name} takes a number of"):
        engine.query(f"X is {number}, set_etalis_flag({name}, X)")
    assert value(engine, name) == before
    assert engine.call("set_etalis_flag(max_keys, 3)")


# ---- kept events, sharing -------------------------------------------------------------------------------


@pytest.mark.parametrize("flag, wanted", [("on", ["a(1)", "a(9)", "b(1)", "out(1)"]), ("off", [])])
def test_fired_events_are_stored_only_when_asked_for(flag, wanted):
    engine, _ = run(SEQ, store_fired_events=flag)
    assert [engine.show(answer["E"]) for answer in engine.query("stored_event(event(E,_))")] == wanted
    assert [engine.show(answer["E"]) for answer in engine.query("fired_event(E,_)")] == wanted


@pytest.mark.parametrize("policy", ["recent", "chronological", "unrestricted"])
def test_sharing_changes_nothing(policy):
    rules = "out1(X) <- a(X) seq b(X).\nout2(X) <- (a(X) seq b(X)) seq c.\nout1(X) <- d(X).\n"
    stream = (("a(1)", 1), ("b(1)", 2), ("d(7)", 3), ("c", 4), ("c", 5))
    on = run(rules, stream, event_consumption_policy=policy, rule_sharing="on")[1]
    off = run(rules, stream, event_consumption_policy=policy, rule_sharing="off")[1]
    assert on == off
    assert on[:3] == [("out1(1)", 1), ("out1(7)", 3), ("out2(1)", 1)]
    assert len(on) == (4 if policy == "unrestricted" else 3)


@pytest.mark.parametrize("switch", [name for name, flag in FLAGS.items() if flag.values == ("off", "on")])
def test_no_switch_changes_what_a_plain_program_fires(switch):
    for state in ("on", "off"):
        assert run(SEQ, **{switch: state})[1] == [("out(1)", 1)]
