"""Definitions of ROS 2 message types, converted to the form of ROS 1.

Definitions of ROS 2 extend those of ROS 1 (https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html) by
bounds of strings and arrays (``string<=10[<=5] names``), default values (``int32 x 5``), quoted string constants,
``wstring``, and ``pkg/msg/Type`` for ``pkg/Type``. Bounds and default values do not change the bytes of a message, so
they are omitted from the ROS 1 definition. A ``byte`` is an octet (``uint8``), a ``wstring`` a ``string`` with the
comment `WIDE_STRING_COMMENT`, which `cdr_decoder` and `cdr_encoder` need.
The lines are parsed here instead of with ``get_types_from_msg`` of rosbags: that does not know ``wstring``, rejects
``wstring<=4``, gives errors no position, and in version 0.9.20 renames slots that are keywords of Python and rejects
default values of strings without quotes. `idl_definitions` converts definitions in IDL.

`format_ros2_text` is the inverse, for bags of ROS 2 that this package writes.

rosidl derives message types from services and actions: ``pkg/srv/Type_Event`` from ``Type.srv``,
``pkg/action/Type_FeedbackMessage`` from ``Type.action`` (see `Interface`). The text that ``ros2 bag`` stores for them
is that of the file, after a heading ``SRV: pkg/srv/Type``. Others store the derived definitions themselves.
"""

import re
from collections import deque
from math import isfinite
from typing import Callable, Deque, Dict, Iterator, List, NamedTuple, Optional, Set, Tuple

from ..foundation.displayed_text import quote_shortened, shorten
from ..foundation.errors import MessageError
from ..foundation.ros_name_checks import name_fault, ros1_type_name
from ..foundation.source_places import place_at_offset
from .idl_definitions import convert_idl
from .type_definition import (
    EXPECTED_CONSTANT_TYPE,
    HEADER,
    PRIMITIVES,
    SEPARATOR,
    TIMES,
    WIDE_STRING_COMMENT,
    Constant,
    Definition,
    lines_with_offsets,
    parse_constant,
    split_sections,
    warn_of_ignored_constants,
)

FindText = Callable[[str], Optional[str]]
"""Function that returns the definition of ``pkg/Type`` with its nested types, in ROS 2 or ROS 1 form, or None."""

_LINE = re.compile(
    r"\s*(?P<type>[\w/]+)(?P<bound><=[0-9]+)?(?P<array>\[(?:<=)?[0-9]*\])?\s+(?P<name>\w+)(?P<rest>(?:[\s=#].*)?)$"
)
_DEFAULT_VALUE_STARTS = (*"-+.0123456789\"'[", "true", "false", "True", "False")
"""Beginnings of the default value of a slot."""

_QUOTED = re.compile(r"""\s*(?:"((?:[^"\\]|\\.)*)"|'((?:[^'\\]|\\.)*)')\s*(?:#.*)?$""")

_ROS1_TYPES = {
    "byte": "uint8",
    "octet": "uint8",
    "wstring": "string",
    "Header": HEADER,
    "builtin_interfaces/Time": "time",
    "builtin_interfaces/Duration": "duration",
}
"""Names of types in ROS 1."""

NAMES_IN_ROS2 = {"tf/tfMessage": "tf2_msgs/TFMessage"}
"""Types of ROS 1 that programs name, and that ROS 2 has under another name."""

_TIMES_IN_ROS2 = {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}

_STRING_TYPES = ("string", "wstring")

_INSTANT = "int32 sec\nuint32 nanosec\n"
_SERVICE_EVENT_INFO = """\
uint8 REQUEST_SENT=0
uint8 REQUEST_RECEIVED=1
uint8 RESPONSE_SENT=2
uint8 RESPONSE_RECEIVED=3
uint8 event_type
builtin_interfaces/Time stamp
char[16] client_gid
int64 sequence_number
"""
_GOAL_STATUS = """\
int8 STATUS_UNKNOWN=0
int8 STATUS_ACCEPTED=1
int8 STATUS_EXECUTING=2
int8 STATUS_CANCELING=3
int8 STATUS_SUCCEEDED=4
int8 STATUS_CANCELED=5
int8 STATUS_ABORTED=6
action_msgs/GoalInfo goal_info
int8 status
"""
_CANCEL_GOAL = """\
action_msgs/GoalInfo goal_info
---
int8 return_code
action_msgs/GoalInfo[] goals_canceling
"""
BUILTIN_DEFINITIONS = {
    "builtin_interfaces/Time": _INSTANT,
    "builtin_interfaces/Duration": _INSTANT,
    "service_msgs/ServiceEventInfo": _SERVICE_EVENT_INFO,
    "unique_identifier_msgs/UUID": "uint8[16] uuid\n",
    "action_msgs/GoalInfo": "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp\n",
    "action_msgs/GoalStatus": _GOAL_STATUS,
    "action_msgs/GoalStatusArray": "action_msgs/GoalStatus[] status_list\n",
}
"""Types of ROS 2 that definitions use without containing them, and those of all actions."""

