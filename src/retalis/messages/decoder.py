"""Source of decoding functions: from the bytes of a type, piece by piece, to the source of its term.

Source of decoding functions for messages that are numbers, then texts, then numbers.

Message bytes to event terms, by functions that are generated for each type.

The generated source reads each run of fixed-size slots with one `struct` call. Long arrays and texts become
lazy terms: what no rule looks at is cut out of the message and left undecoded. Where a message is numbers,
then texts, then numbers, all texts are looked up at once by the bytes they make up (a robot's frame names
come again and again); so one transform costs two `struct` calls and one look-up.
"""

from copy import copy
from struct import Struct
from struct import error as StructError
from typing import Any, Callable, List, NamedTuple, Optional, Tuple, Union

from ..foundation import codegen
from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError
from ..prolog.terms.timestamps import SECOND
from ..prolog.terms.types import CONS, FALSE, NIL, TRUE, Atom, Functor, Lazy, Term, atom, functor
from .field_values import (
    SMALL,
    TEXT_COST,
    alike,
    array_maker,
    blob_term,
    keep_text,
    read_text,
    read_texts,
    record_maker,
    text_cache,
    texts,
    variable_array,
)
from .type_definition import (
    BARE,
    HEADER,
    PRIMITIVES,
    TIMES,
    VARIABLE,
    Definition,
    Field,
    check_bare,
    element_size,
    explain,
    measure_of,
)


class DecoderSource:
    """Source of the function for one type, in the making.

    Runs of fixed-size slots are collected until something of variable size comes. ``base`` is the source of
    the place where the run starts.
    """

    def __init__(self) -> None:
        self.lines: List[str] = []
        self._given = given = codegen.BoundNames(
            {
                "C": CONS,
                "N": NIL,
                "T": TRUE,
                "F": FALSE,
                "Lazy": Lazy,
                "StructError": StructError,
                "known": texts.get,
                "read_text": read_text,
                "blob": blob_term,
                "alike": alike,
            }
        )
        self.names, self.name = given.values, given.name
        self.base, self.shift = "o", 0
        self.format = ""
        self.targets: List[str] = []

    def constant(self, value: Union[Atom, Functor]) -> str:
        """Return the name of an atom or a functor."""
        return self._given.constant(value, value)

    # What a message is made of; the source of the term is returned.

    def message(self, definition: Definition) -> str:
        """Return the source of a whole message's term."""
        if not definition.fields:
            return self.constant(atom(definition.functor_name))
        head = self.constant(functor(definition.functor_name, len(definition.fields)))
        parts = [self.slot(slot) for slot in definition.fields]
        return f"({head}, {', '.join(parts)})"

    def slot(self, slot: Field) -> str:
        """Return the source of a slot: of one value, or of an array."""
        if slot.length is None:
            return self.single(slot)
        if slot.length == VARIABLE:
            return self.variable(slot)
        return self.fixed_array(slot)

    def single(self, slot: Field) -> str:
        """Return the source of one value of a slot."""
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
        """Return the source of an array whose length the definition says."""
        number = slot.length or 0
        if number == 0:
            return "blob(b'')" if slot.is_bytes else "N"
        if slot.is_bytes:
            return f"blob({self.fixed(f'{number}s')})"
        if number <= SMALL and slot.definition is None:
            parts = [self.single(slot._replace(length=None)) for _ in range(number)]
            return "".join(f"(C, {part}, " for part in parts) + "N" + ")" * number
        size = element_size(slot)
        if size is None:
            return self.elements(slot, str(number))
        if not size:
            return self.alike(slot, str(number))
        value = self.fixed(f"{number * size}s")
        return f"Lazy(C, {self.name('make', _maker(slot))}, {value})"

    def variable(self, slot: Field) -> str:
        """Return the source of an array whose length the bytes say."""
        number = self.fixed("I")
        self.flush()
        if slot.is_bytes:
            return self.blob(number)
        size = element_size(slot)
        if size is None:
            return self.elements(slot, number)
        if not size:
            return self.alike(slot, number)
        value = self.name("t")
        make = self.name("make", _maker(slot))
        self.move(f"{number} * {size}")
        self.lines += [
            f"if not {number}: {value} = N",
            f"elif {number} <= {SMALL}: {value} = {make}(data[s:o])",
            f"else: {value} = Lazy(C, {make}, data[s:o])",
        ]
        return value

    def alike(self, slot: Field, number: str) -> str:
        """An array whose elements have no bytes: all are one term."""
        return f"alike({self.single(slot._replace(length=None))}, {number})"

    def elements(self, slot: Field, number: str) -> str:
        """An array whose elements differ in size: each is decoded to find the next."""
        self.flush()
        read = self.name("read", variable_array(*_compile_element(slot)))
        value = self.name("t")
        self.lines.append(f"{value}, o = {read}(data, {self.place()}, {number})")
        self.base, self.shift = "o", 0
        return value

    def string(self) -> str:
        """Return the source of a text."""
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
        """Return the source of an array of bytes, so many of them."""
        self.move(number)
        value = self.name("t")
        self.lines.append(f"{value} = blob(data[s:o])")
        return value

    # Runs.

    def fixed(self, code: str) -> str:
        """Add a value of fixed size to the run, by its `struct` code; return its name."""
        self.format += code
        self.targets.append(self.name("v"))
        return self.targets[-1]

    def place(self) -> str:
        """Return the source of the place where the run starts."""
        return f"{self.base} + {self.shift}" if self.shift else self.base

    def flush(self) -> None:
        """End the run: add the line that reads it."""
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


