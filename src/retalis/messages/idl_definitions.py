"""Definitions of message types in IDL, converted to the syntax of ``.msg`` files of ROS 2.

ROS 2 defines the mapping between IDL 4.2 (https://www.omg.org/spec/IDL/4.2) and its types
(https://design.ros2.org/articles/idl_interface_definition.html). A text can contain the definitions of several types,
each after a heading ``IDL: pkg/msg/Type``; that is what ``ros2 bag`` stores. `convert_idl` parses it with a grammar
for the package ``lark``, which is imported only then, and describes the requested types and the types of their slots:

* `_SymbolReader` collects modules, types and constants in a table by their scoped names.
* `_TypeDescriber` resolves the type of each slot: names are searched from the innermost scope outwards, aliases are
  replaced, and bounds are evaluated.

A definition that no slot uses costs nothing, whatever it contains. The following have no counterpart in ``.msg``, but
the same bytes as something that does: an array of several dimensions is one array, row by row; an enumeration is an
integer, whose enumerators become constants; the slots of a base type come first. Constants in a module
``Type_Constants`` belong to the type. Annotations and preprocessor lines do not change the bytes and are ignored,
except ``@bit_bound`` and ``@value`` of enumerations. Unions, maps, ``fixed``, ``wchar``, ``long double``, bit masks
and nested sequences cannot be read.
"""

import re
from functools import lru_cache
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    NoReturn,
    Optional,
    Set,
    Tuple,
    Union,
)

from ..foundation.displayed_text import quote_shortened, shorten
from ..foundation.errors import MessageError, install_hint
from ..foundation.ros_name_checks import ros1_type_name
from ..foundation.source_places import Place, place_at_offset

_GRAMMAR = r"""
start: definition*
definition: annotation* (module | constant | struct | union | enum | bitmask | bitset | typedef | forward) ";"

module: "module" NAME "{" definition* "}"
constant: "const" type NAME "=" expression
forward: ("struct" | "union") NAME
struct: "struct" NAME [":" scoped_name] "{" member* "}"
member: annotation* type declarator ("," declarator)* ";"
union: "union" NAME "switch" "(" annotation* type ")" "{" case* "}"
case: ("case" expression ":" | "default" ":")+ annotation* type declarator ";"
enum: "enum" NAME "{" enumerator ("," enumerator)* [","] "}"
bitmask: "bitmask" NAME "{" enumerator ("," enumerator)* [","] "}"
enumerator: annotation* NAME
bitset: "bitset" NAME [":" scoped_name] "{" bitfield* "}"
bitfield: annotation* "bitfield" "<" expression ["," type] ">" NAME* ";"
typedef: "typedef" type declarator ("," declarator)*
declarator: NAME dimension*
dimension: "[" expression "]"

type: primitive
    | "string" ["<" expression ">"] -> text
    | "wstring" ["<" expression ">"] -> wide_text
    | "sequence" "<" annotation* type ["," expression] ">" -> sequence
    | "map" "<" type "," type ["," expression] ">" -> map
    | "fixed" ["<" expression "," expression ">"] -> fixed
    | scoped_name -> named
primitive: WORD | UNSIGNED? "short" -> short | UNSIGNED? "long" -> long | UNSIGNED? "long" "long" -> long_long
    | "long" "double" -> long_double

annotation: "@" scoped_name ["(" [expression | parameter ("," parameter)*] ")"]
parameter: NAME "=" expression

?expression: xor | expression "|" xor -> bit_or
?xor: conjunction | xor "^" conjunction -> bit_xor
?conjunction: shift | conjunction "&" shift -> bit_and
?shift: sum | shift "<<" sum -> shift_left
?sum: product | sum "+" product -> add | sum "-" product -> subtract
?product: unary | product "*" unary -> multiply | product "/" unary -> divide | product "%" unary -> modulo
?unary: primary | "-" primary -> negative | "+" primary | "~" primary -> invert
?primary: scoped_name -> name_value
    | NUMBER -> number
    | TRUTH -> truth
    | CHARACTER -> string
    | STRING+ -> string
    | "(" expression ")"
scoped_name: ABSOLUTE? NAME ("::" NAME)*

WORD.2: /(boolean|octet|char|wchar|float|double|any|Object|u?int(8|16|32|64))(?![A-Za-z0-9_])/
UNSIGNED: "unsigned"
ABSOLUTE: "::"
TRUTH.2: /(TRUE|FALSE)(?![A-Za-z0-9_])/
NAME: /[A-Za-z_][A-Za-z0-9_]*/
NUMBER: /0[xX][0-9a-fA-F]+|([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?[dDfF]?/
STRING: /L?"([^"\\\n]|\\.)*"/
CHARACTER: /L?'([^'\\\n]|\\.)+'/
COMMENT.2: /\/\/[^\n]*/ | /\/\*([^*]|\*(?!\/))*\*\//
PREPROCESSOR: /#(\\\r?\n|[^\n])*/
HEADING: /(={20,}[ \t\r]*\n)?[ \t]*IDL:[^\n]*/

%import common.WS
%ignore WS
%ignore COMMENT
%ignore PREPROCESSOR
%ignore HEADING
"""

