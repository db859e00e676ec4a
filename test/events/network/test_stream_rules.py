"""Stream operators in rules: deadlines, state and reports."""

import re
from fractions import Fraction
from pathlib import Path
from typing import Any, Iterator, List, Tuple

import pytest
from asserting_accessors import stream_clock
from events.program_runner import outputs_of
from events.streams.operator_driver import entry_count
from recording_reports import RecordingReports

from retalis import Clock, Engine, RetalisError, StreamClock
from retalis.events.network.event_rule import EventRule
from retalis.prolog.terms.timestamps import SECOND


class EngineDriver(Engine):
    """An engine that records the events of rules, and the reports."""

    def __init__(self, rules: Any, max_stored: Any = None, clock: Any = None) -> None:
        recording = RecordingReports()
        super().__init__(clock, reports=recording)
        self.recording = recording
        if max_stored is not None:
            self.rules.network.limit_stored(max_stored)
        self.outputs: List[Any] = []
        self.load(rules=rules)
        self.on_event(self._record)

    def _record(self, term: Any, start: Any, end: Any) -> None:
        text = self.show(term)
        if not text.startswith(("in", "no", "tick")):
            self.outputs.append(f"{text}@{start / SECOND:g}-{end / SECOND:g}")

    def feed(self, text: str) -> str:
        """Process events, each as ``event@end`` or ``event@start-end``; return the outputs of rules."""
        del self.outputs[:]
        for item in text.split():
            event, timestamp = item.rsplit("@", 1)
            start, _, end = timestamp.partition("-")
            self.event(event, float(start), float(end or start))
        return " ".join(self.outputs)

    @property
    def problems(self) -> List[str]:
        return self.recording.messages

    @property
    def event_rules(self) -> List[EventRule]:
        return self.rules.rules

    def streams(self) -> List[Any]:
        """Return the operators of all rules."""
        return [node.stream for rule in self.event_rules for node in rule.nodes if hasattr(node, "stream")]


EVERY = "{0}(N) <- aggregate(count, in(_), N, every({1})).\n"


def test_due_outputs_precede_event_of_same_instant() -> None:
    rules = EVERY.format("b", 3) + EVERY.format("a", 2) + "c(X) <- in(X) seq absent(in(_), 4). d <- tick."
    engine = EngineDriver(rules)
    assert engine.feed("in(1)@1 tick@6") == "a(1)@0-2 b(1)@0-3 c(1)@1-5 d@6-6"
    assert engine.feed("in(1)@7 tick@12") == "a(1)@6-8 b(1)@6-9 c(1)@7-11 d@12-12"


def test_deadlines_of_one_instant_are_ordered() -> None:
    rules = EVERY.format("b", 2) + EVERY.format("a", 2)
    assert EngineDriver(rules).feed("in(1)@1 tick@2") == "b(1)@0-2 a(1)@0-2"
    inner = "w(N) <- aggregate(count, (in(X) with debounce(1)), N, every(2))."
    assert EngineDriver(inner).feed("in(1)@0.5 tick@9") == "w(1)@0-2"
    assert EngineDriver(inner).feed("in(1)@1 tick@9") == "w(1)@2-4"


@pytest.mark.parametrize(
    "rule",
    [
        "bad(S) <- aggregate(fold(zero, add, add, X), in(X), S, every(2)). zero(0). add(_, S, T) :- T is S + x.",
        "bad <- aggregate(count, in(_), _, every(2)) do throw(no).",
        "bad <- aggregate(count, in(_), N, every(2)) where N > x.",
    ],
)
def test_error_of_rule_leaves_other_deadlines(rule: str) -> None:
    engine = EngineDriver(EVERY.format("a", 2) + rule + "\n" + EVERY.format("z", 2))
    assert engine.feed("in(1)@1 in(2)@1.5 in(3)@3 tick@9") == "a(2)@0-2 z(2)@0-2 a(1)@2-4 z(1)@2-4"
    assert engine.problems


