"""ROS 1 message definitions: their slots, how large they are, and the checksum of all that."""

from struct import calcsize
from typing import Dict, Iterable, List, NamedTuple, Optional, Tuple, Union

from ..foundation import MessageError, type_fault
from .slots import DEEPEST, LARGEST, MOST_SLOTS, PRIMITIVES, TIMES, VARIABLE

HEADER = "std_msgs/Header"
SEPARATOR = "=" * 80


ConstantValue = Union[bool, int, float, str]


class Constant(NamedTuple):
    """A named value of a definition; ``text`` is the value as written."""

    type: str
    name: str
    text: str
    value: ConstantValue


class Field(NamedTuple):
    """A slot of a message.

    Attributes:
        name: the slot's name.
        type: the type of the slot or of its elements: a built-in one, or ``pkg/Type``.
        length: None for a single value, `VARIABLE` or the number of elements for an array.
        definition: the definition of a ``pkg/Type``, None for built-in types.
    """

    name: str
    type: str
    length: Optional[int] = None
    definition: Optional["Definition"] = None

    @property
    def is_bytes(self) -> bool:
        """Whether the slot is an array of bytes, which events show as text."""
        return self.length is not None and self.type in ("uint8", "char")

    def describe(self) -> str:
        """Return the type as a definition writes it: ``float64[36]``."""
        if self.length is None:
            return self.type
        return f"{self.type}[{'' if self.length == VARIABLE else self.length}]"


class Measure(NamedTuple):
    """How large the messages of a type are, and what is made for them.

    Attributes:
        least: bytes of the shortest one.
        fixed: whether all are as long as that.
        slots: how many slots there are, those of nested types included.
        depth: how deep types lie in each other.
        bare: how many elements of fixed arrays have no bytes.
        may_be_bare: whether there is an array, of whatever length, whose elements have no bytes.
    """

    least: int = 0
    fixed: bool = True
    slots: int = 0
    depth: int = 0
    bare: int = 0
    may_be_bare: bool = False

    def plus(self, slot: Field) -> "Measure":
        """Return the measure of messages with one more slot."""
        one = measure_of(slot)
        number = 1 if slot.length is None else slot.length
        varies = number == VARIABLE
        is_bare = slot.length is not None and not one.least
        return Measure(
            self.least + (4 if varies else one.least * number),
            self.fixed and one.fixed and not varies,
            self.slots + one.slots + 1,
            max(self.depth, one.depth + 1),
            self.bare + (0 if varies else number * (one.bare + is_bare)),
            self.may_be_bare or one.may_be_bare or is_bare,
        )

    def problem(self) -> str:
        """Return what is too much; an empty text where nothing is."""
        if self.slots > MOST_SLOTS:
            return (
                f"a type cannot have more than {MOST_SLOTS} slots, including those of the types it contains"
            )
        if self.depth > DEEPEST:
            return f"types cannot be nested more than {DEEPEST} deep"
        if self.least > LARGEST:
            return f"a message cannot have more than {LARGEST} bytes"
        return ""


def measure_of(slot: Field) -> Measure:
    """Return the measure of one element of a slot."""
    if slot.definition is not None:
        return slot.definition.measure
    if slot.type == "string":
        return Measure(4, False)
    return Measure(calcsize("<" + (TIMES.get(slot.type) or PRIMITIVES[slot.type])))


def measured(fields: Iterable[Field]) -> Measure:
    """Return the measure of messages with these slots."""
    found = Measure()
    for slot in fields:
        found = found.plus(slot)
    return found


