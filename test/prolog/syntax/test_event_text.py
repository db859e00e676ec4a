"""Event text, read by skeletons, compared with the general reader."""

import re
from typing import Any, List

import pytest
from asserting_accessors import compound, items
from hypothesis import example, given, settings
from hypothesis import strategies as st
from reachable_objects import count_entries, reachable
from sample_terms import shape, terms

from retalis import Operators, SyntaxFault, Var, atom
from retalis.foundation.bounded_caches import Cache
from retalis.prolog.syntax.event_text import EventReader, to_text
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.syntax.tokenizer import ReadFlags
from retalis.prolog.terms.types import FALSE, TRUE

OPERATORS = Operators.prolog()
TF = (
    "event(tf__0__tfMessage([geometry_msgs__0__TransformStamped(std_msgs__0__Header(1,[1413748205,981209993],"
    "'\"/odom\"'),'\"/base_link\"',geometry_msgs__0__Transform(geometry_msgs__0__Vector3(0.1,0.2,0.3),"
    "geometry_msgs__0__Quaternion(0.0,0.0,0.0,1.0)))]),[datime(2014,10,19,19,50,5,981209993),"
    "datime(2014,10,19,19,50,5,981209993)])"
)


def read_completely(text: Any) -> Any:
    return read_term(text, OPERATORS, flags=ReadFlags(event_text=True)).term


def outcome(read: Any, text: Any) -> Any:
    try:
        return shape(read(text))
    except SyntaxFault as fault:
        return fault.message


def check(text: str, reader: Any = None) -> None:
    reader = reader or EventReader()
    expected = outcome(read_completely, text)
    assert outcome(reader.read, text) == expected
    assert outcome(reader.read, text) == expected


def test_repeated_tf_event_adds_no_cache_entry() -> None:
    reader = EventReader()
    assert to_text(reader.read(TF)) == TF
    assert to_text(reader.read(TF)) == TF
    known = count_entries(reader) + 1  # the entry for other frame names
    other = TF.replace("0.1", "-7").replace("/odom", "/map")
    assert to_text(reader.read(other)) == other
    assert count_entries(reader) == known


@pytest.mark.parametrize(
    "text",
    [
        "e('\"4x4_1\"')",
        'e("4x4_1")',
        'e("it\'s","it\'s")',
        "e('it''s')",
        "e('')",
        'e("")',
        'e("a""b",1)',
        "e('a\\nb','\\x41\\')",
        "e(-1,-2.5,nan,inf,-inf,-nan,1.0e10,1e10,007,1.0e999,0x1F,0'a,1.0Inf)",
        "e([inf,-nan,-inf],nan(1),nan)",
        "e('nan','inf')",
        "e(1 - 1, -1, - 1, a-1, 1-1)",
        "e( 1 , -2 ,[ 3, 4 ])",
        "e('-' - 1)",
        "e('-',1)",
        "e('dynamic' = 1)",
        "e(X,Y,X,_)",
        "e(1)",
        "e(1).",
        "e(1)\n",
        "e(1,\n'a')",
        "'Foo'(1,2)",
        "e('\n')",
        "e(\0)",
        "e(\0,5)",
        "e(1,\0)",
        "e(5,/*'*/b,/*'*/c)",
        "e(0'a,0'b)",
        "e(1) % it's '",
        "'a'",
        '"a"',
        "5",
        "-5",
        "[1|2]",
        "[1,2|X]",
        "e(1,2",
        "e('a)",
        'e("a)',
        "",
        " ",
        "e(99999999999999999999999999)",
        "x <- a('b') * c(1)",
        "f('do',1)",
        "(a,'do'(1),2 * 3)",
        "e(10000000000000000000000000000000000000000)",
        "e(1.5.3)",
        "e(`12`)",
    ],
)
def test_text_is_read_as_by_full_reader(text: str) -> None:
    check(text)


KNOWN = "event(e(0,[1,2],'a',b('b'),0.5,[]))"


@pytest.mark.parametrize(
    "text",
    [
        "event(e(7,[-8,9],'x',b('\"y\"'),-1.5,[]))",
        "event(e(0.5,[1.5,2],'a',b('b'),7,[]))",
        "event(e(1.0e-07,[1.5e16,2.0e+16],'a',b('b'),1.5e-307,[]))",
        "event(e(1e5,[1,2],'a',b('b'),0.5,[]))",
        "event(e(1.5e300,[1,2],'a',b('b'),0.5,[]))",
        "event(e(1.5e-1000,[1,2],'a',b('b'),0.5,[]))",
        "event(e(1.5e5,[1e5,2],'a',b('b'),0.5,[]))",
        "event(e(1.5E5,[1,2],'a',b('b'),0.5,[]))",
        "event(e(007,[1,2],'a',b('b'),0.5,[]))",
        "event(e(nan,[1,2],'a',b('b'),-inf,[]))",
        "event(e(0,[-0,-0.0],'a',b('b'),-0,[]))",
        "event(e(0,1,[2],'a',b('b'),0.5,[]))",
        "event(e(0,[1],'a',b('b'),0.5,[]))",
        "event(e(0,[1,2,3],'a',b('b'),0.5,[]))",
        "event(e(0,[1,e],'a',b('b'),0.5,[]))",
        "event(e(0,[1,-],'a',b('b'),0.5,[]))",
        "event(e(0,[1,2],'it''s',b('b'),0.5,[]))",
        "event(e(0,[1,2],'a\\n',b('b'),0.5,[]))",
        "event(e(0,[1,2],'',b(''),0.5,[]))",
        "event(e(0,[1,2],\"a\",b('b'),0.5,[]))",
        "event(e(0,[1,2],'a',b('\0'),0.5,[]))",
        "event(e(0,[1,2],'a',b('b'),0.5,[])",
        "event(e(0,[1,2],'a',b('b'),0.5,[])).",
        f"event(e({'1' * 400},[1,{'2' * 400}.5],'a',b('b'),0.5,[]))",
        f"event(e({'1' * 5000},[1,2],'a',b('b'),0.5,[]))",
    ],
)
def test_text_of_known_shape_is_read_as_by_full_reader(text: str) -> None:
    reader = EventReader()
    for _ in range(3):
        reader.read(KNOWN)
    check(text, reader)
    check(KNOWN, reader)


