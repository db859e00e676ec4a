"""Templates of messages, as ``retalis msg`` prints them."""

from typing import Any, Tuple

import pytest
from rosbags.typesys import Stores, get_typestore

from retalis import Definitions, MessageError, Operators, Var, deref
from retalis.messages.message_slots import SlotNames
from retalis.messages.message_templates import format_positional, format_with_names, format_with_zeros
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.terms.term_traversal import term_key

DEFINITIONS = Definitions()
OPERATORS = Operators.prolog()
OPERATORS.message_types = SlotNames(DEFINITIONS)


def read(text: Any) -> Tuple[Any, ...]:
    """Return the term of a template and the number of its variables."""
    read_result = read_term(text, OPERATORS)
    assert not [name for name in read_result.names if not name[0].isupper()]
    return read_result.term, len(read_result.names)


def shape(term: Any) -> Any:
    """Return a term whose variables are replaced by one object."""
    term = deref(term)
    if term.__class__ is tuple:
        return (term[0], *map(shape, term[1:]))
    return Var if term.__class__ is Var else term


def expected(definition: Any) -> Tuple[Any, ...]:
    """Return the expected shape of a template and the number of its variables."""
    if not definition.fields:
        return DEFINITIONS.decoder(definition).decode(b""), 0
    parts, number = [], 0
    for slot in definition.fields:
        if slot.definition is not None and slot.length is None:
            part, more = expected(slot.definition)
        elif slot.type in ("time", "duration") and slot.length is None:
            part, more = shape(read_term("[_, _]", OPERATORS).term), 2
        else:
            part, more = Var, 1
        parts.append(part)
        number += more
    return (DEFINITIONS.decoder(definition).functor, *parts), number


def check_templates(definition: Any) -> None:
    for text in (format_positional(definition), format_with_names(definition)):
        term, names = read(text)
        assert (shape(term), names) == expected(definition), text
    data = bytes(definition.measure.min_size)
    text = format_with_zeros(definition, DEFINITIONS)
    assert term_key(read(text)[0]) == term_key(DEFINITIONS.decoder(definition).decode(data))
    assert DEFINITIONS.encoder(definition).encode(read(text)[0]) == data


def test_large_message_with_zeros_is_refused() -> None:
    definitions = Definitions()
    definition = definitions.add("large_msgs/Map", "uint8[1000000000] cells\n")
    with pytest.raises(
        MessageError, match="a message of large_msgs/Map has 1000000000 bytes: expected at most 1000000 bytes"
    ):
        format_with_zeros(definition, definitions)


@pytest.mark.slow
def test_templates_of_installed_types_are_read() -> None:
    store: Any = get_typestore(Stores.ROS1_NOETIC)
    names = getattr(store, "fielddefs", None) or store.FIELDDEFS  # the name depends on the version of rosbags
    checked = 0
    for name in sorted(names):
        package, _, kind = name.split("/")
        try:
            definition = DEFINITIONS.find(f"{package}/{kind}")
        except MessageError:
            continue
        check_templates(definition)
        checked += 1
    assert checked > 100


ODD = """Header header
time then
duration[] spans
Part first
Part[] others
uint8[4] bytes
string _Odd
string aB
string a_b
string seq
uint8 ON=1
string NAME=a % "quoted' */ name
================================================================================
MSG: odd_msgs/Part
string seq
Nothing nothing
Inner[2] inner
================================================================================
MSG: odd_msgs/Nothing
================================================================================
MSG: odd_msgs/Inner
float64 x
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""

PRINTED = """odd_msgs__0__Odd(              % 68 bytes or more
    std_msgs__0__Header(       % header: std_msgs/Header, 16 bytes or more
        Seq,                   % seq: uint32, 4 bytes
        [Sec, NSec],           % stamp: time, 8 bytes
        FrameId                % frame_id: string, 4 bytes + text
    ),
    [ThenSec, ThenNSec],       % then: time, 8 bytes
    Spans,                     % spans: duration[], 4 bytes + 8 per element
    odd_msgs__0__Part(         % first: odd_msgs/Part, 20 bytes or more
        FirstSeq,              % seq: string, 4 bytes + text
        odd_msgs__0__Nothing,  % nothing: odd_msgs/Nothing, 0 bytes
        Inner                  % inner: odd_msgs/Inner[2], 16 bytes
    ),
    Others,                    % others: odd_msgs/Part[], 4 bytes + 20 or more per element
    Bytes,                     % bytes: uint8[4], 4 bytes
    AB,                        % aB: string, 4 bytes + text
    AB_2,                      % a_b: string, 4 bytes + text
    Seq_2                      % seq: string, 4 bytes + text
)

% odd_msgs/Part, an element:
% odd_msgs__0__Part(         % 20 bytes or more
%     Seq,                   % seq: string, 4 bytes + text
%     odd_msgs__0__Nothing,  % nothing: odd_msgs/Nothing, 0 bytes
%     Inner                  % inner: odd_msgs/Inner[2], 16 bytes
% )

% odd_msgs/Inner, an element:
% odd_msgs__0__Inner(  % 8 bytes
%     X                % x: float64, 8 bytes
% )

% constants of odd_msgs/Odd:
%   odd_msgs__0__Odd{ON} = 1 (uint8)
%   odd_msgs__0__Odd{NAME} = a % "quoted' */ name (string)

% for array_min/2, array_percentile/3 and others: bytes
"""


def test_equal_slot_names_have_distinct_variables() -> None:
    odd = DEFINITIONS.add("odd_msgs/Odd", ODD.replace("string _Odd\n", ""))
    assert format_positional(odd) == PRINTED
    check_templates(odd)


def test_template_shows_sizes_of_slots() -> None:
    text = "bool a\nfloat64[9] b\nstring[3] c\nfloat32[] d\nstring[] e\nuint8[] f\nbyte[1] g\n"
    template, _, predicates = format_with_names(DEFINITIONS.add("odd_msgs/Sizes", text)).partition("\n\n")
    assert predicates == "% for array_min/2, array_percentile/3 and others: b, d, f, g\n"
    assert [line.rpartition("% ")[2] for line in template.splitlines()[:-1]] == [
        "98 bytes or more",
        "bool, 1 byte",
        "float64[9], 72 bytes",
        "string[3], 12 bytes or more",
        "float32[], 4 bytes + 4 per element",
        "string[], 4 bytes + 4 or more per element",
        "uint8[], 4 bytes + 1 per element",
        "byte[1], 1 byte",
    ]


def test_template_names_arrays_and_predicates() -> None:
    text = format_positional(DEFINITIONS.find("nav_msgs/OccupancyGrid"))
    assert text.endswith(
        """
% for array_min/2, array_percentile/3 and others: data

% for map_cell/4: the whole message
"""
    )
    text = format_with_names(DEFINITIONS.find("nav_msgs/Odometry"))
    assert text.endswith("others: pose.covariance, twist.covariance\n")
    assert "array_min" not in format_positional(DEFINITIONS.find("geometry_msgs/PoseArray"))
