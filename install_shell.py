"""Commands of `install.py`: the environment they get, and their output in a log or on the terminal.

As a program, run a command with nothing of the environment but what `minimal` keeps:
``python3 install_shell.py COMMAND ARGUMENT...``. Needs Python 3.8 only.
"""

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import IO, Callable, Dict, Mapping, Optional, Sequence

TAIL = 15  # lines of a log shown when a step fails

_KEPT = """
    HOME USER LOGNAME PATH LANG LANGUAGE LC_ALL LC_CTYPE LC_MESSAGES TERM TMPDIR XDG_CACHE_HOME CI DEBIAN_FRONTEND
    HTTP_PROXY HTTPS_PROXY FTP_PROXY ALL_PROXY NO_PROXY http_proxy https_proxy ftp_proxy all_proxy no_proxy
    SSL_CERT_FILE SSL_CERT_DIR REQUESTS_CA_BUNDLE CURL_CA_BUNDLE PIP_CERT PIP_CONFIG_FILE
    """
KEPT = frozenset(_KEPT.split())
"""Variables that the tests are run with: places, language, and how to get at the network. pip reads the rest from its
configuration files."""

OWN = "RETALIS_"
"""Prefix of the variables of this package, which are kept too."""

SYSTEM_FOLDERS = ("/usr/bin", "/bin", "/usr/sbin", "/sbin")
"""Where programs are. `su` and `env -i` leave the last two out, without which root cannot install a package."""


class Problem(Exception):
    """Something that ends the run; its text is one line for the user."""


def minimal(environ: Mapping[str, str]) -> Dict[str, str]:
    """Return the part of an environment that the result of a test may depend on.

    A shell has more: PYTHONUNBUFFERED and its like, another ROS that was sourced, options of pip. With those, tests
    pass that fail where they are not set, or the other way round.
    """
    return {name: value for name, value in environ.items() if name in KEPT or name.startswith(OWN)}


def search_path(path: str) -> str:
    """Return a PATH that begins with the distribution's programs and has all of its folders."""
    given = [folder for folder in path.split(os.pathsep) if folder]  # an empty one is the current folder
    behind = [folder for folder in SYSTEM_FOLDERS if folder not in given]
    return os.pathsep.join(dict.fromkeys(["/usr/bin", *given, *behind]))


def tail(text: str, count: int = TAIL) -> str:
    """Return the last lines of a text, indented."""
    return "\n".join("    " + line for line in text.rstrip().splitlines()[-count:])


def stop(process: "subprocess.Popen[bytes]") -> None:
    """End a process that was started here, first asking, then telling it."""
    for number, patience in ((signal.SIGINT, 20), (signal.SIGTERM, 5), (signal.SIGKILL, 5)):
        try:
            process.send_signal(number)
        except PermissionError:  # sudo's: the terminal has told it
            pass
        try:
            process.wait(patience)
            return
        except subprocess.TimeoutExpired:
            continue


class Line:
    """A line for the user that says what is being done; on a terminal also for how many seconds."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._begin = time.monotonic()
        print(title + " ...", end="", flush=True)

    def tick(self) -> None:
        """Show the seconds so far."""
        if sys.stdout.isatty():
            print(f"\r{self._title} ... {self._seconds()}", end="", flush=True)

    def end(self, result: str) -> None:
        """Show the result and end the line."""
        begin = f"\r{self._title} ..." if sys.stdout.isatty() else ""
        print(f"{begin} {result} ({self._seconds()})", flush=True)

    def _seconds(self) -> str:
        return f"{time.monotonic() - self._begin:.0f} s"


class Shell:
    """Runs commands: quietly with a log for each, or before the user's eyes."""

    def __init__(self, logs: Path, dry: bool = False) -> None:
        self.logs = logs
        self.dry = dry

    def step(self, title: str, name: str, command: Sequence[str], cwd: Optional[Path] = None) -> None:
        """Run a command with its output in a log, one line for the user.

        Raises:
            Problem: It failed; the end of its log is printed and the log named.
        """
        if self.dry:
            print("would run: " + " ".join(map(shlex.quote, command)))
            return
        self.logs.mkdir(parents=True, exist_ok=True)
        log = self.logs / (name + ".log")
        line = Line(title)
        with log.open("wb") as output:
            code = self._wait(command, cwd, output, line.tick)
        line.end("failed" if code else "done")
        if code:
            print(tail(log.read_text(errors="replace")), file=sys.stderr)
            raise Problem(f"{name} failed with exit status {code}; all of its output is in {log}")

    def show(self, command: Sequence[str], cwd: Optional[Path] = None) -> int:
        """Run a command before the user's eyes and return its exit status."""
        if self.dry:
            print("would run: " + " ".join(map(shlex.quote, command)))
            return 0
        return self._wait(command, cwd)

    @staticmethod
    def _wait(
        command: Sequence[str],
        cwd: Optional[Path],
        output: Optional[IO[bytes]] = None,
        tick: Callable[[], None] = lambda: None,
    ) -> int:
        errors = None if output is None else subprocess.STDOUT
        try:
            process = subprocess.Popen(command, cwd=cwd, stdout=output, stderr=errors)
        except FileNotFoundError:
            raise Problem(f"{command[0]} is not installed") from None
        try:
            while True:
                try:
                    return process.wait(1)
                except subprocess.TimeoutExpired:
                    tick()
        except KeyboardInterrupt:
            try:
                process.wait(5)  # the terminal has told the command as well
            except subprocess.TimeoutExpired:
                stop(process)
            raise


if __name__ == "__main__":
    os.execvpe(sys.argv[1], sys.argv[1:], minimal(os.environ))
