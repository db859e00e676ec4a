"""Names in findings: preferred suggestions, and bounded work for suggestions and for names of variables."""

from pathlib import Path
from typing import Any, List

import pytest

from retalis import Definitions, Engine, functor
from retalis.engine.program_check import check_program
from retalis.events.checks import program_model
from retalis.events.checks.condition_checks import find_impossible_conditions
from retalis.events.checks.event_flow_checks import find_declaration_violations
from retalis.events.checks.interval_event_window_checks import find_windows_of_long_events
from retalis.events.checks.number_type_checks import find_number_type_mismatches
from retalis.events.checks.program_model import FunctorSuggestions, ProgramModel
from retalis.events.checks.variable_name_checks import find_constants_meant_as_variables
from retalis.events.checks.variable_type_checks import find_type_conflicts
from retalis.events.program.topic_configuration import Topics


def test_equal_name_is_preferred_suggestion() -> None:
    keys = [functor("hot", 1), functor("hot", 4), functor("hit", 2)]
    assert FunctorSuggestions().suggest(functor("hot", 3), keys) == "hot/4"
    assert FunctorSuggestions().suggest(functor("hut", 1), keys) in ("hot/1", "hit/2")
    assert FunctorSuggestions().suggest(functor("cold", 1), keys) == ""


def test_comparisons_of_names_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: List[Any] = []

    def closest_name(name: str, names: Any, alike: float = 0.66) -> str:
        compared.append(len(names))
        return ""

    monkeypatch.setattr(program_model, "closest_name", closest_name)
    suggestions, keys = FunctorSuggestions(), [functor(f"known_{number}", 1) for number in range(400)]
    for number in range(400):
        suggestions.suggest(functor(f"unknown_{number}", 1), keys)
    assert 0 < sum(compared) <= program_model.MAX_COMPARISONS
    assert suggestions.suggest(functor("known_7", 2), keys) == "known_7/1"


class CountingNames(dict):
    """Names of variables that count how often all of them are read."""

    read_count = 0

    def __iter__(self) -> Any:
        self.read_count += 1
        return super().__iter__()

    def keys(self) -> Any:
        self.read_count += 1
        return super().keys()

    def items(self) -> Any:
        self.read_count += 1
        return super().items()

    def values(self) -> Any:
        self.read_count += 1
        return super().values()


@pytest.mark.parametrize(
    "check",
    [
        find_constants_meant_as_variables,
        find_declaration_violations,
        find_impossible_conditions,
        find_number_type_mismatches,
        find_type_conflicts,
        find_windows_of_long_events,
    ],
)
def test_names_of_program_are_not_read_for_each_rule(tmp_path: Path, check: Any) -> None:
    rules = [
        "a(T) <- b(T, _) where (T > T, T > t).",
        "c(T) <- std_msgs__0__String(T) where T > 1.",
        "d(T) <- std_msgs__0__Int32(T) where T == 1.0.",
        "e(S) <- aggregate(sum(T), (f(T) seq g(_)), S, last(5)).",
        "h(T) <- i(T).",
    ]
    (tmp_path / "eventRules.txt").write_text("\n".join([":- event(i(n: string)).", *rules * 20]))
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')")
    engine = Engine()
    engine.load_program(tmp_path)
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics(), folder=tmp_path)
    program.names = names = CountingNames(program.names)
    assert names
    list(check(program))
    assert names.read_count == 0


def test_clause_is_not_suggested_for_its_own_call(tmp_path: Path, definitions: Definitions) -> None:
    rules = tmp_path / "rules.txt"
    rules.write_text("near(X) :- nearr(X).\na <- b(X) where near(X).\n")
    (finding,) = [item for item in check_program(rules, definitions) if item.problem.code == "RT1402"]
    assert finding.problem.message == "there is no predicate nearr/1: define it, or assert facts of it"
