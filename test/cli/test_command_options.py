"""``--max-seconds`` and its sisters: the same for each command, and nothing hangs one for ever."""

import io
import sys

import pytest

from retalis import BagWriter, Definitions, Limits, Settings
from retalis.cli.command_line import main
from retalis.cli.console import Console
from retalis.cli.stderr_and_progress import StderrReporter
from retalis.cli.toplevel_io import PipedInput

RULES = "loop :- loop.\nloop(X) <- in(X) where (X = 2, loop).\nout(X) <- in(X).\n"
STREAM = "event(in(1),[1,1]).\nevent(in(2),[2,2]).\nloop.\nevent(in(3),[3,3]).\n"
WHAT = ("--max-inferences", "100000"), ("--max-seconds", "0.2")


@pytest.fixture
def files(tmp_path):
    (tmp_path / "rules.txt").write_text(RULES)
    (tmp_path / "stream.txt").write_text(STREAM)
    (tmp_path / "goals.txt").write_text("loop\n")
    return tmp_path


@pytest.mark.parametrize("option", WHAT)
def test_events_go_on_behind_a_goal_without_end(files, option, capsys):
    status = main(
        ["events", "--rules", str(files / "rules.txt"), "--stream", str(files / "stream.txt"), *option]
    )
    shown = capsys.readouterr()
    assert status == 1
    assert [line for line in shown.out.splitlines() if line.startswith("event(out")] == [
        f"event(out({number}),[{number},{number}])." for number in (1, 2, 3)
    ]
    assert shown.err.count("error: ") == 2
    assert "rules.txt:2:1: rule loop(X), at event in(2): goal X=2,loop: Not enough resources" in shown.err
    assert "stream.txt:3:1: Not enough resources" in shown.err


def test_goals_of_the_start_and_queries_have_limits_too(files, capsys):
    (files / "queries.txt").write_text("loop.\nX = 1.\n")
    (files / "more.txt").write_text("consult('rules.txt')\nloop\n")
    options = ["--goals", str(files / "more.txt"), "--queries", str(files / "queries.txt")]
    assert main(["events", *options, "--max-inferences", "50000"]) == 1
    shown = capsys.readouterr()
    assert shown.out == "=(1,1).\n"
    assert "more.txt:2:1: Not enough resources: inferences" in shown.err
    assert "queries.txt:1:1: Not enough resources: inferences" in shown.err


@pytest.mark.parametrize("option", WHAT)
def test_the_console_goes_on_behind_a_goal_without_end(option, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("repeat, fail.\nX = 1.\n"))
    assert main(["console", *option]) == 1
    shown = capsys.readouterr()
    assert shown.out == "X = 1.\n"
    assert shown.err.count("error: ") == 1
    assert "Not enough resources" in shown.err


def test_output_has_a_limit_on_request_only(files, capsys):
    goals = ["-g", "forall(between(1, 1100, _), format('~*c', [1000, 0'x]))", "-g", "write('\\e[2J')"]
    assert main(["console", *goals]) == 0
    shown = capsys.readouterr()
    assert shown.out == f"{'x' * 1_100_000}\ntrue.\n\\x1b[2J\ntrue.\n"
    assert main(["console", "--max-output-megabytes", "0.5", *goals]) == 1
    shown = capsys.readouterr()
    assert shown.out == f"{'x' * 500_000}\n\\x1b[2J\ntrue.\n"
    assert shown.err.count("error: Not enough resources: output") == 1


def make_bag(path, number):
    definition = Definitions().find("std_msgs/Int32")
    with BagWriter(path) as writer:
        connection = writer.add("in", definition)
        for at in range(number):
            writer.write(connection, at * 10**9, at.to_bytes(4, "little"))


@pytest.mark.parametrize("option", WHAT)
def test_a_bag_goes_on_behind_a_goal_without_end(files, option, capsys):
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
    shown = capsys.readouterr()
    assert shown.out.splitlines() == [f"output(std_msgs__0__Int32({at}),out)." for at in range(3)]
    assert shown.err.count("error: ") == 2
    assert "goalPredicates.txt:3:1: Not enough resources" in shown.err
    assert "rule loop(X), at event std_msgs__0__Int32(1): goal X=1,loop: Not enough" in shown.err


@pytest.mark.parametrize("command", [["console"], ["events"], ["bag", "x.bag", "--program", "x"]])
@pytest.mark.parametrize(
    ("option", "value"),
    [
        *(("--max-seconds", "-1"), ("--max-inferences", "1.5"), ("--watchdog", "nan"), ("--max-depth", "0")),
        *(("--max-megabytes", "inf"), ("--max-output-megabytes", "x")),
    ],
)
def test_what_is_no_limit_is_refused(command, option, value, capsys):
    with pytest.raises(SystemExit) as ended:
        main([*command, option, value])
    assert ended.value.code == 2
    assert f"argument {option}: expected a" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["console", "events", "bag"])
def test_each_command_explains_them(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help-all"])
    shown = capsys.readouterr().out
    for name in ("seconds", "inferences", "megabytes", "depth"):
        assert f"--max-{name} N" in shown
    assert "--watchdog N" in shown


def test_the_time_that_a_user_takes_is_not_counted(capsys):
    class User(PipedInput):
        is_terminal = True

        def wants_more(self):
            budget = console.engine.logic.machine.budget
            asked.append(budget.executor.entry)
            return True

    asked = []
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
    assert asked == [None] * 9
