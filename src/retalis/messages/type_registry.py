"""Looks up the texts of installed message types in the file system.

The message types that are known: from texts, and from what is installed. No part of ROS is needed.
"""

import codecs
import os
import re
import sys
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError, beginning
from ..foundation.ros_names import plain_type, type_fault
from .decoder import Decoder
from .encoder import Encoder
from .type_definition import BARE, MAX_TYPE_DEPTH, Definition, parse, split_sections

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


_SAME = {"tf/tfMessage": "tf2_msgs/TFMessage"}
"""Types that are another one by an old name: equal texts, equal checksums."""

_COMMON = {"tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n"}
"""Types that every robot sends and that not every system has as text (Debian, ``rosbags``)."""

_Key = Tuple[str, str]

_CodeKey = Tuple[str, str, str]
"""Type, checksum, and what its events are called."""

MAX_DEFINITION_CHARACTERS = 1_000_000
"""Characters that a definition may have, with those of the types in it."""

MOST_TYPES, MOST_TEXT = 1000, 16_000_000
"""Types that are added at most, and characters that their definitions may have all together."""

_SLOT = 2000
"""Bytes that a slot takes in a definition or in the functions of its type, as measured."""


class Learned(NamedTuple):
    """How to read the messages of a publisher, and whether their own type stands in for one that is not known."""

    decoder: Decoder
    instead: bool


