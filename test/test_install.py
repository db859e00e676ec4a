"""Installation script: platforms, packages, arguments, lint, documentation site, and removal."""

import importlib
import io
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, Dict, Iterator, List, Optional, Tuple
from unittest.mock import patch

import pytest
from asserting_accessors import required

HERE = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def install() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(HERE))
        yield importlib.import_module("install")


@pytest.fixture(autouse=True)
def environment() -> Iterator[Any]:
    """Restore the environment variables, because `install.main` removes some of them."""
    with patch.dict(os.environ):
        yield os.environ


@pytest.fixture(scope="module")
def apt(install: ModuleType) -> ModuleType:
    return importlib.import_module("install_apt")


def test_os_release_is_parsed(install: ModuleType) -> None:
    text = '# made by hand\nID=debian\nVERSION_ID="12"\nPRETTY_NAME="Debian GNU/Linux 12 (bookworm)"\n\n'
    assert install.parse_os_release(text) == {
        "ID": "debian",
        "VERSION_ID": "12",
        "PRETTY_NAME": "Debian GNU/Linux 12 (bookworm)",
    }


@pytest.mark.parametrize(
    ("release", "name"),
    [
        ({"ID": "debian", "VERSION_ID": "12"}, "Debian 12"),
        ({"ID": "ubuntu", "VERSION_ID": "20.04"}, "Ubuntu 20.04"),
    ],
)
def test_known_platform_is_chosen(install: ModuleType, release: Dict[str, Any], name: str) -> None:
    assert install.choose_platform(release).name == name


def test_unknown_platform_is_an_error_with_advice(install: ModuleType) -> None:
    with pytest.raises(install.Problem, match=r"this is Arch Linux; .*/bin/retalis demo") as raised:
        install.choose_platform({"ID": "arch", "PRETTY_NAME": "Arch Linux"})
    assert "\n" not in str(raised.value)


def test_platforms_name_each_package_once(install: ModuleType) -> None:
    for platform in install.PLATFORMS.values():
        packages = [*platform.packages, *platform.test_packages, install.SWI_PACKAGE]
        assert len(set(packages)) == len(packages)


def test_missing_packages_keep_order(install: ModuleType) -> None:
    report = "b install ok installed\nc deinstall ok config-files\n"
    assert install.find_missing_packages(["d", "c", "b", "a"], report) == ["d", "c", "a"]


def test_sudo_is_used_without_root_only(install: ModuleType) -> None:
    assert install.prefix_sudo(["apt-get", "update"], 0) == ["apt-get", "update"]
    assert install.prefix_sudo(["apt-get", "update"], 1000) == ["sudo", "apt-get", "update"]


def test_digest_depends_on_separation_of_texts(install: ModuleType) -> None:
    assert install.short_digest("ab", "c") != install.short_digest("a", "bc")
    assert install.short_digest("ab", "c") == install.short_digest("ab", "c")


def test_bash_command_quotes_arguments(install: ModuleType) -> None:
    command = install.make_bash_command(["X=1", 'exec "$@"'], ["printf", "%s|", "a b", "$X", "'"])
    assert subprocess.check_output(command) == b"a b|$X|'|"


def test_sourced_script_has_no_arguments(install: ModuleType, tmp_path: Path) -> None:
    script = tmp_path / "set up.bash"
    script.write_text('seen="$*"\n', encoding="utf-8")
    command = install.make_bash_command(
        [install.format_source_line(str(script)), 'printf "%s|" "$seen" "$@"'], ["--help", "a b"]
    )
    assert subprocess.check_output(command) == b"|--help|a b|"


def test_arguments_have_defaults_and_are_passed(install: ModuleType) -> None:
    options = install.parse_arguments([])
    assert (options.command, options.passed_arguments, options.dry_run) == ("build", [], False)
    assert options.workspace == install.default_workspace(HERE, os.environ).resolve()
    options = install.parse_arguments(["--workspace", "~/ws", "demo", "--bag", "x.bag", "--seconds", "5"])
    assert options.workspace == Path.home().resolve() / "ws"
    assert (options.command, options.passed_arguments) == ("demo", ["--bag", "x.bag", "--seconds", "5"])


def test_each_clone_has_own_workspace(install: ModuleType) -> None:
    home = {"HOME": "/home/me"}
    workspace = install.default_workspace(Path("/a/retalis"), home)
    assert str(workspace).startswith("/home/me/.cache/retalis/retalis-")
    assert workspace != install.default_workspace(Path("/b/retalis"), home)
    cache = {"HOME": "/home/me", "XDG_CACHE_HOME": "/cache"}
    assert install.default_workspace(Path("/a/retalis"), cache).parent == Path("/cache/retalis")


