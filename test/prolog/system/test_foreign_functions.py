"""Python functions as predicates."""

import itertools
import math
import re
import sys
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Tuple

import numpy
import pytest
from asserting_accessors import compound, lazy
from recording_reports import RecordingReports

from retalis import (
    Compound,
    Engine,
    Limits,
    ProgramErrors,
    PrologError,
    RetalisError,
    Settings,
    Term,
    UsageError,
    Var,
    atom,
    foreign,
    functor,
)
from retalis.prolog.syntax.term_writer import writeq
from retalis.prolog.system.value_conversion import to_term
from retalis.prolog.terms.array_terms import array_term


@foreign
def distance(x1: float, y1: float, x2: float, y2: float) -> float:
    return math.hypot(x1 - x2, y1 - y2)


@foreign
def upto(last: int) -> Iterator[int]:
    yield from range(1, last + 1)


@foreign
def is_even(number: int) -> bool:
    return number % 2 == 0


@foreign(name="parts", outputs=2)
def split(text: str) -> Any:
    return text.partition("-")[::2] if "-" in text else None


@foreign(outputs=2)
def steps(items: list) -> Iterator[Any]:
    yield from zip(items, items[1:])


@foreign
# Without an annotation, the argument is the term's Python value.
def swapped(term) -> Compound:  # type: ignore[no-untyped-def]  # noqa: ANN001
    return Compound(term.name, term.args[::-1])


@foreign
def kind(term: Term) -> str:
    return type(term).__name__


@foreign
def broken() -> int:
    raise ValueError("no luck")


@foreign
def broken_later() -> Iterator[int]:
    yield 1
    raise KeyError("x")


@foreign
def small(term: Any) -> bool:
    return len(writeq(term)) < 5


ALL = (distance, upto, is_even, split, steps, swapped, kind, broken, broken_later, small)


@pytest.fixture
def engine() -> Engine:
    empty_engine = Engine()
    empty_engine.add_foreign(*ALL)
    return empty_engine


def answers(engine: Engine, goal: str) -> List[Dict[Any, Any]]:
    return [
        {name: engine.show(value) for name, value in answer.items() if name[0] != "_"}
        for answer in engine.query(goal)
    ]


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("distance(0, 0, 3, 4.0, D)", [{"D": "5.0"}]),
        ("distance(0, 0, 3, 4, 6.0)", []),
        ("upto(3, X)", [{"X": "1"}, {"X": "2"}, {"X": "3"}]),
        ("upto(3, 2)", [{}]),
        ("upto(3, X), X > 1, !", [{"X": "2"}]),
        ("is_even(4)", [{}]),
        ("is_even(3)", []),
        ("small(f(a))", [{}]),
        ("small(f(abc))", []),
        ("parts('a-b', A, B)", [{"A": "a", "B": "b"}]),
        ('parts("a-b", A, B)', [{"A": "a", "B": "b"}]),
        ("parts(ab, A, B)", []),
        ("steps([1,2,3], A, B)", [{"A": "1", "B": "2"}, {"A": "2", "B": "3"}]),
        ('swapped(f(1,[a,"b"]), X)', [{"X": "f([a,b],1)"}]),
        ("kind(X, Y)", [{"X": "_", "Y": "'Var'"}]),
        ("findall(X, upto(2, X), L)", [{"X": "_", "L": "[1,2]"}]),
    ],
)
def test_foreign_function_returns_solutions(engine: Engine, goal: str, expected: Any) -> None:
    solutions = answers(engine, goal)
    assert [
        {name: "_" if value[:2] == "_G" else value for name, value in solution.items()}
        for solution in solutions
    ] == expected


@pytest.mark.parametrize(
    ("goal", "formal"),
    [
        ("distance(a, 0, 0, 0, D)", "type_error(number,a)"),
        ("distance(X, 0, 0, 0, D)", "instantiation_error"),
        ("upto(2.0, X)", "type_error(integer,2.0)"),
        ("steps(a, X, Y)", "type_error(list,a)"),
        ("broken(X)", "python_error('ValueError',\"no luck\")"),
        ("broken_later(X), fail", "python_error('KeyError',\"'x'\")"),
    ],
)
def test_wrong_arguments_and_exceptions_are_errors(engine: Engine, goal: str, formal: str) -> None:
    with pytest.raises(PrologError) as caught:
        engine.query(goal)
    assert writeq(compound(caught.value.term)[1]) == formal


