"""Execution of commands by ``install_shell.py``: logs, failures, interrupts, and the environment."""

import importlib
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, Iterator, List

import pytest
from asserting_accessors import required

HERE = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def shell() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(HERE))
        yield importlib.import_module("install_shell")


def test_tail_is_indented(shell: ModuleType) -> None:
    assert shell.tail("1\n2\n3\n\n", 2) == "    2\n    3"


def test_step_writes_log_and_prints_title(
    shell: ModuleType, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    shell.Shell(tmp_path / "log").run_logged("Talking", "talk", [sys.executable, "-c", "print('hello')"])
    assert (tmp_path / "log" / "talk.log").read_text() == "hello\n"
    out, err = capfd.readouterr()
    assert out.startswith("Talking ... done (")
    assert "hello" not in out
    assert err == ""


def test_failed_step_prints_end_of_log(
    shell: ModuleType, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    failing = [sys.executable, "-c", "print('reason'); raise SystemExit(3)"]
    with pytest.raises(shell.Problem, match=r"talk failed with exit status 3; .*talk\.log"):
        shell.Shell(tmp_path).run_logged("Talking", "talk", failing)
    out, err = capfd.readouterr()
    assert "failed (" in out
    assert err == "    reason\n"


def test_unknown_program_is_an_error(shell: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(shell.Problem, match="no-such-program is not installed"):
        shell.Shell(tmp_path).run_logged("Talking", "talk", ["no-such-program"])


def test_dry_run_runs_nothing(shell: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = shell.Shell(tmp_path / "log", dry=True)
    runs.run_logged("Talking", "talk", ["touch", str(tmp_path / "a b")])
    assert runs.run_visible(["touch", str(tmp_path / "c")]) == 0
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr().out.startswith("would run: touch '")


INTERRUPTIBLE = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
try:
    print("up", flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    sys.exit(7)
"""


def test_stop_interrupts_process(shell: ModuleType) -> None:
    process = subprocess.Popen([sys.executable, "-c", INTERRUPTIBLE], stdout=subprocess.PIPE)
    output = required(process.stdout)
    output.readline()
    shell.stop(process)
    output.close()
    assert process.returncode == 7


def test_interrupt_ends_command(shell: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped: List[Any] = []

    def stop(process: Any) -> None:
        stopped.append(process)
        process.kill()
        process.wait()

    monkeypatch.setattr(shell, "stop", stop)

    class Interrupted(subprocess.Popen):
        wait_count = 0

        def wait(self, timeout: Any = None) -> int:
            self.wait_count += 1
            if self.wait_count == 1:
                raise KeyboardInterrupt
            if self.wait_count == 2:
                raise subprocess.TimeoutExpired(self.args, timeout)
            return super().wait(timeout)

    monkeypatch.setattr(shell.subprocess, "Popen", Interrupted)
    with pytest.raises(KeyboardInterrupt):
        shell.Shell(tmp_path).run_visible([sys.executable, "-c", "import time; time.sleep(60)"])
    assert len(stopped) == 1
    assert stopped[0].returncode is not None


KEPT_VARIABLES = {
    "HOME": "/home/me",
    "PATH": "/opt/bin:/usr/bin",
    "LC_ALL": "C.UTF-8",
    "https_proxy": "http://proxy.invalid:3128",
    "HTTPS_PROXY": "http://proxy.invalid:3128",
    "SSL_CERT_FILE": "/etc/ssl/own.crt",
    "PIP_CERT": "/etc/ssl/own.crt",
    "RETALIS_TEST_SWI": "1",
    "CI": "true",
}
REMOVED_VARIABLES = {
    "PYTHONUNBUFFERED": "1",
    "PYTHONDONTWRITEBYTECODE": "1",
    "PYTHONPATH": "/opt/ros/noetic/lib/python3/dist-packages",
    "PIP_INDEX_URL": "http://index.invalid",
    "ROS_MASTER_URI": "http://robot.invalid:11311",
    "ROS_PACKAGE_PATH": "/opt/ros/noetic/share",
    "CMAKE_PREFIX_PATH": "/opt/ros/noetic",
    "COLUMNS": "40",
}


def test_minimal_environment_has_kept_variables_only(shell: ModuleType) -> None:
    assert shell.minimal_environment({**KEPT_VARIABLES, **REMOVED_VARIABLES}) == KEPT_VARIABLES


def test_script_runs_command_in_minimal_environment() -> None:
    program = [sys.executable, str(HERE / "install_shell.py"), sys.executable, "-c"]
    script = "import os, sys; print(sys.argv[1:], sorted(os.environ.keys() & set(sys.argv[2].split())))"
    names = " ".join([*KEPT_VARIABLES, *REMOVED_VARIABLES])
    output = subprocess.check_output(
        [*program, script, "a b", names], env={**KEPT_VARIABLES, **REMOVED_VARIABLES}, text=True
    )
    assert output == f"{['a b', names]} {sorted(KEPT_VARIABLES)}\n"


def test_search_path_begins_with_distribution(shell: ModuleType) -> None:
    assert shell.search_path("/opt/bin:/usr/bin:/bin") == "/usr/bin:/opt/bin:/bin:/usr/sbin:/sbin"
    assert shell.search_path("") == "/usr/bin:/bin:/usr/sbin:/sbin"
