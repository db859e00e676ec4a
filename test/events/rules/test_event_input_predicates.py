import pytest
from reachability import count_entries

from retalis import Operators, RetalisError, functor
from retalis.events.rules.event_input_predicates import InputReader, event_of
from retalis.prolog.syntax.event_text import EventReader
from retalis.prolog.terms.term_traversal import freeze
from retalis.prolog.terms.timestamps import SECOND

STAMP = "datime(2014,10,19,19,50,5,981209993)"
TEXTS = [
    f"event(a,[{STAMP},{STAMP}])",
    f"event(tf('\"/odom\"',[1.5,-2]),[{STAMP},{STAMP}])",
    f"event(a,[{STAMP},datime(2014,10,19,19,50,6,981209993)])",
    f"event(a, [{STAMP}, {STAMP}])",
    "event(a,[datime(2014,10,19,19,50,5.5,1),datime(2014,10,19,19,50,5.5,1)])",
    "event(a,[datime(2014,10,19,19,50,5.0,1),datime(2014,10,19,19,50,5.0,1)])",
    "event(a,[datime(2014,10,19,19,50,5),datime(2014,10,19,19,50,5)])",
    "event(a,[datime(2014,13,19,19,50,5,1),datime(2014,13,19,19,50,5,1)])",
    "event(a,[datime(2014,10,19,19,50,5,1234567890),datime(2014,10,19,19,50,5,1234567890)])",
    "event(a,[datime(1970,1,1,0,0,0,0),datime(1970,1,1,0,0,0,0)])",
    f"event('x,[{STAMP},{STAMP}])",
    f"event('x',[{STAMP},{STAMP}])'",
    f"event(f('a,[{STAMP},{STAMP}])'),[{STAMP},{STAMP}])",
    f"event(a,b,[{STAMP},{STAMP}])",
    f"event(0',[{STAMP},{STAMP}])",
    f"event(X,[{STAMP},{STAMP}])",
    f"event(3,[{STAMP},{STAMP}])",
    f"event(,[{STAMP},{STAMP}])",
    f"event(a % ,[{STAMP},{STAMP}])",
    f"event(-,[{STAMP},{STAMP}])",
    f"event(a,[{STAMP},{STAMP}]).",
    "event(a)",
    "event(a,[1,2])",
    "event(event(a,[1,2]))",
    "event(event(a))",
    f"event(event(a,[{STAMP},{STAMP}]))",
    f"event(event(a,[{STAMP},{STAMP}]),[{STAMP},{STAMP}])",
    "new_event(a,1,2)",
    "halt",
    "",
]


def outcome(read, text):
    try:
        made = read(text)
    except RetalisError as error:
        return type(error), str(error)
    if made is None:
        return None
    return freeze(made.term), made.start, made.end, type(made.start), type(made.end)


@pytest.mark.parametrize("text", TEXTS)
def test_the_short_way_gives_what_the_long_one_gives(text):
    reader = InputReader(Operators.prolog())

    def at_length(text):
        return event_of(EventReader(Operators.prolog()).read(text))

    for _ in range(2):  # new to the reader, and known to it
        assert outcome(reader.parse_event, text) == outcome(at_length, text)


def test_stamps_of_many_seconds_keep_their_instants():
    reader = InputReader(Operators.prolog())
    before = count_entries(reader)
    for second in list(range(60)) * 2:
        for minute in (3, 4):
            stamp = f"datime(1970,1,1,0,{minute},{second},5)"
            made = reader.parse_event(f"event(a,[{stamp},{stamp}])")
            assert made.start == made.end == (minute * 60 + second) * 10**9 + 5
            assert type(made.start) is int
    assert count_entries(reader) - before <= 64 + 10


def test_an_event_of_an_event_with_stamps_is_that_event():
    made = event_of(EventReader(Operators.prolog()).read("event(event(a(1),[2,3]))"))
    assert (made.term, made.start, made.end) == (functor("a", 1)(1), 2 * SECOND, 3 * SECOND)
    with pytest.raises(RetalisError, match="interval"):
        event_of(EventReader(Operators.prolog()).read("event(event(a(1),2))"))


def test_events_without_variables_are_told_from_others():
    reader = InputReader(Operators.prolog())
    stamp = "datime(2014,10,19,19,50,5,1)"
    assert reader.parse_event(f"event(a(1),[{stamp},{stamp}])").ground is True
    assert reader.parse_event(f"event(a(X),[{stamp},{stamp}])").ground is False
    assert reader.parse_event("event(a(1))").ground is None


def test_a_stamp_of_thousands_of_digits_is_no_instant():
    stamp = f"datime(2014,10,19,19,50,{'9' * 5000},1)"
    with pytest.raises(RetalisError):
        InputReader(Operators.prolog()).parse_event(f"event(a,[{stamp},{stamp}])")