def test_rule_calls_foreign_function() -> None:
    engine = Engine()
    engine.add_foreign(distance)
    engine.load("near(D) <- at(X, Y) where (distance(X, Y, 0, 0, D), D < 2).")
    events: List[str] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.event("at(3,4)", 1)
    engine.event("at(0,1)", 2)
    assert events == ["at(3,4)", "at(0,1)", "near(1.0)"]


def test_invalid_foreign_functions_are_refused() -> None:
    engine = Engine()
    with pytest.raises(UsageError, match="decorated"):
        engine.add_foreign(len)
    with pytest.raises(UsageError, match="args"):
        foreign(lambda *args: 1)
    with pytest.raises(PrologError, match="append/3|atom_length/2"):
        engine.add_foreign(foreign(name="atom_length")(lambda text: 1))
    engine.add_foreign(foreign(name="pair", outputs=2)(lambda: (1, 2, 3)))
    with pytest.raises(PrologError, match="2 values|3 values"):
        engine.query("pair(A, B)")


MODULE = """
from retalis import foreign

@foreign
def double(number: int) -> int:
    return 2 * number
"""


def test_use_foreign_loads_module_of_program(tmp_path: Path) -> None:
    (tmp_path / "helpers.py").write_text(MODULE)
    rules = ":- use_foreign(helpers).\nb(Y) <- a(X) where double(X, Y).\n"
    (tmp_path / "rules.txt").write_text(rules)
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\n")
    refused = Engine()
    with pytest.raises(ProgramErrors, match="load foreign_module .*: the setting allow_foreign is off"):
        refused.load_program(tmp_path)
    engine = Engine(settings=Settings(allow_foreign=True))
    engine.load_program(tmp_path)
    events: List[str] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.event("a(4)", 1)
    assert events == ["a(4)", "b(8)"]
    engine.load(goals=f"use_foreign('{tmp_path / 'helpers.py'}')")


@pytest.mark.parametrize("folders", [None, ()])
def test_use_foreign_at_run_time_is_refused(tmp_path: Path, folders: Optional[Tuple[Any, ...]]) -> None:
    (tmp_path / "helpers.py").write_text("import pathlib\npathlib.Path(__file__).with_name('ran').touch()\n")
    reports = RecordingReports()
    engine = Engine(
        settings=Settings(allow_foreign=True, folders=folders, write_folders=folders), reports=reports
    )
    engine.load(rules="loading(M) do use_foreign(M) <- load(M).", folder=tmp_path)
    for module in ("helpers", "'helpers.py'", f"'{tmp_path}/helpers.py'", "'os.path'"):
        for goal in (f"use_foreign({module})", f"compile_event_rules([(:- use_foreign({module}))])"):
            with pytest.raises(RetalisError, match="load foreign_module .* only by the program's own files"):
                engine.call(goal)
        engine.event(f"load({module})", 1)
        assert "load foreign_module" in reports.texts[-1]
    (tmp_path / "more.pl").write_text(":- use_foreign(helpers).\n")
    with pytest.raises(RetalisError, match="more.pl:1:4: .*load foreign_module"):
        engine.call(f"ensure_loaded('{tmp_path}/more.pl')")
    assert not (tmp_path / "ran").exists()


def test_use_foreign_imports_module_by_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "retalis_test_helpers.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    engine = Engine(settings=Settings(allow_foreign=True))
    engine.load(goals="use_foreign(retalis_test_helpers)")
    assert answers(engine, "double(2, X)") == [{"X": "4"}]
    sys.modules.pop("retalis_test_helpers")


