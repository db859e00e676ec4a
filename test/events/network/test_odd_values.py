"""Streams with odd values: texts, unbound variables, nan, infinities, huge integers, arrays of other lengths.

An odd value costs at most its own event. The results of other keys are those of the stream without it, each refused
value is counted as an error of its rule, no error reaches the caller, and later rules match the event.
"""

from typing import Any, Dict, Tuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_reports import RecordingReports

from retalis import Engine

AGGREGATES = [
    *("count", "sum(V)", "avg(V)", "min(V)", "max(V)", "stddev(V)", "median(V)", "quantile(0.3,V)"),
    *("first(V)", "list(V)", "distinct(V)", "count_distinct(V)", "sum(V*V)", "fold(zero,plus_,same,V)"),
]
HOPPING_WITH_GAPS = "last(1,every(3))"
"""Windows that do not touch: values between them are not measured, and not refused."""
WINDOWS = [
    *("last(2)", "last(3,events)", "last(2,every(1))", HOPPING_WITH_GAPS, "every(1)", "every(3,events)"),
    *(
        "session(1)",
        "session(1,max(2))",
        "every(2,first)",
        "running(every(1))",
        "running(every(2,first))",
        "running(every(3,events))",
    ),
]
CONDITIONS = [
    *(
        "V > 3",
        "Y is V*1.0e200, Y > 1",
        "Y is V**V",
        "Y is 1 << V",
        "Y is 1/V",
        "Y is truncate(V)",
        "Y is sqrt(V)",
    ),
    *("Y is cot(V)", "Y is rational(V)", "Y is V mod 7", "Y is msb(V)", "format(atom(_),'~2f ~d',[V,V])"),
    *(
        "format(atom(_),'~*c',[V,97])",
        "atom_length(V,_)",
        "msort([V,1,nan,2.0],_)",
        "between(1,V,3)",
        "succ(V,_)",
    ),
    *("stamp_date_time(V,_,'UTC')", "format_time(atom(_),'%c',V)", "array_max(V,Y), Y > 1", "array_sum(V,_)"),
    *("sum_list(V,_)", "number_codes(V,_)", "Y is V - datime(2020,1,1,0,0,0)", "quaternion_rpy(V,_,_,_)"),
]
OTHER_RULES = [
    *(
        f"r(K,R) <- begin(K) seq aggregate({fold}, in(K,V), R)."
        for fold in ("avg(V)", "sum(V)", "min(V)", "max(V*V)")
    ),
    *(f"r(K,V) <- in(K,V) where {condition}." for condition in CONDITIONS),
    *(f"r(K,V) <- (begin(K) seq in(K,V)) where {condition}." for condition in CONDITIONS),
    "r(K,V) <- in(K,V) with debounce(1,K).",
    "r(K,V) <- in(K,V) with throttle(1,K).",
    "r(K,V) <- in(K,V) with change(V,K).",
    "r(K,V) <- (in(K,V) seq absent(in(K,W), 1)) where V > 2.",
    "r(K,N) <- aggregate(count, in(K,V), N, steps([low where V < 5, high where V > prev(V)])).",
    "exceptionAlarm(r(K,V), 1) <- in(K,V).",
    "exceptionAlarm(r(K), V) <- in(K,V).",
    "r(K,S) <- in(K,V) seq in(K,W) where S is V + W.",
]
RULES = [
    *(
        f"r(K,R) <- aggregate({aggregate}, in(K,V), R, {window})."
        for aggregate in AGGREGATES
        for window in WINDOWS
    ),
    *(f"r(K,M,N) <- aggregate([max(V),avg(V)], in(K,V), [M,N], {window})." for window in WINDOWS),
    *OTHER_RULES,
]
CLAUSES = "zero(0). plus_(V,S,T) :- T is S + V. same(S,S).\n"

