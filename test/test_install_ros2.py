"""Installation of ROS 2 by `install.py`: steps, their repetition, arguments, and the wheels' CMake files."""

import importlib
import os
import subprocess
from pathlib import Path
from typing import Any, Iterator, List
from unittest.mock import patch

import pytest

HERE = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def install_ros2() -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.syspath_prepend(str(HERE))
        yield importlib.import_module("install_ros2")


@pytest.fixture(scope="module")
def install(install_ros2: Any) -> Any:
    return importlib.import_module("install")


@pytest.fixture(autouse=True)
def environment() -> Iterator[Any]:
    """Restore the environment variables, because `install.main` removes some of them."""
    with patch.dict(os.environ):
        yield os.environ


class Recorder:
    """A shell that records the names of steps and visible commands; the step in `failure` fails."""

    dry = False

    def __init__(self, logs: Path, problem: Any) -> None:
        self.logs = logs
        self.steps: List[str] = []
        self.commands: List[Any] = []
        self.failure = ""
        self._problem = problem

    def run_logged(self, title: str, name: str, command: Any, cwd: Any = None) -> None:
        if not self.dry:
            self.steps.append(name)
        self.commands.append(command)
        if name == self.failure:
            raise self._problem(f"{name} failed")

    def run_visible(self, command: Any, cwd: Any = None) -> int:
        self.commands.append(command)
        return 0


@pytest.fixture
def shell(install_ros2: Any, tmp_path: Path) -> Recorder:
    return Recorder(tmp_path / "log", install_ros2.Problem)


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """Return a small source tree."""
    files = (
        "requirements.txt",
        "requirements-ros2-jazzy.txt",
        "package.xml",
        "msg/A.msg",
        "src/retalis/a.py",
    )
    for name in files:
        path = tmp_path / "sources" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{name}\n")
    return tmp_path / "sources"