@pytest.mark.parametrize(
    ("stream", "is_emitted"),
    [
        ("a(_,1)@1 b(2,3)@2", True),
        ("a(2,1)@1 b(_,3)@2", True),
        ("b(_,3)@2 a(2,1)@1", True),
        ("a(_,1)@1 b(2,1)@2", False),
        ("b(_,1)@2 a(2,1)@1", False),
    ],
)
def test_absent_event_cancels_unifying_events(stream: str, is_emitted: bool) -> None:
    engine = EngineDriver("o(Y) <- a(X, Y) seq absent(b(X, Y), 3).")
    assert engine.feed(f"{stream} tick@9").endswith(" o(1)@1-4") == is_emitted


def test_deleted_rule_has_no_deadlines() -> None:
    engine = EngineDriver(EVERY.format("a", 2) + EVERY.format("z", 2))
    engine.feed("in(1)@1")
    event_rules = engine.rules
    event_rules.remove(event_rules.rules[0])
    assert engine.feed("tick@9") == "z(1)@0-2"


def test_clock_moved_back_clears_state() -> None:
    rules = (
        EVERY.format("a", 2)
        + "w(X) <- aggregate(list(Y), in(Y), X, last(100)). t(X) <- in(X) with throttle(100). "
        + "c(X) <- in(X) seq absent(no, 5). d(X) <- in(X) with debounce(1)."
    )
    engine = EngineDriver(rules)
    engine.feed("in(1)@50")
    assert sum(len(stream) for stream in engine.streams()) == 5
    stream_clock(engine).move_to(0, back=True)
    engine.advance()
    assert sum(len(stream) for stream in engine.streams()) == 0
    assert sum(rule.match_count for rule in engine.event_rules) == 0
    assert engine.feed("in(2)@1") == "w([2])@1-1 t(2)@1-1"
    assert engine.feed("tick@20") == "a(1)@0-2 d(2)@1-2 c(2)@1-6"


@pytest.mark.parametrize("late", ["on", "off"])
def test_absence_takes_time_from_variable(late: str) -> None:
    """Each match has its own time; it may be bound by a condition, and equals the time of a constant."""
    rules = "limit(1, 3). limit(2, 1.5).\n" + f":- set_etalis_flag(out_of_order, {late}).\n"
    variable = EngineDriver(rules + "o(X) <- (in(X) where limit(X, N)) seq absent(no(X), N).")
    constants = EngineDriver(
        rules + "o(1) <- in(1) seq absent(no(1), 3).\no(2) <- in(2) seq absent(no(2), 1.5)."
    )
    events = "in(1)@1 in(2)@1 no(2)@2-5 in(1)@2 no(1)@3 in(2)@6 no(1)@9 in(1)@8 in(1)@8.5 no(2)@8 tick@20"
    outputs = variable.feed(events)
    assert outputs == constants.feed(events)
    assert outputs == "o(2)@1-2.5 o(1)@1-4 o(2)@6-7.5"


def test_invalid_time_of_absence_is_reported_and_skipped() -> None:
    engine = EngineDriver("o(X) <- in(X, N) seq absent(no(X), N).")
    invalid = ["x", "0", "-1", "0.0", "1.0e-12", "nan", "inf", "1+1", "[]", "_", str(10**30)]
    for term in invalid:
        engine.event(f"in(0,{term})", 1)
    assert engine.feed("in(1,2)@1 tick@9") == "o(1)@1-3"
    assert engine.event_rules[0].metrics.error_count == len(invalid)
    assert "absent: the time is the atom 'x': expected a positive number of seconds" in engine.problems[0]


def test_variable_time_of_absence_is_rounded_to_nanoseconds() -> None:
    engine, ends = Engine(), []
    engine.load(rules="o <- in(N) seq absent(no, N).")
    engine.on_event(lambda term, start, end: ends.append(end))
    engine.event("in(0.3333333333333333)", 21)
    engine.event("tick", 30)
    assert ends[1] == 21 * SECOND + 333_333_333


def test_absence_with_variable_forgets_old_events() -> None:
    engine = EngineDriver("o(X) <- in(X, N) seq absent(no(X), N).")
    for second in range(1000):
        engine.event("no(0)", second)
    (stream,) = engine.streams()
    assert len(stream) == 10
    assert (
        engine.feed("no(1)@1000 no(2)@1005 in(1,900)@999 no(3)@1010 in(1,900)@999.5 in(2,900)@1004 tick@2000")
        == "o(1)@999.5-1899.5"
    )


