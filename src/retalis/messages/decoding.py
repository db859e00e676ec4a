"""Message bytes to event terms, by functions that are generated for each type.

The generated source reads each run of fixed-size slots with one `struct` call. Long arrays and texts become
lazy terms: what no rule looks at is cut out of the message and left undecoded. Where a message is numbers,
then texts, then numbers, all texts are looked up at once by the bytes they make up (a robot's frame names
come again and again); so one transform costs two `struct` calls and one look-up.
"""

from struct import Struct, calcsize
from struct import error as StructError
from typing import Any, Callable, Dict, List, Optional, Tuple

from ..errors import MessageError
from ..terms import CONS, FALSE, NIL, TRUE, Lazy, Term, atom, functor
from ._compile import compile_function
from .arrays import SMALL, array_maker, record_maker, variable_array
from .definition import HEADER, PRIMITIVES, TIMES, VARIABLE, Definition, Field
from .layout import element_format, explain, least_size
from .text import text_term

_CACHED_TEXTS = 2048
_CACHED_LENGTH = 128

Decode = Callable[[bytes], Term]


class Decoder:
    """The decoder of one message type.

    Attributes:
        definition: the type.
        functor: the functor of its event terms (arity 0: the term is an atom).
        decode: the function from the bytes of a message to its term. Raises `MessageError` where the bytes
            are no such message.
        stamp: the function from the bytes to the time of ``header.stamp`` in nanoseconds; None for a zero
            stamp, and always for a type without a header.
    """

    __slots__ = ("definition", "functor", "decode", "stamp")

    def __init__(self, definition: Definition):
        self.definition = definition
        self.functor = functor(definition.functor_name, len(definition.fields))
        self.decode: Decode = _compile_decode(definition)
        self.stamp: Callable[[bytes], Optional[int]] = _compile_stamp(definition)

    def lazy(self, data: bytes) -> Term:
        """Return the term of a message, decoded when something looks at it.

        A message that is broken is found out only then.
        """
        if not self.definition.fields:
            return self.decode(data)
        return Lazy(self.functor, self.decode, data)


class TextCache(Dict[bytes, Any]):
    """Atoms by the bytes of their texts, bounded: names come again and again, other texts do not stay."""

    def keep(self, key: bytes, value: Any) -> None:
        """Remember a value, if its key is short."""
        if len(key) <= _CACHED_LENGTH:
            if len(self) >= _CACHED_TEXTS:
                self.clear()
            self[key] = value


_texts = TextCache()


def _read_text(data: bytes, start: int, stop: int) -> Term:
    """Return the text at a place of a message; the generated code has looked it up in the cache in vain."""
    raw = data[start:stop]
    if len(raw) != stop - start:
        raise StructError
    found = text_term(raw)
    _texts.keep(raw, found)
    return found


def _read_texts(key: bytes, number: int) -> Optional[Tuple[Term, ...]]:
    """Return the texts that, each with its length before it, make up ``key``; None where they do not."""
    texts: List[Term] = []
    at = 0
    for _ in range(number):
        size = int.from_bytes(key[at : at + 4], "little")
        raw = key[at + 4 : at + 4 + size]
        if len(raw) != size:
            return None
        texts.append(text_term(raw))
        at += 4 + size
    return tuple(texts) if at == len(key) and number else None