class Definitions:
    r"""Message types by name, with their decoders and encoders.

    A type is looked for among those added from texts (connection headers, bags), then among the installed
    ones, then among the types nested in added texts.

    >>> definitions = Definitions()
    >>> bumper = definitions.add("my_robot/Bumper", "bool left\nbool right")
    >>> definitions.decoder(bumper).decode(b"\x01\x00")
    (functor('my_robot__0__Bumper', 2), atom('true'), atom('false'))

    Args:
        installed: where installed types are looked up; the usual places by default.
        bare: how many elements without bytes (messages without slots in an array) a message may have.
    """

    def __init__(self, installed: Optional[Installed] = None, bare: int = BARE):
        self._installed = Installed() if installed is None else installed
        self._bare = bare
        self._characters = 0
        self._added: Dict[str, Definition] = {}
        self._nested: Dict[str, Definition] = {}
        self._found: Dict[str, Definition] = {}
        self._by_text: Cache[_Key, Definition] = Cache(1000, 32 << 20, 32 << 20)
        self._decoders: Cache[_CodeKey, Decoder] = Cache(1000, 32 << 20, 32 << 20)
        self._encoders: Cache[_Key, Encoder] = Cache(1000, 32 << 20, 32 << 20)

    def add(self, name: str, text: str, md5sum: str = "") -> Definition:
        """Add a type from its text, which may contain the texts of nested types (``MSG: pkg/Type``).

        The first definition that is added under a name is the one that `find` gives; another text for the
        same name is read and returned all the same.

        Args:
            name: ``pkg/Type``, or ``pkg/msg/Type`` as in ROS 2; so wherever a type is named.
            text: the definition.
            md5sum: the checksum that came with the text; it is compared where it is given and is not ``*``.

        Raises:
            MessageError: for a text that is not a definition or too long, that names a type found nowhere, or that
                has another checksum; where too many types were added.
        """
        name = plain_type(name)
        definition = self._read(name, text, md5sum)
        if name not in self._added:
            self._note(definition, len(text))
        return definition

    def _read(self, name: str, text: str, md5sum: str) -> Definition:
        """Return the type that a text defines, and keep it only to be found again by the same text."""
        if len(text) > MAX_DEFINITION_CHARACTERS:
            raise MessageError(
                f"the definition of {beginning(name)} has {len(text)} characters: "
                f"at most {MAX_DEFINITION_CHARACTERS} are allowed"
            )
        definition = self._by_text.get((name, text))
        if definition is None:
            definition = _Resolver(self, split_sections(name, text)).resolve(name)
            self._by_text.keep((name, text), definition, 2 * len(text) + _SLOT * definition.measure.slots)
        if md5sum not in ("", "*", definition.md5sum):
            raise MessageError(
                f"the definition of {name} that came with the messages does not match theirs: "
                f"its checksum is {definition.md5sum}, theirs is {md5sum}"
            )
        return definition

    def _note(self, definition: Definition, characters: int) -> None:
        """Have a type be found by its name, and those nested in it.

        Raises:
            MessageError: where there are too many.
        """
        if len(self._added) >= MOST_TYPES or self._characters + characters > MOST_TEXT:
            raise MessageError(
                f"{definition.name} is refused: the definitions of {len(self._added)} message types "
                f"are held already, with {self._characters} characters (at most {MOST_TYPES}, with {MOST_TEXT})"
            )
        self._characters += characters
        self._added[definition.name] = definition
        for nested in definition.dependencies():
            self._nested.setdefault(nested.name, nested)

    def learn(self, name: str, sent: str, text: str, md5sum: str, event: str = "") -> Learned:
        """Return what reads the messages of a publisher as a type, as events of a name; see `received`.

        >>> definitions = Definitions()
        >>> learned = definitions.learn("my_robot/Bumper", "my_robot/Bumper", "bool left", "*")
        >>> Engine().show(learned.decoder.decode(bytes([0])))
        'my_robot__0__Bumper(false)'

        Raises:
            MessageError: where they are of another type, or what came with them is wrong.
        """
        name, sent = plain_type(name), plain_type(sent)
        unknown = name not in self
        definition = self.received(name, sent, text, md5sum)
        return Learned(self.decoder(definition.as_event(event)), unknown and sent != name)

    def received(self, name: str, sent: str, text: str, md5sum: str) -> Definition:
        """Return the definition by which to read messages as a type: the known one, or what came with them.

        A type that is known stays what it is for everybody else: a publisher can describe its own messages, not
        others'.

        >>> Definitions().received("my_robot/Bumper", "my_robot/Bumper", "bool left", "*").name
        'my_robot/Bumper'

        Args:
            name: the type that is wanted.
            sent: the type as which they are sent; the wanted one may be another name of it.
            text: the definition that came with them.
            md5sum: the checksum that came with them.

        Raises:
            MessageError: where they are of another type, or what came with them is wrong.
        """
        name, sent = plain_type(name), plain_type(sent)
        known = self.find(name) if name in self else None
        if known is not None and known.md5sum == md5sum:
            return known
        definition = self._read(sent, text, md5sum)
        if sent != name and known is not None and known.md5sum != definition.md5sum:
            raise MessageError(f"expected {name}, found {sent}")
        if known is None and sent not in self:
            self._note(definition, len(text))
        return definition if sent == name else definition.renamed(name)

    def find(self, name: str) -> Definition:
        """Return the definition of ``pkg/Type``.

        >>> Definitions().find("std_msgs/String").full_text.split()
        ['string', 'data']

        Raises:
            MessageError: where it is found nowhere, or is wrong.
        """
        name = plain_type(name)
        found = self._added.get(name) or self._found.get(name)
        if found is None:
            found = self._found[name] = _Resolver(self, {}).resolve(name)
        return found

    def __contains__(self, name: object) -> bool:
        """Tell whether `find` finds a type."""
        try:
            self.find(str(name))
        except MessageError:
            return False
        return True

    def decoder(self, definition: Union[Definition, str]) -> Decoder:
        """Return the decoder of a type, compiled once."""
        definition = self.find(definition) if isinstance(definition, str) else definition
        key = (definition.name, definition.md5sum, definition.event)
        found = self._decoders.get(key)
        if found is None:
            found = self._decoders.keep(
                key, Decoder(definition, self._bare), _SLOT * (definition.measure.slots + 2)
            )
        return found

    def encoder(self, definition: Union[Definition, str]) -> Encoder:
        """Return the encoder of a type, compiled once.

        >>> definitions = Definitions()
        >>> bumper = definitions.add("my_robot/Bumper", "bool left")
        >>> definitions.encoder(bumper) is definitions.encoder("my_robot/Bumper")
        True
        """
        definition = self.find(definition) if isinstance(definition, str) else definition
        key = (definition.name, definition.md5sum)
        found = self._encoders.get(key)
        if found is None:
            found = self._encoders.keep(key, Encoder(definition), _SLOT * (definition.measure.slots + 2))
        return found

    def installed_text(self, name: str) -> Optional[Tuple[str, str]]:
        """Return the text of an installed type and where it was read, or None.

        >>> text, where = Definitions().installed_text("std_msgs/String")
        >>> text.split()
        ['string', 'data']
        """
        return self._installed.text(plain_type(name))

    def misspelt(self, name: str) -> str:
        """Return the type that was probably meant by one that is not known; "" where none is like it.

        >>> Definitions().misspelt("std_msgs/Strng"), Definitions().misspelt("string")
        ('std_msgs/String', 'std_msgs/String')
        """
        name = plain_type(name)
        if name in self:
            return ""
        package, _, kind = name.rpartition("/")
        packages = self._installed.packages()
        if not package:
            return next((f"{one}/{found}" for one in packages for found in self._alike(one, kind, 1)), "")
        for one in dict.fromkeys([package, *get_close_matches(package, packages, 3, 0.8)]):
            close = self._alike(one, kind, 0.7)
            if close and (one == package or close[0] == kind):
                return f"{one}/{close[0]}"
        return ""

    def _alike(self, package: str, kind: str, alike: float) -> List[str]:
        """Return the type of a package whose name is most like another, large letters or small; at most one."""
        small: Dict[str, str] = {}
        for name in self._installed.types(package):
            small.setdefault(name.lower(), name)
        return [small[one] for one in get_close_matches(kind.lower(), small, 1, alike)]

    def added(self) -> List[str]:
        """Return the names of the types that were added from texts, and of those nested in them.

        >>> definitions = Definitions()
        >>> added = definitions.add("my_robot/Bumper", "bool left")
        >>> definitions.added()
        ['my_robot/Bumper']
        """
        return list(dict.fromkeys([*self._added, *self._nested]))

    def installed(self) -> List[str]:
        """Return the names of the types that are installed.

        >>> "std_msgs/String" in Definitions().installed()
        True
        """
        packages = self._installed.packages()
        return [f"{package}/{kind}" for package in packages for kind in self._installed.types(package)]

    def known(self, name: str) -> Optional[Definition]:
        """Return an added or nested type without looking at what is installed.

        >>> definitions = Definitions()
        >>> definitions.known("my_robot/Bumper") is None
        True
        >>> definitions.add("my_robot/Bumper", "bool left") is definitions.known("my_robot/Bumper")
        True
        """
        name = plain_type(name)
        return self._added.get(name) or self._nested.get(name)