def _compile_element(slot: Field) -> Tuple[Callable[[bytes, int], Tuple[Term, int]], int]:
    """Return the function that decodes one element of an array, and the least size of one."""
    code = DecoderSource()
    result = code.single(slot._replace(length=None))
    code.flush()
    lines = ["def element(data, o):", *("  " + line for line in code.lines)]
    lines.append(f"  return {result}, {code.place()}")
    element = codegen.function(lines, code.names, f"decode element {slot.type}", "element")
    return element, measure_of(slot).least


def _compile_records(slot: Field) -> Callable[[bytes], Term]:
    """Return the function that makes the list of an array's elements, which are of one size."""
    code = DecoderSource()
    result = code.single(slot._replace(length=None))
    layout = Struct("<" + code.format)
    return record_maker(slot.describe(), layout, code.targets, result, code.names)


def _maker(slot: Field) -> Callable[[bytes], Term]:
    if slot.definition is None and slot.type in PRIMITIVES and slot.type != "bool":
        return array_maker(PRIMITIVES[slot.type])
    return _compile_records(slot)


_BESIDE = 400
"""Bytes of what is kept beside the texts under one name."""


class Unsuited(Exception):
    """The type is not numbers, texts, numbers."""


class Watch(NamedTuple):
    """Who looks at the stamps of messages while these are read: their frames are looked up then in any case.

    Attributes:
        texts: how many texts of a message name its frames, which have to be all that it has.
        get: gives for the bytes of these texts what has the attribute ``second``, which is known; None for none.
            What it gives no more has a negative one from then on.
        look_all: looks at a message that is read in another way. What it raises comes out.
        look: the same for a message of another second, of which the frames' bytes and the time are known.
    """

    texts: int
    get: Callable[[bytes], Any]
    look_all: Callable[[bytes], object]
    look: Callable[[bytes, int], object]


class _Nothing:
    """What is known of frames that nobody has looked at."""

    second = -1


_NOTHING = _Nothing()