SERVICE_SYNTAX = "SRV"
ACTION_SYNTAX = "ACTION"

_SERVICE_SUFFIXES = ("_Request", "_Response", "_Event")
_DERIVED_SUFFIXES = {
    SERVICE_SYNTAX: _SERVICE_SUFFIXES,
    ACTION_SYNTAX: (
        "_Goal",
        "_Result",
        "_Feedback",
        "_FeedbackMessage",
        *(f"_SendGoal{suffix}" for suffix in _SERVICE_SUFFIXES),
        *(f"_GetResult{suffix}" for suffix in _SERVICE_SUFFIXES),
    ),
}
"""Suffixes of the message types that are derived from services and actions."""

_PARTS = {SERVICE_SYNTAX: ("_Request", "_Response"), ACTION_SYNTAX: ("_Goal", "_Result", "_Feedback")}
"""Suffixes of the types that the parts of a ``.srv`` or ``.action`` file define, in their order."""

_DESCRIPTIONS = {
    SERVICE_SYNTAX: "service {}: expected one, between request and response",
    ACTION_SYNTAX: "action {}: expected two, between goal, result and feedback",
}

_FOLDERS = {"srv": SERVICE_SYNTAX, "action": ACTION_SYNTAX}
"""Syntaxes of definitions by the folder in the name of a type of ROS 2, which is the suffix of files, too."""

_HEADING = re.compile(r"^={20,}[ \t\r]*\n(MSG|SRV|ACTION|IDL):[ \t]*(\S*)", re.MULTILINE)
"""Beginning of the definition of another type in a text."""


class Interface(NamedTuple):
    """A service or an action.

    Attributes:
        name: ``pkg/Type``.
        syntax: syntax of its definition: `SERVICE_SYNTAX` or `ACTION_SYNTAX`.
    """

    name: str
    syntax: str

    def has_definition(self, text: str) -> bool:
        """Return whether a text is its definition, or that of a type that is derived from it."""
        return any(line.strip() == "---" for line in text.splitlines())

    def split(self, text: str) -> Dict[str, str]:
        """Return the definitions of all types that are derived from it.

        Raises:
            MessageError: if the text has not as many parts as it must have.
        """
        lines = text.splitlines(keepends=True)
        ends = [number for number, line in enumerate(lines) if line.strip() == "---"]
        suffixes = _PARTS[self.syntax]
        if len(ends) != len(suffixes) - 1:
            problem, _, expected = _DESCRIPTIONS[self.syntax].partition(": ")
            raise MessageError(
                f"the definition of {problem.format(shorten(self.name))} has {len(ends)} lines '---': {expected}"
            )
        starts = [0, *(end + 1 for end in ends)]
        parts = {
            f"{self.name}{suffix}": "".join(lines[start:end])
            for suffix, start, end in zip(suffixes, starts, [*ends, len(lines)])
        }
        return {**self.derived_definitions(), **parts}

    def derived_definitions(self) -> Dict[str, str]:
        """Return the definitions of the derived types that do not depend on the text of the file."""
        if self.syntax == SERVICE_SYNTAX:
            return {f"{self.name}_Event": _format_service_event(self.name)}
        name, goal_id = self.name, "unique_identifier_msgs/UUID goal_id\n"
        return {
            f"{name}_FeedbackMessage": f"{goal_id}{name}_Feedback feedback\n",
            f"{name}_SendGoal_Request": f"{goal_id}{name}_Goal goal\n",
            f"{name}_SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
            f"{name}_SendGoal_Event": _format_service_event(f"{name}_SendGoal"),
            f"{name}_GetResult_Request": goal_id,
            f"{name}_GetResult_Response": f"int8 status\n{name}_Result result\n",
            f"{name}_GetResult_Event": _format_service_event(f"{name}_GetResult"),
        }


def _format_service_event(name: str) -> str:
    return f"service_msgs/ServiceEventInfo info\n{name}_Request[<=1] request\n{name}_Response[<=1] response\n"


BUILTIN_DEFINITIONS.update(Interface("action_msgs/CancelGoal", SERVICE_SYNTAX).split(_CANCEL_GOAL))


