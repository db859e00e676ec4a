"""Console: solutions, errors, files, and tracing; from a pipe and at a terminal."""

import io
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, List

import pytest
from asserting_accessors import compound
from subprocess_python_path import python_path

from retalis import Limits, Operators, Settings
from retalis.cli.command_line import main
from retalis.cli.console import Console
from retalis.cli.stderr_reports import StderrReporter
from retalis.cli.toplevel_io import PipedInput, TerminalInput, find_completions, format_bindings
from retalis.prolog.syntax.term_reader import read_term


@pytest.fixture
def ask(capsys: pytest.CaptureFixture[str]) -> Any:
    """Return a function that pipes text into a console and returns the printed output and errors."""

    def ask(text: str, console: Any = None) -> Any:
        console = Console(StderrReporter()) if console is None else console
        console.solve_goals(PipedInput(io.StringIO(text)))
        return capsys.readouterr()

    return ask


@pytest.mark.slow
@pytest.mark.parametrize(
    ("goal", "answer"),
    [
        ("true.", "true.\n"),
        ("fail.", "false.\n"),
        ("X = 1.", "X = 1.\n"),
        ("?- X = 1.", "X = 1.\n"),
        ("X = 1, Y = b.", "X = 1,\nY = b.\n"),
        ("member(X, [1,2]).", "X = 1 ;\nX = 2.\n"),
        ("(X = 1 ; X = 2 ; fail).", "X = 1 ;\nX = 2 ;\nfalse.\n"),
        ("X = 1, Y = 1.", "X = Y, Y = 1.\n"),
        ("X = Y.", "X = Y.\n"),
        ("X = f(A, B, _, _), Y = X.", "X = Y, Y = f(A, B, _, _).\n"),
        ("length(L, 2).", "L = [_, _].\n"),
        ("length(L, 1), M = [L, L].", "L = [_A],\nM = [[_A], [_A]].\n"),
        ("X = (a :- b, c).", "X = (a:-b, c).\n"),
        ("X = 'a b', Y = \"s\".", "X = 'a b',\nY = \"s\".\n"),
        ("_X = 1.", "true.\n"),
        ("write(a).", "a\ntrue.\n"),
        ("write(a), nl.", "a\ntrue.\n"),
        ("X = f(X).", "% the answer is a cyclic term, or too large to be shown.\n"),
        ("X = 1,\n  Y = 2.", "X = 1,\nY = 2.\n"),
        ("X = 'a.b'.", "X = 'a.b'.\n"),
        ("% a comment\nX = 1. % another", "X = 1.\n"),
        ("X = 1 % a comment.\n.", "X = 1.\n"),
        ("X = 0'.\n.", "X = 46.\n"),
        ("halt.\nX = 1.", ""),
    ],
)
def test_solutions_are_printed(ask: Any, goal: str, answer: str) -> None:
    captured = ask(goal + "\n")
    assert (captured.out, captured.err) == (answer, "")


def test_console_continues_after_error(ask: Any) -> None:
    captured = ask("atom_length(X, Y).\nthrow(oops).\nX = 2.\n")
    assert captured.out == "X = 2.\n"
    assert "Arguments are not sufficiently instantiated" in captured.err
    assert "Unhandled exception: oops" in captured.err


def test_error_after_output_is_on_new_line(ask: Any) -> None:
    captured = ask("write(a), atom_length(X, Y).\n")
    assert captured.out == "a\n"
    assert captured.err.startswith("error: Arguments are not sufficiently instantiated")


def test_syntax_error_has_position_and_caret(ask: Any) -> None:
    captured = ask("X = .\nX = 1.\n")
    assert captured.out == "X = 1.\n"
    assert "user:1:5" in captured.err
    assert captured.err.splitlines()[-1] == "    ^"


def test_undefined_predicate_has_similar_name(ask: Any) -> None:
    assert "did you mean atom_length/2" in ask("atom_lenth(a, X).\n").err


def test_option_most_limits_solutions(capsys: pytest.CaptureFixture[str]) -> None:
    Console(StderrReporter(), max_solutions=2).solve_goals(PipedInput(io.StringIO("repeat.\n")))
    assert capsys.readouterr().out == "true ;\ntrue .\n% there may be more (see --most)\n"


