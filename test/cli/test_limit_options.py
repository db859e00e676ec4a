"""Limits of goals as options: the same for each command, and no goal blocks a command forever."""

import io
import sys
from pathlib import Path
from typing import Any, List, Tuple

import pytest

from retalis import BagWriter, Definitions, Limits, Settings
from retalis.cli.command_line import main
from retalis.cli.console import Console
from retalis.cli.stderr_reports import StderrReporter
from retalis.cli.toplevel_io import PipedInput

RULES = "loop :- loop.\nloop(X) <- in(X) where (X = 2, loop).\nout(X) <- in(X).\n"
STREAM = "event(in(1),[1,1]).\nevent(in(2),[2,2]).\nloop.\nevent(in(3),[3,3]).\n"
LIMIT_OPTIONS = ("--max-inferences", "100000"), ("--max-seconds", "0.2")


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "rules.txt").write_text(RULES)
    (tmp_path / "stream.txt").write_text(STREAM)
    (tmp_path / "goals.txt").write_text("loop\n")
    return tmp_path


@pytest.mark.parametrize("option", LIMIT_OPTIONS)
def test_events_continues_after_endless_goal(
    files: Path, option: Tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    status = main(
        ["events", "--rules", str(files / "rules.txt"), "--stream", str(files / "stream.txt"), *option]
    )
    captured = capsys.readouterr()
    assert status == 1
    assert [line for line in captured.out.splitlines() if line.startswith("event(out")] == [
        f"event(out({number}),[{number},{number}])." for number in (1, 2, 3)
    ]
    assert captured.err.count("error: ") == 2
    assert "rules.txt:2:1: rule loop(X), at event in(2): goal X=2,loop: Not enough resources" in captured.err
    assert "stream.txt:3:1: Not enough resources" in captured.err


def test_initial_goals_and_queries_have_limits(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (files / "queries.txt").write_text("loop.\nX = 1.\n")
    (files / "more.txt").write_text("consult('rules.txt')\nloop\n")
    options = ["--goals", str(files / "more.txt"), "--queries", str(files / "queries.txt")]
    assert main(["events", *options, "--max-inferences", "50000"]) == 1
    captured = capsys.readouterr()
    assert captured.out == "=(1,1).\n"
    assert "more.txt:2:1: Not enough resources: inferences" in captured.err
    assert "queries.txt:1:1: Not enough resources: inferences" in captured.err


@pytest.mark.parametrize("option", LIMIT_OPTIONS)
def test_console_continues_after_endless_goal(
    option: Tuple[str, str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("repeat, fail.\nX = 1.\n"))
    assert main(["console", *option]) == 1
    captured = capsys.readouterr()
    assert captured.out == "X = 1.\n"
    assert captured.err.count("error: ") == 1
    assert "Not enough resources" in captured.err


def test_output_is_limited_on_request_only(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    goals = ["-g", "forall(between(1, 1100, _), format('~*c', [1000, 0'x]))", "-g", "write('\\e[2J')"]
    assert main(["console", *goals]) == 0
    captured = capsys.readouterr()
    assert captured.out == f"{'x' * 1_100_000}\ntrue.\n\\x1b[2J\ntrue.\n"
    assert main(["console", "--max-output-megabytes", "0.5", *goals]) == 1
    captured = capsys.readouterr()
    assert captured.out == f"{'x' * 500_000}\n\\x1b[2J\ntrue.\n"
    assert captured.err.count("error: Not enough resources: output") == 1


def make_bag(path: Any, count: int) -> None:
    definition = Definitions().find("std_msgs/Int32")
    with BagWriter(path) as writer:
        connection = writer.add("in", definition)
        for second in range(count):
            writer.write(connection, second * 10**9, second.to_bytes(4, "little"))


@pytest.mark.parametrize("option", LIMIT_OPTIONS)
def test_bag_continues_after_endless_goal(
    files: Path, option: Tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    (files / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="in" msg_type="std_msgs/Int32"/>'
        '<publish_to name="out" msg_type="std_msgs/Int32"/></publish_subscribe>'
    )
    (files / "eventRules.txt").write_text(
        "loop :- loop.\nloop(X) <- std_msgs__0__Int32(X) where (X = 1, loop).\n"
    )
    (files / "goalPredicates.txt").write_text(
        "compile_event_file('eventRules.txt')\nsubscribe(std_msgs__0__Int32(X),[],std_msgs__0__Int32(X),out,a)\nloop\n"
    )
    make_bag(files / "in.bag", 3)
    assert main(["bag", str(files / "in.bag"), "--program", str(files), *option]) == 1
    captured = capsys.readouterr()
    assert captured.out.splitlines() == [f"output(std_msgs__0__Int32({value}),out)." for value in range(3)]
    assert captured.err.count("error: ") == 2
    assert "goalPredicates.txt:3:1: Not enough resources" in captured.err
    assert "rule loop(X), at event std_msgs__0__Int32(1): goal X=1,loop: Not enough" in captured.err


@pytest.mark.parametrize("command", [["console"], ["events"], ["bag", "x.bag", "--program", "x"]])
@pytest.mark.parametrize(
    ("option", "value"),
    [
        *(("--max-seconds", "-1"), ("--max-inferences", "1.5"), ("--watchdog", "nan"), ("--max-depth", "0")),
        *(("--max-megabytes", "inf"), ("--max-output-megabytes", "x")),
    ],
)
def test_invalid_limit_is_a_usage_error(
    command: List[str], option: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as raised:
        main([*command, option, value])
    assert raised.value.code == 2
    assert f"argument {option}: expected a" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["console", "events", "bag"])
def test_full_help_has_limits(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help-all"])
    text = capsys.readouterr().out
    for name in ("seconds", "inferences", "megabytes", "depth"):
        assert f"--max-{name} N" in text
    assert "--watchdog N" in text


def test_time_of_user_is_not_limited(capsys: pytest.CaptureFixture[str]) -> None:
    class User(PipedInput):
        is_terminal = True

        def wants_more(self) -> bool:
            entries.append(console.engine.executor.entry)
            return True

    entries: List[Any] = []
    console = Console(StderrReporter(), Settings(limits=Limits(inferences=40_000)))
    console.solve_goals(
        User(
            io.StringIO(
                "nb_setval(k, 0), repeat, numlist(1, 5000, L), msort(L, _), nb_getval(k, K), J is K + 1,"
                " nb_setval(k, J), ( K < 9 -> X = K ; !, X = end ).\n"
            )
        )
    )
    assert "end" in capsys.readouterr().out
    assert entries == [None] * 9
