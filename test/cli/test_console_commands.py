"""Commands of the console: consult, make, help, apropos, and quit."""

import io
import json
import os
from pathlib import Path
from typing import Any

import pytest

from retalis.cli import console
from retalis.cli.command_line import main
from retalis.cli.console import CONSOLE_HELP, DEFAULT_SHOWN_SOLUTIONS, Console, apropos_lines, help_lines
from retalis.cli.stderr_reports import StderrReporter
from retalis.cli.toplevel_io import PipedInput


@pytest.fixture
def ask(capsys: pytest.CaptureFixture[str]) -> Any:
    """Return a function that passes goals to the same console."""
    console = Console(StderrReporter())

    def ask(text: str) -> Any:
        console.solve_goals(PipedInput(io.StringIO(text)))
        return capsys.readouterr()

    return ask


def write(path: Path, text: str, second: int) -> None:
    """Write a file with a given modification time, because the clock of the file system is coarse."""
    path.write_text(text)
    os.utime(path, (second, second))


def test_reloaded_file_replaces_clauses_and_rules(tmp_path: Path, ask: Any) -> None:
    path = tmp_path / "a.pl"
    write(path, "p(1). p(2).\nout(X) <- in(X).\n:- memorize(out(_), [], _, m, 5).\n", 1)
    assert ask(f"['{path}'].\nevent(in(7)).\n").out == "true.\ntrue.\n"
    write(path, "p(3).\nout(X) <- in(X).\nother(X) <- in(X).\n:- memorize(out(_), [], _, m, 5).\n", 2)
    result = ask(f"consult('{path}').\np(X).\nmemory_counter(m, N).\nevent(in(8)).\nmemory_counter(m, N).\n")
    assert result.err == ""
    assert f"% {path} again\n%   rules: 1 new, 0 gone, 1 kept\n" in result.out
    assert result.out.endswith("true.\nX = 3.\nN = 1.\ntrue.\nN = 2.\n")


def test_file_with_error_keeps_previous_version(tmp_path: Path, ask: Any) -> None:
    path = tmp_path / "a.pl"
    write(path, "p(1).\n", 1)
    ask(f"['{path}'].\n")
    write(path, "p(2).\nq(.\n", 2)
    result = ask("make.\np(X).\n")
    assert result.out == "false.\nX = 1.\n"
    assert f"{path}:2:3" in result.err
    write(path, "p(3).\n", 3)
    assert ask("make.\np(X).\n").out.endswith("true.\nX = 3.\n")


def test_reloaded_file_calls_predicates_of_others(tmp_path: Path, ask: Any) -> None:
    needed, needing = tmp_path / "a.pl", tmp_path / "b.pl"
    write(needed, "p(1).\n", 1)
    write(needing, ":- p(X), assertz(q(X)).\n", 1)
    ask(f"['{needed}', '{needing}'].\n")
    write(needing, ":- p(X), Y is X + 1, assertz(q(Y)).\n", 2)
    result = ask("make.\nq(X).\nmake.\n")
    assert result.err == ""
    assert result.out.endswith("true.\nX = 2.\ntrue.\n")


def test_make_reloads_changed_files_of_program(tmp_path: Path, ask: Any) -> None:
    write(tmp_path / "goalPredicates.txt", "compile_event_file('rules.txt')\n", 1)
    write(tmp_path / "rules.txt", "p(1).\n", 1)
    assert ask(f"['{tmp_path}'].\np(X).\n").out == "true.\nX = 1.\n"
    write(tmp_path / "rules.txt", "p(2).\n", 2)
    assert ask("make.\np(X).\n").out.endswith("true.\nX = 2.\n")


def test_predicates_override_console_commands(ask: Any) -> None:
    result = ask(
        "[user].\nmake :- write(made).\nquit.\nhelp(X) :- X = mine.\nend_of_file.\nmake.\nhelp(X).\nquit.\n"
    )
    assert result.out == "true.\nmade\ntrue.\nX = mine.\ntrue.\n"


