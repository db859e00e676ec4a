"""Source of decoding functions: from the bytes of a type, piece by piece, to the source of its term."""

from struct import Struct
from struct import error as StructError
from typing import Callable, List, Tuple, Union

from ..foundation import codegen
from ..prolog.terms import CONS, FALSE, NIL, TRUE, Atom, Functor, Lazy, Term, atom, functor
from .arrays import SMALL, alike, array_maker, record_maker, variable_array
from .definition import Definition, Field, measure_of
from .layout import element_size
from .slots import PRIMITIVES, TIMES, VARIABLE
from .text import blob_term
from .textcache import read_text, texts


class DecoderSource:
    """Source of the function for one type, in the making.

    Runs of fixed-size slots are collected until something of variable size comes. ``base`` is the source of
    the place where the run starts.
    """

    def __init__(self) -> None:
        self.lines: List[str] = []
        self._given = given = codegen.Names(
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