_MAX_DEPTH = 50
"""Maximum nesting depth of modules, expressions, aliases and base types."""

_MAX_RESULT_CHARACTERS = 1_000_000
"""Maximum length of the result of `convert_idl`, as of other definitions."""

_MAX_VALUE = 1 << 64
"""Maximum absolute value of a constant expression."""

_PRIMITIVES = {
    "boolean": "bool",
    "octet": "byte",
    "char": "char",
    "float": "float32",
    "double": "float64",
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}
_INTEGER_BITS = {"short": 16, "long": 32, "long_long": 64}
_UNSUPPORTED_TYPES = {
    "union": "a union",
    "bitmask": "a bit mask",
    "bitset": "a bit set",
    "forward": "a type that is declared but not defined",
    "constant": "a constant",
    "module": "a module",
    "map": "a map",
    "fixed": "a fixed-point number",
}

_EMPTY_TYPE_MEMBER = "structure_needs_at_least_one_member"
"""Slot that ROS 2 adds to a type without slots, because IDL does not allow that."""

_CONSTANTS_SUFFIX = "_Constants"

_ESCAPES = {"n": "\n", "t": "\t", "v": "\v", "b": "\b", "r": "\r", "f": "\f", "a": "\a"}

_Value = Union[bool, int, float, str]
_ScopePath = Tuple[str, ...]


class _Symbol(NamedTuple):
    """A definition: its kind, syntax tree, scope, and for enumerations the bits of a value."""

    kind: str
    tree: Any
    scope: _ScopePath
    bits: int = 32


class _SlotType(NamedTuple):
    """Type of a slot: the type of its elements, and the number of elements; None for one value, 0 for any number."""

    name: str
    length: Optional[int] = None

    def describe(self) -> str:
        """Return the type in the syntax of ``.msg`` files."""
        return self.name if self.length is None else f"{self.name}[{self.length or ''}]"


def convert_idl(name: str, text: str, names: Iterable[str]) -> Dict[str, str]:
    """Return the definitions of types, and of the types of their slots, in the syntax of ``.msg`` files.

    Types that the text does not define are named in the definitions, but not part of the result.

    Args:
        name: ``pkg/Type``, for errors; types outside of modules belong to its package.
        text: the definitions in IDL.
        names: the requested types, ``pkg/Type``.

    Raises:
        MessageError: with its place, if the text cannot be parsed, does not define a requested type, or a type cannot
            be read; or if the package ``lark`` is missing.
    """
    source = _IdlText(name, text)
    tree = _parse(source)
    symbols: Dict[_ScopePath, _Symbol] = {}
    _SymbolReader(source, symbols).read(tree, ())
    return _TypeDescriber(source, symbols).describe_all(names)


class _IdlText:
    """Text of a definition and name of its type, for errors."""

    def __init__(self, name: str, text: str):
        self.name, self.text = name, text

    def fail(self, problem: str, node: Any = None) -> NoReturn:
        """Raise `MessageError` with the place of a tree or token, or of an offset."""
        offset = node if isinstance(node, int) else _find_offset(node)
        place: Optional[Place] = None
        if offset is not None:
            place = place_at_offset(self.name, self.text, min(offset, len(self.text)))
        raise MessageError(problem, place)


