"""Looks up the texts of installed message types in the file system."""

import codecs
import os
import re
import sys
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

from ..foundation import type_fault

_ROS = "/opt/ros"
_SHARE = ("/usr/share", "/usr/local/share")
_MODULES = ("/usr/lib/python3/dist-packages",)
_DEPTH = 4

_FULL_TEXT = re.compile(r'^[ \t]*_full_text = """((?:[^"\\]|\\.|"(?!""))*)"""', re.MULTILINE | re.DOTALL)
"""The definition in a module that genpy has generated: always a literal in three double quotes."""

_ESCAPE = re.compile(
    r"""\\(?:\n|[\\'"abfnrtv]|[0-7]{1,3}|x[0-9a-fA-F]{2}|u[0-9a-fA-F]{4}|U[0-9a-fA-F]{8}|N\{[A-Za-z0-9 -]+\})"""
)
"""The escape sequences of Python's literals; a backslash before anything else stands for itself."""


class Installed:
    """Finds ``pkg/Type`` where ROS and its tools keep message definitions.

    In this order: ``msg/*.msg`` files of packages under ``ROS_PACKAGE_PATH``, ``CMAKE_PREFIX_PATH``,
    ``/opt/ros`` and ``/usr/share``; generated Python modules ``pkg/msg/_Type.py`` on the module path, which
    are read, not imported (Debian installs some types so only); the types that the package ``rosbags``
    brings, where it is installed.

    Args:
        packages: folders that contain packages, instead of the usual ones.
        modules: folders of Python modules, instead of the module path.
        rosbags: whether to ask ``rosbags``.
        further: folders that are looked at before these; a package's own, or one that contains packages.
    """

    def __init__(
        self,
        packages: Optional[Sequence[str]] = None,
        modules: Optional[Sequence[str]] = None,
        rosbags: bool = True,
        further: Sequence[str] = (),
    ):
        usual = _package_folders() if packages is None else packages
        self._packages = list(dict.fromkeys([*further, *usual]))
        self._modules = list(dict.fromkeys([*sys.path, *_MODULES] if modules is None else modules))
        self._rosbags = rosbags
        self._sources: Optional[Dict[str, str]] = None

    def types(self, package: str) -> List[str]:
        """Return the names of the types of a package, in the order of the alphabet; none where there is no such."""
        folders = [os.path.join(folder, package, "msg") for folder in (*self._packages, *self._modules)]
        nested = self._source_packages().get(package)
        found = {name for folder in folders for name in _type_names(folder)}
        if nested is not None:
            found.update(_type_names(os.path.join(nested, "msg")))
        return sorted(found.union(_rosbags_types().get(package, ())) if self._rosbags else found)

    def packages(self) -> List[str]:
        """Return the names of the packages that have messages, in the order of the alphabet."""
        found = set(self._source_packages())
        for folder in self._packages:
            found.update(_with_messages(folder))
        return sorted(found.union(_rosbags_types()) if self._rosbags else found)

    def text(self, name: str) -> Optional[Tuple[str, str]]:
        """Return the text of a type and where it was read, or None where it is not installed."""
        package, _, kind = name.partition("/")
        if type_fault(name) is not None:
            return None
        for path in self._message_files(package, kind):
            if os.path.isfile(path):
                return Path(path).read_text(encoding="utf-8", errors="replace"), path
        return self._module_text(package, kind) or (_rosbags_text(package, kind) if self._rosbags else None)

    def _message_files(self, package: str, kind: str) -> Iterator[str]:
        for folder in self._packages:
            yield os.path.join(folder, package, "msg", kind + ".msg")
            if os.path.basename(folder.rstrip("/")) == package:
                yield os.path.join(folder, "msg", kind + ".msg")
        nested = self._source_packages().get(package)
        if nested is not None:
            yield os.path.join(nested, "msg", kind + ".msg")

    def _source_packages(self) -> Dict[str, str]:
        """Return the packages that lie deeper in a folder of packages, as in a workspace's ``src``."""
        if self._sources is None:
            sources: Dict[str, str] = {}
            for folder in self._packages:
                if os.path.basename(folder.rstrip("/")) != "share":
                    _find_packages(folder, _DEPTH, sources)
            self._sources = sources  # only now: another thread must not search in a part of them
        return self._sources

    def _module_text(self, package: str, kind: str) -> Optional[Tuple[str, str]]:
        for folder in self._modules:
            path = os.path.join(folder, package, "msg", f"_{kind}.py")
            if os.path.isfile(path):
                text = _full_text(path)
                if text is not None:
                    return text, path
        return None