@pytest.mark.parametrize("folder", [".", "build/workspace"])
def test_workspace_within_clone_is_refused(
    install: ModuleType, folder: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        install.parse_arguments(["--workspace", str(HERE / folder)])
    assert "outside the package" in capsys.readouterr().err


@pytest.mark.parametrize("argv", [["lint", "--fast"], ["--fast"], ["buidl"]])
def test_invalid_arguments_are_usage_errors(
    install: ModuleType, argv: List[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as raised:
        install.parse_arguments(argv)
    assert raised.value.code == 2
    assert "install.py: error:" in capsys.readouterr().err


class Recorder:
    """A shell that records commands instead of running them."""

    dry = False

    def __init__(self, logs: Any) -> None:
        self.logs = logs
        self.commands: List[Any] = []

    def run_logged(self, title: Any, name: Any, command: Any, cwd: Any = None) -> None:
        self.commands.append(command)

    def run_visible(self, command: Any, cwd: Any = None) -> int:
        self.commands.append(command)
        return 0


def report_nothing_installed(*arguments: Any, **options: Any) -> Any:
    return subprocess.CompletedProcess(arguments, 1, stdout="")


@pytest.fixture
def noetic(install: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return an installation on Ubuntu 20.04 without ROS and without root."""
    platform = install.UBUNTU_20_04._replace(setup=str(tmp_path / "no" / "setup.bash"))
    monkeypatch.setattr(install.subprocess, "run", report_nothing_installed)
    monkeypatch.setattr(install.os, "getuid", lambda: 1000)
    return install.Installation(platform, tmp_path, Recorder(tmp_path / "log"))


def test_source_and_key_of_ros_precede_packages(
    install: ModuleType,
    apt: ModuleType,
    noetic: Any,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(install, "ros_source_lines", list)
    monkeypatch.setattr(
        apt.urllib.request, "urlopen", lambda url, timeout: io.BytesIO(b"key of " + url.encode())
    )
    noetic.install_system_packages()
    lines = [" ".join(command) for command in noetic.shell.commands]
    assert lines[0] == "sudo -v"
    assert lines[1].startswith("sudo install -m 644 ")
    assert lines[1].endswith(install.KEY_FILE)
    assert lines[2].startswith("sudo install -m 644 ")
    assert lines[2].endswith(install.SOURCE_FILE)
    assert lines[3] == "sudo env DEBIAN_FRONTEND=noninteractive apt-get update"
    assert "ros-noetic-rospy" in lines[4]
    source = (noetic.shell.logs / Path(install.SOURCE_FILE).name).read_text()
    assert source == f"deb [signed-by={install.KEY_FILE}] http://packages.ros.org/ros/ubuntu focal main\n"
    output = capsys.readouterr().out
    assert install.SOURCE_FILE in output
    assert "ros-noetic-rospy" in output


def test_missing_key_is_an_error_with_advice(
    install: ModuleType, apt: ModuleType, noetic: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(url: Any, timeout: Any) -> None:
        raise OSError("no route")

    monkeypatch.setattr(install, "ros_source_lines", list)
    monkeypatch.setattr(apt.urllib.request, "urlopen", refuse)
    with pytest.raises(install.Problem, match=r"no key for packages.ros.org \(no route\); add it as http"):
        noetic.install_system_packages()


def test_certificates_precede_key(
    install: ModuleType, apt: ModuleType, noetic: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(install, "ros_source_lines", list)
    monkeypatch.setattr(install, "CERTIFICATES", str(tmp_path / "none"))
    monkeypatch.setattr(apt.urllib.request, "urlopen", lambda url, timeout: io.BytesIO(b"key"))
    noetic.install_system_packages()
    lines = [" ".join(command) for command in noetic.shell.commands]
    assert lines[1].endswith("apt-get update")
    assert lines[2].endswith("install -y --no-install-recommends ca-certificates")
    assert lines[3].endswith(install.KEY_FILE)


EXPIRED = """Hit:1 http://archive.ubuntu.com/ubuntu focal InRelease
Err:2 http://packages.ros.org/ros/ubuntu focal InRelease
  The following signatures were invalid: EXPKEYSIG F42ED6FBAB17C654 Open Robotics <info@osrfoundation.org>
W: An error occurred. GPG error: http://packages.ros.org/ros/ubuntu focal InRelease: EXPKEYSIG F42ED6FBAB17C654
"""
ARMOURED = b"""-----BEGIN PGP PUBLIC KEY BLOCK-----
Version: GnuPG v1

a2V5IG9m
IFJPUw==
=AAAA
-----END PGP PUBLIC KEY BLOCK-----
"""


@pytest.mark.parametrize(
    ("line", "key_file", "content"),
    [
        (
            "deb [arch=amd64 signed-by=/k/ros.gpg] http://packages.ros.org/ros/ubuntu f m",
            "/k/ros.gpg",
            b"key of ROS",
        ),
        ("deb [signed-by=/k/ros.asc] http://packages.ros.org/ros/ubuntu focal main", "/k/ros.asc", ARMOURED),
        ("deb http://packages.ros.org/ros/ubuntu focal main", None, ARMOURED),
    ],
)
@pytest.mark.parametrize("fails", [False, True])
def test_expired_key_is_replaced(
    install: ModuleType,
    apt: ModuleType,
    noetic: Any,
    monkeypatch: pytest.MonkeyPatch,
    line: str,
    key_file: Optional[str],
    content: bytes,
    fails: bool,
) -> None:
    monkeypatch.setattr(install, "ros_source_lines", lambda: [line])
    monkeypatch.setattr(apt.urllib.request, "urlopen", lambda url, timeout: io.BytesIO(ARMOURED))
    shell = noetic.shell
    record = shell.run_logged

    def run_logged(title: Any, name: Any, command: Any, cwd: Any = None) -> None:
        record(title, name, command, cwd)
        if name == "apt-update":
            shell.logs.mkdir(exist_ok=True)
            first = "again" not in title
            (shell.logs / "apt-update.log").write_text(EXPIRED if first else "")
            if first and fails:
                raise install.Problem("apt-update failed")

    shell.run_logged = run_logged
    noetic.install_system_packages()
    lines = [" ".join(command) for command in shell.commands]
    key_file = key_file or apt.DEFAULT_KEY_FILE
    assert lines[1].endswith("apt-get update")
    assert lines[2].startswith("sudo install -m 644 ")
    assert lines[2].endswith(" " + key_file)
    assert (shell.logs / Path(key_file).name).read_bytes() == content
    assert lines[3].endswith("apt-get update")
    assert "ros-noetic-rospy" in lines[4]


def test_other_failure_of_update_is_an_error(
    install: ModuleType, noetic: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        install, "ros_source_lines", lambda: ["deb http://packages.ros.org/ros/ubuntu focal main"]
    )

    def run_logged(title: Any, name: Any, command: Any, cwd: Any = None) -> None:
        raise install.Problem(f"{name} failed")

    noetic.shell.run_logged = run_logged
    with pytest.raises(install.Problem, match="apt-update failed"):
        noetic.install_system_packages()


UNREACHABLE = """Err:1 http://deb.debian.org/debian bookworm InRelease
  Temporary failure resolving 'deb.debian.org'
W: Failed to fetch http://deb.debian.org/debian/dists/bookworm/InRelease  Temporary failure resolving 'deb.debian.org'
"""


@pytest.mark.parametrize(
    ("update", "log"),
    [
        (UNREACHABLE, "E: Unable to locate package ros-noetic-catkin\n"),
        (UNREACHABLE, "E: Package 'catkin' has no installation candidate\n"),
        ("", "Err:1 http://deb\n  Temporary failure resolving 'deb.debian.org'\n"),
    ],
)
def test_missing_network_is_named(
    install: ModuleType, noetic: Any, monkeypatch: pytest.MonkeyPatch, update: str, log: str
) -> None:
    monkeypatch.setattr(
        install, "ros_source_lines", lambda: ["deb http://packages.ros.org/ros/ubuntu focal main"]
    )
    noetic.shell.logs.mkdir()

    def run_logged(title: Any, name: Any, command: Any, cwd: Any = None) -> None:
        (noetic.shell.logs / f"{name}.log").write_text(update if name == "apt-update" else log)
        if name == "apt-install":
            raise install.Problem("apt-install failed")

    noetic.shell.run_logged = run_logged
    expected = r"no packages can be fetched: Temporary failure resolving 'deb.debian.org': check the network"
    with pytest.raises(install.Problem, match=expected):
        noetic.install_system_packages()


def test_other_failure_is_no_network_problem(apt: ModuleType) -> None:
    assert apt.network_problem("E: You don't have enough free space\n", UNREACHABLE) is None


@pytest.mark.parametrize("audit", ["The following packages are only half configured:\n catkin\n", ""])
def test_interrupted_installation_is_finished_first(
    install: ModuleType, noetic: Any, monkeypatch: pytest.MonkeyPatch, audit: str
) -> None:
    def run(command: Any, **options: Any) -> Any:
        return subprocess.CompletedProcess(command, 0, stdout=audit if "--audit" in command else "")

    monkeypatch.setattr(
        install, "ros_source_lines", lambda: ["deb http://packages.ros.org/ros/ubuntu focal main"]
    )
    monkeypatch.setattr(install.subprocess, "run", run)
    noetic.install_system_packages()
    lines = [" ".join(command) for command in noetic.shell.commands]
    finish = "sudo env DEBIAN_FRONTEND=noninteractive dpkg --configure -a"
    assert lines[: 2 if audit else 1] == ["sudo -v", finish][: 2 if audit else 1]
    assert lines.count(finish) == bool(audit)


@pytest.fixture
def bare(tmp_path: Path) -> Any:
    """Return a function that runs install.py with sh and the given commands only, without Python.

    Commands record their calls in a file; apt-get installs a Python that does so, too.
    """
    python, calls, folder = tmp_path / "python3", tmp_path / "calls", tmp_path / "bin"
    program = tmp_path / "install.py"
    program.write_text((HERE / "install.py").read_text().replace("/usr/bin/python3", str(python)))
    record_call = f"""#!/bin/sh
name=${{0##*/}}
for word in "$name" "$@"; do printf '%s|' "$word" >> {calls}; done
echo >> {calls}
"""
    bodies = {
        "id": "#!/bin/sh\necho 0\n",
        "user": "#!/bin/sh\necho 1000\n",
        "env": '#!/bin/sh\nshift\nexec "$@"\n',
        "dpkg": record_call,
        "sudo": record_call + 'exec "$@"\n',
        "apt-get": f"{record_call}case $1 in install) cp {folder}/python.txt {python} && chmod +x {python} ;; esac\n",
        "broken": f"{record_call}case $1 in install) exit 100 ;; esac\n",
    }

    def run(commands: Any, *arguments: Any) -> Tuple[Any, ...]:
        folder.mkdir()
        (folder / "python.txt").write_text(record_call)
        for name in commands.split():
            command, _, body = name.partition("=")
            (folder / command).write_text(bodies[body or command])
            (folder / command).chmod(0o755)
        for name in ("cp", "chmod"):
            (folder / name).symlink_to(required(shutil.which(name)))
        shell = required(shutil.which("sh"))
        process = subprocess.run(
            [shell, str(program), *arguments], env={"PATH": str(folder)}, capture_output=True, text=True
        )
        return process.returncode, process.stderr, calls.read_text().splitlines() if calls.exists() else []

    return run


def test_missing_python_is_installed(bare: Any, tmp_path: Path) -> None:
    status, errors, calls = bare("id env dpkg apt-get", "test", "-k", "a or  b", "")
    assert (status, errors) == (0, "")
    assert calls == [
        "dpkg|--configure|-a|",
        "apt-get|update|-qq|",
        "apt-get|install|-y|-qq|--no-install-recommends|python3|",
        f"python3|{tmp_path}/install.py|test|-k|a or  b||",
    ]


def test_missing_python_is_installed_with_sudo(bare: Any) -> None:
    status, _, calls = bare("id=user env dpkg apt-get sudo", "demo")
    assert status == 0
    assert calls[0] == "sudo|env|DEBIAN_FRONTEND=noninteractive|dpkg|--configure|-a|"
    assert calls[-1].endswith("|demo|")


@pytest.mark.parametrize(
    ("commands", "arguments", "message"),
    [
        ("id=user env dpkg apt-get", [], "python3 is missing: installing it needs root or sudo"),
        ("id env", [], "python3 is missing: install Python 3.8 or later, then run this again"),
        ("id env dpkg apt-get", ["--no-system", "demo"], "system packages are missing: python3"),
        (
            "id env dpkg apt-get=broken",
            [],
            "python3 cannot be installed: check the network, the proxy and the sources of apt, then run this again",
        ),
    ],
)
def test_failed_installation_of_python_is_an_error(
    bare: Any, commands: str, arguments: List[str], message: str
) -> None:
    status, errors, calls = bare(commands, *arguments)
    assert (status, errors) == (1, f"install.py: {message}\n")
    assert not any(line.startswith("python3") for line in calls)


def test_dry_run_does_not_install_python(bare: Any) -> None:
    assert bare("id env dpkg apt-get", "test", "--dry-run") == (0, "", [])


def test_script_runs_in_sh_and_python() -> None:
    for program in ("sh", "/usr/bin/env python3"):
        command = [*program.split(), str(HERE / "install.py"), "--workspace", "/tmp/a b"]
        process = subprocess.run(command, stderr=subprocess.PIPE, text=True)
        assert process.returncode == 2
        assert "the workspace '/tmp/a b' has ' ' in its path" in process.stderr


def test_closed_pipe_ends_script_without_traceback(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    workspace = str(tmp_path / "workspace")
    command = [sys.executable, str(HERE / "install.py"), "test", "--dry-run", "--workspace", workspace]
    process = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert process.returncode == 1
    assert "Error" not in process.stderr


@pytest.mark.parametrize("name", ["mein Büro", "a;b$(c)", "(x)"])
def test_workspace_has_no_special_characters(install: ModuleType, name: str) -> None:
    workspace = install.default_workspace(Path("/home/me") / name, {"HOME": "/home/me"})
    assert re.fullmatch(r"[\w.-]+", workspace.name, re.ASCII)
    assert workspace != install.default_workspace(Path("/home/me/mein_B_ro"), {"HOME": "/home/me"})


def test_invalid_key_is_refused(apt: ModuleType) -> None:
    with pytest.raises(apt.Problem, match="is not a key"):
        apt.dearmor(b"<html>")


def test_source_lines_of_ros_are_found(apt: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "sources.list.d").mkdir()
    (tmp_path / "sources.list").write_text("# deb http://packages.ros.org/ros/ubuntu x\ndeb http://other y\n")
    assert apt.ros_source_lines(tmp_path) == []
    (tmp_path / "sources.list.d" / "ros.list").write_text(
        "deb http://packages.ros.org/ros/ubuntu focal main\n"
    )
    assert len(apt.ros_source_lines(tmp_path)) == 1
    assert apt.key_problem("Hit:1 http://packages.ros.org/ros/ubuntu focal InRelease") is None


def test_missing_packages_are_named_without_system(install: ModuleType, noetic: Any) -> None:
    noetic.system = False
    with pytest.raises(
        install.Problem, match=r"system packages are missing: ca-certificates cmake .*ros-noetic-rospy"
    ):
        noetic.install_system_packages()
    assert noetic.shell.commands == []


@pytest.mark.parametrize(
    ("version", "options"),
    [((3, 8), ["--no-warn-unused-ignores", "--no-warn-return-any"]), ((3, 9), []), ((3, 11), [])],
)
def test_lint_checks_types_with_options_of_python(
    install: ModuleType,
    noetic: Any,
    monkeypatch: pytest.MonkeyPatch,
    version: Tuple[Any, ...],
    options: List[str],
) -> None:
    monkeypatch.setattr(install, "sys", SimpleNamespace(version_info=version))
    assert install.run_lint(noetic) == 0
    (command,) = [command for command in noetic.shell.commands if "mypy" in command]
    assert command[command.index("mypy") + 1 :] == options


def test_dependencies_of_manifest_are_known(install: ModuleType) -> None:
    manifest = (HERE / "package.xml").read_text()
    assert install.find_dependency_problems(manifest) == []
    names = set(re.findall(r"<\w*depend\b[^>]*>([^<]+)<", manifest))
    assert names == set(install.DEPENDENCIES)
    # The build farms of ROS refuse packages that depend on such a key.
    assert not [name for name in names if name.endswith("-pip")]


@pytest.mark.parametrize(
    ("variables", "build_type", "present", "absent"),
    [
        ({}, "catkin", "catkin rospy std_msgs", "rclpy"),
        ({"ROS_VERSION": "1"}, "catkin", "catkin rospy std_msgs", "rclpy"),
        ({"ROS_VERSION": "2"}, "ament_cmake", "ament_cmake rclpy std_msgs", "catkin rospy python3-rospkg"),
    ],
)
def test_manifest_has_dependencies_of_each_ros(
    variables: Dict[str, str], build_type: str, present: str, absent: str
) -> None:
    manifest = pytest.importorskip("catkin_pkg.package").parse_package(str(HERE / "package.xml"))
    manifest.evaluate_conditions(variables)
    dependencies = [*manifest.buildtool_depends, *manifest.exec_depends]
    names = {dependency.name for dependency in dependencies if dependency.evaluated_condition}
    assert set(present.split()) <= names
    assert not set(absent.split()) & names
    assert manifest.get_build_type() == build_type
    groups = [group.name for group in manifest.member_of_groups if group.evaluated_condition]
    assert groups == (["rosidl_interface_packages"] if build_type == "ament_cmake" else [])


@pytest.mark.parametrize("tag", ["exec_depend", "test_depend", "depend"])
def test_unknown_dependency_fails_lint(
    install: ModuleType,
    noetic: Any,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    tag: str,
) -> None:
    manifest = (HERE / "package.xml").read_text()
    changed_manifest = manifest.replace("</package>", f"<{tag}>rosppy</{tag}></package>")
    (tmp_path / "package.xml").write_text(changed_manifest)
    monkeypatch.setattr(install, "HERE", tmp_path)
    assert install.run_lint(noetic) == 1
    assert f"package.xml: unknown {tag} 'rosppy': expected a key of rosdep" in capsys.readouterr().out


def test_missing_package_of_dependency_fails_lint(
    install: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    packages = {*install.DEPENDENCIES.values()} - {"python3-tf2"}
    status = "".join(f"{name} install ok installed\n" for name in packages)
    monkeypatch.setattr(install, "query_installed_packages", lambda names: status)
    installation = install.Installation(install.DEBIAN_12, tmp_path, Recorder(tmp_path / "log"))
    assert install.run_lint(installation) == 1
    assert "DEPENDENCIES in install.py: 'python3-tf2' is not installed\n" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["demo", "test", "lint", "docs", "uninstall"])
@pytest.mark.parametrize("options", [["--workspace", "/some/where"], ["--workspace=/some/where"]])
def test_options_may_precede_or_follow_command(install: ModuleType, command: str, options: List[str]) -> None:
    before = install.parse_arguments([*options, "--dry-run", command])
    assert before.workspace == Path("/some/where").resolve()
    assert before.dry_run
    assert not before.no_system
    assert vars(install.parse_arguments([command, *options, "--dry-run"])) == vars(before)
    assert vars(install.parse_arguments(["--dry-run", command, *options])) == vars(before)


@pytest.fixture
def environment_of_tests(
    install: ModuleType, environment: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Any:
    """Return a function that runs install.py up to the command of the tests and returns its environment."""
    environment.update(PYTHONUNBUFFERED="1", RETALIS_SCENARIOS="here")
    monkeypatch.setattr(install, "Shell", lambda logs, dry: Recorder(logs))
    for step in ("install_system_packages", "install_python_packages"):
        monkeypatch.setattr(install.Installation, step, lambda *_: None)

    def run(*argv: Any) -> Any:
        assert install.main(["--workspace", str(tmp_path / "ws"), *argv]) == 0
        return environment

    return run


def test_tests_have_minimal_environment(environment_of_tests: Any, tmp_path: Path) -> None:
    environment = environment_of_tests("test")
    assert "PYTHONUNBUFFERED" not in environment
    assert environment["RETALIS_SCENARIOS"] == "here"
    assert environment["RETALIS_WORKSPACE"] == str(tmp_path / "ws")


def test_run_of_all_tests_prints_duration(
    environment_of_tests: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    environment_of_tests("test")
    assert capsys.readouterr().out.startswith("All tests take up to 15 minutes on two cores")
    environment_of_tests("test", "test/test_api.py")
    assert "minutes" not in capsys.readouterr().out


@pytest.mark.parametrize("options", [[], ["test/ros1"], ["-m", "not slow", "--ignore", "test/test_api.py"]])
def test_tests_run_on_two_cores(install: ModuleType, options: List[str]) -> None:
    assert install.choose_parallel_options(options) == ("-n", "3", "--dist", "worksteal")


@pytest.mark.parametrize(
    "options", [["-n", "4"], ["-n0"], ["--pdb"], ["test/test_api.py"], ["test/test_api.py::test_x"], ["--co"]]
)
def test_single_file_or_option_disables_parallel_run(install: ModuleType, options: List[str]) -> None:
    assert install.choose_parallel_options(options) == ()


@pytest.fixture
def packages(install: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Return a function that returns the packages that a command installs on a platform."""

    class StopError(Exception):
        pass

    def run(platform: Any, *words: Any) -> Any:
        installed: List[Any] = []

        def stop(platform: Any, *rest: Any) -> None:
            installed.extend(platform.packages)
            raise StopError

        monkeypatch.setattr(install, "choose_platform", lambda release: platform)
        monkeypatch.setattr(install, "Installation", stop)
        with pytest.raises(StopError):
            install.main(["--workspace", str(tmp_path / "ws"), *words])
        return installed

    return run


def test_swi_prolog_is_installed_on_request(install: ModuleType, packages: Any) -> None:
    for platform in install.PLATFORMS.values():
        assert packages(platform, "--with-swi") == [*platform.packages, "swi-prolog-nox"]
        assert packages(platform) == platform.packages


def test_shells_browser_and_broker_are_installed_for_tests(install: ModuleType, packages: Any) -> None:
    debian, ubuntu = install.DEBIAN_12, install.UBUNTU_20_04
    assert packages(debian, "test") == [*debian.packages, "chromium", "fish", "zsh", *install.TEST_BROKER]
    assert packages(debian, "test", "--with-swi")[-2:] == ["python3-paho-mqtt", "swi-prolog-nox"]
    assert packages(ubuntu, "test") == [*ubuntu.packages, "fish", "zsh", *install.TEST_BROKER]
    for command in ("demo", "lint", "build"):
        assert packages(debian, command) == debian.packages


def test_other_options_are_passed_to_tests(install: ModuleType) -> None:
    options = install.parse_arguments(["test", "-k", "a or b", "--dry-run", "--no-summary", "--inst"])
    assert (options.dry_run, options.no_system, options.install) == (True, False, False)
    assert options.passed_arguments == ["-k", "a or b", "--no-summary", "--inst"]


@pytest.fixture
def workspace(install: ModuleType, tmp_path: Path) -> Path:
    """Return a built workspace."""
    workspace = tmp_path / "retalis" / "clone-1"
    for name in (
        "log/catkin_make.log",
        "venv/bin/python3",
        "docs-venv-3.8/bin/python3",
        "build/x",
        "devel/setup.bash",
        ".catkin_workspace",
    ):
        (workspace / name).parent.mkdir(parents=True, exist_ok=True)
        (workspace / name).touch()
    (workspace / "src").mkdir()
    (workspace / "src" / "retalis").symlink_to(install.HERE)
    (workspace / "src" / "CMakeLists.txt").symlink_to("/nowhere")
    return workspace


def test_uninstall_removes_workspace(
    install: ModuleType, workspace: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(workspace.rglob("*"))
    assert install.main(["uninstall", "--workspace", str(workspace), "--dry-run"]) == 0
    assert f"would remove {workspace}/devel\n" in capsys.readouterr().out
    assert sorted(workspace.rglob("*")) == before
    assert install.main(["uninstall", "--workspace", str(workspace)]) == 0
    assert capsys.readouterr().out.endswith(f"This clone is left: {install.HERE}\n")
    assert not workspace.parent.exists()
    assert workspace.parent.parent.exists()
    assert install.HERE.exists()
    with pytest.raises(install.Problem, match="nothing is installed in"):
        install.main(["uninstall", "--workspace", str(workspace)])


def test_uninstall_names_remaining_packages(
    install: ModuleType, workspace: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (workspace / install.PACKAGE_RECORD).write_text("python3\ncatkin\ngone\ncatkin\n")
    status = "catkin install ok installed\npython3 install ok installed\ngone deinstall ok config-files\n"
    monkeypatch.setattr(install, "query_installed_packages", lambda names: status)
    install.main(["uninstall", "--workspace", str(workspace)])
    assert "and are left, since other programs may need them:\n  python3 catkin\n" in capsys.readouterr().out
    assert not workspace.exists()


def no_address(name: Any) -> None:
    raise OSError("Name or service not known")


def test_localhost_is_added_to_hosts(
    install: ModuleType,
    noetic: Any,
    workspace: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(install.socket, "gethostbyname", no_address)
    noetic.add_localhost()
    (command,) = noetic.shell.commands
    assert command[:3] == ["sudo", "sh", "-c"]
    assert command[4:] == ["127.0.0.1 localhost", "/etc/hosts"]
    shutil.copy(noetic.workspace / install.PACKAGE_RECORD, workspace)
    install.main(["uninstall", "--workspace", str(workspace)])
    assert "The line '127.0.0.1 localhost' is left in /etc/hosts.\n" in capsys.readouterr().out
    noetic.system = False
    with pytest.raises(install.Problem, match="the name localhost is unknown: add the line"):
        noetic.add_localhost()


def test_known_localhost_is_not_added(
    install: ModuleType, noetic: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(install.socket, "gethostbyname", lambda name: "127.0.0.1")
    noetic.add_localhost()
    assert noetic.shell.commands == []


def test_installed_packages_are_recorded(
    install: ModuleType, noetic: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        install, "ros_source_lines", lambda: ["deb http://packages.ros.org/ros/ubuntu focal main"]
    )
    monkeypatch.setenv("RETALIS_INSTALLED", "python3")
    noetic.install_system_packages()
    recorded_packages = (noetic.workspace / install.PACKAGE_RECORD).read_text().split()
    assert recorded_packages == ["python3", *noetic.platform.packages]
    assert "RETALIS_INSTALLED" not in os.environ


def test_uninstall_keeps_other_files(
    install: ModuleType, workspace: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (workspace / "notes.txt").touch()
    (workspace / "src" / "other").mkdir()
    assert install.main(["uninstall", "--workspace", str(workspace)]) == 0
    assert f"{workspace} holds other too: build, devel and install are left" in capsys.readouterr().out
    remaining = {path.relative_to(workspace).as_posix() for path in workspace.rglob("*") if not path.is_dir()}
    assert remaining == {
        "notes.txt",
        "build/x",
        "devel/setup.bash",
        ".catkin_workspace",
        "src/CMakeLists.txt",
    }


def test_uninstall_removes_incomplete_workspace(
    install: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    workspace = install.default_workspace(install.HERE, os.environ)
    (workspace / "venv").mkdir(parents=True)
    assert install.main(["uninstall"]) == 0
    assert list(tmp_path.iterdir()) == []


def test_uninstall_refuses_workspace_of_other_clone(
    install: ModuleType, workspace: Path, tmp_path: Path
) -> None:
    link = workspace / "src" / "retalis"
    link.unlink()
    for target in (None, tmp_path):
        if target is not None:
            link.symlink_to(target)
        with pytest.raises(install.Problem, match="was not built from it"):
            install.main(["uninstall", "--workspace", str(workspace)])
    assert (workspace / "venv").exists()


def test_command_where_prints_script(
    install: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(install.Problem, match="nothing has been built yet"):
        install.main(["--workspace", str(tmp_path), "where"])
    (tmp_path / "devel").mkdir()
    (tmp_path / "devel" / "setup.bash").touch()
    assert install.main(["--workspace", str(tmp_path), "where"]) == 0
    assert capsys.readouterr().out == f"{tmp_path}/devel/setup.bash\n"
    assert install.main(["--workspace", str(tmp_path), "where", "zsh"]) == 0
    assert capsys.readouterr().out == f"{tmp_path}/devel/setup.zsh\n"


def test_dangling_link_to_clone_is_replaced(
    install: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(install.subprocess, "run", report_nothing_installed)
    installation = install.Installation(install.DEBIAN_12, tmp_path, Recorder(tmp_path / "log"))
    installation.package.parent.mkdir()
    installation.package.symlink_to(tmp_path / "gone")
    installation.build(install=False)
    assert installation.package.resolve() == install.HERE


def test_link_to_other_clone_is_refused(install: ModuleType, tmp_path: Path) -> None:
    installation = install.Installation(install.DEBIAN_12, tmp_path, Recorder(tmp_path / "log"))
    (tmp_path / "other").mkdir()
    installation.package.parent.mkdir()
    installation.package.symlink_to(tmp_path / "other")
    with pytest.raises(install.Problem, match="is another copy of retalis"):
        installation.build(install=False)


@pytest.fixture
def site(install: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Recorder:
    """Return the commands of `install.py docs`, with a previously built site."""
    shell = Recorder(tmp_path / "log")
    monkeypatch.setattr(install, "Shell", lambda logs, dry: shell)
    monkeypatch.setattr(install, "SITE_FOLDER", tmp_path / "docs" / "html")
    monkeypatch.setattr(install.importlib.util, "find_spec", lambda name: True)
    # pip creates the folder of the file that marks a complete installation.
    venv = tmp_path / "workspace" / "docs-venv-{}.{}".format(*install.sys.version_info)
    (venv / "bin").mkdir(parents=True)
    install.SITE_FOLDER.mkdir(parents=True)
    (install.SITE_FOLDER / "removed.html").touch()
    return shell


def test_docs_builds_site_in_own_environment(
    install: ModuleType, site: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["docs", "--workspace", str(tmp_path / "workspace")]
    assert install.main(command) == 0
    create, install_packages, build = site.commands
    assert create[1:4] == ["-m", "venv", "--clear"]
    assert install_packages[0] == build[0] == f"{create[4]}/bin/python3"
    assert [Path(name).name for name in install_packages[-3::2]] == [
        "requirements.txt",
        "requirements-docs.txt",
    ]
    assert {"-W", "--keep-going", "-n"} < set(build)
    assert build[-2:] == [str(HERE / "docs"), str(install.SITE_FOLDER)]
    assert not install.SITE_FOLDER.exists()
    assert capsys.readouterr().out == f"The documentation site is built: {install.SITE_FOLDER}/index.html\n"
    assert install.main(command) == 0
    assert site.commands[3:] == [build]


def test_docs_has_exit_status_of_sphinx(
    install: ModuleType,
    site: Recorder,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(site, "run_visible", lambda command, cwd: 2)
    assert install.main(["docs", "--workspace", str(tmp_path / "workspace")]) == 2
    assert "is built" not in capsys.readouterr().out


def test_docs_installs_package_for_environments(
    install: ModuleType, site: Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(install.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(install, "parse_os_release", lambda text: {"ID": "debian", "VERSION_ID": "12"})
    monkeypatch.setattr(install, "query_installed_packages", lambda names: "")
    monkeypatch.setattr(install.os, "getuid", lambda: 0)
    install.main(["docs", "--workspace", str(tmp_path / "workspace")])
    assert site.commands[1][-3:] == ["-y", "--no-install-recommends", "python3-venv"]