def _find_offset(node: Any) -> Optional[int]:
    """Return the offset of a token or of the first token of a tree; None for an empty tree."""
    offset = getattr(node, "start_pos", None)
    if offset is None:
        offset = getattr(getattr(node, "meta", None), "start_pos", None)
    return offset


@lru_cache(maxsize=1)
def _make_parser() -> Any:
    from lark import Lark  # noqa: PLC0415 - slow, and few bags have definitions in IDL

    return Lark(
        _GRAMMAR, parser="lalr", lexer="contextual", maybe_placeholders=False, propagate_positions=True
    )


def _parse(source: _IdlText) -> Any:
    """Return the syntax tree of a text."""
    try:
        parser = _make_parser()
    except ImportError:
        raise MessageError(
            f"its definition is in IDL, which needs the Python package lark ({install_hint('lark', 'python3-lark')})"
        ) from None
    from lark.exceptions import UnexpectedInput  # noqa: PLC0415 - see above

    try:
        return parser.parse(source.text)
    except UnexpectedInput as error:
        offset = getattr(error, "pos_in_stream", None)
        if getattr(getattr(error, "token", None), "type", "") == "$END" or offset is None or offset < 0:
            offset = len(source.text)
        names = getattr(error, "expected", None) or getattr(error, "allowed", None) or ()
        expected = " or ".join(sorted({_describe_terminal(parser, name) for name in names}))
        word = re.match(r"\w+|.", source.text[offset : offset + 100])
        found = quote_shortened(word[0]) if word else "the end"
        source.fail(
            f"its definition in IDL cannot be parsed: expected {shorten(expected)}, found {found}", offset
        )


def _describe_terminal(parser: Any, name: str) -> str:
    """Return a terminal of the grammar as shown in errors."""
    patterns = {terminal.name: terminal.pattern for terminal in parser.terminals}
    pattern = patterns.get(name)
    if pattern is not None and pattern.type == "str":
        return f"'{pattern.value}'"
    return {"$END": "the end", "NAME": "a name", "NUMBER": "a number", "WORD": "a type"}.get(
        name, name.lower()
    )


class _SymbolReader:
    """Reader of a syntax tree, which adds its definitions to a table."""

    def __init__(self, source: _IdlText, symbols: Dict[_ScopePath, _Symbol]):
        self._source = source
        self._symbols = symbols

    def read(self, tree: Any, scope: _ScopePath) -> None:
        """Add the definitions in a tree, which is in a scope."""
        if len(scope) > _MAX_DEPTH:
            self._source.fail(f"modules cannot be nested more than {_MAX_DEPTH} deep", tree)
        for definition in tree.children:
            if getattr(definition, "data", None) != "definition":
                continue
            *annotations, item = definition.children
            kind = str(item.data)
            if kind == "typedef":
                for declarator in item.children[1:]:
                    self._add(
                        scope, declarator.children[0], _Symbol("alias", (item.children[0], declarator), scope)
                    )
                continue
            name = item.children[1] if kind == "constant" else item.children[0]
            path = (*scope, str(name))
            if kind == "module":
                self._symbols.setdefault(path, _Symbol(kind, item, scope))
                self.read(item, path)
            elif kind == "enum":
                bits = _find_annotation(annotations, "bit_bound")
                # The sizes of the mapping to C++: the smallest integer with at least this number of bits.
                size = next((size for size in (8, 16, 32) if bits is not None and bits <= size), 32)
                self._add(scope, name, _Symbol(kind, item, scope, size))
                # Enumerators belong to the scope around the enumeration, too.
                for value, enumerator in _list_enumerators(item):
                    self._symbols.setdefault((*scope, enumerator), _Symbol("enumerator", value, scope))
            else:
                self._add(scope, name, _Symbol(kind, item, scope))

    def _add(self, scope: _ScopePath, name: Any, symbol: _Symbol) -> None:
        # The same definition may follow several headings; a forward declaration precedes the definition.
        known = self._symbols.get((*scope, str(name)))
        if known is None or known.kind == "forward":
            self._symbols[(*scope, str(name))] = symbol