def test_clauses_are_read_from_user(ask: Any) -> None:
    captured = ask("[user].\np(1).\np(X) :- q(Y).\nend_of_file.\np(X).\n")
    assert captured.out.startswith("true.\nX = 1 ;\n")
    assert "singleton variables: X, Y" in captured.err
    assert "called from p/1" in captured.err


def test_files_are_consulted(tmp_path: Path, ask: Any, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "facts.pl"
    path.write_text("p(1).\np(2).\nout(X) <- in(X).\nq(A) :- p(1).\n")
    captured = ask(
        f"['{path}'].\np(X).\nsubscribe(out(_), [], _, topic, s).\nevent(in(3)).\nconsult('{path}x').\n"
    )
    assert "X = 1 ;\nX = 2.\n" in captured.out
    assert "% topic: out(3)" in captured.out
    assert f"{path}:4:1: singleton variables: A" in caplog.text
    assert "cannot read" in captured.err


def test_invalid_file_reports_all_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wrong.pl"
    path.write_text("p(.\nq(1) <- a.\nr(]).\n")
    reporter = StderrReporter()
    assert not Console(reporter).load(path)
    assert reporter.errors == 2
    assert "wrong.pl:1:3" in capsys.readouterr().err


def test_flags_and_operators_apply_to_next_goal(ask: Any) -> None:
    captured = ask('op(700, xfx, ===>), set_prolog_flag(double_quotes, codes).\nX = (a ===> b).\nX = "a".\n')
    assert captured.out == "true.\nX = (a===>b).\nX = [97].\n"


TRACE = """\
     Call: (1) p(_, b)
     Call: (2) q(_)
     Exit: (2) q(1)
     Exit: (1) p(1, b)
     Call: (1) 1>1
     Fail: (1) 1>1
     Redo: (1) p(1, b)
     Redo: (2) q(1)
     Exit: (2) q(2)
     Exit: (1) p(2, b)
     Call: (1) 2>1
     Exit: (1) 2>1
"""


def test_trace_prints_ports(ask: Any) -> None:
    console = Console(StderrReporter())
    ask("[user].\np(X, b) :- q(X).\nq(1).\nq(2).\nend_of_file.\n", console)
    captured = ask("trace, p(X, b), X > 1.\np(X, b).\n", console)
    assert captured.out == "X = 2.\nX = 1 ;\nX = 2.\n"
    assert without_variable_names(captured.err) == TRACE


def test_trace_has_exceptions_and_meta_calls(ask: Any) -> None:
    captured = ask("trace(catch(atom_length(_, _), error(E, _), true)).\n")
    assert captured.out == "E = instantiation_error.\n"
    ports = [line.split()[0] for line in captured.err.splitlines()]
    assert ports == ["Call:", "Call:", "Exception:", "Exit:"]


TRACE_WITH_CUTS = """\
     Call: (1) p(_)
     Call: (2) q(_)
     Exit: (2) q(1)
     Exit: (1) p(1)
     Call: (1) p(3)
     Call: (2) q(3)
     Fail: (2) q(3)
     Fail: (1) p(3)
     Call: (1) p(_)
     Call: (2) q(_)
     Exit: (2) q(1)
     Exit: (1) p(1)
     Call: (1) _=1
     Exit: (1) 1=1
"""


def test_trace_respects_cuts(ask: Any) -> None:
    console = Console(StderrReporter())
    ask("[user].\np(X) :- q(X), !.\nq(1).\nq(2).\nend_of_file.\n", console)
    captured = ask("trace(p(X)).\ntrace(\\+ p(3)).\ntrace((p(X) -> Y = X ; Y = none)).\n", console)
    assert captured.out == "X = 1.\ntrue.\nX = Y, Y = 1.\n"
    assert without_variable_names(captured.err) == TRACE_WITH_CUTS


def test_trace_is_switched_on_and_off(ask: Any) -> None:
    captured = ask("trace.\natom(a).\nnotrace.\natom(b).\n")
    assert captured.out == "true.\n" * 4
    assert captured.err == "     Call: (1) atom(a)\n     Exit: (1) atom(a)\n"


def without_variable_names(text: Any) -> str:
    return re.sub(r"_G\d+", "_", text)


def test_simple_terminal_has_no_line_editing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Any) -> None:
        raise RuntimeError("terminal doesn't have the required 'clear' capability")

    readline = SimpleNamespace(
        **dict.fromkeys(("set_completer", "set_completer_delims", "parse_and_bind"), id)
    )
    readline.read_history_file = refuse
    exit_handlers: List[Any] = []
    monkeypatch.setattr("atexit.register", exit_handlers.append)
    monkeypatch.setitem(sys.modules, "readline", readline)
    assert TerminalInput(list).is_terminal
    assert not exit_handlers