@pytest.mark.parametrize(
    ("stream", "expected"),
    [
        ("no(1)@1 in(1)@3.9", ""),
        ("no(1)@1 in(1)@4", "o(1)@4-4"),
        ("no(2)@1 in(1)@2", "o(1)@2-2"),
        ("no(1)@1 in(1)@1", "o(1)@1-1"),
        ("no(1)@0-3 in(1)@2-5", "o(1)@2-5"),
        ("no(1)@1 in(1)@2-60", ""),
        ("no(1)@5 in(1)@2", "o(1)@2-2"),
    ],
)
def test_event_shortly_before_excludes_match(stream: str, expected: str) -> None:
    assert EngineDriver("o(X) <- in(X) with not_preceded(no(X), 3).").feed(stream) == expected


def test_not_preceded_applies_to_whole_pattern() -> None:
    engine = EngineDriver("o(X) <- in(X) seq tick with not_preceded((no(Y) where Y > 1), 3) where X < 9.")
    assert engine.feed("no(1)@1 in(1)@2 tick@3") == "o(1)@2-3"
    assert engine.feed("no(2)@11 in(2)@12 tick@13 in(9)@20 tick@30") == ""


def test_not_preceded_forgets_old_events() -> None:
    engine = EngineDriver("o(X) <- in(X) with not_preceded(no(X), 3).")
    for second in range(1000):
        engine.event(f"no({second})", second)
    (stream,) = engine.streams()
    assert len(stream) == stream.keys == 63
    assert engine.feed("in(990)@992 in(999)@1002 in(999)@1001") == "o(999)@1002-1002"


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("o <- a with not_preceded(b, 0).", "1:29: not_preceded needs a positive number of seconds"),
        ("o <- a with not_preceded(b, N).", "1:29: not_preceded needs a positive number of seconds"),
        ("o <- a with not_preceded(b).", "1:13: with needs one of throttle(Seconds)"),
        ("o <- not_preceded(b, 3).", "1:6: not_preceded can only be the right side of a with"),
        ("o <- a with not_precede(b, 3).", "did you mean not_preceded?"),
        ("o(X) <- b(X) seq (a with not_preceded(c(X), 3)).", "uses a variable that the pattern before it"),
    ],
)
def test_invalid_not_preceded_is_rejected(rule: str, message: str) -> None:
    with pytest.raises(RetalisError, match=re.escape(message)):
        EngineDriver(rule)


RULES_WITH_STATE = {
    "last": "w(N) <- aggregate(list(X), in(X), N, last(1000)).",
    "last events": "w(N) <- aggregate(list(X), in(X), N, last(100, events)).",
    "every": "w(N) <- aggregate(list(X), in(X), N, every(1000)).",
    "hopping": "w(N) <- aggregate(list(X), in(X), N, last(1000, every(500))).",
    "first": "w(N) <- aggregate(list(X), in(X), N, every(1000, first)).",
    "batch": "w(N) <- aggregate(list(X), in(X), N, every(100, events)).",
    "running": "w(N) <- aggregate(list(X), in(X), N, running(every(1000))).",
    "steps": "w(X) <- aggregate(count, in(X), _, steps([a(2)])).",
    "throttle": "w(X) <- in(X) with throttle(1000, X).",
    "burst": "w(X) <- in(X) with burst(1000, X).",
    "debounce": "w(X) <- in(X) with debounce(1000, X).",
    "change": "w(X) <- in(X) with change(1, X).",
    "awaited": "w(X) <- in(X) seq absent(no, 1000).",
    "absent": "w(X) <- no(X) seq absent(in(Y) where Y > X, 1000).",
}


@pytest.mark.parametrize("name", RULES_WITH_STATE)
@pytest.mark.parametrize("flags", ["", ":- set_etalis_flag(revision_flag, on).\n"])
def test_oldest_element_is_dropped_at_limit(name: str, flags: str) -> None:
    """Dropped elements are counted, reported seldom, and not stored."""
    engine = EngineDriver(flags + RULES_WITH_STATE[name], max_stored=5)
    for number in range(150):
        engine.event(f"in({number})", number / 10)
        assert engine.event_rules[0].match_count <= 5
    (stream,) = engine.streams()
    assert entry_count(stream) <= 100
    assert engine.event_rules[0].dropped_count == 145
    assert len(engine.problems) == 8
    assert engine.problems[0].endswith(
        "more than 5 partial matches; 1 of the oldest have been dropped so far"
    )
    if name in ("last", "running"):
        assert engine.outputs[-1] == "w([144,145,146,147,148,149])@14.4-14.9"
    if name in ("debounce", "awaited"):
        assert engine.feed("tick@2000") == " ".join(
            f"w({n})@{n / 10:g}-{n / 10 + 1000:g}" for n in range(145, 150)
        )