def _find_annotation(annotations: Iterable[Any], name: str) -> Optional[int]:
    """Return the integer argument of an annotation; None without it."""
    for annotation in annotations:
        names, *arguments = annotation.children
        if str(names.children[-1]) == name and len(arguments) == 1:
            argument = arguments[0].children[-1] if arguments[0].data == "parameter" else arguments[0]
            text = str(argument.children[0]) if argument.data == "number" else ""
            if text.isdigit() and len(text) < 10:
                return int(text)
    return None


def _list_enumerators(tree: Any) -> Iterator[Tuple[int, str]]:
    """Yield the values and names of an enumeration."""
    value = -1
    for enumerator in tree.children[1:]:
        *annotations, name = enumerator.children
        stated = _find_annotation(annotations, "value")
        value = value + 1 if stated is None else stated
        yield value, str(name)


class _TypeDescriber:
    """Converter of the types in a table to the syntax of ``.msg`` files."""

    def __init__(self, source: _IdlText, symbols: Dict[_ScopePath, _Symbol]):
        self._source = source
        self._symbols = symbols
        self._package = source.name.partition("/")[0]
        self._constants: Dict[_ScopePath, List[Tuple[str, _Symbol]]] = {}
        """Names and definitions of constants, by scope."""
        for path, symbol in symbols.items():
            if symbol.kind == "constant":
                self._constants.setdefault(path[:-1], []).append((path[-1], symbol))
        self._pending: List[_ScopePath] = []
        """Paths of the types that slots have."""

    def describe_all(self, names: Iterable[str]) -> Dict[str, str]:
        """Return the definitions of types and of the types of their slots, by name."""
        paths = {
            self._name_type(path): path for path, symbol in self._symbols.items() if symbol.kind == "struct"
        }
        for name in names:
            if name not in paths:
                self._source.fail(f"its definition in IDL does not define {shorten(name)}")
            self._pending.append(paths[name])
        texts: Dict[str, str] = {}
        characters = 0
        while self._pending:
            path = self._pending.pop()
            name = self._name_type(path)
            if name not in texts:
                texts[name] = "".join(f"{line}\n" for line in self._describe_struct(path))
                characters += len(texts[name])
                # A short text can give a long result: each of many types repeats the slots of a base type.
                if characters > _MAX_RESULT_CHARACTERS:
                    self._source.fail(
                        f"its types have more than {_MAX_RESULT_CHARACTERS} characters without IDL", 0
                    )
        return texts

    def _name_type(self, path: _ScopePath) -> str:
        if len(path) == 3:
            name = ros1_type_name("/".join(path))
            if name.count("/") == 1:
                return name
        package, *rest = path if len(path) > 1 else (self._package, *path)
        return f"{package}/{'_'.join(rest)}"

    def _describe_struct(self, path: _ScopePath) -> List[str]:
        """Return the lines of the definition of a type."""
        lines: List[str] = []
        names: Set[str] = set()
        for name, symbol in self._constants.get((*path[:-1], path[-1] + _CONSTANTS_SUFFIX), ()):
            lines += self._describe_constant(name, symbol)
            names.add(name)
        slots: List[str] = []
        enums: Dict[int, Tuple[str, _Symbol]] = {}
        for slot_name, slot_type, enum in self._list_slots(self._symbols[path], 0):
            slots.append(f"{slot_type.describe()} {slot_name}")
            if enum is not None:
                enums[id(enum)] = slot_type.name, enum
        for type_name, enum in enums.values():
            for value, name in _list_enumerators(enum.tree):
                if name not in names:
                    lines.append(f"{type_name} {name}={value}")
                    names.add(name)
        return lines + ([] if slots == [f"uint8 {_EMPTY_TYPE_MEMBER}"] else slots)

    def _describe_constant(self, name: str, symbol: _Symbol) -> List[str]:
        """Return the line of a constant; none if ``.msg`` files cannot express it: constants are not in messages."""
        type_tree, _, expression = symbol.tree.children
        try:
            slot_type, _ = self._describe_type(type_tree, symbol.scope, 0)
            value = self._evaluate(expression, symbol.scope, 0)
        except MessageError:
            return []
        if isinstance(value, str):
            if not value.isprintable():
                return []
            escaped = value.replace("\\", "\\\\").replace('"', '\\"')
            return [f'{slot_type.name} {name}="{escaped}"']
        return [f"{slot_type.name} {name}={value}"]

    def _list_slots(self, symbol: _Symbol, depth: int) -> Iterator[Tuple[str, _SlotType, Optional[_Symbol]]]:
        """Yield the name of each slot, its type, and its enumeration, if it is one."""
        self._check_depth(depth, symbol.tree)
        name, *parts = symbol.tree.children
        # Names in a type are searched from the type's own scope outwards.
        for part in parts:
            if part.data == "scoped_name":
                _, base = self._resolve(part, symbol.scope)
                if base is None or base.kind != "struct":
                    self._source.fail("the base type is not a struct that the text defines", part)
                yield from self._list_slots(base, depth + 1)
                continue
            types_and_declarators = [child for child in part.children if child.data != "annotation"]
            for declarator in types_and_declarators[1:]:
                slot_type, enum = self._describe_type(types_and_declarators[0], symbol.scope, 0)
                slot_type = self._add_dimensions(slot_type, declarator, symbol.scope)
                yield str(declarator.children[0]), slot_type, enum

    def _add_dimensions(self, slot_type: _SlotType, declarator: Any, scope: _ScopePath) -> _SlotType:
        """Return the type of an array; the dimensions of an array of arrays are multiplied."""
        for dimension in declarator.children[1:]:
            length = self._evaluate(dimension.children[0], scope, 0)
            if not isinstance(length, int) or length < 1:
                self._source.fail("an array has a length that is not a positive integer", dimension)
            if slot_type.length == 0:
                self._source.fail("an array of sequences cannot be read", declarator)
            slot_type = slot_type._replace(length=length * (slot_type.length or 1))
        return slot_type

    def _describe_type(self, tree: Any, scope: _ScopePath, depth: int) -> Tuple[_SlotType, Optional[_Symbol]]:
        """Return a type, and the enumeration that it is, or whose values its elements are."""
        self._check_depth(depth, tree)
        kind = str(tree.data)
        if kind == "type":
            return self._describe_primitive(tree.children[0]), None
        if kind in ("text", "wide_text"):
            return _SlotType("string" if kind == "text" else "wstring"), None
        if kind == "sequence":
            (element,) = (child for child in tree.children[:-1] or tree.children if self._is_type(child))
            slot_type, enum = self._describe_type(element, scope, depth + 1)
            if slot_type.length is not None:
                self._source.fail("a sequence of arrays or sequences cannot be read", tree)
            return slot_type._replace(length=0), enum
        if kind != "named":
            self._fail_unsupported(kind, tree)
        path, symbol = self._resolve(tree.children[0], scope)
        if symbol is None:
            # Defined elsewhere: on this system, or in another part of the text.
            return _SlotType("/".join(path) if len(path) > 1 else f"{self._package}/{path[0]}"), None
        if symbol.kind == "alias":
            target, declarator = symbol.tree
            slot_type, enum = self._describe_type(target, symbol.scope, depth + 1)
            return self._add_dimensions(slot_type, declarator, symbol.scope), enum
        if symbol.kind == "enum":
            return _SlotType(f"uint{symbol.bits}"), symbol
        if symbol.kind != "struct":
            self._fail_unsupported(symbol.kind, tree)
        self._pending.append(path)
        return _SlotType(self._name_type(path)), None

    @staticmethod
    def _is_type(tree: Any) -> bool:
        return str(tree.data) in ("type", "text", "wide_text", "sequence", "map", "fixed", "named")

    def _describe_primitive(self, tree: Any) -> _SlotType:
        """Return a type of numbers or characters."""
        kind = str(tree.data)
        if kind in _INTEGER_BITS:
            return _SlotType(f"{'u' if tree.children else ''}int{_INTEGER_BITS[kind]}")
        word = "long double" if kind == "long_double" else str(tree.children[0])
        if word not in _PRIMITIVES:
            self._source.fail(f"a slot of type '{word}' cannot be read", tree)
        return _SlotType(_PRIMITIVES[word])

    def _fail_unsupported(self, kind: str, tree: Any) -> NoReturn:
        self._source.fail(f"a slot whose type is {_UNSUPPORTED_TYPES.get(kind, kind)} cannot be read", tree)

    def _resolve(self, tree: Any, scope: _ScopePath) -> Tuple[_ScopePath, Optional[_Symbol]]:
        """Return the path of a scoped name and its definition, or None if the text does not define it."""
        names = tuple(map(str, tree.children))
        if names[0] == "::":
            return names[1:], self._symbols.get(names[1:])
        for length in range(len(scope), -1, -1):
            path = (*scope[:length], *names)
            symbol = self._symbols.get(path)
            if symbol is not None:
                return path, symbol
        return names, None

    def _evaluate(self, tree: Any, scope: _ScopePath, depth: int) -> _Value:
        """Return the value of a constant expression."""
        self._check_depth(depth, tree)
        kind = str(tree.data)
        if kind == "number":
            return _parse_number(str(tree.children[0]))
        if kind == "truth":
            return str(tree.children[0]) == "TRUE"
        if kind == "string":
            return "".join(_unescape(str(token)) for token in tree.children)
        if kind == "name_value":
            _, symbol = self._resolve(tree.children[0], scope)
            if symbol is not None and symbol.kind == "enumerator":
                return int(symbol.tree)
            if symbol is None or symbol.kind != "constant":
                name = "::".join(map(str, tree.children[0].children))
                self._source.fail(f"{shorten(name)} is not a constant that the text defines", tree)
            return self._evaluate(symbol.tree.children[2], symbol.scope, depth + 1)
        operands = [self._evaluate(child, scope, depth + 1) for child in tree.children]
        try:
            value = _OPERATORS[kind](*operands) if kind in _OPERATORS else operands[0]
            if isinstance(value, str) or not abs(value) <= _MAX_VALUE:
                raise ValueError
        except (ArithmeticError, TypeError, ValueError):
            self._source.fail("the value of an expression is not a number of 64 bits", tree)
        return value

    def _check_depth(self, depth: int, tree: Any) -> None:
        if depth > _MAX_DEPTH:
            self._source.fail(f"types and expressions cannot be nested more than {_MAX_DEPTH} deep", tree)


