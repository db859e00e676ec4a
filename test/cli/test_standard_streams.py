"""Standard streams of the commands: full disks, readers that end, closed streams, and interrupts."""

import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from asserting_accessors import required
from subprocess_python_path import python_path
from subprocess_timeouts import running

from retalis import BagWriter, Definitions

SOURCE = Path(__file__).resolve().parents[2] / "src"
FULL_DISK = "retalis: cannot write standard output: No space left on device\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a program, a stream of events and a bag."""
    folder = tmp_path_factory.mktemp("streams")
    (folder / "rules.txt").write_text("hot(T) <- temp(T) where T > 38.\n")
    (folder / "stream.txt").write_text("".join(f"event(temp(39.{n}), [{n},{n}]).\n" for n in range(1, 500)))
    program = folder / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="in" msg_type="std_msgs/Int32"/>'
        '<publish_to name="out" msg_type="std_msgs/Int32"/></publish_subscribe>'
    )
    (program / "goalPredicates.txt").write_text("subscribe(std_msgs__0__Int32(_), [], _, out, o)\n")
    definition = Definitions().find("std_msgs/Int32")
    with BagWriter(folder / "some.bag") as bag:
        connection = bag.add("/in", definition)
        for number in range(500):
            bag.write(connection, 10**9 + number, number.to_bytes(4, "little"))
    return folder


def run(folder: Any, arguments: str, **options: Any) -> Any:
    environment = {**os.environ, "PYTHONPATH": python_path()}
    return subprocess.run(
        [sys.executable, "-m", "retalis", *shlex.split(arguments)],
        cwd=folder,
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
        **options,
    )


COMMANDS = (
    "events --rules rules.txt --stream stream.txt",
    "bag some.bag --program program",
    "bag some.bag --program program --events --json",
    "check program",
    "graph program",
    "help missing",
    "--help",
    "bag --help",
    "--version",
)


@pytest.mark.slow
@pytest.mark.parametrize("arguments", COMMANDS)
def test_full_disk_is_an_error(folder: Path, arguments: str) -> None:
    with open("/dev/full", "w") as full:
        process = run(folder, arguments, stdin=subprocess.DEVNULL, stdout=full)
    assert (process.stderr, process.returncode) == (FULL_DISK, 1)


@pytest.mark.slow
def test_full_disk_is_an_error_in_console(folder: Path) -> None:
    with open("/dev/full", "w") as full:
        process = run(folder, "console", input="X = 1.\nX = 2.\n", stdout=full)
    assert (process.stderr, process.returncode) == (FULL_DISK, 1)


@pytest.mark.slow
@pytest.mark.parametrize("arguments", COMMANDS[:3])
def test_closed_reader_is_no_error(folder: Path, arguments: Any) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        process = run(folder, arguments, stdin=subprocess.DEVNULL, stdout=writing)
    finally:
        os.close(writing)
    assert (process.stderr, process.returncode) == ("", 1)


@pytest.mark.slow
@pytest.mark.parametrize("arguments", ["console", "events --rules rules.txt --stream -", "check program"])
def test_closed_standard_input_is_empty(folder: Path, arguments: str) -> None:
    process = run(folder, arguments, stdout=subprocess.PIPE, preexec_fn=lambda: os.close(0))
    assert (process.stderr, process.returncode) == ("", 0)


@pytest.mark.slow
def test_closed_standard_output_changes_no_file(folder: Path) -> None:
    page = folder / "run.html"
    process = run(folder, f"plot some.bag --program program -o {page}", preexec_fn=lambda: os.close(1))
    assert (process.stderr, process.returncode) == ("", 0)
    assert page.read_text().rstrip().endswith("</html>")


@pytest.mark.slow
@pytest.mark.parametrize(
    "module", ["retalis.cli.command_line", "retalis.engine.engine", "retalis.playback.playback"]
)
def test_interrupt_of_import_has_status_130(folder: Path, module: str) -> None:
    # The import of a module sends the signal, so that the test depends on no duration.
    program = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == {module!r}: os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "import retalis.__main__\n"
        "sys.exit(retalis.__main__.main())\n"
    )
    process = subprocess.run(
        [sys.executable, "-c", program, "bag", "some.bag", "--program", "program"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": python_path()},
        capture_output=True,
        text=True,
        timeout=60,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert (process.stdout, process.stderr, process.returncode) == ("", "", 130)


@pytest.mark.slow
@pytest.mark.parametrize("is_piped", [True, False])
def test_interrupt_of_goal_has_status_130(folder: Path, is_piped: bool) -> None:
    goal = "write(started), nl, repeat, fail."
    with running(
        [sys.executable, "-m", "retalis", "console", *([] if is_piped else ["--goal", goal])],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": python_path()},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as command:
        if is_piped:
            commands = required(command.stdin)
            commands.write(f"{goal}\ntrue.\n")
            commands.flush()
        assert required(command.stdout).readline() == "started\n"
        command.send_signal(signal.SIGINT)
        output, errors = command.communicate(timeout=60)
    assert (output, errors, command.returncode) == ("", "", 130)