def test_node_has_one_timer() -> None:
    """The clock stores few alarms and each node one timer, however many matches wait."""
    engine = EngineDriver(
        "w(X) <- in(X) seq absent(no, 10).\nv(X) <- in(X) with debounce(5, X).\n" + EVERY.format("a", 1)
    )
    rules, clock = engine.rules, engine.clock
    for number in range(400):
        engine.event(f"in({number})", number / 50)
        assert len(clock.alarms) <= 3
        assert len(rules.network.node_timers) <= 2 * 3 + 64
    assert sum(rule.match_count for rule in engine.event_rules) >= 650


def test_late_elements_are_counted_and_reported_seldom() -> None:
    engine = EngineDriver("w(N) <- aggregate(count, in(_), N, last(2)).")
    engine.feed("in(1)@10 " + "in(1)@5 " * 9)
    assert engine.event_rules[0].late_count == 9
    assert [report.rpartition("; ")[2] for report in engine.problems] == [
        "1 so far",
        "2 so far",
        "4 so far",
        "8 so far",
    ]
    assert "its window has ended" in engine.problems[0]


def test_refused_value_is_reported_and_skipped() -> None:
    engine = EngineDriver("w(S) <- aggregate(sum(X), in(X), S, last(100)).")
    assert engine.feed("in(1)@1 in(a)@2 in(inf)@2.5 in(1+1)@3") == "w(1)@1-1 w(3)@1-3"
    assert engine.event_rules[0].metrics.error_count == 2
    assert [report.rpartition(", ")[2] for report in engine.problems] == [
        "at event in(a): aggregate sum: the value is 'a': expected a number",
        "at event in(inf): aggregate sum: the value is 'inf': expected a number",
    ]


WITHOUT_WINDOW = "s seq aggregate({}, a(X), R)"
WINDOWS = [
    "aggregate({}, a(X), R, last(100))",
    "aggregate([{}, count], a(X), [R, _], last(100, events))",
    "aggregate({}, a(X), R, every(2, events))",
    "aggregate({}, a(X), R, running(every(100)))",
    "aggregate(of(p, {}), a(X), R, steps([p(2)]))",
]
ADDITIVE = ("sum", "avg", "stddev")
COMPARATIVE = ("min", "max", "median", "quantile")


def patterns_of(aggregate: Any) -> List[Any]:
    return [*WINDOWS, *([WITHOUT_WINDOW] if aggregate in ("sum", "avg", "min", "max") else [])]


def results_of_patterns(aggregate: str, value: str, factor: str = "") -> Iterator[Any]:
    """Yield the last result for two values, and the errors, of each pattern in one program.

    `factor` follows the variable.
    """
    call = f"{aggregate}({'0.5, ' if aggregate == 'quantile' else ''}X{factor})"
    patterns = patterns_of(aggregate)
    engine = EngineDriver(
        "".join(f"r{number}(R) <- {pattern.format(call)}.\n" for number, pattern in enumerate(patterns))
    )
    engine.feed(f"s@0 a(1)@1 a({value})@2")
    for number, _ in enumerate(patterns):
        results = [output.partition("@")[0] for output in engine.outputs if output.startswith(f"r{number}(")]
        reports = [report for report in engine.problems if report.startswith(f"rule r{number}(R), ")]
        yield results[-1].replace(f"r{number}(", "r(") if results else "", reports


@pytest.mark.parametrize("factor", ["", "*1"])
@pytest.mark.parametrize("value", ["e", "pi", "inf", '"b"', "[98]", "'b'", "1+e", "f(2)", "[]", "Y"])
@pytest.mark.parametrize("aggregate", [*ADDITIVE, *COMPARATIVE])
def test_value_that_is_no_number_is_reported(aggregate: str, value: str, factor: str) -> None:
    """`is` would evaluate constants such as e and pi, and texts and lists of one character."""
    for result, (report,) in results_of_patterns(aggregate, value, factor):
        assert result in ("", "r(0)", "r(1)", "r(1.0)")
        assert "(R), at event a(" in report
        assert f": aggregate {aggregate}: the value is '" in report
        assert report.endswith(": expected a number")


