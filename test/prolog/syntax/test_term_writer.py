"""Written terms: ISO 13211-1, and SWI-Prolog 9 where the standard leaves it open."""

import math

import pytest

from retalis import Operators, String, Term, Var, atom, functor, make_list
from retalis.prolog.syntax.event_text import to_text
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import write_term, writeq
from retalis.prolog.terms.types import CONS, NIL, Lazy, serial

OPERATORS = Operators.prolog()
for _entry in (
    (200, "xf", "post"),
    (200, "yf", "yp"),
    (500, "fy", "~~"),
    (500, "xfy", "xy"),
    (9, "fx", "##"),
):
    OPERATORS.add(*_entry)

WRITTEN = {
    "-(1)": "- 1",
    "-(-(1))": "- - 1",
    "-(-1)": "- -1",
    "-(1.0)": "- 1.0",
    "-(a)": "-a",
    "-(-(a))": "- -a",
    "-(-)": "- (-)",
    "-[-]": "-[-]",
    "-p(c)": "-p(c)",
    "-{a}": "-{a}",
    "-(1^2)": "- 1^2",
    "-(a^2)": "-a^2",
    "-((a,b))": "- (a,b)",
    "-(1*2)": "- (1*2)",
    "-(1)^2": "(- 1)^2",
    "(-1)^2": "-1^2",
    "1-(-1)": "1- -1",
    "1-(2-3)": "1-(2-3)",
    "1-2-3": "1-2-3",
    "2*(-3)": "2* -3",
    "a:(-1)": "a: -1",
    "1 rem -1": "1 rem -1",
    "x is -y": "x is -y",
    "\\+ (a,b)": "\\+ (a,b)",
    "\\+a": "\\+a",
    "\\+ \\+a": "\\+ \\+a",
    "a= (\\+)": "a=(\\+)",
    "- = -": "(-)=(-)",
    "[-]": "[-]",
    "[(:-)]": "[:-]",
    "f(:-,a)": "f(:-,a)",
    "[(:-)|(:-)]": "[:-|:-]",
    "(a:-b)": "a:-b",
    "[(a:-b)]": "[(a:-b)]",
    "f((a:-b),(c,d))": "f((a:-b),(c,d))",
    "(a:-b,c;d->e)": "a:-b,c;d->e",
    "((a,b),c)": "(a,b),c",
    "(a:b):c": "(a:b):c",
    "[a|b]": "[a|b]",
    "'\\n'": "'\\n'",
    "{a}": "{a}",
    "{-}": "{-}",
    "','": "','",
    "','-'|'": "(',')-('|')",
    "','(a)": "','(a)",
    "a|b": "a|b",
    "'it''s'": "'it\\'s'",
    "'A b'": "'A b'",
    "[]": "[]",
    "'\\x200b\\'": "'\\x200B\\'",
    "'/*'": "'/*'",
    "'.'": "'.'",
    "'a.b'": "'a.b'",
    "\u65e5\u672c": "\u65e5\u672c",
    "'\u00c9'": "'\u00c9'",
    '"a\\nb\\"c"': '"a\\nb\\"c"',
    "'$VAR'(27)": "B1",
    "'$VAR'(-3)": "'$VAR'(-3)",
    "a post": "a post",
    "(a post)post": "(a post)post",
    "a yp yp": "a yp yp",
    "-(yp(a))": "- (a yp)",
    "~~(a-b)": "~~ (a-b)",
    "(~~a)-b": "~~a-b",
    "a xy (b-c)": "a xy (b-c)",
    "(a xy b)-c": "a xy b-c",
    "1 - ##(1)": "1- ##1",
    "dynamic(-1)": "dynamic -1",
    "mod(mod,mod)": "(mod)mod(mod)",
    "a <- b * c where d": "a<-b seq c where d",
    "1.0e22": "1.0e+22",
    "1e15": "1.0e+15",
    "123456789012345.0": "123456789012345.0",
    "1234567890123456.0": "1.234567890123456e+15",
    "0.00001": "1.0e-5",
    "0.1": "0.1",
    "-0.0": "-0.0",
    "1.0Inf": "1.0Inf",
    "1.5NaN": "1.5NaN",
}


@pytest.mark.parametrize("text", WRITTEN)
def test_writeq_quotes_and_spaces_terms(text: str) -> None:
    assert writeq(read_term(text, OPERATORS).term, OPERATORS) == WRITTEN[text]


def test_write_options_change_text() -> None:
    term = read_term("f('A b',\"s\",x+1,[1,2],{y,z},- 1)", OPERATORS).term
    assert write_term(term, quoted=False) == "f(A b,s,x+1,[1,2],{y,z},- 1)"
    assert write_term(term, ignore_ops=True) == "f('A b',\"s\",+(x,1),[1,2],{','(y,z)},-(1))"
    assert write_term(term, ignore_ops=True, brace_terms=False).endswith("[1,2],{}(','(y,z)),-(1))")
    assert write_term(term, spacing=True) == "f('A b', \"s\", x+1, [1, 2], {y, z}, - 1)"
    assert write_term(read_term("a:-b", OPERATORS).term, priority=999) == "(a:-b)"
    rule = read_term("c(X) :- a(X), X > 1, b = c->true;f(- - 1)", OPERATORS)
    assert (
        write_term(rule.term, wide=True, variable_names={rule.names["X"]: "X"})
        == "c(X) :- a(X),X > 1,b = c -> true ; f(- - 1)"
    )


def test_variables_are_named_or_numbered() -> None:
    first, second = Var(), Var()
    second.ref = atom("b")
    term = (functor("f", 3), first, second, first)
    assert writeq(term) == to_text(term) == f"f(_G{serial(first)},b,_G{serial(first)})"
    assert write_term(term, variable_names={first: "X"}) == "f(X,b,X)"


def test_lazy_terms_are_decoded() -> None:
    lazy = Lazy(functor("g", 1), lambda source: (functor("g", 1), source), 7)
    term = (functor("f", 2), lazy, (CONS, lazy, Lazy(CONS, lambda source: (CONS, source, NIL), 8)))
    assert to_text(term) == writeq(term) == "f(g(7),[g(7),8])"


def test_event_text_has_no_operators() -> None:
    items = make_list([1, -2.5, math.inf, -math.inf, math.nan, 1e22, atom("nan"), String("s")])
    term = (functor("e", 2), items, atom('"/odom"'))
    assert to_text(term) == "e([1,-2.5,inf,-inf,nan,1.0e+22,'nan',\"s\"],'\"/odom\"')"
    assert to_text((functor("-", 2), 1, -1)) == "-(1,-1)"


@pytest.mark.slow
def test_long_and_deep_terms_are_written() -> None:
    items = make_list(range(300_000))
    assert writeq(items).endswith(",299999]")
    assert to_text(items) == writeq(items)
    deep: Term = atom("a")
    for _ in range(100_000):
        deep = (functor("-", 1), deep)
    assert writeq(deep) == "- " * 99_999 + "-a"
