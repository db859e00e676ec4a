"""Messages with named slots: parsing, errors, and output."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import Definitions, Operators, SyntaxFault, UsageError
from retalis.messages.message_notation import SlotNames
from retalis.messages.type_registry import InstalledTypes
from retalis.prolog.syntax.event_text import to_text
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.tokenizer import ReadFlags
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import term_key

DEFINITIONS = Definitions(InstalledTypes(packages=[], modules=[], include_rosbags=False))
DEFINITIONS.add("my_msgs/Point", "float64 x\nfloat64 y\n")
DEFINITIONS.add("my_msgs/Empty", "")
DEFINITIONS.add(
    "my_msgs/All",
    "bool on\nstring text\ntime stamp\nfloat32[] many\nint8[2] two\nuint8[] data\n"
    "Point point\nPoint[] points\nEmpty no\n",
)
DEFINITIONS.add("my_msgs/Huge", "uint8[2000000] data\n")

POINT, ALL = "my_msgs__0__Point", "my_msgs__0__All"
ZERO = f"{POINT}(0.0,0.0)"


def slots():
    known = SlotNames(DEFINITIONS)
    known.events["spot"] = "my_msgs/Point"
    return known


PROGRAM = PrologSystem()
KNOWING = PROGRAM.operators
KNOWING.message_types = slots()


def read(text, is_constructed=False, operators=KNOWING):
    return read_term(text, operators, flags=ReadFlags(is_constructed=is_constructed)).term


READS = {
    f"{POINT}{{x: X}}": f"{POINT}(X, _)",
    f"{POINT}{{}}": f"{POINT}(_, _)",
    f"{POINT}{{y: 1, x: X}}": f"{POINT}(X, 1.0)",
    f"{POINT}{{y: -1, x: 0}}": f"{POINT}(0.0, -1.0)",
    f"{POINT}{{y: 1 + 1, x: 1.5}}": f"{POINT}(1.5, 1 + 1)",
    f"{POINT}{{x: 1{'0' * 400}}}": f"{POINT}(1{'0' * 400}, _)",
    f"{ALL}{{many: [1, X, 2.5, -3 | R]}}": f"{ALL}(_,_,_,[1.0,X,2.5,-3.0|R],_,_,_,_,_)",
    f"{ALL}{{two: [1, 2]}}": f"{ALL}(_,_,_,_,[1,2],_,_,_,_)",
    f"{ALL}{{many: M, stamp: [1, 2]}}": f"{ALL}(_,_,[1,2],M,_,_,_,_,_)",
    "spot{y: Y}": "spot(_, Y)",
    "my_msgs__0__Empty{}": "my_msgs__0__Empty",
    f"{ALL}{{point: {{y: Y}}}}": f"{ALL}(_,_,_,_,_,_,{POINT}(_,Y),_,_)",
    f"{ALL}{{point: {POINT}{{y: Y}}}}": f"{ALL}(_,_,_,_,_,_,{POINT}(_,Y),_,_)",
    f"{ALL}{{points: [{{x: 1}}, P | R]}}": f"{ALL}(_,_,_,_,_,_,_,[{POINT}(1.0,_), P | R],_)",
    f"{ALL}{{no: {{}}}}": f"{ALL}(_,_,_,_,_,_,_,_,my_msgs__0__Empty)",
    f"{ALL}{{point: {{}}, points: [{{}}]}}": f"{ALL}(_,_,_,_,_,_,{POINT}(_,_),[{POINT}(_,_)],_)",
    f"{ALL}{{stamp: [S, _], on: true}}": f"{ALL}(true,_,[S,_],_,_,_,_,_,_)",
    f"{POINT}{{x: - 1 + 2 * X}}": f"{POINT}(- 1 + 2 * X, _)",
    f"a <- {POINT}{{x: X}} seq {POINT}{{x: X}}": f"a <- {POINT}(X, _) seq {POINT}(X, _)",
    f"{POINT}{{x: X}} <- a(X)": f"{POINT}(X, 0.0) <- a(X)",
    f"l : {POINT}{{x: X}} do event({POINT}{{y: 1}}) <- a(X)": (
        f"l : {POINT}(X,0.0) do event({POINT}(0.0,1.0)) <- a(X)"
    ),
    f"exceptionAlarm({POINT}{{}}, 5) <- a": f"exceptionAlarm({ZERO}, 5) <- a",
    f"rev({POINT}{{}}) <- a": f"rev({POINT}(_, _)) <- a",
    f"synchronized({POINT}{{}}, p({POINT}{{}}), []) <- a": f"synchronized({ZERO}, p({POINT}(_, _)), []) <- a",
    f"a <- b where ({POINT}{{}} = X)": f"a <- b where ({POINT}(_, _) = X)",
    f"subscribe({POINT}{{}}, [], {POINT}{{x: 2}}, t, i)": f"subscribe({POINT}(_,_), [], {POINT}(2.0, 0.0), t, i)",
    f"memorize({POINT}{{x: X}}, [], f({POINT}{{x: X}}), i, 5)": (
        f"memorize({POINT}(X,_), [], f({POINT}(X,0.0)), i, 5)"
    ),
    f"new_event({POINT}{{}}, 1, 2)": f"new_event({ZERO}, 1, 2)",
    f"p :- stored_event(event({POINT}{{}}, T))": f"p :- stored_event(event({POINT}(_, _), T))",
    f"p({POINT}{{}}) :- event({ALL}{{}})": (
        f"p({POINT}(_, _)) :- event({ALL}(false,'\"\"',[0,0],[],[0,0],'\"\"',{ZERO},[],my_msgs__0__Empty))"
    ),
}


def test_what_messages_with_named_slots_read_as():
    for text, same in READS.items():
        assert term_key(read(text)) == term_key(read(same)), text
    assert to_text(read(f"{POINT}{{x: 3}}", is_constructed=True)) == f"{POINT}(3.0,0.0)"


WRONG = {
    f"a <- {POINT}{{z: X}}": (24, f"{POINT} has no slot z; it has x, y"),
    f"{ALL}{{pont: X}}": (17, f"{ALL} has no slot pont; did you mean point?"),
    f"{ALL}{{point: {{xx: X}}}}": (25, f"{POINT} has no slot xx; did you mean x?"),
    f"{POINT}{{x: 1, x: 2}}": (25, "slot x has a value already"),
    f"{POINT}{{x:-1}}": (20, "expected a space between : and the sign that follows"),
    f"{POINT}{{x}}": (20, 'expected a colon and a value after "x"'),
    f"{POINT}{{X: 1}}": (19, 'expected the name of a slot before "X"'),
    f"{POINT}{{x: 1,}}": (24, 'expected the name of a slot before "}"'),
    f"{POINT}{{x: }}": (22, 'expected a term before "}"'),
    f"{POINT}{{x: 1": (23, 'expected "}" for the "{" in line 1, column 18'),
    f"{ALL}{{point.x: 1}}": (
        22,
        "slots of a message in a slot are written in brackets: point: {slot: Value}",
    ),
    f"{ALL}{{text: {{x: 1}}}}": (23, "text is string, which has no slots"),
    f"{ALL}{{points: {{x: 1}}}}": (25, "points is my_msgs/Point[]: expected a list of its elements"),
    "b :- my_msgs__0__Other{a: 1}": (6, "the slots of my_msgs/Other are not known when this is read"),
    "my_msgs__0__Huge{}": (1, "messages of my_msgs/Huge have 2000000 bytes at least"),
}


def test_what_is_wrong_is_said_at_its_place():
    for text, (column, message) in WRONG.items():
        with pytest.raises(SyntaxFault) as caught:
            read(text)
        assert message in caught.value.message, text
        assert (text, caught.value.place.column) == (text, column)


def test_nothing_that_has_read_otherwise_reads_otherwise():
    plain, knowing = Operators.prolog(), KNOWING.copy()
    for text in (
        "{}",
        "{a}",
        "{a: b, c}",
        "f({x: 1})",
        "- {x: 1}",
        "\\+ {x}",
        f"{POINT}(X, _)",
        "'{}'(a)",
        "[{x: 1}]",
    ):
        assert term_key(read(text)) == term_key(read(text, operators=plain)), text
    for text in ("a {b}", "X{a: 1}", "f(x){a: 1}", "0{x: 1}", "a/B{c}", "[] {}"):
        messages = []
        for operators in (plain, knowing):
            with pytest.raises(SyntaxFault) as caught:
                read(text, operators=operators)
            messages.append(str(caught.value))
        assert messages[0] == messages[1], text
    knowing.add(200, "fy", POINT)  # a program's own prefix operator
    plain.add(200, "fy", POINT)
    assert term_key(read(f"{POINT}{{x}}", operators=knowing)) == term_key(
        read(f"{POINT}{{x}}", operators=plain)
    )


UNKNOWN = "no message type or event of a topic is called"
MISNAMED = {
    "a <- spott{x: 1}": (6, f"{UNKNOWN} spott; did you mean spot?"),
    "a <- wrong{x: 1}": (6, f"{UNKNOWN} wrong"),
    "a <- Point{x: 1} where b": (6, f"{UNKNOWN} Point; write {POINT}{{...}}"),
    "a <- point {x: 1} where b": (6, f"{UNKNOWN} point; write {POINT}{{...}}"),
    "a <- Poin{x: 1}": (6, f"{UNKNOWN} Poin; did you mean {POINT}?"),
    "a <- Spot{x: 1}": (6, f"{UNKNOWN} Spot; write spot{{...}}"),
    "a <- my_msgs_Point{x: 1}": (6, f"{UNKNOWN} my_msgs_Point; write {POINT}{{...}}"),
    "f(my_msgs/Point{x: 1})": (3, f"{UNKNOWN} my_msgs/Point; write {POINT}{{...}}"),
    "a <- 'my_msgs/Point'{x: 1}": (6, f"{UNKNOWN} my_msgs/Point; write {POINT}{{...}}"),
    f"a <- {POINT} {{x: 1}}": (24, f'no space is allowed between {POINT} and its "{{"'),
    "my_msgs__0__Other {x: 1}": (19, 'no space is allowed between my_msgs__0__Other and its "{"'),
}


def test_a_name_that_no_messages_have_is_said_with_those_that_were_meant():
    for text, (column, message) in MISNAMED.items():
        with pytest.raises(SyntaxFault) as caught:
            read(text)
        assert (text, caught.value.message) == (text, message)
        assert (text, caught.value.place.column) == (text, column)


def test_who_knows_no_messages_reads_none_by_name():
    with pytest.raises(SyntaxFault, match="slots by name are not available here"):
        read(f"{POINT}{{x: 1}}", operators=Operators.prolog())
    with pytest.raises(SyntaxFault):  # nor does what comes from other nodes
        read_term(f"{POINT}{{x: 1}}", KNOWING, flags=ReadFlags(event_text=True))


SHOWN = (
    f"a<-{POINT}{{x: X}}where X>1",
    f"{POINT}{{x: X}}<-a(X)",
    f"a(X)<-{ALL}{{text: '\"t\"', point: {{y: X}}}}",
    f"a(X)<-{ALL}{{point: {{y: X}}, text: '\"t\"'}}",
    f"a(X)<-{ALL}{{points: [{POINT}{{x: X}},P|R]}}seq b(P,R)",
    f"subscribe(spot{{x: X}},[],{POINT}{{x: X}},t,i)",
    f"p({POINT}(0.0,0.0)):-event({POINT}{{}})",
    f"a<-{POINT}{{x: 0, y: -2}}",
    f"a<-{POINT}{{x: 0.0}}",
    f"a<-{POINT}{{x: -0.0, y: 1}}seq {POINT}{{x: 0}}",
    f"a(X)<-{POINT}{{x: X}}seq {POINT}{{x: 1}}",
    f"{ALL}{{many: [1,X,2.5]}}<-a(X)",
)


def test_terms_are_shown_as_they_were_written():
    for text in SHOWN:
        KNOWING.message_types.notations.clear()
        found = read_term(text, KNOWING)
        shown = PROGRAM.show(found.term, names={var: name for name, var in found.names.items()})
        assert shown == text
        assert term_key(read(shown)) == term_key(found.term)


def test_a_head_alone_is_shown_as_what_is_made():
    # Messages are shown with the slots that the program has written, so it must be one without other messages.
    program = PrologSystem()
    program.operators.message_types = slots()
    rule = read(f"{POINT}{{x: 1}} <- {POINT}{{y: 1}}", operators=program.operators)
    assert program.show(rule[1], is_constructed=True) == f"{POINT}{{x: 1}}"
    assert program.show(rule[1]) == f"{POINT}(1.0,0.0)"  # as a pattern it would match more
    assert program.show(rule) == f"{POINT}{{x: 1}}<-{POINT}{{y: 1}}"


values = st.sampled_from(["X", "Y", "1", "2.5", "'\"t\"'", "[A,B]"])
points = st.dictionaries(st.sampled_from(["x", "y"]), values, max_size=2)


@st.composite
def messages(draw):
    """Return a message with some of its slots by name, and the same with all slots in their order."""
    names = [slot.name for slot in DEFINITIONS.find("my_msgs/All").fields]
    chosen = draw(st.lists(st.sampled_from(names), unique=True))
    named, plain = [], {}
    for name in chosen:
        if name == "point":
            inner = draw(points)
            text = "{" + ", ".join(f"{slot}: {value}" for slot, value in inner.items()) + "}"
            floats = {slot: {"1": "1.0"}.get(value, value) for slot, value in inner.items()}
            plain[name] = f"{POINT}({floats.get('x', '_')},{floats.get('y', '_')})"
        else:
            text = plain[name] = draw(values)
        named.append(f"{name}: {text}")
    ordered = ",".join(plain.get(name, "_") for name in names)
    return f"{ALL}{{{', '.join(named)}}}", f"{ALL}({ordered})"


FRAMES = ("{}", "a(X) <- {}", "a <- {} seq b(X)", "p(Y) :- q({}, {}), r(X)", "p :- stored_event({})")


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(st.lists(messages(), min_size=2, max_size=2), st.sampled_from(FRAMES))
def test_named_slots_read_as_those_in_order_and_are_shown_so_that_they_read_back(found, frame):
    text = frame.format(*(named for named, _ in found))
    term = read_term(text, KNOWING)
    same = read(frame.format(*(plain for _, plain in found)))
    assert term_key(term.term) == term_key(same)
    for names in ({}, {var: name for name, var in term.names.items()}):
        again = read(PROGRAM.show(term.term, names=names))
        assert term_key(again) == term_key(same)


def test_a_type_that_is_misspelt_is_answered_with_the_one_that_was_meant():
    with pytest.raises(UsageError) as caught:
        SlotNames(Definitions()).find("std_msgs__0__Strng")
    assert str(caught.value) == "there is no message type std_msgs/Strng; did you mean std_msgs/String?"
