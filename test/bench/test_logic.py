"""The benchmark of Prolog in all available engines, without the values of its figures."""

import json
import sys
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest


@pytest.fixture
def logic(import_benchmark: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    bench = import_benchmark("logic")
    monkeypatch.setattr(bench, "limit_gc_pauses", lambda: None)
    recursion_limit = sys.getrecursionlimit()
    yield bench
    sys.setrecursionlimit(recursion_limit)  # ProbLog raises it for all


@pytest.mark.slow
@pytest.mark.parametrize("case", ["nrev", "tak", "tabled", "deriv", "primes", "assert", "split", "count"])
def test_case_has_positive_time(logic: Any, monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    monkeypatch.setitem(logic.CASES, case, (logic.CASES[case][0], 1, 1))
    assert logic.one(logic.OURS, case) > 0


@pytest.mark.parametrize(("engine", "case"), [("problog", "split"), ("problog", "deriv"), ("kanren", "join")])
def test_case_has_positive_time_in_other_engine(logic: Any, engine: str, case: str) -> None:
    pytest.importorskip(engine)
    assert logic.can_run(engine, case)
    assert logic.theirs(engine, case, 0.0001) > 0


def test_row_compares_medians(
    logic: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    figures = {logic.OURS: iter([3.0, 1.0, 2.0]), "swipl": iter([0.5, 0.5, 0.5]), "problog": iter([400.0])}
    monkeypatch.setattr(logic, "in_process", lambda python, engine, case: next(figures[engine]))
    monkeypatch.setattr(logic, "can_run", lambda engine, case: engine in figures)
    monkeypatch.setattr(
        sys, "argv", ["logic.py", "--runs", "3", "--json", str(tmp_path / "figures.json"), "nrev"]
    )
    logic.main()
    lines = capsys.readouterr().out.splitlines()
    assert lines[2] == "| `nrev` | 2 | 0.5 | 400 |  | 4.0 | 200 |  |"
    assert f"{logic.version(sys.executable)}: 248, 496" in lines
    figures_of_case = json.loads((tmp_path / "figures.json").read_text())["us"]["nrev"]
    assert figures_of_case["problog"] == {"median": 400.0, "best": 400.0, "runs": 1}


def test_unknown_case_is_refused(
    logic: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["logic.py", "nothing"])
    with pytest.raises(SystemExit):
        logic.main()
    assert "there is no case nothing" in capsys.readouterr().err
