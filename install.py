#!/bin/sh
""":"
# A shell runs these lines up to exec; to Python they are a string. A minimal Debian has no Python to begin with.
if ! python=$(command -v /usr/bin/python3 || command -v python3); then
  fail() { echo "install.py: $1" >&2; exit 1; }
  command -v apt-get > /dev/null || fail "python3 is missing: install Python 3.8 or later, then run this again"
  PATH=$PATH:/usr/sbin:/sbin
  for option in "$@"; do
    case $option in
      --dry-run) echo "would run: apt-get install python3, and again: $0 $*"; exit 0 ;;
      --no-system) fail "system packages are missing: python3" ;;
    esac
  done
  root=
  if [ "$(id -u)" != 0 ]; then
    command -v sudo > /dev/null || fail "python3 is missing: installing it needs root or sudo"
    root=sudo
  fi
  echo "This system package will be installed with apt-get: python3"
  $root env DEBIAN_FRONTEND=noninteractive dpkg --configure -a > /dev/null
  $root apt-get update -qq || true
  $root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends python3 > /dev/null ||
    fail "python3 cannot be installed: check the network, the proxy and the sources of apt, then run this again"
  export RETALIS_INSTALLED=python3
  python=/usr/bin/python3
fi
exec "$python" "$0" "$@"
"""  # noqa: D415

__doc__ = """Install what retalis needs on Debian 12 or Ubuntu 20.04, build it, and run its example or its tests.

Each step does only what is missing, so the program can be run again at any time.
"""

import argparse
import hashlib
import importlib.util
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence
from xml.etree import ElementTree

from install_apt import (
    KEY_FILE,
    SOURCE_FILE,
    encode_key,
    fetch_key,
    key_file,
    key_problem,
    network_problem,
    ros_source_lines,
)
from install_ros2 import DISTRIBUTIONS, FOLDER_PATTERN, SYSTEM_PACKAGES, Ros2Installation
from install_shell import (
    Problem,
    Shell,
    format_source_line,
    make_bash_command,
    minimal_environment,
    search_path,
)

HERE = Path(__file__).resolve().parent
SYSTEM_PYTHON = "/usr/bin/python3"  # the one interpreter that sees the distribution's ROS modules
DEMO_SCRIPT = str(HERE / "examples" / "nao" / "demo.py")
ROS2_DEMO_SCRIPT = str(HERE / "examples" / "nao" / "demo_ros2.py")
ROS2_TESTS = "test/ros2"
# The last mypy for Python 3.8 does not narrow the type of a term by its class: terms and everything computed from
# them are Any, and errors that newer versions have to ignore do not occur.
MYPY_38_OPTIONS = ("--no-warn-unused-ignores", "--no-warn-return-any")


class Platform(NamedTuple):
    """A distribution that is known to work.

    Attributes:
        name: name of the distribution.
        packages: system packages that building and running need.
        test_packages: system packages that only tests need.
        setup: script that has to be sourced to use ROS; None if ROS is part of the system.
        source: line that apt's sources need; None if they need none.
    """

    name: str
    packages: Sequence[str]
    test_packages: Sequence[str] = ()
    setup: Optional[str] = None
    source: Optional[str] = None


HOSTS = "/etc/hosts"
LOCAL_HOST = "127.0.0.1 localhost"

INSTALLED_PYTHON_VARIABLE = "RETALIS_INSTALLED"
"""Environment variable with the package that the shell lines at the beginning of this file have installed."""

CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"

_COMMON = """
    ca-certificates cmake g++ make python3-msgpack python3-numpy python3-setuptools python3-tornado python3-venv
    """

_DEBIAN = """
    catkin librostest-dev libstd-msgs-dev python3-diagnostic-msgs python3-geometry-msgs python3-lark
    python3-rosbag python3-roslaunch python3-rosmaster python3-rosmsg python3-rosnode python3-rosparam
    python3-rospy python3-rosservice python3-rostest python3-rostopic python3-std-msgs python3-std-srvs
    python3-tf python3-tf2 python3-tf2-msgs python3-tf2-ros ros-message-generation ros-message-runtime rosbash rosout
    """

_NOETIC = """
    catkin diagnostic-msgs geometry-msgs message-generation message-runtime rosbag rosbash roslaunch rosmaster
    rosmsg rosnode rosout rosparam rospy rosservice rostest rostopic std-msgs std-srvs tf tf2-msgs tf2-py tf2-ros
    """