@pytest.mark.parametrize("text", ["1 +", "import nothing_of_that_name", "raise RuntimeError('x')", "x = 1"])
def test_invalid_module_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "bad.py").write_text(text)
    engine = Engine(settings=Settings(allow_foreign=True))
    with pytest.raises(ProgramErrors, match="cannot load |has no function"):
        engine.load(goals=f"use_foreign('{tmp_path / 'bad.py'}')")


def test_result_of_other_type_is_an_error_of_goal() -> None:
    @foreign(outputs=2)
    def pair(number: int) -> int:
        return number

    @foreign
    def objects(number: int) -> Iterator[object]:
        yield object()

    engine = Engine()
    engine.add_foreign(pair, objects)
    for goal in ("pair(1, _, _)", "objects(1, _)"):
        with pytest.raises(RetalisError):
            engine.call(goal)
        assert engine.call(f"catch({goal}, _, true)")


def test_example_of_documentation_works(tmp_path: Path) -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "python-predicate.md"
    code = page.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    (tmp_path / "helpers.py").write_text(code)
    engine = Engine(settings=Settings(allow_foreign=True))
    engine.load_rules(":- use_foreign(helpers).", "rules.txt", tmp_path)
    assert answers(engine, "distance(0, 0, 3, 4, D)") == [{"D": "5.0"}]
    assert [answer["X"] for answer in answers(engine, "upto(3, X)")] == ["1", "2", "3"]
    assert engine.call("is_even(4)")


CLOSED: List[Any] = []


@foreign
def endless(start: int) -> Iterator[int]:
    try:
        while True:
            yield start
            start += 1
    finally:
        CLOSED.append(start)


@foreign
def count_items(items: list) -> int:
    return len(items)


@foreign
def depth(term: object) -> int:
    levels = 0
    while isinstance(term, Compound):
        term = term.args[0]
        levels += 1
    return levels


@foreign(outputs=2)
def returns_one_value() -> Any:
    return (1,)


@foreign(outputs=2)
def returns_no_tuple() -> int:
    return 1


@foreign
def returns_object() -> Any:
    return object()


@foreign
def numbers_without_end() -> Any:
    return itertools.count()


@foreign
def raises_prolog_error(name: str) -> bool:
    raise PrologError((functor("my_error", 1), atom(name)))


@pytest.fixture
def forms() -> Engine:
    empty_engine = Engine()
    empty_engine.add_foreign(
        endless,
        count_items,
        depth,
        returns_one_value,
        returns_no_tuple,
        returns_object,
        numbers_without_end,
        raises_prolog_error,
    )
    CLOSED.clear()
    return empty_engine


@pytest.mark.parametrize(
    ("goal", "last_values"),
    [
        ("endless(1, X), X > 2, !", [3]),
        ("(endless(1, X) -> true)", [1]),
        ("\\+ \\+ endless(1, _)", [1]),
        ("once((endless(1, X), endless(5, Y), X + Y > 7))", [7, 1]),
        ("catch((endless(1, X), X > 2, throw(done)), done, true)", [3]),
        ("findall(X, limit(2, endless(1, X)), _)", [2]),
    ],
)
def test_cut_closes_generator(forms: Engine, goal: str, last_values: List[int]) -> None:
    assert forms.call(goal)
    assert sorted(CLOSED) == sorted(last_values)


def test_endless_generator_exceeds_limit(forms: Engine) -> None:
    forms.logic.limits = Limits(inferences=20_000)
    with pytest.raises(PrologError, match="Not enough resources: inferences"):
        forms.call("endless(1, X), X < 0")


@pytest.mark.slow
def test_deep_and_long_terms_are_converted(forms: Engine) -> None:
    forms.load(rules="deep(0, a) :- !.\ndeep(N, s(T)) :- M is N - 1, deep(M, T).")
    assert forms.call("numlist(1, 100000, L), count_items(L, 100000)")
    assert forms.call("deep(50000, T), depth(T, 50000)")
    with pytest.raises(PrologError, match="Not enough resources"):
        forms.call("T = s(T), depth(T, _)")