@pytest.mark.parametrize("aggregate", [*ADDITIVE, *COMPARATIVE])
def test_only_additive_aggregates_accept_expressions(aggregate: str) -> None:
    for result, reports in results_of_patterns(aggregate, "1+2"):
        if aggregate in ADDITIVE:
            assert result == {"sum": "r(4)", "avg": "r(2)", "stddev": "r(1.4142135623730951)"}[aggregate]
            assert reports == []
        else:
            assert [report.rpartition(": aggregate ")[2] for report in reports] == [
                f"{aggregate}: the value is '1+2': expected a number"
            ]


@pytest.mark.parametrize(
    ("aggregate", "factor", "result"),
    [
        ("sum", " * 2", "r(8)"),
        ("max", " - 10", "r(-7)"),
        ("min", " * pi", "r(3.141592653589793)"),
        ("median", "/2", "r(1.0)"),
        ("avg", " ** 2", "r(5)"),
    ],
)
def test_expression_of_rule_is_evaluated(aggregate: str, factor: str, result: str) -> None:
    for result_and_reports in results_of_patterns(aggregate, "3", factor):
        assert result_and_reports == (result, [])


@pytest.mark.parametrize("timestamp", ["[2,500000000]", "datime(1970,1,1,0,0,2.5,0)"])
def test_timestamp_is_a_number(timestamp: str) -> None:
    for result_and_reports in results_of_patterns("max", timestamp):
        assert result_and_reports == ("r(2.5)", [])


@pytest.mark.parametrize("value", ["1.0Inf", "-1.0Inf", "1.5NaN"])
@pytest.mark.parametrize("aggregate", [*ADDITIVE, "median"])
def test_infinite_value_is_not_added(aggregate: str, value: str) -> None:
    """A sum with such a value would never be a number again."""
    for _, (report,) in results_of_patterns(aggregate, value):
        assert report.endswith(f"the value is '{value}': expected a finite number")


@pytest.mark.parametrize("aggregate", ["min", "max"])
def test_nan_is_not_compared(aggregate: str) -> None:
    for _, (report,) in results_of_patterns(aggregate, "1.5NaN"):
        assert report.endswith("the value is '1.5NaN': expected a number")


@pytest.mark.parametrize("aggregate", ["sum", "avg"])
def test_overflow_of_running_sum_is_reported(aggregate: str) -> None:
    engine = EngineDriver(f"r(R) <- s seq aggregate({aggregate}(X), a(X), R).")
    engine.feed("s@0 a(1.5e308)@1 a(1.5e308)@2 a(-1.5e308)@3")
    assert [report.rpartition(": ")[2] for report in engine.problems] == ["a number is too large"]
    assert [output for output in engine.outputs if output.startswith("r(")][-1] == "r(0.0)@0-3"


def test_rates_are_rounded_once() -> None:
    """A division by rounded seconds would be off by one bit for some spans."""
    spans = range(1, 400)
    engine = EngineDriver(
        "".join(f"r({span}, R) <- aggregate(rate, a, R, last(0.{span:03})).\n" for span in spans)
    )
    engine.feed("a@0")
    assert engine.outputs[1:] == [f"r({span},{float(Fraction(1000, span))!r})@0-0" for span in spans]


def test_overflow_of_window_is_reported_once() -> None:
    engine = EngineDriver("w(S) <- aggregate(sum(X), in(X), S, every(2, events)).")
    assert engine.feed("in(1.0e308)@1 in(1.0e308)@2 in(1)@3 in(2)@4") == "w(3)@3-4"
    assert [report.rpartition(": ")[2] for report in engine.problems] == [
        "the result is too large for a float"
    ]


FLAGS = ("revision_flag", "out_of_order", "garbage_control")
POLICIES = ("recent", "chronological", "unrestricted")
OUTER_PATTERNS = {
    "where": "({0}) where X > 0",
    "do": "({0}) do true",
    "within": "({0}) within 100",
    "first": "({0}) seq end",
    "second": "begin seq ({0})",
    "negated": "({0}) fnot never",
    "and": "({0}) and begin",
    "or": "({0}) or never(X)",
}
INNER_PATTERNS = (
    "in(X) with debounce(1)",
    "in(X) seq absent(no, 1)",
    "aggregate(max(Y), in(Y), X, every(2))",
)