class FrameSource(DecoderSource):
    """Source for types that are numbers, then texts, then numbers.

    An array of messages at the end is taken to have one element.

    Args:
        watch: looks at the stamps of messages that are read.
    """

    def __init__(self, watch: Optional[Watch] = None) -> None:
        super().__init__()
        self.watch = watch
        self.texts: List[str] = []
        self.before: Tuple[str, List[str]] = ("", [])
        self.count: Optional[str] = None
        self.beside: List[str] = []
        """Variables whose values are kept beside the texts of a message's frames, None at first."""

    def string(self) -> str:
        """Add a text, which stands beside the others."""
        if self.texts and self.format:
            raise Unsuited
        if not self.texts:
            self.before = self.format, self.targets
            self.format, self.targets = "", []
        self.texts.append(self.name("t"))
        return self.texts[-1]

    def variable(self, slot: Field) -> str:
        """Add the array of messages, if it is the only one and before all texts."""
        if slot.definition is None or self.texts or self.count:
            raise Unsuited
        self.count = self.fixed("I")
        element = self.message(slot.definition)
        return self.only(element)

    def only(self, element: str) -> str:
        """Return the source of the list of one element."""
        return f"(C, {element}, N)"

    def elements(self, slot: Field, number: str) -> str:
        """Refuse: elements that differ in size are not of this shape."""
        raise Unsuited

    def build(self, definition: Definition, general: Callable[[bytes], object]) -> List[str]:
        """Return the source of the whole function, which falls back on ``general``, which looks by itself.

        Raises:
            Unsuited: where the type is not of this shape.
        """
        if definition.measure.may_be_bare:  # which have to be counted first
            raise Unsuited
        result = self.message(definition)
        head, tail = Struct("<" + self.before[0]), Struct("<" + self.format)
        if not self.texts or not (head.size or tail.size):
            raise Unsuited
        result = self.finish(result)
        self.names.update(head=head.unpack_from, tail=tail.unpack_from, general=general)
        self._cache_texts()
        lines = ["def decode(data):", "  try:"]
        if self.before[1]:
            lines.append(f"    {', '.join(self.before[1])}, = head(data)")
        if self.count:
            lines.append(f"    if {self.count} != 1: return general(data)")
        lines += [
            f"    key = data[{head.size}:{-tail.size if tail.size else ''}]",
            "    k = known(key)",
            "    if k is None:",
            "      k = learn(key)",
            "      if k is None: return general(data)",
        ]
        if tail.size:
            lines.append(f"    {', '.join(self.targets)}, = tail(data, {-tail.size})")
        lines += ["  except StructError:", "    return general(data)"]
        found = list(self.texts)
        if self.watch is not None:
            found.append("f")
        found[len(self.texts) : len(self.texts)] = self.beside
        lines.append(f"  {', '.join(found)}{'' if len(found) == 1 else ','} = k")
        if self.watch is not None:
            lines += self._look(self.watch)
        lines += self.prepare(tail.size)
        return [*lines, f"  return {result}"]

    def _look(self, watch: Watch) -> List[str]:
        """Return the lines that have a message looked at whose second is not known of its frames.

        Raises:
            Unsuited: where the frames are not all texts, or no stamp stands where a header has it.
        """
        at = 2 if self.count else 1  # behind ``seq``
        code, targets = self.before
        if len(self.texts) != watch.texts or code[: at + 2] != "I" * (at + 2):
            raise Unsuited
        get, look_at = watch.get, watch.look

        def look(key: bytes, second: int, nanosecond: int, known: List[object]) -> None:
            """Have a message looked at, and keep what is known of its frames beside the texts."""
            seen = get(key)
            try:
                if seen is None or seen.second != second:
                    look_at(key, second * SECOND + nanosecond)
                    seen = get(key)
            finally:
                known[-1] = seen or _NOTHING

        self.names["look"] = look
        second, nanosecond = targets[at : at + 2]
        return [f"  if f.second != {second}: look(key, {second}, {nanosecond}, k)"]

    def _cache_texts(self) -> None:
        """Have ``known`` and ``learn`` give all texts of a message by the bytes that they make up."""
        more = _BESIDE * len(self.beside)
        cache: Cache[bytes, object] = Cache(2048, 2 << 20, 1024 + more) if more else text_cache()
        number = len(self.texts)
        kept, watched, beside = self.kept, self.watch is not None, [None] * len(self.beside)

        def learn(key: bytes) -> object:
            read = read_texts(key, number)
            if read is None:
                return None
            texts = [kept(text) for text in read]
            if watched or beside:
                known = [*texts, *beside, *([_NOTHING] if watched else ())]
                return cache.keep(key, known, TEXT_COST * len(key) + more)
            return keep_text(cache, key, tuple(texts) if number > 1 else texts[0])

        self.names.update(known=cache.get, learn=learn)

    def prepare(self, tail: int) -> List[str]:
        """Return the lines that make what the result needs besides, ``tail`` being the bytes behind the texts.

        They find what is known of the frames in ``k``, and in it, after the texts, what is kept `beside` them.
        """
        return []

    def finish(self, result: str) -> str:
        """Return the source of what the function gives, from the source of the message's term."""
        return result

    def kept(self, text: Term) -> object:
        """Return what stands for a text in it."""
        return text