def find_interfaces(name: str) -> Iterator[Tuple[Interface, str]]:
    """Yield the services and actions from which a type may be derived, with the folders of their files.

    Args:
        name: ``pkg/Type``, or ``pkg/srv/Type`` of a service or ``pkg/action/Type`` of an action.
    """
    stated_folder = name.split("/")[1] if name.count("/") == 2 else ""
    name = ros1_type_name(name)
    for folder, syntax in _FOLDERS.items():
        for suffix in _DERIVED_SUFFIXES[syntax] if stated_folder in ("", folder) else ():
            if name.endswith(suffix):
                yield Interface(name[: -len(suffix)], syntax), folder


def is_ros2_text(text: str) -> bool:
    """Return whether a definition is in the syntax of ROS 2, and is no definition of ROS 1.

    A file of an installed package does not state its syntax. Most texts mean the same in both.
    """
    return any(map(_is_ros2_line, text.splitlines()))


def _is_ros2_line(line: str) -> bool:
    match = _LINE.match(line)
    if match is None:
        return False
    rest = match["rest"].lstrip()
    return bool(
        match["type"] in ("wstring", "builtin_interfaces/Time", "builtin_interfaces/Duration")
        or match["bound"]
        or "<=" in (match["array"] or "")
        or rest.startswith(_DEFAULT_VALUE_STARTS)
    )


def convert_ros2_text(name: str, text: str, find: FindText, is_idl: bool = False) -> str:
    """Return the definition of a type of ROS 2, with those of its nested types, in ROS 1 form.

    Args:
        name: ``pkg/Type``, ``pkg/msg/Type``, or ``pkg/srv/Type_Event`` and others that are derived from a service or
            an action.
        text: the definition, including all nested types that ``find`` does not know; for a derived type it may be
            that of the ``.srv`` or ``.action`` file.
        find: returns the definitions of nested types.
        is_idl: whether the text before the first heading is in IDL.

    Raises:
        MessageError: if the text is not a valid definition, or names an unknown type.
    """
    # Without a folder in its name, a type is not known to be derived.
    is_derived = name.count("/") == 2
    interface = next((interface for interface, _ in find_interfaces(name)), None) if is_derived else None
    name = ros1_type_name(name)
    types = _read_nested_types(name, _split_by_type(name, text, is_idl, interface), find)
    warn_of_ignored_constants(
        [problem for section in types.values() for problem in section.ignored_constants]
    )
    parts = [types[name].text]
    parts += [f"{'=' * 80}\nMSG: {nested}\n{types[nested].text}" for nested in types if nested != name]
    return "".join(parts)


class _Ros2Section(NamedTuple):
    """Definition of one type, without its nested types.

    Attributes:
        text: the definition in ROS 1 form.
        nested_types: types of slots.
        ignored_constants: reasons why constants are ignored.
    """

    text: str
    nested_types: List[str]
    ignored_constants: List[str]


def _split_by_type(
    name: str, text: str, is_idl: bool = False, interface: Optional[Interface] = None
) -> Dict[str, str]:
    """Return the definitions in a concatenated text by their types, ``pkg/Type``, in the syntax of ``.msg`` files."""
    first_syntax = "IDL" if is_idl else "MSG"
    if interface is not None and not is_idl and interface.has_definition(text):
        first_syntax = interface.syntax
    sections = _list_sections(name, text, first_syntax)
    if all(section.syntax == "MSG" for section in sections):
        return {
            ros1_type_name(type_name): section for type_name, section in split_sections(name, text).items()
        }
    texts: Dict[str, str] = {}
    for section in sections:
        if section.syntax == "MSG":
            texts.setdefault(section.type, section.text)
        elif section.syntax in _PARTS and section.text.strip():
            owner = Interface(section.type, section.syntax)
            texts.update((interface if interface and section.type == name else owner).split(section.text))
    if not is_idl:
        requested = [section.type for section in sections if section.syntax == "IDL"]
    # Types that this one does not use may be unreadable.
    elif interface is None:
        requested = [name]
    else:
        requested = [f"{interface.name}{suffix}" for suffix in _PARTS[interface.syntax]]
    derived = {} if interface is None else interface.derived_definitions()
    return {**derived, **_convert_idl_sections(name, sections, requested), **texts}


def _convert_idl_sections(name: str, sections: "List[_TextSection]", requested: List[str]) -> Dict[str, str]:
    """Return the definitions of types that sections define in IDL, in the syntax of ``.msg`` files."""
    if not requested:
        return {}
    # The other sections are replaced by empty lines, so that line numbers stay the same.
    idl_text = "".join(
        section.text if section.syntax == "IDL" else "\n" * section.line_count for section in sections
    )
    return convert_idl(name, idl_text, requested)