DEPENDENCIES = {
    "ament_cmake": "pip",
    "ament_cmake_python": "pip",
    "builtin_interfaces": "pip",
    "catkin": "catkin",
    "diagnostic_msgs": "python3-diagnostic-msgs",
    "genpy": "python3-genpy",
    "geometry_msgs": "python3-geometry-msgs",
    "launch": "",
    "launch_ros": "",
    "lifecycle_msgs": "pip",
    "message_generation": "ros-message-generation",
    "message_runtime": "ros-message-runtime",
    "python3-hypothesis": "pip",
    "python3-msgpack": "python3-msgpack",
    "python3-numpy": "python3-numpy",
    "python3-pytest": "pip",
    "python3-rospkg": "python3-rospkg",
    "python3-setuptools": "python3-setuptools",
    "python3-tornado": "python3-tornado",
    "rcl_interfaces": "pip",
    "rclpy": "pip",
    "rosbag": "python3-rosbag",
    "rosbash": "rosbash",
    "rosgraph": "python3-rosgraph",
    "rosgraph_msgs": "python3-rosgraph-msgs",
    "rosidl_default_generators": "pip",
    "rosidl_default_runtime": "pip",
    "roslaunch": "python3-roslaunch",
    "roslib": "python3-roslib",
    "rospy": "python3-rospy",
    "rostest": "python3-rostest",
    "std_msgs": "python3-std-msgs",
    "tf": "python3-tf",
    "tf2_msgs": "python3-tf2-msgs",
    "tf2_py": "python3-tf2",
    "tf2_ros": "python3-tf2-ros",
}
"""rosdep keys that package.xml may contain, with their Debian 12 packages; ``pip`` for those in the requirements,
and nothing for those of ROS 2 that only a distribution has.

rosdep's own data need a network, and catkin_lint accepts any name without them.
"""

SWI_PACKAGE = "swi-prolog-nox"
"""Package of SWI-Prolog without graphics, installed on request."""

TEST_SHELLS = ("fish", "zsh")
"""Packages of the shells beside bash whose completion is tested."""

TEST_BROKER = ("mosquitto", "mosquitto-clients", "python3-paho-mqtt")
"""Packages of a broker of MQTT and of its clients."""

# The tests open pages in a browser.
DEBIAN_12 = Platform(
    "Debian 12", [*_COMMON.split(), *_DEBIAN.split()], test_packages=["chromium", *TEST_SHELLS, *TEST_BROKER]
)

# No browser: Ubuntu's package chromium-browser installs a snap, which containers cannot run.
UBUNTU_20_04 = Platform(
    "Ubuntu 20.04",
    [*_COMMON.split(), *("ros-noetic-" + name for name in _NOETIC.split())],
    test_packages=[*TEST_SHELLS, *TEST_BROKER],
    setup="/opt/ros/noetic/setup.bash",
    source=f"deb [signed-by={KEY_FILE}] http://packages.ros.org/ros/ubuntu focal main",
)

PLATFORMS = {("debian", "12"): DEBIAN_12, ("ubuntu", "20.04"): UBUNTU_20_04}


def default_workspace(source: Path, environ: Mapping[str, str]) -> Path:
    """Return the default workspace of a copy of the sources, in the cache folder; each copy has its own.

    Its name has only letters, digits and `_.-`: scripts of ROS, such as rosrun, split paths at spaces.
    """
    cache = Path(environ.get("XDG_CACHE_HOME") or Path(environ.get("HOME", "/tmp")) / ".cache")
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", source.name)
    return cache / "retalis" / f"{name}-{short_digest(str(source))[:8]}"


def parse_os_release(text: str) -> Dict[str, str]:
    """Return the assignments in an os-release file."""
    pairs = (line.split("=", 1) for line in text.splitlines() if "=" in line and not line.startswith("#"))
    return {key.strip(): "".join(shlex.split(value)) for key, value in pairs}


def choose_platform(release: Dict[str, str]) -> Platform:
    """Return the platform of a distribution.

    Raises:
        Problem: if the distribution is not supported.
    """
    key = (release.get("ID", ""), release.get("VERSION_ID", ""))
    if key not in PLATFORMS:
        raise Problem(
            "this is {}; ROS 1 is available on Debian 12 and Ubuntu 20.04. Without ROS: "
            "python3 -m venv ~/retalis; ~/retalis/bin/pip install .; ~/retalis/bin/retalis demo".format(
                release.get("PRETTY_NAME", "an unknown system")
            )
        )
    return PLATFORMS[key]


