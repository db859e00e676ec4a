"""YAML documents whose values know their places.

`ruamel.yaml` composes a document to a graph of nodes with line and column. A `YamlValue` wraps a node, and converts
it on request, so that each error names the place of the value that is wrong. A document is YAML 1.2: ``yes`` and
``on`` are texts.
"""

from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Union

from ..foundation.displayed_text import format_count, format_number, quote_shortened
from ..foundation.errors import RetalisError, UsageError, install_hint
from ..foundation.similar_names import did_you_mean
from ..foundation.source_places import Place, place_in_line

MAX_VALUES = 1_000_000
"""Maximum number of values of a document. Aliases count each time: a short text cannot stand for a huge one."""

MAX_NUMBER = 1e300
"""Largest absolute value of a number."""

MAX_DEPTH = 60
"""Maximum nesting depth of a document."""

Scalar = Union[None, bool, int, float, str]
"""A plain value."""

_SCALAR_TAGS = {
    "tag:yaml.org,2002:null": "nothing",
    "tag:yaml.org,2002:bool": "true or false",
    "tag:yaml.org,2002:int": "an integer",
    "tag:yaml.org,2002:float": "a number",
    "tag:yaml.org,2002:str": "a text",
}
"""Descriptions of the types of scalars, by the tag that YAML derives from their form."""


class CaseFileError(RetalisError):
    """An error in a test file."""


class _ValueBudget:
    """Number of values that a document may still have."""

    def __init__(self, document: str):
        self._document = document
        self._remaining = MAX_VALUES

    def spend(self) -> None:
        """Count a value.

        Raises:
            CaseFileError: if the document has too many.
        """
        self._remaining -= 1
        if self._remaining < 0:
            raise CaseFileError(f"{self._document}: has more than {MAX_VALUES} values")


class YamlText(NamedTuple):
    """The text of a document."""

    path: str
    lines: List[str]
    budget: _ValueBudget

    def place(self, line: int, column: int) -> Place:
        """Return the place of a line and column, which count from 0."""
        text = self.lines[line] if line < len(self.lines) else ""
        return place_in_line(self.path, line + 1, text, 0, min(column, len(text)))


