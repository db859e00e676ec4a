"""What may come next on a command line, as a shell asks for it."""

import pytest

from retalis.cli import completion
from retalis.cli.command_line import main, make_parser


def after(*words, names=lambda kind, node: []):
    """Return what the last of the words may become."""
    return completion.list_candidates(make_parser([])[0], words, names)


def named(kind, node):
    return [f"{kind} of {node}", "odom"]


@pytest.mark.parametrize(
    "words, found",
    [
        (["ev"], ["events"]),
        (["--v"], ["--version"]),
        (["bag", "--max-s"], ["--max-skew", "--max-seconds"]),
        (["bag", "--program", ""], []),  # the shell takes files
        (["bag", "--program", "x", "--max-skew", "2", "a.bag", "--prog"], ["--program"]),
        (["bag", "x.bag", "--quiet", "--quie"], ["--quiet"]),
        (["list", ""], ["--help", "--node", "--json"]),  # there are no other arguments
        (["console", "--he"], ["--help", "--help-all"]),
        (["list", "--no"], ["--node"]),
        (["query", "--node", ""], ["nodes of None", "odom"]),
        (["query", "--node", "="], ["nodes of None", "odom"]),
        (["query", "--node", "/r", "--wait-for", ""], ["memories of /r", "odom"]),
        (["query", "x", "--node", "=", "/r", "--wait-for", "mem"], ["memories of /r"]),
        (["console", "--node", "od"], ["odom"]),
        (["complete", ""], ["bash"]),
        (["nothing", "--no"], []),
        (["console", "a", "b", "c"], []),
    ],
)
def test_what_may_come(words, found):
    assert after(*words, names=named) == found


def test_each_command_is_offered_and_each_of_its_options():
    commands = after("")
    assert {"bag", "console", "demo", "events", "query", "watch", "reload"} <= set(commands)
    for command in commands:
        assert "--help" in after(command, "-")


def test_asked_by_the_shell(capsys, monkeypatch):
    assert main(["complete", "words", "1", "retalis", "demo"]) == 0
    assert capsys.readouterr().out.endswith("demo\n")
    monkeypatch.setattr(completion, "import_ros_module", no_ros)
    assert main(["complete", "words", "3", "retalis", "query", "--node"]) == 0  # the word is not begun yet
    assert capsys.readouterr() == ("", "")


def no_ros(name):
    raise completion.UsageError("there is no ROS")


def test_the_script_is_printed(capsys):
    assert main(["complete"]) == 0
    assert capsys.readouterr().out == completion.BASH_SCRIPT.read_text(encoding="utf-8")
    for words in (["words"], ["words", "x"], ["words", "9", "retalis"]):
        assert main(["complete", *words]) == 1
        assert "complete words: expected the number of a word" in capsys.readouterr().err