def test_number_of_numbers_does_not_change_terms() -> None:
    reader = EventReader()
    for text in (
        f"event(e([{','.join(['1.5'] * 36)}],'a'))",
        f"event(e([{','.join(['1.5e-5'] * 35)},{'9' * 400}.5],'a'))",
        "event(e('a',e,1,e,2))",
        "event(e)",
        "event(e('a'))",
        "event(5)",
        f"event(e({','.join(str(number) for number in range(250))}))",
    ):
        for _ in range(2):
            check(text, reader)


def test_alternating_shapes_are_read_as_by_full_reader() -> None:
    reader = EventReader()
    for text in [KNOWN, KNOWN, KNOWN.replace("0.5", "a"), KNOWN.replace("[]", "[1]"), KNOWN] * 3:
        check(text, reader)
        assert reader.ground is True


def test_similar_shapes_are_distinguished() -> None:
    reader = EventReader()
    items = [
        "1",
        "-1",
        "1.5",
        "'a'",
        '"a"',
        "a",
        "nan",
        "X",
        "'1'",
        '"1"',
        "'\"1\"'",
        "'\"'",
        "[]",
        "''",
        "-a",
    ]
    for _ in range(2):
        for left in items:
            for right in items:
                check(f"e({left},{right})", reader)
                check(f"e([{left}|{right}])", reader)
                check(f"e({left} , {right})", reader)
                check(f"e({left}={right})", reader)
                check(f"e({left} - {right})", reader)
                check(f"event(e({left},[{right}]))", reader)


def test_special_floats_differ_from_quoted_atoms() -> None:
    read = EventReader().read
    assert read("nan") != read("nan")
    assert read("-inf") == float("-inf")
    assert read("'nan'") is atom("nan")
    assert read('"4x4_1"') is read("'\"4x4_1\"'") is atom('"4x4_1"')


@pytest.mark.parametrize("size", [1, 17, 250, 1000])
def test_long_arrays_are_read(size: int) -> None:
    reader = EventReader()
    for start in (0, 5):
        text = f"scan([{','.join(str(number / 2) for number in range(start, start + size))}],x,7)"
        check(text, reader)
        assert len(items(compound(reader.read(text))[1])) == size
    text = f"path([{','.join(f'p({number},a)' for number in range(size))}])"
    check(text, reader)
    check(f"[{','.join(['1'] * size)}|2]", reader)
    check(f"e(a,{','.join(['1'] * size)},[{','.join(['b', '1'] * size)}])", reader)


def test_number_of_cached_shapes_is_bounded() -> None:
    reader = EventReader()
    for number in range(600):
        reader.read(f"e{number}(1)")
    assert 0 < max(map(len, reachable(reader, Cache))) <= 512


@pytest.mark.slow
def test_deep_term_is_read() -> None:
    text = "f(" * 50_000 + "1" + ")" * 50_000
    reader = EventReader()
    assert to_text(reader.read(text)) == text


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(st.lists(terms, min_size=1, max_size=3))
def test_written_terms_are_read_as_by_full_reader(written: List[Any]) -> None:
    reader = EventReader()
    for term in written * 2:
        check(to_text(term), reader)
        check(write_term(term, OPERATORS), reader)
        check(write_term(term, OPERATORS, spacing=True), reader)


PIECES = st.sampled_from(
    [
        "f(",
        "g(",
        "(",
        "[",
        ")",
        "]",
        ",",
        "|",
        " ",
        "a",
        "X",
        "'",
        '"',
        "'b'",
        '"c"',
        "1",
        "-1",
        "2.5",
        "-",
        ".",
        "nan",
    ]
    + [
        "inf",
        "-inf",
        "\\",
        "''",
        '""',
        "0'",
        "\n",
        "%",
        "/*",
        "*/",
        "e5",
        "_",
        "\0",
        "{",
        "}",
        "dynamic",
        "'-'",
        " - ",
    ]
)


SHARED = EventReader()


@pytest.mark.slow
@settings(max_examples=1000, deadline=None)
@given(st.lists(PIECES, max_size=12).map("".join))
@example("f('\0')")
def test_any_text_is_read_as_by_full_reader(text: Any) -> None:
    reader = SHARED  # shapes of earlier texts must not change the result
    for variant in (
        text,
        f"e({text})",
        f"event(e({text}))",
        re.sub(r"\d", "7", text),
        f"e({text},'x')",
        text,
    ):
        check(variant, reader)


def test_capitalized_booleans_are_read() -> None:
    for _ in range(2):  # by the full reader, then by its shape
        term = compound(EventReader().read("event(p(True,False,Truth))"))
        assert term[1][1:3] == (TRUE, FALSE)
        assert term[1][3].__class__ is Var


def test_reader_reports_whether_term_is_ground() -> None:
    reader = EventReader()
    states: List[Any] = []
    for text in ("e(1,'a')", "e(2,'b')", "e(X,[1])", "e(Y,[2])", "e(1 + 2)", "e(1"):
        try:
            reader.read(text)
        except SyntaxFault:
            pass
        states.append(reader.ground)
    assert states == [True, True, False, False, True, None]