def _type_names(folder: str) -> Iterator[str]:
    """Yield the types whose definitions lie in a folder: ``Type.msg`` or ``_Type.py``."""
    for name in _names_in(folder):
        if name.endswith(".msg"):
            yield name[:-4]
        elif name.startswith("_") and name.endswith(".py") and not name.startswith("__"):
            yield name[1:-3]


def _with_messages(folder: str) -> Iterator[str]:
    """Yield the packages in a folder that have messages."""
    for name in _names_in(folder):
        if os.path.isdir(os.path.join(folder, name, "msg")):
            yield name


def _names_in(folder: str) -> List[str]:
    try:
        return os.listdir(folder)
    except OSError:  # a folder of the path that is not there or not ours to read
        return []


def _rosbags_types() -> Dict[str, List[str]]:
    """Return the types that ``rosbags`` brings, by package."""
    found: Dict[str, List[str]] = {}
    try:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - slow, and an optional package
    except ImportError:
        return found
    store = get_typestore(Stores.ROS1_NOETIC)
    names: Any = getattr(store, "fielddefs", None) or getattr(store, "FIELDDEFS", ())  # by its version
    for name in names:
        package, _, kind = name.partition("/msg/")
        found.setdefault(package, []).append(kind)
    return found


def _package_folders() -> List[str]:
    folders = [path for path in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if path]
    for prefix in os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            folders.append(os.path.join(prefix, "share"))
    return [*folders, *_distributions(), *_SHARE]


def _distributions() -> List[str]:
    """Return the folders of the distributions of ROS that are not Debian's."""
    try:
        names = sorted(os.listdir(_ROS))
    except OSError:  # none is there
        return []
    return [os.path.join(_ROS, name, "share") for name in names]


def _find_packages(folder: str, depth: int, found: Dict[str, str]) -> None:
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:  # a folder of the path that is not there or not ours to read
        return
    names = {entry.name for entry in entries}
    if "package.xml" in names:
        if "msg" in names:
            found.setdefault(os.path.basename(folder.rstrip("/")), folder)
        return
    if depth:
        for entry in entries:
            if not entry.name.startswith(".") and entry.is_dir():
                _find_packages(entry.path, depth - 1, found)


def _full_text(path: str) -> Optional[str]:
    """Return the definition that a generated Python module holds as ``_full_text``, without running the module.

    A scan and not `ast.parse`: CPython counts the depth of syntax trees per interpreter, so two threads that build
    one at the same time make each other fail, and every connection has a thread.
    """
    try:
        source = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    found = _FULL_TEXT.search(source)
    if found is None:
        return None
    try:
        return _ESCAPE.sub(lambda escape: codecs.decode(escape[0], "unicode_escape"), found[1])
    except ValueError:  # an escape of a character that does not exist
        return None


def _rosbags_text(package: str, kind: str) -> Optional[Tuple[str, str]]:
    try:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - slow, and an optional package
    except ImportError:
        return None
    store = get_typestore(Stores.ROS1_NOETIC)
    try:
        text = store.generate_msgdef(f"{package}/msg/{kind}", ros_version=1)[0]
    except KeyError:
        return None
    except Exception as error:
        if type(error).__name__ != "TypesysError":
            raise
        return None
    return text, "rosbags"
