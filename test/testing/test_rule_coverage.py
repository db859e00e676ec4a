"""Coverage of programs by cases."""

from pathlib import Path
from typing import Collection, List
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from oracle.comparison import ReusableEngine, engine_steps
from oracle.strategies import Case, cases
from testing.case_texts import indent, parse_case

from retalis import Definitions, Engine, RetalisError, Settings, StreamClock
from retalis.foundation.errors import UsageError
from retalis.testing.case_run import run_case
from retalis.testing.rule_coverage import (
    CoveredPart,
    covered_percentage,
    format_coverage,
    merge_parts,
    write_cobertura_report,
)

END_OF_STREAMS = 10**14
"""Time in ns after all events of generated cases."""

CASE = """\
rules: |
  fire <- smoke(X) seq heat(X).
  cold <- frost(_).
goals: |
  subscribe(fire, [], fire, alarms, a)
  memorize(smoke(_), [], _, smokes, 5)
  memorize(frost(_), [], _, frosts, 5)
cases:
  - {name: x, input: [{at: 1, event: smoke(hall)}, {at: 2, event: heat(attic)}], expect: {}}
"""


def collect(text: str, definitions: Definitions) -> List[CoveredPart]:
    result = run_case(parse_case(text), definitions, records_coverage=True)
    assert result.failures == ()
    return list(result.coverage)


def test_parts_have_their_uses(definitions: Definitions) -> None:
    parts = [part._replace(text=part.text.partition("(")[0]) for part in collect(CASE, definitions)]
    assert list(map(tuple, parts)) == [
        ("rule", "mine_test.yaml:2", "fire<-smoke", 0, "fire"),
        ("rule", "mine_test.yaml:3", "cold<-frost", 0, "cold"),
        ("pattern", "mine_test.yaml:2", "1, smoke", 1, "fire"),
        ("pattern", "mine_test.yaml:2", "2, heat", 1, "fire"),
        ("pattern", "mine_test.yaml:3", "1, frost", 0, "cold"),
        ("subscription", "", "a of topic alarms", 0, ""),
        ("memory", "", "smokes, stored", 1, ""),
        ("memory", "", "smokes, read", 0, ""),
        ("memory", "", "frosts, stored", 0, ""),
        ("memory", "", "frosts, read", 0, ""),
    ]


@pytest.mark.parametrize(
    "query",
    [
        "prev(smokes, _, _, _, 1000000002)",
        "\\+ next(smokes, _, _, _, 1000000002, 1000000003)",
        "newest_matching(smokes, _, _, _)",
        "access_mem(smokes, _, _)",
        "memory_counter(smokes, 1)",
        "memory_size(Name, 5), Name == smokes",
    ],
)
def test_queries_read_memories(query: str, definitions: Definitions) -> None:
    text = CASE.replace("expect: {}", f"expect: {{state: [{{query: '{query}', expect: true}}]}}")
    uses = {part.text: part.uses for part in collect(text, definitions)}
    assert uses["smokes, read"] > 0
    assert (uses["frosts, read"] > 0) == ("Name" in query)


def test_declarations_of_events_are_no_clauses(definitions: Definitions) -> None:
    rules = "input_event(smoke/1).\n  limit(5).\n  fire <- smoke(X) where limit(X).\n"
    parts = collect(CASE.replace("  fire <- smoke(X) seq heat(X).\n", f"  {rules}"), definitions)
    assert [part.text for part in parts if part.type == "clause"] == ["limit(5)"]


def list_parts(rules: str, events: str, definitions: Definitions, parts: Collection[str]) -> List[str]:
    """Return the parts of some types, each as text with the number of its uses."""
    inputs = "".join(f"{{at: {at}, event: '{event}'}}, " for at, event in enumerate(events.split(), 1))
    text = f"rules: |\n{indent(rules, 2)}cases:\n  - {{name: x, input: [{inputs}], expect: {{}}}}\n"
    return [f"{part.text} {part.uses}" for part in collect(text, definitions) if part.type in parts]


@pytest.mark.parametrize(
    ("rule", "events", "expected"),
    [
        ("hot <- t(X) where X > 38.", "t(1) t(40) t(41)", "true 2 false 1"),
        (
            "hot <- (t(X) where X > 3) seq (u(Y) where (Y > X)).",
            "t(1) t(4) u(3)",
            "true 1 false 1 true 0 false 1",
        ),
        ("hot <- (t(X) seq u(Y)) where Y > X.", "t(1) u(3) u(4)", "true 1 false 0"),
        ("hot <- t(_) cnot (u(X) where X > 3).", "t(1)", "true 0 false 0"),
        ("hot <- (t(X, _) where X > 3) ntimes 2.", "t(4,a) t(2,b) t(4,c)", "true 4 false 2"),
        ("hot <- ((t(X, _) where X > 3) seq u(_)) ntimes 2.", "t(4,a) u(1) t(4,c)", "true 4 false 0"),
        ("hot <- t(X) check (t1(S), S > X, X > 1).", "t(1) t(2)", "true 1 false 1"),
        ("hot <- t(X) where X.", "t(true) t(fail)", "true 1 false 1"),
    ],
)
def test_outcomes_of_conditions_are_counted(
    rule: str, events: str, expected: str, definitions: Definitions
) -> None:
    """The tests of all repetitions of a pattern are counted."""
    parts = list_parts(rule, events, definitions, ["condition"])
    assert " ".join(f"{part.split(' ')[1].strip(',')} {part.split(' ')[-1]}" for part in parts) == expected


