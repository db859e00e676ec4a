"""Registry of message types: received definitions, and definitions that are installed on the system.

`InstalledTypes` finds the definition of a type in the classes that genpy has generated, in ``.msg`` files, and in the
package ``rosbags``. `Definitions` resolves nested types, compiles decoders and encoders once per version of a type,
and bounds the memory of types that publishers send.

This package does not depend on ROS. Callers that do pass a function that inspects generated classes (see
`ros1.installed_message_classes`). The definition in such a class is compared with the other attributes of the class,
so that this package and rospy cannot read the same bytes as different messages.
"""

import os
import sys
from copy import copy
from difflib import get_close_matches
from itertools import zip_longest
from pathlib import Path
from typing import (
    Any,
    Callable,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ..foundation.bounded_caches import Cache
from ..foundation.displayed_text import shorten
from ..foundation.errors import MessageError
from ..foundation.ros_name_checks import ros1_type_name, type_fault
from ..foundation.similar_names import closest_name
from .action_events import actionlib_name, find_action_event
from .cdr_decoder import CdrDecoder
from .cdr_encoder import CdrEncoder
from .decoder import Decoder
from .encoder import Encoder
from .ros2_definitions import NAMES_IN_ROS2, FindText, convert_ros2_text, find_interfaces, is_ros2_text
from .type_definition import (
    HEADER,
    HEADER_NAMES,
    MAX_EMPTY_ELEMENTS,
    MAX_TYPE_DEPTH,
    PLAIN_STRINGS,
    QUOTED_STRINGS,
    SEPARATOR,
    Definition,
    Field,
    SerializationFormat,
    parse,
    split_sections,
    warn_of_ignored_constants,
)

_ROSBAGS_SOURCE = "rosbags"
"""Source of the types that the package ``rosbags`` provides, those of ROS 1."""

_ROS_FOLDER = "/opt/ros"
_SHARE_FOLDERS = ("/usr/share", "/usr/local/share")
_MAX_FOLDER_DEPTH = 4
"""Maximum depth of packages below a folder of a workspace."""


class GeneratedClass(NamedTuple):
    """Attributes of a message class that genpy has generated.

    Attributes:
        text: the definition with those of nested types (``_full_text``).
        md5sum: the checksum (``_md5sum``).
        slots: the names of the slots (``__slots__``).
        slot_types: the types of the slots (``_slot_types``), for example ``geometry_msgs/Point[]``.
        source: the file of the class's module.
    """

    text: str
    md5sum: str
    slots: Tuple[str, ...]
    slot_types: Tuple[str, ...]
    source: str

    def check(self, definition: Definition) -> None:
        """Compare the class with the definition that its text contains.

        Raises:
            MessageError: if they differ, so that rospy would read other messages than this package.
        """
        fields = definition.fields
        slots = [_expected_slot_name(slot, name) for slot, name in zip_longest(fields, self.slots)]
        slot_types = [HEADER if slot_type in HEADER_NAMES else slot_type for slot_type in self.slot_types]
        if self.md5sum != definition.md5sum:
            problem = f"its checksum is {self.md5sum}, that of its definition is {definition.md5sum}"
        elif slots != list(self.slots) or slot_types != [slot.describe() for slot in fields]:
            problem = "its slots are not those of its definition"
        else:
            return
        raise MessageError(
            f"{self.source}: the generated class of {definition.name} does not match its own definition: {problem}; "
            "build its package again"
        )


def _expected_slot_name(slot: Optional[Field], generated_name: Optional[str]) -> Optional[str]:
    """Return the expected name of a slot in a generated class: genpy appends "_" to the keywords of Python."""
    if slot is None:
        return None
    return generated_name if generated_name == f"{slot.name}_" else slot.name


InspectClass = Callable[[str], Optional[GeneratedClass]]
"""Function that returns the attributes of the generated class of ``pkg/Type``, or None if there is none.

It raises `MessageError` if the class cannot be imported.
"""


class InstalledType(NamedTuple):
    """Definition of an installed type.

    Attributes:
        text: the definition; that of a generated class includes those of nested types.
        source: file that contains it, or ``rosbags``.
        generated: the generated class that the definition comes from, or None.
        is_derived: whether the type is derived from a service or an action of ROS 2; the text is in the syntax of
            ROS 2 then, and includes the other types that are derived from it.
    """

    text: str
    source: str
    generated: Optional[GeneratedClass] = None
    is_derived: bool = False


class InstalledTypes:
    """Message definitions that are installed on the system.

    They are searched in this order:

    1. ``msg/*.msg`` files in ``extra_folders``;
    2. the classes that genpy has generated, which rospy uses, too;
    3. ``msg/*.msg`` files of packages under ``ROS_PACKAGE_PATH``, ``CMAKE_PREFIX_PATH``, ``/opt/ros`` and
       ``/usr/share``;
    4. ``srv/*.srv`` and ``action/*.action`` files of the same folders, from which ROS 2 derives types;
    5. the types of the package ``rosbags``, if that is installed.

    A class is inspected only if there is a file ``pkg/msg/_Type.py`` on the module path. Other nodes choose the names
    of types, and must not make this process import modules that do not define messages.

    Args:
        packages: folders that contain packages, instead of the standard ones.
        modules: folders of Python modules, instead of the module path.
        include_rosbags: whether the types of ``rosbags`` are included.
        extra_folders: folders that are searched first; each is a package or contains packages.
        inspect_class: inspects generated classes; none are used by default.
    """

    def __init__(
        self,
        packages: Optional[Sequence[str]] = None,
        modules: Optional[Sequence[str]] = None,
        include_rosbags: bool = True,
        extra_folders: Sequence[str] = (),
        inspect_class: Optional[InspectClass] = None,
    ):
        self._extra_folders = _PackageFolders(extra_folders)
        self._folders = _PackageFolders(_find_standard_folders() if packages is None else packages)
        self._inspect_class = inspect_class
        # Without a function that imports them, generated modules are of no use.
        module_folders = () if inspect_class is None else sys.path if modules is None else modules
        self._module_folders = list(dict.fromkeys(module_folders))
        self._include_rosbags = include_rosbags

    def types(self, package: str) -> List[str]:
        """Return the names of the types of a package in alphabetical order; empty for an unknown package."""
        names = self._list_types_in_folders(package)
        return sorted(names.union(_list_rosbags_types().get(package, ())) if self._include_rosbags else names)

    def has_package(self, package: str) -> bool:
        """Return whether a package with messages is installed; rosbags has only the types of some distributions."""
        return bool(self._list_types_in_folders(package))

    def _list_types_in_folders(self, package: str) -> Set[str]:
        folders = [*self._extra_folders.message_folders(package), *self._folders.message_folders(package)]
        folders += [os.path.join(folder, package, "msg") for folder in self._module_folders]
        return {name for folder in folders for name in _list_type_names(folder)}

    def packages(self) -> List[str]:
        """Return the names of the packages that have messages, in alphabetical order."""
        names = {*self._extra_folders.packages(), *self._folders.packages()}
        for folder in self._module_folders:
            names.update(_list_packages_with_messages(folder))
        return sorted(names.union(_list_rosbags_types()) if self._include_rosbags else names)

    def interfaces(self, folder_name: str) -> List[str]:
        """Return the names of the services (``srv``) or actions (``action``) of all packages, ``pkg/Type``."""
        names = {*self._extra_folders.interfaces(folder_name), *self._folders.interfaces(folder_name)}
        return sorted(names)

    def text(self, name: str) -> Optional[Tuple[str, str]]:
        """Return the text of a type and its source, or None if the type is not installed.

        Raises:
            MessageError: if only a generated class defines the type, and it cannot be imported.
        """
        installed_type = self.find(name)
        return None if installed_type is None else (installed_type.text, installed_type.source)

    def find(self, name: str) -> Optional[InstalledType]:
        """Return the definition of a type, or None if the type is not installed.

        Raises:
            MessageError: if only a generated class defines the type, and it cannot be imported.
        """
        package, _, type_name = name.partition("/")
        if type_fault(name) is not None:
            return None
        import_error: Optional[MessageError] = None
        installed_type = self._extra_folders.read(package, type_name)
        if installed_type is None:
            try:
                installed_type = self._inspect(package, type_name)
            except MessageError as error:
                # Messages can be decoded without the class, so another definition of the type is searched first.
                import_error = error
        if installed_type is None:
            installed_type = self._folders.read(package, type_name) or self._read_derived(name)
        if installed_type is None and self._include_rosbags:
            installed_type = _read_rosbags_type(package, type_name)
        if installed_type is None and import_error is not None:
            raise import_error
        return installed_type

    def _read_derived(self, name: str) -> Optional[InstalledType]:
        """Return the definition of a type that is derived from a service or an action, or None if there is none."""
        for interface, folder in find_interfaces(name):
            package, _, interface_name = interface.name.partition("/")
            for folders in (self._extra_folders, self._folders):
                installed_interface = folders.read(package, interface_name, folder)
                if installed_interface is None:
                    continue
                text, source = installed_interface.text, installed_interface.source
                try:
                    texts = interface.split(text)
                except MessageError as error:
                    raise MessageError(f"{source}: {error.message}") from error
                parts = [f"{SEPARATOR}\nMSG: {type_name}\n{texts[type_name]}" for type_name in texts]
                return InstalledType("\n".join([texts[name], *parts]), source, is_derived=True)
        return None

    def _inspect(self, package: str, type_name: str) -> Optional[InstalledType]:
        if self._inspect_class is None:
            return None
        modules = [os.path.join(package, "msg", f"_{type_name}.py")]
        service, _, part = type_name.rpartition("_")
        if part in ("Request", "Response"):
            modules.append(os.path.join(package, "srv", f"_{service}.py"))
        paths = (os.path.join(folder, module) for folder in self._module_folders for module in modules)
        if not any(map(os.path.isfile, paths)):
            return None
        generated = self._inspect_class(f"{package}/{type_name}")
        return None if generated is None else InstalledType(generated.text, generated.source, generated)


class _PackageFolders:
    """Folders that contain packages with ``.msg``, ``.srv`` and ``.action`` files.

    A folder may contain packages, contain them in nested folders (the ``src`` of a workspace), or be a package.
    """

    def __init__(self, folders: Sequence[str]):
        self._folders = list(dict.fromkeys(folders))
        self._nested_packages: Optional[Dict[str, str]] = None

    def packages(self) -> Set[str]:
        """Return the names of the packages that have messages."""
        names = set(self._find_nested_packages())
        for folder in self._folders:
            names.update(_list_packages_with_messages(folder))
        return names

    def interfaces(self, folder_name: str) -> Iterator[str]:
        """Yield the names of the services (``srv``) or actions (``action``) of all packages, ``pkg/Type``."""
        packages = [os.path.join(folder, name) for folder in self._folders for name in _list_names(folder)]
        for path in (*self._folders, *packages, *self._find_nested_packages().values()):
            for name in _list_names(os.path.join(path, folder_name)):
                type_name, suffix = os.path.splitext(name)
                if suffix == f".{folder_name}":
                    yield f"{os.path.basename(path.rstrip('/'))}/{type_name}"

    def message_folders(self, package: str, folder_name: str = "msg") -> Iterator[str]:
        """Yield the paths that the ``msg`` folder of a package can have, or another folder of definitions."""
        for folder in self._folders:
            yield os.path.join(folder, package, folder_name)
            # Entries of ROS_PACKAGE_PATH often are packages.
            if os.path.basename(folder.rstrip("/")) == package:
                yield os.path.join(folder, folder_name)
        nested = self._find_nested_packages().get(package)
        if nested is not None:
            yield os.path.join(nested, folder_name)

    def read(self, package: str, type_name: str, folder_name: str = "msg") -> Optional[InstalledType]:
        """Return the definition of a type, service or action, or None if no folder contains it.

        Args:
            package: name of the package.
            type_name: name of the type.
            folder_name: ``msg``, ``srv`` or ``action``.
        """
        for folder in self.message_folders(package, folder_name):
            path = os.path.join(folder, f"{type_name}.{folder_name}")
            if os.path.isfile(path):
                return InstalledType(Path(path).read_text(encoding="utf-8", errors="replace"), path)
        return None

    def _find_nested_packages(self) -> Dict[str, str]:
        """Return the folders of the packages that are nested in other folders, by package."""
        if self._nested_packages is None:
            packages: Dict[str, str] = {}
            for folder in self._folders:
                # Install spaces are flat; searching them recursively would read thousands of folders.
                if os.path.basename(folder.rstrip("/")) != "share":
                    _find_packages(folder, _MAX_FOLDER_DEPTH, packages)
            # Assigned last: another thread must not search in an incomplete dictionary.
            self._nested_packages = packages
        return self._nested_packages


def _list_type_names(folder: str) -> Iterator[str]:
    """Yield the types that a folder defines, as ``Type.msg`` or ``_Type.py``."""
    for name in _list_names(folder):
        if name.endswith(".msg"):
            yield name[:-4]
        elif name.startswith("_") and name.endswith(".py") and not name.startswith("__"):
            yield name[1:-3]


def _list_packages_with_messages(folder: str) -> Iterator[str]:
    for name in _list_names(folder):
        if os.path.isdir(os.path.join(folder, name, "msg")):
            yield name


def _list_names(folder: str) -> List[str]:
    try:
        return os.listdir(folder)
    except OSError:  # the folder does not exist or is not readable
        return []


def _list_rosbags_types() -> Dict[str, List[str]]:
    """Return the types of the package ``rosbags``, by package."""
    types: Dict[str, List[str]] = {}
    try:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - slow, and an optional package
    except ImportError:
        return types
    store = get_typestore(Stores.ROS1_NOETIC)
    # The attribute depends on the version of rosbags.
    names: Any = getattr(store, "fielddefs", None) or getattr(store, "FIELDDEFS", ())
    for name in names:
        package, _, type_name = name.partition("/msg/")
        types.setdefault(package, []).append(type_name)
    return types


def _find_standard_folders() -> List[str]:
    """Return the folders of packages that the environment names, and those of installations."""
    folders = [path for path in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if path]
    for prefix in os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            folders.append(os.path.join(prefix, "share"))
    return [*folders, *_find_distributions(), *_SHARE_FOLDERS]


def _find_distributions() -> List[str]:
    """Return the folders of ROS distributions that are installed below ``/opt/ros``."""
    try:
        names = sorted(os.listdir(_ROS_FOLDER))
    except OSError:  # no distribution is installed
        return []
    return [os.path.join(_ROS_FOLDER, name, "share") for name in names]


def _find_packages(folder: str, depth: int, packages: Dict[str, str]) -> None:
    """Add the packages with messages, at most ``depth`` folders below a folder, to ``packages``: folders by name."""
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:  # the folder does not exist or is not readable
        return
    names = {entry.name for entry in entries}
    # Packages cannot be nested (REP 128), so the search ends at a package.
    if "package.xml" in names:
        if "msg" in names:
            packages.setdefault(os.path.basename(folder.rstrip("/")), folder)
        return
    if depth:
        for entry in entries:
            if not entry.name.startswith(".") and entry.is_dir():
                _find_packages(entry.path, depth - 1, packages)


def _read_rosbags_type(package: str, type_name: str) -> Optional[InstalledType]:
    """Return the definition that the package ``rosbags`` has of a type, or None."""
    try:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - slow, and an optional package
    except ImportError:
        return None
    store = get_typestore(Stores.ROS1_NOETIC)
    try:
        text, *_ = store.generate_msgdef(f"{package}/msg/{type_name}", ros_version=1)
    except KeyError:
        return None
    except Exception as error:
        # Compared by name, so that no version of rosbags needs to export the class.
        if type(error).__name__ != "TypesysError":
            raise
        return None
    # Versions for Python 3.8 write the constants of type byte so, and its slots as byte.
    return InstalledType(f"\n{text}".replace("\noctet ", "\nbyte ")[1:], _ROSBAGS_SOURCE)


_FALLBACK_DEFINITIONS = {
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "std_srvs/Empty_Request": "",
    "std_srvs/Empty_Response": "",
    "std_srvs/SetBool_Request": "bool data\n",
    "std_srvs/SetBool_Response": "bool success\nstring message\n",
    "std_srvs/Trigger_Request": "",
    "std_srvs/Trigger_Response": "bool success\nstring message\n",
    "retalis/GraphChange": "string kind\nstring node\nstring name\nstring detail\n",
}
"""Types that every robot has, and that some systems do not install as text (Debian, ``rosbags``)."""

_TypeKey = Tuple[Union[str, bool], ...]
"""Name of a type with its text or its checksum."""

_DecoderKey = Tuple[str, str, str, bool, str]
"""Type, checksum and name of the events."""

MAX_DEFINITION_CHARACTERS = 1_000_000
"""Maximum length of a definition, including nested types."""

MAX_ADDED_TYPES = 1000
"""Maximum number of types that are added from texts."""

MAX_ADDED_CHARACTERS = 16_000_000
"""Maximum total length of their definitions."""

_BYTES_PER_SLOT = 2000
"""Memory in bytes of a slot in a definition or in the generated functions of its type, as measured."""


class Learned(NamedTuple):
    """Decoder of a publisher's messages.

    Attributes:
        is_replacement: whether the requested type is unknown and the publisher declares another name.
    """

    decoder: Decoder
    is_replacement: bool


class Definitions:
    r"""Message types by name, with their decoders and encoders.

    A type is searched among those added from texts (connection headers, bags), then among the installed types, then
    among the types nested in added texts.

    >>> definitions = Definitions()
    >>> bumper = definitions.add("my_robot/Bumper", "bool left\nbool right")
    >>> definitions.decoder(bumper).decode(b"\x01\x00")
    (functor('my_robot__0__Bumper', 2), atom('true'), atom('false'))

    Args:
        installed: source of installed types; searches the standard folders by default.
        max_empty_elements: limit for zero-byte elements in a message (elements of arrays whose type has no slots).
        strings: form of strings in terms: `QUOTED_STRINGS` or `PLAIN_STRINGS`.

    Attributes:
        strings: see above.
    """

    def __init__(
        self,
        installed: Optional[InstalledTypes] = None,
        max_empty_elements: int = MAX_EMPTY_ELEMENTS,
        strings: str = QUOTED_STRINGS,
    ):
        self.strings = strings
        self._installed = InstalledTypes() if installed is None else installed
        self._max_empty_elements = max_empty_elements
        # A dictionary, because it is shared by the registries of both forms of strings.
        self._characters: Dict[str, int] = {}
        self._added: Dict[str, Definition] = {}
        self._nested: Dict[str, Definition] = {}
        self._resolved: Dict[str, Definition] = {}
        self._by_text: Cache[_TypeKey, Definition] = Cache(1000, 32 << 20, 32 << 20)
        self._decoders: Cache[_DecoderKey, Decoder] = Cache(1000, 32 << 20, 32 << 20)
        self._encoders: Cache[_TypeKey, Encoder] = Cache(1000, 32 << 20, 32 << 20)

    def with_strings(self, strings: str) -> "Definitions":
        """Return the same types with another form of strings in terms.

        Types that are added to one of the two are known to the other.

        >>> definitions = Definitions().with_strings("plain")
        >>> definitions.decoder("std_msgs/String").decode(bytes([4, 0, 0, 0]) + b"anna")[1]
        atom('anna')

        Args:
            strings: `QUOTED_STRINGS` or `PLAIN_STRINGS`.
        """
        if strings == self.strings:
            return self
        twin = copy(self)
        twin.strings = strings
        return twin

    def _in_form(self, definition: Definition) -> Definition:
        """Return a definition with the form of strings that the types have here."""
        return definition.with_strings(PLAIN_STRINGS) if self.strings == PLAIN_STRINGS else definition

    def add(self, name: str, text: str, md5sum: str = "") -> Definition:
        """Add a type from its text, which may contain the texts of nested types (``MSG: pkg/Type``).

        `find` returns the first definition that was added under a name. A different text for the same name is parsed
        and returned, but not registered.

        Args:
            name: ``pkg/Type``, or ``pkg/msg/Type`` as in ROS 2. This holds for all arguments that name a type.
            text: the definition.
            md5sum: checksum that was sent with the text; it is compared unless it is empty or ``*``.

        Raises:
            MessageError: if the text is not a valid definition, is too long, names an unknown type, or has another
                checksum; or if too many types were added.
        """
        name = ros1_type_name(name)
        definition = self._read(name, text, md5sum)
        if name not in self._added:
            self._register(definition, len(text))
        return self._in_form(definition)

    def _read(self, name: str, text: str, md5sum: str) -> Definition:
        """Parse a text, or return its cached definition; the type is not registered by its name."""
        if len(text) > MAX_DEFINITION_CHARACTERS:
            raise MessageError(
                f"the definition of {shorten(name)} has {len(text)} characters: "
                f"at most {MAX_DEFINITION_CHARACTERS} are allowed"
            )
        # Publishers of one topic send the same text with each connection.
        definition = self._by_text.get((name, text))
        if definition is None:
            registry = self.with_strings(QUOTED_STRINGS)
            definition = _Resolver(registry, self._installed, split_sections(name, text)).resolve(name)
            warn_of_ignored_constants(
                [
                    problem
                    for part in (definition, *definition.dependencies())
                    for problem in part.ignored_constants()
                ]
            )
            self._by_text.store(
                (name, text), definition, 2 * len(text) + _BYTES_PER_SLOT * definition.measure.slot_count
            )
        if md5sum not in ("", "*", definition.md5sum):
            raise MessageError(
                f"the definition of {name} does not match the messages: its checksum is {definition.md5sum}, "
                f"theirs is {md5sum}"
            )
        return definition

    def _register(self, definition: Definition, characters: int) -> None:
        """Register a type and its nested types by name.

        Raises:
            MessageError: if too many types were added.
        """
        # Registered types are never removed, so their count must be bounded: each publisher can send new ones.
        total = sum(self._characters.values())
        if len(self._added) >= MAX_ADDED_TYPES or total + characters > MAX_ADDED_CHARACTERS:
            raise MessageError(
                f"{definition.name} is not added: {len(self._added)} message types with {total} "
                f"characters were added before: at most {MAX_ADDED_TYPES} types with {MAX_ADDED_CHARACTERS} "
                "characters are allowed"
            )
        self._characters[definition.name] = characters
        self._added[definition.name] = definition
        for nested in definition.dependencies():
            self._nested.setdefault(nested.name, nested)

    def learn(
        self,
        name: str,
        sent: str,
        text: str,
        md5sum: str,
        event: str = "",
        serialization_format: SerializationFormat = SerializationFormat.ROS1,
    ) -> Learned:
        """Return the decoder of a publisher's messages as events of the name ``event``; see `received`.

        >>> definitions = Definitions()
        >>> learned = definitions.learn("my_robot/Bumper", "my_robot/Bumper", "bool left", "*")
        >>> Engine().show(learned.decoder.decode(bytes([0])))
        'my_robot__0__Bumper(false)'

        Raises:
            MessageError: if they are of another type, or their definition is invalid.
        """
        name, sent = ros1_type_name(name), ros1_type_name(sent)
        is_unknown = name not in self
        definition = self.received(name, sent, text, md5sum)
        decoder = self.decoder(definition.as_event(event), serialization_format)
        return Learned(decoder, is_unknown and sent != name)

    def received(self, name: str, sent: str, text: str, md5sum: str) -> Definition:
        """Return the definition by which a publisher's messages are read as a type: the known one, or the sent one.

        The sent definition is used for the messages of this publisher only; it does not replace a known type.

        >>> Definitions().received("my_robot/Bumper", "my_robot/Bumper", "bool left", "*").name
        'my_robot/Bumper'

        Args:
            name: the requested type.
            sent: the type that the publisher declares; ``name`` may be another name of it.
            text: the definition that the publisher sent.
            md5sum: the checksum that the publisher sent.

        Raises:
            MessageError: if they are of another type, or their definition is invalid.
        """
        name, sent = ros1_type_name(name), ros1_type_name(sent)
        known = self.find(name) if name in self else None
        # The usual case: nothing has to be parsed.
        if known is not None and known.md5sum == md5sum:
            return known
        definition = self._read(sent, text, md5sum)
        if sent != name and known is not None and known.md5sum != definition.md5sum:
            raise MessageError(f"expected {name}, found {sent}")
        # Registered under the publisher's name, not under the requested one, which may belong to another package.
        if known is None and sent not in self:
            self._register(definition, len(text))
        definition = self._in_form(definition)
        return definition if sent == name else definition.renamed(name)

    def find(self, name: str) -> Definition:
        """Return the definition of ``pkg/Type``.

        >>> Definitions().find("std_msgs/String").full_text.split()
        ['string', 'data']

        Raises:
            MessageError: if the type is unknown, or its definition is invalid.
        """
        name = ros1_type_name(name)
        definition = self._added.get(name) or self._resolved.get(name)
        if definition is None:
            registry = self.with_strings(QUOTED_STRINGS)
            definition = self._resolved[name] = _Resolver(registry, self._installed, {}).resolve(name)
        return self._in_form(definition)

    def __contains__(self, name: object) -> bool:
        """Return whether `find` finds a type."""
        try:
            self.find(str(name))
        except MessageError:
            return False
        return True

    def decoder(
        self,
        definition: Union[Definition, str],
        serialization_format: SerializationFormat = SerializationFormat.ROS1,
    ) -> Decoder:
        """Return the decoder of a type for messages in a format, which is compiled once."""
        definition = self.find(definition) if isinstance(definition, str) else self._in_form(definition)
        is_cdr = serialization_format is SerializationFormat.CDR
        # The checksum does not include comments, and these tell wide strings.
        key = (
            definition.name,
            definition.md5sum,
            definition.event,
            definition.has_plain_strings,
            definition.full_text if is_cdr else "",
        )
        decoder = self._decoders.get(key)
        if decoder is None:
            new_decoder = CdrDecoder(definition) if is_cdr else Decoder(definition, self._max_empty_elements)
            size = _BYTES_PER_SLOT * (definition.measure.slot_count + 2) + len(key[-1])
            decoder = self._decoders.store(key, new_decoder, size)
        return decoder

    def encoder(
        self,
        definition: Union[Definition, str],
        serialization_format: SerializationFormat = SerializationFormat.ROS1,
    ) -> Encoder:
        """Return the encoder of a type for messages in a format, which is compiled once.

        >>> definitions = Definitions()
        >>> bumper = definitions.add("my_robot/Bumper", "bool left")
        >>> definitions.encoder(bumper) is definitions.encoder("my_robot/Bumper")
        True
        """
        definition = self.find(definition) if isinstance(definition, str) else self._in_form(definition)
        is_cdr = serialization_format is SerializationFormat.CDR
        key = (
            definition.name,
            definition.md5sum,
            definition.has_plain_strings,
            definition.full_text if is_cdr else "",
        )
        encoder = self._encoders.get(key)
        if encoder is None:
            size = _BYTES_PER_SLOT * (definition.measure.slot_count + 2) + len(key[-1])
            new_encoder = CdrEncoder(definition) if is_cdr else Encoder(definition)
            encoder = self._encoders.store(key, new_encoder, size)
        return encoder

    def is_from_rosbags(self, name: str) -> bool:
        """Return whether a type is not installed, but the package ``rosbags`` has that of ROS 1.

        >>> Definitions().is_from_rosbags("my_robot/Unknown")
        False
        """
        installed_type = self._installed.find(ros1_type_name(name))
        return installed_type is not None and installed_type.source == _ROSBAGS_SOURCE

    def misspelt(self, name: str) -> str:
        """Return a known type with a similar name, as a suggestion for an unknown one; "" if there is none.

        >>> Definitions().misspelt("std_msgs/Strng"), Definitions().misspelt("string")
        ('std_msgs/String', 'std_msgs/String')
        """
        name = ros1_type_name(name)
        if name in self:
            return ""
        event = find_action_event(name)
        if event is not None:
            action = self.misspelt_interface(event.action, "action")
            return event._replace(action=action).type_name if action else ""
        package, _, type_name = name.rpartition("/")
        packages = self._installed.packages()
        # A bare name is searched in all packages, but must match exactly except for case.
        if not package:
            return next(
                (
                    f"{candidate}/{match}"
                    for candidate in packages
                    for match in self._find_most_similar(candidate, type_name, 1)
                ),
                "",
            )
        # The last arguments are minimum similarities, from 0 to 1.
        for candidate in dict.fromkeys([package, *get_close_matches(package, packages, 3, 0.8)]):
            # A package that is not installed has types that rosbags does not know, with names like those that it
            # knows: geometry_msgs/VelocityStamped of ROS 2, and Vector3Stamped.
            cutoff = 0.7 if self._installed.has_package(candidate) else 0.8
            matches = self._find_most_similar(candidate, type_name, cutoff)
            if matches and (candidate == package or matches[0] == type_name):
                return f"{candidate}/{matches[0]}"
        return ""

    def is_missing_in_package(self, name: str) -> bool:
        """Return whether a type is unknown although its package is installed, with other types.

        >>> Definitions().is_missing_in_package("my_robot/Unknown")
        False
        """
        name = ros1_type_name(name)
        return name not in self and self._installed.has_package(name.partition("/")[0])

    def misspelt_interface(self, name: str, folder_name: str) -> str:
        """Return a known service or action with a similar name, as a suggestion for an unknown one.

        >>> Definitions().misspelt_interface("my_robot/Unknown", "srv")
        ''

        Args:
            name: name of the service or action, ``pkg/Type``.
            folder_name: ``srv`` or ``action``.

        Returns:
            The similar name; "" if the service or action is known, or there is none.
        """
        suffix = "_Goal" if folder_name == "action" else "_Request"
        if f"{name}{suffix}" in self:
            return ""
        names = [
            type_name[: -len(suffix)]
            for type_name in (*_FALLBACK_DEFINITIONS, *self._added)
            if type_name.endswith(suffix)
        ]
        return closest_name(name, [*names, *self._installed.interfaces(folder_name)], 0.8)

    def _find_most_similar(self, package: str, type_name: str, cutoff: float) -> List[str]:
        """Return the type of a package with the most similar name, ignoring case, as a list of at most one name."""
        by_lower_case: Dict[str, str] = {}
        for name in self._installed.types(package):
            by_lower_case.setdefault(name.lower(), name)
        return [
            by_lower_case[name] for name in get_close_matches(type_name.lower(), by_lower_case, 1, cutoff)
        ]

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
        return [
            f"{package}/{type_name}" for package in packages for type_name in self._installed.types(package)
        ]

    def known(self, name: str) -> Optional[Definition]:
        """Return a type that was added or is nested in an added one, without searching the installed types.

        >>> definitions = Definitions()
        >>> definitions.known("my_robot/Bumper") is None
        True
        >>> definitions.add("my_robot/Bumper", "bool left") is definitions.known("my_robot/Bumper")
        True
        """
        name = ros1_type_name(name)
        definition = self._added.get(name) or self._nested.get(name)
        return None if definition is None else self._in_form(definition)


def parse_ros2_type(name: str, text: str, find: FindText, is_idl: bool = False) -> Definition:
    """Return the type that a definition of ROS 2 describes, in ROS 1 form; see `convert_ros2_text`.

    Raises:
        MessageError: if the text is not a valid definition, is too long, or names an unknown type.
    """
    if len(text) > MAX_DEFINITION_CHARACTERS:
        raise MessageError(
            f"the definition of {shorten(ros1_type_name(name))} has {len(text)} characters: "
            f"at most {MAX_DEFINITION_CHARACTERS} are allowed"
        )
    # A registry without installed types: the nested types must be those of CDR, not types of ROS 1 with equal names.
    registry = Definitions(InstalledTypes([], [], include_rosbags=False))
    return registry.add(name, convert_ros2_text(name, text, find, is_idl))


class _Resolver:
    """Resolver of a type and its nested types, first from the sections of one text, then from the registry.

    Args:
        registry: the known types.
        sections: the definitions in one text, by type.
        in_progress: the types that are being resolved. A type that is needed while it is in this set contains itself.
    """

    def __init__(
        self,
        registry: Definitions,
        installed: InstalledTypes,
        sections: Dict[str, str],
        in_progress: Optional[Set[str]] = None,
    ):
        self.registry = registry
        self.installed = installed
        self.sections = sections
        self.resolved: Dict[str, Definition] = {}
        self.in_progress: Set[str] = set() if in_progress is None else in_progress

    def resolve(self, name: str) -> Definition:
        """Return the definition of a type.

        Raises:
            MessageError: if the type is unknown or contains itself, or its definition is invalid.
        """
        definition = self.resolved.get(name)
        if definition is None:
            fault = type_fault(name)
            if fault is not None:
                raise MessageError(fault)
            if name in self.in_progress:
                raise MessageError(f"{name} contains itself")
            # Checked before parsing: recursion over nested definitions would exceed Python's stack.
            if len(self.in_progress) > MAX_TYPE_DEPTH:
                raise MessageError(f"types cannot be nested more than {MAX_TYPE_DEPTH} deep")
            self.in_progress.add(name)
            try:
                definition = self.resolved[name] = self.read(name)
            finally:
                self.in_progress.discard(name)
        return definition

    def read(self, name: str) -> Definition:
        """Parse the definition of a type, from the first place that has one."""
        text = self.sections.get(name)
        if text is not None:
            return parse(name, text, self._resolve_nested)
        installed_type = self.installed.find(name)
        if installed_type is not None:
            return self.read_installed(name, installed_type)
        # Nested types of received definitions come last: another publisher must not replace an installed type.
        known = self.registry.known(name)
        if known is not None:
            return known
        if name in _FALLBACK_DEFINITIONS:
            return parse(name, _FALLBACK_DEFINITIONS[name], self._resolve_nested)
        if name in NAMES_IN_ROS2:
            return self.resolve(NAMES_IN_ROS2[name]).renamed(name)
        event = find_action_event(name)
        if event is not None:
            return parse(name, event.text, self._resolve_nested)
        actionlib_definition = self._find_actionlib_type(name)
        if actionlib_definition is not None:
            return actionlib_definition.renamed(name)
        raise MessageError(
            f"no definition of the message type {shorten(name)} is installed or has been received"
        )

    def _find_actionlib_type(self, name: str) -> Optional[Definition]:
        """Return the type of actionlib that a program names as in ROS 2, if there is such an action."""
        other_name = actionlib_name(name)
        if other_name is None:
            return None
        try:
            return self.resolve(other_name)
        except MessageError:
            return None

    def read_installed(self, name: str, installed_type: InstalledType) -> Definition:
        """Parse the definition of an installed type."""
        text = installed_type.text
        if installed_type.is_derived or is_ros2_text(text):
            try:
                text = convert_ros2_text(name, text, self._find_text)
            except MessageError as error:
                raise MessageError(f"{installed_type.source}: {error}") from error
        sections = split_sections(name, text)
        # The text of a generated class contains the nested definitions as well, which take precedence within it.
        if len(sections) > 1:
            definition = _Resolver(self.registry, self.installed, sections, self.in_progress).read(name)
        else:
            definition = parse(name, text, self._resolve_nested, installed_type.source)
        if installed_type.generated is not None:
            installed_type.generated.check(definition)
        return definition

    def _find_text(self, name: str) -> Optional[str]:
        installed_type = self.installed.find(name)
        if installed_type is not None:
            return installed_type.text
        known = self.registry.known(name)
        return None if known is None else known.text

    def _resolve_nested(self, written_name: str, package: str) -> Definition:
        """Return the definition of a nested type, by the name that a type of ``package`` uses for it."""
        for name in _list_possible_names(written_name, package, self.sections):
            if name in self.sections:
                return self.resolve(name)
        return self.resolve(written_name if "/" in written_name else f"{package}/{written_name}")


def _list_possible_names(written_name: str, package: str, sections: Dict[str, str]) -> Sequence[str]:
    """Return the possible names of a nested type in a concatenated text, the most likely name first."""
    if "/" in written_name:
        return [written_name]
    matching_names: List[str] = [name for name in sections if name.endswith("/" + written_name)]
    # A type without a package belongs to the same package. Old bags also omit the package of others, if the name is
    # unique.
    return [f"{package}/{written_name}"] + (matching_names if len(matching_names) == 1 else [])
