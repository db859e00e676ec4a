"""Templates of messages: a type as a term that can be pasted into a program.

`format_positional` writes a variable for each slot, `format_with_names` the names of the slots too, and
`format_with_zeros` default values.
"""

from typing import Dict, Iterator, List, NamedTuple, Optional, Set

from ..foundation.displayed_text import format_count
from ..foundation.errors import MessageError
from ..prolog.syntax.event_text import to_text
from ..prolog.syntax.term_writer import write_term
from ..prolog.terms.term_traversal import copy
from ..prolog.terms.types import atom
from .type_definition import TIMES, VARIABLE_LENGTH, Definition, Field, Measure, measure_of, measure_of_slots
from .type_registry import Definitions

SENSOR_PREDICATES = {
    "nav_msgs/OccupancyGrid": ("map_cell/4",),
    "sensor_msgs/Image": ("image_array/2", "image_pixel/4", "image_region_mean/6"),
    "sensor_msgs/PointCloud2": ("cloud_box/4", "cloud_field/3", "cloud_near/4"),
}
"""Predicates whose first argument is a message, by its type."""

MAX_ZERO_BYTES = 1_000_000
"""Maximum size of a message with default values, in bytes. One line of a definition can state a huge array."""

_INDENT = "    "


class _TemplateLine(NamedTuple):
    """A line of a template and its comment."""

    text: str
    comment: str = ""


def format_positional(definition: Definition) -> str:
    """Return the term of a type with a variable for each slot, and the slots with their sizes as comments.

    >>> print(format_positional(Definitions().find("std_msgs/Header")), end="")
    std_msgs__0__Header(  % 16 bytes or more
        Seq,              % seq: uint32, 4 bytes
        [Sec, NSec],      % stamp: time, 8 bytes
        FrameId           % frame_id: string, 4 bytes + text
    )
    """
    return _Template(uses_slot_names=False).format_type(definition)


def format_with_names(definition: Definition) -> str:
    """Return the term of a type with named slots; slots that do not matter can be deleted from it.

    >>> print(format_with_names(Definitions().find("std_msgs/Header")), end="")
    std_msgs__0__Header{     % 16 bytes or more
        seq: Seq,            % uint32, 4 bytes
        stamp: [Sec, NSec],  % time, 8 bytes
        frame_id: FrameId    % string, 4 bytes + text
    }
    """
    return _Template(uses_slot_names=True).format_type(definition)


def format_with_zeros(definition: Definition, definitions: Definitions) -> str:
    """Return the message of a type with default values, on one line.

    Raises:
        MessageError: if the message would have more than `MAX_ZERO_BYTES`, because the type has large fixed arrays.

    >>> definitions = Definitions()
    >>> print(format_with_zeros(definitions.find("std_msgs/Header"), definitions), end="")
    std_msgs__0__Header(0,[0,0],'""')
    """
    size = definition.measure.min_size
    if size > MAX_ZERO_BYTES:
        raise MessageError(
            f"a message of {definition.name} has {_format_size(definition.measure)}: "
            f"expected at most {MAX_ZERO_BYTES} bytes for a message with default values"
        )
    return write_term(copy(definitions.decoder(definition).decode(bytes(size)))) + "\n"