@pytest.fixture
def installation(
    install_ros2: Any, shell: Recorder, sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Any:
    """Return an installation whose Python has headers in the folder `headers`."""
    headers = tmp_path / "headers"
    headers.mkdir()
    (headers / "Python.h").touch()

    def report_headers(command: Any, **options: Any) -> Any:
        return subprocess.CompletedProcess(command, 0, stdout=f"{headers}\n{headers}/numpy\n")

    monkeypatch.setattr(install_ros2.subprocess, "run", report_headers)
    folder = tmp_path / "workspace"
    installation = install_ros2.Ros2Installation("jazzy", folder, sources, "/usr/bin/python3", shell)
    (installation.venv / "share").mkdir(parents=True)
    return installation


PACKAGE_STEPS = ["ros2-venv", "ros2-pip", "ros2-pip-lark"]


def test_packages_are_installed_once(installation: Any, shell: Recorder, sources: Path) -> None:
    installation.install_python_packages()
    installation.install_python_packages()
    assert shell.steps == PACKAGE_STEPS
    (sources / "requirements-ros2-jazzy.txt").write_text("rclpy==2\n")
    installation.install_python_packages()
    assert shell.steps == 2 * PACKAGE_STEPS


def test_failed_installation_is_repeated(
    install_ros2: Any, installation: Any, shell: Recorder, sources: Path
) -> None:
    installation.install_python_packages()
    requirements = (sources / "requirements.txt").read_text()
    (sources / "requirements.txt").write_text("other\n")
    shell.failure = "ros2-pip"
    with pytest.raises(install_ros2.Problem, match="ros2-pip failed"):
        installation.install_python_packages()
    shell.failure = ""
    shell.steps.clear()
    # The environment has been cleared, so the earlier installation does not count either.
    (sources / "requirements.txt").write_text(requirements)
    installation.install_python_packages()
    assert shell.steps == PACKAGE_STEPS


def test_missing_headers_are_an_error(install_ros2: Any, installation: Any, tmp_path: Path) -> None:
    (tmp_path / "headers" / "Python.h").unlink()
    with pytest.raises(install_ros2.Problem, match="Python.h is missing: install the package python3-dev"):
        installation.install_python_packages()


@pytest.mark.parametrize(
    ("name", "is_built"),
    [("src/retalis/a.py", False), ("src/retalis/new.py", True), ("msg/A.msg", True), ("msg/New.msg", True)],
)
def test_build_is_repeated_if_its_inputs_change(
    installation: Any, shell: Recorder, sources: Path, name: str, is_built: bool
) -> None:
    installation.build()
    installation.build()
    assert shell.steps == ["colcon"]
    (sources / name).write_text("changed\n")
    installation.build()
    assert (shell.steps == ["colcon", "colcon"]) == is_built


def test_failed_build_is_repeated(
    install_ros2: Any, installation: Any, shell: Recorder, sources: Path
) -> None:
    installation.build()
    text = (sources / "msg" / "A.msg").read_text()
    (sources / "msg" / "A.msg").write_text("wrong\n")
    shell.failure = "colcon"
    with pytest.raises(install_ros2.Problem, match="colcon failed"):
        installation.build()
    shell.failure = ""
    (sources / "msg" / "A.msg").write_text(text)
    installation.build()
    assert shell.steps == ["colcon"] * 3


def test_build_removes_files_of_former_build(installation: Any) -> None:
    removed = installation.folder / "install" / "removed.py"
    removed.parent.mkdir(parents=True)
    removed.touch()
    installation.build()
    assert not removed.exists()


@pytest.mark.parametrize("is_installed", [False, True])
@pytest.mark.parametrize(
    ("package", "definition"),
    [("tf2_msgs", "msg/TFMessage.msg"), ("example_interfaces", "action/Fibonacci.action")],
)
def test_packages_that_wheels_lack_are_built(
    installation: Any, package: str, definition: str, is_installed: bool
) -> None:
    if is_installed:
        (installation.venv / "share" / package).mkdir()
    installation.build()
    assert (installation.folder / "src" / package / definition).exists() == (not is_installed)
    (command,) = installation.shell.commands
    assert (package in command) == (not is_installed)


def test_commands_run_in_environment_of_ros2(installation: Any) -> None:
    installation.build()
    (command,) = installation.shell.commands
    process = subprocess.Popen(
        [*command[: command.index("colcon")], "printenv", "ROS_VERSION", "AMENT_PREFIX_PATH", "ROS_DISTRO"],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.communicate()[0].split() == ["2", str(installation.venv), "jazzy"]


def test_dry_run_writes_nothing(installation: Any, shell: Recorder) -> None:
    shell.dry = True
    before = sorted(installation.folder.rglob("*"))
    installation.install_python_packages()
    installation.build()
    assert sorted(installation.folder.rglob("*")) == before
    assert [command[0] for command in shell.commands] == [
        "/usr/bin/python3",
        *[f"{installation.venv}/bin/python3"] * 2,
        "bash",
    ]


def test_include_folders_of_wheels_are_replaced(install_ros2: Any, tmp_path: Path) -> None:
    export = tmp_path / "msgs" / "cmake" / "export.cmake"
    export.parent.mkdir(parents=True)
    other = tmp_path / "other.cmake"
    built = "/opt/python/cp311-cp311"
    export.write_text(
        f'  DIRECTORIES "{built}/include/python3.11;{built}/lib/python3.11/site-packages/numpy/_core/include"\n'
    )
    other.write_text('set(_INCLUDE "${prefix}/include")\n')
    install_ros2.replace_include_folders(tmp_path, "/usr/include/python3.11", "/venv/numpy/_core/include")
    install_ros2.replace_include_folders(tmp_path, "/usr/include/python3.11", "/venv/numpy/_core/include")
    assert export.read_text() == '  DIRECTORIES "/usr/include/python3.11;/venv/numpy/_core/include"\n'
    assert other.read_text() == 'set(_INCLUDE "${prefix}/include")\n'


@pytest.mark.parametrize("distribution", ["jazzy", "kilted"])
def test_wheels_have_exact_versions(distribution: str) -> None:
    lines = (HERE / f"requirements-ros2-{distribution}.txt").read_text().splitlines()
    wheels = [line for line in lines if line.startswith("ros-")]
    assert all(line.startswith(f"ros-{distribution}-") and "==" in line for line in wheels)
    assert any(line.startswith(f"ros-{distribution}-rclpy==") for line in wheels)


# ---- command line


@pytest.mark.parametrize(
    ("argv", "distribution", "passed"),
    [
        (["test"], None, []),
        (["test", "--ros2"], "jazzy", []),
        (["--ros2", "test", "-k", "x"], "jazzy", ["-k", "x"]),
        (["test", "--ros2", "test/ros2/test_x.py"], "jazzy", ["test/ros2/test_x.py"]),
        (["test", "--ros2=kilted"], "kilted", []),
    ],
)
def test_option_chooses_distribution(
    install: Any, argv: List[str], distribution: Any, passed: List[str]
) -> None:
    options = install.parse_arguments(argv)
    assert (options.command, options.ros2, options.passed_arguments) == ("test", distribution, passed)


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["lint", "--ros2"], "'lint' has no option --ros2: expected it with build, demo, test, where"),
        (["build", "--ros2=humble"], "invalid choice: 'humble'"),
    ],
)
def test_wrong_option_is_usage_error(
    install: Any, argv: List[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        install.parse_arguments(argv)
    assert message in capsys.readouterr().err


@pytest.fixture
def run(install: Any, shell: Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that runs install.py on Debian 12, with ROS 2 installed."""
    monkeypatch.setattr(install, "Shell", lambda logs, dry: shell)
    monkeypatch.setattr(install, "parse_os_release", lambda text: {"ID": "debian", "VERSION_ID": "12"})
    for owner, step in (
        (install.Installation, "install_system_packages"),
        (install.Ros2Installation, "install_python_packages"),
        (install.Ros2Installation, "build"),
    ):
        monkeypatch.setattr(owner, step, lambda *_: None)

    def run(*argv: str) -> Any:
        return install.main(["--workspace", str(tmp_path / "workspace"), *argv])

    return run


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], ["-n", "3", "--dist", "worksteal", "test/ros2"]),
        (["-n0", "-k", "tf"], ["-n0", "-k", "tf", "test/ros2"]),
        (["test/test_install.py::test_x"], ["test/test_install.py::test_x"]),
    ],
)
def test_tests_of_ros2_are_default(run: Any, shell: Recorder, arguments: Any, expected: Any) -> None:
    assert run("test", "--ros2", *arguments) == 0
    (command,) = shell.commands
    assert command[command.index("pytest") + 1 :] == expected


def test_demo_of_ros2_gets_arguments(run: Any, shell: Recorder) -> None:
    assert run("demo", "--ros2", "--seconds", "5") == 0
    (command,) = shell.commands
    assert command[-3:] == [str(HERE / "examples" / "nao" / "demo_ros2.py"), "--seconds", "5"]


def test_build_names_setup_file(run: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("build", "--ros2") == 0
    setup = tmp_path / "workspace" / "ros2-jazzy" / "setup.bash"
    assert f"source {setup}\n" in capsys.readouterr().out


def test_other_system_is_an_error(install: Any, run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    release = {"ID": "ubuntu", "VERSION_ID": "20.04", "PRETTY_NAME": "Ubuntu 20.04"}
    monkeypatch.setattr(install, "parse_os_release", lambda text: release)
    with pytest.raises(install.Problem, match=r"this is Ubuntu 20.04: expected Debian 12 with --ros2"):
        run("build", "--ros2")


def test_command_where_prints_setup_of_ros2(
    install: Any, run: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(install.Problem, match="nothing has been built yet"):
        run("where", "--ros2")
    setup = tmp_path / "workspace" / "ros2-jazzy" / "setup.bash"
    setup.parent.mkdir(parents=True)
    setup.touch()
    assert run("where", "--ros2") == 0
    assert capsys.readouterr().out == f"{setup}\n"
    assert run("where", "zsh", "--ros2") == 0
    assert capsys.readouterr().out == f"{setup.with_suffix('.zsh')}\n"


def test_setup_scripts_are_written_for_all_shells(
    install_ros2: Any, shell: Recorder, sources: Path, tmp_path: Path
) -> None:
    installation = install_ros2.Ros2Installation("jazzy", tmp_path, sources, "/usr/bin/python3", shell)
    installation.build()
    for name in ("bash", "zsh", "sh"):
        text = installation.setup.with_suffix(f".{name}").read_text()
        assert f"export AMENT_PREFIX_PATH={installation.venv} " in text
        assert text.endswith(f"  . {installation.folder / 'install' / f'local_setup.{name}'}\nfi\n")
    # They are written again if they are missing, without another build.
    installation.setup.unlink()
    built = list(shell.steps)
    installation.build()
    assert installation.setup.exists()
    assert shell.steps == built


def test_uninstall_removes_ros2(install: Any, run: Any, tmp_path: Path) -> None:
    run("build", "--ros2")
    (tmp_path / "workspace" / "ros2-jazzy" / "venv").mkdir(parents=True)
    assert run("uninstall") == 0
    assert not (tmp_path / "workspace").exists()
