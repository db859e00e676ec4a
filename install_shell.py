"""Execution of commands for `install.py`: environment, logs, and progress on the terminal.

As a program, it runs a command with only the environment variables that `minimal_environment` keeps:
``python3 install_shell.py COMMAND ARGUMENT...``. Needs only Python 3.8.
"""

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import IO, Callable, Dict, List, Mapping, Optional, Sequence

SHOWN_LOG_LINES = 15  # lines of a log shown when a step fails

_KEPT = """
    HOME USER LOGNAME PATH LANG LANGUAGE LC_ALL LC_CTYPE LC_MESSAGES TERM TMPDIR XDG_CACHE_HOME CI DEBIAN_FRONTEND
    HTTP_PROXY HTTPS_PROXY FTP_PROXY ALL_PROXY NO_PROXY http_proxy https_proxy ftp_proxy all_proxy no_proxy
    SSL_CERT_FILE SSL_CERT_DIR REQUESTS_CA_BUNDLE CURL_CA_BUNDLE PIP_CERT PIP_CONFIG_FILE
    """
KEPT_VARIABLES = frozenset(_KEPT.split())
"""Environment variables of the tests: folders, language, and network access. pip reads the rest from its
configuration files."""

PACKAGE_PREFIX = "RETALIS_"
"""Prefix of this package's environment variables, which are kept, too."""

SYSTEM_FOLDERS = ("/usr/bin", "/bin", "/usr/sbin", "/sbin")
"""Program folders. `su` and `env -i` omit the last two, without which root cannot install packages."""


MAX_END_SECONDS = 30
"""Longest wait for a command to end after ctrl-C: pytest first ends its workers."""


class Problem(Exception):
    """Error that ends the program; its text is one line for the user."""


def minimal_environment(environ: Mapping[str, str]) -> Dict[str, str]:
    """Return the variables of an environment that test results may depend on.

    Shells have further ones, for example PYTHONUNBUFFERED, another ROS that was sourced, or pip options. With them,
    tests would pass in one shell and fail in another.
    """
    return {
        name: value
        for name, value in environ.items()
        if name in KEPT_VARIABLES or name.startswith(PACKAGE_PREFIX)
    }


def search_path(path: str) -> str:
    """Return a PATH that begins with ``/usr/bin`` and contains all `SYSTEM_FOLDERS`."""
    folders = [folder for folder in path.split(os.pathsep) if folder]  # an empty one is the current folder
    missing = [folder for folder in SYSTEM_FOLDERS if folder not in folders]
    return os.pathsep.join(dict.fromkeys(["/usr/bin", *folders, *missing]))


def tail(text: str, count: int = SHOWN_LOG_LINES) -> str:
    """Return the last lines of a text, indented."""
    return "\n".join("    " + line for line in text.rstrip().splitlines()[-count:])


def format_source_line(script: str) -> str:
    """Return a line of bash that sources a script.

    A sourced script sees the arguments of the shell, and catkin's acts on options such as ``--help``; inside a
    function without arguments it sees none.
    """
    return "sourced() { source " + shlex.quote(script) + "; } && sourced"


def make_bash_command(lines: Sequence[str], command: Sequence[str]) -> List[str]:
    """Return a command that runs a shell script with another command as its arguments."""
    return ["bash", "-c", " && ".join(lines), "bash", *command]


def stop(process: "subprocess.Popen[bytes]") -> None:
    """End a child process with increasingly strong signals."""
    for signal_number, timeout in ((signal.SIGINT, 20), (signal.SIGTERM, 5), (signal.SIGKILL, 5)):
        try:
            process.send_signal(signal_number)
        except PermissionError:  # A process of sudo, which gets the signal from the terminal.
            pass
        try:
            process.wait(timeout)
            return
        except subprocess.TimeoutExpired:
            continue


class ProgressLine:
    """Progress line with the title of a step; on a terminal also its duration in seconds."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._begin = time.monotonic()
        print(title + " ...", end="", flush=True)

    def tick(self) -> None:
        """Update the duration."""
        if sys.stdout.isatty():
            print(f"\r{self._title} ... {self._seconds()}", end="", flush=True)

    def end(self, result: str) -> None:
        """Print the result and end the line."""
        begin = f"\r{self._title} ..." if sys.stdout.isatty() else ""
        print(f"{begin} {result} ({self._seconds()})", flush=True)

    def _seconds(self) -> str:
        return f"{time.monotonic() - self._begin:.0f} s"


class Shell:
    """Runs commands, each with its output in a log or on the terminal."""

    def __init__(self, logs: Path, dry: bool = False) -> None:
        self.logs = logs
        self.dry = dry

    def run_logged(self, title: str, name: str, command: Sequence[str], cwd: Optional[Path] = None) -> None:
        """Run a command with its output in a log, and print one progress line.

        Raises:
            Problem: if it fails; the end of its log is printed.
        """
        if self.dry:
            print("would run: " + " ".join(map(shlex.quote, command)))
            return
        self.logs.mkdir(parents=True, exist_ok=True)
        log = self.logs / (name + ".log")
        line = ProgressLine(title)
        with log.open("wb") as output:
            code = self._wait(command, cwd, output, line.tick)
        line.end("failed" if code else "done")
        if code:
            print(tail(log.read_text(errors="replace")), file=sys.stderr)
            raise Problem(f"{name} failed with exit status {code}; all of its output is in {log}")

    def run_visible(self, command: Sequence[str], cwd: Optional[Path] = None) -> int:
        """Run a command with its output on the terminal; return its exit status."""
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
                # The terminal has sent the signal to the command, too. A second one would interrupt its end.
                process.wait(MAX_END_SECONDS)
            except subprocess.TimeoutExpired:
                stop(process)
            raise


if __name__ == "__main__":
    os.execvpe(sys.argv[1], sys.argv[1:], minimal_environment(os.environ))