@pytest.mark.parametrize("end", ["quit", "exit", "halt", "end_of_file"])
def test_console_ends_at_command(ask: Any, end: str) -> None:
    assert ask(f"{end}.\nX = 1.\n").out == ""


def test_piped_goal_prints_first_solutions_only(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("between(1, inf, X).\n"))
    assert main(["console"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == DEFAULT_SHOWN_SOLUTIONS + 1
    assert lines[-2:] == [f"X = {DEFAULT_SHOWN_SOLUTIONS} .", "% there may be more (see --most)"]


def test_help_describes_predicates(ask: Any) -> None:
    assert ask("help.\n").out == CONSOLE_HELP + "\n"
    assert ask("help(append).\n").out.splitlines()[:2] == [
        "append(?Left, ?Right, ?Whole)",
        "    Whole is the list Left followed by the list Right.",
    ]
    assert ask("help('append/2').\n").out.startswith("append(+Lists, ?Whole)\n")
    assert ask("assertz(mine(1)).\nhelp(mine).\n").out == "true.\nmine/1\n"
    assert ask("help(nothing_at_all).\n").out == "% nothing is known of nothing_at_all\n"


def test_missing_page_of_predicates_is_reported(ask: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console, "PREDICATES_PAGE", "docs/no_such_page.md")
    result = ask("help(append).\napropos(append).\nX = 1.\n")
    assert result.out == "X = 1.\n"
    assert (
        result.err.count("docs/no_such_page.md is neither in the source tree nor in an installed package")
        == 2
    )


def test_apropos_finds_names_and_descriptions(ask: Any) -> None:
    lines = ask("assertz(my_quaternion(1)).\napropos(quaternion).\n").out.splitlines()
    assert "mul_quaternion/5: Pose is the product of two poses, each given as position and rotation." in lines
    assert lines[-1] == "my_quaternion/1"
    assert help_lines("|/2", []) == [
        ":Goal ; :Goal\n    Succeeds if one of the goals succeeds; backtracking tries the left one first."
    ]
    many = apropos_lines("a", [])
    assert many[-1].startswith("% and ")


@pytest.mark.parametrize(
    ("name", "page"),
    [("memorize", "docs/reference/memories.md"), ("absent", "docs/how-to/missing-message.md")],
)
def test_help_of_own_predicates_names_page(name: str, page: str) -> None:
    assert any(line.endswith(page) for line in "\n".join(help_lines(name, ["memorize/5"])).split("\n"))


def test_json_has_object_per_solution(capsys: pytest.CaptureFixture[str]) -> None:
    goals = ['member(X, [1, "text", f(_)]), _Hidden = 1', "event(seen(1))", "format(shown)"]
    options = [word for goal in goals for word in ("--goal", goal)]
    assert main(["console", "--json", *options]) == 0
    captured = capsys.readouterr()
    assert [json.loads(line) for line in captured.out.splitlines()] == [
        {"X": 1},
        {"X": "text"},
        {"X": {"functor": "f", "args": [{"variable": "_1"}]}},
        {},
        {},
    ]
    assert captured.err == "shown\n"


def test_json_of_failed_goal_is_empty(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["console", "--json", "--goal", "fail"]) == 1
    assert capsys.readouterr() == ("", "")


def test_json_solutions_are_limited(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["console", "--json", "--most", "2", "--goal", "repeat"]) == 0
    assert capsys.readouterr() == ("{}\n{}\n", "there may be more solutions (see --most)\n")
    assert main(["console", "--json", "--most", "2", "--goal", "member(X, [1, 2])"]) == 0
    assert capsys.readouterr() == ('{"X": 1}\n{"X": 2}\n', "")


def test_json_needs_a_goal(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["console", "--json"]) == 1
    assert capsys.readouterr().err == "retalis: console --json: expected a goal with --goal\n"