class YamlValue:
    """A value of a document.

    Args:
        node: node of `ruamel.yaml`.
        name: description for errors: the key of the value, or its position in a list.
        depth: nesting depth.
    """

    def __init__(self, node: Any, source: YamlText, name: str, depth: int = 0):
        if depth > MAX_DEPTH:
            raise CaseFileError(f"more than {MAX_DEPTH} nested values", _place_of(node, source))
        source.budget.spend()
        self._node = node
        self._source = source
        self._depth = depth
        self.name = name

    @property
    def place(self) -> Place:
        """Place of the value."""
        return _place_of(self._node, self._source)

    @property
    def first_text_line(self) -> int:
        """Number of the first line of the text of a scalar; a block scalar (``|``) begins on the next line."""
        line: int = self._node.start_mark.line + 1
        return line + 1 if getattr(self._node, "style", None) in ("|", ">") else line

    @property
    def is_folded(self) -> bool:
        """True for a scalar with the style ``>``, whose line breaks are spaces."""
        return getattr(self._node, "style", None) == ">"

    @property
    def is_mapping(self) -> bool:
        """True if the value is a mapping."""
        return bool(self._node.id == "mapping")

    @property
    def is_list(self) -> bool:
        """True if the value is a list."""
        return bool(self._node.id == "sequence")

    @property
    def is_text(self) -> bool:
        """True if the value is a text; numbers, true, false and null in quotes are texts."""
        return self._type_name() == "a text"

    def error(self, message: str) -> CaseFileError:
        """Return an error at the place of the value."""
        return CaseFileError(message, self.place)

    def mapping(self, keys: Optional[Mapping[str, object]] = None) -> "Dict[str, YamlValue]":
        """Return the values of a mapping by key.

        Args:
            keys: the allowed keys; None for any.

        Raises:
            CaseFileError: if this is no mapping, or a key is unknown or repeated.
        """
        if not self.is_mapping:
            raise self._unexpected(
                "a mapping (key: value)" if keys is None else f"a mapping of {_list(keys)}"
            )
        values: Dict[str, YamlValue] = {}
        for key_node, value_node in self._node.value:
            key = YamlValue(key_node, self._source, "key", self._depth + 1)
            name = key.text()
            if name == "<<":
                raise key.error("merge keys (<<) are not supported: write the values of the alias out")
            if keys is not None and name not in keys:
                hint = did_you_mean(name, keys)
                if any(bracket in name for bracket in "()[]"):
                    hint = '; YAML splits at commas: write a term with commas in quotes, as "f(a, b)"'
                raise key.error(f"unknown key {quote_shortened(name)}: expected {_list(keys)}{hint}")
            if name in values:
                raise key.error(f"key {quote_shortened(name)} is repeated")
            values[name] = YamlValue(value_node, self._source, name, self._depth + 1)
        return values

    def items(self) -> "List[YamlValue]":
        """Return the values of a list.

        Raises:
            CaseFileError: if this is no list.
        """
        if not self.is_list:
            raise self._unexpected("a list")
        return [
            YamlValue(node, self._source, f"{self.name}[{position}]", self._depth + 1)
            for position, node in enumerate(self._node.value)
        ]

    def text(self) -> str:
        """Return a scalar as it is written: numbers, too.

        Raises:
            CaseFileError: if this is no scalar, or nothing.
        """
        if self._node.id != "scalar" or self._type_name() == "nothing":
            raise self._unexpected("a text")
        return str(self._node.value)

    def number(self, minimum: float = -MAX_NUMBER, maximum: float = MAX_NUMBER) -> float:
        """Return a number.

        Raises:
            CaseFileError: if this is no finite number, or out of the range.
        """
        value = self.scalar()
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < float("inf"):
            raise self._unexpected("a number")
        text = quote_shortened(str(self._node.value)).strip("'")
        if value < minimum:
            raise self.error(f"{self.name}: {text} is too small: expected at least {format_number(minimum)}")
        if value > maximum:
            raise self.error(f"{self.name}: {text} is too large: expected at most {format_number(maximum)}")
        return value

    def integer(self, minimum: int = 0) -> int:
        """Return an integer.

        Raises:
            CaseFileError: if this is no integer, or less than the minimum.
        """
        value = self.scalar()
        if isinstance(value, bool) or not isinstance(value, int):
            raise self._unexpected("an integer")
        if value < minimum:
            raise self.error(f"{self.name}: {value} is too small: expected at least {minimum}")
        return value

    def boolean(self) -> bool:
        """Return true or false.

        Raises:
            CaseFileError: if this is neither.
        """
        value = self.scalar()
        if not isinstance(value, bool):
            raise self._unexpected("true or false")
        return value

    def scalar(self) -> Scalar:
        """Return a plain value.

        Raises:
            CaseFileError: if this is a list or a mapping, or its form is invalid.
        """
        type_name = self._type_name()
        if not type_name:
            raise self._unexpected("a plain value")
        text = str(self._node.value)
        if type_name == "a text":
            return text
        if type_name == "nothing":
            return None
        if type_name == "true or false":
            return text.lower() == "true"
        return self._parse_number(text, type_name == "an integer")

    def _parse_number(self, text: str, is_integer: bool) -> Union[int, float]:
        digits = text.replace("_", "").lower()
        try:
            if is_integer:
                return int(digits, 0) if digits.lstrip("+-")[:2] in ("0x", "0o") else int(digits)
            return float(digits.replace(".inf", "inf").replace(".nan", "nan"))
        except ValueError:
            raise self.error(f"{self.name}: {quote_shortened(text)} is not a valid number") from None

    def plain(self) -> Any:
        """Return the value with all values in it, as dictionaries, lists and plain values."""
        if self.is_mapping:
            return {key: value.plain() for key, value in self.mapping().items()}
        if self.is_list:
            return [item.plain() for item in self.items()]
        return self.scalar()

    def _type_name(self) -> str:
        """Return the description of a scalar's type; "" for lists, mappings, and values with another tag."""
        return _SCALAR_TAGS.get(str(self._node.tag), "") if self._node.id == "scalar" else ""

    def _unexpected(self, expected: str) -> CaseFileError:
        if self.is_mapping:
            actual = f"a mapping of {format_count(len(self._node.value), 'key')}"
        elif self.is_list:
            actual = f"a list of {format_count(len(self._node.value), 'value')}"
        elif self._type_name() == "nothing":
            actual = "nothing"
        else:
            actual = quote_shortened(str(self._node.value))
        return self.error(f"{self.name}: expected {expected}, found {actual}")


def parse_yaml(text: str, path: str) -> YamlValue:
    """Parse a document.

    Raises:
        CaseFileError: if it is no YAML, has several documents, or is empty.
        UsageError: if the package ruamel.yaml is not installed.
    """
    try:
        from ruamel.yaml import YAML  # noqa: PLC0415 - takes 50 ms to import
        from ruamel.yaml.error import MarkedYAMLError, YAMLError  # noqa: PLC0415
    except ImportError:
        hint = install_hint("ruamel.yaml", "python3-ruamel.yaml")
        raise UsageError(f"test cases need the Python package ruamel.yaml ({hint})") from None

    source = YamlText(path, text.splitlines(), _ValueBudget(path))
    try:
        # The reader of plain values is written in C where that is installed.
        node = YAML(typ="safe").compose(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = None if mark is None else source.place(mark.line, mark.column)
        problem = " ".join(str(part) for part in (error.context, error.problem) if part)
        prefix = "" if place is not None else f"{path}: "
        raise CaseFileError(f"{prefix}not valid YAML: {problem}", place) from None
    except (YAMLError, RecursionError, ValueError) as error:
        raise CaseFileError(f"{path}: not valid YAML: {error}") from None
    if node is None:
        raise CaseFileError(f"{path}: is empty: expected a mapping with the key 'cases'")
    return YamlValue(node, source, "document")


def _place_of(node: Any, source: YamlText) -> Place:
    return source.place(node.start_mark.line, node.start_mark.column)


def _list(keys: Mapping[str, object]) -> str:
    names = list(keys)
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"
