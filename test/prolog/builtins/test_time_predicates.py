"""Predicates of timestamps."""

import pytest
from prolog.goal_answers import answers, first, prolog

TIMESTAMPS = [
    ("convert_to_datime([10,5], X)", "datime(1970,1,1,0,0,10.0,5)"),
    (
        "datime_interpolate(datime(2001,1,1,23,59,58,0),datime(2001,1,2,0,0,2,0),datime(2001,1,2,0,0,0,0),X)",
        "0.5",
    ),
    ("datime_interpolate(3, 3, 3, X)", "1"),
    ("datime_minus_datime(datime(2001,1,1,0,0,10),datime(2001,1,1,0,0,4),X)", "6"),
    ("datime_minus_datime(datime(2001,1,2,1,0,0,0),datime(2001,1,1,0,0,0,0),X)", "90000.0"),
    ("datime_minus_datime(datime(2001,3,1,0,0,0),datime(2001,2,28,0,0,0),X)", "86400"),
    ("datime_minus_datime(7,2.5,X)", "4.5"),
    ("datime_minus_datime(datime(2001,1,1,0,0,10),datime(2001,1,1,0,0,4,0),X)", "6.0"),
    ("datime_minus_datime([5,1],datime(1970,1,1,0,0,5,0),X)", "1.0e-9"),
    ("datime_minus_datime(datime(2026,11,22,0,0,0.0,300000000),datime(2026,11,22,0,0,0,200000000),X)", "0.1"),
    ("datime_plus_sec(datime(2001,2,28,23,59,59),1,X)", "datime(2001,3,1,0,0,0)"),
    ("datime_plus_sec(datime(2001,1,1,0,0,59),0.5,X)", "datime(2001,1,1,0,0,59.5)"),
    ("datime_plus_sec(datime(2001,1,1,0,0,10),-15,X)", "datime(2000,12,31,23,59,55)"),
    ("datime_minus_sec(datime(2001,3,1,0,0,0),1,X)", "datime(2001,2,28,23,59,59)"),
    ("datime_plus_sec(datime(2026,12,31,23,59,59,900000000),0.2,X)", "datime(2027,1,1,0,0,0,100000000)"),
    ("datime_plus_sec(datime(2026,12,31,23,59,59.0,900000000),0.2,X)", "datime(2027,1,1,0,0,0.0,100000000)"),
    ("datime_minus_sec(datime(2027,1,1,0,0,0,100000000),0.2,X)", "datime(2026,12,31,23,59,59,900000000)"),
    ("datime_plus_sec([5,900000000],0.2,X)", "[6,100000000]"),
    ("datime_plus_sec(5,2,X)", "7"),
    ("datime_minus_sec(5.5,2,X)", "3.5"),
    ("datime_plus_sec(datime(9999,12,31,23,59,59,0),1,X)", "evaluation_error(undefined)"),
    ("datime_plus_sec(foo,1,X)", "type_error(datime,foo)"),
    ("datime_plus_sec(1,foo,X)", "type_error(number,foo)"),
    ("addSec_Datime(5,datime(2001,1,1,0,0,10),X)", "datime(2001,1,1,0,0,15)"),
    ("month_days(2, 2000, X)", "29"),
    ("absoluteTime(datime(2001,1,1,1,0,5,0), X)", "3605"),
    ("stamp_date_time(0, X, 'UTC')", "date(1970,1,1,0,0,0.0,0,'UTC',-)"),
    ("date_time_stamp(date(2001,2,3,4,5,6.5,0,-,-), X)", "981173106.5"),
    ("parse_time('2001-02-03T04:05:06+01:00', X)", "981169506.0"),
    ("format_time(atom(X), '%Y-%m-%d %H:%M:%S.%3f', 1.5)", "'1970-01-01 00:00:01.500'"),
    ("convert_to_datime(x, X)", "type_error('[Sec,NSec]',x)"),
    ("datime_interpolate([1,0], [2,0], datime(1970,1,1,0,0,1,500000000), X)", "0.5"),
    ("datime_interpolate(a, 1, 2, X)", "type_error(datime,a)"),
    ("datime_interpolate([1,b], 1, 2, X)", "type_error(datime,[1,b])"),
]


@pytest.mark.parametrize(("goal", "value"), TIMESTAMPS)
def test_timestamp_predicate_has_value(goal: str, value: str) -> None:
    assert first(prolog(), goal) == value


def test_timestamps_compare_by_instant() -> None:
    logic = prolog()
    assert answers(logic, "less_datime(datime(2001,1,1,0,0,1), datime(2001,1,1,0,0,2,0))") == [{}]
    assert answers(logic, "equal_datime(datime(1970,1,1,0,0,1.5,0), 1.5)") == [{}]
    assert answers(logic, "between_datime(datime(2001,1,1,0,0,1,0),datime(2001,1,1,0,0,1,0),3)") == []
    assert answers(logic, "between_datime(1, 1, 3)") == [{}]