def test_conditions_have_texts_with_names(definitions: Definitions) -> None:
    parts = list_parts("hot <- t(Heat, _) where (Heat > 38, p(Heat)).\np(_).", "", definitions, ["condition"])
    assert parts == ["1 true, Heat>38,p(Heat) 0", "1 false, Heat>38,p(Heat) 0"]


def test_branches_of_or_are_counted(definitions: Definitions) -> None:
    rules = "out <- (a(_) or (b(X) seq c(X))) or d.\nout2 <- (a(1) or a(2)) ntimes 2."
    assert list_parts(rules, "a(1) b(1) a(2) c(2) a(1)", definitions, ["branch"]) == [
        "1, a(_) 3",
        "2, b(X), c(X) 0",
        "3, d 0",
        "1, a(1) 4",
        "2, a(2) 2",
    ]


CLAUSES = """\
out(Y) <- a(X) do size(X, Y).
size(X, small) :- X < 3, !.
size(X, Y) :- limit(Y, Max), X < Max, !.
size(_, huge).
limit(medium, 5).
limit(large, 10).
unused --> [a].
"""


def test_clauses_are_counted(definitions: Definitions) -> None:
    assert list_parts(CLAUSES, "a(1) a(4) a(4)", definitions, ["clause"]) == [
        "size(A,small) 3",
        "size(A,B) 2",
        "size(A,huge) 0",
        "limit(medium,5) 2",
        "limit(large,10) 0",
        "unused(A,B) 0",
    ]


def test_many_calls_of_clauses_are_counted(definitions: Definitions) -> None:
    """A predicate that is called often is compiled without coverage."""
    rules = "out <- go do forall(between(1, 1000, X), even(X, _)).\neven(X, yes) :- X mod 2 =:= 0, !.\neven(_, no)."
    assert list_parts(rules, "go go", definitions, ["clause"]) == ["even(A,yes) 2000", "even(A,no) 1000"]


def test_uses_of_runs_are_added(definitions: Definitions) -> None:
    runs = [collect(CASE.replace("heat(attic)", "heat(hall)"), definitions), collect(CASE, definitions)]
    merged = merge_parts(runs)
    assert len(merged) == 10
    assert merged[0].uses == 1
    assert round(covered_percentage(merged)) == 50
    lines = list(format_coverage(merged))
    assert lines[:5] == [
        "coverage        used   all",
        "rule               1     2",
        "pattern            2     3",
        "subscription       1     1",
        "memory             1     4",
    ]
    assert lines[5].startswith("not used: cold (mine_test.yaml:3): rule cold<-frost(")
    assert lines[-1] == "50 % covered"


@settings(max_examples=30, deadline=None)
@given(joined=cases(), streamed=cases(streams=True))
def test_counting_changes_no_event(joined: Case, streamed: Case) -> None:
    for case in (joined, streamed):
        try:
            case.expected()
        except RecursionError:
            # The rules trigger each other without end.
            continue
        runs = []
        for counts_uses in (False, True):
            clock = None if case.has_streams() else StreamClock(END_OF_STREAMS)
            engine = ReusableEngine(Engine(clock, Settings(counts_uses=counts_uses)))
            try:
                runs.append(str(engine_steps([case.text()], case.goals(), case.stream, engine)))
            except RetalisError as error:
                # The language refuses a few of the generated programs.
                runs.append(str(error))
        assert runs[0] == runs[1]


def test_program_without_parts_has_no_table() -> None:
    assert list(format_coverage([])) == [
        "coverage: the program has no rules, clauses, subscriptions or memories"
    ]
    assert covered_percentage([]) == 100


def test_coverage_is_recorded_on_request_only(definitions: Definitions) -> None:
    assert run_case(parse_case(CASE), definitions).coverage == ()


def test_cobertura_has_lines_of_rules(definitions: Definitions, tmp_path: Path) -> None:
    write_cobertura_report(tmp_path / "coverage.xml", collect(CASE, definitions))
    root = ElementTree.parse(tmp_path / "coverage.xml").getroot()
    (element,) = root.iter("class")
    assert element.get("filename") == "mine_test.yaml"
    for rated in (root, element):
        assert (rated.get("line-rate"), rated.get("branch-rate")) == ("0.0000", "0.6667")
    assert [line.attrib for line in element.iterfind("lines/line")] == [
        {"number": "2", "hits": "0", "branch": "true", "condition-coverage": "100% (2/2)"},
        {"number": "3", "hits": "0", "branch": "true", "condition-coverage": "0% (0/1)"},
    ]
    methods = {method.get("name"): method for method in element.iter("method")}
    assert list(methods) == ["fire", "cold"]
    assert [line.get("number") for line in methods["cold"].iter("line")] == ["3"]
    with pytest.raises(UsageError, match="cannot write"):
        write_cobertura_report(tmp_path / "none" / "coverage.xml", [])
