"""Stream operators in rules: deadlines, state and reports."""

from fractions import Fraction

import pytest
from events.stream_programs import fired
from events.streams.operator_driver import entry_count

from retalis import Clock, Engine, StreamClock
from retalis.prolog.terms.timestamps import SECOND


class Run(Engine):
    """An engine that notes the events of rules, and what is reported."""

    def __init__(self, rules, cap=None, clock=None):
        super().__init__(clock)
        own = self.rules
        own.max_stored = own.max_stored if cap is None else cap
        self.seen, self.reports = [], []
        own.on_error = own.on_warning = lambda error: self.reports.append(error.message)
        self.load(rules=rules)
        self.on_event(self._note)

    def _note(self, term, start, end):
        shown = self.show(term)
        if not shown.startswith(("in", "no", "tick")):
            self.seen.append(f"{shown}@{start / SECOND:g}-{end / SECOND:g}")

    def feed(self, text):
        """Give events, each as ``event@end`` or ``event@start-end``; return what rules said."""
        del self.seen[:]
        for one in text.split():
            event, stamp = one.rsplit("@", 1)
            start, _, end = stamp.partition("-")
            self.event(event, float(start), float(end or start))
        return " ".join(self.seen)

    @property
    def event_rules(self):
        return self.rules.rules

    def streams(self):
        """Return the operators of all rules."""
        return [
            node.stream for rule in self.event_rules for node, _, _ in rule.nodes if hasattr(node, "stream")
        ]


EVERY = "{0}(N) <- aggregate(count, in(_), N, every({1})).\n"


def test_what_is_due_comes_in_the_order_of_instants_before_the_event_of_the_same():
    rules = EVERY.format("b", 3) + EVERY.format("a", 2) + "c(X) <- in(X) seq absent(in(_), 4). d <- tick."
    engine = Run(rules)
    assert engine.feed("in(1)@1 tick@6") == "a(1)@0-2 b(1)@0-3 c(1)@1-5 d@6-6"
    assert engine.feed("in(1)@7 tick@12") == "a(1)@6-8 b(1)@6-9 c(1)@7-11 d@12-12"


def test_at_one_instant_the_older_rule_comes_first_and_in_a_rule_what_is_below():
    rules = EVERY.format("b", 2) + EVERY.format("a", 2)
    assert Run(rules).feed("in(1)@1 tick@2") == "b(1)@0-2 a(1)@0-2"
    inner = "w(N) <- aggregate(count, (in(X) with debounce(1)), N, every(2))."
    assert Run(inner).feed("in(1)@0.5 tick@9") == "w(1)@0-2"
    assert Run(inner).feed("in(1)@1 tick@9") == "w(1)@2-4"


@pytest.mark.parametrize(
    "rule",
    [
        "bad(S) <- aggregate(fold(zero, add, add, X), in(X), S, every(2)). zero(0). add(_, S, T) :- T is S + x.",
        "bad <- aggregate(count, in(_), _, every(2)) do throw(no).",
        "bad <- aggregate(count, in(_), N, every(2)) where N > x.",
    ],
)
def test_an_error_in_one_rule_does_not_keep_others_from_ringing(rule):
    engine = Run(EVERY.format("a", 2) + rule + "\n" + EVERY.format("z", 2))
    assert engine.feed("in(1)@1 in(2)@1.5 in(3)@3 tick@9") == "a(2)@0-2 z(2)@0-2 a(1)@2-4 z(1)@2-4"
    assert engine.reports


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
def test_absent_event_with_variables_cancels_only_what_it_unifies_with(stream, is_emitted):
    engine = Run("o(Y) <- a(X, Y) seq absent(b(X, Y), 3).")
    assert engine.feed(f"{stream} tick@9").endswith(" o(1)@1-4") == is_emitted


def test_a_rule_that_is_deleted_rings_no_more():
    engine = Run(EVERY.format("a", 2) + EVERY.format("z", 2))
    engine.feed("in(1)@1")
    own = engine.rules
    own.remove(own.rules[0])
    assert engine.feed("tick@9") == "z(1)@0-2"