class _Code:
    """Source of the function for one type, in the making.

    Runs of fixed-size slots are collected until something of variable size comes. ``base`` is the source of
    the place where the run starts.
    """

    def __init__(self) -> None:
        self.lines: List[str] = []
        self.names: Dict[str, Any] = {
            "C": CONS,
            "N": NIL,
            "T": TRUE,
            "F": FALSE,
            "Lazy": Lazy,
            "StructError": StructError,
            "known": _texts.get,
            "read_text": _read_text,
            "text": text_term,
        }
        self.serial = 0
        self.base, self.shift = "o", 0
        self.format = ""
        self.targets: List[str] = []

    def name(self, prefix: str, value: Any = None) -> str:
        self.serial += 1
        name = f"{prefix}{self.serial}"
        if value is not None:
            self.names[name] = value
        return name

    def constant(self, name: str, value: Any) -> str:
        self.names[name] = value
        return name

    # What a message is made of; the source of the term is returned.

    def message(self, definition: Definition) -> str:
        if not definition.fields:
            return self.constant("A_" + definition.functor_name, atom(definition.functor_name))
        head = self.constant(
            f"F_{definition.functor_name}", functor(definition.functor_name, len(definition.fields))
        )
        parts = [self.slot(slot) for slot in definition.fields]
        return f"({head}, {', '.join(parts)})"

    def slot(self, slot: Field) -> str:
        if slot.length is None:
            return self.single(slot)
        if slot.length == VARIABLE:
            return self.variable(slot)
        return self.fixed_array(slot)

    def single(self, slot: Field) -> str:
        if slot.definition is not None:
            return self.message(slot.definition)
        if slot.type == "string":
            return self.string()
        if slot.type in TIMES:
            code = TIMES[slot.type][0]
            return f"(C, {self.fixed(code)}, (C, {self.fixed(code)}, N))"
        value = self.fixed(PRIMITIVES[slot.type])
        return f"(T if {value} else F)" if slot.type == "bool" else value

    def fixed_array(self, slot: Field) -> str:
        number = slot.length or 0
        if number == 0:
            return "text(b'')" if slot.is_bytes else "N"
        if slot.is_bytes:
            return f"text({self.fixed(f'{number}s')})"
        if number <= SMALL and slot.definition is None:
            parts = [self.single(slot._replace(length=None)) for _ in range(number)]
            return "".join(f"(C, {part}, " for part in parts) + "N" + ")" * number
        element = element_format(slot)
        if not element:
            return self.elements(slot, str(number))
        value = self.fixed(f"{number * calcsize('<' + element)}s")
        return f"Lazy(C, {self.name('make', _maker(slot))}, {value})"

    def variable(self, slot: Field) -> str:
        number = self.fixed("I")
        self.flush()
        if slot.is_bytes:
            return self.blob(number)
        element = element_format(slot)
        if not element:
            return self.elements(slot, number)
        size = calcsize("<" + element)
        value = self.name("t")
        make = self.name("make", _maker(slot))
        self.move(f"{number} * {size}")
        self.lines += [
            f"if not {number}: {value} = N",
            f"elif {number} <= {SMALL}: {value} = {make}(data[s:o])",
            f"else: {value} = Lazy(C, {make}, data[s:o])",
        ]
        return value

    def elements(self, slot: Field, number: str) -> str:
        """An array whose elements differ in size: each is decoded to find the next."""
        self.flush()
        read = self.name("read", variable_array(*_compile_element(slot)))
        value = self.name("t")
        self.lines.append(f"{value}, o = {read}(data, {self.place()}, {number})")
        self.base, self.shift = "o", 0
        return value

    def string(self) -> str:
        number = self.fixed("I")
        self.flush()
        self.move(number)
        value = self.name("t")
        self.lines += [
            f"{value} = known(data[s:o])",
            f"if {value} is None: {value} = read_text(data, s, o)",
        ]
        return value

    def blob(self, number: str) -> str:
        self.move(number)
        value = self.name("t")
        self.lines.append(f"{value} = text(data[s:o])")
        return value

    # Runs.

    def fixed(self, code: str) -> str:
        self.format += code
        self.targets.append(self.name("v"))
        return self.targets[-1]

    def place(self) -> str:
        return f"{self.base} + {self.shift}" if self.shift else self.base

    def flush(self) -> None:
        if not self.format:
            return
        layout = Struct("<" + self.format)
        unpack = self.name("S", layout.unpack_from)
        self.lines.append(f"{', '.join(self.targets)}, = {unpack}(data, {self.place()})")
        self.shift += layout.size
        self.format, self.targets = "", []

    def move(self, size: str) -> None:
        """Set ``s`` and ``o`` to the start and the end of ``size`` bytes that come next."""
        self.lines += [f"s = {self.place()}", f"o = s + {size}"]
        self.base, self.shift = "o", 0


class _Unsuited(Exception):
    """The type is not numbers, texts, numbers."""


