"""Messages with named slots: parsing, errors, and output."""

from typing import Any, List, Tuple

import pytest
from asserting_accessors import place_of, required
from hypothesis import given, settings
from hypothesis import strategies as st
from message_registries import empty_registry

from retalis import Definitions, Operators, SyntaxFault, UsageError
from retalis.messages.message_slots import SlotNames
from retalis.prolog.syntax.event_text import to_text
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.tokenizer import ReadFlags
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import term_key

DEFINITIONS = empty_registry()
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


def slot_names() -> SlotNames:
    names = SlotNames(DEFINITIONS)
    names.events["spot"] = "my_msgs/Point"
    return names


PROGRAM = PrologSystem()
OPERATORS = PROGRAM.operators
OPERATORS.message_types = slot_names()


def read(text: str, is_constructed: bool = False, operators: Any = OPERATORS) -> Any:
    return read_term(text, operators, flags=ReadFlags(is_constructed=is_constructed)).term


POSITIONAL = {
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


def test_named_slots_are_read_as_positional_term() -> None:
    for text, positional in POSITIONAL.items():
        assert term_key(read(text)) == term_key(read(positional)), text
    assert to_text(read(f"{POINT}{{x: 3}}", is_constructed=True)) == f"{POINT}(3.0,0.0)"


ERRORS = {
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


def test_error_in_named_slots_has_place() -> None:
    for text, (column, message) in ERRORS.items():
        with pytest.raises(SyntaxFault) as error:
            read(text)
        assert message in error.value.message, text
        assert (text, place_of(error.value).column) == (text, column)


def test_other_braces_are_read_as_in_prolog() -> None:
    plain, extended = Operators.prolog(), OPERATORS.copy()
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
        messages: List[Any] = []
        for operators in (plain, extended):
            with pytest.raises(SyntaxFault) as error:
                read(text, operators=operators)
            messages.append(str(error.value))
        assert messages[0] == messages[1], text
    extended.add(200, "fy", POINT)  # a prefix operator of the program
    plain.add(200, "fy", POINT)
    assert term_key(read(f"{POINT}{{x}}", operators=extended)) == term_key(
        read(f"{POINT}{{x}}", operators=plain)
    )


NO_SUCH_TYPE = "no message type or event of a topic is called"
MISNAMED_TYPES = {
    "a <- spott{x: 1}": (6, f"{NO_SUCH_TYPE} spott; did you mean spot?"),
    "a <- wrong{x: 1}": (6, f"{NO_SUCH_TYPE} wrong"),
    "a <- Point{x: 1} where b": (6, f"{NO_SUCH_TYPE} Point; write {POINT}{{...}}"),
    "a <- point {x: 1} where b": (6, f"{NO_SUCH_TYPE} point; write {POINT}{{...}}"),
    "a <- Poin{x: 1}": (6, f"{NO_SUCH_TYPE} Poin; did you mean {POINT}?"),
    "a <- Spot{x: 1}": (6, f"{NO_SUCH_TYPE} Spot; write spot{{...}}"),
    "a <- my_msgs_Point{x: 1}": (6, f"{NO_SUCH_TYPE} my_msgs_Point; write {POINT}{{...}}"),
    "f(my_msgs/Point{x: 1})": (3, f"{NO_SUCH_TYPE} my_msgs/Point; write {POINT}{{...}}"),
    "a <- 'my_msgs/Point'{x: 1}": (6, f"{NO_SUCH_TYPE} my_msgs/Point; write {POINT}{{...}}"),
    f"a <- {POINT} {{x: 1}}": (24, f'no space is allowed between {POINT} and its "{{"'),
    "my_msgs__0__Other {x: 1}": (19, 'no space is allowed between my_msgs__0__Other and its "{"'),
}


def test_unknown_type_is_reported_with_similar_name() -> None:
    for text, (column, message) in MISNAMED_TYPES.items():
        with pytest.raises(SyntaxFault) as error:
            read(text)
        assert (text, error.value.message) == (text, message)
        assert (text, place_of(error.value).column) == (text, column)


def test_named_slots_without_types_are_refused() -> None:
    with pytest.raises(SyntaxFault, match="slots by name are not available here"):
        read(f"{POINT}{{x: 1}}", operators=Operators.prolog())
    with pytest.raises(SyntaxFault):  # nor in event texts of other nodes
        read_term(f"{POINT}{{x: 1}}", OPERATORS, flags=ReadFlags(event_text=True))


SHOWN_TEXTS = (
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


def test_term_is_shown_with_its_named_slots() -> None:
    for text in SHOWN_TEXTS:
        required(OPERATORS.message_types).notations.clear()
        read_result = read_term(text, OPERATORS)
        shown = PROGRAM.show(read_result.term, names={var: name for name, var in read_result.names.items()})
        assert shown == text
        assert term_key(read(shown)) == term_key(read_result.term)


def test_head_is_shown_as_constructed_message() -> None:
    # Messages are shown with the slots that a program has written, so this program is new.
    program = PrologSystem()
    program.operators.message_types = slot_names()
    rule = read(f"{POINT}{{x: 1}} <- {POINT}{{y: 1}}", operators=program.operators)
    assert program.show(rule[1], is_constructed=True) == f"{POINT}{{x: 1}}"
    assert program.show(rule[1]) == f"{POINT}(1.0,0.0)"  # as a pattern it would match more
    assert program.show(rule) == f"{POINT}{{x: 1}}<-{POINT}{{y: 1}}"


values = st.sampled_from(["X", "Y", "1", "2.5", "'\"t\"'", "[A,B]"])
points = st.dictionaries(st.sampled_from(["x", "y"]), values, max_size=2)


@st.composite
def messages(draw: Any) -> Tuple[Any, ...]:
    """Return a message with some named slots, and the same message with positional slots."""
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
def test_shown_messages_are_read_as_same_term(drawn_messages: List[Any], frame: Any) -> None:
    text = frame.format(*(named for named, _ in drawn_messages))
    term = read_term(text, OPERATORS)
    positional = read(frame.format(*(plain for _, plain in drawn_messages)))
    assert term_key(term.term) == term_key(positional)
    for names in ({}, {var: name for name, var in term.names.items()}):
        read_again = read(PROGRAM.show(term.term, names=names))
        assert term_key(read_again) == term_key(positional)


def test_misspelt_type_is_reported_with_similar_name() -> None:
    with pytest.raises(UsageError) as error:
        SlotNames(Definitions()).find("std_msgs__0__Strng")
    assert str(error.value) == "there is no message type std_msgs/Strng; did you mean std_msgs/String?"
