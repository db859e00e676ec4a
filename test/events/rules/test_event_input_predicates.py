"""Reader of input events: timestamps in all forms, and the short path for events."""

from typing import Any, Optional, Tuple

import pytest
from asserting_accessors import required
from reachable_objects import count_entries

from retalis import Operators, RetalisError, functor
from retalis.events.rules.event_input_predicates import InputReader, event_of
from retalis.prolog.syntax.event_text import EventReader
from retalis.prolog.terms.term_traversal import freeze
from retalis.prolog.terms.timestamps import SECOND

TIMESTAMP = "datime(2014,10,19,19,50,5,981209993)"
TEXTS = [
    f"event(a,[{TIMESTAMP},{TIMESTAMP}])",
    f"event(tf('\"/odom\"',[1.5,-2]),[{TIMESTAMP},{TIMESTAMP}])",
    f"event(a,[{TIMESTAMP},datime(2014,10,19,19,50,6,981209993)])",
    f"event(a, [{TIMESTAMP}, {TIMESTAMP}])",
    "event(a,[datime(2014,10,19,19,50,5.5,1),datime(2014,10,19,19,50,5.5,1)])",
    "event(a,[datime(2014,10,19,19,50,5.0,1),datime(2014,10,19,19,50,5.0,1)])",
    "event(a,[datime(2014,10,19,19,50,5),datime(2014,10,19,19,50,5)])",
    "event(a,[datime(2014,13,19,19,50,5,1),datime(2014,13,19,19,50,5,1)])",
    "event(a,[datime(2014,10,19,19,50,5,1234567890),datime(2014,10,19,19,50,5,1234567890)])",
    "event(a,[datime(1970,1,1,0,0,0,0),datime(1970,1,1,0,0,0,0)])",
    f"event('x,[{TIMESTAMP},{TIMESTAMP}])",
    f"event('x',[{TIMESTAMP},{TIMESTAMP}])'",
    f"event(f('a,[{TIMESTAMP},{TIMESTAMP}])'),[{TIMESTAMP},{TIMESTAMP}])",
    f"event(a,b,[{TIMESTAMP},{TIMESTAMP}])",
    f"event(0',[{TIMESTAMP},{TIMESTAMP}])",
    f"event(X,[{TIMESTAMP},{TIMESTAMP}])",
    f"event(3,[{TIMESTAMP},{TIMESTAMP}])",
    f"event(,[{TIMESTAMP},{TIMESTAMP}])",
    f"event(a % ,[{TIMESTAMP},{TIMESTAMP}])",
    f"event(-,[{TIMESTAMP},{TIMESTAMP}])",
    f"event(a,[{TIMESTAMP},{TIMESTAMP}]).",
    "event(a)",
    "event(a,[1,2])",
    "event(event(a,[1,2]))",
    "event(event(a))",
    f"event(event(a,[{TIMESTAMP},{TIMESTAMP}]))",
    f"event(event(a,[{TIMESTAMP},{TIMESTAMP}]),[{TIMESTAMP},{TIMESTAMP}])",
    "new_event(a,1,2)",
    "halt",
    "",
]


def outcome(read: Any, text: Any) -> Optional[Tuple[Any, ...]]:
    try:
        event = read(text)
    except RetalisError as error:
        return type(error), str(error)
    if event is None:
        return None
    return freeze(event.term), event.start, event.end, type(event.start), type(event.end)


@pytest.mark.parametrize("text", TEXTS)
def test_short_path_equals_complete_path(text: str) -> None:
    reader = InputReader(Operators.prolog())

    def read_completely(text: Any) -> Any:
        return event_of(EventReader(Operators.prolog()).read(text))

    for _ in range(2):  # the second time, the reader has cached the text
        assert outcome(reader.parse_event, text) == outcome(read_completely, text)


def test_timestamps_keep_instants_beyond_cache() -> None:
    reader = InputReader(Operators.prolog())
    count_before = count_entries(reader)
    for second in list(range(60)) * 2:
        for minute in (3, 4):
            timestamp = f"datime(1970,1,1,0,{minute},{second},5)"
            event = required(reader.parse_event(f"event(a,[{timestamp},{timestamp}])"))
            assert event.start == event.end == (minute * 60 + second) * 10**9 + 5
            assert type(event.start) is int
    assert count_entries(reader) - count_before <= 64 + 10


def test_nested_event_with_timestamps_is_unwrapped() -> None:
    event = required(event_of(EventReader(Operators.prolog()).read("event(event(a(1),[2,3]))")))
    assert (event.term, event.start, event.end) == (functor("a", 1)(1), 2 * SECOND, 3 * SECOND)
    with pytest.raises(RetalisError, match="interval"):
        event_of(EventReader(Operators.prolog()).read("event(event(a(1),2))"))


def test_reader_reports_ground_events() -> None:
    reader = InputReader(Operators.prolog())
    timestamp = "datime(2014,10,19,19,50,5,1)"
    assert required(reader.parse_event(f"event(a(1),[{timestamp},{timestamp}])")).ground is True
    assert required(reader.parse_event(f"event(a(X),[{timestamp},{timestamp}])")).ground is False
    assert required(reader.parse_event("event(a(1))")).ground is None


def test_timestamp_of_thousands_of_digits_is_refused() -> None:
    timestamp = f"datime(2014,10,19,19,50,{'9' * 5000},1)"
    with pytest.raises(RetalisError):
        InputReader(Operators.prolog()).parse_event(f"event(a,[{timestamp},{timestamp}])")