def _divide(dividend: Any, divisor: Any) -> Any:
    """Return a quotient; that of integers is an integer, rounded towards zero."""
    if isinstance(dividend, float) or isinstance(divisor, float):
        return dividend / divisor
    quotient = abs(dividend) // abs(divisor)
    return quotient if (dividend < 0) == (divisor < 0) else -quotient


def _shift_left(number: Any, count: Any) -> Any:
    """Return a shifted integer; the count is limited, because the result takes memory."""
    if not 0 <= count <= 64:
        raise ValueError
    return number << count


_OPERATORS: Dict[str, Callable[..., Any]] = {
    "bit_or": lambda left, right: left | right,
    "bit_xor": lambda left, right: left ^ right,
    "bit_and": lambda left, right: left & right,
    "shift_left": _shift_left,
    "add": lambda left, right: left + right,
    "subtract": lambda left, right: left - right,
    "multiply": lambda left, right: left * right,
    "divide": _divide,
    "modulo": lambda left, right: left - right * _divide(left, right),
    "negative": lambda operand: -operand,
    "invert": lambda operand: ~operand,
}


def _parse_number(text: str) -> _Value:
    """Return the value of a literal: decimal, hexadecimal, or octal with a leading zero."""
    if text[:2] in ("0x", "0X"):
        return int(text, 16)
    digits = text.rstrip("dDfF")
    # The limit keeps the conversion of an untrusted text linear.
    if not digits.isdigit() or digits != text or len(digits) > 25:
        return float(digits)
    if digits[0] == "0" and digits.strip("01234567") == "":
        return int(digits, 8)
    return int(digits)


def _unescape(literal: str) -> str:
    """Return the text of a literal in quotes."""
    text = literal.lstrip("L")[1:-1]
    return re.sub(r"\\(.)", lambda match: _ESCAPES.get(match[1], match[1]), text) if "\\" in text else text
