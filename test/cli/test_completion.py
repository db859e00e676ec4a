"""Completion of command lines in shells."""

import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, List

import pytest
from subprocess_python_path import python_path

from retalis import UsageError
from retalis.cli import completion, node_client_commands
from retalis.cli.command_line import main, make_parser


def candidates(*words: Any, names: Any = lambda kind, node: []) -> List[str]:
    """Return the completions of the last word."""
    return completion.list_candidates(make_parser([])[0], words, names)


def names_in_node(kind: Any, node: Any) -> List[str]:
    return [f"{kind} of {node}", "odom"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["ev"], ["events"]),
        (["--v"], ["--version"]),
        (["bag", "--max-s"], ["--max-skew", "--max-seconds"]),
        (["bag", "--program", ""], []),  # the shell completes files
        (["bag", "--program", "x", "--max-skew", "2", "a.bag", "--prog"], ["--program"]),
        (["bag", "x.bag", "--quiet", "--quie"], ["--quiet"]),
        (["list", ""], ["--help", "--node", "--json"]),  # has only options
        (["console", "--he"], ["--help", "--help-all"]),
        (["list", "--no"], ["--node"]),
        (["query", "--node", ""], ["nodes of None", "odom"]),
        (["query", "--node", "="], ["nodes of None", "odom"]),
        (["query", "--node", "/r", "--wait-for", ""], ["memories of /r", "odom"]),
        (["query", "x", "--node", "=", "/r", "--wait-for", "mem"], ["memories of /r"]),
        (["console", "--node", "od"], ["odom"]),
        (["query", "--node=/r", "--wait-for", "mem"], ["memories of /r"]),
        (["query", "--wait-for=od"], ["odom"]),
        (["bag", "--format=pa"], ["parquet"]),
        (["events", "--times=rel"], ["--times=relative"]),
        (["complete", ""], ["bash", "zsh", "fish"]),
        (["nothing", "--no"], []),
        (["console", "a", "b", "c"], []),
    ],
)
def test_words_have_candidates(words: List[str], expected: List[str]) -> None:
    assert candidates(*words, names=names_in_node) == expected


def test_commands_and_options_are_candidates() -> None:
    commands = candidates("")
    assert {"bag", "console", "demo", "events", "query", "watch", "reload"} <= set(commands)
    for command in commands:
        assert "--help" in candidates(command, "-")


def test_command_complete_prints_candidates(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["complete", "words", "1", "retalis", "demo"]) == 0
    assert capsys.readouterr().out.endswith("demo\n")
    monkeypatch.setattr(node_client_commands, "connect_client", no_ros)
    assert main(["complete", "words", "3", "retalis", "query", "--node"]) == 0  # the third word is empty
    assert capsys.readouterr() == ("", "")


def no_ros() -> None:
    raise UsageError("there is no ROS")


def test_script_of_shell_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["complete"]) == 0
    assert "\ncomplete -o default -F _retalis_complete retalis\n" in capsys.readouterr().out
    assert main(["complete", "zsh"]) == 0
    assert capsys.readouterr().out.startswith("#compdef retalis\n")
    assert main(["complete", "fish"]) == 0
    assert "\ncomplete -c retalis " in capsys.readouterr().out
    for words in (["words"], ["words", "x"], ["words", "9", "retalis"]):
        assert main(["complete", *words]) == 1
        assert "complete words: expected the number of a word" in capsys.readouterr().err


PROMPT = b"ready> "
MAX_WAIT_SECONDS = 60

START_FILES = {
    # The widget on ctrl-G prints the line in brackets, which no typed line contains.
    "bash": (
        "rc",
        """
PS1='ready> '
source <(retalis complete bash)
bind 'set bell-style none'
bind 'set enable-bracketed-paste off'
bind -x '"\\C-g": printf "\\n[%s]\\n" "$READLINE_LINE"'
""",
    ),
    "zsh": (
        ".zshrc",
        """
PS1='ready> '
source <(retalis complete zsh)
show() { zle -I; print -r -- "[$BUFFER]" }
zle -N show
bindkey '^G' show
""",
    ),
}
"""Name and text of the file that a shell reads when it starts."""

LINES = [
    ("retalis ev", "retalis events"),
    ("retalis bag --max-sk", "retalis bag --max-skew"),
    ("retalis bag x.bag --format pa", "retalis bag x.bag --format parquet"),
    ("retalis bag --format=pa", "retalis bag --format=parquet"),
    ("retalis events --rules ru", "retalis events --rules rules.txt"),
    ("retalis events 'a b' --json --flu", "retalis events 'a b' --json --flush"),
]


def wait_for(terminal: Any, pattern: bytes) -> Any:
    """Read from a terminal until the text matches a pattern; return the match."""
    text, deadline = b"", time.monotonic() + MAX_WAIT_SECONDS
    while time.monotonic() < deadline:
        if select.select([terminal], [], [], 1.0)[0]:
            text += os.read(terminal, 4096)
            match = re.search(pattern, text)
            if match:
                return match
    raise AssertionError(f"expected {pattern!r} in {text!r}")


def complete_in_terminal(words: Any, lines: List[Any], environment: Any) -> Any:
    """Return what an interactive shell completes each line to."""
    terminal, shell_side = pty.openpty()
    shell = subprocess.Popen(
        words, stdin=shell_side, stdout=shell_side, stderr=shell_side, start_new_session=True, **environment
    )
    os.close(shell_side)
    try:
        completed: List[Any] = []
        for line in lines:
            wait_for(terminal, re.escape(PROMPT))
            # ctrl-G prints the completed line, ctrl-U deletes it, and return shows the prompt.
            os.write(terminal, f"{line}\t\x07".encode())
            completed.append(wait_for(terminal, rb"\[(retalis [^\]]*)\]").group(1).decode().strip())
            os.write(terminal, b"\x15\r")
        return completed
    finally:
        shell.kill()
        shell.wait()
        os.close(terminal)


def complete_in_fish(lines: List[Any], environment: Any) -> Any:
    """Return what fish completes each line to, which it prints for a script."""
    completed: List[Any] = []
    for line in lines:
        script = f'retalis complete fish | source; complete -C "{line}"'
        words = ["fish", "-N", "-c", script]
        process = subprocess.run(
            words, stdout=subprocess.PIPE, text=True, check=True, timeout=60, **environment
        )
        (candidate,) = process.stdout.splitlines()
        completed.append(f"{line.rpartition(' ')[0]} {candidate}")
    return completed


@pytest.mark.slow
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shell_completes_words(shell: str, tmp_path: Path) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed (Debian's package {shell})")
    command = tmp_path / "bin" / "retalis"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m retalis "$@"\n')
    command.chmod(0o755)
    (tmp_path / "rules.txt").touch()
    variables = {
        "PATH": f"{command.parent}:{os.environ['PATH']}",
        "PYTHONPATH": python_path(),
        "HOME": str(tmp_path),
        "ZDOTDIR": str(tmp_path),
        "TERM": "dumb",
    }
    environment = {"env": variables, "cwd": tmp_path}
    if shell == "fish":
        completed = complete_in_fish([line for line, _ in LINES], environment)
    else:
        name, text = START_FILES[shell]
        (tmp_path / name).write_text(text)
        words = {"bash": ["bash", "--rcfile", name, "-i"], "zsh": ["zsh", "-d", "-i"]}[shell]
        completed = complete_in_terminal(words, [line for line, _ in LINES], environment)
    assert completed == [line for _, line in LINES]
