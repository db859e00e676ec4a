"""Build by colcon: an installation of a clean copy of the sources, in folders of their own and without links."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("colcon_core", reason="colcon is not installed")
pytest.importorskip("rosidl_adapter", reason="the generators of ROS 2 are not installed")
pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]

SOURCES = (
    "application_source",
    "cmake",
    "docs",
    "examples",
    "launch",
    "nodes",
    "src",
    "CMakeLists.txt",
    "package.xml",
)

INTERFACES = ("msg/AwaitedMemory.msg", "srv/DeleteRule.srv")
"""Interfaces of the copy: all of them would take minutes."""


def run(*command: Any, cwd: Path) -> str:
    """Run a command in an environment that has the wheels, and no other installation of retalis."""
    removed = ("PYTHONPATH", "COLCON_PREFIX_PATH", "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
    environment = {name: value for name, value in os.environ.items() if name not in removed}
    environment.update(AMENT_PREFIX_PATH=sys.prefix, CMAKE_PREFIX_PATH=sys.prefix, ROS_VERSION="2")
    process = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=1200,
    )
    assert process.returncode == 0, process.stdout
    return process.stdout


def build_workspace(workspace: Path) -> None:
    """Build a clean copy of the sources in a workspace of colcon."""
    package = workspace / "src" / "retalis"
    package.mkdir(parents=True)
    for name in SOURCES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(
                source, package / name, ignore=shutil.ignore_patterns("__pycache__", "_build", "cookbook")
            )
        else:
            shutil.copy(source, package / name)
    for name in INTERFACES:
        (package / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, package / name)
    options = ("--cmake-args", "-GNinja", f"-DPython3_EXECUTABLE={sys.executable}")
    run("colcon", "build", "--event-handlers", "console_direct+", *options, cwd=workspace)


def run_in_installation(workspace: Path, *command: Any) -> str:
    script = '. install/setup.bash && exec "$@"'
    return run("bash", "-c", script, "bash", *command, cwd=workspace)


def check_that_program_starts(workspace: Path) -> None:
    program = workspace / "install" / "retalis" / "lib" / "retalis" / "retalis"
    assert run_in_installation(workspace, program, "--help").startswith("usage: retalis")
    assert run_in_installation(workspace, "retalis", "help", "debounce").strip()


def check_that_generated_classes_are_merged(workspace: Path) -> None:
    program = """
import retalis
from retalis.msg import AwaitedMemory
from retalis.srv import DeleteRule
DeleteRule.__class__.__import_type_support__()
assert DeleteRule.__class__._TYPE_SUPPORT is not None
print(retalis.__path__[0], retalis.Engine.__name__, AwaitedMemory().instant.sec)
"""
    folder, *rest = run_in_installation(workspace, "python3", "-c", program).split()
    assert Path(folder).parts[: len(workspace.parts) + 2] == (*workspace.parts, "install", "retalis")
    assert rest == ["Engine", "0"]


def check_types_of_times(workspace: Path) -> None:
    definition = (workspace / "install/retalis/share/retalis/msg/AwaitedMemory.msg").read_text()
    assert "builtin_interfaces/Time instant\n" in definition
    assert "builtin_interfaces/Duration behind\n" in definition
    assert "# Time that the memory has to reach\n" in definition


def check_index_of_ament(workspace: Path) -> None:
    program = (
        "from ament_index_python import get_package_share_directory as f, get_resource as r\n"
        "print(f('retalis'))\nprint(r('rosidl_interfaces', 'retalis')[0])"
    )
    share, *interfaces = run_in_installation(workspace, "python3", "-c", program).split()
    assert {"msg/AwaitedMemory.msg", "srv/DeleteRule.srv"} <= set(interfaces)
    for name in ("application_source/pub_sub.xml", "examples/nao/make_bag.py", "docs/how-to/debounce.md"):
        assert Path(share, name).is_file()
    assert not list(Path(share).rglob("*.launch"))


ROBOT_FILES = {
    "package.xml": """\
<package format="3">
  <name>robot</name><version>1.0.0</version><description>A program.</description>
  <maintainer email="me@example.org">me</maintainer><license>MIT</license>
  <buildtool_depend>ament_cmake</buildtool_depend><test_depend>retalis</test_depend>
  <export><build_type>ament_cmake</build_type></export>
</package>
""",
    "CMakeLists.txt": """\
cmake_minimum_required(VERSION 3.18)
project(robot NONE)
find_package(ament_cmake REQUIRED)
if(BUILD_TESTING)
  find_package(retalis REQUIRED)
  ament_add_retalis_test(tests)
endif()
ament_package()
""",
    "tests/heat.yaml": """\
rules: hot <- heat(T) where T > 40.
cases:
  - {name: hot, input: [{at: 1, event: heat(41)}], expect: {events: [hot]}}
  - {name: cold, input: [{at: 1, event: heat(39)}], expect: {events: [hot]}}
""",
}
"""A package with test cases, of which one fails."""


def check_that_result_command_lists_cases(workspace: Path) -> None:
    for name, text in ROBOT_FILES.items():
        path = workspace / "src" / "robot" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    options = ("--packages-select", "robot")
    script = (
        'colcon build "$@" --cmake-args -GNinja -DBUILD_TESTING=ON > build.log 2>&1 || { cat build.log; exit 1; }\n'
        'colcon test "$@" > test.log 2>&1\ncolcon test-result --verbose --test-result-base build/robot; true'
    )
    text = run_in_installation(workspace, "bash", "-c", script, "bash", *options)
    assert ".xunit.xml: 2 tests, 0 errors, 1 failure, 0 skipped" in text


def test_clean_copy_is_built_and_installed(tmp_path: Path) -> None:
    # One test, because parallel processes would each build the workspace.
    build_workspace(tmp_path)
    check_that_program_starts(tmp_path)
    check_that_generated_classes_are_merged(tmp_path)
    check_types_of_times(tmp_path)
    check_index_of_ament(tmp_path)
    check_that_result_command_lists_cases(tmp_path)