class _TextSection(NamedTuple):
    """Definition of one type in a concatenated text.

    Attributes:
        syntax: ``MSG``, ``SRV``, ``ACTION`` or ``IDL``.
        type: name of the type, service or action.
        line_count: number of lines, including those of the heading.
    """

    syntax: str
    type: str
    text: str
    line_count: int


def _list_sections(name: str, text: str, syntax: str) -> List[_TextSection]:
    """Return the definitions in a text; that before the first heading has the given name and syntax."""
    headings = list(_HEADING.finditer(text))
    ends = [*(heading.start() for heading in headings), len(text)]
    sections = [_TextSection(syntax, name, text[: ends[0]], text.count("\n", 0, ends[0]))]
    for heading, end in zip(headings, ends[1:]):
        # The grammar of IDL includes the heading.
        start = heading.start() if heading[1] == "IDL" else heading.end()
        line_count = text.count("\n", heading.start(), end)
        sections.append(_TextSection(heading[1], ros1_type_name(heading[2]), text[start:end], line_count))
    return sections


def _read_nested_types(name: str, texts: Dict[str, str], find: FindText) -> Dict[str, _Ros2Section]:
    """Parse the definitions of a type and of all types nested in it."""
    types: Dict[str, _Ros2Section] = {}
    pending: Deque[str] = deque([name])
    while pending:
        type_name = pending.popleft()
        if type_name in types:
            continue
        if type_name not in texts:
            text = BUILTIN_DEFINITIONS.get(type_name) or find(type_name)
            if text is None:
                raise MessageError(
                    f"the type {shorten(type_name)} is not defined in the bag or on this system"
                )
            # Definitions that came with the bag have priority over installed ones.
            for nested, section_text in _split_by_type(type_name, text).items():
                texts.setdefault(nested, section_text)
        types[type_name] = section = _Ros2DefinitionReader(type_name, texts).read()
        pending += section.nested_types
    return types


class _Ros2DefinitionReader:
    """Parser of the definition of one type.

    Args:
        name: ``pkg/Type``.
        texts: the definitions of all types in the same text.

    Attributes:
        lines: the lines of the definition in ROS 1 form.
        slot_types: message types of slots.
        constants: names of the constants.
        ignored_constants: reasons why constants are ignored.
        by_short_name: the types in ``texts`` by their names without package.
    """

    def __init__(self, name: str, texts: Dict[str, str]):
        self.name = name
        self.texts = texts
        # CDR has no `seq`, but the event terms of headers have the slots of ROS 1.
        self.lines: List[str] = ["uint32 seq"] if name == HEADER else []
        self.slot_types: List[str] = []
        self.constants: Set[str] = set()
        self.ignored_constants: List[str] = []
        self.by_short_name: Dict[str, List[str]] = {}
        for full_name in texts:
            self.by_short_name.setdefault(full_name.rpartition("/")[2], []).append(full_name)

    def read(self) -> _Ros2Section:
        """Return the definition in ROS 1 form."""
        text = self.texts[self.name]
        for offset, line in lines_with_offsets(text):
            content = line.strip()
            if not content or content.startswith("#"):
                continue
            match = _LINE.match(line)
            if match is None or (match["bound"] and match["type"] not in _STRING_TYPES):
                problem = f"expected 'type name' or 'type NAME=value', found {quote_shortened(content)}"
            else:
                problem = self._read_line(match)
            if problem:
                place = place_at_offset(self.name, text, offset + len(line) - len(line.lstrip()))
                raise MessageError(problem, place)
        return _Ros2Section(
            "".join(f"{line}\n" for line in self.lines),
            self.slot_types,
            self.ignored_constants,
        )

    def _read_line(self, match: "re.Match[str]") -> str:
        """Add a slot or a constant; return an error text, or an empty string."""
        rest = match["rest"].lstrip()
        if not rest.startswith("="):
            self._add_slot(match)
            return ""
        type_name = _ROS1_TYPES.get(match["type"], match["type"])
        if type_name not in PRIMITIVES and type_name != "string":
            return f"a constant cannot be of type {quote_shortened(type_name)}: {EXPECTED_CONSTANT_TYPE}"
        self._add_constant(type_name, match["name"], rest[1:])
        return ""

    def _add_constant(self, type_name: str, name: str, text: str) -> None:
        """Add a constant. One that ROS 1 cannot express is ignored: constants are not part of messages."""
        quoted = _QUOTED.match(text) if type_name == "string" else None
        if quoted is not None:
            value = re.sub(r"\\(.)", r"\1", quoted[1] if quoted[1] is not None else quoted[2])
        else:
            value = text.partition("#")[0].strip()
        problem = f"{quote_shortened(name)} is defined twice" if name in self.constants else name_fault(name)
        if problem is None:
            try:
                parse_constant(type_name, value)
            except ValueError:
                problem = f"{quote_shortened(value)} is not a value of type {type_name}"
        if problem is not None:
            self.ignored_constants.append(f"{self.name}: {problem}")
            return
        self.constants.add(name)
        self.lines.append(f"{type_name} {name}={value}")

    def _add_slot(self, match: "re.Match[str]") -> None:
        """Add a slot in ROS 1 form; the match is one of `_LINE`."""
        type_name, name = match["type"], match["name"]
        if self.name == HEADER and name == "seq":
            return
        comment = f"  {WIDE_STRING_COMMENT}" if type_name == "wstring" else ""
        type_name = ros1_type_name(type_name)
        type_name = _ROS1_TYPES.get(type_name, type_name)
        if type_name not in PRIMITIVES and type_name not in TIMES and type_name != "string":
            type_name = self._qualify_name(type_name)
            self.slot_types.append(type_name)
        # A bounded array is one of variable length.
        length = (match["array"] or "").replace("<=", "]")
        self.lines.append(f"{type_name}{length.partition(']')[0] + ']' if length else ''} {name}{comment}")

    def _qualify_name(self, type_name: str) -> str:
        """Return the name of a nested type with its package."""
        if "/" in type_name:
            return type_name
        # Definitions in bags may name a type of another package without the package, if only one has that name.
        local_name = f"{self.name.partition('/')[0]}/{type_name}"
        candidates = self.by_short_name.get(type_name, [])
        return candidates[0] if local_name not in self.texts and len(candidates) == 1 else local_name