@pytest.mark.parametrize(
    ("goal", "formal"),
    [
        ("returns_one_value(A, B)", "system_error('a foreign predicate returned 1 value for 2 outputs')"),
        ("returns_object(X)", "system_error('a object is not a term: <"),
        ("returns_no_tuple(A, B)", "python_error('TypeError',"),
        ("raises_prolog_error(a)", None),
        ("count_items([1|_], _)", "instantiation_error"),
        ("count_items(X, _)", "instantiation_error"),
        ("count_items([_], _)", "instantiation_error"),
        ("count_items([1])", "existence_error(procedure,count_items/1)"),
    ],
)
def test_failed_conversion_is_an_error_of_goal(forms: Engine, goal: str, formal: Optional[str]) -> None:
    with pytest.raises(PrologError) as caught:
        forms.call(goal)
    if formal is None:
        assert writeq(caught.value.term) == "my_error(a)"
    else:
        assert writeq(compound(caught.value.term)[1]).startswith(formal)
    assert forms.call("count_items([1], 1)")


def test_endless_result_exceeds_limit(forms: Engine) -> None:
    forms.logic.limits = Limits(inferences=20_000)
    with pytest.raises(PrologError, match="Not enough resources"):
        forms.call("numbers_without_end(X)")


def test_ndarray_parameter_receives_array() -> None:
    arrays: List[Any] = []

    @foreign
    def doubled(values: numpy.ndarray) -> numpy.ndarray:
        arrays.append(values)
        return values * 2

    @foreign
    def total(values: numpy.ndarray) -> float:
        return float(values.sum())

    @foreign
    def class_name(values: object) -> str:
        return type(values).__name__

    engine = Engine()
    engine.add_foreign(doubled, total, class_name)
    ranges = array_term(numpy.arange(9, dtype="f4"))
    result = Var()
    for _ in engine.logic.solutions((functor("doubled", 2), ranges, result)):
        shown = writeq(result)
    assert arrays[0].dtype == numpy.dtype("f4")
    assert not arrays[0].flags.writeable
    assert lazy(ranges).decoded_term is None
    assert shown == "[0.0,2.0,4.0,6.0,8.0,10.0,12.0,14.0,16.0]"
    (answer,) = engine.query("doubled([1,2,3], L), total(L, T), class_name(L, K), total('\"ab\"', B)")
    assert [engine.show(answer[name]) for name in "LTKB"] == ["[2,4,6]", "12.0", "list", "195.0"]


@pytest.mark.parametrize("term", ["X", "foo", "[a]", "[1|_]"])
def test_other_terms_for_ndarray_are_errors(term: str) -> None:
    @foreign
    def count(values: numpy.ndarray) -> int:
        return len(values)

    engine = Engine()
    engine.add_foreign(count)
    with pytest.raises(PrologError, match="instantiated|expected"):
        engine.query(f"count({term}, _)")


@pytest.mark.parametrize(
    ("array", "text"),
    [
        (numpy.array([[1, 2], [3, 4]]), "[[1,2],[3,4]]"),
        (numpy.arange(6, dtype=">i2"), "[0,1,2,3,4,5]"),
        (numpy.arange(6)[::2], "[0,2,4]"),
        (numpy.zeros(0), "[]"),
        (numpy.arange(5, dtype="f2"), "[0.0,1.0,2.0,3.0,4.0]"),
    ],
)
def test_returned_array_is_converted_to_list(array: Any, text: str) -> None:
    assert writeq(to_term(array)) == text


def test_items_of_list_parameter_are_checked() -> None:
    @foreign
    def total(values: List[int], scale: Optional[int]) -> int:
        return sum(values) * (scale or 0)

    engine = Engine()
    engine.add_foreign(total)
    assert engine.query("total([1, 2], 3, X)")[0]["X"] == 9
    for goal, problem in {
        "total([1, a], 3, X)": "`integer' expected, found `a'",
        "total(abc, 3, X)": "`list' expected, found `abc'",
        "total([1], 2.5, X)": "`integer' expected, found `2.5'",
    }.items():
        with pytest.raises(PrologError, match=re.escape(problem)):
            engine.query(goal)