def test_a_clock_that_goes_back_clears_all():
    rules = (
        EVERY.format("a", 2)
        + "w(X) <- aggregate(list(Y), in(Y), X, last(100)). t(X) <- in(X) with throttle(100). "
        + "c(X) <- in(X) seq absent(no, 5). d(X) <- in(X) with debounce(1)."
    )
    engine = Run(rules)
    engine.feed("in(1)@50")
    assert sum(len(stream) for stream in engine.streams()) == 5
    engine.clock.move_to(0, back=True)
    engine.advance()
    assert sum(len(stream) for stream in engine.streams()) == 0
    assert sum(rule.match_count for rule in engine.event_rules) == 0
    assert engine.feed("in(2)@1") == "w([2])@1-1 t(2)@1-1"
    assert engine.feed("tick@20") == "a(1)@0-2 d(2)@1-2 c(2)@1-6"


HOLDING = {
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


@pytest.mark.parametrize("name", HOLDING)
@pytest.mark.parametrize("flags", ["", ":- set_etalis_flag(revision_flag, on).\n"])
def test_no_more_is_held_than_may_be_and_the_oldest_goes(name, flags):
    """What was dropped is counted, said seldom, and held nowhere."""
    engine = Run(flags + HOLDING[name], cap=5)
    for number in range(150):
        engine.event(f"in({number})", number / 10)
        assert engine.event_rules[0].match_count <= 5
    (stream,) = engine.streams()
    assert entry_count(stream) <= 100
    assert engine.event_rules[0].dropped_count == 145
    assert len(engine.reports) == 8
    assert engine.reports[0].endswith("more than 5 partial matches; 1 of the oldest have been dropped so far")
    if name in ("last", "running"):
        assert engine.seen[-1] == "w([144,145,146,147,148,149])@14.4-14.9"
    if name in ("debounce", "awaited"):
        assert engine.feed("tick@2000") == " ".join(
            f"w({n})@{n / 10:g}-{n / 10 + 1000:g}" for n in range(145, 150)
        )


def test_alarms_and_wishes_are_as_many_as_nodes_wait():
    """However many matches wait: the clock holds an alarm or two, and each node asks once."""
    engine = Run(
        "w(X) <- in(X) seq absent(no, 10).\nv(X) <- in(X) with debounce(5, X).\n" + EVERY.format("a", 1)
    )
    own, clock = engine.rules, engine.clock
    for number in range(400):
        engine.event(f"in({number})", number / 50)
        assert len(clock.alarms) <= 3
        assert len(own.node_timers) <= 2 * 3 + 64
    assert sum(rule.match_count for rule in engine.event_rules) >= 650


def test_what_comes_too_late_is_counted_and_said_seldom():
    engine = Run("w(N) <- aggregate(count, in(_), N, last(2)).")
    engine.feed("in(1)@10 " + "in(1)@5 " * 9)
    assert engine.event_rules[0].late_count == 9
    assert [one.rpartition("; ")[2] for one in engine.reports] == [
        "1 so far",
        "2 so far",
        "4 so far",
        "8 so far",
    ]
    assert "its window has ended" in engine.reports[0]


def test_a_value_that_cannot_be_measured_is_reported_and_the_rest_is_measured():
    engine = Run("w(S) <- aggregate(sum(X), in(X), S, last(100)).")
    assert engine.feed("in(1)@1 in(a)@2 in(inf)@2.5 in(1+1)@3") == "w(1)@1-1 w(3)@1-3"
    assert engine.event_rules[0].metrics.error_count == 2
    assert [one.rpartition(", ")[2] for one in engine.reports] == [
        "at event in(a): aggregate sum: the value is 'a': expected a number",
        "at event in(inf): aggregate sum: the value is 'inf': expected a number",
    ]


PLAIN = "s seq aggregate({}, a(X), R)"
WINDOWS = [
    "aggregate({}, a(X), R, last(100))",
    "aggregate([{}, count], a(X), [R, _], last(100, events))",
    "aggregate({}, a(X), R, every(2, events))",
    "aggregate({}, a(X), R, running(every(100)))",
    "aggregate(of(p, {}), a(X), R, steps([p(2)]))",
]
ADDING = ("sum", "avg", "stddev")
COMPARING = ("min", "max", "median", "quantile")


def patterns_of(measure):
    return [*WINDOWS, *([PLAIN] if measure in ("sum", "avg", "min", "max") else [])]


def measured(measure, value, times=""):
    """Return for each pattern the last result for two values, and its errors, by one program with all patterns.

    `times` stands behind the variable.
    """
    kind = f"{measure}({'0.5, ' if measure == 'quantile' else ''}X{times})"
    patterns = patterns_of(measure)
    engine = Run("".join(f"r{at}(R) <- {each.format(kind)}.\n" for at, each in enumerate(patterns)))
    engine.feed(f"s@0 a(1)@1 a({value})@2")
    for at, _ in enumerate(patterns):
        results = [one.partition("@")[0] for one in engine.seen if one.startswith(f"r{at}(")]
        reports = [one for one in engine.reports if one.startswith(f"rule r{at}(R), ")]
        yield results[-1].replace(f"r{at}(", "r(") if results else "", reports


@pytest.mark.parametrize("times", ["", "*1"])
@pytest.mark.parametrize("value", ["e", "pi", "inf", '"b"', "[98]", "'b'", "1+e", "f(2)", "[]", "Y"])
@pytest.mark.parametrize("measure", [*ADDING, *COMPARING])
def test_a_value_that_is_no_number_is_reported_by_every_measure(measure, value, times):
    """`is` evaluates constants such as e and pi, and texts and lists of one character."""
    for result, (report,) in measured(measure, value, times):
        assert result in ("", "r(0)", "r(1)", "r(1.0)")
        assert "(R), at event a(" in report
        assert f": aggregate {measure}: the value is '" in report
        assert report.endswith(": expected a number")


@pytest.mark.parametrize("measure", [*ADDING, *COMPARING])
def test_measures_that_add_take_expressions_of_numbers_and_those_that_compare_do_not(measure):
    for result, reports in measured(measure, "1+2"):
        if measure in ADDING:
            assert result == {"sum": "r(4)", "avg": "r(2)", "stddev": "r(1.4142135623730951)"}[measure]
            assert reports == []
        else:
            assert [one.rpartition(": aggregate ")[2] for one in reports] == [
                f"{measure}: the value is '1+2': expected a number"
            ]


@pytest.mark.parametrize(
    ("measure", "times", "result"),
    [
        ("sum", " * 2", "r(8)"),
        ("max", " - 10", "r(-7)"),
        ("min", " * pi", "r(3.141592653589793)"),
        ("median", "/2", "r(1.0)"),
        ("avg", " ** 2", "r(5)"),
    ],
)
def test_an_expression_of_the_rule_is_evaluated(measure, times, result):
    for found in measured(measure, "3", times):
        assert found == (result, [])


@pytest.mark.parametrize("stamp", ["[2,500000000]", "datime(1970,1,1,0,0,2.5,0)"])
def test_a_stamp_is_a_number(stamp):
    for found in measured("max", stamp):
        assert found == ("r(2.5)", [])


@pytest.mark.parametrize("value", ["1.0Inf", "-1.0Inf", "1.5NaN"])
@pytest.mark.parametrize("measure", [*ADDING, "median"])
def test_what_is_not_finite_is_not_added(measure, value):
    """A sum that took it would never be a number again."""
    for _, (report,) in measured(measure, value):
        assert report.endswith(f"the value is '{value}': expected a finite number")


@pytest.mark.parametrize("measure", ["min", "max"])
def test_what_has_no_order_is_not_compared(measure):
    for _, (report,) in measured(measure, "1.5NaN"):
        assert report.endswith("the value is '1.5NaN': expected a number")


@pytest.mark.parametrize("measure", ["sum", "avg"])
def test_a_running_sum_that_is_too_large_is_reported(measure):
    engine = Run(f"r(R) <- s seq aggregate({measure}(X), a(X), R).")
    engine.feed("s@0 a(1.5e308)@1 a(1.5e308)@2 a(-1.5e308)@3")
    assert [one.rpartition(": ")[2] for one in engine.reports] == ["a number is too large"]
    assert [one for one in engine.seen if one.startswith("r(")][-1] == "r(0.0)@0-3"


def test_rates_are_rounded_once():
    """Divided by seconds that were rounded themselves, some were off by one bit."""
    spans = range(1, 400)
    engine = Run("".join(f"r({span}, R) <- aggregate(rate, a, R, last(0.{span:03})).\n" for span in spans))
    engine.feed("a@0")
    assert engine.seen[1:] == [f"r({span},{float(Fraction(1000, span))!r})@0-0" for span in spans]


def test_a_sum_that_is_too_large_is_reported_once_and_does_not_stand_in_the_way():
    engine = Run("w(S) <- aggregate(sum(X), in(X), S, every(2, events)).")
    assert engine.feed("in(1.0e308)@1 in(1.0e308)@2 in(1)@3 in(2)@4") == "w(3)@3-4"
    assert [one.rpartition(": ")[2] for one in engine.reports] == ["the result is too large for a float"]


FLAGS = ("revision_flag", "out_of_order", "garbage_control")
POLICIES = ("recent", "chronological", "unrestricted")
ABOVE = {
    "where": "({0}) where X > 0",
    "do": "({0}) do true",
    "within": "({0}) within 100",
    "first": "({0}) seq end",
    "second": "begin seq ({0})",
    "negated": "({0}) fnot never",
    "and": "({0}) and begin",
    "or": "({0}) or never(X)",
}
RUNG = ("in(X) with debounce(1)", "in(X) seq absent(no, 1)", "aggregate(max(Y), in(Y), X, every(2))")


@pytest.mark.parametrize("flag", FLAGS)
@pytest.mark.parametrize("policy", POLICIES)
def test_what_rings_is_taken_by_all_that_may_stand_above(policy, flag):
    """It is there at an instant of the clock, with no event that is served."""
    value = "general" if flag == "garbage_control" else "on"
    rules = [f":- set_etalis_flag({flag}, {value}), set_etalis_flag(event_consumption_policy, {policy})."]
    heads = [f"{name}{at}(3)" for name in ABOVE for at in range(3)]
    for name, pattern in ABOVE.items():
        rules += [f"{name}{at}(X) <- {pattern.format(below)}." for at, below in enumerate(RUNG)]
    engine = Run("\n".join(rules))
    engine.feed("begin@0.5 in(3)@3")
    said = engine.feed("tick@6 end@7 tick@20")
    assert engine.reports == []
    assert sorted(one.partition("@")[0] for one in said.split() if one[:3] != "end") == sorted(heads)


def test_the_clock_of_a_robot_rings_without_an_event():
    clock = StreamClock()
    engine = Run(EVERY.format("a", 2), clock=clock)
    engine.event("in(1)", 1, 1)
    clock.move_to(2 * SECOND)
    engine.advance()
    assert engine.seen == ["a(1)@0-2"]


def seen_of(engine):
    found = []
    engine.on_event(lambda term, start, end: found.append(engine.show(term)))
    return found


def test_what_was_held_is_there_after_a_change_of_flags():
    engine = Engine()
    engine.load(rules="w(S) <- aggregate(list(X), a(X), S, last(10, events)).")
    seen = seen_of(engine)
    for number in (1, 2, 3):
        engine.event(f"a({number})", number)
    engine.call("set_etalis_flag(revision_flag, on)")
    for term in ("a(4)", "rev(a(4))"):
        engine.event(term, 4)
    engine.call("set_etalis_flag(event_consumption_policy, chronological)")
    engine.event("a(5)", 5)
    assert seen[-1] == "w([1,2,3,5])"


def test_what_came_before_it_was_tracked_is_no_part_of_a_reason():
    engine = Engine()
    engine.load(rules="w(S) <- aggregate(list(X), a(X), S, last(4, events)).")
    engine.event("a(1)", 1)
    engine.call("set_etalis_flag(etalis_justification, on)")
    engine.event("a(2)", 2)
    assert engine.query("justify_event(w([1,2]), T, J)")


def test_the_clock_goes_on_for_rules_that_are_read_again(tmp_path):
    (tmp_path / "eventRules.txt").write_text(
        "d(X) <- a(X) with debounce(3). l(X) <- a(X) seq absent(b, 4).\n"
    )
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt').\n")
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>\n")
    engine = Engine()
    engine.load_program(tmp_path)
    seen = seen_of(engine)
    engine.event("a(1)", 1)
    engine.event("a(2)", 2)
    engine.reload(tmp_path)
    engine.event("a(3)", 3)
    engine.event("tick", 20)
    assert seen == ["a(1)", "a(2)", "a(3)", "l(1)", "d(3)", "l(2)", "l(3)", "tick"]


@pytest.mark.parametrize(
    ("window", "said"), [("every(3, first)", "w(1)@1-4"), ("running(every(3, first))", "w(1)@1-1")]
)
def test_a_window_that_would_be_over_by_the_clock_does_not_begin(window, said):
    engine = Run(f"w(N) <- aggregate(count, in(_), N, {window}).")
    assert engine.feed("in(1)@1 tick@10 in(2)@6 in(3)@7 tick@10.5") == said
    assert [rule.late_count for rule in engine.event_rules] == [2]
    assert "its window has ended" in engine.reports[0]
    assert engine.feed("in(4)@8 tick@20").startswith("w(1)@8-")


@pytest.mark.parametrize("order", [(1, 6), (6, 1), (1, 6, 0), (6, 0, 1)])
def test_bursts_further_apart_than_a_debounce_are_two_in_whatever_order_they_come(order):
    now = [1000 * SECOND]
    engine = Engine(Clock(lambda: now[0]))
    engine.load(rules="d(X) <- a(X) with debounce(2).")
    seen = seen_of(engine)
    for ahead in order:
        engine.event(f"a({ahead})", 1000 + ahead)
    for _ in range(10):
        now[0] += SECOND
        engine.advance()
    assert [one for one in seen if one.startswith("d")] == ["d(1)", "d(6)"]


@pytest.mark.parametrize("shape", ["throttle(5)", "burst(2)", "debounce(2)"])
def test_a_stamp_far_ahead_holds_nothing_up(shape):
    now = [1000 * 10**9]
    engine = Engine(Clock(lambda: now[0]))
    engine.load(rules=f"d(X) <- a(X) with {shape}.")
    engine.event("a(0)", 10**6)
    seen = seen_of(engine)
    for number in (1, 2):
        engine.event(f"a({number})", now[0] // 10**9)
        now[0] += 7 * 10**9
        engine.advance()
    assert [one for one in seen if one.startswith("d")] == ["d(1)", "d(2)"]


@pytest.mark.parametrize(
    "window", ["last(2, events)", "last(5)", "every(2, events)", "every(3, first)", "every(2)"]
)
def test_what_an_interrupt_left_half_done_is_put_right(window):
    engine = Engine()
    engine.load(rules=f"w(S, N, M) <- aggregate([sum(X), count, median(X)], a(X), [S, N, M], {window}).")
    whole = Engine()
    whole.load(rules=f"w(S, N, M) <- aggregate([sum(X), count, median(X)], a(X), [S, N, M], {window}).")
    for number in range(1, 9):
        for one in (engine, whole):
            one.event(f"a({number})", number)
        engine.rules.repair()  # nothing was half done: it changes nothing
    after, expected = seen_of(engine), seen_of(whole)
    for number in range(9, 20):
        for one in (engine, whole):
            one.event(f"a({number})", number)
    assert after == expected
    for rule in engine.rules.rules:  # counters that are wrong are counted anew
        for node, _, _ in rule.nodes:
            if hasattr(node, "stream"):
                node.stream.element_count += 7
    engine.rules.repair()
    assert engine.rules.match_count == whole.rules.match_count


@pytest.mark.parametrize("flags", [(), ("revision_flag",), ("etalis_justification",)])
@pytest.mark.parametrize("steps", ["high(1, many) where X > 0", "one, two(1, many) where X > 0"])
def test_what_a_condition_decides_has_come_with_the_event_that_decides_it(steps, flags):
    """Not with its last event: what has come in between came before it, also where events may be taken back."""
    rules = f"out(L) <- aggregate(list(X), in(X), L, steps([{steps}])) seq end."
    assert fired(rules, "in(1)@1 in(2)@2 end@7 in(-1)@3", flags=flags) == ""
    assert fired(rules, "in(1)@1 in(2)@2 end@7 in(-1)@3 end@8", flags=flags) == "out([1,2])@1-8"


@pytest.mark.parametrize("flags", ["", ":- set_etalis_flag(revision_flag, on).\n"])
def test_matches_of_steps_that_wait_are_given_on_where_what_they_wait_for_is_one_too_many(flags):
    """The longer one that may come of the oldest is dropped and counted, not those that are whole."""
    steps = "p where X < 50, later(y(0, 1, until(X == 80))) where X == 90"
    engine = Run(f"{flags}w(L) <- aggregate(list(X), in(X), L, steps([{steps}])).", cap=5)
    for number in range(20):
        engine.event(f"in({number})", number)
        assert engine.event_rules[0].match_count <= 5
    engine.event("in(80)", 20)
    assert [one.partition("@")[0] for one in engine.seen] == [f"w([{number}])" for number in range(20)]
    assert engine.event_rules[0].dropped_count == 3
    assert engine.reports


def test_array_of_another_length_costs_only_its_event():
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
        plain, mixed = Run(rules.format(window)), Run(rules.format(window))
        expected = plain.feed(" ".join([*samples, odd[2], "tick@2 tick@3"]))
        assert mixed.feed(" ".join([*samples, *odd, "tick@2 tick@3"])) == expected
        assert "r(c,5,[5,1,2])" in expected
        assert len(mixed.reports) == mixed.event_rules[0].metrics.error_count == 2
        assert {report.split("aggregate max: ")[1] for report in mixed.reports} == {
            "the value is '[1,2,3,4]': expected an array of 3 elements",
            "the value is 'long': expected a number",
        }


def test_report_of_value_refused_at_end_of_window_names_key():
    engine = Run("r(K,M) <- aggregate(max(V), in(K,V), M, every(1)).")
    assert engine.feed("in(a,[1,2,3])@1.1 in(a,[1,2,3,4])@1.2 tick@3") == "r(a,[1,2,3])@1-2"
    assert engine.reports == [
        "rule r(K,M), at key a: aggregate max: the value is '[1,2,3,4]': expected an array of 3 elements"
    ]


@pytest.mark.parametrize(
    "window", ["last(1)", "every(1)", "running(every(1))", "last(2,every(1))", "running(every(1,first))"]
)
def test_length_of_arrays_may_change_when_the_earlier_ones_are_out(window):
    engine = Run(f"r(M) <- aggregate(max(V), in(V), M, {window}).")
    assert "[1,2,3]" in engine.feed("in([1,2,3])@1.1 tick@2")
    assert "[1,2,3,4]" in engine.feed("in([1,2,3,4])@9.1 tick@10")
    assert engine.reports == []


def test_length_of_arrays_may_change_after_key_is_idle():
    rules = "q([property(ttl, 5)]) : r(M) <- aggregate(max(V), in(V), M, last(3,events))."
    engine = Run(rules)
    assert engine.feed("in([1,2,3])@1 in([1,2,3,4])@9") == "r([1,2,3])@1-1 r([1,2,3,4])@9-9"
    assert engine.reports == []


def test_array_after_numbers_is_refused_by_each_measure():
    engine = Run("r(A,B) <- aggregate([max(V),max(W)], in(V,W), [A,B], last(9)).")
    assert (
        engine.feed("in([1,2,3],5)@1 in([1,2,4],[1])@2 in([1,2,5],6)@3")
        == "r([1,2,3],5)@1-1 r([1,2,5],6)@1-3"
    )
    assert len(engine.reports) == 1 and "the value is '[1]': expected a number" in engine.reports[0]


def test_average_beyond_floats_is_reported_and_later_rules_match():
    huge = 10**400 + 1
    engine = Run("r(M) <- p seq aggregate(avg(V), in(V), M). later <- in(_).")
    assert (
        engine.feed(f"p@1 in({huge})@2 in(0)@3 in({-huge + 3})@4")
        == f"p@1-1 r({huge})@1-2 later@2-2 later@3-3 r(1)@1-4 later@4-4"
    )
    assert len(engine.reports) == 1
    assert engine.reports[0].endswith("aggregate avg: the result is too large for a float")


def test_error_of_alarm_affects_no_other_alarm_and_no_event(caplog):
    def fail(machine):
        raise KeyError("defect")

    rules = (
        "r(K) <- (in(K) seq absent(no, 1)) where broken. other(K) <- in(K) seq absent(no, 1). last <- tick."
    )
    engine = Run(rules)
    engine.logic.define("broken", 0, fail)
    assert engine.feed("in(a)@1 in(b)@2 tick@9") == "other(a)@1-2 other(b)@2-3 last@9-9"
    assert caplog.text.count("internal error") == 2
    # The rule continues with later events.
    engine.logic.define("broken", 0, lambda machine: True)
    assert engine.feed("in(c)@10 tick@19") == "r(c)@10-11 other(c)@10-11 last@19-19"


def test_event_between_hopping_windows_is_in_none_and_not_late():
    engine = Run("n(N) <- aggregate(count, in(_), N, last(1,every(10))).")
    assert engine.feed("in(1)@3 in(2)@9.5 in(3)@14 in(4)@12 tick@30") == "n(1)@9-10"
    assert engine.event_rules[0].late_count == 0 and engine.reports == []
    # An event of a window that has ended is late.
    assert engine.feed("in(5)@29.5") == ""
    assert engine.event_rules[0].late_count == 1
