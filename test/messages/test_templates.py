"""Templates of ``retalis msg`` for all installed types, parsed again."""

import pytest
from rosbags.typesys import Stores, get_typestore

from retalis import Definitions, MessageError, Operators, Var, deref
from retalis.messages.named_slots import SlotNames, by_names, positional, zero
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.terms.term_traversal import term_key

DEFINITIONS = Definitions()
OPERATORS = Operators.prolog()
OPERATORS.slots = SlotNames(DEFINITIONS)


def read(text):
    """Return the term of a template, and the names in it."""
    found = read_term(text, OPERATORS)
    assert not [name for name in found.names if not name[0].isupper()]
    return found.term, len(found.names)


def shape(term):
    """Return a term with all variables alike."""
    term = deref(term)
    if term.__class__ is tuple:
        return (term[0], *map(shape, term[1:]))
    return Var if term.__class__ is Var else term


def expected(definition):
    """Return the shape that a template of a type has, and how many variables."""
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


def check(definition):
    for text in (positional(definition), by_names(definition)):
        term, names = read(text)
        assert (shape(term), names) == expected(definition), text
    data = bytes(definition.measure.min_size)
    text = zero(definition, DEFINITIONS)
    assert term_key(read(text)[0]) == term_key(DEFINITIONS.decoder(definition).decode(data))
    assert DEFINITIONS.encoder(definition).encode(read(text)[0]) == data


@pytest.mark.slow
def test_templates_of_all_installed_types_read_back():
    store = get_typestore(Stores.ROS1_NOETIC)
    names = getattr(store, "fielddefs", None) or store.FIELDDEFS  # by its version
    checked = 0
    for name in sorted(names):
        package, _, kind = name.split("/")
        try:
            definition = DEFINITIONS.find(f"{package}/{kind}")
        except MessageError:
            continue
        check(definition)
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

PRINTED = """odd_msgs__0__Odd(
    std_msgs__0__Header(       % header: std_msgs/Header
        Seq,                   % seq: uint32
        [Sec, NSec],           % stamp: time
        FrameId                % frame_id: string
    ),
    [ThenSec, ThenNSec],       % then: time
    Spans,                     % spans: duration[]
    odd_msgs__0__Part(         % first: odd_msgs/Part
        FirstSeq,              % seq: string
        odd_msgs__0__Nothing,  % nothing: odd_msgs/Nothing
        Inner                  % inner: odd_msgs/Inner[2]
    ),
    Others,                    % others: odd_msgs/Part[]
    Bytes,                     % bytes: uint8[4]
    AB,                        % aB: string
    AB_2,                      % a_b: string
    Seq_2                      % seq: string
)

% odd_msgs/Part, an element:
% odd_msgs__0__Part(
%     Seq,                   % seq: string
%     odd_msgs__0__Nothing,  % nothing: odd_msgs/Nothing
%     Inner                  % inner: odd_msgs/Inner[2]
% )

% odd_msgs/Inner, an element:
% odd_msgs__0__Inner(
%     X  % x: float64
% )

% constants of odd_msgs/Odd:
%   ON = 1 (uint8)
%   NAME = a % "quoted' */ name (string)
"""


def test_what_is_alike_has_variables_of_its_own():
    odd = DEFINITIONS.add("odd_msgs/Odd", ODD.replace("string _Odd\n", ""))
    assert positional(odd) == PRINTED
    check(odd)