class _Resolver:
    """Reads a type and those it is made of: from the sections of one text first, then from the registry."""

    def __init__(self, registry: Definitions, sections: Dict[str, str], inside: Optional[Set[str]] = None):
        self.registry = registry
        self.sections = sections
        self.done: Dict[str, Definition] = {}
        self.open: Set[str] = set() if inside is None else inside
        """The types that are being read, the others in which they lie included."""

    def resolve(self, name: str) -> Definition:
        found = self.done.get(name)
        if found is None:
            fault = type_fault(name)
            if fault is not None:
                raise MessageError(fault)
            if name in self.open:
                raise MessageError(f"{name} contains itself")
            if len(self.open) > MAX_TYPE_DEPTH:
                raise MessageError(f"types cannot be nested more than {MAX_TYPE_DEPTH} deep")
            self.open.add(name)
            try:
                found = self.done[name] = self.read(name)
            finally:
                self.open.discard(name)
        return found

    def read(self, name: str) -> Definition:
        text = self.sections.get(name)
        if text is not None:
            return parse(name, text, self._nested)
        installed = self.registry.installed_text(name)
        if installed is not None:
            text, source = installed
            sections = split_sections(name, text)
            if len(sections) > 1:
                return _Resolver(self.registry, sections, self.open).read(name)
            return parse(name, text, self._nested, source)
        known = self.registry.known(name)
        if known is not None:
            return known
        if name in _COMMON:
            return parse(name, _COMMON[name], self._nested)
        if name in _SAME:
            return self.resolve(_SAME[name]).renamed(name)
        raise MessageError(
            f"no definition of the message type {beginning(name)} is installed or has been received"
        )

    def _nested(self, written: str, package: str) -> Definition:
        for name in _candidates(written, package, self.sections):
            if name in self.sections:
                return self.resolve(name)
        return self.resolve(written if "/" in written else f"{package}/{written}")


def _candidates(written: str, package: str, sections: Dict[str, str]) -> Sequence[str]:
    """Return the names that a nested type may have in a concatenated text, the likeliest first."""
    if "/" in written:
        return [written]
    others: List[str] = [name for name in sections if name.endswith("/" + written)]
    return [f"{package}/{written}"] + (others if len(others) == 1 else [])
