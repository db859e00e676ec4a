"""ROS 2 in a virtual environment, for `install.py`: the wheels of a third party, and retalis built against them.

The wheels have no ``setup.bash``, and their CMake files contain folders of the machine where they were built. Needs
only Python 3.8.
"""

import hashlib
import re
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Dict, Iterator, List, Optional, Sequence

from install_shell import Problem, Shell, format_source_line, make_bash_command

DISTRIBUTIONS = ("jazzy", "kilted")
"""Distributions of ROS 2 that can be installed; the first one is the default."""

FOLDER_PATTERN = "ros2-*"
"""Folders of a workspace with an installation of ROS 2, one for each distribution."""

SETUP_SHELLS = ("bash", "zsh", "sh")
"""Shells for which there is a setup script."""

SYSTEM_PACKAGES = ("ca-certificates", "cmake", "g++", "ninja-build", "python3-dev", "python3-venv")
"""System packages that building against the wheels needs."""

REQUIREMENTS = ("requirements.txt", "requirements-ros2-{}.txt")
"""Files of Python packages; the second one depends on the distribution."""

# Two versions of lark are installed over each other: retalis needs the newer one, and the wheels accept both.
_REINSTALLED = ("lark",)


def _interface_package(
    name: str, description: str, path: str, definition: str, dependency: str
) -> Dict[str, str]:
    """Return the files of a package with one definition.

    Args:
        name: name of the package.
        description: text for its ``package.xml``.
        path: path of the definition in the package.
        definition: text of the definition.
        dependency: package of the types that the definition uses.
    """
    return {
        "package.xml": f"""<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.0.0</version>
  <description>{description}</description>
  <maintainer email="maintainers@retalis.invalid">retalis maintainers</maintainer>
  <license>GPL-3.0-or-later</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>{dependency}</depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
""",
        "CMakeLists.txt": f"""cmake_minimum_required(VERSION 3.18)
project({name})
find_package(ament_cmake REQUIRED)
find_package({dependency} REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces({name} {path} DEPENDENCIES {dependency})
ament_package()
""",
        path: definition,
    }


MISSING_PACKAGES = {
    "tf2_msgs": _interface_package(
        "tf2_msgs",
        "The message of transforms",
        "msg/TFMessage.msg",
        "geometry_msgs/TransformStamped[] transforms\n",
        "geometry_msgs",
    ),
    "example_interfaces": _interface_package(
        "example_interfaces",
        "An action, for tests",
        "action/Fibonacci.action",
        "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n",
        "action_msgs",
    ),
}
"""Files of packages that the wheels lack, with the one definition that retalis or its tests need."""

_INTERFACE_FILES = ("CMakeLists.txt", "cmake/*", "package.xml", "msg/*", "srv/*")
"""Files of the sources that are built. Other files are installed as links, so their content may change."""

_LINKED_FOLDERS = ("application_source", "docs", "examples", "launch", "nodes", "src")
"""Folders of the sources whose files are installed as links."""

_BUILT_PYTHON = r'/[^;"\s]*/include/python3\.\d+'
_BUILT_NUMPY = r'/[^;"\s]*/numpy/(?:_core|core)/include'