REFUSED_BY_SUM = ["text", '"text"', "_", "f(x)", "1.5NaN", "1.0Inf", "-1.0Inf", "[a,b]", "1/0", "[[1],[2]]"]
ODD_VALUES = [
    *REFUSED_BY_SUM,
    *("1.0e308", "-1.0e308", "5.0e-324", "-0.0", str(10**400), str(-(10**400)), str(2**63), "9" * 5000),
    *("[1,2,3,4]", "[]", "[1.5NaN,1.0Inf,2.0]", f"[{10**400},1,2]", "[1,2]", "[1,2000000000]", "e", "2**100"),
]
NUMBERS = [str(number) for number in range(10)] + ["2.5"]
ARRAYS = ["[1,2,3]", "[4.5,5.0,6.5]", "[7,8,9]"]


class OddEngine(Engine):
    """An engine that collects its reports, and its derived events by key."""

    def __init__(self, rule: Any) -> None:
        recording = RecordingReports()
        super().__init__(reports=recording)
        self.recording = recording
        self.results: Dict[Any, Any] = {}
        self.later_count = 0
        self.load(rules=f"{CLAUSES}{rule}\nlater(K) <- in(K,_).")
        self.on_event(self._collect)
        for key in "abc":
            self.event(f"begin({key})", 1)

    def _collect(self, term: Any, start: Any, end: Any) -> None:
        if term.__class__ is tuple and term[0].name == "r":
            self.results.setdefault(self.show(term[1]), []).append((self.show(term), start, end))
        self.later_count += term.__class__ is tuple and term[0].name == "later"

    def feed(self, arrivals: Any) -> Any:
        for key, value, instant in arrivals:
            self.event(f"in({key},{value})", instant)
        self.event("end", 1000)
        assert self.later_count == len(arrivals)
        return self.results


def make_streams(values: Any) -> Any:
    """Return a strategy of streams: arrivals of keys and values in order, and odd ones among them."""
    steps = st.sampled_from([0.0, 0.1, 0.3, 0.7, 1.5])
    regular = st.tuples(st.sampled_from("abc"), st.sampled_from(values), steps, st.just(False))
    odd = st.tuples(st.sampled_from("ab"), st.sampled_from(ODD_VALUES), steps, st.just(True))
    return st.lists(st.one_of(regular, regular, odd), min_size=1, max_size=25)


def place(stream: Any) -> Tuple[Any, ...]:
    """Return the arrivals, and those without the odd ones."""
    instant, arrivals, regular_arrivals = 2.0, [], []
    for key, value, step, is_odd in stream:
        instant += step
        arrivals.append((key, value, instant))
        if not is_odd:
            regular_arrivals.append(arrivals[-1])
    return arrivals, regular_arrivals


@pytest.mark.slow
@settings(max_examples=60)
@given(st.sampled_from(RULES), st.one_of(make_streams(NUMBERS), make_streams(ARRAYS)))
def test_odd_values_change_no_result_of_other_keys(rule: Any, stream: Any) -> None:
    arrivals, regular_arrivals = place(stream)
    odd_keys = {key for key, _, _, is_odd in stream if is_odd}
    mixed, regular = OddEngine(rule), OddEngine(rule)
    results, expected = mixed.feed(arrivals), regular.feed(regular_arrivals)
    for key in set("abc") - odd_keys:
        assert results.get(key) == expected.get(key)
    assert len(mixed.recording.recorded_errors) == sum(
        event_rule.metrics.error_count for event_rule in mixed.rules.rules
    )


@settings(max_examples=20)
@given(
    st.sampled_from([window for window in WINDOWS if window != HOPPING_WITH_GAPS]),
    st.sampled_from(["sum(V)", "avg(V)", "[count,sum(V)]"]),
    make_streams(NUMBERS),
    st.sampled_from(REFUSED_BY_SUM),
)
def test_refused_values_are_counted_only(window: Any, aggregate: Any, stream: Any, value: Any) -> None:
    result = "[R,S]" if aggregate.startswith("[") else "R"
    rule = f"r(K,R) <- aggregate({aggregate}, in(K,V), {result}, {window})."
    stream = [(key, value if is_odd else own, step, is_odd) for key, own, step, is_odd in stream]
    arrivals, regular_arrivals = place(stream)
    mixed, regular = OddEngine(rule), OddEngine(rule)
    assert mixed.feed(arrivals) == regular.feed(regular_arrivals)
    assert (
        mixed.rules.rules[0].metrics.error_count
        == len(mixed.recording.recorded_errors)
        == len(arrivals) - len(regular_arrivals)
    )