class _FrameCode(_Code):
    """Source for types that are numbers, then texts, then numbers.

    An array of messages at the end is taken to have one element.
    """

    def __init__(self) -> None:
        super().__init__()
        self.texts: List[str] = []
        self.before: Tuple[str, List[str]] = ("", [])
        self.count: Optional[str] = None
        self.closed = False

    def fixed(self, code: str) -> str:
        if self.closed:
            raise _Unsuited
        return super().fixed(code)

    def string(self) -> str:
        if self.closed or (self.texts and self.format):
            raise _Unsuited
        if not self.texts:
            self.before = self.format, self.targets
            self.format, self.targets = "", []
        self.texts.append(self.name("t"))
        return self.texts[-1]

    def variable(self, slot: Field) -> str:
        if slot.definition is None or self.texts or self.count:
            raise _Unsuited
        self.count = self.fixed("I")
        element = self.message(slot.definition)
        self.closed = True
        return f"(C, {element}, N)"

    def elements(self, slot: Field, number: str) -> str:
        raise _Unsuited

    def build(self, definition: Definition, general: Decode) -> List[str]:
        """Return the source of the whole function, which falls back on ``general``.

        Raises:
            _Unsuited: where the type is not of this shape.
        """
        result = self.message(definition)
        head, tail = Struct("<" + self.before[0]), Struct("<" + self.format)
        if not self.texts or not (head.size or tail.size):
            raise _Unsuited
        cache = TextCache()
        number = len(self.texts)

        def learn(key: bytes) -> Any:
            texts = _read_texts(key, number)
            if texts is None:
                return None
            found = texts if number > 1 else texts[0]
            cache.keep(key, found)
            return found

        self.names.update(
            known=cache.get, learn=learn, head=head.unpack_from, tail=tail.unpack_from, general=general
        )
        key = f"data[{head.size}:{-tail.size if tail.size else ''}]"
        lines = ["def decode(data):", "  try:"]
        if self.before[1]:
            lines.append(f"    {', '.join(self.before[1])}, = head(data)")
        if self.count:
            lines.append(f"    if {self.count} != 1: return general(data)")
        lines += [
            f"    k = known({key})",
            "    if k is None:",
            f"      k = learn({key})",
            "      if k is None: return general(data)",
        ]
        if tail.size:
            lines.append(f"    {', '.join(self.targets)}, = tail(data, {-tail.size})")
        lines += ["  except StructError:", "    return general(data)"]
        lines.append(f"  {', '.join(self.texts)}{'' if number == 1 else ','} = k")
        return [*lines, f"  return {result}"]


def _compile_decode(definition: Definition) -> Decode:
    code = _Code()
    code.base = "0"
    result = code.message(definition)
    code.flush()
    code.names["fail"] = _failing(definition)
    lines = ["def decode(data):", "  try:", *("    " + line for line in code.lines)]
    lines += [
        f"    if len(data) != {code.place()}: fail(data)",
        "  except StructError: fail(data)",
        f"  return {result}",
    ]
    general: Decode = compile_function("decode", f"decode {definition.name}", lines, code.names)
    frames = _FrameCode()
    try:
        lines = frames.build(definition, general)
    except _Unsuited:
        return general
    fast: Decode = compile_function("decode", f"decode {definition.name}", lines, frames.names)
    return fast


def _failing(definition: Definition) -> Callable[[bytes], None]:
    def fail(data: bytes) -> None:
        raise MessageError(explain(definition, data))

    return fail


def _compile_stamp(definition: Definition) -> Callable[[bytes], Optional[int]]:
    first = definition.fields[0] if definition.fields else None
    if first is None or first.type != HEADER or first.length is not None or first.name != "header":
        return _no_stamp
    unpack = Struct("<II").unpack_from
    fail = _failing(definition)

    def stamp(data: bytes) -> Optional[int]:
        try:
            seconds, nanoseconds = unpack(data, 4)
        except StructError:
            fail(data)
        return seconds * 1_000_000_000 + nanoseconds or None

    return stamp


def _no_stamp(data: bytes) -> None:
    return None


def _compile_element(slot: Field) -> Tuple[Callable[[bytes, int], Tuple[Term, int]], int]:
    """Return the function that decodes one element of an array, and the least size of one."""
    code = _Code()
    result = code.single(slot._replace(length=None))
    code.flush()
    lines = ["def element(data, o):", *("  " + line for line in code.lines)]
    lines.append(f"  return {result}, {code.place()}")
    title = f"decode element {slot.type}"
    return compile_function("element", title, lines, code.names), least_size(slot._replace(length=None))


def _compile_records(slot: Field) -> Callable[[bytes], Term]:
    """Return the function that makes the list of an array's elements, which are of one size."""
    code = _Code()
    result = code.single(slot._replace(length=None))
    layout = Struct("<" + code.format)
    return record_maker(slot.describe(), layout, code.targets, result, code.names)


def _maker(slot: Field) -> Callable[[bytes], Term]:
    if slot.definition is None and slot.type in PRIMITIVES and slot.type != "bool":
        return array_maker(PRIMITIVES[slot.type])
    return _compile_records(slot)