@pytest.mark.parametrize("flag", FLAGS)
@pytest.mark.parametrize("policy", POLICIES)
def test_timed_output_matches_outer_pattern(policy: str, flag: str) -> None:
    """The output occurs at an instant of the clock, without an input event."""
    value = "general" if flag == "garbage_control" else "on"
    rules = [f":- set_etalis_flag({flag}, {value}), set_etalis_flag(event_consumption_policy, {policy})."]
    heads = [f"{name}{number}(3)" for name in OUTER_PATTERNS for number in range(3)]
    for name, pattern in OUTER_PATTERNS.items():
        rules += [
            f"{name}{number}(X) <- {pattern.format(inner)}." for number, inner in enumerate(INNER_PATTERNS)
        ]
    engine = EngineDriver("\n".join(rules))
    engine.feed("begin@0.5 in(3)@3")
    outputs = engine.feed("tick@6 end@7 tick@20")
    assert engine.problems == []
    assert sorted(output.partition("@")[0] for output in outputs.split() if output[:3] != "end") == sorted(
        heads
    )


def test_clock_emits_output_without_event() -> None:
    clock = StreamClock()
    engine = EngineDriver(EVERY.format("a", 2), clock=clock)
    engine.event("in(1)", 1, 1)
    clock.move_to(2 * SECOND)
    engine.advance()
    assert engine.outputs == ["a(1)@0-2"]


def recorded_events(engine: Engine) -> Any:
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    return events


def test_window_survives_change_of_flags() -> None:
    engine = Engine()
    engine.load(rules="w(S) <- aggregate(list(X), a(X), S, last(10, events)).")
    events = recorded_events(engine)
    for number in (1, 2, 3):
        engine.event(f"a({number})", number)
    engine.call("set_etalis_flag(revision_flag, on)")
    for term in ("a(4)", "rev(a(4))"):
        engine.event(term, 4)
    engine.call("set_etalis_flag(event_consumption_policy, chronological)")
    engine.event("a(5)", 5)
    assert events[-1] == "w([1,2,3,5])"


def test_untracked_event_is_not_in_justification() -> None:
    engine = Engine()
    engine.load(rules="w(S) <- aggregate(list(X), a(X), S, last(4, events)).")
    engine.event("a(1)", 1)
    engine.call("set_etalis_flag(etalis_justification, on)")
    engine.event("a(2)", 2)
    assert engine.query("justify_event(w([1,2]), T, J)")


def test_reloaded_rules_keep_deadlines(tmp_path: Path) -> None:
    (tmp_path / "eventRules.txt").write_text(
        "d(X) <- a(X) with debounce(3). l(X) <- a(X) seq absent(b, 4).\n"
    )
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt').\n")
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>\n")
    engine = Engine()
    engine.load_program(tmp_path)
    events = recorded_events(engine)
    engine.event("a(1)", 1)
    engine.event("a(2)", 2)
    engine.reload(tmp_path)
    engine.event("a(3)", 3)
    engine.event("tick", 20)
    assert events == ["a(1)", "a(2)", "a(3)", "l(1)", "d(3)", "l(2)", "l(3)", "tick"]


@pytest.mark.parametrize(
    ("window", "output"), [("every(3, first)", "w(1)@1-4"), ("running(every(3, first))", "w(1)@1-1")]
)
def test_window_in_the_past_does_not_begin(window: str, output: str) -> None:
    engine = EngineDriver(f"w(N) <- aggregate(count, in(_), N, {window}).")
    assert engine.feed("in(1)@1 tick@10 in(2)@6 in(3)@7 tick@10.5") == output
    assert [rule.late_count for rule in engine.event_rules] == [2]
    assert "its window has ended" in engine.problems[0]
    assert engine.feed("in(4)@8 tick@20").startswith("w(1)@8-")


