"""Declarations of events: parsing, output, and violations."""

import pytest
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
from retalis.events.program.event_file_checker import FileChecker
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import writeq

OPERATORS = Operators.prolog()
NAMES = st.sampled_from(["left", "motor", "T one", "a:b", "don't", "list"])
KIND = st.recursive(
    st.sampled_from([*(kind.term for kind in VALUE_TYPES.values()), read_term("a__0__B", OPERATORS).term]),
    lambda inner: inner.map(lambda kind: (functor("list", 1), kind)),
    max_leaves=3,
)
DECLARATION = st.builds(
    lambda name, found: Declaration(
        name, tuple(Argument(one, parse_value_type(kind)) for one, kind in found.items())
    ),
    NAMES,
    st.dictionaries(NAMES, KIND, max_size=4),
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


def places(part, number=0):
    return None


def read(text):
    goal = read_term(f":- event {text}.", OPERATORS).term[1]
    return [one for one, _ in parse_declarations(goal, places)]


@settings(max_examples=50)
@given(st.lists(DECLARATION, min_size=1, max_size=3))
def test_what_is_written_is_read_again(found):
    text = ", ".join(writeq(one.term, OPERATORS) for one in found)
    assert [one.term for one in read(text)] == [one.term for one in found]


@settings(max_examples=25)
@given(st.data(), st.lists(DECLARATION, min_size=1, max_size=3, unique_by=lambda one: one.name))
def test_rules_that_keep_to_their_declarations_have_no_errors(data, found):
    """Values of the kinds, or a variable for each argument: of one name and kind wherever that stands."""

    def value(kind):
        if kind.items is not None:
            return f"[{value(kind.items)}]"
        name = writeq(kind.term, OPERATORS)
        return data.draw(st.sampled_from([*VALUES[name], f"V_{name}", "_"]))

    def event():
        one = data.draw(st.sampled_from(found))
        arguments = ", ".join(value(argument.value_type) for argument in one.arguments)
        name = writeq(atom(one.name), OPERATORS)
        return f"{name}({arguments})" if arguments else name

    declared = ", ".join(writeq(one.term, OPERATORS) for one in found)
    rules = f":- event {declared}.\n" + "".join(
        f"made <- {event()} and ({event()} or {event()}) and {event()}.\n" for _ in range(2)
    )
    checker = FileChecker(declarations=Declarations(str))
    for clause in read_program(rules, OPERATORS):
        checker.check_read_term(clause)
    assert list(checker.errors) == [] and len(checker.rules) == 2


@pytest.mark.parametrize(
    "text, said",
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
def test_what_is_no_declaration(text, said):
    with pytest.raises(RuleError) as caught:
        read(text)
    assert caught.value.message == said


def test_a_name_is_declared_once():
    declared = Declarations(str)
    (one,), (other,) = read("t(a:atom)"), read("t(a:number)")
    assert declared.add(one) and not declared.add(*read("t(a:atom)"))
    with pytest.raises(UsageError, match="t is declared already"):
        declared.add(other)


@pytest.mark.parametrize("strict", [False, True])
def test_only_where_all_have_to_be_declared_is_an_unknown_event_wrong(strict):
    declared = Declarations(str, read("temperature(a:atom)"), strict, lambda key: key.name == "known")
    said = [declared.functor_error(functor(*key)) for key in (("known", 3), ("temprature", 1), ("other", 2))]
    wrong = [
        "",
        "temprature/1 is not declared; did you mean temperature(a:atom)?",
        "other/2 is not declared; write :- event other(name:type, name:type).",
    ]
    assert [
        text.replace(str(read("temperature(a:atom)")[0].term), "temperature(a:atom)") for text in said
    ] == (wrong if strict else [""] * 3)


def test_an_event_that_has_come():
    declared = Declarations(lambda term: writeq(term, OPERATORS), read("t(a:atom, b:list(event))"))
    events = {"t(x, [])": "", "u(1)": "", "t(X, [u(1), t(x, [])])": ""}
    form = "t(a:atom,b:list(event))"
    events["t(x)"] = f"t/1 does not match its declaration: {form} has 2 arguments"
    events["t(1, [])"] = f"a of t/2 is an atom, found 1; declared as {form}"
    events["t(x, [2])"] = f"an item of b of t/2 is an event, found 2; declared as {form}"
    events["t(x, [t(1, [])])"] = f"a of t/2 is an atom, found 1; declared as {form}"
    events["rev(t(1, []))"] = f"a of t/2 is an atom, found 1; declared as {form}"
    assert {text: declared.refusal(read_term(text, OPERATORS).term) for text in events} == events