class Definition:
    """A message type with all the types it is made of.

    >>> kind = Definitions().find("std_msgs/String")
    >>> kind.name, [slot.name for slot in kind.fields], kind.md5sum
    ('std_msgs/String', ['data'], '992ce8a1687cec8c8bd883ec73ca41d1')

    Attributes:
        name: ``pkg/Type``.
        fields: the slots in order.
        constants: the constants in order.
        text: the definition's own text.
        event: what its event terms are called, where that is not ``pkg__0__Type``.
        md5sum: the checksum by which ROS tells versions of a type apart.
        measure: how large its messages are.

    Raises:
        MessageError: for a name that is none.
    """

    def __init__(
        self,
        name: str,
        fields: Tuple[Field, ...],
        constants: Tuple[Constant, ...] = (),
        text: str = "",
        event: str = "",
    ):
        from hashlib import md5  # noqa: PLC0415 - loads OpenSSL, and many programs have no messages

        fault = type_fault(name)
        if fault is not None:
            raise MessageError(fault)
        self.name = name
        self.fields = fields
        self.constants = constants
        self.text = text
        self.event = event
        self.measure = measured(fields)
        self.md5sum = md5(_checksum_text(self).encode()).hexdigest()

    @property
    def functor_name(self) -> str:
        """The name of the type's event terms: ``pkg__0__Type``.

        >>> Definitions().find("std_msgs/String").functor_name
        'std_msgs__0__String'
        """
        return self.event or functor_name(self.name)

    @property
    def full_text(self) -> str:
        """The text with those of all nested types, as it stands in connection headers and bags.

        >>> definitions = Definitions()
        >>> seen = definitions.add("my_robot/Seen", "Header header")
        >>> "MSG: std_msgs/Header" in seen.full_text
        True
        """
        parts = [self.text]
        for nested in self.dependencies():
            parts.append(f"{SEPARATOR}\nMSG: {nested.name}\n{nested.text}")
        return "\n".join(parts)

    def dependencies(self) -> List["Definition"]:
        """Return the definitions of all nested types, each once, in the order of their first use.

        >>> definitions = Definitions()
        >>> seen = definitions.add("my_robot/Seen", "Header header")
        >>> [nested.name for nested in seen.dependencies()]
        ['std_msgs/Header']
        """
        found: Dict[str, Definition] = {}
        _collect(self, found)
        return list(found.values())

    def renamed(self, name: str) -> "Definition":
        """Return the same definition under another name (``tf/tfMessage`` for ``tf2_msgs/TFMessage``).

        >>> Definitions().find("std_msgs/String").renamed("my_robot/Text").functor_name
        'my_robot__0__Text'
        """
        return Definition(name, self.fields, self.constants, self.text)

    def as_event(self, event: str) -> "Definition":
        """Return the same definition with event terms of another name; "" is that of the type.

        >>> Definitions().find("std_msgs/Bool").as_event("bumper_left").functor_name
        'bumper_left'
        """
        if event == self.event:
            return self
        return Definition(self.name, self.fields, self.constants, self.text, event)

    def __repr__(self) -> str:
        return f"Definition({self.name!r}, md5sum={self.md5sum!r})"


def functor_name(type_name: str) -> str:
    """Return the functor's name of a message type: ``pkg__0__Type`` for ``pkg/Type``."""
    return type_name.replace("/", "__0__")


def type_name(functor_name: str) -> Optional[str]:
    """Return ``pkg/Type`` for ``pkg__0__Type``, or None where the name is not of that form."""
    package, mark, rest = functor_name.partition("__0__")
    return f"{package}/{rest}" if mark and package and rest else None


def _collect(definition: Definition, found: Dict[str, Definition]) -> None:
    for slot in definition.fields:
        nested = slot.definition
        if nested is not None and nested.name not in found:
            found[nested.name] = nested
            _collect(nested, found)


def _checksum_text(definition: Definition) -> str:
    """Return the text whose MD5 is the type's: constants, then slots, nested types by their checksums.

    Comments, spacing and whether a nested type is an array do not count, as in ROS's own tools.
    """
    lines = [f"{constant.type} {constant.name}={constant.text}" for constant in definition.constants]
    for slot in definition.fields:
        if slot.definition is None:
            lines.append(f"{slot.describe()} {slot.name}")
        else:
            lines.append(f"{slot.definition.md5sum} {slot.name}")
    return "\n".join(lines).strip()
