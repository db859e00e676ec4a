"""Syntax errors: messages and places."""

from typing import Any, List

import pytest
from asserting_accessors import compound, place_of, required
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import Operators, SyntaxFault
from retalis.prolog.syntax.term_reader import ReadTerm, read_program, read_term
from retalis.prolog.syntax.term_writer import writeq
from retalis.prolog.syntax.tokenizer import ReadFlags

OPERATORS = Operators.prolog()

# text, column of the caret, parts of the message
FAULTS = [
    ("// note\na <- b.", 4, ["a comment begins with %"]),
    ("# note\na <- b.", 3, ["a comment begins with %"]),
    ("my label : a <- b.", 4, ["a label is one name: write my_label"]),
    ("rule h : a <- b.", 6, ["a label is one name: write h"]),
    ("r : my own label : a <- b.", 8, ["a label is one name: write my_own_label"]),
    ("do print(x) <- a.", 4, ["without an event, write null do Goal <- Pattern"]),
    ("where T > 3, hot(M) <- temp(M, T).", 7, ["a rule begins with its head: Head <- Pattern where Goal"]),
    ("when temp(M, T) then hot(M).", 6, ["a rule begins with its head"]),
    ("hot(M) do <- temp(M).", 14, ['a term is missing between "do" and "<-"']),
    ("a <- b where do print(x).", 17, ['a term is missing between "where" and "do"']),
    ("a <- b xyz : c.", 8, ["is not an operator"]),
    ("a <- b || c.", 9, ['"or" in patterns']),
    ("a <- b where f(/warn/x, 1).", 17, ["is quoted: '/warn/x'"]),
    ("a <- b where f(rules.txt).", 21, ["is quoted: 'rules.txt'"]),
    ("a <- b(T) where 1 < T < 3.", 23, ["A < B, B < C"]),
    ("a <- b(N) where N += 1.", 19, ["New is N + 1"]),
    ("out <- a Seq b.", 10, ['before "Seq"', "write seq or 'Seq'"]),
    ("h :- a <- b.", 8, ['":-" and "<-"', "an event rule has <-"]),
    ("h <- a :- b.", 8, ['"<-" and ":-"']),
    ("f(a, [b.", 8, ['expected "]"', '"[" in line 1, column 6', "end of the clause"]),
    ("k(a)).", 5, ['")" does not close anything']),
    ("f({a).", 5, ['expected "}"', '"{" in line 1, column 3']),
    ("l(\u201cx\u201d).", 3, ["typographic quote", 'write "']),
    ("l(\u2018x\u2019).", 3, ["typographic quote", "write '"]),
    ("m('it's).", 7, ["is doubled"]),
    ("n('abc).", 3, ["not closed on its line"]),
    ("n(a b).", 5, ['expected "," or ")"', "is a comma missing?"]),
    ("[1 2].", 4, ['expected ",", "|" or "]"', "1_000_000"]),
    ("o(,a).", 3, ["expected a term"]),
    ("p :- a, .", 9, ["comma", "before the end of the clause"]),
    ("am([a,b,]).", 9, ["comma before it superfluous"]),
    ("q (a).", 3, ["no space is allowed between q and its bracket"]),
    ("R(a).", 2, ["R is a variable", "lower-case letter"]),
    ("s :- a.b.", 7, ["full stop ends a clause only where"]),
    ("s(.5).", 4, ["digits on both sides"]),
    ("t :- X <= 3.", 8, ["=<"]),
    ("t :- X != 3.", 8, ["\\=="]),
    ("t :- a && b.", 8, ['joined with ","']),
    ("u :- not foo(X).", 10, ["\\+"]),
    ("w <- a sequ b.", 8, ['did you mean "seq"?']),
    ("w <- a b.", 8, ['"b" is not an operator', '"and", "seq"']),
    ("w <- a before b.", 8, ['write "seq"']),
    ("w :- a before b.", 8, ["is a comma missing?"]),
    ("x <- a seq .", 12, ['right argument of "seq"']),
    ("x <- a where X # Y.", 16, ['"#" is not an operator']),
    ("y = a = b.", 7, ["cannot be chained"]),
    ("z :- X = \\+ a.", 10, ["expected brackets", "(900 fy)", '"="']),
    ("af([a|b,c]).", 8, ['expected "]"']),
    ("ah(1a).", 4, ["is not a number"]),
    ("ai('ab\\qc').", 7, ["\\q is not an escape sequence"]),
    ("aj().", 1, ['expected "aj" alone']),
    ("aj(1.0e999).", 4, ["too large"]),
    ("aj(40'z).", 4, ["radix"]),
    ("a /* b", 3, ["never closed"]),
    ("a :- \u00a7.", 6, ["SECTION SIGN"]),
    (".", 1, ["expected a term"]),
    ("a. b.", 4, ["nothing after the full stop"]),
    ("", 1, ["expected a term"]),
    ("[a|b|c]", 5, ['one term after "|"']),
    ("f(a|)", 5, ['right argument of "|"']),
]


