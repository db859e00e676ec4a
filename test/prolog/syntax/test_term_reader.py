"""Reading of terms: operators, flags, and variables, as in SWI-Prolog 9 where ISO leaves it open."""

from typing import Any

import pytest
from asserting_accessors import compound

from retalis import Operators, SyntaxFault
from retalis.prolog.syntax.event_text import to_text
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.syntax.tokenizer import ReadFlags

OPERATORS = Operators.prolog()


def read(text: str, **flags: Any) -> Any:
    return read_term(text, OPERATORS, flags=ReadFlags(**flags)).term


def test_nan_and_inf_are_numbers_in_event_text_only() -> None:
    text = "e(nan,inf,-inf,'nan',nan(1),a-inf)"
    assert to_text(read(text, event_text=True)) == "e(nan,inf,-inf,'nan',nan(1),-(a,inf))"
    assert to_text(read(text)) == "e('nan','inf',-('inf'),'nan',nan(1),-(a,'inf'))"


TERMS = {
    "- 1": "-(1)",
    "-1": "-1",
    "-(1)": "-(1)",
    "- (a,b)": "-(','(a,b))",
    "-(a,b)": "-(a,b)",
    "1 - -1": "-(1,-1)",
    "a- (-1)": "-(a,-1)",
    "3 -(1)": "-(3,1)",
    "-1^2": "^(-1,2)",
    "- 1^2": "-(^(1,2))",
    "-a^2": "-(^(a,2))",
    "f(- , a)": "f(-,a)",
    "[-]": "[-]",
    "[:-|:-]": "[:-|:-]",
    "- = x": "=(-,x)",
    "- - -": "-(-(-))",
    "\\+ (a,b)": "\\+(','(a,b))",
    "a:b:c": ":(a,:(b,c))",
    "a:b/c": ":(a,/(b,c))",
    "f(a:-b)": "f(:-(a,b))",
    "f(a|b)": "f('|'(a,b))",
    "(a|b)": "'|'(a,b)",
    "{a,b}": "{','(a,b)}",
    "'{}'(x)": "{x}",
    "[a,b|c]": "[a,b|c]",
    "p:-q,!;r": ":-(p,;(','(q,!),r))",
    ":- dynamic a/1,b/2": ":-(dynamic(','(/(a,1),/(b,2))))",
    "dynamic - 1": "dynamic(-(1))",
    "is is is": "is(is,is)",
    "* = *": "=(*,*)",
    "a 'mod' b": "mod(a,b)",
    "[](x)": "[](x)",
}


@pytest.mark.parametrize("text", TERMS)
def test_operators_are_read_as_canonical_term(text: str) -> None:
    assert write_term(read(text), ignore_ops=True) == TERMS[text]


@pytest.mark.parametrize("text", ["f(a:-b)", "[a:-b]", "- = x", "X = -", "1e10", "a:b"])
def test_iso_flag_refuses_extensions(text: str) -> None:
    with pytest.raises(SyntaxFault):
        read_term(text, Operators.iso(), flags=ReadFlags(iso=True))


@pytest.mark.parametrize("text", ["f(:-)", "[-]", "- (-)", "f((a:-b))", "-(1)", "[(:-)|a]", "\\+ (a,b)"])
def test_iso_flag_changes_no_standard_term(text: str) -> None:
    term = read_term(text, Operators.iso(), flags=ReadFlags(iso=True)).term
    assert write_term(term, ignore_ops=True) == write_term(read(text), ignore_ops=True)


def test_variables_are_named_and_singletons_listed() -> None:
    read = read_term("f(A,B,_C,_,A,_)", OPERATORS)
    assert list(read.names) == ["A", "B", "_C"]
    assert read.singletons == ["B"]
    assert compound(read.term)[1] is compound(read.term)[5] is read.names["A"]
    assert compound(read.term)[4] is not compound(read.term)[6]