@pytest.mark.parametrize("order", [(1, 6), (6, 1), (1, 6, 0), (6, 0, 1)])
def test_debounce_separates_bursts_in_any_order(order: Tuple[Any, ...]) -> None:
    now = [1000 * SECOND]
    engine = Engine(Clock(lambda: now[0]))
    engine.load(rules="d(X) <- a(X) with debounce(2).")
    events = recorded_events(engine)
    for ahead in order:
        engine.event(f"a({ahead})", 1000 + ahead)
    for _ in range(10):
        now[0] += SECOND
        engine.advance()
    assert [event for event in events if event.startswith("d")] == ["d(1)", "d(6)"]


@pytest.mark.parametrize("rate", ["throttle(5)", "burst(2)", "debounce(2)"])
def test_timestamp_far_ahead_delays_no_output(rate: str) -> None:
    now = [1000 * 10**9]
    engine = Engine(Clock(lambda: now[0]))
    engine.load(rules=f"d(X) <- a(X) with {rate}.")
    engine.event("a(0)", 10**6)
    events = recorded_events(engine)
    for number in (1, 2):
        engine.event(f"a({number})", now[0] // 10**9)
        now[0] += 7 * 10**9
        engine.advance()
    assert [event for event in events if event.startswith("d")] == ["d(1)", "d(2)"]


@pytest.mark.parametrize("flags", [(), ("revision_flag",), ("etalis_justification",)])
@pytest.mark.parametrize("steps", ["high(1, many) where X > 0", "one, two(1, many) where X > 0"])
def test_row_pattern_completes_at_deciding_event(steps: str, flags: Tuple[Any, ...]) -> None:
    """The match is complete at the event that decides, not at its last event, also if events may be retracted."""
    rules = f"out(L) <- aggregate(list(X), in(X), L, steps([{steps}])) seq end."
    assert outputs_of(rules, "in(1)@1 in(2)@2 end@7 in(-1)@3", flags=flags) == ""
    assert outputs_of(rules, "in(1)@1 in(2)@2 end@7 in(-1)@3 end@8", flags=flags) == "out([1,2])@1-8"


@pytest.mark.parametrize("flags", ["", ":- set_etalis_flag(revision_flag, on).\n"])
def test_complete_matches_are_emitted_at_limit(flags: str) -> None:
    """The longer match that the oldest may become is dropped and counted, not the complete matches."""
    steps = "p where X < 50, later(y(0, 1, until(X == 80))) where X == 90"
    engine = EngineDriver(f"{flags}w(L) <- aggregate(list(X), in(X), L, steps([{steps}])).", max_stored=5)
    for number in range(20):
        engine.event(f"in({number})", number)
        assert engine.event_rules[0].match_count <= 5
    engine.event("in(80)", 20)
    assert [output.partition("@")[0] for output in engine.outputs] == [
        f"w([{number}])" for number in range(20)
    ]
    assert engine.event_rules[0].dropped_count == 3
    assert engine.problems


def test_array_of_another_length_costs_only_its_event() -> None:
    rules = "r(K,N,M) <- aggregate([count,max(V)], in(K,V), [N,M], {}).\n"
    samples = [f"in({key},[{number},1,2])@1.{number}" for number in range(1, 6) for key in "abc"]
    odd = ["in(a,[1,2,3,4])@1.55", "in(b,long)@1.56", "in(d,[7,1,2])@1.57"]
    for window in (
        "every(1)",
        "last(1,every(1))",
        "every(1,first)",
        "last(9)",
        "last(9,events)",
        "running(every(1))",
    ):
        plain, mixed = EngineDriver(rules.format(window)), EngineDriver(rules.format(window))
        expected = plain.feed(" ".join([*samples, odd[2], "tick@2 tick@3"]))
        assert mixed.feed(" ".join([*samples, *odd, "tick@2 tick@3"])) == expected
        assert "r(c,5,[5,1,2])" in expected
        assert len(mixed.problems) == mixed.event_rules[0].metrics.error_count == 2
        assert {report.split("aggregate max: ")[1] for report in mixed.problems} == {
            "the value is '[1,2,3,4]': expected an array of 3 elements",
            "the value is 'long': expected a number",
        }


def test_report_of_refused_value_names_key() -> None:
    engine = EngineDriver("r(K,M) <- aggregate(max(V), in(K,V), M, every(1)).")
    assert engine.feed("in(a,[1,2,3])@1.1 in(a,[1,2,3,4])@1.2 tick@3") == "r(a,[1,2,3])@1-2"
    assert engine.problems == [
        "rule r(K,M), at key a: aggregate max: the value is '[1,2,3,4]': expected an array of 3 elements"
    ]


@pytest.mark.parametrize(
    "window", ["last(1)", "every(1)", "running(every(1))", "last(2,every(1))", "running(every(1,first))"]
)
def test_length_of_arrays_may_change_in_empty_window(window: str) -> None:
    engine = EngineDriver(f"r(M) <- aggregate(max(V), in(V), M, {window}).")
    assert "[1,2,3]" in engine.feed("in([1,2,3])@1.1 tick@2")
    assert "[1,2,3,4]" in engine.feed("in([1,2,3,4])@9.1 tick@10")
    assert engine.problems == []


def test_length_of_arrays_may_change_after_key_is_idle() -> None:
    rules = "q([property(ttl, 5)]) : r(M) <- aggregate(max(V), in(V), M, last(3,events))."
    engine = EngineDriver(rules)
    assert engine.feed("in([1,2,3])@1 in([1,2,3,4])@9") == "r([1,2,3])@1-1 r([1,2,3,4])@9-9"
    assert engine.problems == []


def test_array_after_numbers_is_refused() -> None:
    engine = EngineDriver("r(A,B) <- aggregate([max(V),max(W)], in(V,W), [A,B], last(9)).")
    assert (
        engine.feed("in([1,2,3],5)@1 in([1,2,4],[1])@2 in([1,2,5],6)@3")
        == "r([1,2,3],5)@1-1 r([1,2,5],6)@1-3"
    )
    assert len(engine.problems) == 1
    assert "the value is '[1]': expected a number" in engine.problems[0]


@pytest.mark.parametrize("kind", ["stddev(V)", "median(V)", "quantile(0.3, V)"])
def test_run_beyond_floats_is_reported(kind: str) -> None:
    engine = EngineDriver(f"r(M) <- p seq aggregate({kind}, in(V), M). later <- in(_).")
    huge = 10**400
    assert engine.feed(f"p@1 in({huge})@2 in({huge + 1})@3 in(0.5)@4").endswith("later@4-4")
    assert engine.problems
    name = kind.partition("(")[0]
    assert all(
        problem.endswith(f"aggregate {name}: the result is too large for a float")
        for problem in engine.problems
    )


def test_average_beyond_floats_is_reported() -> None:
    huge = 10**400 + 1
    engine = EngineDriver("r(M) <- p seq aggregate(avg(V), in(V), M). later <- in(_).")
    assert (
        engine.feed(f"p@1 in({huge})@2 in(0)@3 in({-huge + 3})@4")
        == f"p@1-1 r({huge})@1-2 later@2-2 later@3-3 r(1)@1-4 later@4-4"
    )
    assert len(engine.problems) == 1
    assert engine.problems[0].endswith("aggregate avg: the result is too large for a float")


def test_error_of_alarm_stops_no_other_alarm() -> None:
    def fail(machine: Any) -> bool:
        raise KeyError("defect")

    rules = (
        "r(K) <- (in(K) seq absent(no, 1)) where broken. other(K) <- in(K) seq absent(no, 1). last <- tick."
    )
    engine = EngineDriver(rules)
    engine.logic.define("broken", 0, fail)
    assert engine.feed("in(a)@1 in(b)@2 tick@9") == "other(a)@1-2 other(b)@2-3 last@9-9"
    assert engine.problems.count(str(KeyError("defect"))) == 2
    # The rule continues with later events.
    engine.logic.define("broken", 0, lambda machine: True)
    assert engine.feed("in(c)@10 tick@19") == "r(c)@10-11 other(c)@10-11 last@19-19"


def test_event_between_hopping_windows_is_ignored() -> None:
    engine = EngineDriver("n(N) <- aggregate(count, in(_), N, last(1,every(10))).")
    assert engine.feed("in(1)@3 in(2)@9.5 in(3)@14 in(4)@12 tick@30") == "n(1)@9-10"
    assert engine.event_rules[0].late_count == 0
    assert engine.problems == []
    # An event of a window that has ended is late.
    assert engine.feed("in(5)@29.5") == ""
    assert engine.event_rules[0].late_count == 1
