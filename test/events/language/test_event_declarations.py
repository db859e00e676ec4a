"""Declarations of events: parsing, output, and violations."""

from typing import Any, List

import pytest
from asserting_accessors import compound
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import Operators, RuleError, UsageError, atom, functor
from retalis.events.language.event_declarations import (
    VALUE_TYPES,
    Argument,
    Declaration,
    Declarations,
    parse_declarations,
    parse_value_type,
)
from retalis.events.program.event_file_parser import EventFileParser
from retalis.prolog.syntax.term_reader import ReadTerm, read_program, read_term
from retalis.prolog.syntax.term_writer import writeq

OPERATORS = Operators.prolog()
NAMES = st.sampled_from(["left", "motor", "T one", "a:b", "don't", "list"])
TYPE_TERMS = st.recursive(
    st.sampled_from(
        [*(value_type.term for value_type in VALUE_TYPES.values()), read_term("a__0__B", OPERATORS).term]
    ),
    lambda inner: inner.map(lambda item: (functor("list", 1), item)),
    max_leaves=3,
)
DECLARATION = st.builds(
    lambda name, arguments: Declaration(
        name, tuple(Argument(argument, parse_value_type(term)) for argument, term in arguments.items())
    ),
    NAMES,
    st.dictionaries(NAMES, TYPE_TERMS, max_size=4),
)
VALUES = {
    "any": ["f(X)", "7", "[]"],
    "atom": ["left", "'two words'"],
    "number": ["7", "-2.5"],
    "integer": ["7"],
    "float": ["7.0"],
    "string": ['"left"', "'\"left\"'"],
    "list": ["[]", "[a|Rest]"],
    "time": ["1.5", "[1,2]", "datime(2026,1,2,3,4,5,6)"],
    "event": ["away", "seen(1)"],
    "a__0__B": ["a__0__B(1, 2)"],
}


def no_position(part: Any, number: int = 0) -> Any:
    return None


def declarations_of(text: str) -> List[Any]:
    goal = compound(read_term(f":- event {text}.", OPERATORS).term)[1]
    return [declaration for declaration, _ in parse_declarations(goal, no_position)]


@settings(max_examples=50)
@given(st.lists(DECLARATION, min_size=1, max_size=3))
def test_written_declaration_is_parsed_again(declarations: List[Any]) -> None:
    text = ", ".join(writeq(declaration.term, OPERATORS) for declaration in declarations)
    assert [declaration.term for declaration in declarations_of(text)] == [
        declaration.term for declaration in declarations
    ]


@settings(max_examples=25)
@given(
    st.data(), st.lists(DECLARATION, min_size=1, max_size=3, unique_by=lambda declaration: declaration.name)
)
def test_rules_that_follow_declarations_have_no_errors(data: st.DataObject, declarations: List[Any]) -> None:
    """Arguments are values of the declared types, or variables with one name for each type."""

    def value(value_type: Any) -> str:
        if value_type.items is not None:
            return f"[{value(value_type.items)}]"
        name = writeq(value_type.term, OPERATORS)
        return data.draw(st.sampled_from([*VALUES[name], f"V_{name}", "_"]))

    def event() -> str:
        declaration = data.draw(st.sampled_from(declarations))
        arguments = ", ".join(value(argument.value_type) for argument in declaration.arguments)
        name = writeq(atom(declaration.name), OPERATORS)
        return f"{name}({arguments})" if arguments else name

    declaration_text = ", ".join(writeq(declaration.term, OPERATORS) for declaration in declarations)
    rules = f":- event {declaration_text}.\n" + "".join(
        f"made <- {event()} and ({event()} or {event()}) and {event()}.\n" for _ in range(2)
    )
    parser = EventFileParser(declarations=Declarations(str))
    for clause in read_program(rules, OPERATORS):
        assert isinstance(clause, ReadTerm), clause
        parser.parse_read_term(clause)
    assert list(parser.errors) == []
    assert len(parser.rules) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t(a)", "an argument is declared by its name and type, as in temperature(motor:atom, value:number)"),
        (
            "t(X:atom)",
            "an argument is declared by its name and type, as in temperature(motor:atom, value:number)",
        ),
        ("t(a:atom, a:number)", "two arguments of t are called a"),
        ("t(a:nubmer)", "there is no type nubmer; did you mean number?"),
        (
            "t, 3",
            "a declaration names an event and its arguments, as in temperature(motor:atom, value:number)",
        ),
        ("rev(a:event)", "rev has a fixed meaning in rules: choose another name for the event"),
        (
            "std_msgs__0__Bool(data:atom)",
            "std_msgs__0__Bool needs no declaration: the slots of its messages and their types are known",
        ),
    ],
)
def test_invalid_declaration_is_refused(text: str, message: str) -> None:
    with pytest.raises(RuleError) as caught:
        declarations_of(text)
    assert caught.value.message == message


def test_second_declaration_of_name_is_refused() -> None:
    declarations = Declarations(str)
    (first,), (second,) = declarations_of("t(a:atom)"), declarations_of("t(a:number)")
    declarations.add(first)
    declarations.add(*declarations_of("t(a:atom)"))
    with pytest.raises(UsageError, match="t is declared already"):
        declarations.add(second)
    assert declarations.get("t") == first


@pytest.mark.parametrize("strict", [False, True])
def test_undeclared_event_is_error_in_strict_mode(strict: bool) -> None:
    declarations = Declarations(
        str, declarations_of("temperature(a:atom)"), strict, lambda key: key.name == "known"
    )
    message = [
        declarations.functor_error(functor(*key)) for key in (("known", 3), ("temprature", 1), ("other", 2))
    ]
    errors = [
        "",
        "temprature/1 is not declared; did you mean temperature(a:atom)?",
        "other/2 is not declared; write :- event other(name:type, name:type).",
    ]
    assert [
        text.replace(str(declarations_of("temperature(a:atom)")[0].term), "temperature(a:atom)")
        for text in message
    ] == (errors if strict else [""] * 3)


def test_received_event_is_checked() -> None:
    declarations = Declarations(
        lambda term: writeq(term, OPERATORS), declarations_of("t(a:atom, b:list(event))")
    )
    events = {"t(x, [])": "", "u(1)": "", "t(X, [u(1), t(x, [])])": ""}
    form = "t(a:atom,b:list(event))"
    events["t(x)"] = f"t/1 does not match its declaration: {form} has 2 arguments"
    events["t(1, [])"] = f"a of t/2 is an atom, found 1; declared as {form}"
    events["t(x, [2])"] = f"an item of b of t/2 is an event, found 2; declared as {form}"
    events["t(x, [t(1, [])])"] = f"a of t/2 is an atom, found 1; declared as {form}"
    events["rev(t(1, []))"] = f"a of t/2 is an atom, found 1; declared as {form}"
    assert {text: declarations.refusal(read_term(text, OPERATORS).term) for text in events} == events