class Ros2Installation:
    """Installation of a distribution of ROS 2 in a folder of a workspace; each step does only what is missing.

    Args:
        distribution: name of a distribution, one of `DISTRIBUTIONS`.
        workspace: folder of the workspace.
        sources: folder of the sources of retalis.
        python: program of the Python that the virtual environment is created with; 3.10 or later.
        shell: runs the commands.
    """

    def __init__(self, distribution: str, workspace: Path, sources: Path, python: str, shell: Shell) -> None:
        self.distribution = distribution
        self.folder = workspace / FOLDER_PATTERN.replace("*", distribution)
        self.sources = sources
        self.python = python
        self.shell = shell
        self.venv = self.folder / "venv"
        self.setup = self.folder / "setup.bash"

    def install_python_packages(self) -> None:
        """Install the wheels, and what building and testing need, into the virtual environment.

        Raises:
            Problem: if a package cannot be installed.
        """
        names = [name.format(self.distribution) for name in REQUIREMENTS]
        files = [self.sources / name for name in names]
        stamp = self._stamp("packages", *(path.read_text() for path in files))
        if stamp.exists():
            return
        self._remove_stamps("packages")
        print(f"ROS 2 {self.distribution} and tools will be installed into {self.venv}", flush=True)
        create_venv = [self.python, "-m", "venv", "--clear", str(self.venv)]
        self.shell.run_logged("Creating a virtual environment", "ros2-venv", create_venv)
        install = [str(self.venv / "bin" / "python3"), "-m", "pip", "--disable-pip-version-check", "install"]
        required = [argument for path in files for argument in ("-r", str(path))]
        self.shell.run_logged("Installing Python packages", "ros2-pip", [*install, *required])
        again = [*install, "--force-reinstall", "--no-deps", *_REINSTALLED]
        self.shell.run_logged("Installing lark", "ros2-pip-lark", again)
        if not self.shell.dry:
            headers, numpy_headers = self._find_headers()
            replace_include_folders(self.venv / "share", headers, numpy_headers)
            stamp.touch()

    def build(self) -> None:
        """Build retalis, and packages that the wheels lack, with colcon.

        Raises:
            Problem: if the build fails.
        """
        stamp = self._stamp("build", *self._describe_sources())
        if not self.shell.dry:
            self._write_setup()
        if stamp.exists():
            return
        self._remove_stamps("build")
        missing: List[str] = []
        if not self.shell.dry:
            missing = self._write_missing_packages()
            # Files that have been removed from the sources would stay installed.
            shutil.rmtree(self.folder / "install", ignore_errors=True)
        colcon = [
            "colcon",
            *("--log-base", str(self.folder / "log")),
            "build",
            *("--base-paths", str(self.sources), str(self.folder / "src")),
            *("--build-base", str(self.folder / "build")),
            *("--install-base", str(self.folder / "install")),
            "--merge-install",
            "--symlink-install",
            *("--packages-up-to", "retalis", *missing),
            *("--event-handlers", "console_direct+"),
            "--cmake-args",
            "-GNinja",
            "-DBUILD_TESTING=OFF",
            f"-DPython3_EXECUTABLE={self.venv / 'bin' / 'python3'}",
        ]
        self.shell.run_logged("Building for ROS 2 (takes minutes)", "colcon", self._in_environment(colcon))
        if not self.shell.dry:
            stamp.touch()

    def run(self, command: Sequence[str], cwd: Optional[Path] = None) -> int:
        """Run a command in the environment with its output on the terminal; return its exit status."""
        return self.shell.run_visible(self._in_environment(command), cwd)

    def _in_environment(self, command: Sequence[str]) -> List[str]:
        return make_bash_command([format_source_line(str(self.setup)), 'exec "$@"'], command)

    def _stamp(self, step: str, *inputs: str) -> Path:
        """Return the file that marks a step as done with these inputs."""
        digest = hashlib.sha256("\0".join((str(self.folder), self.python, *inputs)).encode()).hexdigest()
        return self.folder / f"{step}-{digest[:16]}"

    def _remove_stamps(self, step: str) -> None:
        """Remove the files that mark a step as done, before it is done again: it may fail."""
        if not self.shell.dry:
            for path in self.folder.glob(f"{step}-*"):
                path.unlink()

    def _describe_sources(self) -> Iterator[str]:
        """Yield the content of the files that are built, and the names of the files that are installed as links."""
        for files in MISSING_PACKAGES.values():
            yield from files.values()
        yield self._setup_text()
        for pattern in _INTERFACE_FILES:
            for path in sorted(self.sources.glob(pattern)):
                yield f"{path.name}\n{path.read_text()}"
        for folder in _LINKED_FOLDERS:
            for path in sorted((self.sources / folder).rglob("*")):
                if path.is_file() and "__pycache__" not in path.parts:
                    yield str(path.relative_to(self.sources))
        yield from (path.name for path in self.folder.glob("packages-*"))

    def _find_headers(self) -> List[str]:
        """Return the folders of the headers of the environment's Python and numpy."""
        program = "import sysconfig, numpy; print(sysconfig.get_path('include')); print(numpy.get_include())"
        process = subprocess.run(
            [str(self.venv / "bin" / "python3"), "-c", program], stdout=subprocess.PIPE, text=True, check=True
        )
        headers, numpy_headers = process.stdout.split()
        if not Path(headers, "Python.h").exists():
            raise Problem(f"{headers}/Python.h is missing: install the package python3-dev")
        return [headers, numpy_headers]

    def _write_missing_packages(self) -> List[str]:
        """Write the packages that the wheels lack; return their names."""
        missing: List[str] = []
        for name, files in MISSING_PACKAGES.items():
            package = self.folder / "src" / name
            if (self.venv / "share" / name).exists():
                shutil.rmtree(package, ignore_errors=True)
                continue
            missing.append(name)
            for path, text in files.items():
                (package / path).parent.mkdir(parents=True, exist_ok=True)
                (package / path).write_text(text)
        return missing

    def _write_setup(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        for shell in SETUP_SHELLS:
            self.setup.with_suffix(f".{shell}").write_text(self._setup_text(shell))

    def _setup_text(self, shell: str = "bash") -> str:
        """Return a script for a shell that puts the wheels and the built packages into the environment."""
        venv = shlex.quote(str(self.venv))
        packages = shlex.quote(str(self.folder / "install" / f"local_setup.{shell}"))
        return f"""# Environment of ROS 2 {self.distribution} with retalis; written by install.py.
export ROS_VERSION=2 ROS_PYTHON_VERSION=3 ROS_DISTRO={self.distribution}
export ROS_AUTOMATIC_DISCOVERY_RANGE="${{ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}}"
export AMENT_PREFIX_PATH={venv} CMAKE_PREFIX_PATH={venv}
export PATH={venv}/bin:"$PATH"
export LD_LIBRARY_PATH={venv}/lib"${{LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}}"
if [ -f {packages} ]; then
  . {packages}
fi
"""


def replace_include_folders(folder: Path, headers: str, numpy_headers: str) -> None:
    """Replace the include folders of Python and numpy in the CMake files of a folder.

    The wheels contain those of the machine where they were built. CMake refuses folders that do not exist.

    Args:
        folder: folder that contains the files, also in subfolders.
        headers: folder of this Python's headers.
        numpy_headers: folder of numpy's headers.
    """
    for path in folder.rglob("*.cmake"):
        text = path.read_text()
        changed_text = re.sub(_BUILT_NUMPY, lambda match: numpy_headers, text)
        changed_text = re.sub(_BUILT_PYTHON, lambda match: headers, changed_text)
        if changed_text != text:
            path.write_text(changed_text)