class _Template:
    """Generator of the lines of a term.

    Args:
        uses_slot_names: whether the slots are written with their names.
    """

    def __init__(self, uses_slot_names: bool):
        self.uses_slot_names = uses_slot_names
        self.used_variables: Set[str] = set()

    def format_type(self, definition: Definition) -> str:
        """Return the term of a type, followed by comments: terms of the types of array elements, and constants."""
        lines = list(self.format_message(definition, "", "", [], _format_size(definition.measure)))
        template_lines = _align_comments(lines)
        elements = _find_element_types(definition)
        for element_type in elements.values():
            template_lines += ["", f"% {element_type.name}, an element:"]
            size = _format_size(element_type.measure)
            element_lines = list(
                _Template(self.uses_slot_names).format_message(element_type, "", "", [], size)
            )
            template_lines += [f"% {line}" for line in _align_comments(element_lines)]
        for element_type in (definition, *definition.dependencies()):
            if element_type.constants:
                template_lines += ["", f"% constants of {element_type.name}:"]
                texts = [
                    f"{to_text(atom(element_type.functor_name))}{{{constant.name}}} = "
                    f"{_format_one_line(constant.text)} ({constant.type})"
                    for constant in element_type.constants
                ]
                template_lines += [f"%   {text}" for text in texts]
        return "\n".join(template_lines + _make_predicate_comments(definition)) + "\n"

    def format_message(
        self,
        definition: Definition,
        indent: str,
        prefix: str,
        outer_names: List[str],
        comment: str,
        suffix: str = "",
    ) -> Iterator[_TemplateLine]:
        """Yield the lines of a message.

        Args:
            definition: the type of the message.
            indent: spaces before each line.
            prefix: text before the first line's term.
            outer_names: the names of the slots that contain the message, from the outermost.
            comment: comment of the first line.
            suffix: text after the last line.
        """
        name = to_text(atom(definition.functor_name))
        if not definition.fields:
            yield _TemplateLine(f"{indent}{prefix}{name}{suffix}", comment)
            return
        opening, closing = ("{", "}") if self.uses_slot_names else ("(", ")")
        # The type of a slot determines the message, so that its name can be omitted.
        if self.uses_slot_names and prefix:
            name = ""
        yield _TemplateLine(f"{indent}{prefix}{name}{opening}", comment)
        for position, slot in enumerate(definition.fields, 1):
            comma = "," if position < len(definition.fields) else ""
            yield from self.format_slot(slot, indent + _INDENT, outer_names, comma)
        yield _TemplateLine(f"{indent}{closing}{suffix}")

    def format_slot(
        self, slot: Field, indent: str, outer_names: List[str], comma: str
    ) -> Iterator[_TemplateLine]:
        """Yield the lines of a slot; ``comma`` is the text after it."""
        prefix = f"{to_text(atom(slot.name))}: " if self.uses_slot_names else ""
        comment = f"{slot.describe()}, {_format_slot_size(slot)}"
        if not self.uses_slot_names:
            comment = f"{slot.name}: {comment}"
        if slot.definition is not None and slot.length is None:
            yield from self.format_message(
                slot.definition, indent, prefix, [*outer_names, slot.name], comment, comma
            )
        elif slot.type in TIMES and slot.length is None:
            variables = [self.create_variable(name, [*outer_names, slot.name]) for name in ("sec", "n_sec")]
            yield _TemplateLine(f"{indent}{prefix}[{', '.join(variables)}]{comma}", comment)
        else:
            yield _TemplateLine(
                f"{indent}{prefix}{self.create_variable(slot.name, outer_names)}{comma}", comment
            )

    def create_variable(self, name: str, outer_names: List[str]) -> str:
        """Return a new variable for a slot; it begins with the names of enclosing slots if the name is used."""
        for depth in range(len(outer_names), -1, -1):
            variable = "".join(map(_capitalize, [*outer_names[depth:], name]))
            if not variable[:1].isupper():
                variable = f"V{variable}"
            if variable not in self.used_variables:
                break
        index, stem = 1, variable
        # Several slots can have the same full path of capitalised names, for example `a_b` and `aB`.
        while variable in self.used_variables:
            index += 1
            variable = f"{stem}_{index}"
        self.used_variables.add(variable)
        return variable


def _format_size(measure: Measure) -> str:
    """Return the size of a message: ``8 bytes`` if it is fixed, or the minimum: ``8 bytes or more``."""
    size = format_count(measure.min_size, "byte")
    return size if measure.is_fixed_size else f"{size} or more"


def _format_slot_size(slot: Field) -> str:
    """Return the serialized size of a slot as text; for arrays of variable length, the size of each element."""
    element = measure_of(slot)
    if slot.length == VARIABLE_LENGTH:
        element_size = f"{element.min_size}{'' if element.is_fixed_size else ' or more'}"
        return f"4 bytes + {element_size} per element"
    if slot.length is None and slot.type == "string":
        return "4 bytes + text"
    return _format_size(measure_of_slots([slot]))


def _capitalize(name: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in name.split("_"))


def _format_one_line(text: str) -> str:
    """Return the text of a constant in a form that fits into a comment of one line."""
    return text if text.isprintable() else ascii(text)


def _find_element_types(definition: Definition) -> Dict[str, Definition]:
    """Return the message types of array elements, each once."""
    types: Dict[str, Definition] = {}
    pending: List[Optional[Definition]] = [definition]
    while pending:
        element = pending.pop(0)
        for slot in element.fields if element is not None else ():
            if slot.definition is not None and slot.definition.name not in types:
                if slot.length is not None:
                    types[slot.definition.name] = slot.definition
                pending.append(slot.definition)
    return types


def _make_predicate_comments(definition: Definition) -> List[str]:
    """Return comments that name the predicates for the arrays of numbers in a message, and for the message."""
    arrays = list(_find_number_arrays(definition, ""))
    lines = []
    if arrays:
        lines += ["", f"% for array_min/2, array_percentile/3 and others: {', '.join(arrays)}"]
    predicates = SENSOR_PREDICATES.get(definition.name)
    if predicates is not None:
        lines += ["", f"% for {', '.join(predicates)}: the whole message"]
    return lines


def _find_number_arrays(definition: Definition, prefix: str) -> Iterator[str]:
    """Yield the names of the arrays of numbers of a message and of the messages in it."""
    for slot in definition.fields:
        name = f"{prefix}{slot.name}"
        if slot.definition is not None:
            if slot.length is None:
                yield from _find_number_arrays(slot.definition, f"{name}.")
        elif slot.length is not None and slot.type not in (*TIMES, "bool", "string"):
            yield name


def _align_comments(lines: List[_TemplateLine]) -> List[str]:
    widest = (
        max(len(line.text) for line in lines if line.comment) if any(line.comment for line in lines) else 0
    )
    return [f"{line.text.ljust(widest)}  % {line.comment}" if line.comment else line.text for line in lines]