def test_names_are_completed() -> None:
    names = ["append", "atom_length", "atom_chars", "=..", "Weird"]
    assert find_completions("atom", names) == ["atom_chars", "atom_length"]
    assert find_completions("", names) == []
    assert find_completions("W", names) == []


def test_names_of_bindings_are_unique() -> None:
    read = read_term("f(_A, X)", Operators.prolog())
    read.names["X"].ref = (compound(read.term)[0], read.names["_A"], 1)
    assert format_bindings(read.names, Operators.prolog()) == "X = f(_, 1)"


def run(arguments: List[str], text: str = "") -> Any:
    return subprocess.run(
        [sys.executable, "-m", "retalis", "console", *arguments],
        input=text,
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": python_path()},
    )


@pytest.mark.slow
def test_piped_goals_and_option_goal_are_solved(tmp_path: Path) -> None:
    path = tmp_path / "facts.pl"
    path.write_text("p(1).\n")
    process = run([str(path)], "p(X).\np(.\n")
    assert (process.returncode, process.stdout) == (1, "X = 1.\n")
    assert run(["-g", "X = 1"]).stdout == "X = 1.\n"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a pseudo-terminal")
def test_terminal_has_solutions_and_interrupts(tmp_path: Path) -> None:

    pid, terminal = pty.fork()
    if pid == 0:
        environment = {
            **os.environ,
            "PYTHONPATH": python_path(),
            "HOME": str(tmp_path),
            "TERM": "dumb",
            "PYTHONUNBUFFERED": "",
        }
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # background processes of a shell ignore it
        os.execve(sys.executable, [sys.executable, "-m", "retalis", "console"], environment)
    try:
        use_console(Screen(terminal))
    except BaseException:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        raise
    assert os.waitpid(pid, 0)[1] == 0
    assert "member(X, [1,2,3])." in (tmp_path / ".retalis_history").read_text()


def use_console(screen: "Screen") -> None:
    """Type goals, an interrupt, a completion, and the end of the input."""
    screen.until("?- ")
    screen.type("member(X, [1,2,3]).\n")
    screen.until("X = 1")
    screen.type(";")
    screen.until("X = 2")
    screen.type("\n")
    screen.until("?- ")
    screen.type("write(start), repeat, fail.\n")
    screen.until("fail.")
    screen.until("start")
    screen.type("\x03")
    screen.until("% interrupted")
    screen.until("?- ")
    screen.type("atom_len\t(abc, N).\n")
    screen.until("N = 3.")
    screen.until("?- ")
    screen.type("\x04")


class Screen:
    def __init__(self, terminal: Any) -> None:
        self._terminal = terminal
        self._text = ""

    def type(self, text: str) -> None:
        os.write(self._terminal, text.encode())

    def until(self, text: str) -> None:
        deadline = time.monotonic() + 60
        while text not in self._text:
            readable, _, _ = select.select([self._terminal], [], [], max(0.0, deadline - time.monotonic()))
            assert readable, f"{text!r} is not shown within 60 s, only {self._text!r}"
            self._text += os.read(self._terminal, 4096).decode()
        self._text = self._text.split(text, 1)[1]


def test_output_of_cleanup_ends_its_line(ask: Any) -> None:
    captured = ask("setup_call_cleanup(true, member(X, [1,2]), write(done)), !.\nX = 2.")
    assert captured.out == "done\nX = 1.\nX = 2.\n"


def test_unknown_procedure_is_named_once(ask: Any) -> None:
    assert ask("no_such(1).").err.count("no_such") == 1
    assert "error: Unknown procedure: no_such/1\n" in ask("no_such(1).").err