Decode = Callable[[bytes], Term]


class Decoder:
    """The decoder of one message type.

    >>> definitions = Definitions()
    >>> decoder = definitions.decoder(definitions.add("my_robot/Bumper", "bool left"))
    >>> Engine().show(decoder.decode(bytes([1])))
    'my_robot__0__Bumper(true)'

    Args:
        definition: the type.
        bare: how many elements without bytes a message may have.

    Attributes:
        definition: the type.
        functor: the functor of its event terms (arity 0: the term is an atom).
        decode: the function from the bytes of a message to its term. Raises `MessageError` where the bytes
            are no such message.
        stamp: the function from the bytes to the time of ``header.stamp`` in nanoseconds; None for a zero
            stamp, and always for a type without a header.
        watch: who looks at the stamps of the messages that `decode` reads; None for nobody.
        plain: the same decoder with nobody who looks, where there is somebody; otherwise None.
    """

    __slots__ = ("definition", "functor", "decode", "stamp", "watch", "plain")

    def __init__(self, definition: Definition, bare: int = BARE):
        self.definition = definition
        self.functor = functor(definition.functor_name, len(definition.fields))
        self.decode: Decode = _compile_decode(definition, bare)
        self.stamp: Callable[[bytes], Optional[int]] = _compile_stamp(definition)
        self.watch: Optional[Watch] = None
        self.plain: Optional[Decoder] = None

    def lazy(self, data: bytes) -> Term:
        """Return the term of a message, decoded when something looks at it.

        A message that is broken is found out only then.

        >>> definitions = Definitions()
        >>> decoder = definitions.decoder(definitions.add("my_robot/Bumper", "bool left"))
        >>> Engine().show(decoder.lazy(bytes([1])))
        'my_robot__0__Bumper(true)'
        """
        if not self.definition.fields:
            return self.decode(data)
        return Lazy(self.functor, self.decode, data)


def watching_decoder(decoder: Decoder, watch: Watch) -> Decoder:
    """Return a decoder that has somebody look at the stamps of the messages that it reads.

    Raises:
        Unsuited: where the type is not of the form for that.
    """
    plain = decoder.decode

    def general(data: bytes) -> Term:
        watch.look_all(data)
        return plain(data)

    found = copy(decoder)
    found.decode = _compile_frames(decoder.definition, general, watch)
    found.watch = watch
    found.plain = decoder
    return found


def _compile_decode(definition: Definition, bare: int) -> Decode:
    code = DecoderSource()
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
    general: Decode = codegen.function(lines, code.names, f"decode {definition.name}", "decode")
    if definition.measure.may_be_bare:
        return _checked(definition, bare, general)
    try:
        return _compile_frames(definition, general)
    except Unsuited:
        return general


def _compile_frames(definition: Definition, general: Decode, watch: Optional[Watch] = None) -> Decode:
    frames = FrameSource(watch)
    lines = frames.build(definition, general)
    fast: Decode = codegen.function(lines, frames.names, f"decode {definition.name}", "decode")
    return fast


def _checked(definition: Definition, bare: int, decode: Decode) -> Decode:
    """Return the function of a type with arrays that a few bytes may say anything of: they are counted before."""

    def checked(data: bytes) -> Term:
        check_bare(definition, data, bare)
        return decode(data)

    return checked


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