def ros2_type_name(name: str) -> str:
    """Return the name that a type, ``pkg/Type``, has in ROS 2: ``pkg/msg/Type``, or that of a derived type."""
    name = NAMES_IN_ROS2.get(name, name)
    # `Dock_SendGoal_Request` belongs to the action `Dock`, not to a service `Dock_SendGoal`.
    interfaces = sorted(find_interfaces(name), key=lambda pair: len(pair[0].name))
    folder = interfaces[0][1] if interfaces else "msg"
    return name.replace("/", f"/{folder}/")


def format_ros2_text(definition: Definition) -> str:
    """Return the definition of a type with those of all nested types, in the syntax of ROS 2.

    Slots whose names are capital letters, such as ``K``, have the lower-case names that ROS 2 requires.
    """
    types = (definition, *definition.dependencies())
    texts = {NAMES_IN_ROS2.get(nested.name, nested.name): _format_ros2_section(nested) for nested in types}
    slot_types = {slot.type for nested in types for slot in nested.fields}
    texts.update((name, _INSTANT) for time, name in _TIMES_IN_ROS2.items() if time in slot_types)
    first, *others = texts.items()
    return "".join([first[1], *(f"{SEPARATOR}\nMSG: {name}\n{text}" for name, text in others)])


def _format_ros2_section(definition: Definition) -> str:
    lines = []
    for constant in definition.constants:
        value = _format_ros2_value(constant)
        if value is not None:
            lines.append(f"{constant.type} {constant.name}={value}\n")
    names = {slot.name for slot in definition.fields}
    for slot in definition.fields:
        if definition.name == HEADER and slot.name == "seq":
            continue
        type_name = "wstring" if slot.is_wide else _TIMES_IN_ROS2.get(slot.type, slot.type)
        type_name = NAMES_IN_ROS2.get(type_name, type_name)
        name = slot.name.lower()
        if not slot.name.isupper() or name in names:
            name = slot.name
        lines.append(f"{slot._replace(type=type_name).describe()} {name}\n")
    return "".join(lines)


def _format_ros2_value(constant: Constant) -> Optional[str]:
    """Return the value of a constant in the syntax of ROS 2, or None if ROS 2 cannot have the constant."""
    name, value = constant.name, constant.value
    if not name.isupper() or "__" in name or name[-1] == "_":
        return None
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    if isinstance(value, float):
        return repr(value) if isfinite(value) else None
    # A `byte` of ROS 1 has a sign, that of ROS 2 has none.
    return str(value % 256 if constant.type == "byte" else value).lower()