def test_all_goals_and_clauses_of_line_are_read(ask: Any) -> None:
    text = "X = 1. X = 2.\n[user]. h(1). h(2).\nh(3). h(\n4).\nend_of_file.\nh(X).\n"
    assert ask(text).out == "X = 1.\nX = 2.\ntrue.\nX = 1 ;\nX = 2 ;\nX = 3 ;\nX = 4.\n"


@pytest.mark.slow
def test_goal_beyond_memory_limit_ends(ask: Any) -> None:
    console = Console(StderrReporter(), Settings(limits=Limits(megabytes=50)))
    captured = ask("numlist(1, 20000000, L).\nX = 1.\n", console)
    assert captured.err.startswith("error: Not enough resources: memory (in numlist/3)")
    assert captured.out.endswith("X = 1.\n")


def test_typed_goals_open_files_anywhere(ask: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    (tmp_path / "there" / "one.pl").write_text("p(1).")
    captured = ask(
        "ensure_loaded('../there/one'), p(X).\nassertz(persistent_event(a)), event(a, [1,1]).\n"
        "exists_file('persistent.txt').\n"
    )
    assert (captured.out, captured.err) == ("X = 1.\ntrue.\ntrue.\n", "")
    assert (tmp_path / "here" / "persistent.txt").read_text() == "event(a,[1,1]).\n"


class TypedLines(PipedInput):
    """A terminal with typed lines."""

    is_terminal = True

    def __init__(self, *lines: Any) -> None:
        super().__init__(io.StringIO())
        self.prompts: List[Any] = []
        self._lines = list(lines)

    def read_line(self, prompt: Any) -> Any:
        self.prompts.append(prompt)
        return self._lines.pop(0) if self._lines else None

    def wants_more(self) -> bool:
        return False


def test_goal_reads_typed_lines(capsys: pytest.CaptureFixture[str]) -> None:
    terminal = TypedLines(
        "write('Fever? '), read(X), read(Y).\n", "yes.\n", "39.\n", "get_char(X).\n", "\n", "z\n"
    )
    Console(StderrReporter()).solve_goals(terminal)
    printed = capsys.readouterr().out
    assert "X = yes,\nY = 39." in printed
    assert terminal.prompts[:4] == ["?- ", "|: ", "|: ", "?- "]
    assert "X = '\\n'." in printed


def test_goal_from_pipe_reads_end_of_file(ask: Any) -> None:
    assert ask("read(X).\nfoo.\n").out.startswith("X = end_of_file.")


@pytest.mark.parametrize(
    ("goal", "answer"),
    [
        ("X = 1", "X = 1.\n"),
        ("X = 1.", "X = 1.\n"),
        ("X = 1. % a note", "X = 1.\n"),
        ("X = 1 % a note", "X = 1.\n"),
        ("X = 1 % a note.", "X = 1.\n"),
        ("X = 1. Y = 2", "X = 1.\nY = 2.\n"),
        ("X = 0'.", "X = 46.\n"),
        ("X = 'a.'", "X = 'a.'.\n"),
        ("X = 1 /* a note. */", "X = 1.\n"),
    ],
)
def test_full_stop_of_option_goal_may_be_omitted(
    goal: str, answer: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["console", "--goal", goal]) == 0
    assert capsys.readouterr() == (answer, "")


@pytest.mark.parametrize("goal", ["X = 'a", "X = 'a.", "X = 1 /* a note", "f(X", "f(X.", "", "% a note"])
def test_option_goal_has_one_syntax_error(goal: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["console", "--goal", goal]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("error: user:") == 1


@pytest.mark.parametrize(
    ("goals", "status"),
    [(["true"], 0), (["fail"], 1), (["true", "fail"], 1), (["member(X, [1,2])"], 0), (["X = f("], 1)],
)
def test_option_goal_has_exit_status(
    goals: List[str], status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["console", *(f"--goal={goal}" for goal in goals)]) == status
    assert ("false." in capsys.readouterr().out) == ("fail" in goals)


def test_goals_have_answers_of_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "answers.yaml").write_text("parameters: {/limit: 40}\n")
    assert (
        main(["console", "--answers", str(tmp_path / "answers.yaml"), "--goal", "ros_param('/limit', L)"])
        == 0
    )
    assert capsys.readouterr().out == "L = 40.\n"