@pytest.mark.parametrize(("text", "column", "parts"), FAULTS)
def test_syntax_error_has_message_and_column(text: str, column: int, parts: List[str]) -> None:
    with pytest.raises(SyntaxFault) as error:
        read_term(text, OPERATORS, "rules.txt")
    fault = error.value
    assert (place_of(fault).source, place_of(fault).line, place_of(fault).column) == (
        "rules.txt",
        1,
        column,
    ), fault.message
    for part in parts:
        assert part in fault.message


PROGRAM = """\
ok(1).
foo(X) :- bar(X)
baz(Y) :- qux(Y).
g(a, b
h(X) <- p(X).
l('abc).
m(\u201cx\u201d) :- n.
k(a)).
q :- 'abc,
  r.
ok(2).
last(
"""


def test_errors_of_program_are_reported_together() -> None:
    read = list(read_program(PROGRAM, OPERATORS, "p"))
    terms = [writeq(entry.term).split("(")[0] for entry in read if isinstance(entry, ReadTerm)]
    faults = [place_of(entry).line for entry in read if isinstance(entry, SyntaxFault)]
    assert terms == ["ok", "baz", "h", "ok"]
    assert faults == [3, 5, 6, 7, 8, 9, 12]


def test_caret_is_below_error() -> None:
    fault = list(read_program("a.\n\tb :- c d.\n", OPERATORS, "p"))[1]
    assert str(fault).split("\n")[1:] == ["\tb :- c d.", "\t       ^"]


def test_missing_full_stop_of_last_clause_is_an_error() -> None:
    (fault,) = read_program("a :- b % c", OPERATORS)
    assert isinstance(fault, SyntaxFault)
    assert "expected a full stop" in fault.message
    assert required(fault.place).column == 7


def test_parts_of_term_have_places() -> None:
    read = read_term("out(X) <-\n  a(X) seq (b * c) where X > 1.", OPERATORS, "p")
    where = compound(read.term)[2]
    assert str(read.place) == "p:1:1"
    assert str(read.place_of(read.term)) == "p:1:8"
    assert str(read.place_of(where)) == "p:2:20"
    assert str(read.place_of(where[1])) == "p:2:8"
    assert str(read.place_at(2, 1, 2)) == "p:2:15"
    assert str(read.place_at(2, 1, 2, 1)) == "p:2:13"
    assert str(read.place_at(1, 1)) == "p:1:5"
    assert str(read.place_at(2, 2, 2)) == "p:2:30"
    assert str(read.place_at(9)) == "p:1:1"


PIECES = st.sampled_from(
    [
        "a",
        "X",
        "_",
        "1",
        "2.5",
        "'q'",
        '"s"',
        "`c`",
        "0'c",
        "(",
        ")",
        "[",
        "]",
        "{",
        "}",
        ",",
        "|",
        ".",
        ";",
        ":-",
        "<-",
        "-->",
        "do",
        "seq",
        "'Seq'",
        "where",
        "*",
        "#",
        "-",
        "+",
        "\\+",
        ":",
        "rule:",
        "=",
        "!",
        "f(",
        "-",
        "dynamic",
        "not",
        "star_times",
        "within",
        "/",
        "\\",
        "'",
        '"',
        "`",
        "%",
        "/*",
        "*/",
        "\n",
        ".\n",
        "1e",
        "0x",
        "1_",
        "'rule:'",
        "iff",
        "aggregate(",
        "“",
        "\x00",
        "\u2028",
        "\\x",
    ]
)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.lists(st.one_of(PIECES, st.just(" ")), max_size=25).map("".join) | st.text(max_size=30))
def test_any_text_is_read_or_is_a_syntax_error(text: Any) -> None:
    for entry in read_program(text, OPERATORS):
        assert isinstance(entry, (ReadTerm, SyntaxFault))
    for flags in (ReadFlags(), ReadFlags(iso=True), ReadFlags(event_text=True)):
        fault = None
        try:
            read_term(text, OPERATORS, flags=flags)
        except SyntaxFault as error:
            fault = error
        assert fault is None or (fault.message and fault.place is not None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("opening", "closing"), [("(", ")"), ("f(", ")"), ("[", "]"), ("{", "}"), ("- ", ""), ("[a|", "]")]
)
@pytest.mark.parametrize("rule", ["", "x <- "])
def test_deep_nesting_is_read_or_refused(opening: str, closing: str, rule: str) -> None:
    depth = 30_000
    read_term(rule + opening * depth + "b" + closing * depth, OPERATORS)
    with pytest.raises(SyntaxFault):
        read_term(rule + opening * depth + "(", OPERATORS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", ["'\\'", "' . ", '"\\\n', "0'", "1_ ", "'\\\n\\'", "(,", "a b\n", "/*", "\\"]
)
def test_long_repeated_text_is_read(text: str) -> None:
    for entry in read_program(text * 20_000, OPERATORS):
        assert isinstance(entry, (ReadTerm, SyntaxFault))