def query_installed_packages(names: Iterable[str]) -> str:
    """Return dpkg-query's lines of package and status for packages."""
    query = ["dpkg-query", "-W", "-f=${Package} ${Status}\\n", *names]
    return subprocess.run(query, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True).stdout


def find_missing_packages(required: Iterable[str], report: str) -> List[str]:
    """Return the packages that are not installed, given dpkg-query's lines of package and status."""
    installed = {line.split()[0] for line in report.splitlines() if line.endswith("install ok installed")}
    return [name for name in required if name not in installed]


def is_dpkg_interrupted() -> bool:
    """Return whether an installation was interrupted: apt installs nothing until dpkg has configured the packages."""
    audit = subprocess.run(["dpkg", "--audit"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    return bool(audit.stdout.strip()) or any(Path("/var/lib/dpkg/updates").glob("[0-9]*"))


def is_localhost_known() -> bool:
    """Return whether the name localhost has an address."""
    try:
        return bool(socket.gethostbyname("localhost"))
    except OSError:
        return False


def prefix_sudo(command: Sequence[str], uid: int) -> List[str]:
    """Return a command with sudo before it, unless the user is root."""
    return list(command) if uid == 0 else ["sudo", *command]


def short_digest(*parts: str) -> str:
    """Return a short digest of several texts."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


class Installation:
    """Installation steps; each step installs only what is missing."""

    def __init__(self, platform: Platform, workspace: Path, shell: Shell, system: bool = True) -> None:
        self.platform = platform
        self.workspace = workspace
        self.shell = shell
        self.system = system
        self.venv = workspace / "venv"
        self.package = workspace / "src" / "retalis"

    def install_system_packages(self) -> None:
        """Print and install the missing system packages."""
        missing = find_missing_packages(
            self.platform.packages, query_installed_packages(self.platform.packages)
        )
        if INSTALLED_PYTHON_VARIABLE in os.environ:
            self._record_packages([os.environ.pop(INSTALLED_PYTHON_VARIABLE)])
        if not missing:
            return
        if not self.system:
            raise Problem("system packages are missing: " + " ".join(missing))
        print("These system packages will be installed with apt-get:\n  " + " ".join(missing), flush=True)
        uid = os.getuid()
        if uid and not self.shell.dry and self.shell.run_visible(["sudo", "-v"]):
            raise Problem("installing system packages needs root or sudo")
        noninteractive = prefix_sudo(["env", "DEBIAN_FRONTEND=noninteractive"], uid)
        if is_dpkg_interrupted():
            finish = [*noninteractive, "dpkg", "--configure", "-a"]
            self.shell.run_logged("Finishing an installation that was interrupted", "dpkg", finish)
        apt = [*noninteractive, "apt-get"]
        install = [*apt, "install", "-y", "--no-install-recommends"]
        update = [*apt, "update"]
        if self.platform.source and not Path(self.platform.setup or "").exists() and not ros_source_lines():
            if not Path(CERTIFICATES).exists():  # without them no key can be had
                self.shell.run_logged("Reading the package lists", "apt-update", update)
                self._run_apt("Installing certificates", "apt-certificates", [*install, "ca-certificates"])
            self._add_source(self.platform.source, uid)
        self._update_package_lists(update, uid)
        self._record_packages(missing)
        self._run_apt(f"Installing {len(missing)} system packages", "apt-install", [*install, *missing])

    def _run_apt(self, title: str, name: str, command: Sequence[str]) -> None:
        """Run apt; if it fails for lack of a network, raise an error with that reason.

        `apt-get update` itself exits with 0 without a network, and the packages are unknown afterwards.
        """
        try:
            self.shell.run_logged(title, name, command)
        except Problem as problem:
            log, list_log = (self.shell.logs / f"{step}.log" for step in (name, "apt-update"))
            texts = [path.read_text(errors="replace") if path.exists() else "" for path in (log, list_log)]
            reason = network_problem(*texts)
            if reason is None:
                raise
            raise Problem(
                f"no packages can be fetched: {reason}: check the network, the proxy and the sources of apt; "
                f"all of the output is in {log}"
            ) from problem

    def _record_packages(self, packages: Sequence[str]) -> None:
        """Record system packages before they are installed, so that `uninstall` can list them."""
        if not self.shell.dry:
            self.workspace.mkdir(parents=True, exist_ok=True)
            with (self.workspace / PACKAGE_RECORD).open("a") as record:
                record.writelines(name + "\n" for name in packages)

    def _update_package_lists(self, update: Sequence[str], uid: int) -> None:
        """Update the package lists; if the key of the ROS packages has expired, replace it and try again."""
        log = self.shell.logs / "apt-update.log"
        failure = None
        try:
            self._run_apt("Reading the package lists", "apt-update", update)
        except Problem as problem:
            failure = problem
        key_error = key_problem(log.read_text(errors="replace")) if log.exists() else None
        if key_error is not None:
            target = key_file(ros_source_lines())
            print(
                f"apt refuses the key of packages.ros.org ({key_error}): {target} will be replaced",
                flush=True,
            )
            self._write_system_file(encode_key(fetch_key(), target), target, uid)
            self.shell.run_logged("Reading the package lists again", "apt-update", update)
        elif failure is not None:
            raise failure

    def _add_source(self, line: str, uid: int) -> None:
        """Add the ROS packages and their key to apt's sources."""
        print(f"ROS noetic will be added to apt: {SOURCE_FILE} with the key {KEY_FILE}", flush=True)
        if self.shell.dry:
            return
        for text, target in ((fetch_key(), KEY_FILE), (line.encode() + b"\n", SOURCE_FILE)):
            self._write_system_file(text, target, uid)

    def _write_system_file(self, text: bytes, target: str, uid: int) -> None:
        """Write a system file."""
        self.shell.logs.mkdir(parents=True, exist_ok=True)
        source = self.shell.logs / Path(target).name
        source.write_bytes(text)
        self.shell.run_logged(
            target, "apt-source", prefix_sudo(["install", "-m", "644", str(source), target], uid)
        )

    def add_localhost(self) -> None:
        """Add localhost to /etc/hosts, which a minimal system lacks; ROS nodes call each other by this name."""
        if is_localhost_known():
            return
        if not self.system:
            raise Problem(f"the name localhost is unknown: add the line '{LOCAL_HOST}' to {HOSTS}")
        print(f"The name localhost is unknown: the line '{LOCAL_HOST}' will be added to {HOSTS}", flush=True)
        add = ["sh", "-c", 'echo "$0" >> "$1"', LOCAL_HOST, HOSTS]
        self.shell.run_logged(HOSTS, "hosts", prefix_sudo(add, os.getuid()))
        self._record_packages([HOSTS])

    def install_python_packages(self, requirements: Sequence[str]) -> None:
        """Install the Python packages that the distribution lacks into a virtual environment of the workspace."""
        texts = [(HERE / name).read_text() for name in requirements]
        stamp = self.venv / ("done-" + short_digest(self.platform.name, str(self.venv), *texts))
        if stamp.exists():
            return
        print(f"Python packages that the distribution lacks will be installed into {self.venv}", flush=True)
        create_venv = [SYSTEM_PYTHON, "-m", "venv", "--system-site-packages", str(self.venv)]
        self.shell.run_logged("Creating a virtual environment", "venv", create_venv)
        pip = [str(self.venv / "bin" / "python3"), "-m", "pip", "--disable-pip-version-check"]
        files = [argument for name in requirements for argument in ("-r", str(HERE / name))]
        self.shell.run_logged("Installing Python packages", "pip", [*pip, "install", *files])
        # catkin needs the distribution's setuptools, which uses the folder layout of the distribution.
        remove = [*pip, "uninstall", "-y", "setuptools"]
        self.shell.run_logged("Leaving setuptools to the distribution", "pip-setuptools", remove)
        if not self.shell.dry:
            stamp.touch()

    def link_sources(self) -> None:
        """Create the link to the sources in the workspace.

        Raises:
            Problem: if the workspace belongs to other sources.
        """
        if not self.package.exists() and not self.shell.dry:
            self.package.parent.mkdir(parents=True, exist_ok=True)
            if self.package.is_symlink():  # the target of the link was removed
                self.package.unlink()
            self.package.symlink_to(HERE)
        if self.package.exists() and self.package.resolve() != HERE:
            raise Problem(f"{self.package} is another copy of retalis; choose another --workspace")

    def build(self, install: bool) -> None:
        """Build the workspace, and its install space on request."""
        self.link_sources()
        packages = f"-Dretalis_PYTHON_PACKAGES={self.find_site_packages()}"
        catkin_make = [
            "catkin_make",
            "-DPYTHON_EXECUTABLE=" + SYSTEM_PYTHON,
            packages,
            *(["install"] if install else []),
        ]
        setup_lines = [format_source_line(self.platform.setup)] if self.platform.setup else []
        self.shell.run_logged(
            "Building",
            "catkin_make",
            make_bash_command([*setup_lines, 'exec "$@"'], catkin_make),
            cwd=self.workspace,
        )

    def find_site_packages(self) -> Path:
        """Return the package folder of the virtual environment."""
        version = subprocess.run(
            [SYSTEM_PYTHON, "-c", "import sys; print('python%d.%d' % sys.version_info[:2])"],
            stdout=subprocess.PIPE,
            text=True,
        ).stdout.strip()
        return self.venv / "lib" / version / "site-packages"

    def run(self, command: Sequence[str], cwd: Optional[Path] = HERE) -> int:
        """Run a command in the built workspace with its output on the terminal; return its exit status."""
        script = str(self.workspace / "devel" / "setup.bash")
        return self.shell.run_visible(
            make_bash_command([format_source_line(script), 'exec "$@"'], command), cwd
        )


ROS2_COMMANDS = ("build", "demo", "test", "where")
"""Commands with the option ``--ros2``."""


def create_option_parser() -> argparse.ArgumentParser:
    """Return a parser of the options that are not passed on to the example or to pytest."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    add = parser.add_argument
    add(
        "--workspace",
        type=Path,
        metavar="DIR",
        help="catkin workspace (default: in ~/.cache/retalis)",
    )
    add("--no-system", action="store_true", help="install no system packages; stop where some are missing")
    add(
        "--with-swi",
        action="store_true",
        help="install SWI-Prolog too, for use_swi/1 (docs/how-to/swi-prolog.md)",
    )
    add(
        "--ros2",
        choices=DISTRIBUTIONS,
        metavar="DISTRIBUTION",
        help="build, demo, test and where: use ROS 2 instead of ROS 1, from wheels in a virtual environment; "
        "--ros2 is --ros2=jazzy, the other distribution is kilted",
    )
    add("--install", action="store_true", help="also build the install space (catkin_make install)")
    add("--dry-run", action="store_true", help="print what would be done and do nothing")
    return parser


def parse_arguments(argv: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; options may precede or follow the command."""
    parser = argparse.ArgumentParser(prog="install.py", description=__doc__, parents=[create_option_parser()])
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    commands.add_parser("build", help="install what is needed and build (the default)")
    commands.add_parser("demo", help="... and run the NAO example (see demo --help)", add_help=False)
    commands.add_parser("test", help="... and run every test; options go to pytest", add_help=False)
    where = commands.add_parser("where", help="print the setup.bash of the workspace that was built")
    where.add_argument(
        "shell",
        nargs="?",
        choices=("bash", "zsh", "sh"),
        default="bash",
        help="print that of this shell (bash)",
    )
    commands.add_parser("lint", help="... and check the style: ruff, mypy, catkin_lint")
    commands.add_parser("docs", help="build the documentation site, which needs no ROS, and say where it is")
    commands.add_parser("uninstall", help="remove what was built; say what is left")
    # With an optional value, argparse would take the next argument as the distribution.
    argv = [f"--ros2={DISTRIBUTIONS[0]}" if argument == "--ros2" else argument for argument in argv]
    options, remaining = parser.parse_known_args(argv)
    later_options, options.passed_arguments = create_option_parser().parse_known_args(remaining)
    for name, value in vars(later_options).items():
        setattr(options, name, value or getattr(options, name))
    if options.passed_arguments and options.command not in ("demo", "test"):
        parser.error("unknown argument: " + options.passed_arguments[0])
    options.command = options.command or "build"
    if options.ros2 and options.command not in ROS2_COMMANDS:
        parser.error(f"'{options.command}' has no option --ros2: expected it with {', '.join(ROS2_COMMANDS)}")
    options.workspace = (options.workspace or default_workspace(HERE, os.environ)).expanduser().resolve()
    if options.workspace == HERE or HERE in options.workspace.parents:
        parser.error("the workspace must be outside the package: ROS searches a package's whole folder")
    invalid = re.search(r"[^\w/.,+@%=~-]", str(options.workspace))
    if invalid:
        parser.error(
            f"the workspace '{options.workspace}' has '{invalid.group()}' in its path, which scripts of ROS cannot "
            "read: give a --workspace whose path has letters, digits and _.- only"
        )
    return options


def run_lint(installation: Installation) -> int:
    """Run the checks that need no master; return the number of failures."""
    python = str(installation.venv / "bin" / "python3")
    checks = [
        [python, "-m", "ruff", "check", "--output-format", "concise", "."],
        [python, "-m", "ruff", "format", "--check", "--output-format", "concise", "."],
        [python, "-m", "catkin_lint", "-W2", "--strict", "--offline", str(installation.package)],
        [python, "-m", "mypy", *(MYPY_38_OPTIONS if sys.version_info < (3, 9) else ())],
    ]
    failed_checks = 0
    for check in checks:
        print("$ " + " ".join(["python3", *check[1:]]), flush=True)
        failed_checks += bool(installation.run(check))
    problems = find_dependency_problems((HERE / "package.xml").read_text())
    if installation.platform is DEBIAN_12:
        packages = [name for name in DEPENDENCIES.values() if name not in ("", "pip")]
        missing = find_missing_packages(packages, query_installed_packages(packages))
        problems += [f"DEPENDENCIES in install.py: '{name}' is not installed" for name in missing]
    for problem in problems:
        print(problem)
    return failed_checks + bool(problems)


def find_dependency_problems(manifest: str) -> List[str]:
    """Return an error message for each wrong dependency in a package.xml."""
    tags = ("depend", "build_depend", "build_export_depend", "buildtool_depend", "buildtool_export_depend")
    tags += ("exec_depend", "run_depend", "test_depend", "doc_depend")
    root = ElementTree.fromstring(manifest)
    dependencies = [(tag, (element.text or "").strip()) for tag in tags for element in root.iter(tag)]
    return [
        f"package.xml: unknown {tag} '{name}': expected a key of rosdep that DEPENDENCIES in install.py lists"
        for tag, name in dependencies
        if name not in DEPENDENCIES
    ]


SITE_FOLDER = HERE / "docs" / "_build" / "html"
"""The documentation site, after `build_site`."""

DOCS_VENV_PATTERN = "docs-venv-*"
"""Virtual environments of a workspace that have Sphinx, one for each version of Python."""

DOCS_REQUIREMENTS = ("requirements.txt", "requirements-docs.txt")


def build_site(options: argparse.Namespace, shell: Shell) -> int:
    """Build the documentation site in a virtual environment of this Python; return the exit status of Sphinx.

    A warning, such as a link without a target, is an error. Links to other sites are not checked.
    """
    if importlib.util.find_spec("ensurepip") is None:
        # Debian's python3 can make no virtual environment without this package.
        platform = choose_platform(parse_os_release(Path("/etc/os-release").read_text()))
        platform = platform._replace(packages=["python3-venv"], source=None)
        Installation(platform, options.workspace, shell, not options.no_system).install_system_packages()
    python = create_docs_venv(options.workspace, shell)
    if SITE_FOLDER.exists() and not shell.dry:
        shutil.rmtree(SITE_FOLDER)  # pages that have been removed since would stay
    strict = ["-q", "-W", "--keep-going", "-n", "-E"]
    doctrees = str(SITE_FOLDER.parent / "doctrees")
    command = [
        python,
        "-m",
        "sphinx",
        *strict,
        "-b",
        "html",
        "-d",
        doctrees,
        str(HERE / "docs"),
        str(SITE_FOLDER),
    ]
    status = shell.run_visible(command, cwd=HERE)
    if status == 0 and not shell.dry:
        print(f"The documentation site is built: {SITE_FOLDER / 'index.html'}")
    return status


def create_docs_venv(workspace: Path, shell: Shell) -> str:
    """Return the Python of a virtual environment that has Sphinx, after installing what is missing in it."""
    venv = workspace / DOCS_VENV_PATTERN.replace("*", "{}.{}".format(*sys.version_info))
    python = str(venv / "bin" / "python3")
    texts = [(HERE / name).read_text() for name in DOCS_REQUIREMENTS]
    stamp = venv / ("done-" + short_digest(sys.version, str(venv), *texts))
    if not stamp.exists():
        create_venv = [sys.executable, "-m", "venv", "--clear", str(venv)]
        shell.run_logged("Creating a virtual environment", "docs-venv", create_venv)
        files = [argument for name in DOCS_REQUIREMENTS for argument in ("-r", str(HERE / name))]
        install = [python, "-m", "pip", "--disable-pip-version-check", "install", *files]
        shell.run_logged("Installing Sphinx", "docs-pip", install)
        if not shell.dry:
            stamp.touch()
    return python


TEST_DURATION_TEXT = (
    "All tests take up to 15 minutes on two cores that have nothing else to do; "
    "./install.py test -m 'not slow' --ignore test/ros1 takes 2."
)
PARALLEL_OPTIONS = ("-n", "3", "--dist", "worksteal")
"""Three processes for two cores, because tests with ROS spend most of their time waiting.

Each has a part of the test files in order, so that fixtures of modules are shared. A process without tests takes half
of those that another one still has: all processes work until the end.
"""

_ONE_PROCESS = {
    "--pdb",
    "--trace",
    "-s",
    "--capture=no",
    "--co",
    "--collect-only",
    "-h",
    "--help",
    "--version",
}


def choose_parallel_options(options: Sequence[str]) -> Sequence[str]:
    """Return the pytest options that distribute tests over processes.

    They are empty if the user's options determine the distribution, require a single process, or name single files,
    whose tests start sooner without further processes.
    """
    for previous, option in zip(["", *options], options):
        if option in _ONE_PROCESS or option.startswith(("-n", "--numprocesses", "--dist")):
            return ()
        is_file = option.endswith(".py") or "::" in option
        if is_file and not option.startswith("-") and previous not in ("--ignore", "--deselect"):
            return ()
    return PARALLEL_OPTIONS


PACKAGE_RECORD = "installed-packages"
"""File of a workspace with the system packages that were installed for it, one per line."""

CATKIN_OUTPUTS = ("build", "devel", "install", ".catkin_workspace", "src/CMakeLists.txt")
"""Files and folders that catkin_make creates in a workspace for all its packages."""


def uninstall(workspace: Path, dry: bool) -> None:
    """Remove what `Installation` has created in a workspace, and the workspace if nothing else is in it.

    Raises:
        Problem: if it was built from another copy of the sources, or not by this program.
    """
    link = workspace / "src" / "retalis"
    if not workspace.exists():
        raise Problem(f"nothing is installed in {workspace}; give the --workspace that it was built in")
    is_incomplete = not os.path.lexists(link) and workspace == default_workspace(HERE, os.environ).resolve()
    if not is_incomplete and not (link.is_symlink() and link.resolve() == HERE):
        raise Problem(f"{link} does not lead to this copy of retalis: {workspace} was not built from it")
    other_packages = sorted({path.name for path in link.parent.glob("*")} - {"retalis", "CMakeLists.txt"})
    logs = [path for path in (workspace / "log").glob("*") if path.is_file()]
    record = read_recorded_packages(workspace)
    built_paths = [
        link,
        workspace / "venv",
        *workspace.glob(DOCS_VENV_PATTERN),
        *workspace.glob(FOLDER_PATTERN),
        workspace / PACKAGE_RECORD,
        *logs,
        *([] if other_packages else [workspace / name for name in CATKIN_OUTPUTS]),
    ]
    for path in filter(os.path.lexists, built_paths):
        print(f"{'would remove' if dry else 'Removing'} {path}", flush=True)
        if not dry:
            remove(path)
    for folder in (workspace / "log", workspace / "src", workspace, workspace.parent):
        may_be_removed = folder != workspace.parent or folder.name == "retalis"
        if not dry and may_be_removed and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
    if other_packages:
        print(
            f"{workspace} holds {', '.join(other_packages)} too: build, devel and install are left; build them again"
        )
    elif workspace.exists() and not dry:
        print(
            f"{workspace} is left: it holds {', '.join(sorted(path.name for path in workspace.iterdir()))} too"
        )
    print_remaining(record)


def read_recorded_packages(workspace: Path) -> List[str]:
    """Return the system packages that were installed for a workspace and still are, and changed system files."""
    record = workspace / PACKAGE_RECORD
    names = list(dict.fromkeys(record.read_text().split())) if record.exists() else []
    missing = find_missing_packages(names, query_installed_packages(names))
    return [name for name in names if name == HOSTS or name not in missing]


def print_remaining(record: Sequence[str]) -> None:
    """Print what was installed outside of the workspace."""
    packages = [name for name in record if name != HOSTS]
    if packages:
        print("These system packages were installed and are left, since other programs may need them:")
        print("  " + " ".join(packages))
    for path in (SOURCE_FILE, KEY_FILE):
        if Path(path).exists():
            print(f"{path} is left, for apt.")
    if HOSTS in record:
        print(f"The line '{LOCAL_HOST}' is left in {HOSTS}.")
    print(f"This clone is left: {HERE}")


def remove(path: Path) -> None:
    """Remove a file, a link, or a folder with its contents."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def main(argv: Sequence[str]) -> int:
    """Execute the command line; return the exit status."""
    options = parse_arguments(argv)
    environment = (
        minimal_environment(os.environ) if options.command in ("test", "lint", "docs") else dict(os.environ)
    )
    os.environ.clear()
    os.environ.update(environment, PATH=search_path(environment.get("PATH", "")))
    # The example for ROS 2 imports rclpy, also to print its help.
    if options.command == "demo" and not options.ros2 and {"-h", "--help"} & set(options.passed_arguments):
        return subprocess.call([sys.executable, DEMO_SCRIPT, "--help"])
    shell = Shell(options.workspace / "log", options.dry_run)
    ros2 = create_ros2_installation(options, shell) if options.ros2 else None
    setup = options.workspace / "devel" / "setup.bash" if ros2 is None else ros2.setup
    if options.command == "where":
        if not setup.exists():
            raise Problem(
                f"nothing has been built yet in {options.workspace}; "
                "run ./install.py, or give the --workspace that it was run with"
            )
        print(setup.with_suffix(f".{options.shell}"))
        return 0
    if options.command == "uninstall":
        uninstall(options.workspace, options.dry_run)
        return 0
    if options.command == "docs":
        return build_site(options, shell)
    if ros2 is not None:
        return run_ros2_command(options, ros2)
    platform = choose_platform(parse_os_release(Path("/etc/os-release").read_text()))
    test_packages = platform.test_packages if options.command == "test" else ()
    swi_packages = (SWI_PACKAGE,) if options.with_swi else ()
    platform = platform._replace(packages=[*platform.packages, *test_packages, *swi_packages])
    return run_command(options, Installation(platform, options.workspace, shell, not options.no_system))


def run_command(options: argparse.Namespace, installation: Installation) -> int:
    """Install the dependencies of a command, build, and run the command; return its exit status."""
    if options.command == "test" and not options.passed_arguments:
        print(TEST_DURATION_TEXT, flush=True)
    development_requirements = ["requirements-dev.txt"] if options.command in ("test", "lint") else []
    installation.install_system_packages()
    installation.add_localhost()
    installation.install_python_packages(["requirements.txt", *development_requirements])
    installation.build(install=options.install or options.command == "test")
    if options.command == "demo":
        status = installation.run([SYSTEM_PYTHON, DEMO_SCRIPT, *options.passed_arguments], cwd=None)
        if status == 0:
            print('To use retalis in this shell:  source "$(./install.py where)"', file=sys.stderr)
        return status
    if options.command == "test":
        os.environ["RETALIS_WORKSPACE"] = str(options.workspace)
        return installation.run(
            [
                SYSTEM_PYTHON,
                "-m",
                "pytest",
                *choose_parallel_options(options.passed_arguments),
                *options.passed_arguments,
            ]
        )
    if options.command == "lint":
        return run_lint(installation)
    setup = options.workspace / "devel" / "setup.bash"
    print(f"retalis is built. To use it:  source {setup}")
    return 0


def create_ros2_installation(options: argparse.Namespace, shell: Shell) -> Ros2Installation:
    """Return the installation of ROS 2 that the options name."""
    return Ros2Installation(options.ros2, options.workspace, HERE, SYSTEM_PYTHON, shell)


def run_ros2_command(options: argparse.Namespace, ros2: Ros2Installation) -> int:
    """Install ROS 2, build, and run a command in its environment; return the exit status of the command.

    Raises:
        Problem: if the system is not supported, or a step fails.
    """
    release = parse_os_release(Path("/etc/os-release").read_text())
    if (release.get("ID"), release.get("VERSION_ID")) != ("debian", "12"):
        name = release.get("PRETTY_NAME", "an unknown system")
        raise Problem(f"this is {name}: expected Debian 12 with --ros2; elsewhere, build with colcon")
    platform = DEBIAN_12._replace(packages=SYSTEM_PACKAGES)
    installation = Installation(platform, options.workspace, ros2.shell, not options.no_system)
    installation.install_system_packages()
    installation.link_sources()
    ros2.install_python_packages()
    ros2.build()
    python = str(ros2.venv / "bin" / "python3")
    if options.command == "demo":
        return ros2.run([python, ROS2_DEMO_SCRIPT, *options.passed_arguments])
    if options.command == "test":
        arguments = options.passed_arguments
        if not any(Path(HERE, argument.partition("::")[0]).exists() for argument in arguments):
            arguments = [*arguments, ROS2_TESTS]
        return ros2.run([python, "-m", "pytest", *choose_parallel_options(arguments), *arguments], cwd=HERE)
    print(f"retalis is built for ROS 2 {ros2.distribution}. To use it:  source {ros2.setup}")
    return 0


if __name__ == "__main__":
    try:
        try:
            sys.exit(main(sys.argv[1:]))
        except Problem as problem:
            sys.exit(f"install.py: {problem}")
        except KeyboardInterrupt:
            sys.exit(130)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the output has ended (``| head``). Python flushes stdout at exit, and would report the error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
